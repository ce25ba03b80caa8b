"""Import of the package that writes PDF documents."""

from __future__ import annotations

from types import ModuleType

from mistray.errors import MistrayError


def fpdf_module() -> ModuleType:
    """
    Import and return the package fpdf2.

    Raises
    ------
    MistrayError
        If it is not installed; the message names the extra.
    """
    try:
        import fpdf
    except ImportError:
        raise MistrayError("PDF files need fpdf2, which is not installed; run: pip install 'mistray[pdf]'") from None
    return fpdf

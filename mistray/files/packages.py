"""Import of the packages that come with extras of mistray."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from mistray.errors import MistrayError

OF_FORMATS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "fits": ("FITS files need astropy", "astropy.io.fits", "images"),
        "exr": ("EXR files need OpenEXR", "OpenEXR", "images"),
        "parquet": ("Parquet files need pyarrow", "pyarrow", "tables"),
        "pdf": ("PDF files need fpdf2", "fpdf", "pdf"),
    }
)
"""Arguments of `package` for each file format that needs one, by the ending of its files."""


def package(need: str, module: str, extra: str) -> Any:
    """
    Import and return a module of a package that an extra installs.

    Parameters
    ----------
    need : str
        Purpose that needs the package, for the start of the message: "FITS files need astropy".
    module, extra : str
        Names of the module and of the extra.

    Raises
    ------
    MistrayError
        If it is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MistrayError(f"{need}, which is not installed; run: pip install 'mistray[{extra}]'") from None


def format_package(name: str) -> Any:
    """Import and return the package that a file format needs, or raise as `package` does; None if it needs none."""
    return package(*OF_FORMATS[name]) if name in OF_FORMATS else None

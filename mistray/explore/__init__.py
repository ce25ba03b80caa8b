"""Name of the live explorer, re-exported."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.explorer.explorer import Explorer

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.explorer.explorer": ("Explorer",),
    },
)

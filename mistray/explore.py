"""Public name of the live explorer, re-exported."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.explorer.explorer": ("Explorer",),
    },
)

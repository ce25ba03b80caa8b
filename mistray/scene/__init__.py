"""Optical systems as Mitsuba scenes: loading, checking, editing, naming and coating."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "add_structures": ["add_structures"],
        "coat": ["Coated", "coat", "write_coated"],
        "load": ["find", "load"],
        "surface_rules": ["Rules"],
    },
)

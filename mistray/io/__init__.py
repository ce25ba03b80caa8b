"""Readers and writers for lens files and CAD files of other programs."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "batoid.read": ["from_batoid"],
        "camera_json": ["from_json"],
        "codev.read": ["read_codev"],
        "flaresim": ["read_flaresim"],
        "oslo": ["read_oslo"],
        "prescriptions": ["from_codev", "from_flaresim", "from_optiland", "from_oslo", "from_rayoptics", "from_zemax"],
        "to_sequential": ["to_sequential"],
        "write_optiland": ["to_optiland"],
        "zemax.read": ["read_zemax"],
        "zemax.write": ["write_zemax"],
    },
)

"""Readers and writers of lens files and CAD files of other programs."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.io.batoid.read import from_batoid
    from mistray.io.camera_json import from_json
    from mistray.io.codev.read import read_codev
    from mistray.io.flaresim import read_flaresim
    from mistray.io.oslo import read_oslo
    from mistray.io.prescriptions import (
        from_codev,
        from_flaresim,
        from_optiland,
        from_oslo,
        from_rayoptics,
        from_zemax,
    )
    from mistray.io.to_sequential import to_sequential
    from mistray.io.write_optiland import to_optiland
    from mistray.io.zemax.read import read_zemax
    from mistray.io.zemax.write import write_zemax

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

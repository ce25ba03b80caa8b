"""Readers and writers for lens files and CAD files of other programs."""

# Written by tests/stubs.py from what the functions are when they run

from mistray.io.batoid.read import from_batoid as from_batoid
from mistray.io.camera_json import from_json as from_json
from mistray.io.codev.read import read_codev as read_codev
from mistray.io.flaresim import read_flaresim as read_flaresim
from mistray.io.oslo import read_oslo as read_oslo
from mistray.io.prescriptions import from_codev as from_codev
from mistray.io.prescriptions import from_flaresim as from_flaresim
from mistray.io.prescriptions import from_optiland as from_optiland
from mistray.io.prescriptions import from_oslo as from_oslo
from mistray.io.prescriptions import from_rayoptics as from_rayoptics
from mistray.io.prescriptions import from_zemax as from_zemax
from mistray.io.to_sequential import to_sequential as to_sequential
from mistray.io.write_optiland import to_optiland as to_optiland
from mistray.io.zemax.read import read_zemax as read_zemax
from mistray.io.zemax.write import write_zemax as write_zemax

__all__ = [
    "from_batoid",
    "from_codev",
    "from_flaresim",
    "from_json",
    "from_optiland",
    "from_oslo",
    "from_rayoptics",
    "from_zemax",
    "read_codev",
    "read_flaresim",
    "read_oslo",
    "read_zemax",
    "to_optiland",
    "to_sequential",
    "write_zemax",
]

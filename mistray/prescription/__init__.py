"""What an optical system is: dataclasses, geometry generators and readers."""

from mistray.prescription.baffle_cassegrain import CassegrainBaffles, cassegrain_baffles
from mistray.prescription.baffle_two_stage import TwoStageBaffle, two_stage_baffle
from mistray.prescription.baffle_vanes import Vane, VaneEdge
from mistray.prescription.baffle_zones import first_order_zones, lit_zones, seen_zones
from mistray.prescription.baffles import BaffleTube, hood_length, vane_tube
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import barrel, detector_frame, lens_edge, wall
from mistray.prescription.model import Detector, Prescription, Source, Stop, Structure, Surface
from mistray.prescription.read_batoid import from_batoid
from mistray.prescription.read_json import from_json
from mistray.prescription.scatter import Scatter

__all__ = [
    "BaffleTube",
    "CassegrainBaffles",
    "Coating",
    "Detector",
    "Prescription",
    "Scatter",
    "Source",
    "Stop",
    "Structure",
    "Surface",
    "TwoStageBaffle",
    "Vane",
    "VaneEdge",
    "barrel",
    "cassegrain_baffles",
    "detector_frame",
    "first_order_zones",
    "from_batoid",
    "from_json",
    "hood_length",
    "lens_edge",
    "lit_zones",
    "seen_zones",
    "two_stage_baffle",
    "vane_tube",
    "wall",
]

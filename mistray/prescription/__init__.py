"""What an optical system is: dataclasses, geometry generators and readers."""

from mistray.prescription.baffle_cassegrain import CassegrainBaffles, cassegrain_baffles
from mistray.prescription.baffle_two_stage import TwoStageBaffle, two_stage_baffle
from mistray.prescription.baffle_vanes import Vane, VaneEdge
from mistray.prescription.baffle_zones import first_order_zones, lit_zones, seen_zones
from mistray.prescription.baffles import BaffleTube, hood_length, vane_tube
from mistray.prescription.build import Built, to_prescription
from mistray.prescription.coating import Coating
from mistray.prescription.first_order import FirstOrder
from mistray.prescription.from_files import from_codev, from_optiland, from_rayoptics, from_zemax
from mistray.prescription.geometry import barrel, detector_frame, lens_edge, wall
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.model import Detector, Prescription, Source, Stop, Structure, Surface
from mistray.prescription.read_batoid import from_batoid
from mistray.prescription.read_codev import read_codev
from mistray.prescription.read_json import from_json
from mistray.prescription.read_zemax import read_zemax
from mistray.prescription.scatter import Scatter
from mistray.prescription.sequential import ClearAperture, Decentre, Row, Sequential, Unread
from mistray.prescription.to_sequential import to_sequential
from mistray.prescription.write_zemax import write_zemax

__all__ = [
    "BaffleTube",
    "Built",
    "CassegrainBaffles",
    "ClearAperture",
    "Coating",
    "Decentre",
    "Detector",
    "FirstOrder",
    "MeshStructure",
    "Prescription",
    "Row",
    "Scatter",
    "Sequential",
    "Source",
    "Stop",
    "Structure",
    "Surface",
    "TwoStageBaffle",
    "Unread",
    "Vane",
    "VaneEdge",
    "barrel",
    "cassegrain_baffles",
    "detector_frame",
    "first_order_zones",
    "from_batoid",
    "from_codev",
    "from_json",
    "from_optiland",
    "from_rayoptics",
    "from_zemax",
    "hood_length",
    "lens_edge",
    "lit_zones",
    "read_codev",
    "read_zemax",
    "seen_zones",
    "to_prescription",
    "to_sequential",
    "two_stage_baffle",
    "vane_tube",
    "wall",
    "write_zemax",
]

"""What an optical system is: dataclasses, geometry generators and readers."""

from mistray.prescription.coating import Coating
from mistray.prescription.geometry import barrel, detector_frame, lens_edge, wall
from mistray.prescription.model import Detector, Prescription, Source, Stop, Structure, Surface
from mistray.prescription.read_batoid import from_batoid
from mistray.prescription.read_json import from_json
from mistray.prescription.scatter import Scatter

__all__ = [
    "Coating",
    "Detector",
    "Prescription",
    "Scatter",
    "Source",
    "Stop",
    "Structure",
    "Surface",
    "barrel",
    "detector_frame",
    "from_batoid",
    "from_json",
    "lens_edge",
    "wall",
]

"""Prescription of an optical system: its dataclasses, generators of mechanical faces, and export to a scene file."""

from typing import TYPE_CHECKING, Any

from mistray.physics.geometry.outline import Outline, OutlineFigure, circle, polygon, rectangle
from mistray.physics.sags.grid import Grid
from mistray.prescription.baffles.cassegrain import CassegrainBaffles, cassegrain_baffles
from mistray.prescription.baffles.spider import spider
from mistray.prescription.baffles.two_stage import TwoStageBaffle, two_stage_baffle
from mistray.prescription.baffles.vane_edges import Vane, VaneEdge
from mistray.prescription.baffles.vane_tube import BaffleTube, hood_length, vane_tube
from mistray.prescription.baffles.zones import first_order_zones, lit_zones, seen_zones
from mistray.prescription.bodies.extruded import beam_splitter_cube, box, prism
from mistray.prescription.bodies.fresnel import fresnel
from mistray.prescription.bodies.placing import array, moved_as_one
from mistray.prescription.bodies.plate import plate
from mistray.prescription.closing.system import Built, to_prescription
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import barrel, detector_frame, lens_edge, wall
from mistray.prescription.grid_file import read_grid, save_grid
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.model import Detector, Prescription, Stop, Structure, Surface
from mistray.prescription.scatter import Scatter
from mistray.prescription.sequential.first_order import SequentialFirstOrder
from mistray.prescription.sequential.table import Decentre, Row, Sequential, Unread
from mistray.prescription.sources import ObjectPoint, Source

if TYPE_CHECKING:
    from mistray.io import (  # type: ignore[no-redef]  # a module has a name of these, too
        from_batoid,
        from_codev,
        from_flaresim,
        from_json,
        from_optiland,
        from_oslo,
        from_rayoptics,
        from_zemax,
        read_codev,
        read_flaresim,
        read_oslo,
        read_zemax,
        to_optiland,
        to_sequential,
        write_zemax,
    )

# Their names before version 0.3
Figure, FirstOrder = OutlineFigure, SequentialFirstOrder

__all__ = [
    "BaffleTube",
    "Built",
    "CassegrainBaffles",
    "Coating",
    "Decentre",
    "Detector",
    "Figure",
    "FirstOrder",
    "Grid",
    "MeshStructure",
    "ObjectPoint",
    "Outline",
    "OutlineFigure",
    "Prescription",
    "Row",
    "Scatter",
    "Sequential",
    "SequentialFirstOrder",
    "Source",
    "Stop",
    "Structure",
    "Surface",
    "TwoStageBaffle",
    "Unread",
    "Vane",
    "VaneEdge",
    "array",
    "barrel",
    "beam_splitter_cube",
    "box",
    "cassegrain_baffles",
    "circle",
    "detector_frame",
    "first_order_zones",
    "fresnel",
    "from_batoid",
    "from_codev",
    "from_flaresim",
    "from_json",
    "from_optiland",
    "from_oslo",
    "from_rayoptics",
    "from_zemax",
    "hood_length",
    "lens_edge",
    "lit_zones",
    "moved_as_one",
    "plate",
    "polygon",
    "prism",
    "read_codev",
    "read_flaresim",
    "read_grid",
    "read_oslo",
    "read_zemax",
    "rectangle",
    "save_grid",
    "seen_zones",
    "spider",
    "to_optiland",
    "to_prescription",
    "to_sequential",
    "two_stage_baffle",
    "vane_tube",
    "wall",
    "write_zemax",
]


def __getattr__(name: str) -> Any:
    """Import a reader or writer of lens files from `mistray.io` on first use."""
    if name in __all__:
        from mistray import io

        return getattr(io, name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)

"""A lens behind a two-stage baffle with vanes, as of a star tracker."""

from __future__ import annotations

from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Structure, Surface, lens_edge
from mistray.prescription.baffles.two_stage import two_stage_baffle

LENS_RADIUS, LENS_THICKNESS, CURVATURE_RADIUS, CONIC = 10.0, 5.0, 20.672, -0.582
DETECTOR_Z, DETECTOR_RADIUS = 41.704, 3.5
CHAMBER_RADIUS = 14.0
FIELD_DEG, EXCLUSION_DEG = 5.0, 40.0
VANE_DEPTH, CLEARANCE = 8.0, 0.2
GLASS = "1.5168"

BLACK = Coating(R=0.0)
PAINT = Scatter("paint", {"reflectance": 0.05}, name="black_paint")
PAINT_INSIDE = Scatter("paint", {"reflectance": 0.05, "side": "front"}, name="black_paint_inside")
POLISH = Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5}, name="polish_2nm")
DUST = Scatter("particulate", {"level": 300.0}, name="particles_300")
AR = Coating(R=0.005, T=0.995)


def build() -> Prescription:
    """Two stages of vanes up to the rim of a lens, which is the stop, then a chamber with the detector."""
    lens = {"semi_diameter": LENS_RADIUS, "coating": AR, "part": "lens"}
    front = Surface("lens_front", radius=CURVATURE_RADIUS, conic=CONIC, back=GLASS, scatter=(POLISH, DUST), **lens)
    rear = Surface("lens_rear", z=LENS_THICKNESS, front=GLASS, scatter=(POLISH,), **lens)
    rim_z = front.rim[1]
    baffle = two_stage_baffle(
        "baffle",
        optic_radius=LENS_RADIUS,
        z_rear=rim_z,
        field_deg=FIELD_DEG,
        exclusion_deg=EXCLUSION_DEG,
        depth=VANE_DEPTH,
        clearance=CLEARANCE,
    )
    black = {"coating": BLACK, "scatter": (PAINT,)}
    mount = Structure("lens_mount", baffle.inner.wall_rear, rim_z, LENS_RADIUS, rim_z, part="mount", **black)
    inside = {"coating": BLACK, "scatter": (PAINT_INSIDE,), "part": "chamber"}
    chamber = Structure("chamber_wall", CHAMBER_RADIUS, rim_z, CHAMBER_RADIUS, DETECTOR_Z, **inside)
    board = Structure("board", CHAMBER_RADIUS, DETECTOR_Z, DETECTOR_RADIUS, DETECTOR_Z, **black)
    return Prescription(
        name="Two-stage baffle of a star tracker, f = 40 mm, exclusion angle 40°",
        surfaces=(front, rear),
        structures=(
            *baffle.structures(coating=BLACK, scatter=(PAINT,), wall_scatter=(PAINT_INSIDE,)),
            mount,
            *lens_edge(front, rear),
            chamber,
            board,
        ),
        detector=Detector(z=DETECTOR_Z, semi_diameter=DETECTOR_RADIUS, pixels=(70, 70)),
        source=Source(radius=LENS_RADIUS, wavelength_nm=(550.0,)),
        provenance="Baffle by mistray.prescription.baffles.two_stage; see SOURCE.md.",
    )

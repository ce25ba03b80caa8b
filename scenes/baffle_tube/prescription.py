"""A lens behind a tube with vanes that leave no first-order path to it."""

from __future__ import annotations

from mistray.prescription import (
    Coating,
    Detector,
    Prescription,
    Scatter,
    Source,
    Stop,
    Structure,
    Surface,
    lens_edge,
    vane_tube,
)

TUBE_RADIUS = 30.0
LENS_Z, LENS_RADIUS, LENS_THICKNESS, CURVATURE_RADIUS = 100.0, 18.0, 6.0, 80.0
STOP_Z, STOP_RADIUS = 112.0, 10.0
DETECTOR_Z, DETECTOR_RADIUS = 184.0, 6.0
FIELD_DEG = 4.0
GLASS = "1.5"

BLACK = Coating(R=0.0)
PAINT = Scatter("paint", {"reflectance": 0.05}, name="black_paint")
PAINT_INSIDE = Scatter("paint", {"reflectance": 0.05, "side": "front"}, name="black_paint_inside")
POLISH = Scatter("harvey_shack", {"rms_nm": 4.0, "l": 0.01, "s": -1.5}, name="polish_4nm")
AR = Coating(R=0.01, T=0.99)


def build() -> Prescription:
    """Vanes from the opening at z = 0 to the rim of the lens, then a chamber that the stop divides."""
    lens = {"semi_diameter": LENS_RADIUS, "coating": AR, "scatter": (POLISH,), "part": "lens"}
    front = Surface("lens_front", z=LENS_Z, radius=CURVATURE_RADIUS, back=GLASS, **lens)
    rear = Surface("lens_rear", z=LENS_Z + LENS_THICKNESS, radius=-CURVATURE_RADIUS, front=GLASS, **lens)
    rim_z = front.rim[1]
    tube = vane_tube(
        "tube",
        optic_radius=LENS_RADIUS,
        z_rear=rim_z,
        length=rim_z,
        wall_radius=TUBE_RADIUS,
        field_deg=FIELD_DEG,
    )
    black = {"coating": BLACK, "scatter": (PAINT,)}
    mount = Structure("lens_mount", TUBE_RADIUS, rim_z, LENS_RADIUS, rim_z, part="mount", **black)
    edge = lens_edge(front, rear)
    chamber = Structure(
        "chamber_wall",
        TUBE_RADIUS,
        rim_z,
        TUBE_RADIUS,
        DETECTOR_Z,
        coating=BLACK,
        scatter=(PAINT_INSIDE,),
        part="chamber",
    )
    board = Structure("board", TUBE_RADIUS, DETECTOR_Z, DETECTOR_RADIUS, DETECTOR_Z, **black)
    return Prescription(
        name="Baffle tube with a lens, f = 81 mm",
        surfaces=(front, rear),
        structures=(
            *tube.structures(coating=BLACK, scatter=(PAINT,), wall_scatter=(PAINT_INSIDE,)),
            mount,
            *edge,
            chamber,
            board,
        ),
        stop=Stop(STOP_RADIUS, STOP_Z, STOP_Z, TUBE_RADIUS, TUBE_RADIUS, **black),
        detector=Detector(z=DETECTOR_Z, semi_diameter=DETECTOR_RADIUS, pixels=(120, 120)),
        source=Source(radius=tube.vanes[0].radius, wavelength_nm=(550.0,)),
        provenance="Vanes by mistray.prescription.vane_tube; see SOURCE.md.",
    )

"""Cassegrain telescope with main tube, vanes, secondary baffle and inner baffle."""

from __future__ import annotations

from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Structure, Surface, vane_tube
from mistray.prescription.baffles.cassegrain import cassegrain_baffles

PRIMARY_FOCAL_LENGTH, PRIMARY_RADIUS, HOLE_RADIUS = 500.0, 100.0, 26.0
SECONDARY_DISTANCE, SECONDARY_RADIUS, SECONDARY_THICKNESS = 370.0, 24.0, 5.0
BACK_FOCUS = 150.0
DETECTOR_RADIUS = 10.0
FIELD_DEG = 0.28
TUBE_RADIUS, TUBE_LENGTH, TUBE_CLEARANCE = 130.0, 800.0, 3.0
INNER_DEPTH, INNER_WALL_REAR = 4.0, 26.0

BLACK = Coating(R=0.0)
PAINT = Scatter("paint", {"reflectance": 0.05}, name="black_paint")
PAINT_INSIDE = Scatter("paint", {"reflectance": 0.05, "side": "front"}, name="black_paint_inside")
POLISH = Scatter("harvey_shack", {"rms_nm": 1.5, "l": 0.01, "s": -1.5}, name="polish_1_5nm")
DUST = Scatter("particulate", {"level": 300.0}, name="particles_300")
MIRROR = Coating(R=0.95)


def build() -> Prescription:
    """Paraboloid, hyperboloid (the stop), and everything black around them, from the sky to the detector."""
    # Image distances of the secondary: p to the focus of the primary, q to the detector
    p = PRIMARY_FOCAL_LENGTH - SECONDARY_DISTANCE
    q = SECONDARY_DISTANCE + BACK_FOCUS
    magnification = q / p
    mirror = {"coating": MIRROR, "scatter": (POLISH, DUST), "mirror": True}
    primary = Surface(
        "primary",
        radius=-2 * PRIMARY_FOCAL_LENGTH,
        conic=-1.0,
        semi_diameter=PRIMARY_RADIUS,
        inner_semi_diameter=HOLE_RADIUS,
        **mirror,
    )
    secondary = Surface(
        "secondary",
        z=-SECONDARY_DISTANCE,
        radius=-2 * p * q / (q - p),
        conic=-(((magnification + 1) / (magnification - 1)) ** 2),
        semi_diameter=SECONDARY_RADIUS,
        **mirror,
    )
    detector = Detector(z=BACK_FOCUS, semi_diameter=DETECTOR_RADIUS, pixels=(100, 100))
    baffles = cassegrain_baffles(
        primary, secondary, detector, field_deg=FIELD_DEG, wall_depth=INNER_DEPTH, wall_rear=INNER_WALL_REAR
    )
    black = {"coating": BLACK, "scatter": (PAINT,)}
    rim_r, rim_z = primary.rim
    hole_z = float(primary.z_at(HOLE_RADIUS))
    tube = vane_tube(
        "tube",
        optic_radius=PRIMARY_RADIUS,
        z_rear=rim_z,
        length=TUBE_LENGTH + rim_z,
        wall_radius=TUBE_RADIUS,
        field_deg=FIELD_DEG,
        clearance=TUBE_CLEARANCE,
    )
    back_z = -SECONDARY_DISTANCE - SECONDARY_THICKNESS
    return Prescription(
        name="Cassegrain telescope, f = 2000 mm",
        surfaces=(primary, secondary),
        structures=(
            *tube.structures(coating=BLACK, scatter=(PAINT,), wall_scatter=(PAINT_INSIDE,)),
            Structure("mirror_cell", TUBE_RADIUS, rim_z, rim_r, rim_z, **black),
            Structure("hole_ring", HOLE_RADIUS, hole_z, baffles.tube.wall_radius(hole_z), hole_z, **black),
            Structure("secondary_back", SECONDARY_RADIUS, back_z, 0.0, back_z, part="secondary_cell", **black),
            Structure(
                "secondary_edge", SECONDARY_RADIUS, back_z, *baffles.secondary_rim, part="secondary_cell", **black
            ),
            *baffles.structures(**black),
            Structure("board", INNER_WALL_REAR, BACK_FOCUS, DETECTOR_RADIUS, BACK_FOCUS, **black),
        ),
        detector=detector,
        source=Source(radius=PRIMARY_RADIUS, z=-TUBE_LENGTH, plane="axis", wavelength_nm=(550.0,)),
        provenance="Baffles by mistray.prescription.baffles.cassegrain and baffles; see SOURCE.md.",
    )

"""Ritchey-Chrétien telescope with a spider of four vanes, polished mirrors and dust, in a black tube."""

from __future__ import annotations

from dataclasses import replace

from mistray.prescription import (
    Coating,
    Detector,
    Prescription,
    Scatter,
    Source,
    Structure,
    Surface,
    detector_frame,
    spider,
)

PRIMARY_FOCAL_LENGTH, PRIMARY_RADIUS, HOLE_RADIUS = 1500.0, 250.0, 75.0
SECONDARY_DISTANCE, SECONDARY_RADIUS = 1080.0, 80.0
BACK_FOCUS = 300.0
DETECTOR_HALF = 25.0
TUBE_RADIUS, TUBE_LENGTH = 300.0, 1900.0
CELL_RADIUS, CELL_DEPTH = 85.0, 60.0
INSTRUMENT_RADIUS, BEHIND_MIRROR = 120.0, 5.0

BLACK = Coating(R=0.0)
PAINT = Scatter("paint", {"reflectance": 0.05}, name="black_paint")
POLISH = Scatter("harvey_shack", {"rms_nm": 1.5, "l": 0.01, "s": -1.5}, name="polish_1_5nm")
DUST = Scatter("particulate", {"level": 300.0}, name="particles_300")
MIRROR = Coating(R=0.95)


def build() -> Prescription:
    """Two hyperboloids without spherical aberration and coma; the primary is the stop."""
    p, q = PRIMARY_FOCAL_LENGTH - SECONDARY_DISTANCE, SECONDARY_DISTANCE + BACK_FOCUS
    m, beta = q / p, BACK_FOCUS / PRIMARY_FOCAL_LENGTH
    mirror = {"coating": MIRROR, "scatter": (POLISH, DUST), "mirror": True}
    primary = Surface(
        "primary",
        radius=-2 * PRIMARY_FOCAL_LENGTH,
        conic=-1 - 2 * (1 + beta) / (m * m * (m - beta)),
        semi_diameter=PRIMARY_RADIUS,
        inner_semi_diameter=HOLE_RADIUS,
        **mirror,
    )
    secondary = Surface(
        "secondary",
        z=-SECONDARY_DISTANCE,
        radius=-2 * p * q / (q - p),
        conic=-(((m + 1) / (m - 1)) ** 2) - 2 * m * (m + 1) / ((m - beta) * (m - 1) ** 3),
        semi_diameter=SECONDARY_RADIUS,
        **mirror,
    )
    black = {"coating": BLACK, "scatter": (PAINT,)}
    rim_r, rim_z = primary.rim
    cell_z = secondary.rim[1]
    front = cell_z - CELL_DEPTH
    detector = Detector(z=BACK_FOCUS, half_width=DETECTOR_HALF, half_height=DETECTOR_HALF, pixels=(100, 100))
    board = tuple(replace(piece, **black) for piece in detector_frame(detector, INSTRUMENT_RADIUS))
    return Prescription(
        name="Ritchey-Chrétien telescope with spider, f = 4929 mm",
        surfaces=(primary, secondary),
        structures=(
            *spider(
                "spider", vanes=4, inner_radius=CELL_RADIUS, outer_radius=TUBE_RADIUS, thickness=4.0, depth=CELL_DEPTH,
                z=front, start_deg=45.0, **black,
            ),
            Structure("cell_front", CELL_RADIUS, front, 0.0, front, part="cell", **black),
            Structure("cell_wall", CELL_RADIUS, front, CELL_RADIUS, cell_z, part="cell", **black),
            Structure("cell_ring", CELL_RADIUS, cell_z, SECONDARY_RADIUS, cell_z, part="cell", **black),
            Structure("tube", TUBE_RADIUS, rim_z - TUBE_LENGTH, TUBE_RADIUS, rim_z, **black),
            Structure(
                "instrument", INSTRUMENT_RADIUS, BEHIND_MIRROR, INSTRUMENT_RADIUS, BACK_FOCUS, **black
            ),
            *board,
            Structure("mirror_cell", TUBE_RADIUS, rim_z, rim_r, rim_z, **black),
        ),
        detector=detector,
        source=Source(radius=PRIMARY_RADIUS, z=rim_z - TUBE_LENGTH, plane="axis", wavelength_nm=(550.0,)),
        provenance="Two hyperboloids by the formulas of Schroeder; see SOURCE.md.",
    )  # fmt: skip

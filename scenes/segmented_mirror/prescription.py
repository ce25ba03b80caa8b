"""Cassegrain telescope whose primary mirror consists of 18 hexagons."""

from __future__ import annotations

import math

from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface, polygon

FLAT_TO_FLAT, GAP = 1320.0, 7.0
FOCAL_LENGTH, SECONDARY_DISTANCE, BACK_FOCUS = 8000.0, 7170.0, 1500.0
SECONDARY_RADIUS, SOURCE_RADIUS = 370.0, 3400.0
MIRROR = Coating(R=0.98)
BLACK = Coating(R=0.0)
RINGS = 2


def places() -> list[tuple[float, float]]:
    """Middles of the hexagons of two rings, mm."""
    found = []
    for i in range(-RINGS, RINGS + 1):
        for j in range(-RINGS, RINGS + 1):
            if 1 <= max(abs(i), abs(j), abs(i + j)) <= RINGS:
                found.append(((FLAT_TO_FLAT + GAP) * (i + j / 2), (FLAT_TO_FLAT + GAP) * j * math.sqrt(3) / 2))
    return found


def hexagon(x: float, y: float) -> list[tuple[float, float]]:
    """Corners of a hexagon, mm."""
    r = FLAT_TO_FLAT / math.sqrt(3)
    angles = [math.radians(30 + 60 * k) for k in range(6)]
    return [(round(x + r * math.cos(a), 6), round(y + r * math.sin(a), 6)) for a in angles]


def build() -> Prescription:
    """Each segment is a surface of its own with the figure of the whole paraboloid."""
    p, q = FOCAL_LENGTH - SECONDARY_DISTANCE, SECONDARY_DISTANCE + BACK_FOCUS
    m = q / p
    mirror = {"coating": MIRROR, "mirror": True}
    segments = [
        Surface(f"segment_{k}", radius=-2 * FOCAL_LENGTH, conic=-1.0, outline=polygon(hexagon(x, y)), **mirror)
        for k, (x, y) in enumerate(places(), start=1)
    ]
    secondary = Surface(
        "secondary", z=-SECONDARY_DISTANCE, radius=-2 * p * q / (q - p), conic=-(((m + 1) / (m - 1)) ** 2),
        semi_diameter=SECONDARY_RADIUS, **mirror,
    )  # fmt: skip
    back = -SECONDARY_DISTANCE - 50.0
    return Prescription(
        name="Cassegrain telescope with 18 segments",
        surfaces=(*segments, secondary),
        structures=(Structure("secondary_back", SECONDARY_RADIUS, back, 0.0, back, coating=BLACK),),
        detector=Detector(z=BACK_FOCUS, half_width=200.0, half_height=200.0, pixels=(100, 100)),
        source=Source(radius=SOURCE_RADIUS, z=-SECONDARY_DISTANCE - 500.0, plane="axis", wavelength_nm=(2000.0,)),
        provenance="After the primary mirror of JWST; see SOURCE.md.",
    )

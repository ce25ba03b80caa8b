"""Offner relay with a near point of light: two concentric spheres image it at unit magnification."""

from __future__ import annotations

import math

from mistray.materials import refractive_index
from mistray.prescription import (
    Coating,
    Detector,
    Figure,
    ObjectPoint,
    Outline,
    Prescription,
    Structure,
    Surface,
    plate,
    prism,
)

PRIMARY_RADIUS, HEIGHT = 400.0, 60.0  # mm; of the object above the common centre, which is the origin
SECONDARY_RADIUS = PRIMARY_RADIUS / (2 * math.sqrt(1 - (HEIGHT / PRIMARY_RADIUS) ** 2))
APERTURE = 0.1  # sine of the half angle of the cone that the secondary takes
STOP_RADIUS, MOUNT_RADIUS, SECONDARY_MM = 20.0, 34.0, 12.0
PRIMARY_SEMI_DIAMETER, PRIMARY_MM = 112.0, 20.0
HALF_ANGLE_DEG = 7.0
WINDOW_MM, WINDOW_GAP_MM, WINDOW_HALF, WINDOW = 2.0, 8.0, 22.0, "N-BK7"
DETECTOR_HALF, OPENING_HALF = 12.0, 10.0
HOUSING_RADIUS, SCREEN_Z, SCREEN_MM, SEPTUM_HALF = 125.0, -6.0, 1.0, 60.0
WAVELENGTH_NM = 550.0
MIRROR, BLACK, SILICON = Coating(R=0.95), Coating(R=0.0), Coating(R=0.3)


def build() -> Prescription:
    """Light leaves the object in the plane z = 0 towards +z and comes back to that plane on the other side."""
    mirror = {"coating": MIRROR, "mirror": True}
    primary, secondary = (
        Surface(name, z=radius, radius=-radius, semi_diameter=semi_diameter, **mirror)
        for name, radius, semi_diameter in (
            ("primary", PRIMARY_RADIUS, PRIMARY_SEMI_DIAMETER),
            ("secondary", SECONDARY_RADIUS, STOP_RADIUS),
        )
    )
    r, z = secondary.rim
    back = SECONDARY_RADIUS - SECONDARY_MM
    # The plate moves the focus away by d (1 - 1/n)
    n = refractive_index(WINDOW, WAVELENGTH_NM).real
    focus = -WINDOW_MM * (1 - 1 / n)
    near, far = WINDOW_GAP_MM, WINDOW_GAP_MM + WINDOW_MM
    low, high = -HEIGHT - WINDOW_HALF, -HEIGHT + WINDOW_HALF
    window = prism(
        "window", [(low, near), (high, near), (high, far), (low, far)], 2 * WINDOW_HALF, material=WINDOW,
        faces=("rear", "top", "front", "bottom"),
    )  # fmt: skip
    opening = Figure("rectangle", "-", y=HEIGHT, sizes=(OPENING_HALF, OPENING_HALF))
    screen = Outline((Figure("circle", sizes=(HOUSING_RADIUS,)), opening))
    behind, end = SCREEN_Z + SCREEN_MM, PRIMARY_RADIUS + PRIMARY_MM
    by_name = {face.name: face for face in window}
    order = ("window_front", "window_rear")
    return Prescription(
        name="Offner relay, 1:1, NA 0.1",
        surfaces=(primary, secondary, *(by_name[name] for name in order)),
        structures=(
            Structure("secondary_mount", r, z, MOUNT_RADIUS, z, coating=BLACK, part="mount"),
            Structure("secondary_edge", r, z, r, back, coating=BLACK, part="mount"),
            Structure("secondary_back", r, back, 0.0, back, coating=BLACK, part="mount"),
            *(face for face in window if face.name not in order),
            *plate("screen", screen, SCREEN_MM, z=SCREEN_Z, coating=BLACK),
            Structure("housing_wall", HOUSING_RADIUS, behind, HOUSING_RADIUS, end, coating=BLACK, part="housing"),
            Surface(
                "septum", z=behind + SEPTUM_HALF, tilt_deg=(90.0, 0.0, 0.0), half_width=0.8 * HOUSING_RADIUS,
                half_height=SEPTUM_HALF, coating=BLACK,
            ),
            Structure("housing_end", HOUSING_RADIUS, end, 0.0, end, coating=BLACK, part="housing"),
        ),
        detector=Detector(
            y=-HEIGHT, z=round(focus, 6), tilt_deg=(180.0, 0.0, 0.0), half_width=DETECTOR_HALF,
            half_height=DETECTOR_HALF, pixels=(96, 96), coating=SILICON,
        ),
        source=ObjectPoint(
            y=HEIGHT, z=PRIMARY_RADIUS, distance=PRIMARY_RADIUS, half_angle_deg=HALF_ANGLE_DEG,
            wavelength_nm=(WAVELENGTH_NM,),
        ),
        provenance="Layout of US patent 3,748,015 (A. Offner, 1973); see SOURCE.md.",
    )  # fmt: skip

"""Off-axis telescope of four mirrors without obscuration, by a patent, with a shade around its stop."""

from __future__ import annotations

import math

import numpy as np

from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface, rectangle
from mistray.prescription.closing.edges import placed

MIRROR = Coating(R=0.97)
BLACK = Coating(R=0.0)
STOP_RADIUS, SHADE_RADIUS = 58.5, 82.0
FIELD_DEG = 16.0
PUPIL = (-25.053031568, 1547.4175408546212)  # y and z of the middle of the entrance pupil in the patent's frame, mm
START_Z = 380.0  # of the world's origin in that frame: on the middle ray, before the first mirror


def build() -> Prescription:
    """The mirrors are pieces beside the axis of their figures; the light of the design field travels +z."""
    c, s = math.cos(math.radians(FIELD_DEG)), math.sin(math.radians(FIELD_DEG))
    y = PUPIL[0] + (START_Z - PUPIL[1]) * s / c
    frame = np.array([[1, 0, 0, 0], [0, c, -s, s * START_Z - c * y], [0, s, c, -c * START_Z - s * y], [0, 0, 0, 1.0]])
    mirror = {"coating": MIRROR, "mirror": True}
    first = Surface(
        "M1", z=400.0, radius=-3565.96, conic=8.11561, coefficients=(-2.70865e-11, 3.14594e-17, 4.06319e-24),
        outline=rectangle(424.0, 192.0, y=-397.0), **mirror,
    )  # fmt: skip
    second = Surface(
        "M2", radius=-2341.512, conic=4.2752, coefficients=(-5.45677e-10, -3.47241e-16),
        outline=rectangle(190.0, 95.0, y=-156.0), **mirror,
    )  # fmt: skip
    third = Surface(
        "M3", z=400.0, radius=927.696, coefficients=(-1.943596136597e-10, -8.22925e-16), semi_diameter=STOP_RADIUS,
        **mirror,
    )  # fmt: skip
    fourth = Surface(
        "M4", z=0.6192, radius=807.857, conic=-0.225786,
        coefficients=(7.93987e-11, 1.41338e-16, -5.15897e-23, 9.07704e-28),
        outline=rectangle(225.435, 140.0, y=140.0), **mirror,
    )  # fmt: skip
    rim_z = third.rim[1]
    return Prescription(
        name="Off-axis telescope of four mirrors, f = 500 mm",
        surfaces=tuple(placed(mirror, frame) for mirror in (first, second, third, fourth)),
        structures=(placed(Structure("M3_shade", SHADE_RADIUS, rim_z, STOP_RADIUS, rim_z, coating=BLACK), frame),),
        detector=placed(
            Detector(y=140.0, z=780.6188, half_width=120.0, half_height=120.0, pixels=(120, 120)), frame
        ),
        source=Source(radius=78.70653467873812, plane="axis", wavelength_nm=(550.0,)),
        provenance="US patent 8,011,793; see SOURCE.md.",
    )  # fmt: skip

"""Head-up display of a car that the sun shines into: a freeform mirror collects sunlight on the display."""

from __future__ import annotations

import math

from mistray.prescription import Coating, Detector, Prescription, Source, Surface, prism, rectangle

FOCUS_MM = 420.0  # from the middle of the mirror
INCIDENCE_DEG = 25.0  # on it, of the light of its design
BEFORE_FOCUS_MM = 60.0  # where the display stands
MIRROR_HALF, DISPLAY_HALF = (110.0, 60.0), (24.0, 16.0)
COVER_MM, COVER_GAP_MM = 1.1, 2.0
WINDSCREEN_MM, WINDSCREEN_DEG, WINDSCREEN_Z = 4.8, 60.0, -560.0
ORDER = 6
MIRROR, DISPLAY = Coating(R=0.95), Coating(R=0.05)

Polynomial = dict[tuple[int, int], float]


def coefficients() -> dict[str, float]:
    """
    Terms x^i y^j of the piece of a paraboloid that takes light at the incidence α to a focus at the distance L.

    In the frame of its middle, whose z is its normal, all paths to the focus are of one length: with c = cos α and
    s = sin α that is 4 L c z = -(x² + c² y²) + 2 s c y z - s² z². Put into its right side again and again, z as a
    polynomial gains an order each time.
    """
    c, s = math.cos(math.radians(INCIDENCE_DEG)), math.sin(math.radians(INCIDENCE_DEG))
    z: Polynomial = {}
    for _ in range(ORDER):
        terms = [({(2, 0): -1.0, (0, 2): -c * c}, 1.0), (_times({(0, 1): 2 * s * c}, z), 1.0), (_times(z, z), -s * s)]
        z = {}
        for polynomial, factor in terms:
            for place, value in polynomial.items():
                z[place] = z.get(place, 0.0) + factor * value / (4 * FOCUS_MM * c)
    return {f"xy_{i}_{j}": float(f"{value:.12g}") for (i, j), value in sorted(z.items()) if value}


def _times(a: Polynomial, b: Polynomial) -> Polynomial:
    found: Polynomial = {}
    for (i, j), p in a.items():
        for (k, m), q in b.items():
            if i + j + k + m <= ORDER:
                found[i + k, j + m] = found.get((i + k, j + m), 0.0) + p * q
    return found


def build() -> Prescription:
    """The light of the design travels along +z and meets the mirror at the origin."""
    angle = math.radians(2 * INCIDENCE_DEG)
    along, across = (math.sin(angle), -math.cos(angle)), (math.cos(angle), math.sin(angle))  # (y, z), from the mirror

    def place(distance: float, aside: float = 0.0) -> tuple[float, float]:
        y, z = (distance * a + aside * b for a, b in zip(along, across, strict=True))
        return round(y, 6), round(z, 6)

    display = FOCUS_MM - BEFORE_FOCUS_MM
    rear = display - COVER_GAP_MM
    half = DISPLAY_HALF[1] + 6.0
    cover = [place(rear, half), place(rear, -half), place(rear - COVER_MM, -half), place(rear - COVER_MM, half)]
    c, s = math.cos(math.radians(WINDSCREEN_DEG)), math.sin(math.radians(WINDSCREEN_DEG))
    # Up and forward, away from the light between mirror and display
    screen = [
        (round(u * c + w * s, 6), round(WINDSCREEN_Z - u * s + w * c, 6))
        for u, w in ((-320.0, 0.0), (320.0, 0.0), (320.0, WINDSCREEN_MM), (-320.0, WINDSCREEN_MM))
    ]
    y, z = place(display)
    turned = (2 * INCIDENCE_DEG - 180.0, 0.0, 0.0)
    mirror = Surface(
        "mirror", tilt_deg=(INCIDENCE_DEG, 0.0, 0.0), sag=coefficients(), outline=rectangle(*MIRROR_HALF),
        coating=MIRROR, mirror=True,
    )  # fmt: skip
    faces = (
        *prism("windscreen", screen, 400.0, material="N-BK7", faces=("outside", "top", "inside", "bottom")),
        *prism("cover", cover, 2 * DISPLAY_HALF[0] + 12.0, material="N-BK7", faces=("rear", "top", "front", "bottom")),
    )
    by_name = {face.name: face for face in faces} | {"mirror": mirror}
    order = ("windscreen_outside", "windscreen_inside", "mirror", "cover_front", "cover_rear")
    return Prescription(
        name="Head-up display in the sun",
        surfaces=tuple(by_name[name] for name in order),
        structures=tuple(face for face in faces if face.name not in order),
        detector=Detector(
            y=y, z=z, tilt_deg=turned, half_width=DISPLAY_HALF[0], half_height=DISPLAY_HALF[1], pixels=(96, 64),
            coating=DISPLAY,
        ),
        source=Source(half_width=90.0, half_height=50.0, plane="axis", wavelength_nm=(550.0,)),
        provenance="Invented; see SOURCE.md.",
    )  # fmt: skip

"""Cooke triplet, f = 50 mm, f/4, uncoated."""

from __future__ import annotations

from mistray.prescription import Detector, Prescription, Source, Structure, Surface, barrel, detector_frame

CROWN, FLINT = "N-LAK9", "N-SF5"
BACK_FOCUS_MM = 41.2365
# part, front radius, thickness, rear radius, gap behind, glass, clear radii; mm
LENSES = (
    ("L1", 23.713, 4.831, 7331.288, 5.86, CROWN, (10.009, 8.9482)),
    ("L2", -24.456, 0.975, 21.896, 4.822, FLINT, (4.7919, 4.7761)),
    ("L3", 86.759, 3.127, -20.4942, BACK_FOCUS_MM, CROWN, (8.0217, 8.3321)),
)


def build() -> Prescription:
    """Three air-spaced lenses in a black barrel that is open at the front only; the front of L2 is the stop."""
    surfaces = []
    z = 0.0
    for part, r_front, thickness, r_rear, gap, glass, (clear_front, clear_rear) in LENSES:
        front = Surface(f"{part}_front", z=z, radius=r_front, semi_diameter=clear_front, back=glass, part=part)
        z += thickness
        rear = Surface(f"{part}_rear", z=z, radius=r_rear, semi_diameter=clear_rear, front=glass, part=part)
        z += gap
        surfaces += [front, rear]
    detector = Detector(z=z, half_width=19.0, half_height=19.0, pixels=(380, 380))
    opening = surfaces[0].rim
    face = Structure("barrel_face", *opening, 15.0, opening[1], part="barrel", space=0)
    return Prescription(
        name="Cooke triplet, f = 50 mm, f/4",
        surfaces=tuple(surfaces),
        structures=(face, *barrel((*surfaces, detector)), *detector_frame(detector)),
        detector=detector,
        source=Source(radius=11.0, wavelength_nm=(587.5618,)),
        provenance="J. Sasian, Introduction to Lens Design; barrel invented, see SOURCE.md.",
    )

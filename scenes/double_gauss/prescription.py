"""Double Gauss of the patent US 2,673,491 (Tronnier), f = 50 mm, stopped down to f/4."""

from __future__ import annotations

from mistray.prescription import Detector, Prescription, Source, Stop, Structure, Surface, barrel, detector_frame

STOP_RADIUS_MM = 4.34
STOP_Z_MM = 16.885
IMAGE_Z_MM = 68.146
# name, part that begins here, vertex z, radius, clear radius, index behind; mm
SURFACES = (
    ("L1_front", "L1", 0.0, 29.475, 12.6, "1.67"),
    ("L1_rear", "L1", 3.76, 84.83, 12.6, "air"),
    ("L2_front", "L2", 3.88, 19.275, 11.5, "1.67"),
    ("L2_L3", "L3", 7.905, 40.77, 11.5, "1.699"),
    ("L3_rear", "L3", 11.18, 12.75, 9.0, "air"),
    ("L4_front", "L4", 21.385, -14.495, 8.5, "1.603"),
    ("L4_L5", "L5", 22.565, 40.77, 10.0, "1.658"),
    ("L5_rear", "L5", 28.63, -20.385, 10.0, "air"),
    ("L6_front", "L6", 28.82, 437.065, 10.0, "1.717"),
    ("L6_rear", "L6", 32.04, -39.73, 10.0, "air"),
)
REAR_GROUP = 5


def build() -> Prescription:
    """Six lenses, two of them cemented pairs, in a black barrel that is open at the front only; bare surfaces."""
    surfaces = []
    before = "air"
    for name, part, z, radius, clear, behind in SURFACES:
        surfaces.append(Surface(name, z=z, radius=radius, semi_diameter=clear, front=before, back=behind, part=part))
        before = behind
    stop = Stop(STOP_RADIUS_MM, STOP_Z_MM, STOP_Z_MM, outer_front=9.0, outer_rear=9.0)
    detector = Detector(z=IMAGE_Z_MM, half_width=20.5, half_height=20.5, pixels=(410, 410))
    opening = surfaces[0].rim
    face = Structure("barrel_face", *opening, 18.0, opening[1], part="barrel", space=0)
    tube = barrel((*surfaces[:REAR_GROUP], stop, *surfaces[REAR_GROUP:], detector))
    return Prescription(
        name="Double Gauss, f = 50 mm, f/4",
        surfaces=tuple(surfaces),
        structures=(face, *tube, *detector_frame(detector)),
        stop=stop,
        detector=detector,
        source=Source(radius=13.0, wavelength_nm=(587.5618,)),
        provenance="US patent 2,673,491 (Tronnier), scaled to f = 50 mm; barrel invented, see SOURCE.md.",
    )

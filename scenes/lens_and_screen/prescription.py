"""A dusty, polished lens and a black screen before a small detector: one scatter at each of the three."""

from __future__ import annotations

from mistray.prescription import (
    Coating,
    Detector,
    Prescription,
    Scatter,
    Source,
    Structure,
    Surface,
    detector_frame,
    lens_edge,
    wall,
)

GLASS = "N-BK7"
LENS_RADIUS, HOUSING_RADIUS, DETECTOR_Z = 10.0, 30.0, 62.6
SCREEN_TILT_DEG = 105.0

POLISH = Scatter("harvey_shack", {"rms_nm": 1.5, "l": 0.01, "s": -2.0}, name="polish")
DUST = Scatter("particulate", {"level": 300.0, "max_um": 100.0}, name="dust")
BLACK = Scatter("paint", {"reflectance": 0.04}, name="black")


def build() -> Prescription:
    """Coated lens, f = 61 mm, in a housing that absorbs all; inside, a tilted Lambertian screen on the +y side."""
    coating = Coating(R=0.005, T=0.995)
    front = Surface(
        "lens_front",
        radius=62.0,
        semi_diameter=LENS_RADIUS,
        back=GLASS,
        coating=coating,
        scatter=(POLISH, DUST),
        part="lens",
    )
    rear = Surface(
        "lens_rear",
        z=4.0,
        radius=-62.0,
        semi_diameter=LENS_RADIUS,
        front=GLASS,
        coating=coating,
        scatter=(POLISH,),
        part="lens",
    )
    screen = Surface(
        "screen",
        y=22.0,
        z=32.0,
        tilt_deg=(SCREEN_TILT_DEG, 0.0, 0.0),
        half_width=12.0,
        half_height=22.0,
        coating=Coating(R=0.0),
        scatter=(BLACK,),
    )
    detector = Detector(z=DETECTOR_Z, half_width=2.0, half_height=2.0, pixels=(40, 40))
    edge = lens_edge(front, rear)
    z_front = min(piece.z0 for piece in edge)
    face = Structure("housing_face", LENS_RADIUS, z_front, HOUSING_RADIUS, z_front, part="housing")
    tube = wall("housing_wall", [(HOUSING_RADIUS, z_front), (HOUSING_RADIUS, DETECTOR_Z)], part="housing")
    return Prescription(
        name="Lens and black screen before a small detector",
        surfaces=(front, rear),
        structures=(*edge, face, *tube, screen, *detector_frame(detector, HOUSING_RADIUS)),
        detector=detector,
        source=Source(radius=LENS_RADIUS, wavelength_nm=(550.0,)),
        provenance="Dimensions are free; see SOURCE.md.",
    )

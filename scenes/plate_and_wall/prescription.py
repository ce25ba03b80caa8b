"""A glass plate and a grey screen before a detector: one scatter at either."""

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
PLATE_RADIUS, PLATE_THICKNESS = 20.0, 3.0
HOUSING_RADIUS, DETECTOR_Z = 45.0, 60.0
SCREEN_TILT_DEG = 105.0

POLISH = Scatter("abg", {"A": 2.5e-4, "B": 1e-3, "g": 1.8}, name="polish")
GREY = Scatter("paint", {"reflectance": 0.2}, name="grey")


def build() -> Prescription:
    """Bare plate as the window of a black housing; inside, a tilted Lambertian screen on the +y side."""
    front = Surface("plate_front", semi_diameter=PLATE_RADIUS, back=GLASS, scatter=(POLISH,), part="plate")
    rear = Surface(
        "plate_rear", z=PLATE_THICKNESS, semi_diameter=PLATE_RADIUS, front=GLASS, scatter=(POLISH,), part="plate"
    )
    screen = Surface(
        "screen",
        y=30.0,
        z=30.0,
        tilt_deg=(SCREEN_TILT_DEG, 0.0, 0.0),
        half_width=15.0,
        half_height=28.0,
        coating=Coating(R=0.0),
        scatter=(GREY,),
    )
    detector = Detector(z=DETECTOR_Z, half_width=10.0, half_height=10.0, pixels=(100, 100))
    face = Structure("housing_face", PLATE_RADIUS, 0.0, HOUSING_RADIUS, 0.0, part="housing")
    tube = wall("housing_wall", [(HOUSING_RADIUS, 0.0), (HOUSING_RADIUS, DETECTOR_Z)], part="housing")
    return Prescription(
        name="Glass plate and grey screen before a detector",
        surfaces=(front, rear),
        structures=(*lens_edge(front, rear), face, *tube, screen, *detector_frame(detector, HOUSING_RADIUS)),
        detector=detector,
        source=Source(radius=PLATE_RADIUS, wavelength_nm=(550.0,)),
        provenance="Dimensions are free; see SOURCE.md.",
    )

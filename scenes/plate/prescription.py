"""A plane-parallel plate in a collimated beam: the closed form of multiple reflections."""

from __future__ import annotations

from mistray.prescription import Detector, Prescription, Source, Surface, lens_edge

INDEX = "1.5"
THICKNESS_MM = 5.0
SEMI_DIAMETER_MM = 50.0


def build() -> Prescription:
    """Uncoated plate, normal incidence, one detector behind it that takes all transmitted light."""
    front = Surface("plate_front", semi_diameter=SEMI_DIAMETER_MM, back=INDEX, part="plate")
    rear = Surface("plate_rear", z=THICKNESS_MM, semi_diameter=SEMI_DIAMETER_MM, front=INDEX, part="plate")
    return Prescription(
        name="Plane-parallel plate, n = 1.5, uncoated",
        surfaces=(front, rear),
        structures=lens_edge(front, rear),
        detector=Detector(z=20.0, half_width=10.0, half_height=10.0, pixels=(64, 64)),
        source=Source(radius=5.0, wavelength_nm=(550.0,)),
        provenance="Dimensions are free; see SOURCE.md.",
    )

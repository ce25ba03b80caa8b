"""Singlet of least spherical aberration and a plane window whose ghost the lens brings to a focus on the detector."""

from __future__ import annotations

from mistray.prescription import Coating, Detector, Prescription, Source, Surface, barrel, detector_frame

GLASS = "N-BK7"
SEMI_DIAMETER_MM = 12.5


def build() -> Prescription:
    """Lens f = 100 mm at f/6.25, window 59 mm behind it, detector (R = 20 %) in the best focus."""
    surfaces = (
        Surface("L1_front", radius=60.6, semi_diameter=SEMI_DIAMETER_MM, back=GLASS, part="L1"),
        Surface("L1_rear", z=4.0, radius=-343.4, semi_diameter=SEMI_DIAMETER_MM, front=GLASS, part="L1"),
        Surface("window_front", z=63.0, semi_diameter=SEMI_DIAMETER_MM, back=GLASS, part="window"),
        Surface("window_rear", z=65.0, semi_diameter=SEMI_DIAMETER_MM, front=GLASS, part="window"),
    )
    detector = Detector(z=102.0, half_width=5.0, half_height=5.0, coating=Coating(R=0.2), pixels=(500, 500))
    return Prescription(
        name="Lens of best form and window",
        surfaces=surfaces,
        structures=(*barrel((*surfaces, detector)), *detector_frame(detector)),
        detector=detector,
        source=Source(radius=8.0, wavelength_nm=(587.5618,)),
        provenance="Dimensions are free; see SOURCE.md.",
    )

"""Biconvex singlet, plane window and reflecting detector: ten two-reflection ghosts in closed form."""

from __future__ import annotations

from mistray.prescription import Coating, Detector, Prescription, Source, Surface, barrel, detector_frame

GLASS = "1.5168"
BFL_MM = 14.599477266251874


def build() -> Prescription:
    """Lens R = ±100 mm, window and detector (R = 20 %) at the paraxial focus, beam radius 10 mm."""
    surfaces = (
        Surface("L1_front", radius=100.0, semi_diameter=20.0, back=GLASS, part="L1"),
        Surface("L1_rear", z=5.0, radius=-100.0, semi_diameter=20.0, front=GLASS, part="L1"),
        Surface("window_front", z=85.0, semi_diameter=60.0, back=GLASS, part="window"),
        Surface("window_rear", z=87.0, semi_diameter=60.0, front=GLASS, part="window"),
    )
    detector = Detector(z=87.0 + BFL_MM, half_width=60.0, half_height=60.0, coating=Coating(R=0.2), pixels=(240, 240))
    return Prescription(
        name="Biconvex singlet, window, detector",
        surfaces=surfaces,
        structures=(*barrel((*surfaces, detector)), *detector_frame(detector)),
        detector=detector,
        source=Source(radius=10.0, wavelength_nm=(587.5618,)),
        provenance="Dimensions of tests/data/ghost_lens_window_det.csv; see SOURCE.md.",
    )

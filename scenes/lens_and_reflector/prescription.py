"""Grid source, lens, reflector, target: the ray-sorting example of a TracePro webinar."""

from __future__ import annotations

from mistray.prescription import Coating, Detector, Prescription, Source, Surface, lens_edge

GLASS = "N-BK7"


def build() -> Prescription:
    """Uncoated N-BK7 lens; a flat reflector at 45 degrees sends the light to +y onto a small target."""
    front = Surface("lens_front", radius=103.0, semi_diameter=15.0, back=GLASS, part="lens")
    rear = Surface("lens_rear", z=6.0, radius=-103.0, semi_diameter=15.0, front=GLASS, part="lens")
    reflector = Surface(
        "reflector",
        z=60.0,
        tilt_deg=(45.0, 0.0, 0.0),
        half_width=20.0,
        half_height=28.0,
        coating=Coating(R=0.87),
        mirror=True,
    )
    return Prescription(
        name="Grid source, lens, reflector, target",
        surfaces=(front, rear, reflector),
        structures=lens_edge(front, rear),
        detector=Detector(
            "target", y=35.0, z=60.0, tilt_deg=(-90.0, 0.0, 0.0), half_width=10.0, half_height=10.0, pixels=(200, 200)
        ),
        source=Source(radius=10.0, wavelength_nm=(546.1,), pattern="grid"),
        provenance="After the ray-sorting slide of a TracePro webinar; dimensions are invented, see SOURCE.md.",
    )

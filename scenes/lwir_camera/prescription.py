"""Cooled camera for 8 to 12 µm: three lenses, a dewar window, the cold stop and the detector."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mistray.prescription import Coating, Prescription, Surface, from_zemax

ON_GERMANIUM = Coating(preset="bbar4_lwir", name="bbar4_lwir")
# The preset as it is fitted to ZnSe, where mistray puts it on by name
ON_SELENIDE = Coating(layers="1.40 1798.45, 2.20 1654.32, 4.00 81.92, 2.20 568.81", name="bbar4_lwir_ZnSe")


def build() -> Prescription:
    """The lens of ``lens.zmx``, coated; import makes walls and the cold shield from its stop and apertures."""
    bare = from_zemax(Path(__file__).with_name("lens.zmx"))
    assert bare.detector is not None
    return replace(
        bare,
        surfaces=tuple(_coated(surface) for surface in bare.surfaces),
        detector=replace(bare.detector, coating=Coating(R=0.05), pixels=(640, 512)),
    )


def _coated(surface: Surface) -> Surface:
    return replace(surface, coating=ON_GERMANIUM if "Ge" in (surface.front, surface.back) else ON_SELENIDE)

"""Newtonian telescope with rough, dusty mirrors and black walls."""

from __future__ import annotations

from dataclasses import replace

from mistray.prescription import Coating, Prescription, Scatter, Structure, Surface
from mistray.scenes.newtonian.prescription import build as build_telescope

MATT = Coating(R=0.0)
ROUGHNESS = Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5}, name="polish_2nm")
DUST = Scatter("particulate", {"level": 400.0}, name="particles_400")
PAINT = Scatter("paint", {"reflectance": 0.1}, name="black_paint")
PAINT_INSIDE = Scatter("paint", {"reflectance": 0.1, "side": "front"}, name="black_paint_inside")


def build() -> Prescription:
    """The telescope of `mistray.scenes.newtonian`; its walls scatter the 10 % that they reflect there."""
    telescope = build_telescope()
    return replace(
        telescope,
        name=f"{telescope.name}, with scatter",
        surfaces=tuple(replace(mirror, scatter=(ROUGHNESS, DUST)) for mirror in telescope.surfaces),
        structures=tuple(_painted(shape) for shape in telescope.structures),
        provenance="The scene newtonian and its scatter; see SOURCE.md.",
    )


def _painted(shape: Structure | Surface) -> Structure | Surface:
    """With the paint; on the main tube on its inside only."""
    return replace(shape, coating=MATT, scatter=(PAINT_INSIDE if shape.part == "tube" else PAINT,))

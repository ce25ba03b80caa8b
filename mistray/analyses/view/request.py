"""Requests for the 3-D view: the light traced for it, and the picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mistray.light import Light
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, PLACE_MM, RAYS, Each, Range, Words
from mistray.toolkit.drawings.ray_choice import RayChoice
from mistray.toolkit.fields import FieldSubset, Request, field

WHOLE = "none"


@dataclass(frozen=True)
class CutAzimuth(Range):
    """Condition that a value is the azimuth of a cut, degrees about z from x, or "none" for no cut."""

    also = ({"const": WHOLE},)

    def check(self, name: str, value: Any, owner: str = "") -> float | None:
        """Return the azimuth, degrees, or None for no cut; raise `MistrayError` if it is out of range."""
        return None if isinstance(value, str) and value == WHOLE else super().check(name, value, owner)

    def __call__(self, text: str) -> Any:
        """Return the value of a command-line text: an azimuth, degrees, or "none"."""
        return WHOLE if text == WHOLE else super().__call__(text)


@dataclass(frozen=True)
class ViewTraces(Request):
    """Traces whose light `mistray view` shows: field angles, spectrum and number of start rays."""

    field_deg: tuple[float, ...] | None = field(Each(FIELD_DEG), None, "field angles, degrees; rays of each are drawn")
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("azimuth_deg", "wavelength_nm", "weights")), None, "light of the traces"
    )
    rays: int = field(RAYS, 20_000, "start rays, whatever the scene says")


@dataclass(frozen=True)
class ViewRequest(RayChoice):
    """Picture of a scene in three dimensions: drawn rays, colours of surfaces, and cut."""

    colour: str | None = field(
        Words(("flux", "absorbed", "irradiance", "role")),
        None,
        "colours of surfaces: by the flux that reaches them, by what they absorb of it, by place where the trace has "
        "surface maps, or by what they are. The default is place with these, else flux, without a trace role",
    )
    cut_deg: float | None = field(
        CutAzimuth(AZIMUTH_DEG.low, AZIMUTH_DEG.high, unit=AZIMUTH_DEG.unit),
        180.0,
        "azimuth of the half that is taken away, degrees about z from x: 180 takes x < 0, 90 takes y > 0; none: the "
        "whole scene is shown",
    )
    cut_mm: float = field(PLACE_MM, 0.0, "distance of the cut from the z axis along that direction, mm")

"""Requests for the search for objects: light from outside, view of the detector, rays, and table lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import AZIMUTH_DEG, CONE_DEG, FIELD_DEG, FLAG, PART, PLACE_MM, RAYS, ROWS, TEXT, WAVELENGTH_NM, Each
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field, field_of


@dataclass(frozen=True, kw_only=True)
class ObjectsRequest(Request):
    """Light from outside, view of the detector and rays of a search for objects."""

    rays: int | None = field(
        RAYS,
        None,
        "start rays from the detector, and from outside at each angle; without it as the scene says, else 1e6",
    )
    half_angle_deg: float | None = field(
        CONE_DEG, None, "light comes from everywhere within this angle of the axis, degrees; without it 20"
    )
    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG), None, "field angles of a distant source instead, degrees"
    )
    azimuth_deg: float = field(
        AZIMUTH_DEG, 0.0, "azimuth of the distant source, degrees, from +y to -x", needs="field_deg"
    )
    disc_mm: tuple[float, float] | None = field(
        Each(PLACE_MM, count=2),
        None,
        "z and radius of a Lambertian disc across the z axis instead, mm; its cone has that half angle",
        option="--disc",
        metavar=("Z", "RADIUS"),
    )
    view_half_angle_deg: float = field(
        CONE_DEG, 90.0, "rays leave the detector within this angle of its normal, degrees"
    )
    wavelength_nm: float | None = field(
        WAVELENGTH_NM, None, "wavelength, nm; without it the first of the scene's source"
    )
    light: Mapping[str, Any] = field(FieldSubset(Light, ("detector",)), None, "where light is recorded")
    stop: str | None = field(
        TEXT, None, "part or shape that is the aperture stop; without it what ends the beam on the axis"
    )
    threshold: float = field(
        PART, 1e-6, "flux that an object must get to count, W for each W that starts; one ray is 1/rays", metavar="W"
    )
    ray_control: str = field_of(Settings, "ray_control", "transmit_specular")
    total_reflection: bool = field(FLAG, True, "follow rays in total reflection")
    settings: Mapping[str, Any] = field(FieldSubset(Settings, ("max_events", "seed")), None, "settings of the trace")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.field_deg is not None:
            refuse_second(self, "field_deg", "half_angle_deg", "disc_mm")


def refuse_second(request: ObjectsRequest, given: str, *others: str) -> None:
    """Raise `MistrayError` if a request has any of the light sources `others` besides the one named `given`."""
    for name in others:
        if getattr(request, name) is not None:
            raise MistrayError(f"{name} and {given} are given, two kinds of source; give one of them")


@dataclass(frozen=True)
class ObjectsTables(Request):
    """Number of rows in the printed tables of objects."""

    rows: int = field(ROWS, 25, "rows of each table")

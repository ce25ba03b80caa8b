"""Requests for the analysis of image quality: its arguments, and those of its tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import FIELD_DEG, FREQUENCY_PER_MM, PLACE_MM, PUPIL_CELLS, TEXT, Each, Range
from mistray.toolkit.fields import FieldSubset, Request, field

RADIUS_MM = Range(-math.inf, math.inf, unit="mm")


@dataclass(frozen=True)
class ImageRequest(Request):
    """Fields, light, stop and grid of an analysis of image quality."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG),
        None,
        "field angles, degrees; those of a near object are seen from the origin of its frame; without them the axis",
    )
    _: KW_ONLY
    field_mm: tuple[float, ...] | None = field(
        Each(PLACE_MM), None, "object heights of a near source instead, mm", metavar="MM"
    )
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("azimuth_deg", "wavelength_nm", "weights", "detector")), None, "light of the image"
    )
    stop: str | None = field(
        TEXT, None, "surface that limits the light; without it that at which most light next to the pupil ends",
        metavar="ID",
    )  # fmt: skip
    grid: int | None = field(
        PUPIL_CELLS, None, "cells across the pupil; without it 64, or as many as the wavefront asks for, up to 512"
    )
    reference_radius_mm: float | None = field(
        RADIUS_MM,
        None,
        "radius of the reference sphere, mm, inf for a plane; without it the distance of the exit pupil",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.field_mm is not None and self.field_deg is not None:
            raise MistrayError("field_deg and field_mm are given; give one of them")
        if self.reference_radius_mm == 0:
            raise MistrayError("reference_radius_mm is 0; give a radius, or inf for a plane")


@dataclass(frozen=True)
class ImageTables(Request):
    """Contents of the tables and pages of image quality: frequencies of the MTF, 1/mm."""

    frequencies: tuple[float, ...] | None = field(
        Each(FREQUENCY_PER_MM),
        None,
        "frequencies of the MTF in tables, 1/mm; without them three below the cut-off",
    )

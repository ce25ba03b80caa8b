"""Requests for transfer functions: of images of points with their stray light, and of single surfaces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, MISSING, dataclass
from itertools import pairwise
from typing import Any

from mistray.analyses.image.request import ImageRequest
from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import (
    FLAG,
    NOT_NEGATIVE,
    POSITIVE,
    RADIUS_MM,
    SHARE,
    WAVELENGTH_NM,
    Demand,
    Each,
    Range,
    Words,
)
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field, field_of

COSINE = Range(0.0, 1.0, above=True)


class Curve(Demand):
    """Condition that a value is a curve: two sequences of numbers, abscissae and values."""

    demand = "must be two sequences of numbers, places and values"
    also = ({"type": "array", "items": {"type": "array", "items": {"type": "number"}}, "minItems": 2, "maxItems": 2},)

    def check(self, name: str, value: Any, owner: str = "") -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return both sequences as tuples; raise `MistrayError` if they are not two sequences of numbers."""
        try:
            places, values = (tuple(float(number) for number in column) for column in value)
        except (TypeError, ValueError):
            raise MistrayError(f"{name} is {value!r}; it {self.demand}") from None
        return places, values


@dataclass(frozen=True)
class TransferRequest(Request):
    """Request for images of points with their stray light: fields, light, detector and frequencies."""

    field_deg: tuple[float, ...] | None = field_of(ImageRequest, "field_deg", None)
    _: KW_ONLY
    field_mm: tuple[float, ...] | None = field_of(ImageRequest, "field_mm", None)
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("azimuth_deg", "wavelength_nm", "weights", "detector")), None, "light of the image"
    )
    frequencies_per_mm: tuple[float, ...] | None = field(
        Each(NOT_NEGATIVE),
        None,
        "frequencies of the transfer functions, 1/mm, ascending; without them from the inverse of the detector's size "
        "to the cut-off of diffraction",
    )
    pixel_mm: tuple[float, ...] | None = field(
        Each(POSITIVE),
        None,
        "side of a pixel, or its sides along x and y, mm, see `PixelResponse`; without it the detector resolves "
        "everything",
    )
    diffusion_mm: float | None = field(RADIUS_MM, None, "standard deviation of the diffusion of charge, mm")
    detector_table: tuple[tuple[float, ...], tuple[float, ...]] | None = field(
        Curve(), None, "measured transfer function of the detector: frequencies, 1/mm, and values"
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings), None, "settings of the traces")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frequencies_per_mm and any(b <= a for a, b in pairwise(self.frequencies_per_mm)):
            raise MistrayError(f"frequencies_per_mm are {list(self.frequencies_per_mm)}; sort them, each once")


@dataclass(frozen=True)
class SurfaceTransferRequest(Request):
    """
    Request for a surface transfer function: light at a rough surface.

    The wavelength is in nm, in vacuum; `n_in` is the index on the side that the light comes from.
    """

    wavelength_nm: float = field(WAVELENGTH_NM, MISSING, "vacuum wavelength, nm")
    event: str = field(Words(("reflection", "transmission")), "reflection", "event whose light makes the image")
    n_in: float = field(POSITIVE, 1.0, "index on the side of incidence")
    n_out: float = field(POSITIVE, 1.0, "index on the other side")
    cos_i: float = field(COSINE, 1.0, "cosine of the angle of incidence")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.event == "transmission" and self.n_in * math.sqrt(1 - self.cos_i**2) >= self.n_out:
            raise MistrayError(
                f"cos_i is {self.cos_i:g}: light is totally reflected from index {self.n_in:g} to {self.n_out:g}; use "
                "event 'reflection'"
            )


@dataclass(frozen=True)
class BsdfTransferRequest(SurfaceTransferRequest):
    """Request for a surface transfer function from a BSDF: light at a surface with scatter models and coating."""

    share: float = field(
        SHARE, 1.0, "R or T of the coating, with which models relative to the incident light are compared"
    )
    from_front: bool = field(FLAG, True, "whether light comes from the front")

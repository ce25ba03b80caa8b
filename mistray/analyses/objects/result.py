"""Result of the search for objects."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.objects.estimates import product_estimates
from mistray.analyses.objects.rows import LISTS, CommonObject, ScatterEstimate, SceneObject, StraightShot
from mistray.analyses.objects.traced import Traced
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.notes import Note
from mistray.toolkit.rows import frame

if TYPE_CHECKING:
    import mitsuba as mi
    import pandas as pd


@dataclass(frozen=True, eq=False, kw_only=True)
class Objects:
    """
    Result of `objects`.

    Attributes
    ----------
    scene : mi.Scene
    critical : list of SceneObject
        Objects that the detector sees, the strongest first, optics left out.
    illuminated : list of SceneObject
        Objects that light from outside reaches; of several source angles the mean.
    common : list of CommonObject
        Objects in both lists, in the order of the light: by the gap of the design path in which the detector sees them,
        then by flux. Places that are lit and places that are seen overlap.
    apart : list of CommonObject
        Objects in both lists that are lit in one place and seen in another.
    optics : list of CommonObject
        The surfaces of the design path, in its order: common by design. What was not met has 0 rays.
    straight_shots : list of StraightShot
        Views of the outside past the optics, the strongest first.
    field_deg : tuple of float
        Source angles; empty where the source is a cone or a disc.
    traced : Traced
        Views that the lists come from.
    facts : dict
        How it was computed, plain values.
    notes : list of Note
        Notes on what a reader must know before trusting the lists; empty if all is well.
    """

    scene: mi.Scene
    critical: list[SceneObject]
    illuminated: list[SceneObject]
    common: list[CommonObject]
    apart: list[CommonObject]
    optics: list[CommonObject]
    straight_shots: list[StraightShot]
    field_deg: tuple[float, ...]
    traced: Traced
    facts: dict[str, Any]
    notes: list[Note]

    @property
    def stop(self) -> str:
        """Part that is the aperture stop; "" where there is none that the rays could tell."""
        found = self.traced.places.stop
        return found.part if found is not None else ""

    @property
    def source_text(self) -> str:
        """The source of the light in words."""
        if self.field_deg:
            angles = ", ".join(f"{angle:g}" for angle in self.field_deg)
            return f"a distant source at {angles}°{' each' if len(self.field_deg) > 1 else ''}"
        return str(self.facts["source"])

    @functools.cached_property
    def products(self) -> list[ScatterEstimate]:
        """Light by one scatter event at each common object and each optic, at each source angle the strongest first."""
        wanted = [*self.common, *(row for row in self.optics if row.id != self.facts["detector"])]
        angles: Sequence[float] = self.field_deg or [np.nan]
        return product_estimates(self.traced, angles, wanted)

    def estimates(self) -> pd.DataFrame:
        """Return `products` with a row for each, and the columns of `ScatterEstimate`."""
        return frame(ScatterEstimate, self.products)

    def illumination(self, id: str, side: str = "front") -> list[Estimate]:
        """Flux on an object for 1 W/mm² across the beam, W, at each source angle (or for the whole source)."""
        numbers = self.traced.numbers
        number = numbers.get((id, side), numbers.get((id, "both")))
        if number is None:
            raise MistrayError(f"'{id}' has no side '{side}', or there is no such shape; see Objects.illuminated")
        return [Estimate(*view.area(number)) for view in self.traced.illuminated]

    def to_pandas(self, which: str = "common") -> pd.DataFrame:
        """One of the lists, such as "critical" or "common", as a DataFrame with a column for each attribute."""
        if which not in LISTS:
            raise MistrayError(f"to_pandas: there is no list '{which}'; use {', '.join(LISTS)}")
        return frame(LISTS[which], getattr(self, which))

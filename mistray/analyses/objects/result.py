"""Result of the search for critical, illuminated and common objects."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.objects.estimates import product_estimates
from mistray.analyses.objects.patches import meet
from mistray.analyses.objects.places import Places
from mistray.analyses.objects.rows import LISTS, CommonObject, ScatterEstimate, SceneObject, StraightShot
from mistray.analyses.objects.view import SIDES, RayView
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.messages import Message, fewer_rays
from mistray.notes import Note
from mistray.result import KeyNumber, Result
from mistray.settings import RAY_CONTROLS
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.thin_gaps import thin_gaps
from mistray.toolkit.rows import frame
from mistray.trace.host.ray_sources import DetectorView

if TYPE_CHECKING:
    import mitsuba as mi
    import pandas as pd

SHOTS_TOLD = 4  # ways past the optics that a warning names


@dataclass(frozen=True, eq=False, repr=False)
class Objects(Result, table=".page:main_table", figure=".figures:objects_layout"):
    """
    Result of `objects`: surfaces that the detector sees, surfaces that light from outside reaches, and both.

    Attributes
    ----------
    scene : mi.Scene
        Loaded scene.
    table : SurfaceTable
        Surfaces of the scene for computations on the host.
    places : Places
        Gaps of the design path, and the aperture stop.
    detector : DetectorView
        Detector as the source of backward rays.
    seen : RayView
        Objects that rays from the detector meet, and their flux.
    lit : list of RayView
        Objects that rays from each source angle, or from the cone or disc, meet, and their flux.
    field_deg : tuple of float
        Source angles, degrees; empty where the source is a cone or a disc.
    facts : dict
        Settings and facts of the computation, as plain values.
    unpolarized : list of Note
        Notes on paths that Stokes vectors would change.

    Examples
    --------
    >>> found = mistray.objects(mistray.load("cassegrain"), rays=2000)
    >>> found.stop, len(found.critical), len(found.illuminated)
    ('secondary', 7, 20)
    >>> table = found.to_pandas("common")
    """

    scene: mi.Scene
    table: SurfaceTable
    places: Places
    detector: DetectorView
    seen: RayView
    lit: list[RayView]
    field_deg: tuple[float, ...]
    facts: dict[str, Any]
    unpolarized: list[Note]

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return numbers of critical, illuminated and common objects, and the name of the aperture stop, by label."""
        counts = {name: len(getattr(self, name)) for name in ("critical", "illuminated", "common")}
        return {**counts, "stop": self.stop or "not found"}

    @functools.cached_property
    def critical(self) -> list[SceneObject]:
        """Critical objects: surfaces that the detector sees above the threshold, without optics, strongest first."""
        return self._strongest(0)

    @functools.cached_property
    def illuminated(self) -> list[SceneObject]:
        """
        Illuminated objects: surfaces that light from outside reaches above the threshold, without optics.

        They are in the order of their mean flux over the source angles, the strongest first.
        """
        return self._strongest(1)

    def _strongest(self, which: int) -> list[SceneObject]:
        rows = self._rows[which].values()
        counting = (row for row in rows if not row.optic and row.power > self.facts["threshold"])
        return sorted(counting, key=lambda row: -row.power)

    @functools.cached_property
    def common(self) -> list[CommonObject]:
        """
        Common objects: those in both lists whose lit and seen places overlap.

        They are in the order of the light: by the gap of the design path in which the detector sees them, then by flux.
        """
        return [self._both(number) for number, meets in self._meeting.items() if meets]

    @functools.cached_property
    def apart(self) -> list[CommonObject]:
        """Objects that are critical and illuminated, but lit in one place and seen in another."""
        return [self._both(number) for number, meets in self._meeting.items() if not meets]

    @functools.cached_property
    def optics(self) -> list[CommonObject]:
        """
        Surfaces of the design path in its order, common by design; surfaces not met have 0 rays.

        The list is empty without a design path.
        """
        steps = self.places.path.steps if self.places.path is not None else ()
        met = (SIDES * step.surface + (self._opaque(step.surface) and not step.from_front) for step in steps)
        return [self._both(number) for number in dict.fromkeys(met)]

    def _both(self, number: int) -> CommonObject:
        return CommonObject.of(*(rows[number] for rows in self._rows))

    @functools.cached_property
    def _meeting(self) -> dict[int, bool]:
        """Whether lit and seen areas overlap (True or False), by index of each critical and illuminated object."""
        (seen, lit), threshold = self._rows, self.facts["threshold"]
        found = [k for k, row in seen.items() if not row.optic and min(row.power, lit[k].power) > threshold]
        found.sort(key=lambda k: (_gap(k, [self.seen]), -seen[k].power * lit[k].power))
        return {k: any(self._meet(k, view) for view in self.lit) for k in found}

    def _meet(self, number: int, view: RayView) -> bool:
        lit, seen = view.samples(number), self.seen.samples(number)
        return meet(self.table, number // SIDES, lit.point, seen.point)

    @functools.cached_property
    def numbers(self) -> dict[tuple[str, str], int]:
        """
        Index of each object in the arrays of `RayView`, by id and side.

        Both sides of a transmitting surface are one object.
        """
        return {
            (name, side): SIDES * surface + back
            for surface, name in enumerate(self.table.ids)
            for back, side in enumerate(("front", "back") if self._opaque(surface) else ("both",))
        }

    def _opaque(self, surface: int) -> bool:
        return bool(self.table.optics.host_words[surface] & OPAQUE)

    @functools.cached_property
    def _rows(self) -> tuple[dict[int, SceneObject], dict[int, SceneObject]]:
        """Rows of all objects by their index: first as seen by the detector, then as lit from outside."""
        seen, lit = (
            {number: self._row(name, side, number, views) for (name, side), number in self.numbers.items()}
            for views in ([self.seen], self.lit)
        )
        return seen, lit

    def _row(self, name: str, side: str, number: int, views: Sequence[RayView]) -> SceneObject:
        places, surface, gap = self.places, number // SIDES, _gap(number, views)
        part = self.table.parts[surface]
        rays = int(sum(view.hits[number] for view in views))
        along = np.array([view.along[number] for view in views])
        known = along[np.isfinite(along)]
        powers = [view.power(number) for view in views]
        return SceneObject(
            id=name,
            part=part,
            side=side,
            space=self.table.spaces[surface],
            between=places.between(gap) if rays else "",
            stop=places.against_stop(part, gap, float(known.mean()) if known.size else np.nan) if rays else "",
            optic=bool(places.optics[surface]),
            rays=rays,
            power=float(np.mean([power for power, _ in powers])),
            power_se=float(np.sqrt(sum(se**2 for _, se in powers)) / len(views)),
        )

    @functools.cached_property
    def straight_shots(self) -> list[StraightShot]:
        """Straight shots: paths past the optics by which the detector sees the outside, the strongest first."""
        ids, path = self.table.ids, self.places.path
        design = [step.surface for step in path.steps[:-1]] if path is not None else []
        found = []
        for way in self.seen.ways_out():
            order = way.surfaces[::-1]
            if not way.turned and not (design and list(order) == design):
                missed = tuple(ids[s] for s in design if s not in order)
                beside = tuple(ids[s] for s in order if s not in design)
                found.append(
                    StraightShot(
                        way=_in_words(missed, beside) if order else "with no surface in between",
                        surfaces=tuple(ids[s] for s in order),
                        missed=missed,
                        beside=beside,
                        rays=way.rays,
                        share=way.share,
                        share_se=way.share_se,
                        field_deg=way.field_deg,
                    )
                )
        return found

    @property
    def stop(self) -> str:
        """Part that is the aperture stop, or "" if it is unknown."""
        return self.places.stop.part if self.places.stop is not None else ""

    @property
    def source_text(self) -> str:
        """Description of the light source in words."""
        if self.field_deg:
            angles = ", ".join(f"{angle:g}" for angle in self.field_deg)
            return f"a distant source at {angles}°{' each' if len(self.field_deg) > 1 else ''}"
        return str(self.facts["source"])

    @property
    def notes(self) -> list[Note]:
        """Notes on how reliable the lists are; empty if there is nothing to note."""
        found = [Message.NO_OPTICS.note()] if self.places.path is None else []
        threshold, rays, planned = (self.facts[name] for name in ("threshold", "rays", "rays_planned"))
        shots = [shot for shot in self.straight_shots if shot.share > threshold]
        for shot in shots[:SHOTS_TOLD]:
            low, high = shot.field_deg
            found.append(Message.OUTSIDE_SEEN.note(way=shot.way, share=shot.share, low=low, high=high))
        if len(shots) > SHOTS_TOLD:
            found.append(Message.MORE_OUTSIDE.note(count=len(shots) - SHOTS_TOLD))
        control = self.facts["ray_control"]
        if not self.seen.ways_out() and "T" in RAY_CONTROLS.get(control, control):
            found.append(Message.CLOSED_IN.note())
        if rays < planned:
            found.append(fewer_rays(rays, planned))
        lost = max(view.lost for view in (self.seen, *self.lit))
        unseen = [Message.VIEW_LOST.note(share=lost)] if lost > threshold else []
        return [*found, *thin_gaps(self.table), *unseen, *self.unpolarized]

    @functools.cached_property
    def products(self) -> list[ScatterEstimate]:
        """
        Estimated flux on the detector, W for 1 W/mm² across the beam, by one scatter event at each common object.

        Optics other than the detector are included. The strongest is first at each angle.
        """
        wanted = [*self.common, *(row for row in self.optics if row.id != self.facts["detector"])]
        seen = {self.numbers[row.id, row.side]: row for row in wanted}
        views = zip(self.field_deg or [np.nan], self.lit, strict=True)
        return product_estimates(self.table, self.detector, self.seen, views, seen)

    def estimates(self) -> pd.DataFrame:
        """Return `products` with a row for each, and the columns of `ScatterEstimate`."""
        return frame(ScatterEstimate, self.products)

    def illumination(self, id: str, side: str = "front") -> list[Estimate]:
        """
        Return the flux on an object for 1 W/mm² across the beam, W, at each source angle or for the whole source.

        Raises
        ------
        MistrayError
            If no object has this id and side.
        """
        known = self.numbers.get((id, "both")) if side in ("front", "back") else None
        number = self.numbers.get((id, side), known)
        if number is None:
            raise MistrayError(f"'{id}' has no side '{side}', or there is no such shape; see Objects.illuminated")
        return [Estimate(*view.area(number)) for view in self.lit]

    def to_pandas(self, which: str = "common") -> pd.DataFrame:
        """
        Return the list called `which`, such as "critical" or "common", as a frame with a column for each attribute.

        Powers are fractions of the launched flux.

        Raises
        ------
        MistrayError
            If there is no such list.
        """
        if which not in LISTS:
            raise MistrayError(f"to_pandas: there is no list '{which}'; use {', '.join(LISTS)}")
        return frame(LISTS[which], getattr(self, which))


def _in_words(missed: Sequence[str], beside: Sequence[str]) -> str:
    past = f"past {', '.join(missed)}" if missed else ""
    through = f"through {', '.join(beside)}" if beside else ""
    return " ".join(text for text in (past, through) if text) or "through the optics in another order"


def _gap(number: int, views: Sequence[RayView]) -> int:
    """Return the index of the gap between design surfaces in which most rays meet an object."""
    return int(np.argmax(np.sum([view.in_gap[number] for view in views], axis=0)))

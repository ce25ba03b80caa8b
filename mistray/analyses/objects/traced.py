"""What the views of the detector and of the source say of each object of a scene."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mistray.analyses.objects.patches import meet
from mistray.analyses.objects.places import Places
from mistray.analyses.objects.rows import SceneObject, StraightShot
from mistray.analyses.objects.view import SIDES, RayView
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.ray_sources import DetectorView


@dataclass(frozen=True, eq=False)
class Traced:
    """
    Views of a search, with the table and the places that they were made with.

    Objects have the numbers of `RayView`; a surface that transmits is one object for both of its sides.
    """

    table: SurfaceTable
    places: Places
    detector: DetectorView
    critical: RayView
    illuminated: list[RayView]

    @functools.cached_property
    def numbers(self) -> dict[tuple[str, str], int]:
        """Numbers of all objects by id and side."""
        table = self.table
        return {
            (table.ids[surface], side): SIDES * surface + back
            for surface in range(table.count)
            for back, side in enumerate(("front", "back") if self._opaque(surface) else ("both",))
        }

    def _opaque(self, surface: int) -> bool:
        return bool(self.table.optics.host_words[surface] & OPAQUE)

    @property
    def design_objects(self) -> list[int]:
        """Objects of the design path, in its order."""
        path = self.places.path
        steps = path.steps if path is not None else ()
        met = (SIDES * step.surface + (self._opaque(step.surface) and not step.from_front) for step in steps)
        return list(dict.fromkeys(met))

    def rows(self, views: Sequence[RayView]) -> dict[int, SceneObject]:
        """Rows of all objects by number, as views see them; of several the mean."""
        return {number: self._row(id, side, number, views) for (id, side), number in self.numbers.items()}

    def _row(self, id: str, side: str, number: int, views: Sequence[RayView]) -> SceneObject:
        table, places, surface = self.table, self.places, number // SIDES
        gap = gap_of(number, views)
        met = any(view.hits[number] for view in views)
        along = np.array([view.along[number] for view in views])
        known = along[np.isfinite(along)]
        powers = [view.power(number) for view in views]
        part = table.parts[surface]
        return SceneObject(
            id=id,
            part=part,
            side=side,
            space=table.spaces[surface],
            between=places.between(gap) if met else "",
            stop=places.against_stop(part, gap, float(known.mean()) if known.size else np.nan) if met else "",
            optic=bool(places.optics[surface]),
            rays=int(sum(view.hits[number] for view in views)),
            power=float(np.mean([power for power, _ in powers])),
            power_se=float(np.sqrt(sum(se**2 for _, se in powers)) / len(views)),
        )

    def meets(self, number: int) -> bool:
        """Whether places of an object that are lit and places that are seen overlap."""
        seen = self.critical.samples(number).point
        lit = (view.samples(number).point for view in self.illuminated)
        return any(meet(self.table, number // SIDES, points, seen) for points in lit)

    def straight_shots(self) -> list[StraightShot]:
        """Views of the outside past the optics, the strongest first."""
        ids, path = self.table.ids, self.places.path
        design = [step.surface for step in path.steps[:-1]] if path is not None else []
        found = []
        for way in self.critical.ways_out():
            order = way.surfaces[::-1]
            if way.total or (design and list(order) == design):
                continue
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


def _in_words(missed: Sequence[str], beside: Sequence[str]) -> str:
    past = f"past {', '.join(missed)}" if missed else ""
    through = f"through {', '.join(beside)}" if beside else ""
    return " ".join(text for text in (past, through) if text) or "through the optics in another order"


def gap_of(number: int, views: Sequence[RayView]) -> int:
    """Gap of the design path in which most rays meet an object."""
    return int(np.argmax(np.sum([view.in_gap[number] for view in views], axis=0)))

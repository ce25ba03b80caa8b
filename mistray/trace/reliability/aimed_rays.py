"""Aimed rays by place of scatter: how many of them reach the detector, and places of which nothing does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mistray.events import FIRST_SCATTERED, kind_of, place_of
from mistray.execute.tracer import Run
from mistray.kernel.targets import Inside, Target
from mistray.recorders.tallies import AIMED, HITS, INCIDENT, LANDED
from mistray.sampling.bulk_aiming import medium_of
from mistray.sampling.outlines import outline
from mistray.surfaces.surfaces import SurfaceTable

FEWEST_HITS = 100.0  # hits of a place below which it may be chance that none of its rays arrives
SAME = 1e-6  # relative to the size of the detector: lengths that differ by rounding


@dataclass(frozen=True)
class AimedSurface:
    """
    Number of scattered rays that a surface or medium aimed at targets, and of those that reached the detector.

    Attributes
    ----------
    id : str
        Name of the surface, or of the medium in brackets.
    aimed : float
        Number of rays that were sent to targets.
    landed : float
        Number of these that reached the detector without a further reflection.
    at_detector : bool
        Whether each target is the detector itself, or a part of its plane that contains it.
    """

    id: str
    aimed: float
    landed: float
    at_detector: bool = False


def aimed_surfaces(runs: Sequence[Run]) -> list[AimedSurface]:
    """Return the numbers of aimed rays of each surface and medium that aims, summed over runs, in the scene's order."""
    sums: dict[str, np.ndarray] = {}
    for run in runs:
        table, found = run.table, run.sums.surfaces[:, [AIMED, LANDED]].sum(axis=-1)
        for i in (*table.listed, *range(table.count, len(found))):
            # By name, whatever the number of a medium in each run
            name = table.event_ids[i]
            sums[name] = sums.get(name, np.zeros(2)) + found[i]
    elsewhere = _aims_elsewhere(runs)
    return [
        AimedSurface(name, float(aimed), float(landed), name not in elsewhere)
        for name, (aimed, landed) in sums.items()
        if aimed > 0
    ]


def _aims_elsewhere(runs: Sequence[Run]) -> set[str]:
    """Return the names of the places that have a target which contains no detector."""
    names = set()
    for run in runs:
        table = run.table
        detectors = [outline(table.shapes[i]) for i in table.detectors]
        for place, aim in run.scattering.tables.aims.items():
            flat = [target for target in aim.targets if isinstance(target, Target)]
            held = [any(_covers(target, detector) for detector in detectors) for target in flat]
            if len(flat) < len(aim.targets) or not all(held):
                if isinstance(place, Inside):  # in front of a wall may be any of the media
                    numbers = [table.count + medium for medium in np.flatnonzero(table.optics.host_scattering).tolist()]
                else:
                    numbers = [place[0]]
                names |= {table.event_ids[number] for number in numbers}
    return names


def _covers(target: Target, detector: Target) -> bool:
    """Whether a target has the centre of a detector and is at least as large."""
    size = max(detector.size)
    return (
        float(np.linalg.norm(target.centre - detector.centre)) < SAME * size
        and min(target.size) >= (1 - SAME) * min(detector.size)
        and max(target.size) >= (1 - SAME) * size
    )


@dataclass(frozen=True)
class SilentPlace:
    """
    Surface or medium that scatters and got light, none of which reached the detector.

    Attributes
    ----------
    id : str
        Name of a surface, or of a medium in brackets.
    share : float
        Flux of all visits over the launched flux; for a medium that of its surface with most flux.
    """

    id: str
    share: float


def silent_places(runs: Sequence[Run]) -> list[SilentPlace]:
    """
    Return the surfaces and media that scatter but sent none of their light to the detector, most flux first.

    The list is empty where paths were not kept, or nothing may scatter.
    """
    lit: dict[str, np.ndarray] = {}
    heard: set[str] = set()
    for run in runs:
        settings = run.settings
        if run.sums.paths is None or not settings.max_scatters or settings.ray_control != "allow_all":
            return []
        table, events = run.table, run.sums.paths.events
        sums = run.sums.surfaces[: table.count, [HITS, INCIDENT]].sum(axis=-1) * [1.0, run.unit]
        for place, found in _lit_places(table, sums).items():
            name = table.event_ids[place]
            lit[name] = lit.get(name, np.zeros(2)) + found
        # Places of the scatter events of all paths to the detector
        places = np.unique(place_of(events[kind_of(events) >= FIRST_SCATTERED]))
        heard |= {table.event_ids[place] for place in places.tolist()}
    launched = sum(run.source.power for run in runs)
    # Lit often enough, and in no path
    quiet = [
        SilentPlace(name, float(flux) / launched)
        for name, (hits, flux) in lit.items()
        if hits >= FEWEST_HITS and name not in heard
    ]
    return sorted(quiet, key=lambda place: -place.share)


def _lit_places(table: SurfaceTable, sums: np.ndarray) -> dict[int, np.ndarray]:
    """Return hits and flux of the places that scatter; for a medium those of its surface with most flux."""
    lit = {i: sums[i] for i in table.listed if table.interfaces[i].scatter and i not in table.detectors}
    if table.optics.scatters:
        for i in table.listed:
            for side in (Inside(i, False), Inside(i, True)):
                medium = medium_of(table, side)
                if table.optics.host_scattering[medium] > 0:
                    place = table.count + medium
                    lit[place] = max(lit.get(place, sums[i]), sums[i], key=lambda found: float(found[1]))
    return lit

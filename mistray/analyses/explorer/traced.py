"""Trace results on which the explorer's estimates rest: powers of all paths, maps of the strongest, sampled rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as of_field

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analyses.explorer.controls import VALUES
from mistray.analyses.explorer.looks import SurfaceHits
from mistray.analyses.ghosts.combine import by_path
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.verdict import Remedy, remedy
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.events import AIMED_TRANSMITTED, FIRST_SCATTERED, RANDOM_TRANSMITTED
from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace
from mistray.trace.sampled_hits import SampledHits

MAPPED = 40  # stray ways that have a map of their own
CELLS = 128  # of a map along the longer side, at most
START_RAYS, RAYS_OF_A_PATH = 1024, 128  # of the sample

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class HitGroup:
    """
    Hits of the sampled rays at one surface that have the same event.

    Attributes
    ----------
    surface : str
        Shape id.
    rays : (n,) int
        Index in the sample of the ray of each hit.
    hits : SurfaceHits
        Angles and directions of the hits.
    """

    surface: str
    rays: Whole
    hits: SurfaceHits


@dataclass(frozen=True)
class Sample:
    """
    Sampled rays of the paths of a trace, with their hits.

    Attributes
    ----------
    way : (r,) int
        Row of `Traced.ways` to which each ray belongs.
    weight : (r,) float64
        Flux that the detector absorbs, W; the rays of a trace's path share its power in proportion to their flux.
    groups : tuple of HitGroup
        All hits of all rays, grouped by surface and event.
    lines : list of (k, 3) float64
        Points of each ray in world coordinates, mm.
    """

    way: Whole
    weight: Floats
    groups: tuple[HitGroup, ...]
    lines: list[Floats]


@dataclass(frozen=True)
class Maps:
    """
    Power of stray light on cells of the detector.

    Attributes
    ----------
    ways : (m,) int
        Rows of `Traced.ways` that have a map of their own.
    power_W : (m + 1, h, w) float64
        Maps of these ways, and one of all other stray light, W; row 0 is at the smallest y.
    extent : tuple of float
        x0, x1, y0, y1 of the cells in the plane of the detector, mm; the last cells may extend past it.
    """

    ways: Whole
    power_W: Floats
    extent: tuple[float, float, float, float]


@dataclass
class Traced:
    """
    Trace reduced to the paths, maps and hits that estimates need.

    Attributes
    ----------
    state : mapping
        Values of all controls.
    ways : DataFrame
        Paths of the light, one for each source and events, see `mistray.analyses.ghosts.combine.by_path`.
    stray_W, direct_W, ratio : Estimate
        Power of the stray and of the direct light, W, and stray over direct.
    sample : Sample
        Rays of the paths, with their hits.
    maps : Maps
        Stray power on cells of the detector.
    remedy : Remedy or None
        Surface that takes part in most of the stray light, detectors aside; None if there is none.
    polarized : bool
        Whether the trace carries Stokes vectors, which estimates do not follow.
    slopes : dict
        Name of a control → d(stray power)/d(value) over the stray power, where it is known. It is not a number for a
        rim that the beam just fills: there the derivatives on its two sides differ.
    factors : dict
        Index of a `HitGroup` in the sample → factors of its hits, (n,), in `state`, see `Looks.factor`.
    """

    state: Mapping[str, VALUES]
    ways: pd.DataFrame
    stray_W: Estimate
    direct_W: Estimate
    ratio: Estimate
    sample: Sample
    maps: Maps
    remedy: Remedy | None
    polarized: bool
    slopes: dict[str, Estimate] = of_field(default_factory=dict)
    factors: dict[int, Floats] = of_field(default_factory=dict)

    @property
    def stray(self) -> npt.NDArray[np.bool_]:
        """Mask of the paths that are stray light, (paths,) bool."""
        return np.asarray(self.ways.kind != DIRECT)

    def row(self, events: str, source: str | None) -> int:
        """
        Return the row of `ways` of a path, by its events and its source; None: the only source.

        Raises
        ------
        MistrayError
            If there is no such path, or one of each of several sources.
        """
        found = self.ways[self.ways.events == events]
        found = found if source is None else found[found.source == source]
        name = f"path '{events[:120]}'" + ("" if source is None else f" of source '{str(source)[:80]}'")
        if found.empty:
            raise MistrayError(f"{name} is not one of the last trace; choose one of the table")
        if len(found) > 1:
            raise MistrayError(f"{name} has light of several sources; choose one of {', '.join(found.source)}")
        return int(found.index[0])


def traced(t: Trace, state: Mapping[str, VALUES]) -> Traced:
    """
    Return the data for estimates from a trace; its rays are traced again for the maps and for a sample.

    Parameters
    ----------
    t : Trace
        Finished trace.
    state : mapping
        Values of the controls with which the scene was traced.
    """
    ways, field = by_path(t.paths.by_way(), t.paths), float(t.settings["field_deg"])
    stray = np.asarray(ways.kind != DIRECT)
    groups = [_ids(ways, stray), _ids(ways, ~stray)]
    powers = [Estimate(*t.paths.power(ids)) for ids in groups]
    return Traced(
        state=dict(state),
        ways=ways,
        stray_W=powers[0],
        direct_W=powers[1],
        ratio=_ratio(t, groups),
        sample=_sample(t, ways),
        maps=_maps(t, ways),
        remedy=remedy(GhostReport(None, {field: t}, t, {})),
        polarized=t.settings["polarization"] == "stokes",
    )


def _ids(ways: pd.DataFrame, chosen: npt.NDArray[np.bool_]) -> list[int]:
    return [i for ids in ways.path_ids[chosen] for i in ids]


def _ratio(t: Trace, groups: Sequence[Sequence[int]]) -> Estimate:
    """
    Return the ratio of the powers of two groups of paths, with a standard error that allows for shared rays.

    It is 0 if the first group is empty, and NaN if the second is.
    """
    if not all(groups):
        return Estimate(0.0, 0.0) if groups[1] else Estimate(float("nan"), float("nan"))
    light = t.paths.numbers(groups).light
    found = light[np.array([0])].over(light[np.array([1])])
    return Estimate(float(found.value[0]), float(found.se[0]))


def _sample(t: Trace, ways: pd.DataFrame) -> Sample:
    row_of_path, power = np.full(len(t.paths), -1, dtype=np.int64), t.paths.column("power_W")
    for row, ids in enumerate(ways.path_ids):
        row_of_path[list(ids)] = row
    rows, weights, groups, lines, before = [], [], [], [], 0
    for found in t.sampled_hits(START_RAYS, RAYS_OF_A_PATH):
        rows.append(row_of_path[found.path_ids])
        of_its_path = np.bincount(found.path_ids, found.weight, minlength=len(power))[found.path_ids]
        weights.append(power[found.path_ids] * found.weight / of_its_path)
        groups += _groups(found, before)
        lines += [found.polyline(k) for k in range(len(found.path_ids))]
        before += len(found.path_ids)
    return Sample(np.concatenate(rows), np.concatenate(weights), tuple(groups), lines)


def _groups(hits: SampledHits, before: int) -> list[HitGroup]:
    """
    Return the surface hits of sampled rays, grouped by surface and event; hits within media are left out.

    `before` is the number of rays in the sample ahead of these.
    """
    cosine = np.einsum("rki,rki->rk", hits.arrival, hits.normal)
    groups = []
    for number in np.unique(hits.surface[hits.surface >= 0]):
        if number >= hits.table.count:
            continue
        for event in np.unique(hits.event[hits.surface == number]):
            ray, place = np.nonzero((hits.surface == number) & (hits.event == event))
            scattered = np.zeros((len(ray), 3))
            if event >= FIRST_SCATTERED:
                scattered = _scattered(hits, int(event), ray, place)
            own = SurfaceHits(
                int(event),
                hits.wavelength_nm,
                np.abs(cosine[ray, place]),
                cosine[ray, place] > 0,
                scattered,
            )
            groups.append(HitGroup(hits.table.ids[number], ray + before, own))
    return groups


def _scattered(hits: SampledHits, event: int, ray: Whole, place: Whole) -> Floats:
    """
    Return unit directions of scattered light, (n, 3), in the local frame of `mistray.scatter.evaluate.bsdf`.

    The hits are those with this event at the indices `ray` and `place`, (n,) each, of `hits`.
    """
    arrival, leaving = hits.arrival[ray, place], hits.arrival[ray, place + 1]
    normal = hits.normal[ray, place]
    along = np.sum(arrival * normal, axis=1, keepdims=True)
    inwards = normal * np.sign(along)  # away from the light
    tangent = arrival - along * normal
    size = np.linalg.norm(tangent, axis=1, keepdims=True)
    other = np.cross(inwards, np.eye(3)[np.argmin(np.abs(inwards), axis=1)])
    x = np.where(size > 1e-9, tangent / np.maximum(size, 1e-9), other / np.linalg.norm(other, axis=1, keepdims=True))
    y = np.cross(-inwards, x)
    z = inwards if event in (RANDOM_TRANSMITTED, AIMED_TRANSMITTED) else -inwards
    return np.stack([np.sum(leaving * axis, axis=1) for axis in (x, y, z)], axis=1)


def _maps(t: Trace, ways: pd.DataFrame) -> Maps:
    stray = np.flatnonzero(ways.kind != DIRECT)
    own, others = stray[:MAPPED], stray[MAPPED:]  # the table is in the order of the power
    groups = [list(ways.path_ids[row]) for row in own]
    rest = [i for row in others for i in ways.path_ids[row]]
    width, height, (x0, x1, y0, y1) = t.runs[0].table.film()
    pixel, block = (x1 - x0) / width * (y1 - y0) / height, max(1, -(-max(height, width) // CELLS))
    rows, columns = -(-height // block), -(-width // block)
    power = np.zeros((len(own) + 1, rows, columns))
    filled = [k for k, ids in enumerate([*groups, rest]) if ids]
    wanted = [[*groups, rest][k] for k in filled]
    whole = np.zeros((rows * block, columns * block))
    for k, found in zip(filled, t.each_map(wanted, [False] * len(wanted)) if wanted else (), strict=True):
        whole[:height, :width] = found.value * pixel
        # Rows of pixels first: NumPy sums neighbours in memory faster
        power[k] = whole.reshape(rows, block, -1).sum(axis=1).reshape(rows, columns, block).sum(axis=2)
    cell = (x1 - x0) / width * block, (y1 - y0) / height * block
    return Maps(own, power, (x0, x0 + columns * cell[0], y0, y0 + rows * cell[1]))

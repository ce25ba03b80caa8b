"""Rays of chosen paths as polylines, points in mm and fluxes in W."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.events import INTERCEPTS, LETTERS
from mistray.ranges import several
from mistray.sampling.design_path import find_design_path
from mistray.sampling.sources import field_axes
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.drawings.ray_choice import BACKWARD, ELSEWHERE, RayChoice
from mistray.trace.host.backward_rays import steps_back
from mistray.trace.host.ray_sources import DetectorView
from mistray.trace.named_paths import KINDS

if TYPE_CHECKING:
    import mitsuba as mi
    import pandas as pd

    from mistray.trace import Trace
    from mistray.trace.path_row import PathRow

Floats = npt.NDArray[np.float64]

_LETTER = {INTERCEPTS[code]: letter for code, letter in LETTERS.items()}


@dataclass(frozen=True, eq=False)
class RayLine:
    """
    Ray of one path as a polyline, from its source (backward: from the detector) to its last hit.

    Attributes
    ----------
    path_id : int
        Row of the path table; `ELSEWHERE` for a ray chosen by a surface or class.
    events : str
        Surfaces and events in order, as in `mistray.trace.path_row.PathRow`.
    wavelength_nm : float
        Wavelength, nm.
    start_ray : int
        Index of its start ray; of a backward ray, its index among those of its detector.
    points : (k + 1, 3) float64
        Start and every hit, mm; where a ray leaves the scene, perhaps one more point on its way out.
    flux_W : (k + 1,) float64
        Flux arriving at each point, W; 1 for backward rays.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> ray = mistray.report.rays_of_paths(t, [1], n=3)[0]
    >>> ray.points.shape, ray.events.split()[2:4]
    ((10, 3), ['L2_front:R', 'L1_rear:R'])
    """

    path_id: int
    events: str
    wavelength_nm: float
    start_ray: int
    points: Floats
    flux_W: Floats

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, RayLine)
            and self._head() == other._head()
            and np.array_equal(self.points, other.points)
            and np.array_equal(self.flux_W, other.flux_W)
        )

    def _head(self) -> tuple[int, str, float, int]:
        return self.path_id, self.events, self.wavelength_nm, self.start_ray


def traces_of(trace: Trace | Sequence[Trace] | None) -> list[Trace]:
    """Return one trace, several or none as a list; raise `MistrayError` for anything else."""
    found = [] if trace is None else several(trace)
    if not all(hasattr(one, "history") for one in found):
        raise MistrayError(f"trace is of type {type(trace).__name__}; give what mistray.trace returned, one or several")
    return found


def chosen_rows(trace: Trace, count: int, path_ids: Sequence[int | str] | None = None) -> list[PathRow]:
    """
    Return the `count` strongest rows of the path table, or all that `path_ids` requests by id, by name or by filter.

    A path at several wavelengths, unless it is requested by id, counts once, with its strongest row: the rays of the
    others would lie on its own.

    Raises
    ------
    MistrayError
        If an id is unknown, or no path has the name or passes the filter.
    """
    if path_ids is None:
        return one_of_each(trace.paths, count)
    rows: list[PathRow] = []
    for path_id in path_ids:
        if isinstance(path_id, str):
            found = one_of_each(trace.paths.select(path_id), len(trace.paths))
            if not found:
                raise MistrayError(f"no path of this trace is meant by '{path_id}'; see mistray ghosts --filter")
            rows += found
        else:
            rows += [trace.paths[number] for number in trace.paths.check_ids(path_id).tolist()]
    return list({row.path_id: row for row in rows}.values())


def one_of_each(rows: Iterable[PathRow], count: int) -> list[PathRow]:
    """Return the first rows of a path table, at most `count`, that differ in more than wavelength."""
    found: dict[tuple[str, str], PathRow] = {}
    for row in rows:
        if len(found) == count:
            break
        found.setdefault((row.source, row.events), row)
    return list(found.values())


def rays_of_paths(trace: Trace, path_ids: int | Iterable[int] | None = None, n: int = 8) -> list[RayLine]:
    """
    Return rays of some paths, from `Trace.history`.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    path_ids : int or iterable of int, optional
        Rows of the path table (default: all).
    n : int
        Largest number of rays per path.

    Returns
    -------
    list of RayLine
        Rays path by path, points in mm; fewer than `n` where a path has fewer.

    Raises
    ------
    MistrayError
        If a row is unknown, `n` is below 1, or the trace has no path table.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> rays = mistray.report.rays_of_paths(t, [0, 1], n=3)
    >>> [ray.path_id for ray in rays]
    [0, 0, 0, 1, 1, 1]
    """
    ids = range(len(trace.paths)) if path_ids is None else trace.paths.check_ids(path_ids).tolist()
    return [line for i in ids for line in ray_lines(trace.history(i, n).to_pandas().assign(path_id=i))]


def ray_lines(nodes: pd.DataFrame, beyond_mm: float = 0.0) -> list[RayLine]:
    """
    Return the rays of a table of nodes.

    Parameters
    ----------
    nodes : DataFrame
        Nodes from `Trace.rays` or `Trace.rays_at` with ``events=True``, or from a `RayHistory`.
    beyond_mm : float
        Length by which a ray that leaves the scene is extended past its last node, mm.
    """
    lines = []
    for _, ray in nodes.groupby("ray", sort=True):
        steps = zip(ray.surface[1:], ray.intercept[1:], strict=True)
        points, flux = (ray[names].to_numpy(dtype=np.float64) for names in (["x_mm", "y_mm", "z_mm"], "flux_W"))
        if beyond_mm and (heading := ray[["dx", "dy", "dz"]].to_numpy(dtype=np.float64)[-1]).any():
            points, flux = np.vstack([points, points[-1] + beyond_mm * heading]), np.append(flux, flux[-1])
        lines.append(
            RayLine(
                int(ray.path_id.iloc[0]) if "path_id" in ray else ELSEWHERE,
                " ".join(f"{surface}:{_LETTER[intercept]}" for surface, intercept in steps),
                float(ray.wavelength_nm.iloc[0]),
                int(ray.start_ray.iloc[0]),
                points,
                flux,
            )
        )
    return lines


def backward_lines(scene: mi.Scene, trace: Trace, n: int, beyond_mm: float = 0.0) -> list[RayLine]:
    """
    Return rays that leave the detectors of a trace backwards, over the hemisphere on the side of the light.

    Surfaces send them on as the design does, see `mistray.trace.host.backward_rays`; they end where a surface absorbs
    them. Their flux is 1.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    trace : Trace
        Trace that gives the detectors, the wavelength (its first) and the seed.
    n : int
        Largest number of rays of each detector; rays of one point are left out.
    beyond_mm : float
        Length by which a ray that leaves the scene is extended, mm.
    """
    rng, lines = np.random.default_rng(trace.settings["seed"]), list[RayLine]()
    whole = SurfaceTable(scene, trace.wavelengths_nm[0], trace.settings["detector"])
    for number in whole.detectors:
        table = whole.on(number)
        path = find_design_path(table, scene)
        light = field_axes(scene)[:, 2] if path is None else path.steps[-1].before
        start = DetectorView(table, light).sample(n, rng)
        points, events = [[at] for at in start.o], [list[str]() for _ in start.o]
        for step in steps_back(table, start.o, start.d):
            for ray, met, d, p, reflects, stops in zip(
                step.ray, step.met, step.d, step.p, step.reflects, step.stops, strict=True
            ):
                if met >= 0:
                    points[ray].append(p)
                    events[ray].append(f"{table.ids[met]}:{'A' if stops else 'R' if reflects else 'T'}")
                elif beyond_mm:
                    points[ray].append(points[ray][-1] + beyond_mm * d)
        lines += [
            RayLine(ELSEWHERE, " ".join(names), table.wavelength_nm, k, np.array(way), np.ones(len(way)))
            for k, (names, way) in enumerate(zip(events, points, strict=True))
            if len(way) > 1
        ]
    return lines


class RayGroup(NamedTuple):
    """Drawn rays with a common colour: name in the legend, rays, and row of the path table (None: rays of a class)."""

    name: str
    lines: list[RayLine]
    path_id: int | None = None


def rows_of(choice: RayChoice, trace: Trace) -> list[PathRow]:
    """
    Return the drawn rows of the path table; none if rays are drawn by class.

    If no path passes the filter, or a path is unknown, it raises `MistrayError`.
    """
    if choice.classes is not None:
        return []
    if not choice.selection:
        return chosen_rows(trace, choice.paths, choice.path_ids)
    found = one_of_each(trace.paths.select(choice.selection), choice.paths)
    if not found:
        raise MistrayError(f"no path passes the filter '{choice.selection}'; widen it, or see mistray ghosts --filter")
    return found


def ray_groups(choice: RayChoice, scene: mi.Scene, traces: Sequence[Trace], size_mm: float = 0.0) -> list[RayGroup]:
    """
    Return the rays to draw, grouped by path or by class; rays that leave the scene are extended by `size_mm`.

    Raise `MistrayError` for an unknown path or surface, or a filter that is not valid or that no path passes.
    """
    found = [group for trace in traces for group in _groups_of(choice, trace, size_mm, len(traces) > 1)]
    if traces and BACKWARD in (choice.classes or ()):  # at all fields the same
        found.append(RayGroup(BACKWARD, backward_lines(scene, traces[0], choice.rays, size_mm)))
    return found


def _groups_of(choice: RayChoice, trace: Trace, size_mm: float, with_field: bool) -> list[RayGroup]:
    """
    Return the rays to draw from the trace of one field, grouped by path or by class.

    Names begin with the field angle if `with_field`; `size_mm` is that of `ray_groups`. Raise `MistrayError` as
    `rows_of` does, or if the filter is not valid.
    """
    field = f"{trace.settings['field_deg']:g}°: " if with_field else ""
    if choice.classes is not None:
        names = [name for name in choice.classes if name != BACKWARD]
        return [RayGroup(f"{field}{name}", _lines_of_class(choice, trace, name, size_mm)) for name in names]
    several = len(trace.wavelengths_nm) > 1
    return [
        RayGroup(f"{field}{row_name(row, several)}", rays_of_paths(trace, [row.path_id], choice.rays), row.path_id)
        for row in rows_of(choice, trace)
    ]


def _lines_of_class(choice: RayChoice, trace: Trace, name: str, size_mm: float) -> list[RayLine]:
    if name not in KINDS:
        if choice.box is not None:
            raise MistrayError(f"box is about light on the detector, not about '{name}'; leave one of them out")
        return ray_lines(trace.rays_at(name, choice.selection, n=choice.rays, events=True), size_mm)
    kind = f"'{name}'" if choice.selection else name
    selection = f"{kind} & ({choice.selection})" if choice.selection else kind
    return ray_lines(trace.rays(selection, n=choice.rays, box=choice.box, events=True))


def row_name(row: PathRow, with_wavelength: bool = False) -> str:
    """
    Return the name of a row of the path table in a legend: id, name and power (W).

    With `with_wavelength` the wavelength (nm) is added.
    """
    wavelength = f", {row.wavelength_nm:g} nm" if with_wavelength else ""
    return f"{row.path_id} {row.label}{wavelength}, {row.power_W:.4g} W"

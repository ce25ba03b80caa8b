"""Rays of chosen paths as polylines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.recorders.path_events import INTERCEPTS, LETTERS

if TYPE_CHECKING:
    from mistray.trace import Trace
    from mistray.trace.paths import PathRow

Floats = npt.NDArray[np.float64]

_LETTER = {INTERCEPTS[code]: letter for code, letter in LETTERS.items()}


@dataclass(frozen=True, eq=False)
class RayLine:
    """
    One ray from the source to the detector.

    Attributes
    ----------
    path_id : int
        Row of the path table.
    events : str
        Surfaces and what happened there, as in `mistray.trace.paths.PathRow`.
    wavelength_nm : float
    start_ray : int
        Number of its start ray.
    points : (k + 1, 3) float64
        Start and every hit, mm.
    flux_W : (k + 1,) float64
        Flux with which it arrives at each point.
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


def chosen_rows(trace: Trace, count: int, path_ids: Sequence[int | str] | None = None) -> list[PathRow]:
    """
    The strongest rows of the path table, or those requested: by their ids, or all that have a name or pass a filter.

    A path at several wavelengths counts once, with its strongest row: the rays of the others would lie on its own.

    Raises
    ------
    MistrayError
        If `count` is below 0, for an unknown id, and for a text by which no light goes.
    """
    if count < 0:
        raise MistrayError(f"paths is {count}; give the number of rows of the path table to draw, 0 or more")
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
            trace.paths.locate(path_id)
            rows.append(trace.paths[path_id])
    return list({row.path_id: row for row in rows}.values())


def one_of_each(rows: Iterable[PathRow], count: int) -> list[PathRow]:
    """The first rows, at most `count`, that are different ways of the light; not one way at several wavelengths."""
    found: dict[tuple[str, str], PathRow] = {}
    for row in rows:
        if len(found) == count:
            break
        found.setdefault((row.source, row.events), row)
    return list(found.values())


def check_count(rays: int) -> None:
    """Refuse a number of rays of each path below 1."""
    if rays < 1:
        raise MistrayError(f"rays is {rays}; ask for at least one ray of each path")


def rays_of_paths(trace: Trace, path_ids: Iterable[int] | None = None, n: int = 8) -> list[RayLine]:
    """
    Rays of some paths, from `Trace.history`.

    Parameters
    ----------
    trace : Trace
    path_ids : iterable of int, optional
        Rows of the path table; default: all of them.
    n : int
        Most rays of each path.

    Returns
    -------
    list of RayLine
        Path by path. A path that has fewer rays than `n` has fewer here.

    Raises
    ------
    MistrayError
        For an unknown row, or if `n` is below 1.
    """
    ids = range(len(trace.paths)) if path_ids is None else path_ids
    lines = []
    for path_id in ids:
        table = trace.history(int(path_id), n).to_pandas()
        for _, ray in table.groupby("ray", sort=True):
            steps = zip(ray.surface[1:], ray.intercept[1:], strict=True)
            lines.append(
                RayLine(
                    int(path_id),
                    " ".join(f"{surface}:{_LETTER[intercept]}" for surface, intercept in steps),
                    float(ray.wavelength_nm.iloc[0]),
                    int(ray.start_ray.iloc[0]),
                    ray[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=np.float64),
                    ray.flux_W.to_numpy(dtype=np.float64),
                )
            )
    return lines


def row_name(row: PathRow, with_wavelength: bool = False) -> str:
    """A row of the path table in a legend: id, name, on request the wavelength, and power."""
    wavelength = f", {row.wavelength_nm:g} nm" if with_wavelength else ""
    return f"{row.path_id} {row.label}{wavelength}, {row.power_W:.4g} W"

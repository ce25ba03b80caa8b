"""Irradiance maps of parts of the light of a field, on the detector and on surfaces: kinds of paths, or filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.estimate import Estimate
from mistray.recorders.film import Pixels
from mistray.recorders.flux_maps.surface_maps import SurfaceMap, SurfaceMaps
from mistray.toolkit.irradiance import highest_cell
from mistray.trace import Trace
from mistray.trace.path_filter import PathFilter

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LightMap:
    """
    Irradiance map of a part of the light on one surface.

    Attributes
    ----------
    selection : str
        Kind of paths, name or filter that selects the light.
    surface : str
        Shape id.
    irradiance, se : (rows, columns) float64
        Irradiance and its standard error, W/mm²: flux absorbed by the detector, incident on other surfaces.
    power : Estimate
        Power on the whole surface, W.
    across, along : str
        Coordinates along the rows and along the columns, see `mistray.recorders.SurfaceMap`.
    across_borders, along_borders : (n + 1,) float64
        Borders of the columns and rows, mm, or degrees for azimuths.
    unrolled_mm : four float
        Extent x0, x1, y0, y1 of the flat map, mm.
    """

    selection: str
    surface: str
    irradiance: Array
    se: Array
    power: Estimate
    across: str
    along: str
    across_borders: Array
    along_borders: Array
    unrolled_mm: tuple[float, float, float, float]

    @property
    def peak(self) -> tuple[Estimate, float, float]:
        """Irradiance of the brightest cell, W/mm², and its position across and along, mm (azimuths in degrees)."""
        (row, column), peak = highest_cell(self.irradiance, self.se)
        across, along = (
            float(borders[k : k + 2].mean())
            for borders, k in ((self.across_borders, column), (self.along_borders, row))
        )
        return peak, across, along


def light_maps(t: Trace, selections: Sequence[str]) -> list[LightMap]:
    """
    Return maps of parts of the light of a trace, by tracing its rays again.

    Parameters
    ----------
    t : Trace
        Trace with one detector.
    selections : sequence of str
        Kinds, names or filters, see `mistray.trace.path_filter`; light may be in several.

    Returns
    -------
    list of LightMap
        Map of the detector, then of the surfaces that a `SurfaceMaps` of the trace records, for each selection.
    """
    ids = [np.concatenate([own.ids for own in t.paths.chosen(PathFilter(text))]) for text in selections]
    of_detector: dict[int, LightMap] = {}
    for together in _apart(ids):
        found = t.each_map([ids[k].tolist() for k in together], [True] * len(together))
        for k, pixels in zip(together, found, strict=True):
            of_detector[k] = _on_detector(t, selections[k], pixels, Estimate(*t.paths.power(ids[k])))
    walls: list[list[LightMap]] = [[] for _ in selections]
    for recorder in t.recorders.values():
        if isinstance(recorder, SurfaceMaps):
            lengths, azimuths = recorder.shape
            found_on = t.surface_maps(recorder.patterns, selections, azimuths=azimuths, lengths=lengths)
            for own, text, maps in zip(walls, selections, found_on, strict=True):
                own += [_on_surface(text, one) for one in maps.values()]
    return [one for k, own in enumerate(walls) for one in (of_detector[k], *own)]


def _apart(groups: Sequence[np.ndarray]) -> list[list[int]]:
    """
    Return, for each trace to be made, the indices of the groups of path ids that it maps together.

    No trace has a path twice, and there are few traces.
    """
    runs: list[tuple[list[int], set[int]]] = []
    for number, group in enumerate(groups):
        own = set(group.tolist())
        for members, taken in runs:
            if not own & taken:
                members.append(number)
                taken |= own
                break
        else:
            runs.append(([number], own))
    return [members for members, _ in runs]


def _on_detector(t: Trace, selection: str, pixels: Pixels, power: Estimate) -> LightMap:
    rows, columns = pixels.value.shape
    x0, x1, y0, y1 = t.extent
    borders = np.linspace(x0, x1, columns + 1), np.linspace(y0, y1, rows + 1)
    (surface,) = t.detectors
    return LightMap(selection, surface, pixels.value, pixels.se, power, "x", "y", *borders, t.extent)


def _on_surface(selection: str, one: SurfaceMap) -> LightMap:
    names, borders = (one.across, one.along), (one.across_borders, one.along_mm)
    return LightMap(selection, one.surface, *one.irradiance, Estimate(*one.power), *names, *borders, one.unrolled_mm)

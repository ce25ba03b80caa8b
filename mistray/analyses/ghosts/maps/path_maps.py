"""Maps of many paths in one report, each only as fine as its structure needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mistray.analyses.ghosts.peaks import BYTES_PER_PIXEL, MAP_BYTES
from mistray.files.irradiance_files import Map
from mistray.recorders.film import Pixels, images_of
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.irradiance import pixel_size

if TYPE_CHECKING:
    import pandas as pd

    from mistray.trace import Trace

# Along the longer side of the map of a path in a report, of that of all light, and of one that is not shown
CELLS, CELLS_OF_ALL, CELLS_OF_OTHERS = 84, 256, 8


@dataclass(frozen=True)
class PathMap:
    """
    Map of one path's power, W, on the detector, in square cells of whole pixels.

    It is cropped to the smallest rectangle that holds all power.

    Attributes
    ----------
    pixels : int
        Number of pixels along the side of a cell, a power of two.
    column, row : int
        Indices of the first cell, counted from the corner of the smallest x and y.
    power_W : (h, w) float64
        Power in each cell, W; row 0 is at the smallest y; shape (0, 0) for a dark map. Cells may extend past the
        detector.
    """

    pixels: int
    column: int
    row: int
    power_W: npt.NDArray[np.float64]

    @staticmethod
    def of(power_W: Map, cells: int) -> PathMap:
        """
        Return the map of power in cells, summed from pixels.

        Parameters
        ----------
        power_W : (H, W) float64
            Power in each pixel, W.
        cells : int
            Largest number of cells along either side.
        """
        rows, columns = (np.flatnonzero(power_W.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return PathMap(1, 0, 0, np.zeros((0, 0)))
        pixels = 1
        while max(_cells(rows, pixels), _cells(columns, pixels)) > cells:
            pixels *= 2
        row, column = rows[0] // pixels, columns[0] // pixels
        shape = _cells(rows, pixels), _cells(columns, pixels)
        part = power_W[row * pixels : (row + shape[0]) * pixels, column * pixels : (column + shape[1]) * pixels]
        whole = np.zeros((shape[0] * pixels, shape[1] * pixels))
        whole[: part.shape[0], : part.shape[1]] = part
        summed = whole.reshape(shape[0], pixels, shape[1], pixels).sum(axis=(1, 3))
        return PathMap(pixels, int(column), int(row), summed)

    def within(self, columns: tuple[int, int], rows: tuple[int, int]) -> float:
        """
        Return the power, W, of the path in a rectangle of detector pixels.

        Parameters
        ----------
        columns, rows : (int, int)
            First pixel and the one after the last, multiples of the cell size.
        """
        (c0, c1), (r0, r1) = (
            (max(first // self.pixels - start, 0), max(last // self.pixels - start, 0))
            for (first, last), start in ((columns, self.column), (rows, self.row))
        )
        return float(self.power_W[r0:r1, c0:c1].sum())


@dataclass(frozen=True)
class FieldMaps:
    """
    Power maps of the paths at one field.

    Attributes
    ----------
    direct, stray : PathMap
        Maps of the direct image and of all other light.
    paths : dict
        Maps of single paths, by ``path_id``.
    rest : PathMap
        Map of all other paths together.
    others : dict
        Maps of single paths of the rest, by ``path_id``, in large cells; as many of the strongest as memory allows.
    """

    direct: PathMap
    stray: PathMap
    paths: dict[int, PathMap]
    rest: PathMap
    others: dict[int, PathMap]

    @property
    def grid(self) -> int:
        """Largest cell size of `paths` and `rest`, pixels. Sums over rectangles of such cells are exact for these."""
        return max(found.pixels for found in (self.rest, *self.paths.values()))


@dataclass(frozen=True)
class ImagesOfField:
    """Images of irradiance, W/mm², and of its standard error at a field: direct, stray, and worst paths by path id."""

    direct: Pixels
    stray: Pixels
    paths: dict[int, tuple[Map, Map]]


def field_maps(
    trace: Trace, table: pd.DataFrame, path_ids: Sequence[int], worst: set[int]
) -> tuple[FieldMaps, ImagesOfField | None]:
    """
    Return the power maps of paths at one field, by tracing its rays once more.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    table : DataFrame
        Paths of the trace.
    path_ids : sequence of int
        Paths that get a map of their own, the most important ones first, as far as memory allows.
    worst : set of int
        Paths whose full images are requested.

    Returns
    -------
    maps : FieldMaps
    images : ImagesOfField or None
        Full images, or None if memory does not suffice for all that are requested.
    """
    pixels = trace.irradiance.size
    members = dict(zip(table.path_id, table.path_ids, strict=True))
    direct_ids = set(table.path_id[table.kind == DIRECT])
    shown = set(path_ids)
    strongest = table.sort_values("power_W", ascending=False).path_id.tolist()
    wanted = [*path_ids, *(path_id for path_id in strongest if path_id not in shown)]
    sizes = [images_of(pixels) if path_id in direct_ids | worst else 1 for path_id in wanted]
    room = MAP_BYTES / (BYTES_PER_PIXEL * pixels) - images_of(pixels) - 1
    chosen = wanted[: int(np.searchsorted(np.cumsum(sizes), room, side="right"))]
    left = set(members) - set(chosen)
    # What is left, direct and stray apart, then path by path
    groups = [[path_id for path_id in left if (path_id in direct_ids) == kind] for kind in (True, False)]
    groups += [[path_id] for path_id in chosen]
    ways = [[i for path_id in group for i in members[path_id]] for group in groups]
    is_direct = [number == 0 or bool(set(group) & direct_ids) for number, group in enumerate(groups)]
    noisy = [known or bool(set(group) & worst) for known, group in zip(is_direct, groups, strict=True)]

    width, height = pixel_size(trace.irradiance, trace.extent)

    def in_cells(irradiance: Map, cells: int) -> PathMap:
        return PathMap.of(irradiance * (width * height), cells)

    direct, stray, rest = trace.light.none, np.zeros_like(trace.irradiance), np.zeros_like(trace.irradiance)
    paths: dict[int, PathMap] = {}
    others: dict[int, PathMap] = {}
    full: dict[int, tuple[Map, Map]] = {}
    images = trace.each_map(ways, noisy) if len(table) else ()
    for path_id, known, found in zip([None, None, *chosen], is_direct, images, strict=len(table) > 0):
        if known:
            direct = direct + found
        else:
            stray += found.value
        if path_id in shown:
            paths[path_id] = in_cells(found.value, CELLS)
        else:
            rest += found.value
            if path_id is not None:
                others[path_id] = in_cells(found.value, CELLS_OF_OTHERS)
        if path_id in worst:
            full[path_id] = found.value, found.se
    maps = FieldMaps(
        in_cells(direct.value, CELLS_OF_ALL), in_cells(stray, CELLS_OF_ALL), paths, in_cells(rest, CELLS), others
    )
    whole = ImagesOfField(direct, without(trace.light, direct, stray), full) if worst <= set(full) else None
    return maps, whole


def images_of_field(trace: Trace, table: pd.DataFrame, worst: Sequence[int]) -> ImagesOfField:
    """
    Return irradiance images at one field, W/mm², at full resolution, also of each path in `worst`.

    Rays are traced once more.
    """
    if table.empty:
        return ImagesOfField(trace.light, trace.light, {})
    members = dict(zip(table.path_id, table.path_ids, strict=True))
    is_direct = table.kind == DIRECT
    others = table.path_id[~is_direct & ~table.path_id.isin(worst)]
    groups = [[i for path_id in part for i in members[path_id]] for part in (table.path_id[is_direct], others)]
    noisy = [True, False, *[True] * len(worst)]
    direct, *rest = trace.each_map([*groups, *(members[path_id] for path_id in worst)], noisy)
    stray = without(trace.light, direct, np.sum([found.value for found in rest], axis=0))
    paths = {path_id: (found.value, found.se) for path_id, found in zip(worst, rest[1:], strict=True)}
    return ImagesOfField(direct, stray, paths)


def without(light: Pixels, direct: Pixels, value: Map) -> Pixels:
    """
    Return the irradiance map of stray light, W/mm², with its noise: that of all light less that of the direct image.

    `value` is the map of stray light without noise, (H, W), W/mm².
    """
    noise = np.where(value[..., None] > 0, light.apart - direct.apart, 0.0)
    return Pixels(value, noise, np.maximum(light.weights - direct.weights, 0.0))


def _cells(lit: npt.NDArray[np.int64], pixels: int) -> int:
    """Return the number of cells of `pixels` width from the first to the last lit pixel."""
    return int(lit[-1] // pixels - lit[0] // pixels + 1)

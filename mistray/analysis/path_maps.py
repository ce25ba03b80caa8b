"""Maps of many paths at once, each no finer than it must be: what a report can hold of all paths of a field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.files.irradiance_files import Map
from mistray.recorders.sampled import Sampled


@dataclass(frozen=True)
class PathMap:
    """
    Power on the detector in square cells of whole pixels, within the smallest rectangle that holds all of it.

    Attributes
    ----------
    pixels : int
        Pixels along the side of a cell, a power of two.
    column, row : int
        First cell, in cells from the corner of the smallest x and y.
    power_W : (h, w) float64
        Row 0 at the smallest y; (0, 0) of a dark map. Cells at the edge may reach beyond the detector.
    """

    pixels: int
    column: int
    row: int
    power_W: npt.NDArray[np.float64]

    @staticmethod
    def of(power_W: Map, cells: int) -> PathMap:
        """
        Sum the pixels of a map in cells.

        Parameters
        ----------
        power_W : (H, W) float64
            Power in each pixel.
        cells : int
            Most cells along either side.
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
        Power in a rectangle, W.

        Parameters
        ----------
        columns, rows : (int, int)
            First pixel and the one after the last, whole numbers of cells.
        """
        (c0, c1), (r0, r1) = (
            (max(first // self.pixels - start, 0), max(last // self.pixels - start, 0))
            for (first, last), start in ((columns, self.column), (rows, self.row))
        )
        return float(self.power_W[r0:r1, c0:c1].sum())


@dataclass(frozen=True)
class FieldMaps:
    """
    Maps of one field.

    Attributes
    ----------
    direct, stray : PathMap
        Of the direct image, and of all other light.
    paths : dict
        Of single paths, by ``path_id``.
    rest : PathMap
        Of all paths together that are not among these.
    """

    direct: PathMap
    stray: PathMap
    paths: dict[int, PathMap]
    rest: PathMap

    @property
    def grid(self) -> int:
        """Pixels along the side of the largest cell: rectangles on this grid are whole numbers of cells of any path."""
        return max(found.pixels for found in (self.rest, *self.paths.values()))


@dataclass(frozen=True)
class ImagesOfField:
    """Full maps of one field: the direct image, all stray light, and the worst paths with their errors by path_id."""

    direct: Sampled
    stray: Sampled
    paths: dict[int, tuple[Map, Map]]


def without(light: Sampled, direct: Sampled, value: Map) -> Sampled:
    """Map of the stray light, whose value is known, with the noise of all light less the direct image."""
    return Sampled(value, np.where(value[..., None] > 0, (light - direct).apart, 0.0))


def _cells(lit: npt.NDArray[np.int64], pixels: int) -> int:
    """Cells from the first lit pixel to the last."""
    return int(lit[-1] // pixels - lit[0] // pixels + 1)

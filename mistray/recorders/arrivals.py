"""Recorders of forward traces of many cells of directions at once: light that meets the detector, by way and cell."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.film import Film
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Memory, Recorder, Visit
from mistray.recorders.way_table import WayTable
from mistray.settings import BATCHES


class FoundWays(Recorder):
    """
    All ways that are met, by cell.

    Parameters
    ----------
    path_sums : PathSums
    """

    by_way, incident = True, True

    def __init__(self, path_sums: PathSums) -> None:
        self.path_sums = path_sums

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add rays that have met the detector."""
        cell = visit.start.cell
        self.path_sums.record(visit.key, visit.depth + 1, visit.event, cell, visit.weight, visit.detected)


class CountedWays(Recorder):
    """
    The light of chosen ways in chosen cells.

    Parameters
    ----------
    table : WayTable
        With the keys of the ways in the order of the light.
    cells : int
        Number of cells.
    film : Film, optional
        Of a map of the detector for each; None: no maps.
    """

    by_way, incident = True, True

    def __init__(self, table: WayTable, cells: int, film: Film | None) -> None:
        self._table, self._film, self._cells = table, film, cells
        self._pixels = pixels = 0 if film is None else film.width * film.height
        pairs = max(table.count, 1)
        self._sums = dr.zeros(mi.Float64, pairs * BATCHES)
        self._hits, self._squares = dr.zeros(mi.Float64, pairs), dr.zeros(mi.Float64, pairs)
        self._largest = dr.zeros(mi.UInt32, cells)  # bits of the largest weight of a scattered ray
        self._maps = dr.zeros(mi.Float64, 2 * cells * pixels) if pixels else None
        dr.eval(self._sums, self._hits, self._squares, self._largest, self._maps)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add rays that have met the detector."""
        cell, batch = visit.start.cell, visit.start.batch
        assert cell is not None
        number, found = self._table.find(visit.key, cell, visit.detected)
        w = mi.Float64(visit.weight)
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, w, number * BATCHES + batch, found)
        dr.scatter_reduce(dr.ReduceOp.Add, self._hits, mi.Float64(1), number, found)
        dr.scatter_reduce(dr.ReduceOp.Add, self._squares, w * w, number, found)
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, visit.weight)
        dr.scatter_reduce(dr.ReduceOp.Max, self._largest, bits, cell, found & (visit.state["scatters"] != 0))
        if self._maps is not None and self._film is not None:
            pixel = self._film.places(*visit.position)[0][0]
            place = 2 * (cell * self._pixels + pixel)
            for k, value in enumerate((w, w * w)):
                dr.scatter_reduce(dr.ReduceOp.Add, self._maps, value, place + k, found)

    def read(self) -> dict[str, np.ndarray]:
        """
        The sums on the host.

        Returns
        -------
        dict
            ``weights`` (p, BATCHES), ``hits`` and ``squares`` (p,) of the pairs, ``largest`` (cells,) and, if there are
            maps, ``maps`` (2, cells, pixels); in units of a start ray.
        """
        count = self._table.count
        found = {
            "weights": np.array(self._sums).reshape(-1, BATCHES)[:count],
            "hits": np.array(self._hits)[:count],
            "squares": np.array(self._squares)[:count],
            "largest": np.array(self._largest).view(np.float32).astype(np.float64),
        }
        if self._maps is not None:
            found["maps"] = np.moveaxis(np.array(self._maps).reshape(self._cells, self._pixels, 2), 2, 0)
        return found

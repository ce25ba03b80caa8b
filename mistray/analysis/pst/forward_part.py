"""Forward rays of a PST, alone or beside backward rays: their sums so far."""

from __future__ import annotations

import time

import numpy as np

from mistray.analysis.pst.state import under
from mistray.execute.all_cells import AllCells
from mistray.execute.grid_trace import GridTrace
from mistray.recorders.direction_recorder import CLASS_COUNT
from mistray.recorders.path_sums import join_sums
from mistray.settings import BATCHES

SUMS, PATHS = "light_", "light_path_"  # prefixes of the names of saved arrays
FoundByCell = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]  # path table, unit and start rays of each cell
CellSums = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]  # sums of one cell, and its paths


class ForwardPart:
    """
    Sums of forward rays.

    Parameters
    ----------
    trace : GridTrace
        See `AllCells`.
    saved : dict of str to np.ndarray, optional
        Result of `arrays` of the run that this one continues.

    Attributes
    ----------
    rays : (c,) float64
        Start rays of each cell.
    seconds : float
        Time spent so far.
    cells : AllCells
        Tracer of the forward rays.
    """

    def __init__(self, trace: GridTrace, saved: dict[str, np.ndarray] | None = None) -> None:
        self.cells = AllCells(trace)
        count, pixels = self.cells.cells, trace.map_size[0] * trace.map_size[1]
        self.rays, self.seconds, self._rounds = np.zeros(count), 0.0, 0
        self._before: dict[str, np.ndarray] = {}
        self._sums = {
            "cells": np.zeros((CLASS_COUNT, count, BATCHES)),
            "largest": np.zeros(count),
            "segments": np.zeros(count),
        }
        if pixels:
            self._sums["maps"] = np.zeros((2, count, pixels))
        # Continue a saved run; its path table is merged when paths are read
        if saved is not None:
            self._sums = {name: saved.get(SUMS + name, none) for name, none in self._sums.items()}
            self.rays, (rounds, self.seconds) = saved[SUMS + "rays"], saved[SUMS + "done"]
            self._rounds = int(rounds)
            self._before = under(saved, PATHS)

    def go_on(self, rays: np.ndarray, number: int | None = None) -> None:
        """
        Trace until each cell has the given number of rays.

        Parameters
        ----------
        rays : (c,) int
            In multiples of `BATCHES`; other numbers are made up of as many rays of adapted weight.
        number : int, optional
            Number of the round, which selects its random numbers; by default the next one.
        """
        missing = np.maximum(rays - self.rays, 0)
        if not missing.any():
            return
        started = time.perf_counter()
        # Sums add up, maxima do not
        for name, values in self.cells.sums(missing, self._rounds if number is None else number).items():
            self._sums[name] = np.maximum(self._sums[name], values) if name == "largest" else self._sums[name] + values
        self.rays = self.rays + missing
        self._rounds += 1
        self.seconds += time.perf_counter() - started

    @property
    def unscattered_rays(self) -> float:
        """Number of additional rays for unscattered light alone, see `Sharing.unscattered`."""
        ratio = self.cells.unscattered
        return 0.0 if ratio is None else float(np.sum(self.rays * ratio))

    @property
    def unit(self) -> np.ndarray:
        """PST_normal of the flux of one start ray of each cell, (c,)."""
        unit = self.cells.unit
        return np.divide(unit, self.rays, out=np.zeros_like(unit), where=self.rays > 0)

    @property
    def by_batch(self) -> np.ndarray:
        """PST_normal of each class from each batch alone, (CLASS_COUNT, n, m, BATCHES)."""
        found = BATCHES * self.unit[:, None] * self._sums["cells"]
        return np.asarray(found.reshape(CLASS_COUNT, *self.cells.areas.shape, BATCHES))

    @property
    def largest(self) -> np.ndarray:
        """PST_normal of the strongest scattered ray of each cell, (n, m)."""
        return np.asarray((self.unit * self._sums["largest"]).reshape(self.cells.areas.shape))

    @property
    def maps(self) -> np.ndarray:
        """Part of each pixel in the PST_normal of a cell, and its variance, (2, n, m, pixels)."""
        # Variance of a sum over start rays: Σ w² - (Σ w)²/n
        weight, squares = self._sums["maps"]
        rays, unit = np.maximum(self.rays, 1)[:, None], self.unit[:, None]
        found = np.stack([unit * weight, unit**2 * np.maximum(squares - weight**2 / rays, 0)])
        return found.reshape(2, *self.cells.areas.shape, -1)

    @property
    def segments(self) -> int:
        """Number of ray segments."""
        return round(self._sums["segments"].sum())

    def of_cell(self, cell: int) -> CellSums:
        """Return the sums of a cell, and the paths so far, which are then forgotten here."""
        found = {name: _part(values, cell) for name, values in self._named.items()}, self.paths()
        self.cells.forget_paths()
        return found

    def add_cell(self, cell: int, found: CellSums) -> None:
        """Take over `of_cell` of another process."""
        for name, values in self._named.items():
            _part(values, cell)[...] = found[0][name]
        self._before = join_sums(self._before, found[1])

    @property
    def _named(self) -> dict[str, np.ndarray]:
        return self._sums | {"rays": self.rays}

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path table, see `PathSums.read`; event lists in forward order."""
        return join_sums(self._before, self.cells.paths())

    @property
    def found(self) -> FoundByCell:
        """Path table, PST_normal of the flux of one start ray of each cell, and start rays of each cell."""
        return self.paths(), self.unit, self.rays

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which a run can be continued."""
        sums = {SUMS + name: values for name, values in self._sums.items()}
        paths = {PATHS + name: values for name, values in self.paths().items()}
        return sums | paths | {SUMS + "rays": self.rays, SUMS + "done": np.array([self._rounds, self.seconds])}


def _part(values: np.ndarray, cell: int) -> np.ndarray:
    """Return the part of a cell in an array over cells, which is a view; classes and the like come before the cells."""
    return values[:, cell] if values.ndim > 1 else values[cell, ...]

"""Forward rays beside the backward ones of a PST: their sums so far."""

from __future__ import annotations

import time

import numpy as np

from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import CLASS_COUNT
from mistray.recorders.path_sums import join_sums
from mistray.settings import BATCHES

SUMS, PATHS = "light_", "light_path_"  # prefixes of the names of saved arrays


class ForwardPart:
    """
    Forward rays beside a backward trace that shares its paths with them by MIS.

    Parameters
    ----------
    trace : BackwardTrace
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

    def __init__(self, trace: BackwardTrace, saved: dict[str, np.ndarray] | None = None) -> None:
        self.cells = AllCells(trace)
        count, pixels = self.cells.cells, trace.map_size[0] * trace.map_size[1]
        self.rays, self.seconds, self._rounds = np.zeros(count), 0.0, 0
        self._before: dict[str, np.ndarray] = {}
        self._sums = {"cells": np.zeros((CLASS_COUNT, count, BATCHES)), "largest": np.zeros(count)}
        if pixels:
            self._sums["maps"] = np.zeros((2, count, pixels))
        # Continue a saved run; its path table is merged when paths are read
        if saved is not None:
            self._sums = {name: saved[SUMS + name] for name in self._sums}
            self.rays, (rounds, self.seconds) = saved[SUMS + "rays"], saved[SUMS + "done"]
            self._rounds = int(rounds)
            names = [name for name in saved if name.startswith(PATHS)]
            self._before = {name.removeprefix(PATHS): saved[name] for name in names}

    def go_on(self, rays: np.ndarray) -> None:
        """Trace until each cell has the given number of rays, (c,) multiples of `BATCHES`."""
        missing = np.maximum(rays - self.rays, 0)
        if not missing.any():
            return
        started = time.perf_counter()
        # Sums add up, maxima do not
        for name, values in self.cells.sums(missing, self._rounds).items():
            self._sums[name] = np.maximum(self._sums[name], values) if name == "largest" else self._sums[name] + values
        self.rays = self.rays + missing
        self._rounds += 1
        self.seconds += time.perf_counter() - started

    @property
    def unscattered_rays(self) -> float:
        """Number of additional rays for unscattered light alone, see `Sharing.unscattered`."""
        ratio = self.cells.sharing.unscattered
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

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path table, see `PathSums.read`; event lists in forward order."""
        here = self.cells.paths()
        return join_sums(self._before, here) if self._before and here else here or self._before

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which a run can be continued."""
        sums = {SUMS + name: values for name, values in self._sums.items()}
        paths = {PATHS + name: values for name, values in self.paths().items()}
        return sums | paths | {SUMS + "rays": self.rays, SUMS + "done": np.array([self._rounds, self.seconds])}

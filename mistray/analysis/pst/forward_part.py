"""The part of a backward run that is counted forwards: the ways that its pilot has chosen."""

from __future__ import annotations

import time
from dataclasses import fields

import numpy as np

from mistray.analysis.pst.forward_cells import Ways
from mistray.analysis.pst.pilot import FORWARD, Plan, backward_events
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import CLASS_COUNT
from mistray.recorders.path_key import host_keys
from mistray.recorders.way_table import WayTable
from mistray.settings import BATCHES
from mistray.trace.all_cells import AllCells

PLAN, SUMS = "plan_", "light_"  # names of arrays that are saved


class ForwardPart:
    """
    Forward rays beside a backward trace, which leaves out what they count.

    Parameters
    ----------
    trace : BackwardTrace
    cells : AllCells
    plan : Plan
    saved : dict of str to np.ndarray
        What `arrays` gave, of a run that this one goes on from.

    Attributes
    ----------
    classes : (p,) int
        Number of the class of light of each pair of the plan.
    rays : (c,) float64
        Start rays of each cell.
    """

    def __init__(
        self, trace: BackwardTrace, cells: AllCells, plan: Plan, saved: dict[str, np.ndarray] | None = None
    ) -> None:
        self.plan, self._trace, self._cells = plan, trace, cells
        self._pairs = np.flatnonzero(plan.forward)
        way, cell = plan.way[self._pairs], plan.cell[self._pairs]
        events, lengths = backward_events(plan.events, plan.lengths)
        trace.leave_out(host_keys(events, lengths)[way], cell)
        self._table = WayTable(host_keys(plan.events, plan.lengths)[way], cell)
        ways = Ways(trace.table.event_ids, trace.table.event_words, trace.has_optics)
        numbers = ways.number(plan.events, plan.lengths)
        self.classes = ways.classes[numbers][plan.way]
        pixels = trace.map_size[0] * trace.map_size[1]
        count, self.seconds, self._rounds = len(plan.rays[FORWARD]), 0.0, 0
        self.rays = np.zeros(count)
        self._sums = {
            "weights": np.zeros((len(self._pairs), BATCHES)),
            "hits": np.zeros(len(self._pairs)),
            "squares": np.zeros(len(self._pairs)),
            "largest": np.zeros(count),
        }
        if pixels:
            self._sums["maps"] = np.zeros((2, count, pixels))
        if saved is not None:
            self._sums = {name: saved[SUMS + name] for name in self._sums}
            self.rays, (self._rounds, self.seconds) = saved[SUMS + "rays"], saved[SUMS + "done"]
            self._rounds = int(self._rounds)

    def go_on(self, rays: np.ndarray) -> None:
        """Trace what is missing of so many rays of each cell, (c,) multiples of `BATCHES`."""
        missing = np.maximum(rays - self.rays, 0)
        if not missing.any():
            return
        started = time.perf_counter()
        new, _ = self._cells.count(self._table, missing.reshape(self._cells.areas.shape), self._rounds)
        for name, values in new.items():
            self._sums[name] = np.maximum(self._sums[name], values) if name == "largest" else self._sums[name] + values
        self.rays = self.rays + missing
        self._rounds += 1
        self.seconds += time.perf_counter() - started

    @property
    def _unit(self) -> np.ndarray:
        """(c,) PST_normal of the light of one start ray."""
        area = self._cells.areas.ravel() / self._trace.area
        return np.divide(area, self.rays, out=np.zeros_like(area), where=self.rays > 0)

    @property
    def by_batch(self) -> np.ndarray:
        """(CLASS_COUNT, n, m, BATCHES): what each batch alone adds to the PST_normal of each class."""
        cell = self.plan.cell[self._pairs]
        found = np.zeros((CLASS_COUNT, len(self.rays), BATCHES))
        values = BATCHES * self._unit[cell, None] * self._sums["weights"]
        np.add.at(found, (self.classes[self._pairs], cell), values)
        return found.reshape(CLASS_COUNT, *self._cells.areas.shape, BATCHES)

    @property
    def largest(self) -> np.ndarray:
        """(n, m) PST_normal of the strongest scattered ray."""
        return np.asarray((self._unit * self._sums["largest"]).reshape(self._cells.areas.shape))

    @property
    def maps(self) -> np.ndarray:
        """(2, n, m, pixels): PST_normal that each pixel adds to the mean over the pixels, and its variance."""
        weight, squares = self._sums["maps"]
        rays = np.maximum(self.rays, 1)[:, None]
        unit = self._unit[:, None]
        found = np.stack([unit * weight, unit**2 * np.maximum(squares - weight**2 / rays, 0)])
        return found.reshape(2, *self._cells.areas.shape, -1)

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of the pairs of the plan that are counted here, hits, PST_normal and its variance, (q,) each."""
        cell = self.plan.cell[self._pairs]
        unit, rays = self._unit[cell], np.maximum(self.rays[cell], 1)
        weight = self._sums["weights"].sum(axis=1)
        variance = unit**2 * np.maximum(self._sums["squares"] - weight**2 / rays, 0)
        return self._pairs, self._sums["hits"], unit * weight, variance

    def arrays(self) -> dict[str, np.ndarray]:
        """All that a run needs to go on."""
        plan = {PLAN + f.name: np.asarray(getattr(self.plan, f.name)) for f in fields(Plan)}
        sums = {SUMS + name: values for name, values in self._sums.items()}
        return plan | sums | {SUMS + "rays": self.rays, SUMS + "done": np.array([self._rounds, self.seconds])}


def saved_plan(arrays: dict[str, np.ndarray]) -> Plan:
    """The plan within what `ForwardPart.arrays` gave."""
    return Plan(**{f.name: arrays[PLAN + f.name] for f in fields(Plan)})

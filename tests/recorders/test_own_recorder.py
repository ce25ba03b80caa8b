"""A recorder as a user writes it: a histogram of the optical path lengths of every path, in one file."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.recorders import Recorder, Visit

pytestmark = pytest.mark.quick

POINTS, LENGTHS = ("lengths x", "lengths y", "lengths z"), "lengths"


class PathLengths(Recorder):
    """Detected power, (bins,) W, by slot of the path in the ledger and optical path length from `low` to `high` mm."""

    def __init__(self, slots: int, low: float, high: float, bins: int) -> None:
        self.slots, self.low, self.step, self.bins = slots, low, (high - low) / bins, bins
        self.power: dict[int, np.ndarray] = {}

    def attach(self, scene: Any) -> None:
        """A trace begins."""
        self.indices = scene.table.optics.indices  # (4 · surfaces,): in front, behind, …
        self.sums = dr.zeros(mi.Float64, self.slots * self.bins)
        dr.eval(self.sums)

    def begin(self, start: Any, max_events: int, memory: dict[str, Any]) -> None:
        """The points and path lengths of the nodes, by depth; depth 0 is the start of the ray."""
        for name in POINTS:
            memory[name] = dr.alloc_local(mi.Float, max_events + 1)
        memory[LENGTHS] = dr.alloc_local(mi.Float64, max_events + 1, mi.Float64(0))
        zero = dr.full(mi.UInt32, 0, dr.width(start.lane))
        for name, value in zip(POINTS, start.o, strict=True):
            memory[name].write(value, zero)

    def visit(self, visit: Visit, memory: dict[str, Any]) -> None:
        """Add the segment that led here, and at the detector the flux."""
        it, depth, active = visit.interaction, visit.depth, visit.active
        before = mi.Vector3f(*(memory[name].read(depth, active) for name in POINTS))
        side = 4 * visit.surface + dr.select(it.from_front, mi.UInt32(0), 1)
        segment = mi.Float64(dr.gather(mi.Float, self.indices, side, active) * dr.norm(it.p - before))
        length = memory[LENGTHS].read(depth, active) + segment
        for name, value in zip(POINTS, it.p, strict=True):
            memory[name].write(value, depth + 1, active)
        memory[LENGTHS].write(length, depth + 1, active)
        place = mi.Int32((length - self.low) / self.step)
        inside = visit.counted & (place >= 0) & (place < self.bins)
        index = visit.slot * self.bins + mi.UInt32(place)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, mi.Float64(visit.absorbed), index, inside)

    def collect(self, unit: float) -> None:
        """The trace has ended."""
        found = unit * np.array(self.sums).reshape(self.slots, self.bins)
        for slot in np.flatnonzero(found.any(axis=1)):
            self.power[int(slot)] = self.power.get(int(slot), 0.0) + found[slot]


def test_every_path_has_its_power() -> None:
    lengths = PathLengths(1 << 12, 50.0, 450.0, 4000)
    t = mistray.trace(mistray.load("double_gauss"), rays=20_000, field_deg=3, recorders=[lengths])
    mine = sorted(histogram.sum() for histogram in lengths.power.values())
    assert mine == pytest.approx(sorted(row.power_W for row in t.paths), rel=1e-6)  # of the history in float32
    # The direct path: each ray of the history, in float64, lies where the histogram has light
    direct = max(lengths.power.values(), key=lambda histogram: float(histogram.sum()))
    lit = np.flatnonzero(direct)
    low, high = lengths.low + lengths.step * lit[0], lengths.low + lengths.step * (lit[-1] + 1)
    rays = t.rays(n=8000)
    opl = rays.loc[rays["kind"] == "direct", "opl_mm"]
    assert len(opl) > 100
    assert opl.min() >= low - lengths.step
    assert opl.max() <= high + lengths.step
    other = mistray.trace(mistray.load("double_gauss"), rays=20_000, field_deg=3)
    np.testing.assert_allclose(*(sorted(row.power_W for row in one.paths) for one in (t, other)), rtol=1e-12)

"""Lanes that take one start ray after the other bring what those bring that take one each; packets are sums."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.kernel.start_supply import StartSupply
from mistray.recorders import Recorder, Visit

pytestmark = pytest.mark.quick

ROUNDING = {"rtol": 1e-9, "atol": 0.0}  # of sums whose terms come in another order

CASES: dict[str, dict[str, Any]] = {
    "baffle_tube": {"field_deg": 3, "max_scatters": 3},
    "phone_camera_scatter": {"field_deg": 40, "max_scatters": 2, "rays": 500},
    "plate_and_wall": {"field_deg": 20, "max_segments": 40},  # trees are cut off
}


def let_lanes_take_several(several: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StartSupply, "pays", staticmethod(lambda *_: several))


@pytest.mark.parametrize("scene", CASES)
def test_a_trace_is_the_same(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for several in (False, True):
        let_lanes_take_several(several, monkeypatch)
        t = mistray.trace(mistray.load(scene), **{"rays": 20_000, **CASES[scene]})
        energy, rows = t.energy, sorted(t.paths, key=lambda row: row.path_id)
        losses = [energy.launched_W, energy.escaped_W, *energy.cut.values()]
        found.append(np.array([*losses, *(v for row in rows for v in (row.power_W, row.power_se_W))]))
    assert len(found[0]) > 20
    np.testing.assert_allclose(*found, **ROUNDING)


def test_a_pst_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for several in (False, True):
        let_lanes_take_several(several, monkeypatch)
        pst = mistray.pst(mistray.load("baffle_tube"), [0, 15, 40], rays=20_000, max_scatters=3)
        found.append(np.array([pst.value, pst.standard_error, pst.stray]))
    np.testing.assert_allclose(*found, **ROUNDING)


class RayNumbers(Recorder):
    def attach(self, scene: Any) -> None:
        self.most = dr.zeros(mi.UInt32, 1)
        self.least = dr.full(mi.UInt32, 1 << 31, 1)
        dr.eval(self.most, self.least)

    def begin(self, start: Any, max_events: int, memory: dict[str, Any]) -> None:
        memory["lane"] = start.lane + 0

    def visit(self, visit: Visit, memory: dict[str, Any]) -> None:
        dr.scatter_reduce(dr.ReduceOp.Max, self.most, memory["lane"], mi.UInt32(0), visit.active)
        astray = visit.active & (memory["lane"] != visit.start.lane)
        dr.scatter_reduce(dr.ReduceOp.Min, self.least, memory["lane"], mi.UInt32(0), astray)


def test_a_recorder_may_remember_the_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    let_lanes_take_several(True, monkeypatch)
    recorder = RayNumbers()
    mistray.trace(mistray.load("plate_and_wall"), rays=200_000, field_deg=20, recorders=[recorder])
    assert int(recorder.most[0]) > 199_000
    assert int(recorder.least[0]) == 1 << 31

"""Start rays up to 4.29e9: sums keep their precision, memory does not grow; lanes that take one after the other."""

import gc
import itertools
import json
import subprocess
import sys
import textwrap
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles import closed_forms

import mistray
from mistray.execute import launching, tracer
from mistray.execute.tracer import PASS_LANES, prepare
from mistray.kernel.launches import Launches
from mistray.kernel.start_supply import StartSupply
from mistray.recorders import Recorder, Visit
from mistray.recorders.film import Images
from mistray.recorders.ledger import Ledger
from mistray.recorders.tallies import SURFACE_SUMS, Tallies
from mistray.settings import BATCHES, Settings

pytestmark = pytest.mark.quick

MOST_RAYS = 2**32 - 1

PROGRAM = """
    import json, resource, sys
    import mistray

    rays = int(sys.argv[1])
    t = mistray.trace(mistray.load("plate"), rays=rays)
    print(json.dumps({
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "launched": t.energy.launched_W, "detected": t.energy.detected_W, "escaped": t.energy.escaped_W,
        "closure": t.energy.closure, "hits": [row.rays for row in t.paths], "segments": t.segments,
        "se": t.energy.detected_se_W, "rms": t.paths[0].rms_radius_mm, "rms_se": t.paths[0].rms_radius_se_mm,
        "x": t.paths[0].x_mm, "x_se": t.paths[0].x_se_mm, "map": float(t.irradiance.sum()),
    }))
"""


def traced(rays: int) -> dict:
    """The trace in a process of its own, with the peak of its memory."""
    command = [sys.executable, "-c", textwrap.dedent(PROGRAM), str(rays)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_hundred_million_rays() -> None:
    """A float32 sum of 1e8 equal terms would end at 2^24 of them; a pass has 2^20 rays: from four on, memory stays."""
    few, some, many = traced(1_000), traced(4_000_000), traced(100_000_000)
    assert (many["hits"], many["segments"]) == ([100_000_000, 100_000_000], 800_000_000)
    for what in ("detected", "escaped"):
        assert many[what] == pytest.approx(few[what], rel=1e-12)
    assert many["detected"] / many["launched"] == pytest.approx(closed_forms.plate_orders(0.04, 2).sum(), rel=1e-7)
    assert abs(many["closure"]) < 1e-7
    assert many["se"] < 1e-9 * many["detected"]
    assert many["map"] * (20 / 64) ** 2 == pytest.approx(many["detected"], rel=1e-12)
    # second moments too: a uniform disc of radius 5 mm, within 4 standard errors
    assert many["rms"] == pytest.approx(5 / 2**0.5, abs=4 * many["rms_se"])
    assert many["rms_se"] < 1e-3
    assert abs(many["x"]) < 4 * many["x_se"]
    assert many["mib"] < 1.15 * some["mib"] + 10


def test_a_pass_takes_no_more_memory_than_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Largest memory of Dr.Jit's arrays: nothing keeps those of a pass, with no help of the garbage collector."""
    lanes, backend = 1 << 13, dr.backend_v(mi.Float)
    monkeypatch.setattr(tracer, "PASS_LANES", lanes)
    scene = mistray.load("cooke_triplet")

    def largest(passes: int) -> int:
        dr.detail.malloc_clear_statistics()
        assert mistray.trace(scene, rays=passes * lanes).energy.closure < 1e-6
        return dr.detail.malloc_watermark(backend)

    largest(4)  # the first launches are of a few rays
    gc.disable()
    try:
        few, many = largest(4), largest(8)
        assert many == few
        # Launches of a part of a pass: Dr.Jit keeps memory in sizes of powers of two, of which two together are enough
        sizes = itertools.cycle((lanes // 2, lanes // 3, lanes // 5, lanes // 7))
        monkeypatch.setattr(Launches, "lanes", property(lambda _: next(sizes)))
        assert largest(4) < 2 * few
    finally:
        gc.enable()


def test_sums_and_numbers_of_the_last_rays() -> None:
    """The last ray has the number 2³² - 2, its own random numbers, and is found again by its number."""
    (run,) = prepare(mistray.load("plate"), Settings(rays=MOST_RAYS))
    assert run.passes == 4096
    first, last = run.start_pass(0), run.start_pass(run.passes - 1)
    lanes = np.array(last.lane)
    assert (lanes[0], lanes[-1]) == ((run.passes - 1) * PASS_LANES, MOST_RAYS - 1)
    assert len(np.unique(np.array(last.batch))) == BATCHES
    points = np.array(last.o).T
    assert not np.any(np.all(points == np.array(first.o).T[: len(points)], axis=1))
    # A uniform disc of 5 mm; both moments within 5 standard errors of 1e6 rays: a false alarm in 6e5 runs
    r2 = (points[:, :2] ** 2).sum(axis=1)
    assert r2.max() <= 25 * (1 + 1e-6)
    assert r2.mean() == pytest.approx(12.5, abs=5 * 25 / 12**0.5 / len(r2) ** 0.5)
    origins, _ = run.start_rays(lanes[[0, -1]])
    # Found in float64 on the exact start plane, where the device's float32 has rounded
    np.testing.assert_allclose(origins, points[[0, -1]], rtol=0, atol=1e-6)
    # Row and column of a ray come from its 32-bit number
    sample: list[mi.Point2f] = []

    class Grid:
        pattern, positions = "grid", staticmethod(lambda at: (sample.append(at), (at.x, at.y))[1])

    object.__setattr__(run.source, "emitter", Grid())
    rays = run.source.count(MOST_RAYS)
    assert rays == 65535**2
    lane = mi.UInt32([0, rays - 1])
    run.source.start(lane, dr.zeros(mi.UInt32, 2), rays, None, run.table.centre)
    np.testing.assert_allclose(np.array(sample[0]).T, [[0.5 / 65535] * 2, [1 - 0.5 / 65535] * 2], rtol=1e-6)
    # Every sum and count of a trace is a float64: after 2³³ hits one more counts
    tallies, images, ledger = Tallies(run.table), Images(run.make_film()), Ledger(64, run.settings.max_events)
    before = 2.0**33
    for recorder, name in ((tallies, "surfaces"), (tallies, "channels"), (images, "sums"), (ledger, "sums")):
        values = getattr(recorder, name)
        assert type(values) is mi.Float64, name
        setattr(recorder, name, dr.full(mi.Float64, before, dr.width(values)))
    dr.eval(tallies.surfaces, tallies.channels, images.sums, ledger.sums)
    start = run.start_pass(run.passes - 1)
    run.trace_trees(start, tallies, ledger, images)
    rays = dr.width(start.lane)
    hits = np.array(ledger.sums).reshape(ledger.capacity, BATCHES, -1)[:, :, 0] - before
    assert sorted(hits.sum(axis=1))[-2:] == [rays, rays]  # the direct path and the ghost
    surfaces = np.array(tallies.surfaces).reshape(-1, SURFACE_SUMS, BATCHES)[: run.table.count, 0] - before
    assert surfaces.sum(axis=1).max() >= 2 * rays


def test_seconds_are_those_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time that the host takes to record a kernel is not counted."""
    slow = launching.trace_tree

    def trace_tree(*arguments: Any) -> None:
        time.sleep(0.5)
        slow(*arguments)

    monkeypatch.setattr(launching, "trace_tree", trace_tree)
    assert 0 < mistray.trace(mistray.load("cooke_triplet"), rays=100).seconds < 0.5


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

"""Work that is done in parts: the numbers are those of one process, and what is left of a part of them is a sample."""

from __future__ import annotations

import contextlib
from itertools import pairwise

import numpy as np
import pytest
from oracles.statistics import assert_z
from workers_here import Here, assert_same

import mistray
from mistray import UnfinishedError
from mistray.execute import by_parts
from mistray.execute.workers import working_with
from mistray.optimize.metrics import metric as metrics

SCENE = "lens_and_window"
ROUNDING = 1e-12  # of sums of some 1e5 numbers of float64


@pytest.fixture(scope="module")
def scene():
    return mistray.load(SCENE)


@pytest.mark.long
def test_parts_add_up_to_one_run(scene, monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    arguments = {"rays": 40_000, "wavelength_nm": [500.0, 600.0], "field_deg": 2.0}
    one = mistray.trace(scene, **arguments)
    workers, told = Here(), []
    with working_with(workers):
        many = mistray.trace(scene, progress=lambda *rays: told.append(rays), **arguments)
        assert len(workers.parts) == 16  # four for each worker
        assert_same(one, many)
        groups = [[0], list(range(1, len(many.paths)))]
        for a, b in zip(one.maps(groups), many.maps(groups), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
    assert len(workers.parts) == 32
    assert told[-1] == (40_000, 40_000)
    assert all(a < b for (a, _), (b, _) in pairwise(told))
    # What a trace can do afterwards, it can do here
    assert_same(one, many)
    for a, b in zip(one.maps(groups), many.maps(groups), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
    np.testing.assert_array_equal(one.history(0, 4).to_pandas(), many.history(0, 4).to_pandas())


def test_work_is_split_by_rays_and_workers(scene):
    (run,) = mistray.trace(scene, rays=1000)._runs
    rays = {1000: 1, 1 << 20: 16, 4 << 20: 16}
    for count, parts in rays.items():
        run.rays = count
        places = by_parts.split([run], 4)
        assert len(places) == parts
        covered = sorted((p.part.number, b) for p in places for b in range(p.part.low, p.part.high))
        assert covered == [(k, b) for k in range(run.passes) for b in range(32)]
    run.rays = 1 << 20
    assert len(by_parts.split([run], 1000)) == 32  # a batch is not divided
    both = by_parts.split([run, run], 4)
    assert [place.run for place in both[:4]] in ([0, 1, 0, 1], [0, 0, 1, 1])


def test_what_was_finished_is_a_trace_of_fewer_rays(scene, monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    whole = mistray.trace(scene, rays=32_000)
    with working_with(Here(last=6)), pytest.raises(UnfinishedError, match=r"1\.2e") as caught:
        mistray.trace(scene, rays=32_000)
    part = caught.value.partial
    assert (part.rays_traced, part.rays_planned, part.settings["rays"]) == (12_000, 32_000, 12_000)
    assert "of 3.2e+04 rays are finished and kept" in str(caught.value)
    assert part.energy.launched_W == whole.energy.launched_W
    assert abs(part.energy.closure) < 1e-6
    assert_z("detected", part.energy.detected_W, whole.energy.detected_W, part.energy.detected_se_W, false_alarm=1e-6)
    ratio = part.energy.detected_se_W / whole.energy.detected_se_W
    assert ratio == pytest.approx(np.sqrt(32 / 12), rel=0.5)  # of 12 batches
    x0, x1, y0, y1 = part.extent
    area = (x1 - x0) * (y1 - y0) / part.irradiance.size
    np.testing.assert_allclose(part.irradiance_of([0])[0].sum() * area, part.paths[0].power_W, rtol=1e-6)
    assert len(part.history(0, 2)) == 2
    with pytest.raises(mistray.MistrayError, match="gradients need all"):
        list(part.table_gradients(None, None))
    with working_with(Here(last=0)), pytest.raises(UnfinishedError, match="too few") as caught:
        mistray.trace(scene, rays=1000)
    assert caught.value.partial is None


def test_a_grid_whose_rows_are_not_all_there_is_no_result(monkeypatch):
    scene = mistray.load(SCENE)
    (run,) = mistray.trace(scene, rays=2000)._runs
    run.parts = (by_parts.Part(0),)
    assert run.is_sample
    monkeypatch.setattr(type(run.source), "pattern", "grid")
    assert run.is_sample
    run.rays = 1 << 21
    assert not run.is_sample
    run.parts = None
    assert run.is_sample


@pytest.mark.parametrize(("last", "fields", "kept"), [(2, [0, 1, 2], [0, 1]), (1, [1, 0], [0])])
def test_ghosts_keep_the_fields_that_are_finished(scene, last, fields, kept):
    """The yardstick comes first."""
    with working_with(Here(last=last)), pytest.raises(UnfinishedError, match="finished") as caught:
        mistray.ghosts(scene, field_deg=fields, rays=2000)
    report = caught.value.partial
    assert isinstance(report, mistray.GhostReport)
    assert {field: t.rays_traced for field, t in report.items()} == dict.fromkeys(kept, 2000)


@pytest.mark.long
@pytest.mark.parametrize("method", ["joined", "adjoint", "forward"])
def test_pst_by_workers(method, tmp_path):
    scene = mistray.load("plate_and_wall")
    arguments = {"field_deg": [0, 20], "rays": 4000 if method == "forward" else 60_000, "method": method}
    one = mistray.pst(scene, map_pixels=4, **arguments)
    workers = Here()
    with working_with(workers):
        many = mistray.pst(scene, map_pixels=4, **arguments)
    assert len(workers.parts) == (2 if method == "forward" else 3)
    np.testing.assert_allclose(many.by_batch, one.by_batch, rtol=ROUNDING)
    np.testing.assert_allclose(many.maps, one.maps, rtol=1e-9, atol=1e-20)
    assert many.facts["rays"] == one.facts["rays"]
    order = ["cell", "events"]
    x, y = (found.path_rows.sort_values(order, ignore_index=True) for found in (one, many))
    assert list(x.events) == list(y.events)
    np.testing.assert_allclose(y.pst_normal, x.pst_normal, rtol=1e-9)
    if method == "forward":
        return
    state = tmp_path / "state.npz"
    with working_with(Here(last=2)), pytest.raises(UnfinishedError, match=r"4.915e\+04 of 6e\+04 rays") as caught:
        mistray.pst(scene, state=state, **arguments)
    assert caught.value.partial.facts["rays"] == 49152
    assert str(state) in str(caught.value)
    rest = mistray.pst(scene, state=state, resume=True, **arguments)
    np.testing.assert_allclose(rest.by_batch, one.by_batch, rtol=ROUNDING)
    if method == "joined":  # an error that is wanted stops at the same pass
        wanted = arguments | {"rays": 1_000_000, "relative_error": 0.3}
        one = mistray.pst(scene, **wanted)
        with working_with(Here()):
            many = mistray.pst(scene, **wanted)
        assert many.facts["rays"] == one.facts["rays"] < 1_000_000
        np.testing.assert_allclose(many.by_batch, one.by_batch, rtol=ROUNDING)


@pytest.mark.long
def test_monte_carlo_of_tolerances(scene):
    metric = metrics.path_power(scene, selection="ghost", rays=2000)
    arguments = {"keys": ["*.curvature"], "check": False, "monte_carlo": 3, "edges": False}
    one = mistray.sensitivity(metric, **arguments)
    workers = Here()
    with working_with(workers):
        many = mistray.sensitivity(metric, **arguments)
    assert sorted(part for part in workers.parts if isinstance(part, int)) == [0, 1, 2]
    np.testing.assert_allclose(many.draws.ratios, one.draws.ratios, rtol=1e-9)
    np.testing.assert_allclose(many.draws.predicted, one.draws.predicted, rtol=1e-6)
    assert one.draws.ratios.std() > 0
    assert metric.value() == pytest.approx(one.value.value, rel=1e-9)  # the scene is as it was


def test_a_failing_consumer_calls_parts_off_at_once(scene, monkeypatch):
    """Not only when somebody drops the traceback, which a notebook keeps."""
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    ended = []

    class Watched(Here):
        @contextlib.contextmanager
        def job(self, task):
            try:
                with super().job(task) as job:
                    yield job
            finally:
                ended.append(len(self.parts))

    with pytest.raises(ZeroDivisionError) as caught, working_with(Watched()):
        mistray.trace(scene, rays=20_000, progress=lambda done, of: 1 / 0)
    assert caught.value.__traceback__ is not None  # still held
    assert ended == [1]

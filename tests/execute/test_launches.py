"""Launches of bounded time: no number hangs on them; limits of trees, time budgets and interrupts."""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write

import mistray
from mistray.errors import Interrupted

launches = importlib.import_module("mistray.kernel.launches")
interrupts = importlib.import_module("mistray.interrupts")
RAYS = 40_000


@pytest.fixture
def small_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch may take no time: all are of the least size at which they are spread."""
    monkeypatch.setattr(launches, "SECONDS", 1e-9)
    monkeypatch.setattr(launches, "BATCHES", 2048)


@pytest.fixture
def plates(tmp_path: Path) -> Any:
    return mistray.load(write(tmp_path, plates_text(4)))


@pytest.mark.parametrize("scene", ["cooke_triplet", "baffle_tube"])
def test_results_do_not_hang_on_the_launches(scene: str, monkeypatch: pytest.MonkeyPatch, request: Any) -> None:
    loaded = mistray.load(scene)
    monkeypatch.setattr(launches, "STRETCH", 1e12)
    whole = mistray.trace(loaded, rays=RAYS, field_deg=3)
    monkeypatch.undo()
    request.getfixturevalue("small_launches")
    done: list[int] = []
    parts = mistray.trace(loaded, rays=RAYS, field_deg=3, progress=lambda rays, _: done.append(rays))
    assert len(done) > 10
    assert done == sorted(done)
    assert (done[-1], parts.rays_traced, parts.segments) == (RAYS, RAYS, whole.segments)
    np.testing.assert_allclose(parts.irradiance, whole.irradiance, rtol=1e-12)
    np.testing.assert_allclose(parts.irradiance_se, whole.irradiance_se, rtol=1e-9)
    powers = [{row.path: row.power_W for row in t.paths} for t in (parts, whole)]
    assert powers[0].keys() == powers[1].keys()
    np.testing.assert_allclose([powers[0][path] for path in powers[1]], list(powers[1].values()), rtol=1e-12)


@pytest.mark.parametrize("splitting", ["split", "one"])
def test_trees_have_a_limit_which_is_booked(plates: Any, splitting: str) -> None:
    """A tree of n surfaces that follow two reflections has about n³/6 branches: here it ends after 50 segments."""
    options: dict[str, Any] = {"rays": 2000, "max_reflections": 4, "flux_threshold": 0, "splitting": splitting}
    whole = mistray.trace(plates, **options)
    short = mistray.trace(plates, **options, max_segments=5 if splitting == "one" else 50)
    assert abs(short.energy.closure) < 1e-6
    assert whole.energy.cut["max_segments"] == 0
    assert short.energy.cut["max_segments"] > 1e-3 * short.energy.launched_W
    assert short.segments < whole.segments
    report = mistray.ghosts(plates, [0], **{**options, "rays": 200}, max_segments=5)
    assert any("max_segments = 5" in text for text in report.notes)
    # Pending nodes send on one ray each: no more than there are nodes on a path
    assert short.segments <= 2000 * (50 + 64)


def test_a_time_budget_ends_with_a_sample_of_all_rays(plates: Any, small_launches: None) -> None:
    """False alarm of the comparison: 5 standard errors, 6e-7."""
    whole = mistray.trace(plates, rays=60_000)
    part = mistray.trace(plates, rays=60_000, seconds=0.05)
    assert 0 < part.rays_traced < part.rays_planned == 60_000
    assert any("of 6e+04 rays" in note for note in part.notes)
    assert abs(part.energy.closure) < 1e-6
    assert part.energy.launched_W == pytest.approx(whole.energy.launched_W, rel=1e-12)
    started = part.runs[0].started
    assert np.ptp(started) <= 3 * 64
    for ours, all_of_it in zip(part.surfaces, whole.surfaces, strict=True):
        spread = np.hypot(ours.absorbed_se_W, all_of_it.absorbed_se_W)
        assert abs(ours.absorbed_W - all_of_it.absorbed_W) <= 5 * spread + 1e-9
    again, _ = part.irradiance_of([row.path_id for row in part.paths])
    np.testing.assert_allclose(again, part.irradiance, rtol=1e-12)
    report = mistray.ghosts(plates, [0, 2], wavelength_nm=[450, 650], rays=2_000_000, seconds=4)
    assert list(report) == [0, 2]
    for t in report.values():
        assert all(0 < run.started.sum() < run.rays for run in t.runs)


def pressing(after: float) -> Callable[[float, float], None]:
    return lambda done, _: os.kill(os.getpid(), signal.SIGINT) if done > after else None


def test_an_interrupt_keeps_the_fields_that_are_finished(
    plates: Any, small_launches: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(Interrupted) as caught:
        mistray.ghosts(plates, [1, 2, 3], rays=100_000, progress=pressing(1.5))
    report = caught.value.partial
    assert list(report) == [1, 2]
    assert report[1].rays_traced == 100_000 > report[2].rays_traced > 0
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(Interrupted) as caught:
        mistray.trace(plates, rays=200_000, progress=pressing(10_000))
    assert 10_000 < caught.value.partial.rays_traced < 30_000
    assert signal.getsignal(signal.SIGINT) is before
    assert not interrupts.requested()
    monkeypatch.setattr(interrupts, "_count", 1)
    with pytest.raises(KeyboardInterrupt):  # what was dropped is raised after the launch
        mistray.pst(plates, [0, 20], rays=1000)


def test_an_interrupt_keeps_all_but_a_table_that_takes_long(
    plates: Any, small_launches: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.import_module("mistray.execute.tracer"), "MOST_PATHS_KEPT", 3)
    with pytest.raises(Interrupted) as caught:
        mistray.trace(plates, rays=200_000, progress=pressing(-1))
    partial = caught.value.partial
    assert partial.irradiance.max() > 0
    assert not partial.has_paths
    with pytest.raises(mistray.MistrayError, match="no path table"):
        _ = partial.paths


@pytest.mark.long
def test_a_long_trace_names_the_limit_to_lower(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forecast = importlib.import_module("mistray.execute.forecast")
    monkeypatch.setattr(forecast, "FIRST_LOOK", 0.0)
    monkeypatch.setattr(forecast, "LONG", 1.0)
    monkeypatch.setattr(launches, "SECONDS", 0.05)
    scene = mistray.load(write(tmp_path, plates_text(8)))
    with pytest.warns(mistray.MistrayWarning, match=r"max_reflections \(6\)"), pytest.raises(Interrupted):
        mistray.trace(scene, rays=1e8, max_reflections=6, flux_threshold=1e-12, progress=pressing(100))


def test_mirrors_that_shut_light_in_end(tmp_path: Path) -> None:
    mirror = interface_xml(R=1.0, mirror=True)
    walls = [shape_xml("asphere", f"m{k}", 10.0 * k, mirror, semi_diameter=5.0) for k in (1, 2)]
    text = scene_text(*walls, shape_xml("asphere", "detector", 30.0, sensor=True, semi_diameter=1.0))
    t = mistray.trace(mistray.load(write(tmp_path, text)), rays=100)
    assert abs(t.energy.closure) < 1e-6

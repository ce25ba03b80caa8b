"""Backward traces: balance, books, passes that add up; launches of bounded time, which no number hangs on."""

import copy
import importlib
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
import vectors
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write
from oracles.statistics import assert_z

import mistray
from mistray import MistrayError
from mistray.errors import Interrupted
from mistray.events import EVENT_BITS
from mistray.execute import grid_trace
from mistray.execute.backward import BackwardTrace
from mistray.execute.cell_sums import BackwardSums
from mistray.execute.seen import Seen, see
from mistray.light import Light
from mistray.recorders.direction_recorder import GHOST
from mistray.recorders.directions import DirectionGrid
from mistray.settings import BATCHES, Settings

RAYS = 4096
GRID = DirectionGrid.of([0.0, 20.0, 50.0, 75.0], cell_deg=10.0)


def traced(scene: Any, grid: DirectionGrid = GRID, passes: int = 1, rays: int = RAYS, **arguments: Any) -> Any:
    own = {key: arguments.pop(key) for key in ("paths", "map_pixels") if key in arguments}
    trace = BackwardTrace(scene, grid, Settings.of(scene, **arguments), **own)
    for _ in range(passes):
        trace.advance(rays)
    return trace


@pytest.fixture(scope="module")
def wall_scene() -> Any:
    return mistray.load("plate_and_wall")


def balance(seen: Seen) -> tuple[float, float]:
    by_batch = sum(row.emission_by_batch for row in seen.rows)
    by_batch = by_batch + sum(part[2] for part in seen.media.values()) + seen.escaped[2] + seen.lost[2]
    return float(np.mean(by_batch)), float(np.std(by_batch, ddof=1) / np.sqrt(BATCHES))


@pytest.mark.long
def test_ghosts_by_two_roulettes(load_scene) -> None:
    """Followed by chance at each reflection and below the threshold: 5 standard errors (false alarm 6e-7)."""
    scene, found = load_scene(plates_text(4, R=0.2, T=0.8)), []
    for limits in ({}, {"flux_threshold": 0.1, "below_threshold": "roulette"}):
        trace = traced(scene, DirectionGrid.of([10.0], cell_deg=20.0), rays=8192, **limits)
        ghosts = trace.sums.by_batch(trace.unit)[GHOST, 0, 0]
        found.append((ghosts.mean(), ghosts.std(ddof=1) / np.sqrt(BATCHES)))
    (cut, cut_se), (played, se) = found
    assert_z("ghosts", played, cut, np.hypot(se, cut_se), k=5.0)
    assert se < 0.1 * cut


@pytest.mark.long
def test_the_threshold_is_relative_to_the_start(load_scene) -> None:
    """Rays aimed out of a deep tube start with some thousandths of the mean weight; ghosts of 1e-6 are no cut ones."""
    sides, shares = (("front", 0.0, "air", "1.5"), ("rear", 2.0, "1.5", "air")), {"R": 1e-3, "T": 0.999}
    plate = [shape_xml("asphere", name, z, interface_xml(*n, **shares), semi_diameter=5.0) for name, z, *n in sides]
    tube = shape_xml("frustum", "tube", 0.0, r0=5.0, z0=0.0, r1=5.0, z1=200.0)
    scene = load_scene(scene_text(*plate, tube, shape_xml("asphere", "d", 200.0, sensor=True, semi_diameter=5.0)))
    limits = ({"flux_threshold": 0.0}, {"flux_threshold": 1e-8}, {"flux_threshold": 0.0, "cut_below": "T=1e-7"})
    whole, *others = [traced(scene, **limit).sums.cells[GHOST] for limit in limits]
    assert whole.any()
    for found in others:
        np.testing.assert_array_equal(found, whole)


@pytest.mark.long
def test_a_wavelength_without_light(wall_scene) -> None:
    dark = {"wavelength_nm": [550.0, 600.0], "weights": [1, 0]}
    assert mistray.pst(wall_scene, [20.0], rays=1024, method="adjoint", **dark).facts["wavelength_nm"] == [550.0]
    energy = mistray.trace(wall_scene, rays=100, cut_below_W="T=1e-9", ledger=False, **dark).energy
    assert energy.launched_W > 0
    assert abs(energy.closure) < 1e-5


class TestSee:
    @pytest.mark.parametrize("name", ["plate_and_wall", "newtonian_scatter", "cooke_triplet"])
    def test_all_is_somewhere(self, name: str) -> None:
        """Emission + media + escaped + lost = 1 in vacuum, 4 standard errors (false alarm 6e-5), 1e-5 for rounding."""
        seen = see(mistray.load(name), rays=20_000, max_scatters=2)
        total, error = balance(seen)
        assert_z(name, total, 1.0, error, k=4.0, floor=1e-5)
        assert error < 0.02
        parts = [row.emission for row in seen.rows] + [value for value, *_ in seen.media.values()]
        assert total == pytest.approx(sum(parts) + seen.escaped[0] + seen.lost[0], rel=1e-9)
        assert total == pytest.approx(seen.whole, rel=1e-9)
        assert seen.escaped[0] > 0
        for row in seen.rows:
            assert row.share >= row.emission * (1 - 1e-6)
            assert row.emission >= 0

    @pytest.mark.parametrize("name", ["plate_and_wall", "cooke_triplet"])
    def test_limits_and_chances_are_booked(self, name: str) -> None:
        """Without aiming every start ray weighs 1, so that the balance holds in each batch: to 1e-5."""
        scene = mistray.load(name)
        for limits in vectors.toml("tables.toml")["limits of backward traces"]:
            total, error = balance(see(scene, rays=3200, aim="none", **limits))
            assert total == pytest.approx(1.0, abs=1e-5), limits
            assert error < 1e-6


def cell_sums(trace: BackwardTrace) -> np.ndarray:
    return trace.sums.cells.sum(axis=(0, 3)).ravel()


class TestPathBook:
    SETTINGS = {"paths": True, "max_scatters": 2, "max_reflections": 2}
    CELLS = DirectionGrid.of([0.0, 20.0, 50.0, 75.0], [0.0, 90.0, 180.0, 270.0], cell_deg=10.0)

    def test_listed_paths_add_up_to_the_cells(self, wall_scene, monkeypatch) -> None:
        trace = traced(wall_scene, self.CELLS, passes=2, **self.SETTINGS)
        book = trace.paths()
        cells = cell_sums(trace)
        assert np.all(cells > 0)
        by_batch = np.zeros((len(cells), BATCHES))
        np.add.at(by_batch, book["cell"], book["weight"])
        np.testing.assert_allclose(by_batch, trace.sums.cells.sum(axis=0).reshape(by_batch.shape), rtol=1e-9)
        assert len(book["events"]) == len(book["lengths"]) > 20
        assert len(np.unique(book["path"] * len(cells) + book["cell"])) == len(book["cell"])
        kinds = book["events"] & ((1 << EVENT_BITS) - 1)
        assert set(np.unique(kinds[np.arange(kinds.shape[1]) < book["lengths"][:, None]])) <= set(range(1, 6))
        plain = traced(wall_scene, self.CELLS, passes=2, **(self.SETTINGS | {"paths": False}))
        assert plain.paths() is None
        np.testing.assert_allclose(plain.sums.cells, trace.sums.cells, rtol=1e-12)
        whole = traced(wall_scene, self.CELLS, **self.SETTINGS)
        monkeypatch.setattr(grid_trace, "PATH_SLOTS", 16)
        monkeypatch.setattr(grid_trace, "ENTRY_SLOTS", 64)
        small = traced(wall_scene, self.CELLS, **self.SETTINGS)
        np.testing.assert_allclose(small.sums.cells, whole.sums.cells, rtol=1e-12)
        book = small.paths()
        assert 0 < len(book["lengths"]) <= 16 < len(whole.paths()["lengths"])
        assert 0 < len(book["cell"]) <= 64
        cells = cell_sums(small)
        listed = np.bincount(book["cell"], book["weight"].sum(axis=1), len(cells))
        assert np.all(listed <= cells * (1 + 1e-9))
        assert listed.sum() < 0.999 * cells.sum()


def assert_same(one: BackwardSums, other: BackwardSums) -> None:
    """Sums are of the same numbers in another order."""
    first, second = ({k: v for k, v in vars(sums).items() if isinstance(v, np.ndarray)} for sums in (one, other))
    assert set(first) == set(second)
    for key, values in first.items():
        scale = np.max(np.abs(values), initial=1e-300)
        np.testing.assert_allclose(second[key], values, rtol=1e-12, atol=1e-12 * scale, err_msg=key)


class TestPasses:
    SETTINGS = {"max_scatters": 2, "map_pixels": 3}

    def test_going_on_is_exact(self, wall_scene) -> None:
        whole = traced(wall_scene, passes=3, **self.SETTINGS)
        begun = traced(wall_scene, passes=2, **self.SETTINGS)
        resumed = traced(wall_scene, passes=0, **self.SETTINGS)
        before = copy.deepcopy(begun.sums)
        resumed.go_on_from(replace(begun.sums, seconds=7.5))
        resumed.advance(RAYS)
        assert_same(whole.sums, resumed.sums)
        np.testing.assert_allclose(whole.sums.maps[0].sum(axis=2).ravel(), cell_sums(whole), rtol=1e-12)
        assert resumed.sums.passes == 3
        assert resumed.sums.seconds > 7.5
        assert_same(before, begun.sums)  # the other trace keeps its own

    def test_another_seed_and_other_angles_compile_nothing(self, wall_scene) -> None:
        traced(wall_scene, seed=1, rays=1024)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            other = DirectionGrid.of([3.0, 30.0, 40.0, 88.0], cell_deg=4.0)
            traced(wall_scene, other, seed=2, rays=1024, passes=2, flux_threshold=1e-5)
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
        assert kernels
        fresh = [entry for entry in kernels if not entry["cache_hit"]]
        assert not fresh, f"{len(fresh)} of {len(kernels)} kernels were compiled anew"


def lens_text(radius: float = 30.0, reflectance: float = 0.02, b: float = 1e-3, index: str = "1.5") -> str:
    front = scattering_xml([bsdf_xml("abg", A=1e-4, B=b, g=2.0)], "air", index, R=reflectance, T=0.95)
    return scatter_scene(
        beam_xml(2.0),
        placed_xml("asphere", "front", front, radius=radius, semi_diameter=4.0),
        placed_xml("asphere", "rear", interface_xml(index, "air"), at=(0, 0, 3), semi_diameter=4.0),
        placed_xml("asphere", "detector", at=(0, 0, 40), pixels=4, semi_diameter=2.0),
    )


def test_settings_that_are_refused(wall_scene) -> None:
    for settings, words in (
        ({"polarization": "stokes"}, "polarization is 'stokes'; .* unpolarised light only"),
        ({"max_random_scatters": 1}, "max_random_scatters is 1; .* use max_scatters"),
    ):
        with pytest.raises(MistrayError, match=words):
            see(wall_scene, rays=100, **settings)
    grid = DirectionGrid.of(np.linspace(0, 90, 200), np.linspace(0, 359, 200))
    with pytest.raises(MistrayError, match="131072 paths in 40000 cells are too many"):
        BackwardTrace(wall_scene, grid, Settings(), paths=True)


def contents(book: dict[str, np.ndarray]) -> dict[tuple[tuple[int, ...], int], list[float]]:
    """(Event list, cell) → hits, and weight by batch."""
    lists = [tuple(row[:length].tolist()) for row, length in zip(book["events"], book["lengths"], strict=True)]
    sums = np.column_stack([book["hits"], book["weight"]]).tolist()
    return {(lists[p], c): v for p, c, v in zip(book["path"].tolist(), book["cell"].tolist(), sums, strict=True)}


def test_joined_books_of_two_traces_are_the_book_of_both(wall_scene, load_scene) -> None:
    settings = {"paths": True, "max_scatters": 1}
    whole = traced(wall_scene, passes=2, **settings).paths()
    begun = traced(wall_scene, **settings)
    resumed = traced(wall_scene, passes=0, **settings)
    empty = resumed.paths()
    resumed.go_on_from(begun.sums)
    resumed.advance(RAYS)
    halves = begun.paths(), resumed.paths()
    for books in (halves, halves[::-1], (empty, whole), (whole, empty)):
        found, expected = contents(books[0] + books[1]), contents(whole)
        assert set(found) == set(expected)
        for key, values in expected.items():
            assert found[key] == pytest.approx(values, rel=1e-9)

    def of(change: dict[str, Any], grid: DirectionGrid = GRID, nm: Any = None, **settings: Any) -> str:
        scene, light = load_scene(lens_text(**change)), Light(wavelength_nm=nm)
        return BackwardTrace(scene, grid, Settings(**settings), light).fingerprint

    first = of({})
    assert first == of({}) == of({}, DirectionGrid.of([15.0], cell_deg=30.0), seed=2, rays=7)
    changes = {"radius": 30.001}, {"reflectance": 0.021}, {"b": 1.01e-3}, {"index": "1.501"}
    prints = {first, *map(of, changes), *(of({"index": "N-BK7"}, nm=nm) for nm in (500.0, 600.0, [500.0, 600.0]))}
    assert len(prints) == 1 + len(changes) + 3


launches = importlib.import_module("mistray.kernel.launches")
interrupts = importlib.import_module("mistray.interrupts")
MANY = 40_000


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
    whole = mistray.trace(loaded, rays=MANY, field_deg=3)
    monkeypatch.undo()
    request.getfixturevalue("small_launches")
    done: list[int] = []
    parts = mistray.trace(loaded, rays=MANY, field_deg=3, progress=lambda rays, _: done.append(rays))
    assert len(done) > 10
    assert done == sorted(done)
    assert (done[-1], parts.rays_traced, parts.segments) == (MANY, MANY, whole.segments)
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
    assert np.ptp(part.runs[0].started) <= 3 * 64
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
    assert abs(mistray.trace(mistray.load(write(tmp_path, text)), rays=100).energy.closure) < 1e-6

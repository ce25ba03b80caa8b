"""A result beside that with one more event on each path, curves with other limits, and a term that reaches 0."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write

import mistray
from mistray import MistrayError, Pst
from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import optimization_record, report_text
from mistray.analyses.pst.figures import level_curves
from mistray.analyses.pst.next_order import with_next_orders
from mistray.analyses.pst.tables import pst_record, pst_text
from mistray.metrics.next_order import NextOrder, next_limits
from mistray.optimize import Metric, optimize
from mistray.recorders.direction_recorder import CLASSES
from mistray.recorders.directions import DirectionGrid
from mistray.settings import NO_LIMIT, Settings
from mistray.surfaces.surfaces import SurfaceTable

HALF = 0.5  # R of both faces of the plate; T is as much


def order(before: Any, after: Any, se: Any) -> NextOrder:
    before, after, se = (np.atleast_1d(np.asarray(values, float)) for values in (before, after, se))
    names = tuple(f"number {k}" for k in range(len(before)))
    return NextOrder("max_scatters", 2, names, before, se, after, se, np.sqrt(2) * se)


def test_more_than_two_errors_and_5_percent() -> None:
    """Of 2000 pairs of equal curves of 41 angles 4.6 % alarm, the rate of one number; 6 % has a chance of 2e-3."""
    for before, after, se, matters in (
        (1.0, 1.2, 0.01, True),
        (1.0, 0.8, 0.01, True),
        (1.0, 1.04, 1e-4, False),  # for certain, but less than 5 %
        (1.0, 1.2, 0.1, False),  # 1.4 errors of the difference
        (0.0, 1e-12, 1e-13, True),
        (0.0, 0.0, 0.0, False),
        (1.0, np.nan, 0.1, False),
        (np.nan, np.nan, np.nan, False),
    ):
        found = order(before, after, se)
        assert found.matters == matters
        assert json.dumps(found.record())
    found = order([1.0, 1.0, 1e-9], [1.3, 1.1, 1e-8], [0.01, 0.01, 1e-8])  # the last is ten times larger, by chance
    assert found.worst == 0
    assert "number 0" in found.sentence
    draws = np.random.default_rng(5).normal(1.0, 0.1, (2000, 2, 41))
    assert np.mean([order(before, after, np.full(41, 0.1)).matters for before, after in draws]) < 0.06


def curve(level: float, rays: int = 1000, seed: int = 0) -> Pst:
    """A PST of scattered light at two angles, 10 and 20°, the second ten times darker, with an error of 2 %."""
    grid = DirectionGrid.of([10.0, 20.0])
    by_batch = np.zeros((len(CLASSES), *grid.shape, 32))
    noise = np.random.default_rng(seed).normal(1.0, 0.02 * np.sqrt(32), (2, 1, 32))
    by_batch[CLASSES.index("single_scatter")] = level * np.array([1.0, 0.1])[:, None, None] * noise
    facts = {"settings": asdict(Settings()), "wavelength_nm": [550.0], "detector": "detector"}
    facts |= {"rays": rays, "seconds": 50, "notes": []}
    return Pst(grid, by_batch, np.full(32, 1 / 32), facts=facts)


def test_the_pst_shown_is_that_which_changes_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of the same rays are those of the batches' differences; of others both errors add up."""
    first, asked = curve(1e-6), []
    of_limit = {"max_scatters": curve(1.5e-6), "max_reflections": curve(1.2e-6, rays=500, seed=1)}

    def measure(rays: int, **limit: int) -> Pst:
        ((name, allowed),) = limit.items()
        asked.append((name, allowed, rays))
        return of_limit[name]

    found = with_next_orders(mistray.load("baffle_tube"), first, 60.0, measure)
    assert asked == [("max_scatters", 2, 500), ("max_reflections", 3, 500)]  # of 1000, whatever the time was
    forward = replace(first, method="forward", facts=first.facts | {"rays_of_cell": [[800], [200]]})
    with_next_orders(mistray.load("baffle_tube"), forward, 60.0, measure)
    assert asked[2:] == [("max_scatters", 2, 400), ("max_reflections", 3, 400)]  # of each angle
    scatter, reflection = found.next_orders
    assert np.array_equal(found.by_batch, of_limit["max_scatters"].by_batch)
    assert (scatter.taken, reflection.taken, reflection.matters) == (True, False, True)
    assert scatter.difference_se == pytest.approx(0.5 * first.stray_se, rel=1e-9)  # every batch half as bright again
    assert reflection.difference_se == pytest.approx(np.hypot(reflection.before_se, reflection.after_se), rel=1e-9)
    assert scatter.sentence in pst_text(found)
    assert [item["taken"] for item in pst_record(found)["next_orders"]] == [True, False]
    of_limit = {name: curve(1.01e-6) for name in of_limit}
    same = with_next_orders(mistray.load("baffle_tube"), first, 60.0, measure)
    assert np.array_equal(same.by_batch, first.by_batch)
    assert [order.taken for order in same.next_orders] == [False, False]
    # Of a time that suffices for one of them the result tells, whichever PST it is
    lefts, of_limit = iter([100.0, 0.0]), {"max_scatters": curve(1.5e-6)}
    monkeypatch.setattr("mistray.analyses.pst.next_order.left", lambda: next(lefts))
    short = with_next_orders(mistray.load("baffle_tube"), first, 60.0, measure)
    assert np.array_equal(short.by_batch, of_limit["max_scatters"].by_batch)
    assert short.facts["notes"] == ["the time was up before max_reflections = 3 was measured"]
    assert first.facts["notes"] == []
    plain, rough = (SurfaceTable(mistray.load(name), 550.0) for name in ("cooke_triplet", "baffle_tube"))
    assert next_limits(Settings(), rough) == {"max_scatters": 2, "max_reflections": 3}
    assert next_limits(Settings(), plain) == {"max_reflections": 3}
    assert next_limits(Settings(max_scatters=0, max_reflections=0), rough) == {}
    assert next_limits(Settings(max_scatters=NO_LIMIT), rough) == {"max_reflections": 3}


def test_a_baffle_without_light_of_one_scatter() -> None:
    """From 40° the lens sees no wall that is lit: what arrives has been scattered twice at least."""
    scene = mistray.load("baffle_tube")
    once = mistray.pst(scene, [40.0], rays=16_000, max_scatters=1, seed=3)
    twice = mistray.pst(scene, [40.0], rays=8_000, max_scatters=2, seed=3)  # half of the rays, whatever the time
    found = mistray.pst(scene, [40.0], rays=16_000, max_scatters=1, seed=3, next_order=True)
    assert found.facts["settings"]["max_scatters"] == 2
    assert found.stray[0] == pytest.approx(twice.stray[0], rel=1e-12) != pytest.approx(once.stray[0])
    scatter, reflection = found.next_orders
    assert (scatter.limit, scatter.taken, scatter.before[0]) == ("max_scatters", True, once.stray[0])
    assert ((reflection.limit, reflection.taken), once.next_orders) == (("max_reflections", False), ())


@pytest.mark.parametrize(("trace", "more"), [({"max_reflections": 1}, HALF**2), ({}, 0.0)])
def test_a_search(tmp_path: Path, trace: dict[str, int], more: float) -> None:
    """T² arrives directly and T² R² after two reflections, of which one too few were allowed, or enough."""
    faces = [
        shape_xml("asphere", name, z, interface_xml(*sides, R=HALF, T=1 - HALF), semi_diameter=50.0)
        for name, z, sides in (("front", 5.0, ("air", "1.5")), ("rear", 8.0, ("1.5", "air")))
    ]
    detector = shape_xml("asphere", "detector", 20.0, sensor=True, semi_diameter=50.0)
    scene = write(tmp_path, scene_text(shape_xml("asphere", "disc", 1.0, semi_diameter=0.4), *faces, detector))
    study = {
        "trace": {"rays": 400, **trace},
        "term": [{"name": "light", "kind": "path_power", "goal": "minimise", "selection": "all"}],
        "variable": [{"parameters": ["disc.semi_diameter"], "low": 0.2, "high": 0.6}],
        "optimizer": {"steps": 1},
    }
    result = optimize(scene, study, verification_seeds=4)
    (found,) = result.next_orders
    taken = more > 0
    assert (found.limit, found.allowed, found.taken) == ("max_reflections", 2 if taken else 3, taken)
    assert found.after[0] / found.before[0] == pytest.approx(1 + more, rel=1e-5)
    if taken:
        assert result.comparison.total.after == pytest.approx(found.after[0], rel=1e-12)
        assert found.sentence in report_text(result)
        assert optimization_record(result)["next_orders"][0]["taken"] is True
    else:
        alone = optimize(scene, study, verification_seeds=4, next_order=False)
        assert alone.next_orders == ()
        assert alone.comparison.total.after == pytest.approx(result.comparison.total.after, rel=1e-12)


ANGLES = [0.0, 30.0, 60.0]


def test_limits_of_curves_and_progress():
    scene = mistray.load("plate_and_wall")
    found = mistray.first_level(scene, ANGLES, rays=40_000, max_scatters=2, max_reflections=3)
    limits = {"scatter once": [1, 0], "ghosts off": [2, 0], "scatter off": [0, 3], "all": [2, 3]}
    for name, one in found.curves.items():
        assert [one.facts["settings"][f"max_{what}"] for what in ("scatters", "reflections")] == limits[name]
    table = found.to_pandas()
    assert list(table.columns) == ["angle_deg", *(f"{name}{end}" for name in limits for end in ("", "_se"))]
    np.testing.assert_array_equal(table.angle_deg, ANGLES)
    np.testing.assert_array_equal(table["all"], found.curves["all"].curve("stray")[0])
    np.testing.assert_array_equal(found.to_pandas("direct")["all"], found.curves["all"].curve("direct")[0])
    slack = 5 * (table["all_se"] + table["scatter once_se"])
    assert np.all(table["scatter once"] <= table["all"] + slack)
    assert np.all(table["scatter off"] <= table["all"] + slack)
    assert not np.any(found.curves["scatter once"].curve("multiple_scatter")[0])
    assert np.any(found.curves["ghosts off"].curve("multiple_scatter")[0] > 0)
    assert not np.any(found.curves["ghosts off"].curve("ghost")[0])
    assert not np.any(found.curves["scatter off"].curve("single_scatter")[0])
    found = mistray.first_level(scene, [0.0, 20.0], rays=1000)
    assert found.curves["scatter once"] is found.curves["ghosts off"]
    seen = []
    limits = {"one ghost": {"max_reflections": 1}, "two": {"max_reflections": 2, "max_scatters": 0}}
    found = mistray.first_level(scene, [0.0], limits=limits, rays=1000, progress=lambda name, now: seen.append(name))
    assert (list(found.curves), found.limits) == (list(limits), limits)
    assert list(dict.fromkeys(seen)) == list(limits)
    many = mistray.first_level(scene, [0.0], limits={f"set {k}": {} for k in range(20)}, rays=1000)
    assert len(level_curves(many).axes[0].containers) == 20  # more than there are colours
    with pytest.raises(MistrayError, match="limits is empty"):
        mistray.first_level(scene, limits={})
    with pytest.raises(MistrayError, match="next_order would change the limits of the sets"):
        mistray.first_level(scene, next_order=True)
    with pytest.raises(MistrayError, match="limits of 'x': there is no 'max_ghosts'; "):
        mistray.first_level(scene, limits={"x": {"max_ghosts": 1}})


BEAM, BLOCK, FARTHEST = 5.0, 2.0, 9.0  # radii, mm


@pytest.fixture
def beam(tmp_path: Path) -> Path:
    """A beam with a black disc before a detector: 1 - (r/5)² of the light gets past it, and none from r = 5 on."""
    detector = shape_xml("asphere", "detector", 10.0, sensor=True, half_width=BEAM, half_height=BEAM)
    return write(tmp_path, scene_text(shape_xml("asphere", "disc", 5.0, semi_diameter=BLOCK), detector, radius=BEAM))


def study(*terms: dict[str, Any], method: str = "sqp", **optimizer: Any) -> dict[str, Any]:
    return {
        "trace": {"rays": 500},
        "term": [{"goal": "minimise", "selection": "all", **term} for term in terms],
        "variable": [{"parameters": ["disc.semi_diameter"], "low": 0.5, "high": FARTHEST}],
        "optimizer": {"method": method, "step_size": 0.4, **optimizer},
    }


@pytest.mark.parametrize("method", ["sqp", "lbfgsb", "adam"])
@pytest.mark.parametrize("kind", ["path_power", "ghost_rms_irradiance"])
def test_a_closed_gap_is_the_result(beam: Path, tmp_path: Path, kind: str, method: str) -> None:
    result = optimize(beam, study({"kind": kind}, method=method), verification_seeds=2)
    assert result.best.terms == {kind: 0.0}
    assert BEAM < result.after["disc.semi_diameter"] <= FARTHEST
    assert "is 0" in result.ended[0]
    assert result.comparison.total.before > 0
    assert (result.comparison.total.after, np.isnan(result.comparison.total.ratio)) == (0.0, True)
    assert np.isfinite(result.best.merit)
    assert "is 0" in report_text(result)
    assert json.loads(json.dumps(optimization_record(result)))["terms"][0]["after"] == 0
    if (kind, method) == ("path_power", "sqp"):
        names = [file.name for file in write_optimization(result, tmp_path / "out")]
        assert {"scene.xml", "report.html", "search.png"} <= set(names)
        assert ", <b>nothing is left</b>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_zero_does_not_outweigh_a_limit(beam: Path) -> None:
    """A disc that takes all the light breaks the limit on what it may take."""
    limit = {"name": "light", "kind": "path_power", "goal": "at_least", "limit_of_start": 0.9, "tolerance": 0.01}
    result = optimize(beam, study({"kind": "path_power"}, limit), verification_seeds=2)
    assert result.best.terms["path_power"] > 0  # the limit costs 1e4 where all light is lost, ln 1e15 is 35
    assert result.best.broken == ()


def test_zero_reflectance_of_a_coating(tmp_path: Path) -> None:
    """A quarter wave of n = √1.5 on n = 1.5 reflects nothing at its wavelength."""
    index = 1.5**0.5
    coated = {
        "term": [{"kind": "path_power", "goal": "minimise", "wavelength_nm": 550.0, "rays": 32}],
        "coating": [{"name": "AR", "surfaces": "all", "layers": f"{index} 60", "thickness_nm": [20.0, 180.0]}],
        "optimizer": {"starts": 1},
    }
    result = optimize(write(tmp_path, plates_text(1)), coated, verification_seeds=2)
    assert result.thickness_nm("AR") == pytest.approx([550 / 4 / index], abs=0.1)
    assert np.isfinite(result.best.merit)


def test_a_point_without_a_merit_ends_the_search_and_keeps_its_steps(beam: Path) -> None:
    """The RMS radius of no light is no number. Past the disc the ring of light has r_rms² = (5² + r²)/2."""
    found = optimize(beam, study({"kind": beyond_the_disc}), verification_seeds=2)
    assert "no merit" in found.ended[0]
    assert found.best.step == 0
    assert found.best.terms["beyond_the_disc"] == pytest.approx(2 / (BEAM**2 + BLOCK**2), rel=0.05)


def beyond_the_disc(scene: Any, selection: str, **traced: Any) -> Any:
    """1/r_rms², which falls as the disc grows."""
    seen = {key: value for key, value in traced.items() if key not in ("field_deg", "wavelength_nm", "weights")}
    return Metric(scene, lambda observations: 1 / observations[0].moments(selection).variance, settings=seen)

"""Searches on functions whose minima are known, start designs, variables, and what is refused."""

import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from refusals import refused

import mistray
from mistray.analyses.optimize.search import stop_reason
from mistray.analyses.optimize.search.point import Pieces
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.analyses.optimize.study.searches import Searches
from mistray.analyses.optimize.study.starts import Proxy, minima, starts
from mistray.analyses.optimize.study.state import Evaluation, State
from mistray.analyses.optimize.study.study_scene import PlacedDesign, place
from mistray.analyses.optimize.study.variables import Variable, VariablePlace, Variables, find_variables
from mistray.optimize import Optimizer, Parameter, Start, Step, parameters, read_study

NLOPT = pytest.mark.skipif(find_spec("nlopt") is None, reason="the extra 'nlopt' is not installed")
METHODS = [
    Optimizer(method="sqp", steps=200, tolerance=0),
    Optimizer(method="lbfgsb", steps=200, tolerance=0),
    Optimizer(method="adam", steps=400, tolerance=0, step_size=0.03, decay=0.98),
    *(
        pytest.param(Optimizer(method="nlopt", algorithm=name, steps=200, tolerance=0), id=name, marks=NLOPT)
        for name in ("LD_MMA", "LD_SLSQP", "LD_CCSAQ")
    ),
]


class Bowl:
    """A quadratic merit with a known minimum, perhaps noisy, slow, or interrupted after some evaluations."""

    start: dict[str, float] | None = None

    def __init__(
        self, centre: list[float], noise: float = 0.0, least: float = -np.inf, *, pause: float = 0.0, last: int = 10**9
    ) -> None:
        self.centre, self.noise, self.least, self.pause, self.last = np.array(centre), noise, least, pause, last
        self.calls: list[np.ndarray] = []
        self.width = 1.0 + np.arange(len(centre))

    def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
        time.sleep(self.pause)
        if len(self.calls) == self.last:
            raise KeyboardInterrupt
        self.calls.append(y.copy())
        draw = self.noise * np.random.default_rng(number).standard_normal(len(y) + 1)
        away = y - self.centre
        merit = float(np.sum(self.width * away**2)) + draw[0] * float(np.linalg.norm(away))
        found = {"merit": merit, "merit_se": self.noise, "slope": 2 * self.width * away + draw[1:]}
        return found | {"terms": {"bowl": merit}, "slopes": {}, "traced_seconds": 0.0, "left_out": ["nothing"]}

    def pieces(self, at: Evaluation) -> Pieces | None:
        none = np.zeros(0)
        return Pieces(at.slope, none, none, np.zeros((0, len(at.y))), none.astype(bool))

    def broken(self, values: dict[str, float]) -> tuple[str, ...]:
        return ("bowl",) if values["bowl"] > 1 else ()


def searches(problem: Any, optimizer: Optimizer, state: State, **more: Any) -> Searches:
    made = Searches(problem, lambda x: x / 10, lambda y: 10 * y, optimizer, state, **more)
    made.run()
    return made


def begin(*starts: list[float]) -> State:
    return State([Start(f"start {k}", np.array(x, dtype=np.float64)) for k, x in enumerate(starts)])


@pytest.mark.parametrize("optimizer", METHODS)
class TestMethods:
    @pytest.mark.parametrize("centre", [(0.3, 0.6, 0.5), (-0.5, 0.6, 1.5)])
    def test_minimum(self, optimizer: Optimizer, centre: tuple[float, ...]) -> None:
        """Of a separable function it lies at the nearest point of the unit cube."""
        problem = Bowl(list(centre))
        done = searches(problem, optimizer, begin([5, 5, 5]))
        assert done.best.x == pytest.approx(10 * np.clip(centre, 0, 1), abs=0.02)
        assert done.best.merit == min(step.merit for step in done.steps)
        assert all(np.all((y >= 0) & (y <= 1)) for y in problem.calls)

    def test_no_more_steps_than_asked_for(self, optimizer: Optimizer) -> None:
        done = searches(Bowl([0.3, 0.6]), replace(optimizer, steps=3), begin([1, 9]))
        assert [step.step for step in done.steps] == [0, 1, 2, 3]
        assert [step.share_done for step in done.steps] == [0.25, 0.5, 0.75, 1.0]
        assert done.ended == {0: "all steps used"}
        none = searches(Bowl([0.3, 0.6]), replace(optimizer, steps=0), begin([1, 9]))
        assert (len(none.steps), none.ended) == (1, {0: "all steps used"})

    def test_interrupted_is_uninterrupted(self, optimizer: Optimizer, tmp_path: Path) -> None:
        """Interrupted after any evaluation, and resumed from the file: the same steps, to the last bit."""
        noise, how = 0.0, replace(optimizer, steps=9)
        if optimizer.method == "adam":
            noise, how = 0.05, replace(how, seeds="fresh")
        scene = tmp_path / "scene.xml"
        scene.write_text("<scene/>")
        whole = searches(Bowl([0.3, 0.6], noise), how, begin([1, 9]))
        total = whole.steps[-1].evaluations
        for after in (1, 2, total // 2, total - 1):
            file = Checkpoint(tmp_path / "checkpoint.json", scene, "study")
            problem = Bowl([0.3, 0.6], noise, last=after)
            with pytest.raises(KeyboardInterrupt):
                searches(problem, how, begin([1, 9]), file=file)
            assert len(problem.calls) == after
            again = Bowl([0.3, 0.6], noise)
            seen: list[Step] = []
            resumed = searches(again, how, file.read(), file=file, progress=lambda step, start: seen.append(step))  # noqa: B023
            assert len(again.calls) <= total - after + 1
            for one, other in zip(resumed.steps, whole.steps, strict=True):
                assert replace(one, seconds=0.0) == replace(other, seconds=0.0)
            assert resumed.ended == whole.ended
            assert all(b.seconds >= a.seconds for a, b in zip(resumed.steps, resumed.steps[1:], strict=False))
            assert seen == resumed.steps[-len(seen) :], "steps that were made before are not shown again"

    def test_going_on_for_longer(self, optimizer: Optimizer) -> None:
        whole = searches(Bowl([0.3, 0.6]), replace(optimizer, steps=8), begin([1, 9]))
        state, problem = begin([1, 9]), Bowl([0.3, 0.6])
        short = searches(Bowl([0.3, 0.6]), replace(optimizer, steps=3), state)
        still = searches(problem, replace(optimizer, steps=0), state)
        assert (still.steps, problem.calls) == (short.steps, []), "the result as it stands"
        longer = searches(problem, replace(optimizer, steps=8), state)
        assert [step.x for step in longer.steps] == [step.x for step in whole.steps]

    def test_searches_end_in_time_and_can_go_on(self, optimizer: Optimizer) -> None:
        whole = searches(Bowl([0.3, 0.6]), optimizer, begin([1, 9], [8, 8]))
        state = begin([1, 9], [8, 8])
        began = time.monotonic()
        done = searches(Bowl([0.3, 0.6], pause=0.05), optimizer, state, seconds=0.3)
        assert time.monotonic() - began < 1.0
        assert 1 < sum(len(kept) for kept in state.evaluations) <= 6
        assert set(done.ended.values()) == {"the time was up"}
        more = searches(Bowl([0.3, 0.6]), optimizer, state)
        assert [step.merit for step in more.steps] == [step.merit for step in whole.steps]
        # The first start is evaluated whatever the time
        done = searches(Bowl([0.3, 0.6], pause=0.05), optimizer, begin([1, 9], [8, 8]), seconds=1e-3)
        assert [(step.start, step.step) for step in done.steps] == [(0, 0)]
        assert done.best.x == pytest.approx([1, 9])


class Valley(Bowl):
    """Minimise -ln v, v = 1 + y0 + 2 y1, between walls 1000 times as steep, straight or bent, on one side or on both.

    The residual is (y0 + y1 - 1 + bend (y0 - y1)²) / 1e-3; with `one_sided` it counts above 0 only.
    """

    def __init__(self, bend: float, one_sided: bool) -> None:
        super().__init__([0.0, 0.0])
        self.bend, self.one_sided = bend, one_sided

    def apart(self, y: np.ndarray) -> tuple[float, np.ndarray, float, np.ndarray]:
        v, gap = 1 + y[0] + 2 * y[1], y[0] - y[1]
        r = (y[0] + y[1] - 1 + self.bend * gap**2) / 1e-3
        row = np.array([1 + 2 * self.bend * gap, 1 - 2 * self.bend * gap]) / 1e-3
        return -np.log(v), -np.array([1.0, 2.0]) / v, r, row

    def pieces(self, at: Evaluation) -> Pieces:
        _, slope, r, row = self.apart(at.y)
        return Pieces(slope, np.ones(1), np.array([r]), row[None], np.array([self.one_sided]))

    def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
        value, slope, r, row = self.apart(y)
        r = max(r, 0.0) if self.one_sided else r
        return {**super().evaluate(y, number), "merit": value + r**2, "slope": slope + 2 * r * row}


class TestValleys:
    """Limits are steep against what is to be minimised; the way along them must not be lost in that."""

    @pytest.mark.parametrize("one_sided", [False, True])
    @pytest.mark.parametrize("bend", [0.0, 0.2])
    def test_along_a_wall(self, bend: float, one_sided: bool) -> None:
        """The optimum on the wall, from a parametrisation of it; the penalty there is less than 1e-3."""
        problem = Valley(bend, one_sided)
        done = searches(problem, Optimizer(method="sqp", tolerance=1e-6), begin([7, 3 if bend == 0 else 2.5]))
        gaps = np.linspace(-1, 1, 200_001)  # y0 - y1 on the wall
        total = 1 - bend * gaps**2
        wall = np.stack([(total + gaps) / 2, (total - gaps) / 2])
        wall = wall[:, np.all((wall >= 0) & (wall <= 1), axis=0)]
        best = wall[:, np.argmax(wall[0] + 2 * wall[1])]
        assert np.array(done.best.x) / 10 == pytest.approx(best, abs=0.02)
        assert done.best.merit == pytest.approx(-np.log(1 + best[0] + 2 * best[1]), abs=1e-3)
        assert len(problem.calls) < 100

    def test_from_far_beyond_a_limit(self) -> None:
        """A start that breaks a limit by 300 widths of its zone comes back first."""
        done = searches(Valley(0.0, True), Optimizer(method="sqp", tolerance=1e-6), begin([9, 4]))
        assert done.best.x == pytest.approx([0, 10], abs=0.1)


class TestDriver:
    @pytest.mark.parametrize("method", ["sqp", "lbfgsb", "adam"])
    def test_first_trial_is_small(self, method: str) -> None:
        """No coordinate moves by more than `step_size`; NLopt's methods choose their own."""
        problem, optimizer = Bowl([0.9, 0.1]), Optimizer(method=method, step_size=0.03)
        searches(problem, optimizer, begin([2, 5]))
        assert np.max(np.abs(problem.calls[1] - problem.calls[0])) == pytest.approx(0.03, rel=1e-6)

    def test_searches_from_the_best_starts(self) -> None:
        problem = Bowl([0.5])
        done = searches(problem, Optimizer(searches=2), begin([9], [4], [0]))
        counts = [step.evaluations for step in done.steps]
        assert counts == sorted(counts)
        assert counts[-1] == len(problem.calls)
        assert [(step.start, step.step) for step in done.steps[:3]] == [(0, 0), (1, 0), (2, 0)]
        assert set(done.ended) == {0, 1}
        assert done.best.x == pytest.approx([5], abs=0.01)

    def test_all_limits_hold(self) -> None:
        """A merit of limits alone is over when it is 0."""

        class Ramp(Bowl):
            def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
                short = np.maximum(0.5 - y, 0)
                return super().evaluate(y, number) | {"merit": float(np.sum(short**2)), "slope": -2 * short}

        done = searches(Ramp([0.0], least=0.0), Optimizer(), begin([1]))
        assert (done.best.merit, done.ended) == (0, {0: "all limits hold"})

    def test_fresh_seeds_take_the_last_step(self) -> None:
        """The least of noisy merits is the luckiest; the last step is what the search found."""
        how = Optimizer(method="adam", seeds="fresh", steps=60, tolerance=0, step_size=0.05, decay=0.95)
        done = searches(Bowl([0.3, 0.6], noise=0.1), how, begin([9, 1]))
        assert done.best is done.steps[-1]
        assert done.best.x == pytest.approx([3, 6], abs=0.5)

    def test_a_state_of_another_search(self) -> None:
        state = begin([1, 9])
        searches(Bowl([0.3, 0.6]), Optimizer(steps=3), state)
        with refused(r"asks for other points than before.*run without resuming"):
            searches(Bowl([0.3, 0.6]), Optimizer(steps=3, step_size=0.1), state)


@pytest.mark.parametrize(
    ("merits", "tolerance", "fresh", "reason"),
    [
        ([3, 2, 1], 1e-3, False, None),
        ([3, 2, 1.9995, 1.9994], 1e-3, False, "the last 2 steps have lowered the merit by less than 0.001"),
        ([3, 2, 1.9995, 1.99], 1e-3, False, None),
        ([3, 2, 4, 5], 1e-3, False, "the last 2 steps"),
        ([3, 2.9999], 1e-3, False, None),
        ([1] * 100, 0, False, None),
        # Means count: one lucky step neither ends a search nor keeps it going
        ([5, 4, 3, 2], 1e-3, True, None),
        ([5, 1, 3, 3.1], 1e-3, True, "the mean merit of 2 steps"),
        ([9, 9, 5, 1, 3, 2.9], 1e-3, True, None),
        ([1, 1, 1], 1e-3, True, None),
        ([1] * 100, 0, True, None),
    ],
)
def test_stop(merits: list[float], tolerance: float, fresh: bool, reason: str | None) -> None:
    found = stop_reason(merits, tolerance, 2, fresh)
    assert (found is None) == (reason is None)
    assert reason is None or reason in str(found)


def test_nlopt_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nlopt", None)
    term, variable = {"kind": "path_power", "goal": "minimise"}, {"parameters": "x", "low": 0, "high": 1}
    with refused(r"optimizer\.method.*nlopt is not installed; pip install 'mistray\[nlopt\]'"):
        read_study({"term": [term], "variable": [variable], "optimizer": {"method": "nlopt"}})


def placed_coating(layers: str, surfaces: list[str], bounds: list[float]) -> PlacedDesign:
    coating = {"name": "AR", "surfaces": surfaces, "layers": layers, "thickness_nm": bounds}
    study = {"term": [{"kind": "path_power", "goal": "minimise"}], "coating": [coating]}
    (placed,) = place(mistray.load("cooke_triplet"), read_study(study))
    return placed


def test_proxy_and_its_minima() -> None:
    """Against the coating's own response, from the air on both sides of a lens, whatever side is the front."""
    placed = placed_coating("1.38 90, 2.1 120", ["L1_front", "L1_rear"], [10.0, 200.0])
    proxy = Proxy.of(placed, (500.0, 600.0), (0.25, 0.75))
    stack = placed.stack((90.0, 120.0))
    expected = 0.0
    for nm, weight in ((500.0, 0.25), (600.0, 0.75)):
        n = mistray.materials.complex_index("N-LAK9", nm)
        for from_front, sides in ((True, (1 + 0j, n)), (False, (n, 1 + 0j))):
            answer = stack.response(nm, *sides, np.cos(np.radians([0.0, 15.0, 30.0, 45.0])), from_front)
            expected += weight * np.mean(answer.R.mean(axis=1) ** 2) / 2
    assert proxy(np.array([[90.0, 120.0], [50.0, 50.0]]))[0] == pytest.approx(expected, rel=1e-12)
    # Of one layer at one wavelength: odd quarter waves, the one next to the given design among them, each once
    placed = placed_coating("1.38 530", ["L1_front"], [20.0, 600.0])
    proxy = Proxy.of(placed, (550.0,), (1.0,))
    found = minima(proxy, placed.group.bounds_nm, np.array([530.0]), seed=0)
    quarter = min(d[0] for d in found)
    assert sorted(round(d[0] / quarter) for d in found) == [1, 3, 5]
    assert np.all(np.diff([proxy(d[None])[0] for d in found]) >= -1e-12)


def test_latin_hypercube_and_minima_of_coatings() -> None:
    """One point in each of as many equal parts of the way from bound to bound, which is one of ratios here."""
    params = {"AR.thickness_nm": [90.0], "vane.r0": [12.0]}
    layer = Variable("d[0]", "nm", 10.0, 200.0, "linear", (VariablePlace("AR.thickness_nm", 0, 1.0, 90.0),))
    radius = Variable("r", "mm", 1.0, 100.0, "log", (VariablePlace("vane.r0", 0, 1.0, 12.0),))
    alone = Variables(params, [radius])
    given, *others = starts(alone, (), (), (), 9, 3)
    assert (given.name, given.x.tolist()) == ("given", [12.0])
    shares = sorted(float(alone.shares(start.x)[0]) for start in others)
    assert [int(8 * share) for share in shares] == list(range(8))
    again = starts(alone, (), (), (), 9, 3)
    assert [start.x.tolist() for start in again[1:]] == [start.x.tolist() for start in others]
    placed = placed_coating("1.38 90", ["L1_front"], [10.0, 400.0])
    given, *others = starts(Variables(params, [layer, radius]), (placed,), (550.0,), (1.0,), 4, 0)
    assert given.x.tolist() == [90.0, 12.0]
    assert 1 <= len(others) <= 3, "as many as there are minima"
    assert [start.x[1] for start in others] == [12.0] * len(others)
    grid, proxy = np.linspace(10.0, 400.0, 4001), Proxy.of(placed, (550.0,), (1.0,))
    assert others[0].x[0] == pytest.approx(grid[np.argmin(proxy(grid[:, None]))], abs=0.2)
    assert others[0].name == "minimum 1 of the mean square R"


VALUES = vectors.toml("tables.toml")["parameters of a search"]
KINDS = {"r0": ("mm", 0.0), "curvature": ("1/mm", -1.0), "z": ("mm", -1e3), "A": ("1/sr", 0.0)}
KINDS["thickness_nm"] = "nm", 0.0
KNOWN = {
    key: Parameter(key, "rim", unit, np.array(value), 0, name, ("shape",), 0.1, low, 1000.0)
    for key, value in VALUES.items()
    for name, (unit, low) in KINDS.items()
    if key.endswith(f".{name}")
}


def variables(*sections: dict[str, Any], coatings: dict[str, str] | None = None, **study: Any) -> Variables:
    content = {
        "term": [{"kind": "path_power", "goal": "minimise"}],
        "variable": [{"low": 0, "high": 100, **section} for section in sections],
        **study,
    }
    return find_variables(read_study(content), VALUES, KNOWN, coatings or {})


def test_shares_of_the_way() -> None:
    """Linear, and by ratios; dx/dy by a central difference; a plugin may refuse what lies beyond the ends."""
    found = variables({"parameters": "vane_1.r0", "low": 10, "high": 14})
    (variable,) = found.variables
    assert (variable.name, variable.unit) == ("vane_1.r0", "mm")
    assert [*found.shares([11.0]), *found.stretch([11.0])] == pytest.approx([0.25, 4.0])
    assert found.values(np.array([0.75])) == pytest.approx([13.0])
    assert found.parameters([13.5]) == {"vane_1.r0": pytest.approx(np.array([13.5]))}
    found = variables({"parameters": ["paint.A"], "low": 1e-4, "high": 1e-2, "scale": "log", "name": "black"})
    assert found.names == ("black",)
    assert found.shares([1e-3]) == pytest.approx([0.5])
    assert found.values(np.array([0.0])) == pytest.approx([1e-4])
    for x in (2e-4, 5e-3):
        y = found.shares([x])
        slope = (found.values(y + 1e-6) - found.values(y - 1e-6)) / 2e-6
        assert found.stretch([x]) == pytest.approx(slope, rel=1e-6)
    found = variables({"parameters": "paint.A", "low": 1e-3, "high": 3e-3, "scale": "log"})
    for y in np.linspace(-0.1, 1.1, 97):
        assert 1e-3 <= found.values(np.array([y]))[0] <= 3e-3
    found = variables({"parameters": "vane_1.r0", "low": 11 + 1e-7, "high": 14})
    assert found.shares(found.start) == pytest.approx([0.0])


class TestGroups:
    def test_by_differences(self) -> None:
        found = variables({"parameters": "vane_*.r0", "low": 10, "high": 20, "name": "vanes"})
        (variable,) = found.variables
        assert [place.label for place in variable.places] == ["vane_1.r0[0]", "vane_2.r0[0]", "vane_3.r0[0]"]
        assert (variable.low, variable.high) == (10.0, 17.0), "the third, 3 mm larger, ends at 20"
        assert [found.parameters([15.5])[f"vane_{k}.r0"][0] for k in (1, 2, 3)] == pytest.approx([15.5, 16.5, 18.5])
        found = variables({"parameters": "vane_*.r0", "low": 10, "high": 20, "each": True, "name": "vane"})
        assert found.names == ("vane vane_1.r0", "vane vane_2.r0", "vane vane_3.r0")
        assert [v.high for v in found.variables] == [20.0] * 3
        assert variables({"parameters": "vane_*.r0", "each": True}).names == ("vane_1.r0", "vane_2.r0", "vane_3.r0")

    def test_by_ratios_and_factors(self) -> None:
        """Slopes of ratios against central differences; a symmetric lens, whose other surface bends the other way."""
        found = variables({"parameters": ["paint.A", "polish.A"], "low": 1e-4, "high": 1e-2, "scale": "log"})
        (variable,) = found.variables
        assert (variable.low, variable.high) == pytest.approx((1e-4, 2.5e-3))
        assert found.parameters([5e-4])["polish.A"][0] == pytest.approx(2e-3)
        weights = {"paint.A": np.array([3.0]), "polish.A": np.array([7.0])}

        def function(x: float) -> float:
            moved = found.parameters([x])
            return float(sum(weights[key] @ moved[key] for key in weights))

        x, h = 1.5e-3, 1e-6
        assert found.slope(weights, [x])[0] == pytest.approx((function(x + h) - function(x - h)) / (2 * h), rel=1e-9)
        both = ["lens_front.curvature", {"key": "lens_rear.curvature", "factor": -1}]
        found = variables({"parameters": both, "low": 0.01, "high": 0.05})
        moved = found.parameters([0.03])
        assert (moved["lens_front.curvature"][0], moved["lens_rear.curvature"][0]) == pytest.approx((0.03, -0.03))
        slope = found.slope({"lens_front.curvature": np.array([2.0]), "lens_rear.curvature": np.array([5.0])}, [0.03])
        assert slope == pytest.approx([2.0 - 5.0])

    def test_entries_and_layers(self) -> None:
        weights = {"AR.thickness_nm": np.array([1.0, 2.0, 4.0])}
        for name, x, expected, slope in (
            ("AR.thickness_nm[1]", 150.0, [90.0, 150.0, 60.0], 2.0),
            ("AR.thickness_nm", 100.0, [100.0, 130.0, 70.0], 7.0),
        ):
            found = variables({"parameters": name, "low": 50, "high": 200})
            assert found.parameters([x])["AR.thickness_nm"] == pytest.approx(expected)
            assert found.slope(weights, [x]) == pytest.approx([slope])
        apart = variables({"parameters": "AR.thickness_nm", "low": 50, "high": 200, "each": True})
        assert apart.names == tuple(f"AR.thickness_nm[{k}]" for k in range(3))
        # Layers of coatings come first
        coating = {"name": "AR", "surfaces": "all", "layers": "1.38 90, 2.0 120", "thickness_nm": [10.0, 200.0]}
        found = variables({"parameters": "vane_1.r0"}, coatings={"AR": "AR.thickness_nm"}, coating=[coating])
        assert found.names == ("AR.thickness_nm[0]", "AR.thickness_nm[1]", "vane_1.r0")
        assert found.keys == ("AR.thickness_nm", "vane_1.r0")
        assert found.start == pytest.approx([90.0, 120.0, 11.0])


def test_what_belongs_together_in_a_scene() -> None:
    scene = mistray.load("cooke_triplet")
    params = mi.traverse(scene)
    known = parameters(scene, params)

    def keys(name: str) -> set[str]:
        section = {"parameters": name, "low": -0.01, "high": 0.01}
        study = {"term": [{"kind": "path_power", "goal": "minimise"}], "variable": [section]}
        (variable,) = find_variables(read_study(study), params, known, {}).variables
        return {place.key for place in variable.places}

    index = keys("N-SF5.index")
    assert {"L2_front.bsdf.n_back_shift", "L2_rear.bsdf.n_front_shift"} <= index
    assert all(key.startswith("L2") for key in index)
    assert {"L1_front.z", "L1_rear.z"} <= keys("L1.z")
    with refused(r'variable\[1\]: it changes the index .* write parameters = "N-SF5\.index"'):
        keys("L2_rear.bsdf.n_front_shift")


@pytest.mark.parametrize(("sections", "message"), vectors.toml("search_refusals.toml")["refused"])
def test_refusals(sections: list[dict[str, Any]], message: str) -> None:
    with refused(f"^study 'study': .*{message}"):
        variables(*sections)

"""The methods on functions whose minima are known, the criterion that ends them, and interruptions."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mistray.analyses.optimize.search import stop_reason
from mistray.analyses.optimize.search.point import Pieces
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.analyses.optimize.study.searches import Searches
from mistray.analyses.optimize.study.state import Evaluation, State
from mistray.errors import MistrayError
from mistray.optimize import Optimizer, Start, Step, read_study

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
        return {
            "merit": merit,
            "merit_se": self.noise,
            "slope": 2 * self.width * away + draw[1:],
            "terms": {"bowl": merit},
            "slopes": {},
            "traced_seconds": 0.0,
            "left_out": ["nothing"],
        }

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
        assert done.ended == {0: "all steps used"}
        none = searches(Bowl([0.3, 0.6]), replace(optimizer, steps=0), begin([1, 9]))
        assert (len(none.steps), none.ended) == (1, {0: "all steps used"})

    def test_interrupted_is_uninterrupted(self, optimizer: Optimizer, tmp_path: Path) -> None:
        """Interrupted after any evaluation, and resumed from the file: the same steps, to the last bit."""
        how = replace(optimizer, steps=9)
        noise = 0.05 if optimizer.method == "adam" else 0.0
        how = replace(how, seeds="fresh") if noise else how
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
        found = super().evaluate(y, number)
        return {**found, "merit": value + r**2, "slope": slope + 2 * r * row}


@pytest.mark.parametrize("optimizer", METHODS)
class TestTime:
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
        assert done.best.merit == 0
        assert done.ended == {0: "all limits hold"}

    def test_fresh_seeds_take_the_last_step(self) -> None:
        """The least of noisy merits is the luckiest; the last step is what the search found."""
        how = Optimizer(method="adam", seeds="fresh", steps=60, tolerance=0, step_size=0.05, decay=0.95)
        done = searches(Bowl([0.3, 0.6], noise=0.1), how, begin([9, 1]))
        assert done.best is done.steps[-1]
        assert done.best.x == pytest.approx([3, 6], abs=0.5)

    def test_a_state_of_another_search(self) -> None:
        state = begin([1, 9])
        searches(Bowl([0.3, 0.6]), Optimizer(steps=3), state)
        with pytest.raises(MistrayError, match=r"asks for other points than before.*run without resuming"):
            searches(Bowl([0.3, 0.6]), Optimizer(steps=3, step_size=0.1), state)


FLAT = "the last 2 steps have lowered the merit by less than 0.001"


@pytest.mark.parametrize(
    ("merits", "tolerance", "fresh", "reason"),
    [
        ([3, 2, 1], 1e-3, False, None),
        ([3, 2, 1.9995, 1.9994], 1e-3, False, FLAT),
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
    with pytest.raises(
        MistrayError, match=r"optimizer\.method.*nlopt is not installed; pip install 'mistray\[nlopt\]'"
    ):
        read_study({"term": [term], "variable": [variable], "optimizer": {"method": "nlopt"}})

"""The worst field and wavelength of a term: as what is made small, and as what a comparison warns of."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences

import mistray
from mistray.analyses.optimize.study.comparison import ComparisonCell, Levels, compare, worse
from mistray.analyses.optimize.study.model import Term
from mistray.analyses.optimize.study.terms import traced_metric
from mistray.analyses.optimize.tables import optimization_record, report_text
from mistray.errors import MistrayError
from mistray.metrics.scene_values import changed
from mistray.optimize import gradient, optimize, read_study

FIELDS, LINES = (0.0, 12.0), (450.0, 550.0, 650.0)
TRACED = {"field_deg": FIELDS, "wavelength_nm": LINES, "weights": (1.0, 2.0, 1.0), "rays": 1200, "max_reflections": 2}
# 1 nm of the thickest layer makes 450 nm a third worse, so that it takes over from 550 nm: steps are short
STEP_NM, TOLERANCE = 0.1, 1e-3
NORM = 16  # of smooth maxima, see docs/optimization.md


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.coat("cooke_triplet", {"L?_*": "bbar3"})


def term(worst: str, goal: str = "minimise", **more: Any) -> Term:
    return Term("ghosts", "path_power", goal, worst=worst, traced=TRACED, **more)


@pytest.mark.quick
@pytest.mark.parametrize("goal", ["minimise", "at_least"])
def test_value(scene: Any, goal: str) -> None:
    """The p-norm, by NumPy, of what each field and wavelength gives alone."""
    limit = {"limit": 0.0} if goal == "at_least" else {}
    alone = {
        (field, line): traced_metric(
            term("none"), scene, 3, field_deg=(field,), wavelength_nm=line, weights=None, rays=300 + 300 * (line == 550)
        ).value()
        for field in FIELDS
        for line in LINES
    }
    sign = 1 if goal == "minimise" else -1
    values = np.array(list(alone.values())) ** sign
    expected = np.sum(values**NORM) ** (sign / NORM)
    found = traced_metric(term("both", goal, **limit), scene, 3).value()
    assert found == pytest.approx(expected, rel=1e-6)
    extreme = max(alone.values()) if goal == "minimise" else min(alone.values())
    assert extreme * 6 ** min(sign / NORM, 0) <= found <= extreme * 6 ** max(sign / NORM, 0)


@pytest.mark.long
def test_gradient(scene: Any) -> None:
    """Against four-point central differences with the same rays."""
    params = mi.traverse(scene)
    key = "bbar3_N-LAK9.thickness_nm"
    metric = traced_metric(term("both"), scene, 5)
    found = gradient(metric, params, [key]).gradient[key]
    before = np.array(params[key], dtype=np.float64)

    def at(*thickness_nm: float) -> float:
        with changed(params, {key: np.array(thickness_nm)}):
            return metric.value()

    expected = central_differences(at, before, [STEP_NM] * len(before))
    assert found == pytest.approx(expected, abs=TOLERANCE * np.abs(found).max())


def levels(values: dict[ComparisonCell, np.ndarray]) -> Levels:
    return Levels(tuple(range(8)), values, {"ghosts": "W/W"})


@pytest.mark.quick
class TestWorse:
    cells = [
        ComparisonCell("ghosts"),
        *(ComparisonCell("ghosts", None, line) for line in LINES),
        *(ComparisonCell("ghosts", f) for f in FIELDS),
    ]

    def test_the_wavelength_that_got_worse(self) -> None:
        rng = np.random.default_rng(1)
        before = {cell: rng.normal(1, 0.03, 8) for cell in self.cells}
        after = {cell: 0.3 * values for cell, values in before.items()}
        after[ComparisonCell("ghosts", None, 450.0)] = 1.7 * before[ComparisonCell("ghosts", None, 450.0)]
        after[ComparisonCell("ghosts", 12.0)] = 1.2 * before[ComparisonCell("ghosts", 12.0)]
        comparison = compare(levels(before), levels(after))
        found = worse(comparison, [term("none")])
        assert [(row.field_deg, row.wavelength_nm) for row in found] == [(None, 450.0), (12.0, None)]
        assert found[0].ratio == pytest.approx(1 / 1.7)

    @pytest.mark.parametrize(
        ("goal", "more", "factor", "told"),
        [
            ("at_least", {"limit_of_start": 0.9}, 0.8, True),
            ("at_least", {"limit_of_start": 0.9}, 0.95, False),
            ("at_most", {"limit_of_start": 1.1}, 1.2, True),
            ("at_most", {"limit_of_start": 1.1}, 0.2, False),
            ("at_least", {"limit": 0.5}, 0.4, True),
            ("at_least", {"limit": 3.0}, 0.4, False),  # it did not hold before
            ("keep", {"tolerance": 0.1}, 1.2, True),
            ("keep", {"tolerance": 0.1}, 0.8, True),
            ("keep", {"tolerance": 0.1}, 1.05, False),
            ("minimise", {}, 1.005, False),  # not worth telling
        ],
    )
    def test_goals(self, goal: str, more: dict[str, float], factor: float, told: bool) -> None:
        before = {cell: np.random.default_rng(2).normal(1, 0.01, 8) for cell in self.cells}
        after = before | {ComparisonCell("ghosts", 12.0): factor * before[ComparisonCell("ghosts", 12.0)]}
        found = worse(compare(levels(before), levels(after)), [term("none", goal, **more)])
        assert [row.field_deg for row in found] == ([12.0] if told else [])

    def test_noise_is_no_news(self) -> None:
        """Nothing has changed but the noise: 1 % of the comparisons warn. More than 15 of 500: with p = 7e-5."""
        rng = np.random.default_rng(3)
        alarms = 0
        for _ in range(500):
            before, after = ({cell: rng.normal(1, 0.1, 8) for cell in self.cells} for _ in range(2))
            alarms += bool(worse(compare(levels(before), levels(after)), [term("none")]))
        assert alarms <= 15


@pytest.mark.quick
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"worst": "angle"}, "worst is 'angle'; choose from none, field, wavelength, both"),
        ({"worst": "field", "field_deg": [3]}, "needs two field_deg or more"),
        ({"worst": "both", "wavelength_nm": [500]}, "needs two wavelength_nm or more"),
        ({"worst": "field", "goal": "keep"}, 'has no meaning with goal = "keep"'),
        ({"worst": "field", "kind": "layer_minimum", "goal": "at_least", "limit": 3}, "is for metrics of traces"),
    ],
)
def test_what_makes_no_sense(changes: dict[str, Any], words: str) -> None:
    one = {"kind": "path_power", "goal": "minimise", "worst": "both"} | changes
    if one["kind"] == "path_power":
        one = {"field_deg": [0, 5], "wavelength_nm": [500, 600]} | one
    coating = {"name": "AR", "surfaces": "all", "preset": "bbar3", "thickness_nm": [15, 260]}
    with pytest.raises(MistrayError, match=words):
        read_study({"term": [one], "coating": [coating]})


@pytest.mark.long
def test_a_study_says_what_got_worse_and_can_prevent_it() -> None:
    """A coating made for 650 nm spoils 450 nm, and the result says so; made for the worst of both, it does not."""
    study: dict[str, Any] = {
        "term": [
            {"name": "ghosts", "kind": "path_power", "goal": "minimise", "field_deg": [5],
             "wavelength_nm": [450, 650], "weights": [1, 50], "rays": 1000, "max_reflections": 2}
        ],
        "coating": [{"name": "AR", "surfaces": "all", "layers": "1.38 99.6", "thickness_nm": [15, 260]}],
        "optimizer": {"starts": 1, "steps": 6},
    }  # fmt: skip
    red = optimize("cooke_triplet", study, verification_seeds=6)
    assert "warning: ghosts is worse than before at 450 nm (" in report_text(red)
    assert [row["wavelength_nm"] for row in optimization_record(red)["worse"]] == [450]
    study["term"][0]["worst"] = "wavelength"
    both = optimize("cooke_triplet", study, verification_seeds=6)
    assert 450 not in [row["wavelength_nm"] for row in optimization_record(both)["worse"]]

    def worst(result: Any) -> float:
        return max(row.after for row in result.comparison.rows if row.wavelength_nm is not None)

    assert worst(both) < 0.8 * worst(red)

"""The merit: its formula, its derivative against central differences, and what has no merit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import plates_text, write

from mistray.analyses.optimize.study.goals import by_value, check, contribution, holds, least_merit, limit_of, pieces
from mistray.analyses.optimize.study.merit import Merit, seed_of
from mistray.analyses.optimize.study.study_scene import open_scene, place
from mistray.analyses.optimize.study.terms import layer_minimum, material_count, total_thickness
from mistray.analyses.optimize.study.variables import find_variables
from mistray.errors import MistrayError
from mistray.optimize import Metric, Optimizer, Term, read_study
from mistray.scene import load


class TestContribution:
    """Against the formulas of the documentation, in float64."""

    TERMS = {
        "minimise": (Term("t", "path_power", "minimise", 2.0), lambda v, v0, b: 2 * math.log(v / v0)),
        "floor": (
            Term("t", "path_power", "minimise", 2.0, floor_of_start=0.1),
            lambda v, v0, b: 2 * math.log((v + 0.1 * v0) / (1.1 * v0)),
        ),
        "at_least": (
            Term("t", "path_power", "at_least", 3.0, 5.0, None, 0.1),
            lambda v, v0, b: 3 * max(0.0, 1 - (v - b) / (0.1 * abs(b))) ** 2,
        ),
        "at_most": (
            Term("t", "path_power", "at_most", 3.0, 5.0, None, 0.1),
            lambda v, v0, b: 3 * max(0.0, 1 - (b - v) / (0.1 * abs(b))) ** 2,
        ),
        "negative": (
            Term("t", "path_power", "at_most", 1.0, -5.0, None, 0.1),
            lambda v, v0, b: max(0.0, 1 - (-b - v) / (0.1 * abs(b))) ** 2,
        ),
        "keep": (
            Term("t", "path_power", "keep", 4.0, None, None, 0.02),
            lambda v, v0, b: 4 * ((v - v0) / (0.02 * abs(v0))) ** 2,
        ),
    }

    @pytest.mark.parametrize("goal", TERMS)
    @pytest.mark.parametrize("value", [3.0, 4.4, 4.9, 5.0, 5.2, 5.45, 5.6, 9.0])
    def test_value_and_slope(self, goal: str, value: float) -> None:
        term, formula = self.TERMS[goal]
        v = dr.opaque(mi.Float64, value)
        dr.enable_grad(v)
        with dr.resume_grad():
            result = contribution(term, v, 4.5)
        assert dr.detach(result)[0] == pytest.approx(formula(value, 4.5, 5.0), abs=1e-12)
        dr.backward(result)
        step = 1e-6
        expected = (formula(value + step, 4.5, 5.0) - formula(value - step, 4.5, 5.0)) / (2 * step)
        assert dr.grad(v)[0] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert by_value(term, value, 4.5) == pytest.approx(expected, rel=1e-6, abs=1e-6)

    def test_a_floor(self) -> None:
        """With one a term may vanish: darker than so far below the start is dark enough."""
        term = Term("t", "path_power", floor_of_start=0.01)
        assert float(contribution(term, mi.Float64(0.0), 4.0)[0]) == pytest.approx(math.log(0.01 / 1.01))
        assert by_value(term, 0.0, 4.0) == pytest.approx(1 / 0.04)
        check([term], {"t": 0.0}, {"t": 4.0}, "study 'x'", "y = 1")
        for value, start, words in ((0.0, 0.0, r"0 at the start \(y = 1\)"), (-1.0, 4.0, "-1 at y = 1")):
            with pytest.raises(MistrayError, match=f"its value is {words}"):
                check([term], {"t": value}, {"t": start}, "study 'x'", "y = 1")
        # The least merit is that of zeros
        least = 2 * math.log(1e-15) + math.log(0.01 / 1.01)
        assert least_merit([Term("a", "path_power", weight=2.0), term]) == pytest.approx(least, rel=1e-14)
        assert least_merit([Term("c", "path_power", "at_most", limit=1.0)]) == 0

    def test_pieces(self) -> None:
        """Taken apart and put together again: value and slope are those of the sum."""
        rng = np.random.default_rng(1)
        slopes = {goal: rng.standard_normal(3) for goal in self.TERMS}
        terms = [replace(term, name=goal) for goal, (term, _) in self.TERMS.items()]
        found = pieces(terms, dict.fromkeys(slopes, 4.9), slopes, dict.fromkeys(slopes, 4.5))
        assert found.one_sided.tolist() == [True, True, True, False]
        formulas = {goal: formula for goal, (_, formula) in self.TERMS.items()}
        penalty = sum(formulas[goal](4.9, 4.5, 5.0) for goal in ("at_least", "at_most", "negative", "keep"))
        assert found.penalty(found.residuals) == pytest.approx(penalty)
        step = 1e-6
        expected = sum(
            (formulas[goal](4.9 + step, 4.5, 5.0) - formulas[goal](4.9 - step, 4.5, 5.0)) / (2 * step) * slopes[goal]
            for goal in self.TERMS
        )
        assert found.slope + found.rows.T @ found.multipliers == pytest.approx(expected, rel=1e-6)

    def test_limits(self) -> None:
        for goal, more, limit, inside, outside in (
            ("at_least", {"limit_of_start": 0.9}, pytest.approx(1.8), (1.81, 5.0), (1.79,)),
            ("at_most", {"limit": 7.0}, 7.0, (6,), (8,)),
            ("keep", {"tolerance": 0.1}, None, (1.81, 2.19), (1.79, 2.21)),
            ("minimise", {}, None, (99.0,), ()),
        ):
            term = Term("t", "path_power", goal, **more)
            assert limit_of(term, 2.0) == limit
            assert [holds(term, value, 2.0) for value in inside] == [True] * len(inside)
            assert not any(holds(term, value, 2.0) for value in outside)


def test_seeds() -> None:
    """Fixed or fresh; those differ from each other and from those of the verification, and begin with the study's."""
    assert {seed_of(Optimizer(seed=5), k) for k in range(20)} == {5}
    how = Optimizer(method="adam", seeds="fresh", seed=5)
    seeds = [seed_of(how, k) for k in range(1000)]
    assert seeds == [seed_of(how, k) for k in range(1000)]
    assert (seeds[0], len(set(seeds))) == (5, 1000)
    assert not set(seeds) & set(range(6, 14))
    assert all(0 <= seed < 2**32 for seed in seeds)


class TestLayers:
    THICKNESS = {"a": np.array([60.0, 12.0, 90.0]), "b": np.array([12.1, 3.0])}
    MATERIALS = {"a": ["MgF2", "TiO2", "MgF2"], "b": ["TiO2", "SiO2"]}

    @pytest.mark.parametrize("kind", [layer_minimum, total_thickness, material_count])
    def test_derivatives(self, kind: Callable[..., Any]) -> None:
        """Against central differences."""
        _, slopes = kind(self.THICKNESS, self.MATERIALS)
        for name, d in self.THICKNESS.items():
            for k in range(len(d)):
                ends = []
                for step in (1e-4, -1e-4):
                    moved = {n: v.copy() for n, v in self.THICKNESS.items()}
                    moved[name][k] += step
                    ends.append(kind(moved, self.MATERIALS)[0])
                assert slopes[name][k] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-6, abs=1e-9)

    def test_values(self) -> None:
        assert total_thickness(self.THICKNESS, self.MATERIALS)[0] == pytest.approx(177.1)
        assert layer_minimum(self.THICKNESS, self.MATERIALS)[0] == pytest.approx(3.0, abs=1e-6)
        even = layer_minimum({"a": np.full(4, 20.0)}, {"a": ["x"] * 4})[0]
        assert even == pytest.approx(20 - 0.2 * math.log(4)), "below the thinnest, by a fraction of a nanometre"
        count = material_count(self.THICKNESS, self.MATERIALS)[0]
        assert count == pytest.approx(3 - math.exp(-150 / 5) - math.exp(-24.1 / 5) - math.exp(-3 / 5))
        gone = material_count({**self.THICKNESS, "b": np.array([12.1, 0.0])}, self.MATERIALS)[0]
        assert gone == pytest.approx(2, abs=0.01), "a material without thickness does not count"


def merit_of(scene: Path, study: dict[str, Any]) -> Merit:
    read = read_study(study)
    placed = place(load(scene), read)
    with open_scene(scene, placed) as opened:
        variables = find_variables(read, opened.params, opened.known, opened.thickness_keys)
        return Merit(read, opened.scene, opened.params, variables, opened.thickness_keys)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    return write(tmp_path, plates_text(1, R=0.05, T=0.9))


LIGHT = {"wavelength_nm": [500, 600], "field_deg": [0, 5], "rays": 500}


def by_reflectance(*terms: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A study of terms by R of both faces of the plate."""
    variable = {"parameters": "p0_*.bsdf.R", "low": 0.01, "high": 0.1}
    return {"trace": LIGHT, "term": list(terms), "variable": [variable], **more}


def at_start(merit: Merit) -> dict[str, Any]:
    return merit.evaluate(merit.variables.shares(merit.variables.start), 0)


class TestMerit:
    def test_terms_of_a_plate(self, plate: Path) -> None:
        """Ghost R² T², transmission T² and their ratio R² at known R and T; the merit is that of the formulas."""
        study = {
            "trace": LIGHT,
            "term": [
                {"name": "ghosts", "kind": "path_power", "goal": "minimise", "weight": 0.5},
                {"name": "ratio", "kind": "ghost_to_signal", "goal": "minimise"},
                {"kind": "transmission", "goal": "at_least", "limit": 0.81, "tolerance": 0.1},
            ],
            "variable": [
                {"name": "R", "parameters": "p0_*.bsdf.R", "low": 0.01, "high": 0.1},
                {"name": "T", "parameters": "p0_*.bsdf.T", "low": 0.5, "high": 0.9},
            ],
        }
        merit = merit_of(plate, study)
        first = at_start(merit)
        assert first["terms"] == pytest.approx({"ghosts": (0.05 * 0.9) ** 2, "ratio": 0.05**2, "transmission": 0.81})
        assert first["merit"] == pytest.approx(1.0, rel=1e-4), "the limit is just met"
        x = np.array([0.02, 0.88])
        found = merit.evaluate(merit.variables.shares(x), 1)

        def expected(R: float, T: float) -> float:
            ghosts, ratio = math.log((R * T) ** 2 / (0.05 * 0.9) ** 2), math.log(R**2 / 0.05**2)
            return 0.5 * ghosts + ratio + max(0.0, 1 - (T**2 - 0.81) / 0.081) ** 2

        assert 0.88**2 - 0.81 < 0.081
        assert found["merit"] == pytest.approx(expected(*x), rel=1e-4)
        slope = [
            (expected(x[0] + 1e-6, x[1]) - expected(x[0] - 1e-6, x[1])) / 2e-6 * 0.09,
            (expected(x[0], x[1] + 1e-6) - expected(x[0], x[1] - 1e-6)) / 2e-6 * 0.4,
        ]
        assert found["slope"] == pytest.approx(slope, rel=1e-3)
        assert merit.broken(found["terms"]) == ("transmission",)
        assert merit.least == pytest.approx(1.5 * math.log(1e-15))

    @pytest.mark.long
    @pytest.mark.parametrize("method", ["lbfgsb", "sqp"])
    def test_slope_against_differences(self, plate: Path, method: str) -> None:
        """Of coatings, terms of layers and an ideal R on a log scale; all at once, or term by term; with one seed."""
        study = {
            "optimizer": {"method": method},
            "trace": LIGHT,
            "term": [
                {"name": "ghosts", "kind": "path_power", "goal": "minimise"},
                {"kind": "transmission", "goal": "keep", "tolerance": 0.5},
                {"kind": "total_thickness", "goal": "at_most", "limit": 130, "tolerance": 0.2},
                {"kind": "layer_minimum", "goal": "at_least", "limit": 40, "tolerance": 0.5, "weight": 0.1},
            ],
            "coating": [
                {"name": "AR", "surfaces": ["p0_front"], "layers": "1.38 70, 2.0 50", "thickness_nm": [20.0, 150.0]}
            ],
            "variable": [{"parameters": "p0_rear.bsdf.R", "low": 1e-3, "high": 1e-1, "scale": "log"}],
        }
        merit = merit_of(plate, study)
        at_start(merit)
        y = merit.variables.shares(np.array([75.0, 45.0, 0.02]))
        found = merit.evaluate(y, 1)
        assert set(found["slopes"]) == (set() if method == "lbfgsb" else {term.name for term in merit.study.terms})
        for k in range(3):
            ends = []
            for step in (2e-3, -2e-3):
                moved = y.copy()
                moved[k] += step
                ends.append(merit.evaluate(moved, 1))
            by_difference = (ends[0]["merit"] - ends[1]["merit"]) / 4e-3
            assert found["slope"][k] == pytest.approx(by_difference, rel=1e-3), merit.variables.names[k]
            for name, slope in found["slopes"].items():
                by_difference = (ends[0]["terms"][name] - ends[1]["terms"][name]) / 4e-3
                assert slope[k] == pytest.approx(by_difference, rel=1e-3, abs=1e-9), (name, k)

    @pytest.mark.parametrize(
        ("term", "message"),
        [
            (
                {"kind": "path_power", "selection": "structure", "goal": "minimise"},
                r"term 'path_power': its value is 0 at the start \(p0_front\.bsdf\.R = 0\.05\).* take more rays",
            ),
            ({"kind": "path_power", "selection": "structure", "goal": "keep"}, "value at the start is 0, which cannot"),
            ({"kind": "path_power", "goal": "at_most", "limit": 0}, "its limit is 0; the tolerance is relative to it"),
            (
                {"kind": "transmission", "goal": "at_most", "limit": 0.9},
                r"the merit is 0, nothing is to be minimised and all limits hold; add a term with goal = \"minimise\"",
            ),
            (
                {"kind": lambda scene, **traced: broken_metric(scene, np.nan, **traced), "goal": "minimise"},
                "term '<lambda>': its value is nan at p0_",
            ),
        ],
    )
    def test_no_merit(self, plate: Path, term: dict[str, Any], message: str) -> None:
        merit = merit_of(plate, by_reflectance(term))
        with pytest.raises(MistrayError, match=message) as caught:
            at_start(merit)
        assert "\n" not in str(caught.value)


def broken_metric(scene: Any, factor: float, **traced: Any) -> Any:
    light = {key: traced.pop(key) for key in ("field_deg", "wavelength_nm")}
    return Metric(scene, lambda observations: factor * observations[0].power("all"), settings=traced, **light)

"""The merit, its worst field and wavelength, and derivatives by reflectances, against formulas and differences."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles.derivatives import central_differences
from oracles.small_scenes import plates_text, write
from refusals import each_refused, refused

import mistray
from mistray import load
from mistray.analyses.optimize.reflectance_weights import best_thicknesses, reflectance_weights
from mistray.analyses.optimize.study.comparison import ComparisonCell, Levels, _cells, compare, worse
from mistray.analyses.optimize.study.goals import by_value, check, contribution, holds, least_merit, limit_of, pieces
from mistray.analyses.optimize.study.merit import Merit, seed_of
from mistray.analyses.optimize.study.study_scene import open_scene, place
from mistray.analyses.optimize.study.terms import layer_minimum, material_count, total_thickness, traced_metric
from mistray.analyses.optimize.study.variables import find_variables
from mistray.analyses.optimize.tables import optimization_record, report_text, worse_lines
from mistray.analyses.optimize.thickness_minima import thickness_minima
from mistray.coatings import preset
from mistray.metrics.scene_values import changed
from mistray.optimize import Metric, Optimizer, Term, gradient, optimize, path_power, read_study
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

path = partial(Term, "t", "path_power")


class TestContribution:
    """Against the formulas of the documentation, in float64; the limits are 5 and -5, tolerances a tenth of them."""

    TERMS = {
        "minimise": (path("minimise", 2.0), lambda v, v0: 2 * math.log(v / v0)),
        "floor": (path("minimise", 2.0, floor_of_start=0.1), lambda v, v0: 2 * math.log((v + 0.1 * v0) / (1.1 * v0))),
        "at_least": (path("at_least", 3.0, 5.0, None, 0.1), lambda v, v0: 3 * max(0.0, 1 - (v - 5) / 0.5) ** 2),
        "at_most": (path("at_most", 3.0, 5.0, None, 0.1), lambda v, v0: 3 * max(0.0, 1 - (5 - v) / 0.5) ** 2),
        "negative": (path("at_most", 1.0, -5.0, None, 0.1), lambda v, v0: max(0.0, 1 - (-5 - v) / 0.5) ** 2),
        "keep": (path("keep", 4.0, None, None, 0.02), lambda v, v0: 4 * ((v - v0) / (0.02 * v0)) ** 2),
    }

    @pytest.mark.parametrize("goal", TERMS)
    @pytest.mark.parametrize("value", [3.0, 4.4, 4.9, 5.0, 5.2, 5.45, 5.6, 9.0])
    def test_value_and_slope(self, goal: str, value: float) -> None:
        term, formula = self.TERMS[goal]
        v = dr.opaque(mi.Float64, value)
        dr.enable_grad(v)
        with dr.resume_grad():
            result = contribution(term, v, 4.5)
        assert dr.detach(result)[0] == pytest.approx(formula(value, 4.5), abs=1e-12)
        dr.backward(result)
        step = 1e-6
        expected = (formula(value + step, 4.5) - formula(value - step, 4.5)) / (2 * step)
        assert dr.grad(v)[0] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert by_value(term, value, 4.5) == pytest.approx(expected, rel=1e-6, abs=1e-6)

    def test_a_floor_and_pieces(self) -> None:
        """With one a term may vanish: darker than so far below the start is dark enough."""
        term = path(floor_of_start=0.01)
        assert float(contribution(term, mi.Float64(0.0), 4.0)[0]) == pytest.approx(math.log(0.01 / 1.01))
        assert by_value(term, 0.0, 4.0) == pytest.approx(1 / 0.04)
        check([term], {"t": 0.0}, {"t": 4.0}, "study 'x'", "y = 1")
        for value, start, words in ((0.0, 0.0, r"0 at the start \(y = 1\)"), (-1.0, 4.0, "-1 at y = 1")):
            with refused(f"its value is {words}"):
                check([term], {"t": value}, {"t": start}, "study 'x'", "y = 1")
        # The least merit is that of zeros
        least = 2 * math.log(1e-15) + math.log(0.01 / 1.01)
        assert least_merit([Term("a", "path_power", weight=2.0), term]) == pytest.approx(least, rel=1e-14)
        assert least_merit([Term("c", "path_power", "at_most", limit=1.0)]) == 0
        # Taken apart and put together again: value and slope are those of the sum
        rng = np.random.default_rng(1)
        slopes = {goal: rng.standard_normal(3) for goal in self.TERMS}
        terms = [replace(term, name=goal) for goal, (term, _) in self.TERMS.items()]
        found = pieces(terms, dict.fromkeys(slopes, 4.9), slopes, dict.fromkeys(slopes, 4.5))
        assert found.one_sided.tolist() == [True, True, True, False]
        formulas = {goal: formula for goal, (_, formula) in self.TERMS.items()}
        penalty = sum(formulas[goal](4.9, 4.5) for goal in ("at_least", "at_most", "negative", "keep"))
        assert found.penalty(found.residuals) == pytest.approx(penalty)
        step = 1e-6
        expected = sum(
            (formula(4.9 + step, 4.5) - formula(4.9 - step, 4.5)) / (2 * step) * slopes[goal]
            for goal, formula in formulas.items()
        )
        assert found.slope + found.rows.T @ found.multipliers == pytest.approx(expected, rel=1e-6)

    def test_limits(self) -> None:
        for goal, more, limit, inside, outside in (
            ("at_least", {"limit_of_start": 0.9}, pytest.approx(1.8), (1.81, 5.0), (1.79,)),
            ("at_most", {"limit": 7.0}, 7.0, (6,), (8,)),
            ("keep", {"tolerance": 0.1}, None, (1.81, 2.19), (1.79, 2.21)),
            ("minimise", {}, None, (99.0,), ()),
        ):
            term = path(goal, **more)
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
            for k, step in enumerate(1e-4 * np.eye(len(d))):
                above, below = (kind({**self.THICKNESS, name: d + by}, self.MATERIALS)[0] for by in (step, -step))
                assert slopes[name][k] == pytest.approx((above - below) / 2e-4, rel=1e-6, abs=1e-9)

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
    with open_scene(scene, place(load(scene), read)) as opened:
        variables = find_variables(read, opened.params, opened.known, opened.thickness_keys)
        return Merit(read, opened.scene, opened.params, variables, opened.thickness_keys)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    return write(tmp_path, plates_text(1, R=0.05, T=0.9))


LIGHT = {"wavelength_nm": [500, 600], "field_deg": [0, 5], "rays": 500}


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
        steps = 1e-6 * np.eye(2)
        slope = [(expected(*(x + step)) - expected(*(x - step))) / 2e-6 for step in steps] * np.array([0.09, 0.4])
        assert found["slope"] == pytest.approx(slope, rel=1e-3)
        assert merit.broken(found["terms"]) == ("transmission",)
        assert merit.least == pytest.approx(1.5 * math.log(1e-15))

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
            "coating": [{"surfaces": ["p0_front"], "layers": "1.38 70, 2.0 50", "thickness_nm": [20.0, 150.0]}],
            "variable": [{"parameters": "p0_rear.bsdf.R", "low": 1e-3, "high": 1e-1, "scale": "log"}],
        }
        merit = merit_of(plate, study)
        at_start(merit)
        y = merit.variables.shares(np.array([75.0, 45.0, 0.02]))
        found = merit.evaluate(y, 1)
        assert set(found["slopes"]) == (set() if method == "lbfgsb" else {term.name for term in merit.study.terms})
        for k, step in enumerate(2e-3 * np.eye(3)):
            above, below = (merit.evaluate(y + by, 1) for by in (step, -step))
            by_difference = (above["merit"] - below["merit"]) / 4e-3
            assert found["slope"][k] == pytest.approx(by_difference, rel=1e-3), merit.variables.names[k]
            for name, slope in found["slopes"].items():
                by_difference = (above["terms"][name] - below["terms"][name]) / 4e-3
                assert slope[k] == pytest.approx(by_difference, rel=1e-3, abs=1e-9), (name, k)

    def test_no_merit(self, plate: Path) -> None:
        def no_number(scene: Any, **traced: Any) -> Any:
            light = {key: traced.pop(key) for key in ("field_deg", "wavelength_nm")}
            return Metric(scene, lambda observations: np.nan * observations[0].power("all"), settings=traced, **light)

        def evaluated(change: dict[str, Any]) -> None:
            variable = {"parameters": "p0_*.bsdf.R", "low": 0.01, "high": 0.1}
            term = {"kind": "path_power", "goal": "minimise"} | change
            at_start(merit_of(plate, {"trace": LIGHT, "term": [term], "variable": [variable]}))

        nothing = r"the merit is 0, nothing is to be minimised and all limits hold; add a term with goal = \"minimise\""
        each_refused(
            ({"selection": "structure"}, r"power': its value is 0 at the start \(p0_front.bsdf.R = 0.05\).* more rays"),
            ({"selection": "structure", "goal": "keep"}, "value at the start is 0, which cannot"),
            ({"goal": "at_most", "limit": 0}, "its limit is 0; the tolerance is relative to it"),
            ({"kind": "transmission", "goal": "at_most", "limit": 0.9}, nothing),
            ({"kind": no_number}, "term 'no_number': its value is nan at p0_"),
            by=evaluated,
        )


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
    alone = []
    for field, line in itertools.product(FIELDS, LINES):
        light = {"field_deg": (field,), "wavelength_nm": line, "weights": None, "rays": 300 + 300 * (line == 550)}
        alone.append(traced_metric(term("none"), scene, 3, **light).value())
    sign = 1 if goal == "minimise" else -1
    found = traced_metric(term("both", goal, **limit), scene, 3).value()
    assert found == pytest.approx(np.sum(np.array(alone) ** (sign * NORM)) ** (sign / NORM), rel=1e-6)
    extreme = max(alone) if goal == "minimise" else min(alone)
    assert extreme * 6 ** min(sign / NORM, 0) <= found <= extreme * 6 ** max(sign / NORM, 0)


@pytest.mark.quick
@pytest.mark.parametrize("field_deg", [12, 12.0, [12.0], np.array([12.0])])
def test_light_from_python(field_deg: Any) -> None:
    light = {"field_deg": field_deg, "wavelength_nm": np.array([450.0, 550.0]), "weights": [1, 2]}
    cells = _cells(Term("ghosts", "path_power", traced=light), None)
    assert [(cell.field_deg, cell.wavelength_nm) for cell in cells] == [(None, None), (None, 450.0), (None, 550.0)]
    assert [metric.field_deg for metric in cells.values()] == [(12.0,)] * 3


def test_gradient(scene: Any) -> None:
    """Against four-point central differences with the same rays."""
    params, key = mi.traverse(scene), "bbar3_N-LAK9.thickness_nm"
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
    places = (), *((None, line) for line in LINES), *((field,) for field in FIELDS)
    cells = [ComparisonCell("ghosts", *place) for place in places]

    def test_the_wavelength_that_got_worse(self) -> None:
        rng = np.random.default_rng(1)
        before = {cell: rng.normal(1, 0.03, 8) for cell in self.cells}
        factors = {ComparisonCell("ghosts", None, 450.0): 1.7, ComparisonCell("ghosts", 12.0): 1.2}
        after = {cell: factors.get(cell, 0.3) * values for cell, values in before.items()}
        found = worse(compare(levels(before), levels(after)), [term("none")])
        assert [(row.field_deg, row.wavelength_nm) for row in found] == [(None, 450.0), (12.0, None)]
        assert found[0].ratio == pytest.approx(1 / 1.7)

    @pytest.mark.parametrize(("goal", "more", "factor", "told"), vectors.toml("tables.toml")["what got worse"])
    def test_goals(self, goal: str, more: dict[str, float], factor: float, told: bool) -> None:
        before = {cell: np.random.default_rng(2).normal(1, 0.01, 8) for cell in self.cells}
        after = before | {ComparisonCell("ghosts", 12.0): factor * before[ComparisonCell("ghosts", 12.0)]}
        found = worse(compare(levels(before), levels(after)), [term("none", goal, **more)])
        assert [row.field_deg for row in found] == ([12.0] if told else [])

    def test_noise_is_no_news(self) -> None:
        """Nothing has changed but the noise: 1 % of the comparisons warn. More than 15 of 500: with p = 7e-5."""
        rng, alarms = np.random.default_rng(3), 0
        for _ in range(500):
            before, after = ({cell: rng.normal(1, 0.1, 8) for cell in self.cells} for _ in range(2))
            alarms += bool(worse(compare(levels(before), levels(after)), [term("none")]))
        assert alarms <= 15


@pytest.mark.quick
@pytest.mark.parametrize(("changes", "words"), vectors.toml("refusals.toml")["worst of a term"])
def test_what_makes_no_sense(changes: dict[str, Any], words: str) -> None:
    one = {"kind": "path_power", "goal": "minimise", "worst": "both"} | changes
    if one["kind"] == "path_power":
        one = {"field_deg": [0, 5], "wavelength_nm": [500, 600]} | one
    coating = {"name": "AR", "surfaces": "all", "preset": "bbar3", "thickness_nm": [15, 260]}
    with refused(words):
        read_study({"term": [one], "coating": [coating]})


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
    kept = replace(red.study, terms=(replace(red.study.terms[0], goal="keep", tolerance=0.1),))
    for after, words in ((0.0, "now 0"), (math.nan, "no value")):
        gone = [replace(r, after=after, ratio=math.nan) if r.wavelength_nm == 450 else r for r in red.comparison.rows]
        (line,) = worse_lines(replace(red, study=kept, comparison=replace(red.comparison, rows=tuple(gone))))
        assert line.startswith(f"ghosts is worse than before at 450 nm ({words})")
    study["term"][0]["worst"] = "wavelength"
    both = optimize("cooke_triplet", study, verification_seeds=6)
    assert 450 not in [row["wavelength_nm"] for row in optimization_record(both)["worse"]]

    def worst(result: Any) -> float:
        return max(row.after for row in result.comparison.rows if row.wavelength_nm is not None)

    assert worst(both) < 0.8 * worst(red)


GROUPS = {"crown": ("L1_front", "L1_rear", "L3_front", "L3_rear"), "flint": ("L2_front", "L2_rear")}
STACK = preset("bbar3")
THICKNESS_NM = np.array([layer.thickness_nm for layer in STACK.layers])
BY_TABLE = 1e-2  # R between the cosines is interpolated: its slope by a thickness is wrong by h²/8 R''
THIN_NM = 0.01


@pytest.fixture(scope="module")
def metric(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Ghost power of the Cooke triplet with a preset on all surfaces."""
    coatings = [SharedCoating(name, STACK, surfaces) for name, surfaces in GROUPS.items()]
    file = write_recoated(find("cooke_triplet"), coatings, tmp_path_factory.mktemp("scene") / "scene.xml")
    scene = mistray.load(file)
    return path_power(scene, "ghost", field_deg=(0, 15), wavelength_nm=(480, 600), rays=256, flux_threshold=0)


@pytest.fixture(scope="module")
def weights(metric: Any) -> Any:
    return reflectance_weights(metric)


def by_thickness(cost: Any) -> np.ndarray:
    """Central differences of a cost by the thicknesses of the preset."""
    steps = THIN_NM * np.eye(len(THICKNESS_NM))
    return np.array((cost(THICKNESS_NM + steps) - cost(THICKNESS_NM - steps)) / (2 * THIN_NM))


def test_chain_rule_gives_the_gradient_by_thicknesses(metric, weights):
    expected = mistray.gradient(metric, mi.traverse(metric.scene), ["crown.thickness_nm", "flint.thickness_nm"])
    assert weights.value == pytest.approx(expected.value, rel=1e-9)
    for name, other in (("crown", "flint"), ("flint", "crown")):
        slopes = expected.gradient[f"{name}.thickness_nm"]
        own, wrong = (by_thickness(weights.cost(GROUPS[glass], STACK)) for glass in (name, other))
        allowed = BY_TABLE * np.max(np.abs(slopes))
        assert np.max(np.abs(own - slopes)) < allowed < np.max(np.abs(wrong - slopes)), name
    # Surfaces add up
    cost = weights.cost(GROUPS["crown"], STACK)(THICKNESS_NM[None])
    single = [weights.cost([surface], STACK)(THICKNESS_NM[None]) for surface in GROUPS["crown"]]
    assert sum(single) == pytest.approx(cost, rel=1e-12)
    bare = path_power(mistray.load("cooke_triplet"), "ghost", rays=64, flux_threshold=0)
    each_refused(
        (lambda: weights.cost(["L9_front"], STACK), "surface 'L9_front' has no layers"),
        (lambda: reflectance_weights(bare), "no surface that the light meets has layers"),
    )


def test_the_deepest_minimum_is_found():
    """A function with many minima, known in closed form: the sum of (d/20)² and of 1 - cos(d), about 100 nm."""

    def cost(d: np.ndarray) -> np.ndarray:
        return np.array(np.sum(((d - 100) / 20) ** 2 + 1 - np.cos(d - 100), axis=1) + 0.1)

    found = best_thicknesses(cost, [5, 5], [260, 260], [np.array([40.0, 200.0]), np.array([101.0, 99.0])])
    assert found == pytest.approx([100, 100], abs=0.01)
    assert best_thicknesses(cost, [110, 5], [260, 260], [])[0] >= 110
    # A layer that is not there yet: the slope at 0 leads away from it
    (grown,) = thickness_minima(lambda d: np.exp(-d[:, 0] / 50), [(0, 150)], [np.zeros(1)], points=1, followed=0)
    assert grown == pytest.approx([150])

"""Budgets of scatter: the least cost against Lagrange multipliers by hand and enumeration, and what cannot be met."""

import itertools
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text, shape_xml, write
from refusals import each_refused, refused

import mistray
from mistray.analyses.budget import allocation
from mistray.analyses.budget.allocation import Model, PowerCost, StepCost, ToleranceChoice, allocate
from mistray.analyses.budget.read_budget import read_budget
from mistray.metrics.scene_values import assign
from mistray.optimize import budget, path_power

TRACED = {"rays": 4096, "max_reflections": 0, "flux_threshold": 0.0, "scatter_threshold": 0.0}
AS_GIVEN = 4.0
POLISH = bsdf_xml("harvey_shack", rms_nm=AS_GIVEN, l=0.05, s=-2.0, event="transmission")
SHARED = '<ref id="polish"/>'
KEYS = [f"{side}.bsdf.harvey_shack.rms_nm" for side in ("front", "rear")]
RMS: dict[str, Any] = {"surfaces": "front", "parameter": "rms_nm"}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A window whose faces share a polish, before a small black detector."""
    faces = [
        shape_xml("asphere", name, z, scattering_xml([SHARED], *glass, R=0.04, T=0.96), semi_diameter=20.0)
        for name, z, *glass in (("front", 0.0, "air", "1.5"), ("rear", 15.0, "1.5", "air"))
    ]
    detector = shape_xml("asphere", "detector", 30.0, sensor=True, half_width=5.0, half_height=5.0)
    text = scene_text(POLISH.replace("<bsdf ", '<bsdf id="polish" ', 1), *faces, detector)
    return write(tmp_path_factory.mktemp("budget"), text)


def study(limit: float, **changes: Any) -> dict[str, Any]:
    choose = [
        RMS | {"surfaces": side, "best": 0.2, "worst": 20.0, "cost": {"weight": weight}}
        for side, weight in (("front", 1.0), ("rear", 6.0))
    ]
    require = {"metric": "path_power", "selection": "single scatter", "limit": limit}
    return {"require": [require], "choose": choose, "traced": TRACED, "solver": {"sigmas": 0.0, "seeds": 2}} | changes


@pytest.fixture(scope="module")
def parts(source: Path) -> np.ndarray:
    """Scatter of either surface alone over σ²: traces in which the other one is almost smooth."""
    path = source.parent / "own.xml"
    path.write_text(source.read_text().replace(SHARED, POLISH))
    scene = mistray.load(path)
    params, found = mi.traverse(scene), []
    for rough, smooth in (KEYS, KEYS[::-1]):
        assign(params, {rough: np.array([AS_GIVEN]), smooth: np.array([1e-3])})
        found.append(path_power(scene, "single scatter", **TRACED).value() / AS_GIVEN**2)
    return np.array(found)


@pytest.fixture(scope="module")
def limit(parts: np.ndarray) -> float:
    return 0.25 * float(parts.sum()) * AS_GIVEN**2


WEIGHTS = np.array([1.0, 6.0])


def by_hand(weights: np.ndarray, parts: np.ndarray, limit: float, exponent: float = 1.0) -> np.ndarray:
    """Least Σ w/σ^q with Σ a σ² = limit: σ ~ (w/a)^(1/(q + 2))."""
    shape = (weights / parts) ** (1 / (exponent + 2))
    return shape * np.sqrt(limit / np.sum(parts * shape**2))


def test_two_surfaces(source: Path, parts: np.ndarray, limit: float, tmp_path: Path) -> None:
    """To 1 %: what is scattered twice, and the light that scatter takes from the beam, are of second order."""
    result = budget(source, study(limit))
    chosen, found = result.chosen, np.array([each.after for each in result.chosen])
    assert [each.key for each in chosen] == KEYS
    assert found == pytest.approx(by_hand(WEIGHTS, parts, limit), rel=1e-2)
    assert abs(found / by_hand(WEIGHTS, parts * [1.0, 1.3], limit) - 1).max() > 0.03  # a wrong part is seen
    assert [each.shares_before[0] for each in chosen] == pytest.approx(parts / parts.sum(), rel=1e-2)
    after = np.array([each.shares_after[0] for each in chosen])
    assert after == pytest.approx(parts * found**2 / np.sum(parts * found**2), rel=2e-2)
    assert result.cost == pytest.approx((7 * 20 / AS_GIVEN, np.sum(WEIGHTS * 20 / found)))
    (met,) = result.requirements
    assert met.limit == limit
    assert (met.before.value, met.after.value) == pytest.approx((4 * limit, limit), rel=0.05)
    assert result.gradients <= 3
    assert met.distance == pytest.approx((limit - met.after.value) / met.after.se)
    params = mi.traverse(mistray.load(write(tmp_path, result.scene_text(tmp_path))))
    assert [float(params[key][0]) for key in KEYS] == pytest.approx(found, rel=1e-6)


def test_grades(source: Path, parts: np.ndarray, limit: float) -> None:
    """The cheapest pair of grades that meets the limit, by trying all."""
    values, costs = [0.5, 1.0, 2.0, 3.0, 4.0, 6.0], [12.0, 6.0, 3.0, 2.0, 1.5, 1.0]
    choose = [RMS | {"surfaces": ["front", "rear"], "values": values, "costs": costs}]
    found = budget(source, study(limit, choose=choose))
    pairs = itertools.product(zip(values, costs, strict=True), repeat=2)
    allowed = {(a, b): cost_a + cost_b for (a, cost_a), (b, cost_b) in pairs if parts @ [a * a, b * b] <= limit}
    assert found.cost[1] == min(allowed.values())
    assert tuple(chosen.after for chosen in found.chosen) in allowed


@pytest.mark.parametrize(("best", "sigmas"), [(0.2, 0.0), (1.95, 10.0)])
def test_a_shared_model_stays_one(source: Path, limit: float, best: float, sigmas: float) -> None:
    """σ of both faces is AS_GIVEN · sqrt(limit / value), also where there are no ten standard errors to spare."""
    solver = {"sigmas": sigmas, "seeds": 2, "shared": True}
    (chosen,) = budget(source, study(limit, choose=[RMS | {"best": best, "worst": 20.0}], solver=solver)).chosen
    assert (chosen.key, chosen.surfaces) == ("polish.rms_nm", ("front", "rear"))
    assert chosen.after == pytest.approx(AS_GIVEN / 2, rel=1e-2)


@pytest.mark.parametrize(("change", "words"), vectors.toml("refusals.toml")["budget"])
def test_bad_files(change: dict[str, Any], words: str) -> None:
    with refused(words):
        read_budget(study(1.0) | change)


def test_what_cannot_be_met(source: Path, limit: float) -> None:
    """With both at 3 nm of 4 there is 9/16 of the light left, 2.25 times a limit of a quarter."""
    choose = [RMS | {"surfaces": ["front", "rear"], "best": 3.0, "worst": 20.0}]
    with refused(r"at best the path power is .* 2\.2\d times the limit"):
        budget(source, study(limit, choose=choose))


def test_surfaces_that_do_not_fit(source: Path) -> None:
    each_refused(
        (1.0, [RMS | {"parameter": "level", "best": 100, "worst": 300}], "no surface 'front' has a level with"),
        (1.0, [RMS | {"surfaces": "side", "best": 1, "worst": 3}], "those that have one are front, rear"),
        (1.0, [RMS | {"surfaces": name, "best": 1, "worst": 3} for name in ("front", "*")], "another section"),
        (1e3, [RMS | {"best": 1.0, "worst": 500.0}], "^budget 'budget': .*rms roughness 500 nm is not smooth"),
        by=lambda limit, choose: budget(source, study(limit, choose=choose)),
    )


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "budget.toml"
    path.write_text(
        '[[require]]\nmetric = "pst_band"\nlow_deg = 20\nhigh_deg = 80\nlimit = 1e-6\n'
        '[[choose]]\nsurfaces = "L*"\nparameter = "level"\nvalues = [100, 300]\ncosts = [3, 1]\n'
        '[[choose]]\nsurfaces = ["L*"]\nparameter = "rms_nm"\nbest = 1\nworst = 4\ncost = { exponent = 2 }\n'
        "[traced]\nrays = 1000\n"
    )
    found = read_budget(path)
    assert found.requirements[0].arguments == {"low_deg": 20, "high_deg": 80, "rays": 1000}
    assert found.choices[0].cost == StepCost((100.0, 300.0), (3.0, 1.0))
    assert found.choices[1].cost == PowerCost(1.0, 4.0, 2.0)
    assert read_budget(found) is found
    path.write_text("[[require]\n")
    each_refused((path, "correct the TOML"), (tmp_path / "no.toml", "No such file"), by=read_budget)


def test_weights_belong_to_the_wavelengths_beside_them() -> None:
    require = {**study(1.0)["require"][0], "wavelength_nm": [450, 650]}
    traced = {"rays": 1000, "wavelength_nm": [500, 600], "weights": [1, 9]}
    for given, weights in ((require, None), (require | {"weights": [3, 1]}, (3, 1))):
        (found,) = read_budget(study(1.0, require=[given], traced=traced)).requirements
        assert (found.arguments["wavelength_nm"], found.arguments.get("weights")) == ((450, 650), weights)


def polish(weight: float = 1.0, low: float = 0.01, high: float = 100.0, exponent: float = 1.0) -> ToleranceChoice:
    return ToleranceChoice("rms_nm", AS_GIVEN, low, high, PowerCost(weight, 1.0, exponent))


class TestByHand:
    """Surfaces with M = Σ a σ² + fixed and the cost Σ w/σ^q.

    Lagrange: q w_i/σ_i^(q+1) = 2 λ a_i σ_i, so that σ_i ~ (w_i/a_i)^(1/(q+2)), and Σ a_i σ_i² = limit - fixed gives λ.
    """

    weights, factors, fixed, limit = np.array([1.0, 5.0]), np.array([2e-8, 7e-9]), 3e-8, 1e-7

    def test_numbers_and_the_model_from_derivatives(self) -> None:
        model = Model(np.array([self.fixed]), (self.factors * AS_GIVEN**2)[None, :])
        free = by_hand(self.weights, self.factors, self.limit - self.fixed)
        found = allocate([polish(w) for w in self.weights], model, np.array([self.limit]))
        assert found == pytest.approx(free, rel=1e-5)
        wrong = by_hand(self.weights, self.factors * [1.0, 1.2], self.limit - self.fixed)
        assert abs(found / wrong - 1).max() > 0.03  # a wrong part is seen
        assert self.fixed + self.factors @ found**2 == pytest.approx(self.limit, rel=1e-6)
        # A bound holds one, and the rest follows from the limit
        low = 1.2 * free[0]
        found = allocate([polish(self.weights[0], low=low), polish(self.weights[1])], model, np.array([self.limit]))
        second = np.sqrt((self.limit - self.fixed - self.factors[0] * low**2) / self.factors[1])
        assert found == pytest.approx([low, second], rel=1e-5)
        # Of M = fixed + Σ a σ² the derivative is 2 a σ, the part is a σ²
        variables, value = [polish(), polish()], self.fixed + self.factors.sum() * AS_GIVEN**2
        model = Model.of(variables, np.array([value]), (2 * self.factors * AS_GIVEN)[None, :])
        assert model.fixed == pytest.approx([self.fixed], rel=1e-12)
        expected = self.fixed + self.factors @ [1.0, 9.0]
        assert model.metrics(variables, np.array([1.0, 3.0])) == pytest.approx([expected], rel=1e-12)

    def test_exponents_and_several_limits(self) -> None:
        weights, factors, q = np.array([1.0, 2.0, 9.0]), np.array([1.0, 4.0, 0.2]), 2.5
        model = Model(np.zeros(1), (factors * AS_GIVEN**2)[None, :])
        for low in (0.01, 1e-6):
            found = allocate([polish(w, low, exponent=q) for w in weights], model, np.array([10.0]))
            assert found == pytest.approx(by_hand(weights, factors, 10.0, q), rel=1e-4)
        # Nothing to do is the cheapest; each of two metrics sees one surface
        model = Model(np.array([1.0]), np.array([[1.0, 1.0]]))
        assert allocate([polish(high=8.0), polish(high=6.0)], model, np.array([100.0])) == pytest.approx([8.0, 6.0])
        found = allocate([polish(), polish()], Model(np.zeros(2), np.diag([1.0, 2.0])), np.array([0.25, 0.02]))
        assert found == pytest.approx([AS_GIVEN * 0.5, AS_GIVEN * 0.1], rel=1e-6)


class TestGrades:
    levels, costs = (100.0, 200.0, 300.0, 400.0, 500.0), (9.0, 5.0, 3.0, 2.0, 1.0)
    grade = ToleranceChoice("level", 300.0, 100.0, 500.0, StepCost(levels, costs))

    def test_against_all_choices(self) -> None:
        variables, parts = [self.grade] * 3, np.array([[1.0, 3.0, 0.5]])
        model = Model(np.array([0.1]), parts)
        ratios = [float(self.grade.ratio(np.array(level))) for level in self.levels]
        for limit in (0.5, 1.0, 2.0, 5.0, 50.0):
            found = allocate(variables, model, np.array([limit]))
            choices = [
                (sum(self.costs[k] for k in choice), [self.levels[k] for k in choice])
                for choice in itertools.product(range(5), repeat=3)
                if 0.1 + sum(part * ratios[k] for part, k in zip(parts[0], choice, strict=True)) <= limit
            ]
            least = min(cost for cost, _ in choices)
            assert sum(float(v.cost(p)) for v, p in zip(variables, found, strict=True)) == pytest.approx(least)
            assert list(found) in [numbers for _, numbers in choices]

    def test_beside_a_continuous_one(self) -> None:
        """Against all grades, each with the σ that the rest of the limit allows."""
        model = Model(np.array([0.1]), np.array([[1.0, 1.0]]))
        found = allocate([self.grade, polish(12.0)], model, np.array([1.5]))
        left = [max(1.4 - float(self.grade.ratio(np.array(level))), 1e-9) for level in self.levels]
        choices = zip(self.costs, self.levels, AS_GIVEN * np.sqrt(left), strict=True)
        _, level, sigma = min((cost + 12 / sigma, level, sigma) for cost, level, sigma in choices)
        assert found == pytest.approx([level, sigma], rel=1e-5)
        # Who wants 250 has to order 200
        costs = StepCost(self.levels, self.costs)(np.array([99.0, 100.0, 250.0, 500.0, 900.0]))
        assert costs.tolist() == [9.0, 9.0, 5.0, 1.0, 1.0]


def test_particles_follow_the_standard() -> None:
    """Area covered at two levels, ratio from the standard's own formula to 3 %: its curve and the integral differ."""
    few, many = (allocation.relative_scatter("level", np.array([level])) for level in (300.0, 500.0))
    standard = 10 ** (0.926 * (np.log10(300.0) ** 2 - np.log10(500.0) ** 2))
    assert few / many == pytest.approx(standard, rel=0.03)
    assert allocation.elasticity("level", 300.0) == pytest.approx(2 * 0.926 * np.log(300.0) / np.log(10), rel=0.03)
    assert allocation.elasticity("rms_nm", 3.0) == 2

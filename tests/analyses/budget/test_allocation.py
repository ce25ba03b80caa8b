"""The least cost that meets limits, against Lagrange multipliers by hand, enumeration, and what cannot be met."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mistray.analyses.budget.allocation import (
    Model,
    PowerCost,
    StepCost,
    ToleranceChoice,
    allocate,
    elasticity,
    relative_scatter,
)

AS_GIVEN = 4.0  # σ of all surfaces before, nm


def polish(weight: float = 1.0, low: float = 0.01, high: float = 100.0, exponent: float = 1.0) -> ToleranceChoice:
    return ToleranceChoice("rms_nm", AS_GIVEN, low, high, PowerCost(weight, 1.0, exponent))


class TestByHand:
    """Surfaces with M = Σ a σ² + fixed and the cost Σ w/σ^q.

    Lagrange: q w_i/σ_i^(q+1) = 2 λ a_i σ_i, so that σ_i ~ (w_i/a_i)^(1/(q+2)), and Σ a_i σ_i² = limit - fixed gives λ.
    """

    weights, factors, fixed, limit = np.array([1.0, 5.0]), np.array([2e-8, 7e-9]), 3e-8, 1e-7

    def by_hand(self, factors: np.ndarray) -> np.ndarray:
        unscaled = (self.weights / factors) ** (1 / 3)
        return unscaled * np.sqrt((self.limit - self.fixed) / np.sum(factors * unscaled**2))

    def test_numbers(self) -> None:
        model = Model(np.array([self.fixed]), (self.factors * AS_GIVEN**2)[None, :])
        free = self.by_hand(self.factors)
        found = allocate([polish(w) for w in self.weights], model, np.array([self.limit]))
        assert found == pytest.approx(free, rel=1e-5)
        assert abs(found / self.by_hand(self.factors * [1.0, 1.2]) - 1).max() > 0.03  # a wrong part is seen
        assert self.fixed + self.factors @ found**2 == pytest.approx(self.limit, rel=1e-6)
        # A bound holds one, and the rest follows from the limit
        low = 1.2 * free[0]
        found = allocate([polish(self.weights[0], low=low), polish(self.weights[1])], model, np.array([self.limit]))
        second = np.sqrt((self.limit - self.fixed - self.factors[0] * low**2) / self.factors[1])
        assert found == pytest.approx([low, second], rel=1e-5)

    def test_the_model_from_derivatives(self) -> None:
        """Of M = fixed + Σ a σ² the derivative is 2 a σ, the part is a σ²."""
        variables = [polish(), polish()]
        value = self.fixed + self.factors.sum() * AS_GIVEN**2
        model = Model.of(variables, np.array([value]), (2 * self.factors * AS_GIVEN)[None, :])
        assert model.fixed == pytest.approx([self.fixed], rel=1e-12)
        expected = self.fixed + self.factors @ [1.0, 9.0]
        assert model.metrics(variables, np.array([1.0, 3.0])) == pytest.approx([expected], rel=1e-12)

    def test_exponents_and_several_limits(self) -> None:
        weights, factors, q = np.array([1.0, 2.0, 9.0]), np.array([1.0, 4.0, 0.2]), 2.5
        model = Model(np.zeros(1), (factors * AS_GIVEN**2)[None, :])
        found = allocate([polish(w, exponent=q) for w in weights], model, np.array([10.0]))
        shape = (weights / factors) ** (1 / (q + 2))
        assert found == pytest.approx(shape * np.sqrt(10 / np.sum(factors * shape**2)), rel=1e-5)
        # Nothing to do is the cheapest; each of two metrics sees one surface
        model = Model(np.array([1.0]), np.array([[1.0, 1.0]]))
        assert allocate([polish(high=8.0), polish(high=6.0)], model, np.array([100.0])) == pytest.approx([8.0, 6.0])
        found = allocate([polish(), polish()], Model(np.zeros(2), np.diag([1.0, 2.0])), np.array([0.25, 0.02]))
        assert found == pytest.approx([AS_GIVEN * 0.5, AS_GIVEN * 0.1], rel=1e-6)


class TestGrades:
    levels = (100.0, 200.0, 300.0, 400.0, 500.0)
    costs = (9.0, 5.0, 3.0, 2.0, 1.0)

    def variables(self) -> list[ToleranceChoice]:
        return [ToleranceChoice("level", 300.0, 100.0, 500.0, StepCost(self.levels, self.costs)) for _ in range(3)]

    def test_against_all_choices(self) -> None:
        variables, parts = self.variables(), np.array([[1.0, 3.0, 0.5]])
        model = Model(np.array([0.1]), parts)
        ratios = [float(variables[0].ratio(np.array(level))) for level in self.levels]
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
        grade = ToleranceChoice("level", 300.0, 100.0, 500.0, StepCost(self.levels, self.costs))
        variables, model = [grade, polish(12.0)], Model(np.array([0.1]), np.array([[1.0, 1.0]]))
        found = allocate(variables, model, np.array([1.5]))
        best = []
        for level, cost in zip(self.levels, self.costs, strict=True):
            left = 1.4 - float(grade.ratio(np.array(level)))
            if left > 0:
                sigma = AS_GIVEN * np.sqrt(left)
                best.append((cost + 12 / sigma, level, sigma))
        _, level, sigma = min(best)
        assert found == pytest.approx([level, sigma], rel=1e-5)

        # Who wants 250 has to order 200
        costs = StepCost(self.levels, self.costs)(np.array([99.0, 100.0, 250.0, 500.0, 900.0]))
        assert costs.tolist() == [9.0, 9.0, 5.0, 1.0, 1.0]


def test_particles_follow_the_standard() -> None:
    """Area covered at two levels, ratio from the standard's own formula to 3 %: its curve and the integral differ."""
    ratio = relative_scatter("level", np.array([300.0])) / relative_scatter("level", np.array([500.0]))
    standard = 10 ** (0.926 * (np.log10(300.0) ** 2 - np.log10(500.0) ** 2))
    assert ratio == pytest.approx(standard, rel=0.03)
    slope = 2 * 0.926 * np.log(300.0) / np.log(10)
    assert elasticity("level", 300.0) == pytest.approx(slope, rel=0.03)
    assert elasticity("rms_nm", 3.0) == 2

"""
The merit of a design: one smooth number made of the terms of a study, and its derivative by the variables.

With v the value of a term, v₀ that of the first start, w its weight, t its tolerance and b its limit, the merit is the
sum of

    minimise   w ln(v / v₀)
    at_least   w max(0, 1 - (v - b) / (t |b|))²
    at_most    w max(0, 1 - (b - v) / (t |b|))²
    keep       w ((v - v₀) / (t |v₀|))²

A limit costs w where it is just met and nothing from t |b| inside of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.optimize.gradient import gradient
from mistray.optimize.metrics import combine
from mistray.optimize.study import Optimizer, Study, Term
from mistray.optimize.terms import layer_value, of_layers, traced_metric
from mistray.optimize.variables import Variables


def contribution(term: Term, value: Any, start: Any, limit: Any) -> Any:
    """
    What a term adds to the merit.

    Parameters
    ----------
    term : Term
    value, start, limit : float or mi.Float64
        Of the term, in its unit; `limit` counts for "at_least" and "at_most" only, `start` for the others.

    Returns
    -------
    float or mi.Float64
    """
    if term.goal == "minimise":
        return term.weight * dr.log(value / start)
    if term.goal == "keep":
        return term.weight * dr.square((value - start) / (term.tolerance * dr.abs(start)))
    inside = value - limit if term.goal == "at_least" else limit - value
    return term.weight * dr.square(dr.maximum(1 - inside / (term.tolerance * dr.abs(limit)), 0))


def limit_of(term: Term, start: float) -> float | None:
    """The limit of a term whose value at the start is known; None if it has none."""
    return term.limit if term.limit_of_start is None else term.limit_of_start * start


def holds(term: Term, value: float, start: float) -> bool:
    """Whether a value, with that at the start, is one that the goal of a term allows; "minimise" allows all."""
    if term.goal == "minimise":
        return True
    if term.goal == "keep":
        return abs(value - start) <= term.tolerance * abs(start)
    limit = limit_of(term, start)
    assert limit is not None
    return value >= limit if term.goal == "at_least" else value <= limit


def seed_of(optimizer: Optimizer, number: int) -> int:
    """Seed of the rays of an evaluation, the first of a search being number 0."""
    if optimizer.seeds == "fixed" or number == 0:
        return optimizer.seed
    return int(np.random.SeedSequence((optimizer.seed, number)).generate_state(1)[0])


class Merit:
    """
    The merit of a scene.

    Parameters
    ----------
    study : Study
    scene : mi.Scene
    params : mi.SceneParameters
    variables : Variables
    thickness_keys : mapping of str to str
        Name of a coating → key of its thicknesses.

    Attributes
    ----------
    start : dict or None
        Name of a term → its value at the first point evaluated, to which the merit refers. Set by the first evaluation,
        or by whoever knows it.
    """

    def __init__(
        self,
        study: Study,
        scene: Any,
        params: Any,
        variables: Variables,
        thickness_keys: Mapping[str, str] | None = None,
    ) -> None:
        self.study, self.scene, self.params, self.variables = study, scene, params, variables
        self.thickness_keys = thickness_keys or {}
        self.start: dict[str, float] | None = None

    @property
    def least(self) -> float:
        """What the merit cannot fall below: 0 if there are limits only."""
        return -math.inf if any(term.goal == "minimise" for term in self.study.terms) else 0.0

    def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
        """
        The merit at a point.

        Parameters
        ----------
        y : (n,) float64
            Shares of the way from bound to bound.
        number : int
            Of the evaluation in its search; decides the seed if seeds are fresh.

        Returns
        -------
        dict
            merit, merit_se, slope (n,) by y, terms, traced_seconds, left_out.

        Raises
        ------
        MistrayError
            If a term to be minimised is 0, or anything is not finite, or there is nothing to improve.
        """
        x = self.variables.values(y)
        self.variables.apply(x)
        seed = seed_of(self.study.optimizer, number)
        layers = {
            term.name: layer_value(term, self.study.coatings, self.thickness_keys, self.variables.parameters(x))
            for term in self.study.terms
            if of_layers(term)
        }
        leaves = {name: dr.opaque(mi.Float64, value) for name, (value, _) in layers.items()}
        dr.enable_grad(leaves)
        values: dict[str, float] = {}

        def merit(traced: Mapping[str, Any]) -> Any:
            every = {**traced, **leaves}
            values.update({t.name: float(dr.detach(mi.Float64(every[t.name]))[0]) for t in self.study.terms})
            self._check(values, x)
            start = {name: dr.opaque(mi.Float64, value) for name, value in self._started(values).items()}
            total = mi.Float64(0.0)
            for term in self.study.terms:
                limit = limit_of(term, self._started(values)[term.name])
                at = None if limit is None else dr.opaque(mi.Float64, limit)
                total = total + contribution(term, every[term.name], start[term.name], at)
            return total

        metrics = {term.name: traced_metric(term, self.scene, seed) for term in self.study.terms if not of_layers(term)}
        result = gradient(combine(metrics, merit), self.params, self.variables.keys)
        slope = self.variables.slope(result.gradient, x)
        for name, (_, by_thickness) in layers.items():
            by_value = float(np.broadcast_to(np.array(dr.grad(leaves[name])), 1)[0])
            slope += by_value * self.variables.slope(by_thickness, x)
        if not np.all(np.isfinite(slope)):
            raise MistrayError(
                f"study '{self.study.name}': the gradient is not finite at {self._point(x)}; change the bounds so that "
                "they leave this out"
            )
        if self.start is None:
            if result.value == self.least:
                raise MistrayError(
                    f"study '{self.study.name}': the merit is 0, nothing is to be minimised and all limits hold; add a "
                    'term with goal = "minimise" or narrow the limits'
                )
            self.start = values
        return {
            "merit": result.value,
            "merit_se": result.value_se,
            "slope": slope * self.variables.stretch(x),
            "terms": values,
            "traced_seconds": sum(result.seconds),
            "left_out": result.left_out,
        }

    def broken(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Names of the terms whose values break their limit."""
        start = self._started(values)
        return tuple(t.name for t in self.study.terms if not holds(t, values[t.name], start[t.name]))

    def _started(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Values at the start; those of this point if it is the start."""
        return values if self.start is None else self.start

    def _check(self, values: Mapping[str, float], x: np.ndarray) -> None:
        for term in self.study.terms:
            value = values[term.name]
            where = f"study '{self.study.name}', term '{term.name}'"
            if not math.isfinite(value):
                raise MistrayError(f"{where}: its value is {value} at {self._point(x)}; change the bounds or the term")
            if term.goal == "minimise" and value <= 0:
                raise MistrayError(
                    f"{where}: its value is {value:g} at {self._point(x)}; no light goes there, take more rays, "
                    "another term or other bounds"
                )
            start = self._started(values)[term.name]
            if term.goal == "keep" and start == 0:
                raise MistrayError(f"{where}: its value at the start is 0, which cannot be kept within a share of it")
            if limit_of(term, start) == 0:
                raise MistrayError(f"{where}: its limit is 0; the tolerance is relative to it, give another number")

    def _point(self, x: np.ndarray) -> str:
        shown = [f"{v.name} = {value:.6g}" for v, value in zip(self.variables.variables, x, strict=True)]
        return ", ".join(shown[:4]) + (", …" if len(shown) > 4 else "")

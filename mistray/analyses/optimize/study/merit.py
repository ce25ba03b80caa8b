"""Merit (figure to be minimised) of a scene as a function of a study's variables, with its gradient; see `goals`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.analyses.optimize.search.point import Pieces
from mistray.analyses.optimize.study.goals import by_value, check, contribution, holds, least_merit, pieces
from mistray.analyses.optimize.study.model import DesignStudy, Optimizer
from mistray.analyses.optimize.study.state import Evaluation
from mistray.analyses.optimize.study.terms import layer_value, of_layers, traced_metric
from mistray.analyses.optimize.study.variables import Variables
from mistray.errors import MistrayError
from mistray.metrics.combined_metric import combine
from mistray.metrics.gradient import Gradient, chosen_parameters, gradient_request, gradient_seen
from mistray.metrics.metric import Metric

WHOLE = "merit"  # the gradient of all terms at once


def seed_of(optimizer: Optimizer, number: int) -> int:
    """Return the random seed of the rays for evaluation `number` of a search, counted from 0."""
    if optimizer.seeds == "fixed" or number == 0:
        return optimizer.seed
    return int(np.random.SeedSequence((optimizer.seed, number)).generate_state(1)[0])


class Merit:
    """
    Merit of a scene, dimensionless, as a function of the variables of a study, with its gradient.

    Parameters
    ----------
    study : DesignStudy
        Study of the design.
    scene : mi.Scene
        Loaded scene.
    params : mi.SceneParameters
        Parameters of the scene, ``mi.traverse(scene)``.
    variables : Variables
        Variables of the study in this scene.
    thickness_keys : mapping of str to str
        Name of a coating of the study → key of its thicknesses; None: the study has no coatings.

    Attributes
    ----------
    start : dict or None
        Name of a term → its value at the first point evaluated, to which the merit refers. Set by the first evaluation,
        or by the caller; None before.
    edge_widths : dict
        Width of the zones at rims, over their radii, of each gradient: `WHOLE` or the name of a term. It is set by the
        first evaluation that meets rims and kept, so that the slopes of a search are consistent.
    """

    def __init__(
        self,
        study: DesignStudy,
        scene: Any,
        params: Any,
        variables: Variables,
        thickness_keys: Mapping[str, str] | None = None,
    ) -> None:
        self.study, self.scene, self.params, self.variables = study, scene, params, variables
        self.thickness_keys = thickness_keys or {}
        self.start: dict[str, float] | None = None
        self.edge_widths: dict[str, float] = {}

    @property
    def least(self) -> float:
        """Least possible value of the merit, dimensionless; 0 if the study has limits only."""
        return least_merit(self.study.terms)

    def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
        """
        Return the merit and its gradient at a point.

        Parameters
        ----------
        y : (n,) float64
            Variables as shares of the way from the low to the high bound, 0 … 1.
        number : int
            Index of the evaluation in its search, from 0; decides the seed if seeds are fresh.

        Returns
        -------
        dict
            merit, merit_se, slope (derivatives of the merit with respect to y, (n,)), terms, slopes, traced_seconds
            (s), left_out, edge_widths. `slopes` are the derivatives of the terms with respect to y for "sqp", otherwise
            empty.

        Raises
        ------
        MistrayError
            If the values give no merit, see `goals.check`, the gradient is not finite, or the first point has the least
            possible merit.
        """
        x = self.variables.values(y)
        self.variables.apply(self.params, x)
        seed = seed_of(self.study.optimizer, number)
        parameters = self.variables.parameters(x)
        layers = {
            term.name: layer_value(term, self.study.coatings, self.thickness_keys, parameters)
            for term in self.study.terms
            if of_layers(term)
        }
        metrics = {term.name: traced_metric(term, self.scene, seed) for term in self.study.terms if not of_layers(term)}
        evaluate = self._one_by_one if self.study.optimizer.method == "sqp" else self._together
        found = evaluate(metrics, layers, x)
        stretch = self.variables.stretch(x)
        found["slope"] = found["slope"] * stretch
        found["edge_widths"] = dict(self.edge_widths)
        found["slopes"] = {name: slope * stretch for name, slope in found["slopes"].items()}
        for slope in (found["slope"], *found["slopes"].values()):
            if not np.all(np.isfinite(slope)):
                raise MistrayError(
                    f"study '{self.study.name}': the gradient is not finite at {self._point(x)}; change the bounds so "
                    "that they leave this out"
                )
        if self.start is None:
            if found["merit"] == self.least:
                raise MistrayError(
                    f"study '{self.study.name}': the merit is 0, nothing is to be minimised and all limits hold; add a "
                    'term with goal = "minimise" or narrow the limits'
                )
            self.start = found["terms"]
        return found

    def _together(
        self, metrics: Mapping[str, Metric], layers: Mapping[str, tuple[float, dict[str, np.ndarray]]], x: np.ndarray
    ) -> dict[str, Any]:
        """
        Return the dictionary of `evaluate` from one reverse-mode differentiation of all terms together.

        `layers` are the results of `layer_value` by term. The slope is that with respect to the variables `x`, (n,), in
        their units.
        """
        leaves = {name: dr.opaque(mi.Float64, value) for name, (value, _) in layers.items()}
        dr.enable_grad(leaves)
        values: dict[str, float] = {}

        def merit(traced: Mapping[str, Any]) -> Any:
            every = {**traced, **leaves}
            values.update(self._checked(every, x))
            start = values if self.start is None else self.start
            total = mi.Float64(0.0)
            for term in self.study.terms:
                total = total + contribution(term, mi.Float64(every[term.name]), start[term.name])
            return total

        whole, width = combine(metrics, merit), self._edge_width(WHOLE)
        chosen = chosen_parameters(self.scene, self.params, self.variables.keys)
        result = gradient_seen(whole, whole.observe(), chosen, gradient_request(chosen.values(), edge_width=width))
        self._keep(WHOLE, result)
        slope = self.variables.slope(result.gradient, x)
        for name, (_, by_thickness) in layers.items():
            by_leaf = float(np.broadcast_to(np.array(dr.grad(leaves[name])), 1)[0])
            slope += by_leaf * self.variables.slope(by_thickness, x)
        return {
            "merit": result.value,
            "merit_se": result.value_se,
            "slope": slope,
            "terms": values,
            "slopes": {},
            "traced_seconds": sum(result.seconds),
            "left_out": result.left_out,
        }

    def _one_by_one(
        self, metrics: Mapping[str, Metric], layers: Mapping[str, tuple[float, dict[str, np.ndarray]]], x: np.ndarray
    ) -> dict[str, Any]:
        """Return the dictionary of `evaluate` by one reverse-mode pass per term; see `_together` for the arguments."""
        whole = combine(metrics, lambda traced: mi.Float64(0.0))
        observations = whole.observe()
        chosen = chosen_parameters(self.scene, self.params, self.variables.keys)
        found = {}
        for name in metrics:
            request = gradient_request(chosen.values(), edge_width=self._edge_width(name))
            found[name] = gradient_seen(whole.part(name), observations, chosen, request)
            self._keep(name, found[name])
        slopes = {name: self.variables.slope(result.gradient, x) for name, result in found.items()}
        slopes |= {name: self.variables.slope(by_thickness, x) for name, (_, by_thickness) in layers.items()}
        values = self._checked(
            {**{name: result.value for name, result in found.items()}, **{name: v for name, (v, _) in layers.items()}},
            x,
        )
        start = values if self.start is None else self.start
        apart = pieces(self.study.terms, values, slopes, start)
        total, noise = 0.0, 0.0
        for term in self.study.terms:
            value, at_start = values[term.name], start[term.name]
            total += float(contribution(term, dr.opaque(mi.Float64, value), at_start)[0])
            if term.name in found:
                noise = math.hypot(noise, by_value(term, value, at_start) * found[term.name].value_se)
        return {
            "merit": total,
            "merit_se": noise,  # as if the noise of the terms had nothing in common
            "slope": apart.slope + apart.rows.T @ apart.multipliers,
            "terms": values,
            "slopes": slopes,
            "traced_seconds": sum(o.seconds for o in observations) + sum(r.seconds[1] for r in found.values()),
            "left_out": [text for result in found.values() for text in result.left_out],
        }

    def _edge_width(self, name: str) -> float | None:
        return self.edge_widths.get(name, self.study.optimizer.edge_width)

    def _keep(self, name: str, found: Gradient) -> None:
        if found.edge_width is not None:
            self.edge_widths[name] = found.edge_width

    def pieces(self, at: Evaluation) -> Pieces | None:
        """Return smooth part and penalties of an evaluated merit; None if the terms were differentiated together."""
        if not at.slopes:
            return None
        return pieces(self.study.terms, at.terms, at.slopes, self.start or at.terms)

    def broken(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Return the names of the terms whose values violate their limits, or the tolerance of the goal "keep"."""
        start = self.start or values
        return tuple(t.name for t in self.study.terms if not holds(t, values[t.name], start[t.name]))

    def _checked(self, every: Mapping[str, Any], x: np.ndarray) -> dict[str, float]:
        """
        Return the values of a study's terms, by name, each in its unit, after a check.

        `every` has them as Dr.Jit or Python numbers; `x` are the variables, (n,). Raise `MistrayError` if they give no
        merit.
        """
        values = {t.name: float(dr.detach(mi.Float64(every[t.name]))[0]) for t in self.study.terms}
        check(self.study.terms, values, self.start or values, f"study '{self.study.name}'", self._point(x))
        return values

    def _point(self, x: np.ndarray) -> str:
        shown = [f"{v.name} = {value:.6g}" for v, value in zip(self.variables.variables, x, strict=True)]
        return ", ".join(shown[:4]) + (", …" if len(shown) > 4 else "")

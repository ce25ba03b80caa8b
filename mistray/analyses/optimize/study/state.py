"""State of an optimisation: start points, all evaluations of the merit, and steps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Start:
    """
    Point in the space of variables from which a search can start.

    Attributes
    ----------
    name : str
        Origin of the point.
    x : (variables,) float64
        Values of the variables, in their units.

    Examples
    --------
    >>> start = mistray.optimize.Start("given design", np.array([100.0]))
    >>> start.name, start.x
    ('given design', array([100.]))
    """

    name: str
    x: np.ndarray


@dataclass(frozen=True)
class Evaluation:
    """
    Merit of a study and its gradient at one point of the variables.

    Attributes
    ----------
    y : (variables,) float64
        The point, as shares of the way from the low to the high bound, 0 … 1.
    merit, merit_se : float
        The merit and its standard error, dimensionless.
    slope : (variables,) float64
        d merit/d y, dimensionless.
    terms : dict
        Name of a term → its value, in its unit.
    slopes : dict
        Name of a term → (variables,) float64, d value/dy, in the unit of the term; empty unless the method works with
        them.
    seconds : float
        Time since the beginning of the optimisation, s, without interruptions.
    traced_seconds : float
        Time of the traces and of their derivatives in this evaluation, s.
    edge_widths : dict
        Relative widths of the smoothing zones at rims, see `mistray.analyses.optimize.study.merit.Merit`.
    """

    y: np.ndarray
    merit: float
    merit_se: float
    slope: np.ndarray
    terms: dict[str, float]
    slopes: dict[str, np.ndarray]
    seconds: float
    traced_seconds: float
    edge_widths: dict[str, float] = field(default_factory=dict)

    @property
    def free_slope(self) -> np.ndarray:
        """Gradient d merit/d y, (variables,), dimensionless, with 0 for the variables that are held by a bound."""
        held = ((self.y <= 0) & (self.slope > 0)) | ((self.y >= 1) & (self.slope < 0))
        return np.where(held, 0.0, self.slope)


@dataclass(frozen=True)
class Step:
    """
    Step of a search: merit, terms and values of the variables.

    Attributes
    ----------
    start : int
        Index of the start that the search began with.
    step : int
        Number of the step; 0 is the start itself.
    evaluations : int
        Evaluations of the merit so far, all searches together.
    merit, merit_se : float
        The merit and its standard error, dimensionless; the merit is 0 at the first start but for penalties of limits.
    terms : dict
        Name of a term → its value, in its unit.
    broken : tuple of str
        Names of the terms that break their limit, or with the goal "keep" their tolerance.
    gradient_norm : float
        Root of the sum of squares of d merit/d y, y being the share of the way from bound to bound, over the variables
        that are free to move.
    seconds : float
        Time since the beginning of the optimisation, s, without interruptions.
    x : tuple of float
        Values of the variables, in their units.
    share_done : float
        Part of the work of all searches that is done, 0 … 1, as if each took all of its steps.

    Examples
    --------
    >>> study = {
    ...     "term": [{"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 1000}],
    ...     "coating": [{"name": "ar", "surfaces": ["L1_front"], "layers": "MgF2 80", "thickness_nm": [60, 150]}],
    ... }
    >>> found = mistray.optimize.optimize("lens_and_window", study, steps=2, verification_seeds=2, next_order=False)
    >>> for step in found.steps:
    ...     print(f"{step.step}: {step.x[0]:.0f} nm")
    0: 80 nm
    0: 114 nm
    1: 112 nm
    2: 106 nm
    """

    start: int
    step: int
    evaluations: int
    merit: float
    merit_se: float
    terms: dict[str, float]
    broken: tuple[str, ...]
    gradient_norm: float
    seconds: float
    x: tuple[float, ...]
    share_done: float = field(compare=False)


@dataclass
class State:
    """
    State from which an optimisation can resume: methods are deterministic, so the evaluations reproduce their steps.

    Attributes
    ----------
    starts : list of Start
        Points from which searches start.
    evaluations : list of list of Evaluation
        Evaluations of the search from each start, in the order of time.
    left_out : list of str
        Effects that the gradients do not contain.
    """

    starts: list[Start] = field(default_factory=list)
    evaluations: list[list[Evaluation]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Time of the searches so far, s, without interruptions."""
        return max((e.seconds for evaluations in self.evaluations for e in evaluations), default=0.0)

    @property
    def edge_widths(self) -> dict[str, float]:
        """Width of the zones at rims, relative to their radii, by the names of `Merit.edge_widths`."""
        found: dict[str, float] = {}
        for evaluations in self.evaluations:
            for evaluation in evaluations:
                found |= evaluation.edge_widths
        return found

    @property
    def traced_seconds(self) -> float:
        """Time of the traces and of their derivatives so far, s."""
        return sum(e.traced_seconds for evaluations in self.evaluations for e in evaluations)

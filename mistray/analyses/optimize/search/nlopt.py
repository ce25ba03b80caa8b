"""Gradient methods of NLopt (S. G. Johnson, https://github.com/stevengj/nlopt), if it is installed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.analyses.optimize.search.point import AfterStep, Merit
    from mistray.analyses.optimize.study.model import Optimizer

ALGORITHMS = ("LD_MMA", "LD_CCSAQ", "LD_SLSQP", "LD_LBFGS", "LD_VAR2", "LD_TNEWTON_PRECOND_RESTART")


def installed() -> Any:
    """
    Import and return the package ``nlopt``.

    Raises
    ------
    MistrayError
        If NLopt is not installed.
    """
    try:
        return importlib.import_module("nlopt")
    except ImportError:
        raise MistrayError(
            "optimizer.method is 'nlopt', but nlopt is not installed; pip install 'mistray[nlopt]', or take 'lbfgsb'"
        ) from None


def nlopt_search(function: Merit, y0: np.ndarray, optimizer: Optimizer, after: AfterStep) -> str:
    """
    Minimise a merit by a method of NLopt, see `Search`; every evaluation but the first counts as a step.

    `algorithm` is one of `ALGORITHMS`; `step_size` is the initial step of those that take one.

    Raises
    ------
    MistrayError
        If NLopt is not installed.
    BaseException
        Whatever `function` or `after` raises, such as the end of the search or Ctrl-C.
    """
    nlopt = installed()
    search = nlopt.opt(getattr(nlopt, optimizer.algorithm), len(y0))
    search.set_lower_bounds(np.zeros_like(y0))
    search.set_upper_bounds(np.ones_like(y0))
    search.set_initial_step(optimizer.step_size)
    raised: list[BaseException] = []
    count = 0

    def objective(y: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal count
        here = np.clip(y, 0.0, 1.0)
        try:
            found = function(here)
            if count:
                after(here)
        except BaseException as error:  # NLopt would turn it into one of its own
            raised.append(error)
            raise nlopt.ForcedStop from None
        count += 1
        if gradient.size:
            gradient[:] = found.slope
        return found.merit

    search.set_min_objective(objective)
    try:
        search.optimize(y0)
    except (nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError, ValueError) as error:
        if not raised:
            return f"no lower merit along the gradient (NLopt {optimizer.algorithm}: {error or type(error).__name__})"
    if raised:
        raise raised[0]
    return f"no lower merit along the gradient (NLopt {optimizer.algorithm}, code {search.last_optimize_result()})"

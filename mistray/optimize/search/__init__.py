"""Methods that follow a gradient within bounds, all of them as one function each."""

from mistray.optimize.search.adam import adam
from mistray.optimize.search.lbfgsb import lbfgsb
from mistray.optimize.search.nlopt import nlopt_search
from mistray.optimize.search.sqp import sqp
from mistray.optimize.search.stop import stop_reason

METHODS = {"sqp": sqp, "lbfgsb": lbfgsb, "adam": adam, "nlopt": nlopt_search}

__all__ = ["METHODS", "adam", "lbfgsb", "nlopt_search", "sqp", "stop_reason"]


def __dir__() -> list[str]:
    return sorted(__all__)

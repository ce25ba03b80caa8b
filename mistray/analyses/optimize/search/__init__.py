"""Search methods that follow a gradient within bounds, one function each."""

from mistray.analyses.optimize.search.adam import adam
from mistray.analyses.optimize.search.lbfgsb import lbfgsb
from mistray.analyses.optimize.search.nlopt import nlopt_search
from mistray.analyses.optimize.search.point import Search
from mistray.analyses.optimize.search.sqp import sqp
from mistray.analyses.optimize.search.stop import stop_reason

METHODS: dict[str, Search] = {"sqp": sqp, "lbfgsb": lbfgsb, "adam": adam, "nlopt": nlopt_search}

__all__ = ["METHODS", "Search", "adam", "lbfgsb", "nlopt_search", "sqp", "stop_reason"]


def __dir__() -> list[str]:
    return sorted(__all__)

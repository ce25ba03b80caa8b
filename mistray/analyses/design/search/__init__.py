"""Search methods that follow a gradient within bounds, one function each."""

from mistray.analyses.design.search.adam import adam
from mistray.analyses.design.search.lbfgsb import lbfgsb
from mistray.analyses.design.search.nlopt import nlopt_search
from mistray.analyses.design.search.point import Search
from mistray.analyses.design.search.sqp import sqp
from mistray.analyses.design.search.stop import stop_reason

METHODS: dict[str, Search] = {"sqp": sqp, "lbfgsb": lbfgsb, "adam": adam, "nlopt": nlopt_search}

__all__ = ["METHODS", "Search", "adam", "lbfgsb", "nlopt_search", "sqp", "stop_reason"]


def __dir__() -> list[str]:
    return sorted(__all__)

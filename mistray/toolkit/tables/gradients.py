"""Table of a gradient: derivatives of a metric with their errors."""

from __future__ import annotations

import math

from mistray.estimate import Estimate
from mistray.metrics.gradient import Gradient
from mistray.toolkit.pages.model import Table, columns


def derivatives(found: Gradient) -> dict[str, Estimate]:
    """
    Return derivatives with standard errors, in metric per unit of the parameter, by parameter key.

    The key of an array is followed by the index of the entry. `Gradient.untouched` parameters are left out.
    """
    return {
        f"{key}[{entry}]" if len(values) > 1 else key: Estimate(float(value), float(se))
        for key, values in found.gradient.items()
        if key not in found.untouched
        for entry, (value, se) in enumerate(zip(values, found.standard_error[key], strict=True))
    }


def gradient_table(found: Gradient) -> Table:
    """Return the table of derivatives, in metric per unit of the parameter, the largest relative to its error first."""
    rows = sorted(derivatives(found).items(), key=lambda item: -_significance(item[1]))
    heads = columns("<parameter", "derivative [metric per unit of the parameter]")
    return Table(heads, [[key, value] for key, value in rows], empty="the metric depends on no parameter")


def _significance(value: Estimate) -> float:
    if not math.isfinite(value.value):
        return -1.0
    return abs(value.value) / value.se if value.se > 0 else math.inf

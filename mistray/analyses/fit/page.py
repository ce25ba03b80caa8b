"""Table of the parameters that a fit has estimated."""

from __future__ import annotations

from mistray.analyses.fit.run import LIKELY, Fit
from mistray.estimate import Estimate
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.tables.frames import value_text
from mistray.toolkit.tables.text import number


def parameter_table(found: Fit) -> Table:
    """Return the table of fitted parameters: estimate, confidence interval and bounds, in their units."""
    rows: list[list[Value]] = []
    errors = found.standard_error.tolist()
    for name, value, se, *bounds in zip(found.names, found.value, errors, found.low, found.high, strict=True):
        first, last = found.interval(name)
        interval = f"{number(first, 4)} … {number(last, 4)}"
        rows.append(
            [name, Estimate(float(value), se), interval, " … ".join(value_text(float(bound)) for bound in bounds)]
        )
    return Table(columns("<parameter", "estimate", f"interval of {LIKELY:.0%}", "bounds"), rows)

"""Values that meet demands, for what a request cannot do without."""

import dataclasses
from typing import Any

from mistray.ranges import Each, Range, Words, demand_of
from mistray.toolkit.fields import flat_fields


def right(demand: Any) -> Any:
    """A value that meets a demand."""
    match demand:
        case Range():
            return max(demand.low, min(demand.high, 1)) if not (demand.above or demand.below) else demand.high / 2
        case Words():
            return demand.choices[0]
        case Each():
            return [right(demand.of)] * (demand.count or 1)
    return "x"


def needed(kind: type) -> dict[str, Any]:
    """Values of the fields of a request that have no default."""
    fields = [field for field, _ in flat_fields(kind) if field.default is dataclasses.MISSING]
    return {field.name: right(demand_of(field)) for field in fields}

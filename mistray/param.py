"""Properties of the parameters of scatter models, stated once as fields of the model's dataclass."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from mistray.ranges import FINITE, FLAG, Demand, Range

AT_ZERO = 0.02  # tolerance where a relative one says nothing
UNBOUNDED = FINITE.high


@dataclass(frozen=True)
class Param(Demand):
    """
    One parameter of a scatter model.

    The model's constructor checks the value by it. The plugin reads the value from a scene and offers it to
    `mi.traverse`. Sensitivities and optimizations use its range and tolerance, and the command line has an option for
    it.

    Attributes
    ----------
    unit : str
        Unit, "1" for a pure number; for other values their type: "string", "bool" or "file".
    values : Demand
        Condition on the value; a `Range` for a number.
    doc : str
        Short description of the parameter, for help texts.
    tolerance : float
        Usual tolerance relative to the value; an absolute 0.02 if that would be 0.
    differentiable : bool
        Whether a trace has derivatives with respect to it, if it is a number.
    power : float
        Exponent p such that scattered light grows as the number to the power p; used in fits, see
        `mistray.analyses.fit.run`.
    """

    unit: str = "1"
    values: Demand = FINITE
    doc: str = ""
    tolerance: float = 0.2
    differentiable: bool = True
    power: float = 1.0

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that a value must meet, in words, for messages."""
        return self.values.demand

    @property
    def moves(self) -> bool:
        """Whether the parameter is a number with respect to which a trace has derivatives."""
        return self.differentiable and isinstance(self.values, Range)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value of a number; infinite if only the arithmetic limits it."""
        assert isinstance(self.values, Range)
        low, high = self.values.low, self.values.high
        return -math.inf if low <= -UNBOUNDED else low, math.inf if high >= UNBOUNDED else high

    def usual_tolerance(self, value: float) -> float:
        """Return the usual tolerance ± of a parameter with this nominal value, in the unit of the parameter."""
        return self.tolerance * abs(value) or AT_ZERO

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the value; raise `MistrayError` if it is not allowed, see `Range.check`."""
        return self.values.check(name, value, owner)

    def typed(self, value: Any) -> float | bool | str:
        """Convert a property of a scene to its type: a number, a flag or a text."""
        return float(value) if isinstance(self.values, Range) else bool(value) if self.values is FLAG else str(value)

"""Knowledge about the parameters of a scatter model, stated once as the fields of its dataclass."""

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

    The model's constructor checks it, its plugin reads it from a scene and offers it to `mi.traverse`, sensitivities
    and optimizations take range and tolerance from it, and the command line makes an option of it.

    Attributes
    ----------
    unit : str
        1 for a pure number; of what is no number, its type: "string", "bool" or "file".
    values : Demand
        What it must be; a number has a `Range`.
    doc : str
        What it is, in a few words.
    tolerance : float
        Usual one, relative to the value; 0.02 in all where that makes 0.
    differentiable : bool
        Whether a trace has derivatives by it, if it is a number.
    power : float
        Power of the number with which scattered light grows, for fits; see `mistray.analyses.fit.run`.
    """

    unit: str = "1"
    values: Demand = FINITE
    doc: str = ""
    tolerance: float = 0.2
    differentiable: bool = True
    power: float = 1.0

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that a value must meet, in words."""
        return self.values.demand

    @property
    def moves(self) -> bool:
        """Whether it is a number by which there are derivatives."""
        return self.differentiable and isinstance(self.values, Range)

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest value of a number; infinite where only the arithmetic ends it."""
        assert isinstance(self.values, Range)
        low, high = self.values.low, self.values.high
        return -math.inf if low <= -UNBOUNDED else low, math.inf if high >= UNBOUNDED else high

    def usual_tolerance(self, value: float) -> float:
        """Half the width of the range in which a number is found that should have this value."""
        return self.tolerance * abs(value) or AT_ZERO

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """The value; raises `MistrayError` if it is impossible, see `Range.check`."""
        return self.values.check(name, value, owner)

    def typed(self, value: Any) -> float | bool | str:
        """A property of a scene as what it stands for: a number, a flag or a text."""
        return float(value) if isinstance(self.values, Range) else bool(value) if self.values is FLAG else str(value)

"""Parameters of plugins and scatter models, each declared once for scenes, derivatives, messages and manuals."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from enum import Enum
from typing import Any

from mistray.errors import MistrayError
from mistray.ranges import FINITE, FLAG, POSITIVE, Demand, OfType, Range, Words, demand_of, doc_of, number_text

PLACE = ".. parameters::"  # line of the docstring of a plugin where its parameters stand
OBJECT = OfType(object, "must be an object of a scene")
AT_ZERO = 0.02  # tolerance where a relative one says nothing
UNBOUNDED = FINITE.high


class Default(Enum):
    """Marker of a parameter without a default value."""

    REQUIRED = "required"


REQUIRED = Default.REQUIRED


@dataclass(frozen=True)
class Param(Demand):
    """
    One parameter of a plugin or of a scatter model.

    A plugin reads the value from a scene as it says, and offers a number with derivatives to `mi.traverse`. The
    constructor of a model checks its field against it. Sensitivities and optimizations use its range and tolerance. The
    manual, `help`, options of the command line and suggestions for unknown parameters are made from it.

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
    absolute : float or None
        Usual tolerance in its unit, instead of a relative one; None: `tolerance` holds.
    differentiable : bool
        Whether a trace has derivatives with respect to it, if it is a number.
    power : float
        Exponent p such that scattered light grows as the p-th power of the value; used in fits, see
        `mistray.analyses.fit.run`.
    default : Any
        Value if the scene states none; `REQUIRED`: it must state one.
    otherwise : str
        What holds without a value, in words, if the default does not say it: "plane", "shape id".
    within : str
        Allowed values in words, if `values` does not say it: "rigid".
    """

    unit: str = "1"
    values: Demand = FINITE
    doc: str = ""
    tolerance: float = 0.2
    differentiable: bool = True
    power: float = 1.0
    default: Any = REQUIRED
    otherwise: str = ""
    within: str = ""
    absolute: float | None = None

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that a value must meet, in words, for messages."""
        return self.values.demand

    @property
    def moves(self) -> bool:
        """True if the parameter is a number for which a trace can compute derivatives."""
        return self.differentiable and isinstance(self.values, Range)

    @property
    def ends(self) -> tuple[float, float]:
        """Lower and upper limit of a parameter that is a number, in its unit; infinite if there is no bound."""
        assert isinstance(self.values, Range)
        low, high = self.values.low, self.values.high
        return -math.inf if low <= -UNBOUNDED else low, math.inf if high >= UNBOUNDED else high

    def usual_tolerance(self, value: float) -> float:
        """
        Return the usual tolerance (±) for a nominal value, in the unit of the parameter.

        It is `absolute`, if stated; else `tolerance` times the size of the value, or `AT_ZERO` where that would be 0.
        """
        return self.tolerance * abs(value) or AT_ZERO if self.absolute is None else self.absolute

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the value if it is allowed; otherwise raise `MistrayError`, see `Range.check`."""
        return self.values.check(name, value, owner)

    def field(self, default: Any = MISSING, doc: str = "", kw_only: Any = MISSING) -> Any:
        """
        Return a dataclass field for this parameter with a help text, see `Demand.field`.

        `default` is also that of the parameter.
        """
        own = self if default is MISSING else replace(self, default=default)
        return Demand.field(own, default, doc, kw_only)

    def of(self, props: Any, name: str, owner: str) -> Any:
        """
        Return the value of a scene property, converted and checked; the default if the scene does not set it.

        Parameters
        ----------
        props : mi.Properties
            Properties of the plugin.
        name : str
            Name of the property.
        owner : str
            Owner of the property, for messages.

        Raises
        ------
        MistrayError
            If a property without default is missing, or its value is not allowed.
        """
        if name in props:
            return self.typed(props[name], name, owner)
        if self.default is REQUIRED:
            raise MistrayError(f"{owner}: {name} is missing; add what is required")
        return self.default

    def typed(self, value: Any, name: str, owner: str) -> Any:
        """
        Return a scene property converted to the parameter's type: a checked number, flag or word, else a string.

        A value that is not allowed raises `MistrayError`.
        """
        if isinstance(self.values, Range):
            if isinstance(value, bool | str) or (value != value and self.allowed == "±"):
                whole = "whole " if self.values.whole else ""
                raise MistrayError(f"{owner}: {name} is {value!r}; it must be a {whole}number")
            number = self.check(name, value, owner)
            return number if self.values.whole else float(number)
        if self.values is FLAG:
            return self.check(name, bool(value) if value in (0, 1) else value, owner)
        return self.check(name, str(value), owner) if isinstance(self.values, Words) else str(value)

    @property
    def allowed(self) -> str:
        """Allowed values in words for a table cell; empty if the type says it all."""
        if self.within or isinstance(self.values, Words):
            return self.within or ", ".join(self.values.choices)  # type: ignore[attr-defined]
        if not isinstance(self.values, Range):
            return ""
        low, high = self.ends
        if math.isinf(high):
            return "±" if math.isinf(low) else "> 0" if low == POSITIVE.low else f"≥ {number_text(low)}"
        return str(self.values)

    @property
    def usual(self) -> str:
        """Default value in words for a table cell; "none" if it is empty, "required" if a scene must state a value."""
        if self.otherwise or self.default in (None, ""):
            return self.otherwise or "none"
        if isinstance(self.default, tuple):
            return ", ".join(map(number_text, self.default)) if any(self.default) else "none"
        if isinstance(self.default, Default | bool):
            return str(getattr(self.default, "value", self.default)).lower()
        return number_text(self.default) if isinstance(self.default, int | float) else str(self.default)


def fixed(unit: str, values: Demand, doc: str, default: Any = REQUIRED, **more: Any) -> Param:
    """Return a parameter without derivatives; the arguments, `more` of them too, are attributes of `Param`."""
    return Param(unit, values, doc, default=default, differentiable=False, **more)


def params_of(model: Any, last: Container[str] = ()) -> dict[str, Param]:
    """
    Return the parameters of a dataclass by name, from its fields and its class attribute ``also``.

    A field with a demand of another kind has the unit 1 if it is a number, else the type "string". A field without a
    demand is left out. Fields named in `last` come after all others.
    """
    found = {}
    for field in fields(model):
        demand = demand_of(field)
        if isinstance(demand, Param):
            found[field.name] = demand
        elif demand is not None:
            unit, otherwise = "string", ""
            if isinstance(demand, Range):
                unit, otherwise = "1", "no limit" if field.default == demand.high else ""
            found[field.name] = fixed(unit, demand, doc_of(field), field.default, otherwise=otherwise)
    found |= getattr(model, "also", {})
    return {name: found[name] for name in sorted(found, key=lambda name: name in last)}


def grouped(parameters: Mapping[str, Param]) -> list[tuple[list[str], Param]]:
    """Group consecutive parameters with equal definitions; return pairs of their names and the shared definition."""
    groups: list[tuple[list[str], Param]] = []
    for name, param in parameters.items():
        if groups and groups[-1][1] == param:
            groups[-1][0].append(name)
        else:
            groups.append(([name], param))
    return groups


def title_of(names: Sequence[str]) -> str:
    """Return parameter names joined for one table cell: "r0, r1", or "a4 … a20" for four or more."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} … {names[-1]}"


def documented(plugin: type) -> type:
    """Decorate a plugin class: insert the list of its parameters into its docstring, for `help`."""
    lines = []
    for names, param in grouped(plugin.properties):  # type: ignore[attr-defined]
        usual = param.usual if param.usual == REQUIRED.value else f"default {param.usual}"
        lines.append(f"{title_of(names)} : {'; '.join(filter(None, [param.unit, param.allowed, usual]))}")
        lines.append(f"    {param.doc}{' (differentiable)' if param.moves else ''}")
    if plugin.__doc__:  # python -OO has none, and since 3.13 its lines are not indented
        listed = re.compile(f"^( *){re.escape(PLACE)}", re.MULTILINE)
        plugin.__doc__ = listed.sub(lambda found: "\n".join(found[1] + line for line in lines), plugin.__doc__)
    return plugin


def take(plugin: Any, props: Any, name: str) -> Any:
    """Return the value that a scene sets for one of a plugin's `properties`, or its default, see `Param.of`."""
    return plugin.properties[name].of(props, name, plugin.owner)

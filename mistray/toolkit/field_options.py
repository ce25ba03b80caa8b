"""Conversion of the fields of a request into options of a command, and of parsed options into a request."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, TypeVar

from mistray.errors import MistrayError
from mistray.ranges import (
    FLAG,
    Ascending,
    ByName,
    Each,
    Interval,
    OfType,
    Range,
    Several,
    Words,
    demand_of,
    doc_of,
    number_text,
)
from mistray.toolkit.arguments import Angles, Pairs
from mistray.toolkit.command import Group, Option
from mistray.toolkit.fields import METAVAR, NEEDS, OPTION, FieldSubset, Nested, flat_fields, from_flat

R = TypeVar("R")
MARKS = {"µm": "UM", "degrees": "DEG", "1/mm": "F", "cm √Hz/W": "D"}  # placeholders of values by their unit


def flag(name: str) -> str:
    """Return the command-line option for a request field, such as "--field-deg" for field_deg."""
    return f"--{name.replace('_', '-')}"


def option_of(field: dataclasses.Field[Any], default: str = "") -> Option:
    """
    Return the command-line option for a field of a request. For a flag set by default, "--no-…" unsets it.

    Parameters
    ----------
    field : dataclasses.Field
        Field with its allowed values and its description.
    default : str
        Text of the default, where it is not the one of the field.
    """
    option = _option_of(field, default)
    return dataclasses.replace(option, of=field)


def _option_of(field: dataclasses.Field[Any], default: str) -> Option:
    demand, usual = demand_of(field), field.default
    taken_back = demand is FLAG and usual is True
    name = field.metadata.get(OPTION) or flag(f"no_{field.name}" if taken_back else field.name)
    text = f"{'do not ' if taken_back else ''}{doc_of(field).rstrip('.')}"
    if not default and usual is not None and usual is not dataclasses.MISSING and demand is not FLAG:
        default = " ".join(map(_value_text, usual if isinstance(usual, tuple) else (usual,)))
    text += f" ({default})" if default else ""
    metavar = field.metadata.get(METAVAR) or _metavar(demand)
    if demand is FLAG:
        return Option(name, text, bool)
    if isinstance(demand, Words):
        return Option(name, text, demand.choices, field.metadata.get(METAVAR) or None)
    if isinstance(demand, Range):
        return Option(name, text, demand, metavar)
    if isinstance(demand, Each):
        angles = isinstance(demand, Ascending) or (demand.of.unit == "degrees" and not demand.count)
        return Option(name, text, Angles(demand.of) if angles else demand.of, metavar, demand.count or "+")
    if isinstance(demand, Several):
        one = demand.of
        kind = one.choices if isinstance(one, Words) else one if callable(one) else None
        return Option(name, text, kind, metavar, "+")
    if isinstance(demand, Interval):
        return Option(name, text, demand.of, metavar, 2)
    if isinstance(demand, ByName):
        pair = Pairs(f"not {metavar}, such as {demand.example}", demand.of if callable(demand.of) else str)
        return Option(name, text, pair, metavar, "+", extends=True)
    return Option(name, text, metavar=metavar)


def _value_text(value: Any) -> str:
    if isinstance(value, range):
        return f"{value[0]}:{value[-1]}:{value.step}"
    return value if isinstance(value, str) else number_text(value)


def _metavar(demand: Any) -> Any:
    """
    Return the placeholder of an option's value in the help text.

    It is the unit of a number, or N for a whole and F for another number without unit. It is NAME, or NAME=…, for
    names, and a pair for an interval; else the word that the demand itself states, or WHAT.
    """
    if isinstance(demand, Interval):
        return "LOW", "HIGH"
    if isinstance(demand, ByName):
        return f"NAME={_metavar(demand.of)}"
    if isinstance(demand, Each | Several):
        return _metavar(demand.of)
    if isinstance(demand, Range):
        return MARKS.get(demand.unit, demand.unit.upper()) or ("N" if demand.whole else "F")
    return "NAME" if isinstance(demand, OfType) else getattr(demand, "metavar", "WHAT")


def options_of(request: type, *names: str) -> tuple[Option, ...]:
    """
    Return the options of the named fields of a request (default: all).

    A nested object, or a subset of the fields of another dataclass, gives one per field.
    """
    found: list[Option] = []
    declared = {field.name: field for field in dataclasses.fields(request)}
    for name in names or declared:
        demand = demand_of(declared[name])
        if isinstance(demand, FieldSubset):
            found += map(option_of, demand.fields)
        elif isinstance(demand, Nested):
            options = map(option_of, dataclasses.fields(demand.kind))
            found += (dataclasses.replace(option, within=declared[name]) for option in options)
        else:
            found.append(option_of(declared[name]))
    return tuple(found)


def group(title: str, request: type, *names: str) -> Group:
    """Return the options for some fields of a request, under a common heading."""
    return Group(title, options_of(request, *names))


def request_of(request: type[R], options: Mapping[str, Any]) -> R:
    """
    Return the request that the options of a command describe.

    Parameters
    ----------
    request : type
        Class of the request.
    options : mapping
        Value by the name of its option, without dashes; None where it is not given.

    Raises
    ------
    MistrayError
        If a value is out of range, or an option is given without another one that it needs.
    """
    values: dict[str, Any] = {}
    for field, _ in flat_fields(request):
        demand = demand_of(field)
        if isinstance(demand, Nested):
            values[field.name] = _object_of(demand, options)
            continue
        value = options.get(option_of(field).dest)
        if value is not None:
            _refuse_alone(request, field, value, options)
            values[field.name] = dict(value) if isinstance(demand, ByName) else value
            if demand is FLAG:  # an option that is given changes the default
                values[field.name] = value != field.default
    try:
        return request(**from_flat(request, values))
    except MistrayError as error:
        # Here fields are options; names without an underscore or a "=" behind them may be words of the sentence
        known = [(field.name, option_of(field).name) for field, _ in flat_fields(request)]
        names = {name: option for name, option in known if "_" in name}
        names |= {f"{name}{sign}": f"{option}{end}" for name, option in known for sign, end in (("=…", ""), ("=", " "))}
        raise MistrayError(re.sub(r"\w+(=…?)?", lambda word: names.get(word[0], word[0]), str(error))) from None


def _refuse_alone(request: Any, field: dataclasses.Field[Any], value: Any, options: Mapping[str, Any]) -> None:
    """Raise `MistrayError` if an option is given without one that it needs, see `mistray.toolkit.fields.field`."""
    needs = field.metadata.get(NEEDS)
    if needs and value is not False:
        needed = option_of(request.__dataclass_fields__[needs])
        if options.get(needed.dest) is None:
            raise MistrayError(f"{option_of(field).name} is about {needed.name}; give that too, or leave it out")


def _object_of(nested: Nested, options: Mapping[str, Any]) -> Any:
    """
    Return the nested object whose fields are given as options.

    The result is None if none is given. Raise `MistrayError` if some are missing or not allowed.
    """
    fields = dataclasses.fields(nested.kind)
    given = {field.name: value for field in fields if (value := options.get(field.name)) is not None}
    missing = [flag(field.name) for field in fields if field.default is dataclasses.MISSING and field.name not in given]
    if nested.one_of and not any(name in given for name in nested.one_of):
        missing.append(" or ".join(map(flag, nested.one_of)))
    if given and missing:
        raise MistrayError(f"{flag(next(iter(given)))} says nothing alone; add {', '.join(missing)}")
    return nested.kind(**given) if given else None

"""Fields of requests: each declares condition, default and description, from which keywords and options are made.

A request is a frozen dataclass. A function takes its fields as keywords, a command takes them as options, and both
check and describe them from these declarations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from mistray.errors import MistrayError, nearest, refuse_unknown
from mistray.ranges import Demand, OfType, check_fields, demand_of, doc_of, type_of

T = TypeVar("T")
OPTION, METAVAR, NEEDS = "option", "metavar", "needs"


@dataclass(frozen=True)
class Nested(OfType):
    """
    Condition that a value is an object of a dataclass, whose fields the command line takes as options.

    Attributes
    ----------
    demand : str
        Condition in words, from the name of `kind`.
    kind : type
        Dataclass of the object.
    one_of : tuple of str
        Names of fields of which at least one must be given.
    """

    demand: str = dataclasses.field(init=False)
    one_of: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "demand", f"must be a {self.kind.__name__}")

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """
        Return the object, built from a mapping of its fields if necessary.

        Raise `MistrayError` if it is of another type, or if the mapping has an unknown field or a value that is not
        allowed.
        """
        return super().check(name, object_of(self.kind, value, f"{name}: ") if isinstance(value, Mapping) else value)


@dataclass(frozen=True)
class FieldSubset(Demand):
    """
    Condition that a value is a mapping with some fields of another dataclass, such as `Settings`.

    Any field may be missing. Each is a separate keyword and a separate option of the command.

    Attributes
    ----------
    kind : type
        Dataclass with these fields.
    names : tuple of str
        Names of the fields that are taken.
    """

    kind: type
    names: tuple[str, ...]

    @classmethod
    def but(cls, kind: type, *without: str) -> FieldSubset:
        """Return the condition for all fields of a dataclass except those named."""
        return cls(kind, tuple(field.name for field in dataclasses.fields(kind) if field.name not in without))

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that the mapping must meet, in words for messages."""
        return f"must be a mapping of fields of {self.kind.__name__}"

    @property
    def fields(self) -> tuple[dataclasses.Field[Any], ...]:
        """Fields of the dataclass that are taken."""
        return tuple(field for field in dataclasses.fields(self.kind) if field.name in self.names)

    def check(self, name: str, value: Any, owner: str = "") -> dict[str, Any]:
        """
        Return the given values by name, without None.

        Raise `MistrayError` for an unknown name, a value that is not allowed, or anything but a mapping.
        """
        OfType(Mapping, self.demand).check(name, value, owner)
        unknown = next((key for key in value if key not in self.names), None)
        if unknown is not None:
            raise MistrayError(f"{name}: there is no '{unknown}'; {nearest(str(unknown), self.names)}")
        given = {key: number for key, number in value.items() if number is not None}
        for field in self.fields:
            demand = demand_of(field)
            if field.name in given and demand is not None:
                given[field.name] = demand.check(field.name, given[field.name], owner)
        return given


def field(
    demand: Demand,
    default: Any,
    doc: str,
    *,
    option: str = "",
    metavar: str | tuple[str, ...] = "",
    needs: str = "",
) -> Any:
    """
    Return the declaration of a field of a request, for the body of its dataclass.

    Parameters
    ----------
    demand : Demand
        Condition on the value, unless it is None.
    default
        Default value; None: nothing is requested. That of a `FieldSubset` is always an empty mapping.
    doc : str
        One sentence with the unit, for `help()`, the help of the command and the docs.
    option : str
        Name of the option where it is not that of the field, such as "--part".
    metavar : str or tuple of str
        Placeholder of the values in the help, where it does not follow from the demand.
    needs : str
        Name of the field that must be given together with this one.
    """
    metadata = {**demand.field(doc=doc).metadata, OPTION: option, METAVAR: metavar, NEEDS: needs}
    if isinstance(demand, FieldSubset):
        return dataclasses.field(default_factory=dict, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def field_of(kind: Any, name: str, default: Any) -> Any:
    """Return the declaration of a request field like the field `name` of the dataclass `kind`, with another default."""
    return dataclasses.field(default=default, metadata=kind.__dataclass_fields__[name].metadata)


@dataclass(frozen=True)
class Request:
    """Base class of the requests of analyses: all arguments except the scene. The constructor checks the fields."""

    def __post_init__(self) -> None:
        for declared in dataclasses.fields(self):
            # Where the type does not say otherwise, None is not given
            if getattr(self, declared.name) is None and "None" not in type_of(declared.type):
                object.__setattr__(self, declared.name, _usual(declared))
        check_fields(self)

    @classmethod
    def of(cls, **given: Any) -> Self:
        """
        Create the request from keywords of its analysis function.

        Raise `MistrayError` for one that is unknown, missing or not allowed.
        """
        return object_of(cls, given)

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON schema (draft 2020-12) of the request's keywords, with units and descriptions."""
        from mistray.toolkit.json_schema import DRAFT, schema_of

        return {"$schema": DRAFT, **schema_of(cls)}

    def to_dict(self) -> dict[str, Any]:
        """Return the request as JSON-serialisable values by keyword, from which `of` restores it."""
        return _plain(self)


def object_of(kind: type[T], given: Mapping[str, Any], owner: str = "") -> T:
    """
    Return a request, or an object nested in one, made from its keywords.

    Parameters
    ----------
    kind : type
        Dataclass of the request or object.
    given : mapping
        Values by keyword.
    owner : str
        Text at the start of error messages.

    Raises
    ------
    MistrayError
        If a keyword is unknown or missing, or a value fails its demand.
    """
    known = {declared.name: declared for declared, _ in flat_fields(kind)}
    refuse_unknown(given, known, owner)
    for name, declared in known.items():
        if given.get(name) is None:
            _usual(declared, owner)
    return kind(**from_flat(kind, given))


def _usual(declared: dataclasses.Field[Any], owner: str = "") -> Any:
    """Return the default of a request field, empty for a `FieldSubset`; raise `MistrayError` if it must be given."""
    if isinstance(demand_of(declared), FieldSubset):
        return {}
    if declared.default is dataclasses.MISSING:
        raise MistrayError(f"{owner}{declared.name} is missing; give it: {doc_of(declared)}")
    return declared.default


def _plain(value: Any) -> Any:
    """Return a request, or a value in it, in JSON-serialisable values, without fields that are None as by default."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if not dataclasses.is_dataclass(value):
        return value.tolist() if hasattr(value, "tolist") else value  # a number of NumPy
    found: dict[str, Any] = {}
    for declared in dataclasses.fields(value):
        one = getattr(value, declared.name)
        if isinstance(demand_of(declared), FieldSubset):
            found |= _plain(one)
        elif one is not None or declared.default is not None:
            found[declared.name] = _plain(one)
    return found


def flat_fields(request: type) -> Iterable[tuple[dataclasses.Field[Any], FieldSubset | None]]:
    """
    Yield each field of a request that is a keyword of its own, with the `FieldSubset` that contains it.

    With a field that no `FieldSubset` contains comes None.
    """
    for declared in dataclasses.fields(request):
        part = demand_of(declared)
        if isinstance(part, FieldSubset):
            yield from ((inner, part) for inner in part.fields)
        else:
            yield declared, None


def from_flat(request: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by keyword as values by field of a request; those of a `FieldSubset` form a mapping."""
    found: dict[str, Any] = {}
    for declared in dataclasses.fields(request):
        part = demand_of(declared)
        if isinstance(part, FieldSubset):
            found[declared.name] = {name: values[name] for name in part.names if name in values}
        elif declared.name in values:
            found[declared.name] = values[declared.name]
    return found

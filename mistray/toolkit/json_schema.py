"""JSON schemas of requests: what an object of the keywords of an analysis must be, from the demands on its fields."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from mistray.files.json_values import plain
from mistray.ranges import ByName, Each, Interval, OfType, Range, Several, Words, demand_of, doc_of, type_of
from mistray.toolkit.fields import Nested, flat_fields

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_TYPES: Mapping[type, Mapping[str, Any]] = {bool: {"type": "boolean"}, str: {"type": "string", "minLength": 1}}


def schema_of(kind: type) -> dict[str, Any]:
    """
    Return the JSON schema of an object with the keywords of a request, or with the fields of an object within one.

    Parameters
    ----------
    kind : type
        Dataclass of the request or of the object within it, with demands on its fields.
    """
    fields = list(flat_fields(kind))
    return {
        "title": kind.__name__,
        "type": "object",
        "properties": {field.name: property_of(field, part is not None, part is None) for field, part in fields},
        "required": [field.name for field, _ in fields if field.default is dataclasses.MISSING],
        "additionalProperties": False,
    }


def property_of(field: dataclasses.Field[Any], may_be_null: bool, has_default: bool = True) -> dict[str, Any]:
    """
    Return the JSON schema of a field: its description, allowed values and default.

    With `may_be_null`, or if the field may be None, null is allowed. Without `has_default` no default is stated.
    """
    usual, kinds = field.default, _kinds(demand_of(field))
    if usual == "":
        kinds.append({"const": ""})
    if may_be_null or usual is None or "None" in type_of(field.type):
        kinds.append({"type": "null"})
    found = {"description": doc_of(field), **_one_of(kinds)}
    known = has_default and usual is not None and usual is not dataclasses.MISSING
    return {**found, "default": plain([*usual] if isinstance(usual, range) else usual)} if known else found


def _kinds(demand: Any) -> list[dict[str, Any]]:
    """Return alternative JSON schemas of values that meet a demand.

    A condition that no schema can state is a comment.
    """
    own = [dict(one) for one in demand.also]
    match demand:
        case Range():
            return [_number(demand), *own]
        case Words():
            return [{"enum": [*demand.choices]}]
        case Interval():
            return [_list(demand.of, 2, 2)]
        case Each(count=0):
            return [*_kinds(demand.of), _list(demand.of, demand.least)]
        case Each():
            return [_list(demand.of, demand.count, demand.count)]
        case Several():
            single = [kind for kind in _kinds(demand.of) if kind.get("type") != "array"]  # a list has several
            return [*single, _list(demand.of, demand.least)]
        case ByName():
            names = {"propertyNames": {"pattern": r"\S"}}
            return [{"type": "object", **names, "additionalProperties": _one_of(_kinds(demand.of))}]
        case Nested():
            one_of = {"anyOf": [{"required": [name]} for name in demand.one_of]} if demand.one_of else {}
            return [{**schema_of(demand.kind), **one_of}]
        case OfType() if demand.kind in _TYPES:
            return [{**_TYPES[demand.kind]}]
    return own or [{"$comment": demand.demand}]


def _one_of(kinds: list[dict[str, Any]]) -> dict[str, Any]:
    return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}


def _number(within: Range) -> dict[str, Any]:
    low, high = ("exclusiveMinimum" if within.above else "minimum"), "exclusiveMaximum" if within.below else "maximum"
    ends = {name: end for name, end in ((low, within.low), (high, within.high)) if math.isfinite(end)}
    return {"type": "integer" if within.whole else "number", **ends, **({"unit": within.unit} if within.unit else {})}


def _list(of: Any, least: int, most: int | None = None) -> dict[str, Any]:
    ends = {"minItems": least, **({"maxItems": most} if most else {})}
    return {"type": "array", "items": _one_of(_kinds(of)), **ends}

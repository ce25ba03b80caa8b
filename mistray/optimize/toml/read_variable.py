"""Reads the sections ``[[variable]]`` of a study."""

from __future__ import annotations

import re
from typing import Any

from mistray.optimize.study.model import SCALES, Moved, VariableGroup
from mistray.optimize.toml.section import Section

VARIABLE_KEYS = ("name", "parameters", "low", "high", "scale", "each")
ENTRY = re.compile(r"(?P<key>.*)\[(?P<entry>\d+)\]")


def read_variable(section: Section) -> VariableGroup:
    """One variable of a study, or a family of them."""
    section.known(VARIABLE_KEYS)
    scale = section.choice("scale", "linear", SCALES)
    low, high = (section.number(key, None, -1e30, 1e30) for key in ("low", "high"))
    if not low < high:
        raise section.fail("low", f"is {low:g} and high is {high:g}; low must be less than high")
    if scale == "log" and low <= 0:
        raise section.fail("low", f'is {low:g}; with scale = "log" it must be greater than 0')
    given = section.content.get("parameters")
    items = given if isinstance(given, list) else [given]
    if not items or given is None:
        raise section.fail(
            "parameters", f'is {"missing" if given is None else "empty"}; give keys or patterns, ["vane_*.r0"] say'
        )
    moved = tuple(_moved(section, item) for item in items)
    if scale == "log" and any(item.factor != 1 for item in moved):
        raise section.fail("parameters", 'has a factor; with scale = "log" parameters move by ratios, without factors')
    name = section.text("name") if "name" in section.content else None
    return VariableGroup(name, moved, low, high, scale, section.flag("each", False))


def _moved(section: Section, item: Any) -> Moved:
    """One entry of `parameters`: text, or a table with a factor."""
    form = 'give text, or {key = "…", factor = -1}'
    factor = 1.0
    if isinstance(item, dict):
        inner = Section(section.title, f"{section.place}parameters.", item, section.folder)
        inner.known(("key", "factor"))
        key = inner.text("key")
        found = inner.finite("factor")
        factor = 1.0 if found is None else found
        if factor == 0:
            raise inner.fail("factor", "is 0; the parameter would not move, leave it out")
    elif isinstance(item, str) and item:
        key = item
    else:
        raise section.fail("parameters", f"has the entry {item!r}; {form}")
    match = ENTRY.fullmatch(key)
    return Moved(match["key"], int(match["entry"]), factor) if match else Moved(key, None, factor)

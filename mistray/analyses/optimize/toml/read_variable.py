"""Reader of the sections ``[[variable]]`` of a design study."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from mistray.analyses.optimize.study.model import Moved, VariableGroup
from mistray.toolkit.toml_section import TomlSection, keys_of

ENTRY = re.compile(r"(?P<key>.*)\[(?P<entry>0|[1-9]\d*)\]")  # [01] is a pattern


def read_variable(section: TomlSection) -> VariableGroup:
    """
    Return the section ``[[variable]]``: parameters that move together or each by itself, and bounds of their value.

    Raises
    ------
    MistrayError
        If the parameters are missing, a key is unknown, or a value is impossible.
    """
    section.known(keys_of(VariableGroup))
    given = section.content.get("parameters")
    items = given if isinstance(given, list) else [given]
    if not items or given is None:
        raise section.fail(
            "parameters", f'is {"missing" if given is None else "empty"}; give keys or patterns, ["vane_*.r0"] say'
        )
    moved = tuple(_moved(section, item) for item in items)
    return section.make(VariableGroup, {"parameters": moved}, name=None)


def _moved(section: TomlSection, item: Any) -> Moved:
    """Return the parameter in an entry of `parameters`: a key as text, or a table with key, factor and pivot."""
    if not isinstance(item, dict | str) or not item:
        raise section.fail("parameters", f'has the entry {item!r}; give text, or {{key = "…", factor = -1}}')
    inner = section.inner("parameters", item if isinstance(item, dict) else {"key": item})
    moved = inner.make(Moved)
    match = ENTRY.fullmatch(moved.key)
    return replace(moved, key=match["key"], entry=int(match["entry"])) if match else moved

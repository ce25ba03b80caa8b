"""The page for users of Mitsuba: the keys of its table are those of a scene."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.metrics.parameters import parameters

PAGE = (Path(__file__).parents[1] / "docs" / "mitsuba.md").read_text(encoding="utf-8")


def test_each_key_of_the_table_is_a_parameter_in_its_unit() -> None:
    here: dict[str, Any] = {}
    code = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(code[0].partition("scene = ")[0], here)
    exec(code[-1].partition("for key")[0], here)
    known, params = parameters(here["scene"]), mi.traverse(here["scene"])
    rows = re.findall(r"^\| `([\w.]+)` \| (\S+) \|", PAGE, re.MULTILINE)
    assert len(rows) == 20
    for key, unit in rows:
        assert key in params, key
        assert known[key].unit == unit, key

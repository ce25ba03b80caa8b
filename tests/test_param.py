"""A parameter of a plugin: what a scene may give, and what tables say of it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mistray.errors import MistrayError
from mistray.param import Param, fixed, grouped, params_of, title_of
from mistray.ranges import FINITE, FLAG, POSITIVE, SHARE, TEXT, Range, Words
from mistray.scatter.abg import ABg
from mistray.settings import Settings

pytestmark = pytest.mark.quick

WHOLE, WAY = Range(1, 9, whole=True), Words(("up", "down"))


@pytest.mark.parametrize(
    ("param", "given", "value"),
    [
        (Param(values=SHARE), 1, 1.0),
        (Param(values=WHOLE), 3.0, 3),
        (fixed("bool", FLAG, ""), 1, True),
        (fixed("string", WAY, ""), "up", "up"),
        (fixed("string", TEXT, ""), 1.5, "1.5"),
    ],
)
def test_values_have_their_type(param: Param, given: Any, value: Any) -> None:
    taken = param.of({"x": given}, "x", "shape 'S'")
    assert (taken, type(taken)) == (value, type(value))


@pytest.mark.parametrize(
    ("param", "given", "said"),
    [
        (Param(values=SHARE), {}, "x is missing; add what is required"),
        (Param(values=SHARE), {"x": "a"}, "x is 'a'; it must be a number"),
        (Param(values=WHOLE), {"x": True}, "x is True; it must be a whole number"),
        (Param(values=WHOLE), {"x": 10}, "x is 10; it must be a whole number between 1 and 9"),
        (Param(values=FINITE), {"x": math.nan}, "x is nan; it must be a number"),
        (fixed("bool", FLAG, ""), {"x": "false"}, "x is 'false'; it must be true or false"),
        (fixed("string", WAY, ""), {"x": "dwn"}, "x is 'dwn'; did you mean 'down'?"),
    ],
)
def test_refusals_name_owner_and_value(param: Param, given: Any, said: str) -> None:
    with pytest.raises(MistrayError) as caught:
        param.of(given, "x", "shape 'S'")
    assert str(caught.value) == f"shape 'S': {said}"


@pytest.mark.parametrize(
    ("param", "allowed", "usual"),
    [
        (Param(), "±", "required"),
        (Param(values=POSITIVE, default=1e6), "> 0", "1e6"),
        (Param(values=SHARE, default=None), "0 … 1", "none"),
        (Param(values=SHARE, default=None, otherwise="Fresnel"), "0 … 1", "Fresnel"),
        (fixed("string", WAY, "", "up"), "up, down", "up"),
        (fixed("bool", FLAG, "", False), "", "false"),
        (fixed("list", TEXT, "", (1.0, 2.0), within="two"), "two", "1, 2"),
    ],
)
def test_cells_of_a_table(param: Param, allowed: str, usual: str) -> None:
    assert (param.allowed, param.usual) == (allowed, usual)


def test_parameters_of_dataclasses() -> None:
    known = params_of(ABg, last=("event", "side", "relative_to"))
    assert list(known) == ["A", "B", "g", "reference_nm", "file", "event", "side", "relative_to"]
    assert (known["A"].usual, known["event"].usual, known["A"].moves) == ("required", "both", True)
    settings = params_of(Settings)
    assert (settings["rays"].unit, settings["aim"].unit) == ("1", "string")
    assert (settings["max_generations"].usual, settings["cut_below"].usual) == ("no limit", "none")


def test_those_stated_as_one_share_a_row() -> None:
    coefficient = Param(doc="coefficient")
    rows = grouped({"r": Param(), **dict.fromkeys(("a", "b"), coefficient), **dict.fromkeys("defg", Param("mm"))})
    assert [title_of(names) for names, _ in rows] == ["r", "a, b", "d … g"]


def test_usual_tolerance_is_absolute_where_stated() -> None:
    assert Param(tolerance=0.1).usual_tolerance(5.0) == 0.5
    assert Param(absolute=0.01).usual_tolerance(5.0) == 0.01

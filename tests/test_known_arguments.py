"""Keyword arguments that there are not: one line that names the nearest one; and field angles, one or several."""

from __future__ import annotations

import inspect
import warnings
from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.errors import MistrayError, MistrayWarning
from mistray.known_arguments import known_arguments
from mistray.ranges import FIELD_DEG


@known_arguments
def boxed(number: int, size: Any = 1, *, way: str = "up") -> tuple[Any, ...]:
    return number, size, way


def test_a_wrong_name() -> None:
    assert boxed(1, 2, way="down") == (1, 2, "down")
    assert list(inspect.signature(boxed).parameters) == ["number", "size", "way"]
    with pytest.raises(MistrayError, match=r"^boxed: there is no argument 'sise'; did you mean 'size'\?$"):
        boxed(1, sise=2)
    scene = mistray.load("plate")
    for function in (mistray.trace, mistray.ghosts, mistray.sweep):
        with pytest.raises(MistrayError, match=r"field_degr.*; did you mean 'field_deg'"):
            function(scene, field_degr=[0.0])


def test_warnings_are_about_the_line_of_the_caller() -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mistray.trace(mistray.load("plate"), rays=200, max_reflections=0)
    assert {Path(one.filename) for one in told if issubclass(one.category, MistrayWarning)} <= {Path(__file__)}


def test_a_number_or_several() -> None:
    assert FIELD_DEG.check_each("field_deg", 3) == [3.0]
    assert FIELD_DEG.check_each("field_deg", range(3)) == [0.0, 1.0, 2.0]
    for wrong in ("3", [], [90.0], [[1.0, 2.0]], [None], float("nan")):
        with pytest.raises(MistrayError, match=r"^scene: field_deg is "):
            FIELD_DEG.check_each("field_deg", wrong, "scene")
    scene = mistray.load("plate_and_wall")
    for call in (mistray.ghosts, mistray.sweep, mistray.pst, mistray.sweeps.rank_edits):
        with pytest.raises(MistrayError, match="field_deg is"):
            call(scene, [])

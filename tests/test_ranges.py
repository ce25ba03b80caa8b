"""Ranges of numbers and shares as texts: what they hold and say, and that Python, shell and scenes use the same."""

from __future__ import annotations

import argparse
import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from command_line import fails
from oracles.small_scenes import plates_text

import mistray
from mistray import ranges
from mistray.errors import MistrayError
from mistray.percent import percent_text
from mistray.ranges import FIELD_DEG, RAYS, THRESHOLD, Range, check_fields
from mistray.settings import Settings

pytestmark = pytest.mark.quick

RANGES = {name: value for name, value in vars(ranges).items() if isinstance(value, Range)}
NOT_NUMBERS = (None, True, "5", "", [1, 2], object(), 1j)


@pytest.mark.parametrize("name", RANGES)
def test_ends(name: str) -> None:
    """Each end belongs to the range unless it is said not to; the next number outside does not; NaN is in none."""
    one = RANGES[name]
    step = 1 if one.whole else 0
    for end, excluded, outside in ((one.low, one.above, -math.inf), (one.high, one.below, math.inf)):
        beyond = end + math.copysign(step, outside) if step else math.nextafter(end, outside)
        inside = end - math.copysign(step, outside) if step else math.nextafter(end, -outside)
        assert (end in one) is not excluded
        assert inside in one
        for value in (beyond, outside, math.nan):
            assert value not in one
            with pytest.raises(MistrayError, match=r"number is .*; it must "):
                one.check("number", value)
    assert one.low < one.high


def test_what_is_no_number_is_refused() -> None:
    assert ranges.THREADS.high == (os.cpu_count() or 1)
    for value in NOT_NUMBERS:
        with pytest.raises(MistrayError, match=r"^shape 'a': size is "):
            ranges.SIZE_MM.check("size", value, "shape 'a'")
    for text in ("nan", "inf", "1e308", "90", "-90", "abc", "", "1,5"):
        with pytest.raises(argparse.ArgumentTypeError) as caught:
            FIELD_DEG(text)
        assert text in str(caught.value)


def test_whole_numbers_become_int() -> None:
    for value in (7, 7.0, np.float32(7), np.int64(7), np.array(7.0)):
        found = RAYS.check("rays", value)
        assert (type(found), found) == (int, 7)
    with pytest.raises(MistrayError, match="whole number between 1 and 4294967295"):
        RAYS.check("rays", 7.5)
    for text, number in (("1e6", 1_000_000), ("4294967295", 2**32 - 1)):
        assert (type(RAYS(text)), RAYS(text)) == (int, number)
    assert (FIELD_DEG("-89.9"), THRESHOLD("0")) == (-89.9, 0.0)


def test_fields_of_a_dataclass() -> None:
    @dataclass(frozen=True)
    class Lens:
        radius: float = ranges.SIZE_MM.field()
        count: int = RAYS.field(3)
        width: float | None = ranges.SIZE_MM.field(None)

        def __post_init__(self) -> None:
            check_fields(self, "lens")

    assert Lens(1.0, 4.0) == Lens(1.0, 4)  # type: ignore[arg-type]
    assert isinstance(Lens(1.0, 4.0).count, int)  # type: ignore[arg-type]
    for wrong in ({"radius": 0.0}, {"radius": 1.0, "count": 0}, {"radius": 1.0, "width": math.nan}):
        with pytest.raises(MistrayError, match=f"^lens: {list(wrong)[-1]} is "):
            Lens(**wrong)  # type: ignore[arg-type]


def test_one_range_for_python_shell_and_scene(tmp_path: Any, capsys: Any) -> None:
    """The same end refuses the same number in all three, and says the same."""
    path = tmp_path / "scene.xml"
    for name, text in (("scatter_rays", "256"), ("max_reflections", "32768"), ("flux_threshold", "1")):
        number = float(text)
        with pytest.raises(MistrayError) as caught:
            Settings(**{name: number})
        demand = str(caught.value).partition("; it ")[2]
        assert demand
        option = f"--{name.replace('_', '-')}"
        assert f"argument {option}: {text} {demand}" in fails(capsys, "ghosts", "plate", option, text)
        integrator = f'<integrator type="straylight"><float name="{name}" value="{text}"/></integrator>'
        path.write_text(plates_text(1).replace('<integrator type="straylight"/>', integrator))
        with pytest.raises(MistrayError) as caught:
            mistray.load(path)
        assert demand in str(caught.value)


def test_no_exponent_where_a_share_is_large() -> None:
    for share, digits, text in (
        (0.0, 2, "0 %"), (0.00312, 2, "0.31 %"), (0.12345, 3, "12.3 %"), (0.9949, 2, "99 %"), (0.997, 2, "100 %"),
        (1.0, 3, "100 %"), (12.34, 2, "1234 %"), (-1.5, 2, "-150 %"), (1e-12, 2, "1e-10 %"),
        (float("inf"), 2, "– %"), (float("nan"), 2, "– %"),
    ):  # fmt: skip
        assert percent_text(share, digits) == text

"""Parameters of plugins, ranges of numbers, shares as texts: what they hold and say, in Python, shell and scenes."""

import argparse
import inspect
import math
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from command_line import fails
from oracles.small_scenes import plates_text
from refusals import refused

import mistray
from mistray import MistrayError, MistrayWarning, ranges
from mistray.known_arguments import known_arguments
from mistray.param import Param, fixed, grouped, params_of, title_of
from mistray.percent import percent_text
from mistray.ranges import FIELD_DEG, FINITE, FLAG, POSITIVE, RAYS, SHARE, TEXT, THRESHOLD, Range, Words, check_fields
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


def test_parameters_of_dataclasses_their_rows_and_tolerances() -> None:
    known = params_of(ABg, last=("event", "side", "relative_to"))
    assert list(known) == ["A", "B", "g", "reference_nm", "file", "event", "side", "relative_to"]
    assert (known["A"].usual, known["event"].usual, known["A"].moves) == ("required", "both", True)
    settings = params_of(Settings)
    assert (settings["rays"].unit, settings["aim"].unit) == ("1", "string")
    assert (settings["max_generations"].usual, settings["cut_below"].usual) == ("no limit", "none")
    coefficient = Param(doc="coefficient")
    rows = grouped({"r": Param(), **dict.fromkeys(("a", "b"), coefficient), **dict.fromkeys("defg", Param("mm"))})
    assert [title_of(names) for names, _ in rows] == ["r", "a, b", "d … g"]
    assert Param(tolerance=0.1).usual_tolerance(5.0) == 0.5
    assert Param(absolute=0.01).usual_tolerance(5.0) == 0.01


RANGES = {name: value for name, value in vars(ranges).items() if isinstance(value, Range)}


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
            with refused(r"number is .*; it must "):
                one.check("number", value)
    assert one.low < one.high


def test_what_is_no_number_and_whole_numbers() -> None:
    assert ranges.THREADS.high == (os.cpu_count() or 1)
    for value in (None, True, "5", "", [1, 2], object(), 1j):
        with refused(r"^shape 'a': size is "):
            ranges.SIZE_MM.check("size", value, "shape 'a'")
    for text in ("nan", "inf", "1e308", "90", "-90", "abc", "", "1,5"):
        with pytest.raises(argparse.ArgumentTypeError) as caught:
            FIELD_DEG(text)
        assert text in str(caught.value)
    for value in (7, 7.0, np.float32(7), np.int64(7), np.array(7.0)):
        found = RAYS.check("rays", value)
        assert (type(found), found) == (int, 7)
    with refused("whole number between 1 and 4294967295"):
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
        with refused(f"^lens: {list(wrong)[-1]} is "):
            Lens(**wrong)  # type: ignore[arg-type]


def test_one_range_for_python_shell_and_scene(tmp_path: Any, capsys: Any) -> None:
    """The same end refuses the same number in all three, and says the same."""
    path = tmp_path / "scene.xml"
    for name, text in (("scatter_rays", "256"), ("max_reflections", "32768"), ("flux_threshold", "1")):
        number = float(text)
        with refused() as caught:
            Settings(**{name: number})
        demand = str(caught.value).partition("; it ")[2]
        assert demand
        option = f"--{name.replace('_', '-')}"
        assert f"argument {option}: {text} {demand}" in fails(capsys, "ghosts", "plate", option, text)
        integrator = f'<integrator type="straylight"><float name="{name}" value="{text}"/></integrator>'
        path.write_text(plates_text(1).replace('<integrator type="straylight"/>', integrator))
        with refused("", demand):
            mistray.load(path)


def test_no_exponent_where_a_share_is_large() -> None:
    for share, digits, text in (
        (0.0, 2, "0 %"), (0.00312, 2, "0.31 %"), (0.12345, 3, "12.3 %"), (0.9949, 2, "99 %"), (0.997, 2, "100 %"),
        (1.0, 3, "100 %"), (12.34, 2, "1234 %"), (-1.5, 2, "-150 %"), (1e-12, 2, "1e-10 %"),
        (float("inf"), 2, "– %"), (float("nan"), 2, "– %"),
    ):  # fmt: skip
        assert percent_text(share, digits) == text


@known_arguments
def boxed(number: int, size: Any = 1, *, way: str = "up") -> tuple[Any, ...]:
    return number, size, way


def test_wrong_names_warnings_and_a_number_or_several() -> None:
    assert boxed(1, 2, way="down") == (1, 2, "down")
    assert list(inspect.signature(boxed).parameters) == ["number", "size", "way"]
    with refused(r"^boxed: there is no argument 'sise'; did you mean 'size'\?$"):
        boxed(1, sise=2)
    scene = mistray.load("plate")
    for function in (mistray.trace, mistray.ghosts, mistray.sweep):
        with refused(r"field_degr.*; did you mean 'field_deg'"):
            function(scene, field_degr=[0.0])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mistray.trace(mistray.load("plate"), rays=200, max_reflections=0)
    assert {Path(one.filename) for one in told if issubclass(one.category, MistrayWarning)} <= {Path(__file__)}
    assert FIELD_DEG.check_each("field_deg", 3) == [3.0]
    assert FIELD_DEG.check_each("field_deg", range(3)) == [0.0, 1.0, 2.0]
    for wrong in ("3", [], [90.0], [[1.0, 2.0]], [None], float("nan")):
        with refused(r"^scene: field_deg is "):
            FIELD_DEG.check_each("field_deg", wrong, "scene")


SCALED, MIRRORED = mi.ScalarTransform4f().scale(1.000012), mi.ScalarTransform4f().scale([-1, 1, 1])
SHEARED = mi.ScalarTransform4f([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
MOVED = (
    {"type": "collimated", "radius": 1.0},
    {"type": "asphere", "semi_diameter": 2.0},
    {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0},
)
WRONG = [
    *vectors.toml("plugin_refusals.toml")["alone"],
    *((one | {"to_world": pose}, "to_world scales, shears or mirrors; use a rigid motion")
      for one in MOVED for pose in (SCALED, MIRRORED, SHEARED)),
]  # fmt: skip


@pytest.mark.parametrize(("values", "words"), WRONG)
def test_wrong_values(values: dict[str, Any], words: str) -> None:
    with pytest.raises((mistray.MistrayError, RuntimeError, TypeError)) as caught:
        mi.load_dict({**values, "id": "S"})
    assert words in str(caught.value)
    assert not isinstance(caught.value, mistray.MistrayError) or "\n" not in str(caught.value)

"""Old names of arguments, attributes, options and keys: they work and warn; both names at once are refused."""

from __future__ import annotations

import inspect
import json
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from command_line import fails

import mistray
from mistray.analysis.metrics.extended_source import Disc, sun
from mistray.cli.program import main
from mistray.errors import MistrayError, MistrayWarning
from mistray.optimize.metrics.metric import path_power
from mistray.optimize.metrics.pst_metrics import pst_bin, pst_mask
from mistray.optimize.toml.read_study import read_study
from mistray.ranges import FIELD_DEG
from mistray.recorders.directions import DirectionGrid
from mistray.renamed import by_new_names, old_names, renamed
from mistray.sweeps import rank_edits, sweep_pst


@renamed(sizes="size", ways="way")
def boxed(number: int, size: Any = 1, *, way: str = "up", **more: Any) -> tuple[Any, ...]:
    """What it was called with."""
    return number, size, way, more


@renamed(sizes="size")
@dataclass(frozen=True)
class Box:
    """Has an attribute with a new name."""

    number: int
    size: int = 1


def test_the_mechanism() -> None:
    with pytest.warns(MistrayWarning, match=r"^boxed: sizes is an old name; write size$") as told:
        assert boxed(1, sizes=2, other=3) == (1, 2, "up", {"other": 3})
    assert [Path(one.filename) for one in told] == [Path(__file__)], "the warning is about the caller's line"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert boxed(1, 2, way="down") == (1, 2, "down", {})
    assert (old_names(boxed), old_names(len)) == ({"sizes": "size", "ways": "way"}, {})
    for arguments, more in (((1, 2), {}), ((1,), {"size": 2})):
        with pytest.raises(MistrayError, match="boxed: sizes is the old name of size, and both are given"):
            boxed(*arguments, **more, sizes=3)
    with pytest.warns(MistrayWarning, match="Box: sizes"):
        box = Box(1, sizes=2)  # type: ignore[call-arg]
    assert (box, replace(box, size=3).size) == (Box(1, 2), 3)
    with pytest.warns(MistrayWarning, match="sizes is an old name; write size"):
        assert box.sizes == 2  # type: ignore[attr-defined]
    with pytest.warns(MistrayWarning, match="study: a is an old name; write b"):
        assert by_new_names({"a": 1, "c": 2}, {"a": "b"}, "study: ") == {"b": 1, "c": 2}


def test_a_number_or_several() -> None:
    assert FIELD_DEG.check_each("field_deg", 3) == [3.0]
    assert FIELD_DEG.check_each("field_deg", range(3)) == [0.0, 1.0, 2.0]
    for wrong in ("3", [], [90.0], [[1.0, 2.0]], [None], float("nan")):
        with pytest.raises(MistrayError, match=r"^scene: field_deg is "):
            FIELD_DEG.check_each("field_deg", wrong, "scene")


@pytest.fixture(scope="module")
def wall() -> Any:
    """A scene that is traced in no time."""
    return mistray.load("plate_and_wall")


FEW: dict[str, Any] = {"rays": 200}


OLD_NAMES: list[tuple[Any, tuple[str, ...]]] = [
    (mistray.ghosts, ("fields_deg",)), (mistray.pst, ("angles_deg",)), (mistray.objects, ("angles_deg",)),
    (mistray.sweep, ("fields_deg",)), (sweep_pst, ("angles_deg",)), (path_power, ("fields_deg",)),
    (pst_bin, ("angle_deg", "angles_deg")), (pst_mask, ("angles_deg",)), (sun, ("angle_deg",)), (Disc, ("angle_deg",)),
    (DirectionGrid.of, ("angles_deg",)),
]  # fmt: skip


@pytest.mark.parametrize(("function", "old"), OLD_NAMES, ids=lambda value: getattr(value, "__qualname__", ""))
def test_functions_know_their_old_names(function: Any, old: tuple[str, ...]) -> None:
    """Each is there, and is no name of today; the mechanism is tested above."""
    new = old_names(function) or old_names(function.__init__)
    today = set(inspect.signature(function).parameters)
    assert set(old) <= set(new)
    assert "traced" in today or {new[name] for name in old} <= today
    assert not set(old) & today


@pytest.mark.long
def test_python(wall: Any) -> None:
    """One warning for each old name, about the caller's line, and the same result."""
    with pytest.warns(MistrayWarning, match="is an old name; write") as told:
        old = mistray.pst(wall, angles_deg=[0, 20], **FEW)
    assert {Path(one.filename).name for one in told if "old name" in str(one.message)} == {Path(__file__).name}
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".* is an old name")
        new = mistray.pst(wall, field_deg=[0, 20], **FEW)
    with pytest.warns(MistrayWarning, match=r"Pst\.angles_deg is an old name; write field_deg"):
        assert list(old.angles_deg) == list(new.field_deg) == [0, 20]
    with pytest.warns(MistrayWarning, match="paths: angle_deg is an old name"):
        assert len(new.paths(angle_deg=0)) == len(new.paths(0))
    with pytest.warns(MistrayWarning, match="study: (angles|fields)_deg") as told:
        found = mistray.study(wall, angles_deg=20, fields_deg=0, rays=200)
    assert len([one for one in told if "old name" in str(one.message)]) == 2
    assert (list(found.pst.field_deg), list(found.ghosts)) == ([20.0], [0.0])


def test_nothing_is_empty_or_raw(wall: Any) -> None:
    for call in (mistray.ghosts, mistray.sweep, mistray.pst, rank_edits):
        with pytest.raises(MistrayError, match="field_deg is"):
            call(wall, [])


TERM: dict[str, Any] = {"kind": "path_power", "goal": "minimise"}


def test_keys_of_a_study() -> None:
    content: dict[str, Any] = {
        "trace": {"fields_deg": [0, 10]},
        "term": [TERM, {"kind": "pst_bin", "goal": "minimise", "angle_deg": 20, "angles_deg": [20, 40]}],
        "variable": [{"parameters": ["wall.z"], "low": 0, "high": 1}],
    }
    with pytest.warns(MistrayWarning) as told:
        read = read_study(content)
    assert sorted(str(one.message).split(" is an old name; write ")[1] for one in told) == [
        "field_deg", "field_deg", "pst_field_deg",
    ]  # fmt: skip
    assert "term[2].angle_deg" in "".join(str(one.message) for one in told)
    assert read.terms[0].traced["field_deg"] == (0.0, 10.0)
    assert (read.terms[1].own, read.terms[1].traced) == ({"field_deg": 20}, {"pst_field_deg": (20, 40)})
    content["trace"]["field_deg"] = [0]
    with pytest.raises(MistrayError, match=r"trace\.fields_deg is the old name of field_deg, and both are given"):
        read_study(content)


def test_both_names_in_the_shell(capsys: pytest.CaptureFixture[str]) -> None:
    for command, old, new in (
        ("pst", "--angles-deg", "--field-deg"), ("objects", "--angles-deg", "--field-deg"),
        ("study", "--angles-deg", "--pst-field-deg"), ("pst", "--map-angles-deg", "--map-field-deg"),
        ("sweep", "--pst-deg", "--pst-field-deg"), ("sensitivity", "--angle-deg", "--field-deg"),
    ):  # fmt: skip
        for first, second in ((old, new), (new, old)):
            said = fails(capsys, command, "plate_and_wall", first, 10, second, 20)
            assert f"{old} is the old name of {new}, and both are given" in said


def test_an_old_name_works(capsys: pytest.CaptureFixture[str]) -> None:
    few = ("pst", "plate_and_wall", "--rays", "500", "--json")
    assert main([*few, "--field-deg", "10", "20:40:10"]) == 0
    new = capsys.readouterr()
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main([*few, "--angles-deg", "10", "20:40:10"]) == 0
    old = capsys.readouterr()
    angles = [[row["angle_deg"] for row in json.loads(told.out)["curve"]] for told in (old, new)]
    assert angles == [[10, 20, 30, 40]] * 2
    assert old.err.count("--angles-deg is an old name; write --field-deg") == 1
    assert "old name" not in new.err

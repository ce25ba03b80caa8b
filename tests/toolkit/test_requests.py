"""What a request alone gives, and rows of a result, of toys; `test_command_request` is about the analyses."""

from __future__ import annotations

import argparse
import inspect
import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, fields, make_dataclass, replace
from typing import Any

import pytest
import vectors
from refusals import refused

from mistray import MistrayError, ranges
from mistray.estimate import Estimate
from mistray.ranges import Several
from mistray.settings import Settings
from mistray.toolkit.analysis import analysis
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.fields import FieldSubset, Nested, Request, field
from mistray.toolkit.rows import column, derived, frame, records, table
from mistray.toolkit.tables.text import table_text

pytestmark = pytest.mark.quick


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Two numbers that belong together."""

    centre: float = ranges.SHARE.field(doc="middle")
    width: float = ranges.SHARE.field(0.5, "width")


@dataclass(frozen=True)
class Toy(Request):
    """One field of each kind."""

    share: float = field(ranges.SHARE, 0.25, "a share")
    _: KW_ONLY
    waves: tuple[float, ...] | None = field(ranges.Each(ranges.WAVELENGTH_UM), None, "wavelengths, µm")
    band: tuple[float, float] = field(ranges.Interval(ranges.WAVELENGTH_UM), (1.0, 2.0), "band, µm", option="--in-band")
    parts: Mapping[str, float] | None = field(ranges.ByName(ranges.SHARE, "wall=0.5"), None, "shares by part")
    how: str = field(ranges.Words(("fast", "slow")), "fast", "how it is done")
    loud: bool = field(ranges.FLAG, False, "whether it is said aloud")
    angles: tuple[float, ...] | None = field(ranges.Each(ranges.FIELD_DEG), None, "angles, degrees")
    place: tuple[float, float] | None = field(ranges.Each(ranges.SHARE, count=2), None, "x and y", metavar=("X", "Y"))
    turn: float | None = field(ranges.SHARE, None, "a turn of the angles", needs="angles")
    careful: bool = field(ranges.FLAG, True, "check it")
    turns_deg: tuple[float, ...] = field(ranges.Each(ranges.FIELD_DEG), range(0, 20, 10), "turns, degrees")
    names: tuple[str, ...] = field(Several(ranges.TEXT, least=0), (), "names of it", metavar="NAME")
    kinds: tuple[str, ...] | None = field(Several(ranges.Words(("red", "blue"))), None, "only these")
    window: Filter | None = field(Nested(Filter), None, "a window")
    settings: Mapping[str, Any] = field(FieldSubset(Settings, ("seed", "max_scatters")), None, "settings")


def run_toy(scene: Any, request: Toy, *, progress: Any = None) -> Toy:
    """
    Return the request.

    Parameters
    ----------
    scene : mi.Scene
    request : Toy
    progress : callable, optional
        Called never.

    Returns
    -------
    Toy
    """
    return request


toy = analysis("toy", Toy, run_toy)


def parsed(*words: str) -> Toy:
    parser = argparse.ArgumentParser()
    for option in options_of(Toy, *(one.name for one in fields(Toy))):
        option.declare(parser)
    return request_of(Toy, vars(parser.parse_args(words)))


def test_signature_and_help() -> None:
    parameters = inspect.signature(toy).parameters
    assert list(parameters) == [
        "scene", "share", "waves", "band", "parts", "how", "loud", "angles", "place", "turn", "careful", "turns_deg",
        "names", "kinds", "window",
        "progress", "seed", "max_scatters",
    ]  # fmt: skip
    assert parameters["share"].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    assert parameters["waves"].annotation == "float | Iterable[float] | None"
    assert parameters["names"].annotation == "str | Sequence[str]"
    text = toy.__doc__ or ""
    lines = ('how : {"fast", "slow"}, optional', "    A share. 0 … 1.", "    Called never.", "Returns\n-------\nToy")
    assert all(line in text for line in lines)
    assert text.index("window : Filter") < text.index("progress :") < text.index("seed : int")


def test_values(scene: Any) -> None:
    assert toy(scene) == Toy()
    given = toy(scene, 1, waves=3, band=[2, 4], parts={"wall": 1}, seed=4)
    assert (given.share, given.waves, given.band, given.parts, given.settings) == (
        1, (3.0,), (2.0, 4.0), {"wall": 1}, {"seed": 4},
    )  # fmt: skip
    assert toy(scene, seed=None) == Toy()
    assert toy(scene, names="wall", turns_deg=range(3)) == Toy(names=("wall",), turns_deg=(0.0, 1.0, 2.0))


@pytest.mark.parametrize(("given", "named"), vectors.toml("refusals.toml")["arguments of the toy"])
def test_wrong_values(scene: Any, given: dict[str, Any], named: tuple[str, ...]) -> None:
    with refused("", *named):
        toy(scene, **given)


def test_no_scene_and_options() -> None:
    with pytest.raises(MistrayError, match=r"toy\(\) got str"):
        toy("scene.xml")
    assert parsed() == Toy()
    words = "--share 0.5 --waves 1 3 --in-band 3 5 --parts wall=0.1 floor=0.2 --how slow --loud --centre 0.1 --seed 7"
    more = "--no-careful --turns-deg 0:20:10 45 --names wall floor --kinds blue"
    assert parsed(*words.split(), *more.split()) == Toy(
        0.5, waves=(1, 3), band=(3, 5), parts={"wall": 0.1, "floor": 0.2}, how="slow", loud=True, careful=False,
        turns_deg=(0, 10, 20, 45), names=("wall", "floor"), kinds=("blue",), window=Filter(centre=0.1),
        settings={"seed": 7},
    )  # fmt: skip
    assert parsed("--no-careful", "--angles", "0", "10:30:10", "--place", "0.1", "0.2", "--turn", "0.5") == Toy(
        careful=False, angles=(0, 10, 20, 30), place=(0.1, 0.2), turn=0.5
    )
    with pytest.raises(MistrayError, match="--turn is about --angles; give that too, or leave it out"):
        parsed("--turn", "0.5")
    with pytest.raises(MistrayError, match="--width says nothing alone; add --centre"):
        parsed("--width", "0.1")


@dataclass(frozen=True)
class Wall:
    """A row."""

    name: str = column("name of the wall", empty="(none)")
    temperature_K: float = column("temperature, K", digits="g")
    power_W: Estimate = column("power, W", head="emitted [W]")
    lost: float = column("share that is lost", 0.0, percent=True, digits="g")
    shares: tuple[float, ...] = ()

    @derived.column("twice the power, W")
    def double_W(self) -> Estimate:
        """Twice the power."""
        return Estimate(2 * self.power_W.value, 2 * self.power_W.se)


ROWS = [Wall("front", 293.0, Estimate(3.0, 0.1), 0.5), Wall("", math.nan, Estimate(1.0, 0.2))]
COLUMNS = ["name", "temperature_K", "power_W", "power_W_se", "lost_percent", "double_W", "double_W_se"]


def test_frame_and_records() -> None:
    found = frame(Wall, ROWS)
    assert list(found.columns) == list(frame(Wall, []).columns) == COLUMNS
    assert found.power_W_se.tolist() == [0.1, 0.2]
    assert records(Wall, ROWS)[0] == dict(zip(COLUMNS, ("front", 293.0, 3.0, 0.1, 50.0, 6.0, 0.2), strict=True))


@dataclass(frozen=True)
class Gap:
    """A row with a number and its error in two fields, a number that may be absent, a flag, and several texts."""

    width: float = column("width")
    width_se: float = column("its error")
    space: int = column("number; -1: none", absent=-1)
    shut: bool = column("whether it is shut")
    between: tuple[str, ...] = column("what it lies between")


def test_errors_in_a_field_of_their_own_and_what_is_absent() -> None:
    rows = [Gap(1.0, 0.1, -1, True, ("a", "b")), Gap(2.0, 0.2, 3, False, ())]
    assert list(frame(Gap, rows).columns) == ["width", "width_se", "space", "shut", "between"]
    assert [row["between"] for row in records(Gap, rows)] == ["a b", ""]
    found = table(Gap, rows, only=("width", "space", "shut"))
    assert found.rows == [[Estimate(1.0, 0.1), "–", "yes"], [Estimate(2.0, 0.2), 3, ""]]
    assert [head.style for head in found.columns] == ["", "", "t"]
    assert "width_se" not in [head.head for head in table(Gap, rows).columns]


def test_annotations_may_be_types_and_table() -> None:
    plain = make_dataclass("Plain", [("power_W", Estimate, column("power, W")), ("name", str, column("name"))])
    assert list(frame(plain, []).columns) == ["power_W", "power_W_se", "name"]
    assert [head.style for head in table(plain, []).columns] == ["", "t"]
    found = table(Wall, ROWS, "walls")
    assert [(head.head, head.unit, head.style) for head in found.columns] == [
        ("name", "", "t"), ("temperature", "K", ""), ("emitted", "W", ""), ("lost", "%", ""),
        ("double", "W", ""),
    ]  # fmt: skip
    assert found.rows[0] == ["front", "293", Estimate(3.0, 0.1), "50", Estimate(6.0, 0.2)]
    wide = found.beside(table(Wall, ROWS, only=("name",)), found)
    assert [len(wide.columns), *map(len, wide.rows)] == [11, 11, 11]
    assert wide.rows[0][4:6] == [Estimate(6.0, 0.2), "front"]
    short = replace(found.kept([0]), most=1, rest=["… and 1 more"]).beside(found.kept([1]))
    assert table_text(short).splitlines()[-1] == "… and 1 more"
    assert found.rows[1][:2] == ["(none)", "–"]
    assert [head.head for head in table(Wall, ROWS, only=("power_W", "name")).columns] == ["emitted", "name"]

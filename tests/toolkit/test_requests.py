"""What a request alone gives: signature, help, options, errors; of a toy. `test_every_field` is about the analyses."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any

import pytest

from mistray.errors import MistrayError
from mistray.ranges import (
    FIELD_DEG,
    FLAG,
    SHARE,
    TEXT,
    WAVELENGTH_UM,
    ByName,
    Each,
    Interval,
    Words,
)
from mistray.settings import Settings
from mistray.toolkit.analysis import analysis
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.fields import FieldSubset, Nested, Request, Several, field

pytestmark = pytest.mark.quick


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Two numbers that belong together."""

    centre: float = SHARE.field(doc="middle")
    width: float = SHARE.field(0.5, "width")


@dataclass(frozen=True)
class Toy(Request):
    """One field of each kind."""

    share: float = field(SHARE, 0.25, "a share")
    _: KW_ONLY
    waves: tuple[float, ...] | None = field(Each(WAVELENGTH_UM), None, "wavelengths, µm")
    band: tuple[float, float] = field(Interval(WAVELENGTH_UM), (1.0, 2.0), "a band, µm", option="--in-band")
    parts: Mapping[str, float] | None = field(ByName(SHARE, "wall=0.5"), None, "shares by part")
    how: str = field(Words(("fast", "slow")), "fast", "how it is done")
    loud: bool = field(FLAG, False, "whether it is said aloud")
    angles: tuple[float, ...] | None = field(Each(FIELD_DEG), None, "angles, degrees")
    place: tuple[float, float] | None = field(Each(SHARE, count=2), None, "x and y", metavar=("X", "Y"))
    turn: float | None = field(SHARE, None, "a turn of the angles", needs="angles")
    careful: bool = field(FLAG, True, "check it")
    turns_deg: tuple[float, ...] = field(Each(FIELD_DEG), range(0, 20, 10), "turns, degrees")
    names: tuple[str, ...] = field(Several(TEXT, least=0), (), "names of it", metavar="NAME")
    kinds: tuple[str, ...] | None = field(Several(Words(("red", "blue"))), None, "only these")
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


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"share": 2}, ("share is 2", "0 and 1")),
        ({"waves": []}, ("waves is empty",)),
        ({"band": (2, 1)}, ("band is 2 to 1", "lower one first")),
        ({"band": 1}, ("band has 1 number",)),
        ({"parts": {"wall": 3}}, ("parts of 'wall' is 3",)),
        ({"parts": "wall"}, ("parts is 'wall'", "wall=0.5")),
        ({"how": "fats"}, ("how is 'fats'", "fast")),
        ({"place": (0.1,)}, ("place has 1 number", "give 2")),
        ({"kinds": ["red", "rde"]}, ("kinds is 'rde'", "red")),
        ({"kinds": []}, ("kinds is empty",)),
        ({"names": ["", "wall"]}, ("names is ''", "must be text")),
        ({"window": 3}, ("window is 3", "Filter")),
        ({"seed": -1}, ("seed is -1",)),
        ({"sead": 1}, ("toy", "'sead'", "seed")),
    ],
)
def test_wrong_values(scene: Any, given: dict[str, Any], named: tuple[str, ...]) -> None:
    with pytest.raises(MistrayError) as error:
        toy(scene, **given)
    assert "\n" not in str(error.value)
    for words in named:
        assert words in str(error.value)


def test_no_scene() -> None:
    with pytest.raises(MistrayError, match=r"toy\(\) got str"):
        toy("scene.xml")


def test_options() -> None:
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

"""Scenes that are refused, in one line: too deep, no numbers, unknown plugins and parameters."""

from __future__ import annotations

import math
import time
from pathlib import Path

import mitsuba as mi
import pytest
from refusals import refused

import mistray
from mistray.scene.depth import check_source
from mistray.scene.messages import explain
from mistray.scene.xml_file import DEEPEST


def nested(levels: int) -> str:
    """A scene with elements within each other, the outermost included."""
    return '<scene version="3.0.0">\n' + "<bsdf>" * (levels - 1) + "</bsdf>" * (levels - 1) + "\n</scene>"


def test_deep_files_are_refused(tmp_path: Path) -> None:
    path, whole = tmp_path / "deep.xml", tmp_path / "scene.xml"
    whole.write_text('<scene version="3.0.0"><include filename="deep.xml"/><include filename="scene.xml"/></scene>')
    for levels in (DEEPEST + 1, 20_000):
        path.write_text(nested(levels))
        said = f"scene '{path}', line 2: <bsdf> lies within 100 other elements; close them first"
        for file in (path, whole):
            with refused() as caught:
                mistray.load(file)
            assert str(caught.value) == said
    for data in (nested(DEEPEST).encode(), b"<scene", b"", b"\x00\xff", b'<?xml encoding="?"?><a/>'):
        path.write_bytes(data)
        check_source(path)


def scene_of(folder: Path, text: str, name: str = "scene.xml") -> Path:
    """A file with these elements in a scene."""
    path = folder / name
    path.write_text(f'<scene version="3.0.0">{text}</scene>')
    return path


def refusal(folder: Path, text: str) -> str:
    """What `mistray.load` says of these elements: one line."""
    with refused() as caught:
        mistray.load(scene_of(folder, text))
    assert len(str(caught.value)) < 500
    return str(caught.value)


LENS = '<shape type="asphere" id="L1">{}<float name="semi_diameter" value="5"/></shape>'


def test_what_is_no_number_is_refused(tmp_path: Path) -> None:
    """Mitsuba makes 0 of what is empty, a plane of an empty radius, and inf or 0 of what it cannot hold."""
    defaults = '<default name="none" value=""/><default name="blank" value="$none $none"/>'
    for value in ("", "\t", "$none", "$blank", "5x", "1,5", "1e400", "1e-400"):
        said = refusal(tmp_path, defaults + LENS.format(f'<float name="radius" value="{value}"/>'))
        assert "shape 'L1': radius is '" in said
        assert "must be a number" in said or "beyond the range" in said
    for operation, words in (
        ('<translate z=""/>', "z of <translate> is ''"),
        ('<translate value="1 2"/>', "give 1 or 3 numbers, not 2"),
        ('<rotate angle="" z="1"/>', "angle of <rotate> is ''"),
        ('<lookat origin="" target="0 0 1"/>', "origin of <lookat> is ''"),
        ('<matrix value=""/>', "give 9 or 16 numbers"),
        ('<matrix value="1 0 0 0  0 1 0 0  0 0 1 0  0 0 0 0"/>', "'0 0 0 0' as its last row"),
        ('<matrix value="1 0 0 0  0 1 0 0  0 0 x 0  0 0 0 1"/>', "holds 'x'"),
    ):
        said = refusal(tmp_path, LENS.format(f'<transform name="to_world">{operation}</transform>'))
        assert "shape 'L1': to_world: " in said
        assert words in said


def test_other_numbers_are_taken_as_they_are(tmp_path: Path) -> None:
    look_at = '<transform name="to_world"><lookat origin="0 0 0" target="0 0 1" up=""/></transform>'
    matrix = '<transform name="to_world"><matrix value="1 0 0, 0 1 0, 0 0 1"/><translate/></transform>'
    values = ('<float name="radius" value=" -1.5e+01 "/>', '<float name="radius" value="inf"/>', look_at, matrix)
    defaults = '<default name="a" value="5"/><default name="ab" value="$a."/>'
    for text in (*values, f'{defaults}<float name="z" value="-$ab"/>'):
        assert mistray.load(scene_of(tmp_path, LENS.format(text))) is not None


def test_includes_that_multiply(tmp_path: Path) -> None:
    """Fourteen files of two kilobytes, six includes each: 1.6e10 files; Mitsuba would not end."""
    for k in range(14):
        include = f'<include filename="part{k + 1}.xml"/>' if k < 13 else ""
        scene_of(tmp_path, include * 6, f"part{k}.xml")
    began = time.monotonic()
    with refused(r"part0\.xml': it includes more than 1000 files, .*; put"):
        mistray.load(tmp_path / "part0.xml")
    assert time.monotonic() - began < 20


def test_parameters_that_double(tmp_path: Path) -> None:
    """Each of 26 lines is twice as long as the one before: Mitsuba took 4 GB. No value is made that is too long."""
    lines = "".join(f'<default name="p{k + 1}" value="$p{k}$p{k}"/>' for k in range(40))
    said = refusal(tmp_path, f'<default name="p0" value="{"x" * 64}"/>{lines}')
    assert "<default> 'p" in said
    assert "more than 32 MiB" in said
    with (tmp_path / "large.xml").open("wb") as file:
        file.truncate(1 << 40)  # sparse: a terabyte of nothing
    with refused("more than 32 MiB of text"):
        mistray.load(tmp_path / "large.xml")


def test_files_within_each_other(tmp_path: Path) -> None:
    """Mitsuba ends at fifteen files, with as many lines and no name of a file."""
    for k in range(16):
        scene_of(tmp_path, f'<include filename="{k + 1}.xml"/>' if k < 15 else "", f"{k}.xml")
    assert mistray.load(tmp_path / "1.xml") is not None
    with refused(r"14\.xml', line 1: <include> '15\.xml' lies within 15 files"):
        mistray.load(tmp_path / "0.xml")
    assert "'scene.xml' lies within itself" in refusal(tmp_path, '<include filename="scene.xml"/>')
    folder = tmp_path / "my scenes (old)"
    folder.mkdir()
    (folder / "lens.xml").write_text('<scene version="3.0.0">\n' + LENS.replace("5", "x").format("") + "</scene>")
    scene_of(folder, '<include filename="lens.xml"/>')
    for file in ("lens.xml", "scene.xml"):
        with refused() as caught:
            mistray.load(folder / file)
        expected = f"scene '{folder / 'lens.xml'}', line 2: shape 'L1': semi_diameter is 'x'; it must be a number"
        assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LENS.format('<transform name="0"><translate z="5"/></transform>'), "unknown parameter '0' of shape 'L1'"),
        (LENS.format(f'<string name="layers" value="{"MgF2 100 " * 20_000}"/>'), "'layers' = MgF2 100"),
        (LENS.format('<float name="z" value="1"/><float name="z" value="1"/>'), "'L1': z is given twice"),
        (LENS.format('<float name="Radius" value="1"/>'), "did you mean 'radius'?"),
        ('<shape type="sphere" id="${jndi}"/>', "holds $"),
        ('<string name="x" value="1"/>', "unknown parameter 'x' = 1 of <scene>"),
        # Mitsuba takes a property for known once somebody has read it, whoever it was
        *((LENS.format(f'<string name="{name}" value="x"/>'), f"unknown parameter '{name}'")
          for name in ("filename", "prt", "r")),
    ],
)  # fmt: skip
def test_messages(tmp_path: Path, text: str, words: str) -> None:
    assert words in refusal(tmp_path, text)


def test_numbers_of_dicts(tmp_path: Path) -> None:
    box = {"type": "interface", "R": 0.0}
    tipped = mi.ScalarTransform4f([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]])
    for part, words in (
        ({"type": "sphere", "radius": math.nan, "bsdf": box}, "radius is nan"),
        ({"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, 0, math.inf]), "bsdf": box}, "to_world"),
        ({"type": "cube", "to_world": tipped, "bsdf": box}, "last row"),
        ({"type": "point", "intensity": {"type": "rgb", "value": [1.0, 2.0, math.inf]}}, "intensity holds inf"),
        ({"type": "point", "intensity": {"type": "spectrum", "value": math.nan}}, "intensity holds nan"),
        ({"type": "asphere", "semi_diameter": ""}, "semi_diameter is ''"),
        ({"type": "asphere", "semi_diameter": 5.0, "part": "a\ud800"}, "half of a character"),
        ({"type": "part_mesh", "filename": ""}, "filename is ''"),
        ({"type": "collimated", "radius": 1.0, "wavelength_nm": "550,,600"}, "wavelength_nm is '550,,600'"),
    ):
        with refused("", "'one'", words):
            mistray.load({"type": "scene", "one": part})


GOOD = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "1.5"}}


def test_dicts() -> None:
    for shape, words in (
        ({"semidiameter": 3.0}, "parameter 'semidiameter' = 3.0 of asphere 'L1'; did you mean 'semi_diameter'?"),
        ({"semi_diameter": "five"}, "shape 'L1': semi_diameter is 'five'; it must be a number"),
        ({"semi_diameter": [1]}, "'L1': semi_diameter is a list; give a number or a string"),
        ({"semi_diameter": 1e15}, "shape 'L1': semi_diameter is 1e"),
        ({"semi_diameter": 1e300}, "shape 'L1': semi_diameter is 1e"),
        ({"bsdf": {"type": "interface", "bak": "1"}}, "'bak' = 1 of interface of asphere 'L1'; did you mean 'back'?"),
        ({"bsdf": {"type": "interface", "R": 0.9, "T": 0.9}}, "interface of asphere 'L1': R = 0.9 and T = 0.9"),
        ({"type": "aspheer"}, "there is no plugin 'aspheer'; did you mean 'asphere'?"),
        ({"type": "torus"}, "there is no plugin 'torus'"),
    ):
        given = {key: value for key, value in GOOD.items() if key != "semi_diameter" or "semidiameter" not in shape}
        with refused("", words):
            mistray.load({"type": "scene", "L1": given | shape})
    for given, words in (
        ({"type": "sphere"}, 'the dict describes a Shape; add "type": "scene"'),
        ({"type": "scene", "L1": {"semi_diameter": 5.0}}, "'L1' has no type"),
    ):
        with refused(words):
            mistray.load(given)


def test_what_is_not_known_is_passed_on_in_one_line(tmp_path: Path) -> None:
    """Of an error in Python inside of a plugin its last line, not its frames."""
    error = RuntimeError("[scene.cpp:12] Something\n  new went wrong")
    assert explain(error, tmp_path / "a.xml") == f"scene '{tmp_path}/a.xml': Something new went wrong; correct the file"
    assert explain(RuntimeError(""), {}) == "scene: RuntimeError; correct the dict"
    text = (
        'failed to instantiate shape plugin of type "asphere": Traceback (most recent call last):\n'
        '  File "/x/asphere.py", line 97, in __init__\n    self._finish(props, values)\n'
        "FloatingPointError: overflow encountered in cast\n"
    )
    line = explain(RuntimeError(text), {"type": "scene"})
    assert line == "scene: FloatingPointError: overflow encountered in cast; correct the dict"

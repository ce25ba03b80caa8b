"""Mitsuba's errors in one line: places in files and dicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.errors import MistrayError
from mistray.scene.messages import explain

GOOD = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "1.5"}}


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"semidiameter": 3.0}, "parameter 'semidiameter' = 3.0 of asphere 'L1'; did you mean 'semi_diameter'?"),
        ({"semi_diameter": "five"}, "shape 'L1': semi_diameter is 'five'; it must be a number"),
        ({"semi_diameter": [1]}, "'L1': semi_diameter is a list; give a number or a string"),
        ({"semi_diameter": 1e15}, "shape 'L1': semi_diameter is 1e"),
        ({"semi_diameter": 1e300}, "shape 'L1': semi_diameter is 1e"),
        ({"bsdf": {"type": "interface", "bak": "1"}}, "'bak' = 1 of interface of asphere 'L1'; did you mean 'back'?"),
        ({"bsdf": {"type": "interface", "R": 0.9, "T": 0.9}}, "interface of asphere 'L1': R = 0.9 and T = 0.9"),
        ({"type": "aspheer"}, "there is no plugin 'aspheer'; did you mean 'asphere'?"),
        ({"type": "torus"}, "there is no plugin 'torus'"),
    ],
)
def test_dicts(shape: dict[str, Any], words: str) -> None:
    given = {key: value for key, value in GOOD.items() if key != "semi_diameter" or "semidiameter" not in shape}
    with pytest.raises(MistrayError) as caught:
        mistray.load({"type": "scene", "L1": given | shape})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_dict_that_is_no_scene() -> None:
    with pytest.raises(MistrayError, match='the dict describes a Shape; add "type": "scene"'):
        mistray.load({"type": "sphere"})
    with pytest.raises(MistrayError, match="'L1' has no type"):
        mistray.load({"type": "scene", "L1": {"semi_diameter": 5.0}})


def test_a_path_with_blanks_and_an_included_file(tmp_path: Path) -> None:
    folder = tmp_path / "my scenes (old)"
    folder.mkdir()
    (folder / "lens.xml").write_text(
        '<scene version="3.0.0">\n'
        '  <shape type="asphere" id="L1"><float name="semi_diameter" value="x"/></shape>\n'
        "</scene>"
    )
    (folder / "scene.xml").write_text('<scene version="3.0.0"><include filename="lens.xml"/></scene>')
    expected = f"scene '{folder / 'lens.xml'}', line 2: shape 'L1': semi_diameter is 'x'; it must be a number"
    for file in ("lens.xml", "scene.xml"):
        with pytest.raises(MistrayError) as caught:
            mistray.load(folder / file)
        assert expected in str(caught.value)


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

"""Mitsuba's errors in one line: places in files and dicts, and the parameters a plugin takes."""

from __future__ import annotations

import pytest

import mistray
from mistray.errors import MistrayError
from mistray.scene.messages import explain, parameters

PLUGINS = {
    "asphere": {"radius", "conic", "a4", "a20", "semi_diameter", "half_width", "to_world", "part", "space"},
    "frustum": {"r0", "r1", "z0", "z1", "to_world", "part", "space"},
    "interface": {"front", "back", "R", "T", "table", "mirror", "wavelength_nm"},
    "collimated": {"radius", "field_deg", "irradiance", "wavelength_nm", "weights", "pattern", "to_world"},
    "straylight": {"rays", "max_reflections", "max_events", "flux_threshold", "splitting", "below_threshold", "seed"},
}


@pytest.mark.parametrize("plugin", PLUGINS)
def test_parameters_come_from_the_manual_page(plugin):
    mistray.load("plate")
    assert set(parameters(plugin)) >= PLUGINS[plugin]
    assert "bsdf" not in parameters(plugin)


def test_stock_plugins_have_no_list():
    assert parameters("sphere") == parameters("") == []


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"semidiameter": 3.0}, "parameter 'semidiameter' = 3.0 of asphere 'L1'; did you mean 'semi_diameter'?"),
        ({"semi_diameter": -3.0}, "shape 'L1': semi_diameter is -3; it must lie"),
        ({"semi_diameter": "five"}, "shape 'L1': semi_diameter is 'five'; it must be a number"),
        ({"semi_diameter": [1]}, "'L1': semi_diameter is a list; give a number or a string"),
        ({"bsdf": {"type": "interface", "bak": "1"}}, "'bak' = 1 of interface of asphere 'L1'; did you mean 'back'?"),
        ({"bsdf": {"type": "interface", "R": 0.9, "T": 0.9}}, "interface of asphere 'L1': R = 0.9 and T = 0.9"),
        ({"type": "aspheer"}, "there is no plugin 'aspheer'; did you mean 'asphere'?"),
        ({"type": "torus"}, "there is no plugin 'torus'"),
    ],
)  # fmt: skip
def test_dicts(shape, words):
    good = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "1.5"}}
    scene = {"type": "scene", "L1": good | shape}
    if "semidiameter" in shape:
        del scene["L1"]["semi_diameter"]
    with pytest.raises(MistrayError) as caught:
        mistray.load(scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_dict_that_is_no_scene():
    with pytest.raises(MistrayError, match='the dict describes a Shape; add "type": "scene"'):
        mistray.load({"type": "sphere"})
    with pytest.raises(MistrayError, match="'L1' has no type"):
        mistray.load({"type": "scene", "L1": {"semi_diameter": 5.0}})


def test_a_path_with_blanks_and_an_included_file(tmp_path):
    folder = tmp_path / "my scenes (old)"
    folder.mkdir()
    (folder / "lens.xml").write_text(
        '<scene version="3.0.0">\n'
        '  <shape type="asphere" id="L1"><float name="semi_diameter" value="x"/></shape>\n'
        "</scene>"
    )
    (folder / "scene.xml").write_text('<scene version="3.0.0"><include filename="lens.xml"/></scene>')
    for file in ("lens.xml", "scene.xml"):
        with pytest.raises(MistrayError) as caught:
            mistray.load(folder / file)
        assert f"scene '{folder / 'lens.xml'}', line 2: shape 'L1': semi_diameter is 'x'; it must be a number" in str(
            caught.value
        )


def test_what_is_not_known_is_passed_on_in_one_line(tmp_path):
    error = RuntimeError("[scene.cpp:12] Something\n  new went wrong")
    assert explain(error, tmp_path / "a.xml") == f"scene '{tmp_path}/a.xml': Something new went wrong; correct the file"
    assert explain(RuntimeError(""), {}) == "scene: RuntimeError; correct the dict"


def test_no_traceback_of_a_plugin_reaches_the_user(monkeypatch):
    """An error in Python inside of a plugin: its last line, not its frames."""
    text = (
        'failed to instantiate shape plugin of type "asphere": Traceback (most recent call last):\n'
        '  File "/x/asphere.py", line 97, in __init__\n    self._finish(props, values)\n'
        "FloatingPointError: overflow encountered in cast\n"
    )
    line = explain(RuntimeError(text), {"type": "scene"})
    assert line == "scene: FloatingPointError: overflow encountered in cast; correct the dict"


@pytest.mark.parametrize("size", [1e15, 1e300])
def test_shapes_beyond_all_measure_are_refused(size):
    scene = {"type": "scene", "L1": {"type": "asphere", "semi_diameter": size}}
    with pytest.raises(MistrayError, match=r"shape 'L1': semi_diameter is 1e.*"):
        mistray.load(scene)


@pytest.mark.parametrize("place", ['<translate y="up"/>', '<rotate x="1" angle="up"/>', '<scale value="up"/>'])
def test_no_number_in_a_transform(place: str, tmp_path):
    """Its numbers stand in attributes of their own: it is given once."""
    text = f'<shape type="asphere" id="L1"><transform name="to_world">{place}</transform></shape>'
    (tmp_path / "lens.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
    with pytest.raises(MistrayError) as caught:
        mistray.load(tmp_path / "lens.xml")
    assert "'up'" in str(caught.value)
    assert "twice" not in str(caught.value)

"""Sources that cannot be, by each way into a scene: one line that names the source, the value and what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.cli import main

pytestmark = pytest.mark.quick

FILES = {
    "no unit.csv": "x,y,z,dx,dy,dz,flux_W\n0,0,-5,0,0,1,1\n",
    "no unit.dat": "1\n1 2 3 0 0 1 5.5\n",
    "nan.csv": "x_mm,y_mm,z_mm,dx,dy,dz,flux_W\n0,0,-5,0,0,1,1\n0,0,nan,0,0,1,1\n",
    "falling.csv": "500,1\n400,2\n",
    "dark.csv": "400,0\n500,0\n",
    "lamp.ies": "hello\n",
}
POINT = {"type": "point_source", "z": -20.0}
# What of the value and of the remedy its message names
WRONG: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({**POINT, "power": -1.0}, ("power is -1", "1e-30")),
    ({**POINT, "power": float("nan")}, ("power is nan", "number")),
    ({**POINT, "power": 1e308}, ("power is 1e+308", "1e30")),
    ({**POINT, "z": -1e308}, ("z is -1e+308", "1e12")),
    ({**POINT, "stokes": "1, 1, 0"}, ("stokes is 1, 1, 0", "at most 1")),
    ({**POINT, "wavelength_nm": "500, -3"}, ("wavelength_nm is -3", "10")),
    ({**POINT, "filename": "lamp.ies"}, ("lamp.ies", "TILT=")),
    ({**POINT, "hue": 1.0}, ("hue", "parameter")),
    ({"type": "gaussian_beam", "waist_x": 0.0, "waist_y": 1.0}, ("waist_x is 0", "1e-15")),
    ({"type": "surface_source", "radius": 1.0, "radiance": -2.0}, ("radiance is -2", "1e-30")),
    ({"type": "distant_disc", "irradiance": -2.0}, ("irradiance is -2", "1e-30")),
    ({"type": "collimated", "radius": 1.0, "irradiance": -2.0}, ("irradiance is -2", "1e-30")),
    ({"type": "sky", "radiance": 0.0}, ("radiance is 0", "1e-30")),
    ({"type": "sky", "spectrum": "blackbody:0"}, ("temperature is 0", "0 excluded")),
    ({"type": "sky", "spectrum": "blackbody:-5"}, ("temperature is -5", "0 excluded")),
    ({"type": "sky", "spectrum": "falling.csv"}, ("falling.csv", "line 2", "400 nm", "sort")),
    ({"type": "sky", "spectrum": "dark.csv"}, ("dark.csv",)),
    ({"type": "sky", "spectrum": "none.csv"}, ("none.csv", "check the path")),
    ({"type": "ray_file", "filename": "no unit.csv"}, ("no unit.csv", "x_mm")),
    ({"type": "ray_file", "filename": "no unit.dat"}, ("no unit.dat", "unit=")),
    ({"type": "ray_file", "filename": "nan.csv"}, ("nan.csv", "ray 2 is 0, 0, nan", "give numbers")),
    ({"type": "ray_file", "filename": "none.csv"}, ("none.csv", "check the path")),
    ({"type": "thermal", "temperature_K": -3.0}, ("temperature_K is -3", "1e6 K")),
    ({"type": "thermal", "temperature_K": 0.0}, ("0 K", "temperature_K")),
    ({"type": "thermal", "parts": "cold stop=77"}, ("cold stop", "screen")),
    ({"type": "point_source", "z": 2000.0, "half_angle_deg": 10.0}, ("no ray", "position")),
    ({"type": "point_source", "z": 50.0}, ("'Al'", "'block'", "move it")),
]  # fmt: skip
METAL = {"type": "interface", "back": "Al"}
BODIES: dict[str, Any] = {
    "screen": {
        "type": "asphere",
        "semi_diameter": 10.0,
        "bsdf": {"type": "interface", "R": 0.0},
        "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
    },
    "block": {"type": "sphere", "center": [0, 0, 50], "radius": 5.0, "flip_normals": True, "bsdf": METAL},
}
SHAPES = """
<shape type="asphere" id="screen"><float name="semi_diameter" value="10"/>
  <bsdf type="interface"><float name="R" value="0"/></bsdf>
  <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor></shape>
<shape type="sphere" id="block"><point name="center" x="0" y="0" z="50"/><float name="radius" value="5"/>
  <boolean name="flip_normals" value="true"/><bsdf type="interface"><string name="back" value="Al"/></bsdf></shape>
"""


def by_dict(lamp: dict[str, Any], folder: Path, _: Any) -> str:
    """What a trace of a dict says."""
    with pytest.raises(mistray.MistrayError) as error:
        mistray.trace(mistray.load({"type": "scene", "my lamp": lamp, **BODIES}), rays=1000)
    return str(error.value)


def by_command(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """What the command line says, which ends with an error."""
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["ghosts", *arguments, "--rays", "1000"]))
    assert ended.value.code == 2
    output, text = capfd.readouterr()
    assert not output.strip()
    return text.strip()


def by_file(lamp: dict[str, Any], folder: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """The same of an XML file."""
    given = {key: value for key, value in lamp.items() if key != "type"}
    rows = "".join(
        f'<{"float" if isinstance(value, float) else "string"} name="{key}" value="{value}"/>'
        for key, value in given.items()
    )
    file = folder / "a scene.xml"
    file.write_text(
        f'<scene version="3.0.0"><emitter type="{lamp["type"]}" id="my lamp">{rows}</emitter>{SHAPES}</scene>'
    )
    return by_command([str(file)], capfd)


def by_option(lamp: dict[str, Any], folder: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """The same of ``--source``, where blanks stand in lists."""
    lists = ("wavelength_nm", "stokes")
    words = [
        f"{key}={str(value).replace(',', '') if key in lists else value}"
        for key, value in lamp.items()
        if key != "type"
    ]
    file = folder / "a scene.xml"
    file.write_text(f'<scene version="3.0.0">{SHAPES}</scene>')
    return by_command([str(file), "--source", ",".join([f"{lamp['type']}:id=my lamp", *words])], capfd)


@pytest.mark.parametrize("way", [by_dict, by_file, by_option])
@pytest.mark.parametrize(("lamp", "words"), WRONG, ids=lambda value: str(value) if isinstance(value, dict) else "")
def test_one_line(
    lamp: dict[str, Any],
    words: tuple[str, ...],
    way: Callable[[dict[str, Any], Path, Any], str],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Its name, the value and the remedy, and nothing else is printed."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    keys = [key for key, value in lamp.items() if str(value) in FILES or str(value) == "none.csv"]
    text = way({**lamp, **{key: str(tmp_path / lamp[key]) for key in keys}}, tmp_path, capfd)
    assert "\n" not in text
    assert "my lamp" in text
    for word in words:
        assert word in text


def test_a_kind_that_is_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The kinds of sources are named, and no plugin that is none."""
    text = by_file({"type": "warp"}, tmp_path, capfd)
    assert "point_source" in text
    assert "asphere" not in text
    assert "light_source" not in text

"""Sources that cannot be: one line that names the source, the value and what to do, by each way into a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails
from lit_detector import lit

import mistray

pytestmark = pytest.mark.quick

FILES = {
    "no unit.csv": "x,y,z,dx,dy,dz,flux_W\n0,0,-5,0,0,1,1\n",
    "no unit.dat": "1\n1 2 3 0 0 1 5.5\n",
    "lines.csv": "x_mm,y_mm,z_mm,dx,dy,dz,flux_W,wavelength_nm\n0,0,-5,0,0,1,1,500\n",
    "falling.csv": "500,1\n400,2\n",
    "dark.csv": "400,0\n500,0\n",
    "hello.ies": "hello\n",
    "lamp.ies": "IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 3 1 1 2 0.1 0.1 0\n1 1 12.5 0 45 90 0 1 1 1\n",
}
POINT = {"type": "point_source", "z": -20.0}
BEAM = {"type": "gaussian_beam", "waist_x": 1.0, "waist_y": 1.0}
DISC = {"type": "surface_source", "radius": 1.0}
THERMAL = {"type": "thermal"}
IES = {**POINT, "filename": "lamp.ies"}
# What of the value and of the remedy its message names
WRONG: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({**POINT, "power": -1.0}, ("power is -1", "1e-30")),
    ({**POINT, "power": 1e308}, ("power is 1e+308", "1e30")),
    ({**POINT, "power": 1.0, "intensity": 1.0}, ("power", "intensity")),
    ({**POINT, "exponent": 2.0, "half_angle_deg": 120.0}, ("exponent", "120")),
    ({**POINT, "half_angle_deg": 0.0}, ("half_angle_deg is 0",)),
    *(({**POINT, "profile": text}, ("profile",)) for text in ("0:1", "0:1, 0:2", "0:0, 10:0", "a:b", "0:1, 10:nan")),
    ({**POINT, "stokes": "1, 1, 0"}, ("stokes is 1, 1, 0", "at most 1")),
    ({**POINT, "wavelength_nm": "500, -3"}, ("wavelength_nm is -3", "10")),
    ({**POINT, "filename": "hello.ies"}, ("hello.ies", "TILT=")),
    ({**POINT, "hue": 1.0}, ("hue", "parameter")),
    ({**IES, "half_angle_deg": 20.0}, ("filename", "half_angle_deg")),
    ({**IES, "exponent": 1.0}, ("filename", "exponent")),
    ({**IES, "profile": "0:1, 20:0"}, ("filename", "profile")),
    ({**IES, "wavelength_nm": 900.0}, ("lumens",)),
    ({**BEAM, "waist_x": 0.0}, ("waist_x is 0", "1e-15")),
    ({"type": "gaussian_beam", "waist_x": 1.0}, ("waist_y",)),
    ({**BEAM, "m2_x": 0.5}, ("m2_x is 0.5",)),
    ({"type": "surface_source"}, ("radius",)),
    ({**DISC, "half_width": 1.0, "half_height": 1.0}, ("radius", "half_width")),
    ({"type": "surface_source", "half_width": 1.0}, ("half_height",)),
    ({**DISC, "inner_radius": 1.0}, ("inner_radius",)),
    ({"type": "distant_disc", "irradiance": 1.0, "radiance": 1.0}, ("irradiance", "radiance")),
    ({"type": "sky", "radiance": 0.0}, ("radiance is 0", "1e-30")),
    ({"type": "sky", "spectrum": "blackbody:0"}, ("temperature is 0", "0 excluded")),
    ({"type": "sky", "spectrum": "falling.csv"}, ("falling.csv", "line 2", "400 nm", "sort")),
    ({"type": "sky", "spectrum": "dark.csv"}, ("dark.csv",)),
    ({"type": "sky", "spectrum": "none.csv"}, ("none.csv", "check the path")),
    ({"type": "sky", "filename": "dark.exr"}, ("radiance of 0",)),
    ({"type": "sky", "filename": "none.exr"}, ("none.exr",)),
    ({"type": "sky", "filename": "dark.exr", "half_angle_deg": 9.0}, ("half_angle_deg",)),
    ({"type": "ray_file", "filename": "no unit.csv"}, ("no unit.csv", "x_mm")),
    ({"type": "ray_file", "filename": "no unit.dat"}, ("no unit.dat", "unit=")),
    ({"type": "ray_file", "filename": "lines.csv", "wavelength_nm": 500.0}, ("wavelength_nm", "leave it out")),
    ({"type": "ray_file", "filename": "none.csv"}, ("none.csv", "check the path")),
    ({**THERMAL, "temperature_K": -3.0}, ("temperature_K is -3", "1e6 K")),
    ({**THERMAL, "temperature_K": 0.0}, ("0 K", "temperature_K")),
    ({**THERMAL, "parts": "cold stop=77"}, ("cold stop", "detector")),
    *(({**THERMAL, "parts": text}, ("parts",)) for text in ("detector", "detector=cold", "=4")),
    ({**THERMAL, "parts": "detector=-4"}, ("temperature of 'detector' is -4",)),
    *(({**THERMAL, "band_nm": text}, ("band_nm",)) for text in ("12000, 8000", "8000")),
    *(
        ({**THERMAL, key: value}, (key,))
        for key, value in {
            "wavelength_nm": 1e4, "spectrum": "blackbody:300", "power": 1.0, "field_deg": 3.0, "stokes": "1, 0, 0"
        }.items()
    ),
    ({**THERMAL, "parts": "detector=0; block=0"}, ("no light",)),
    ({**POINT, "z": 2000.0, "half_angle_deg": 10.0}, ("no ray", "position")),
    ({"type": "point_source", "z": 50.0}, ("'Al'", "'block'", "move it")),
]  # fmt: skip
METAL = {"type": "interface", "back": "Al"}
BLOCK = {"type": "sphere", "center": [0, 0, 50], "radius": 5.0, "flip_normals": True, "bsdf": METAL}
SHAPES = """
<shape type="asphere" id="screen"><float name="semi_diameter" value="10"/>
  <bsdf type="interface"><float name="R" value="0"/></bsdf>
  <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor></shape>
"""


@pytest.mark.parametrize(("lamp", "words"), WRONG, ids=lambda value: str(value) if isinstance(value, dict) else "")
def test_one_line(lamp: dict[str, Any], words: tuple[str, ...], tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    mi.Bitmap(np.zeros((4, 8, 3), dtype=np.float32)).write(str(tmp_path / "dark.exr"))
    kinds = ("csv", "dat", "ies", "exr")
    files = {key: str(tmp_path / str(value)) for key, value in lamp.items() if str(value).endswith(kinds)}
    with pytest.raises(mistray.MistrayError) as error:
        mistray.trace(lit({"id": "my lamp", **lamp, **files}, block=BLOCK), rays=1000)
    message = str(error.value)
    assert "\n" not in message
    for word in ("lamp", *words):
        assert word in message


def test_by_a_file_and_by_an_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same lines; in a list of an option blanks stand for commas."""
    file = tmp_path / "a scene.xml"
    for keys, words in (
        ({"power": "-1"}, ("power is -1", "1e-30")),
        ({"stokes": "1, 1, 0"}, ("stokes is 1, 1, 0", "at most 1")),
        ({"filename": str(tmp_path / "none.ies")}, ("none.ies", "check the path")),
    ):
        rows = "".join(f'<{"float" if k == "power" else "string"} name="{k}" value="{v}"/>' for k, v in keys.items())
        emitter = f'<emitter type="point_source" id="my lamp">{rows}</emitter>'
        option = ",".join(["point_source:id=my lamp", *(f"{k}={v.replace(',', '')}" for k, v in keys.items())])
        for text, more in ((emitter, ()), ("", ("--source", option))):
            file.write_text(f'<scene version="3.0.0">{text}{SHAPES}</scene>')
            message = fails(capsys, "ghosts", file, "--rays", 1000, *more)
            for word in ("my lamp", *words):
                assert word in message


def test_kinds_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The kinds of sources are named, and no plugin that is none; stock emitters that cannot be traced are none."""
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0"><emitter type="warp"/>{SHAPES}</scene>')
    message = fails(capsys, "ghosts", tmp_path / "scene.xml")
    assert "point_source" in message
    assert not any(name in message for name in ("asphere", "light_source"))
    with pytest.raises(mistray.MistrayError, match="Projector"):
        mistray.trace(lit({"type": "projector", "irradiance": {"type": "spectrum", "value": 1.0}, "fov": 20.0}))

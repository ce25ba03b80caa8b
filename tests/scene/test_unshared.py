"""Scene texts with scatter models of their own at every surface."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.errors import MistrayError
from mistray.scene.unshared import SceneText

POLISH = '<bsdf type="harvey_shack" id="polish"><float name="rms_nm" value="4"/><float name="l" value="0.01"/></bsdf>'
DUST = '<bsdf type="particulate" id="dust"><float name="coverage_percent" value="0.1"/></bsdf>'
BLACK = '<bsdf type="paint" id="black"><string name="preset" value="flat_black"/></bsdf>'
WALL = '<bsdf type="interface" id="wall"><float name="R" value="0"/><ref id="black"/></bsdf>'
AR = '<bsdf type="thinfilm" id="AR"><string name="layers" value="1.38 0.25w"/></bsdf>'


def text() -> str:
    def window(front: str, back: str) -> str:
        refs = "".join(f'<ref id="{name}"/>' for name in ("AR", "polish", "dust"))
        return interface_xml(front, back).removesuffix("</bsdf>") + refs + "</bsdf>"

    shapes = (
        shape_xml("asphere", "front", 0.0, window("air", "1.5"), semi_diameter=5.0),
        shape_xml("asphere", "rear", 2.0, window("1.5", "air"), semi_diameter=5.0),
        shape_xml("frustum", "tube", 0.0, '<ref id="wall"/>', r0=6.0, z0=0.0, r1=6.0, z1=20.0),
        shape_xml("frustum", "cone", 0.0, '<ref id="black"/>', r0=7.0, z0=0.0, r1=8.0, z1=20.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=3.0, half_height=3.0),
    )
    return scene_text(POLISH, DUST, BLACK, WALL, AR, *shapes)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "scene.xml"
    path.write_text(text(), encoding="utf-8")
    return path


def rewritten(file: SceneText, folder: Path) -> mi.SceneParameters:
    path = folder / "own.xml"
    path.write_text(file.text(folder), encoding="utf-8")
    return mi.traverse(mistray.load(path))


def test_every_surface_has_its_own(source: Path) -> None:
    before = mi.traverse(mistray.load(source))
    assert "polish.rms_nm" in before
    after = rewritten(SceneText(source), source.parent)
    keys = {f"{side}.bsdf.{rest}" for side in ("front", "rear") for rest in ("harvey_shack.rms_nm",
            "particulate.coverage_percent")}  # fmt: skip
    keys |= {"tube.bsdf.paint.reflectance", "cone.bsdf.reflectance"}
    assert keys <= set(after.keys())
    assert not [key for key in after.keys() if key.startswith(("polish.", "dust.", "black."))]  # noqa: SIM118
    assert "AR.thickness_nm" in after  # a coating stays shared


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rear.bsdf.harvey_shack.rms_nm", 1.5),
        ("front.bsdf.particulate.coverage_percent", 0.02),
        ("tube.bsdf.paint.reflectance", 0.02),
        ("cone.bsdf.reflectance", 0.03),
        ("polish.rms_nm", 2.0),  # stays shared
    ],
)
def test_new_values(source: Path, key: str, value: float) -> None:
    """One value changes, and nothing else."""
    own = not key.startswith("polish")
    before = rewritten(SceneText(source, own), source.parent)
    file = SceneText(source, own)
    file.set(key, value)
    after = rewritten(file, source.parent)
    assert np.array(after[key]) == pytest.approx([value], rel=1e-6)
    others = [k for k in after.keys() if k != key and isinstance(after[k], mi.Float)]  # noqa: SIM118
    assert all(np.array_equal(np.array(before[k]), np.array(after[k])) for k in others)


def test_what_cannot_be_done(source: Path, tmp_path: Path) -> None:
    with pytest.raises(MistrayError, match=r"the model of 'side\.bsdf\.paint\.reflectance' does not stand in the file"):
        SceneText(source).set("side.bsdf.paint.reflectance", 0.1)
    with pytest.raises(MistrayError, match="No such file"):
        SceneText(tmp_path / "nothing.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<scene")
    with pytest.raises(MistrayError, match="broken XML"):
        SceneText(broken)

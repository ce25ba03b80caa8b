"""Improbable scatter is named when a scene is loaded, and the shipped scenes have none."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.errors import MistrayWarning
from mistray.scene.improbable import improbable
from mistray.scene.load import shipped_scenes

DETECTOR = {
    "type": "asphere", "half_width": 1.0, "half_height": 1.0, "bsdf": {"type": "interface", "R": 0.0},
    "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
}  # fmt: skip


def scene(*models: dict[str, Any]) -> dict[str, Any]:
    """A stack of mirrors before a detector, each with a model of scatter."""
    mirrors = {
        f"mirror_{k}": {
            "type": "frustum", "r0": 1.0, "r1": 2.0, "z0": 10.0 * k, "z1": 10.0 * k,
            "bsdf": {"type": "interface", "R": 0.9, "model": model},
        }
        for k, model in enumerate(models, start=1)
    }  # fmt: skip
    return {"type": "scene", "beam": {"type": "collimated", "radius": 2.0}, "detector": DETECTOR, **mirrors}


def told(given: dict[str, Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        mistray.load(given)
    assert all(item.category is MistrayWarning for item in found)
    assert all(item.filename == __file__ for item in found), "the warning points at who loads"
    return [str(item.message) for item in found]


def test_names_surface_value_and_range() -> None:
    found = told(
        scene(
            {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 1.8},
            {"type": "abg", "A": 1e-6, "B": 1e-8, "g": 2.5},
            {"type": "harvey_shack", "b0": 0.1, "l": 0.3, "s": -1.5},
            {"type": "abg", "A": 1.0, "B": 1e-8, "g": 2.0, "relative_to": "incident"},
        )
    )
    assert len(found) == 3
    for text, parts in zip(
        found,
        (
            ("'mirror_1'", "0.001", "1.8", "1e-10 … 1e-6"),
            ("'mirror_3'", "l 0.3", "1e-4 … 1e-2"),
            ("'mirror_4'", "57.9"),
        ),
        strict=True,
    ):
        assert all(part in text for part in parts), text
        assert "\n" not in text


def test_a_shared_model_speaks_once() -> None:
    given = scene(*[{"type": "ref", "id": "polish"}] * 5)
    found = told({"polish": {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 1.8}, **given})
    assert len(found) == 1
    assert "and 2 more" in found[0]


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_probable(name: str) -> None:
    """But for one, whose A, B and g are those that the webinar plots, outside of what it calls typical."""
    found = improbable(mistray.load(name))
    assert len(found) == (name == "plate_and_wall")
    assert all("B 0.001 and g 1.8" in text for text in found)


@pytest.mark.long
def test_the_command_line_shows_it(tmp_path: Path) -> None:
    """One line on stderr, without the place in the source."""
    text = """<scene version="3.0.0"><emitter type="collimated"><float name="radius" value="1"/></emitter>
      <shape type="asphere" id="wall"><float name="semi_diameter" value="1"/>
        <bsdf type="interface"><float name="R" value="0.9"/><bsdf type="abg"><float name="A" value="1e-4"/>
          <float name="B" value="1e-3"/><float name="g" value="1.8"/></bsdf></bsdf>
        <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor></shape></scene>"""
    file = tmp_path / "wall.xml"
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mistray", "view", str(file), "--out", str(tmp_path / "view")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    lines = [line for line in done.stderr.splitlines() if "warning" in line]
    assert len(lines) == 1
    assert lines[0].startswith("mistray: warning: surface 'wall': ABg")

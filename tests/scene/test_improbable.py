"""Improbable scatter is named when a scene is loaded, and the shipped scenes have none."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write

import mistray
from mistray.errors import MistrayWarning
from mistray.scene.improbable import improbable
from mistray.scene.load import shipped_scenes


def scene(*models: dict[str, Any]) -> dict[str, Any]:
    """A stack of mirrors, each with a model of scatter."""
    ring = {"type": "frustum", "r0": 1.0, "r1": 2.0}
    mirrors = {
        f"mirror_{k}": ring | {"z0": 10.0 * k, "z1": 10.0 * k, "bsdf": {"type": "interface", "R": 0.9, "model": model}}
        for k, model in enumerate(models, start=1)
    }
    return {"type": "scene", **mirrors}


def told(given: dict[str, Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        mistray.load(given)
    assert all(item.category is MistrayWarning for item in found)
    assert all(item.filename == __file__ for item in found), "the warning points at who loads"
    return [str(item.message) for item in found]


def test_names_surface_value_and_range() -> None:
    polish = {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 1.8}
    harvey = {"type": "harvey_shack", "b0": 0.1, "l": 0.3, "s": -1.5}
    others = {"A": 1e-6, "B": 1e-8, "g": 2.5}, {"A": 1.0, "B": 1e-8, "g": 2.0, "relative_to": "incident"}
    found = told(scene(polish, {"type": "abg", **others[0]}, harvey, {"type": "abg", **others[1]}))
    expected = (
        ("'mirror_1'", "0.001", "1.8", "1e-10 … 1e-6"),
        ("'mirror_3'", "l 0.3", "1e-4 … 1e-2"),
        ("'mirror_4'", "57.9"),
    )
    for text, parts in zip(found, expected, strict=True):
        assert all(part in text for part in parts), text
        assert "\n" not in text
    (text,) = told({"polish": polish, **scene(*[{"type": "ref", "id": "polish"}] * 5)})
    assert "and 2 more" in text


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_probable(name: str) -> None:
    """But for one, whose A, B and g are those that the webinar plots, outside of what it calls typical."""
    found = improbable(mistray.load(name))
    assert len(found) == (name == "plate_and_wall")
    assert all("B 0.001 and g 1.8" in text for text in found)


@pytest.mark.long
def test_the_command_line_shows_it(tmp_path: Path) -> None:
    values = "".join(f'<float name="{name}" value="{x}"/>' for name, x in (("A", 1e-4), ("B", 1e-3), ("g", 1.8)))
    abg = f'<bsdf type="abg">{values}</bsdf>'
    wall = interface_xml(R=0.9).replace("</bsdf>", f"{abg}</bsdf>")
    file = write(tmp_path, scene_text(shape_xml("asphere", "wall", 9.0, wall, sensor=True, semi_diameter=1.0)))
    command = [sys.executable, "-m", "mistray", "view", str(file), "--out", str(tmp_path / "view")]
    err = subprocess.run(command, capture_output=True, text=True, timeout=120).stderr
    lines = [line for line in err.splitlines() if "warning" in line]
    assert len(lines) == 1
    assert lines[0].startswith("mistray: warning: surface 'wall': ABg")

"""The worked example of the phone camera's barrel: its study fits the scene, and its walls stay joined."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.analyses.optimize.study.variables import find_variables
from mistray.optimize import parameters, read_study

STUDY = Path(__file__).parents[3] / "examples" / "phone_barrel.toml"
# Ends of walls that meet at the start: the cone behind the stop, the wall of the stop and what stands around it
JOINTS = (
    ("stop_rear.r1", "barrel_1_cone.r0"),
    ("stop_front.r1", "stop_wall.r0"),
    ("barrel_0_plane.r1", "stop_front.r0"),
    ("barrel_1_plane.r1", "barrel_0_plane.r0"),
)
START_MM = {"cone": 1.2667, "stop wall": -0.075}  # of the scene


@pytest.mark.parametrize("change_mm", [0.0, 0.05])
def test_walls_stay_joined(change_mm: float) -> None:
    scene = mistray.load("phone_camera_scatter")
    known = parameters(scene)
    variables = find_variables(read_study(STUDY), mi.traverse(scene), known, {})
    assert dict(zip(variables.names, variables.start, strict=True)) == pytest.approx(START_MM, abs=1e-6)
    moved = variables.parameters(np.asarray(variables.start) + change_mm)
    values = {key: parameter.value for key, parameter in known.items()} | moved
    for one, other in JOINTS:
        assert values[one] == pytest.approx(values[other], abs=1e-5), (one, other)
    assert values["barrel_1_cone.r0"] == pytest.approx(START_MM["cone"] + change_mm, abs=1e-5)
    front = values["stop_wall.z0"]
    assert front == pytest.approx(START_MM["stop wall"] + change_mm, abs=1e-5)
    for name in ("stop_front", "barrel_0_plane", "barrel_1_plane"):
        at = values[f"{name}.z"] - known[f"{name}.z"].value + START_MM["stop wall"]
        assert at == pytest.approx(front, abs=1e-5), name
    assert values["barrel_0_cone.z1"] == pytest.approx(front, abs=1e-5)

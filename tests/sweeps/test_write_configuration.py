"""A configuration as a file: loaded again, it is the scene that a sweep traces."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds

import mistray
from mistray.sweeps import Configuration, write_configuration

NAMED = (("far", 3), ("near", 1))


def numbers(scene) -> dict[str, np.ndarray]:
    params = mi.traverse(scene)
    keys = [key for key in list(params.keys()) if key.rpartition(".")[2] in ("x", "y", "z")]
    return {key: np.array(params[key]).ravel() for key in keys}


@pytest.mark.parametrize(
    ("scene", "key", "step"), [("baffle_tube", "tube_vane_3.z", 2.0), ("cooke_triplet", "L2.y", -0.25)]
)
def test_a_move(tmp_path, scene: str, key: str, step: float) -> None:
    """One surface, and a lens as a body: all its surfaces and edges go the same way, nothing else does."""
    before = numbers(mistray.load(scene))
    file = write_configuration(scene, Configuration("moved", {key: step}), tmp_path / "moved.xml")
    after = numbers(mistray.load(file))
    assert before.keys() == after.keys()
    part, _, axis = key.rpartition(".")
    moved = {name for name in before if not np.array_equal(before[name], after[name])}
    own = {name for name in before if name.startswith((f"{part}.", f"{part}_")) and name.endswith(f".{axis}")}
    assert moved == own
    for name in moved:
        np.testing.assert_allclose(after[name] - before[name], step, atol=1e-5)


def test_paint_and_a_value_from_the_shell(capsys, tmp_path) -> None:
    file = tmp_path / "edited.xml"
    edit = ("--set", "tube_vane_3.z=1.5", "--paint", "tube_vane_2=R=0.3")
    assert str(file) in succeeds(capsys, "sweep", "baffle_tube", *edit, "--write-scene", file)
    shapes = {shape.id(): shape for shape in mistray.load(file).shapes()}
    assert float(shapes["tube_vane_2"].bsdf().coating.R) == pytest.approx(0.3)
    assert numbers(mistray.load(file))["tube_vane_3.z"] == pytest.approx(1.5)


def test_one_of_a_study(capsys, tmp_path) -> None:
    study = tmp_path / "states.toml"
    far, near = (f'[[configuration]]\nname = "{n}"\nvalues = {{ "tube_vane_3.z" = {z} }}\n' for n, z in NAMED)
    study.write_text(far + near, encoding="utf-8")
    command = ["sweep", "baffle_tube", study, "--write-scene", tmp_path / "far.xml"]
    assert "did you mean 'far'?" in fails(capsys, *command, "--configuration", "farr")
    assert "writes one configuration" in fails(capsys, *command)
    assert "--rays has no effect with --write-scene" in fails(capsys, *command, "--rays", 5)
    assert not (tmp_path / "far.xml").exists()
    succeeds(capsys, *command, "--configuration", "far")
    assert numbers(mistray.load(tmp_path / "far.xml"))["tube_vane_3.z"] == pytest.approx(3)

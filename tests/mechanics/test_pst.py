"""A tube with vanes from a STEP file and the same tube typed as frusta: one point source transmittance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import make_step

import mistray
from mistray.mechanics import Mechanics, read_mechanics
from mistray.prescription import Coating, MeshStructure, Scatter, Structure
from mistray.prescription.model import Placed

DATA = Path(__file__).parents[1] / "data"
ANGLES_DEG = (20.0, 30.0, 40.0, 50.0)
RAYS = 1_500_000
CLASSES = ("single_scatter", "multiple_scatter")
# A chamber behind the tube: light that leaves the paint for elsewhere must not come around the tube.
END_Z, DETECTOR_Z, INNER, DETECTOR_RADIUS = 80.0, 95.0, 20.0, 8.0


def scene(tube: tuple[Any, ...]) -> Any:
    """The tube before a chamber with the detector in its rear wall."""
    chamber = Structure("chamber", INNER, END_Z, INNER, DETECTOR_Z)
    board = Structure("board", DETECTOR_RADIUS, DETECTOR_Z, INNER, DETECTOR_Z)
    detector = mistray.Detector(z=DETECTOR_Z, semi_diameter=DETECTOR_RADIUS, pixels=(8, 8))
    parts = {"surfaces": (), "structures": (*tube, chamber, board), "detector": detector}
    return mistray.Prescription(name="tube", source=mistray.Source(radius=INNER), **parts).to_scene()


def pst(tube: tuple[Any, ...], seed: int, rays: int = RAYS) -> Any:
    options = {"max_scatters": 2, "max_reflections": 0, "cell_deg": 4.0, "paths": False}
    return mistray.pst(scene(tube), ANGLES_DEG, rays=rays, seed=seed, **options)


def apart(a: Any, b: Any) -> np.ndarray:
    """Difference in its standard errors: light scattered once, more than once, and both, at each angle."""
    pairs = [(*a.curve(classes), *b.curve(classes)) for classes in (*CLASSES, CLASSES)]
    return np.array([np.abs(x - y) / np.maximum(np.hypot(x_se, y_se), 1e-30) for x, x_se, y, y_se in pairs])


@pytest.fixture(scope="module")
def typed() -> Any:
    """The profile as frusta, from its numbers."""
    profile = make_step.vane_tube_profile()
    sides = zip(profile, [*profile[1:], profile[0]], strict=True)
    paint = (Scatter("paint", {"reflectance": 0.1}, name="tube_paint"),)
    more = {"coating": Coating(R=0.0), "scatter": paint, "part": "tube"}
    return pst(tuple(Structure(f"side_{k}", *a, *b, **more) for k, (a, b) in enumerate(sides)), seed=1)


@pytest.fixture(scope="module")
def drawn() -> Mechanics:
    return read_mechanics(DATA / "vane_tube.step")


def outside(tube: Mechanics, folder: Path) -> tuple[Any, ...]:
    """Painted on the outside alone: light meets no other side, unless normals are wrong."""
    return tube.painted({"vane*": "paint reflectance=0.1 side=back"}).structures(folder)


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "kinds", "seed"), [({}, {Structure}, 2), ({"most_analytic": 0}, {MeshStructure}, 3)]
)
def test_exact_surfaces_and_meshes(
    typed: Any, drawn: Mechanics, tmp_path: Path, changes: dict[str, int], kinds: set[type], seed: int
) -> None:
    tube = outside(replace(drawn, **changes), tmp_path)
    assert {type(shape) for shape in tube} == kinds
    assert np.all(apart(pst(tube, seed=seed), typed) < 3)


@pytest.mark.long
def test_paint_inside_of_the_body_is_dark(typed: Any, drawn: Mechanics, tmp_path: Path) -> None:
    tube = drawn.painted({"vane*": "paint reflectance=0.1 side=front"}).structures(tmp_path)
    assert np.all(pst(tube, seed=5, rays=RAYS // 10).stray == 0)
    assert np.all(typed.stray > 0)


@pytest.mark.long
def test_the_comparison_can_fail(typed: Any, drawn: Mechanics, tmp_path: Path) -> None:
    """The tube 4 mm further in front: a unit or a place that is wrong would show."""
    value, error = typed.curve("multiple_scatter")
    assert np.all(error < 0.1 * value)
    there = Placed(z=-4.0).to_world()
    tube = outside(replace(drawn, parts=tuple(part.moved(there) for part in drawn.parts)), tmp_path)
    assert apart(pst(tube, seed=4), typed).max() > 3

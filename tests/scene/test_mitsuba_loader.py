"""Scenes by Mitsuba's own loaders with their defaults, which merge meshes: surfaces of mistray stay what they are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray import Metric, MistrayError

T = mi.ScalarTransform4f
WALL = {"type": "interface", "R": 0.1}
PIXELS = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}


def lens(**others: Any) -> dict[str, Any]:
    """A plano-convex lens of f = 100 mm and its detector."""
    glass = {"type": "interface", "front": "air", "back": "1.5"}
    back = {"type": "interface", "front": "1.5", "back": "air"}
    return {
        "type": "scene",
        "front": {"type": "asphere", "radius": 50.0, "semi_diameter": 10.0, "bsdf": glass},
        "rear": {"type": "asphere", "semi_diameter": 10.0, "z": 4.0, "bsdf": back},
        "detector": {
            "type": "asphere", "semi_diameter": 5.0, "z": 101.3, "bsdf": {"type": "interface", "R": 0.0},
            "sensor": {"type": "irradiancemeter", "film": PIXELS},
        },
        "beam": {"type": "collimated", "radius": 5.0, "to_world": T().translate([0, 0, -20]), "wavelength_nm": "550"},
        **others,
    }  # fmt: skip


def test_parts_from_cad_keep_their_names_and_parts(tmp_path: Path) -> None:
    """Two meshes of one paint in one object: they would be one shape without a name."""
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    file = tmp_path / "sheet.ply"
    file.write_text(
        f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n0 9 0\n3 0 1 2\n"
    )
    mesh = {"type": "part_mesh", "filename": str(file), "part": "mount", "bsdf": {"type": "ref", "id": "black"}}
    far = mesh | {"to_world": T().translate([0, 0, 500])}
    scene = mi.load_dict({"type": "scene", "black": WALL, "a": mesh, "b": far})
    assert {(shape.id(), shape.part) for shape in scene.shapes()} == {("a", "mount"), ("b", "mount")}


def test_exact_surfaces_beside_stock_meshes_are_traced_as_they_are() -> None:
    """Two boxes of one paint are merged, and the lens is not: its image is as sharp as without merging, ray by ray."""
    boxes = {f"box_{x}": {"type": "cube", "to_world": T().translate([x, 0, 50]), "bsdf": WALL} for x in (-30, 30)}
    images = []
    for optimize in (False, True):
        scene = mi.load_dict(lens(**boxes), optimize=optimize)
        assert {"front", "rear", "detector"} <= {shape.id() for shape in scene.shapes()}
        assert len(scene.shapes()) == (4 if optimize else 5)
        t = mistray.trace(scene, rays=2000, max_scatters=0)
        images.append((t.paths[0].power_W, t.paths[0].rms_radius_mm))
    assert images[1] == pytest.approx(images[0], rel=1e-6)
    assert images[0][1] < 0.05  # mm; a lens of facets spreads its light over more than a millimetre


def test_renders_and_gradients_of_a_scene_by_load_dict() -> None:
    """The image of `straylight` is the trace's, and its derivative by a curvature is that of the scene as given."""
    integrator = {"type": "straylight", "rays": 2000, "max_scatters": 0}
    found = []
    for optimize in (False, True):
        scene = mi.load_dict(lens(integrator=integrator), optimize=optimize)
        metric = Metric(scene, lambda seen: seen[0].power("direct"), settings={"rays": 2000})
        gradient = mistray.gradient(metric, mi.traverse(scene), ["front.curvature"])
        found.append((float(np.sum(mi.render(scene))), float(gradient.gradient["front.curvature"][0])))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_equal_sensors_of_two_detectors_are_refused_by_name() -> None:
    """Mitsuba takes equal sensors for one, which cannot belong to two shapes; as given, they are two."""
    second = lens()["detector"] | {"z": 150.0}
    with pytest.raises(RuntimeError, match=r"shape '(detector|second)': its sensor .*optimize=False") as caught:
        mi.load_dict(lens(second=second))
    assert MistrayError.__name__ in str(caught.value)
    assert len(mi.load_dict(lens(second=second), optimize=False).sensors()) == 2


def test_the_folder_of_plugins_registers_them_by_itself(tmp_path: Path) -> None:
    program = (
        "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import plugins;"
        "print(type(mi.load_dict({'type': 'asphere', 'semi_diameter': 5.0, 'bsdf': {'type': 'interface'}})).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["Asphere"]

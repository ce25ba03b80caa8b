"""The design path of scenes, and rays in float64 against the oracles' intersections."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lit_detector import lit, square
from oracles.nonsequential import nearest_hits
from oracles.scene_xml import read_scene
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.events import EVENT_BITS
from mistray.physics.sags.terms import sag
from mistray.sampling.design.search import design_sequences
from mistray.sampling.design_path import find_design_path, first_aperture
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.surfaces import SurfaceTable

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*/scene.xml"))
IDS = [path.parent.name for path in SCENES]


@pytest.mark.parametrize("path", SCENES, ids=IDS)
def test_design_paths_of_the_scenes(path):
    prescription = importlib.import_module(f"mistray.scenes.{path.parent.name}.prescription").build()
    scene = mistray.load(path)
    table = SurfaceTable(scene, 550.0)
    found = find_design_path(table, scene)
    if path.parent.name == "segmented_mirror":  # there is no segment in the middle, and no one order of surfaces
        assert found is None
        return
    surfaces = {surface.name: surface for surface in (*prescription.surfaces, prescription.detector)}
    met = [table.ids[step.surface] for step in found.steps]
    assert list(dict.fromkeys(met)) == list(surfaces)
    beside = prescription.source.y != 0  # the light starts beside the axis
    assert len(met) == len(surfaces) or beside
    for name, step in zip(met, found.steps, strict=True):
        surface = surfaces[name]
        assert step.reflects == surface.mirror
        x, y, z = np.linalg.inv(surface.to_world())[:3] @ [*step.point, 1.0]
        assert sag(x, y, surface.sag_numbers) == pytest.approx(z, abs=1e-4)
        if surface.outline is not None:  # a piece beside the vertex
            assert surface.outline.contains(x, y)
        elif beside:
            assert np.hypot(x, y) < surface.outer_radius
        elif any(other.outline is not None for other in surfaces.values()):  # the middle is that of the beam
            assert np.hypot(x, y) < 0.02 * surface.outer_radius
        else:  # those that are aligned as measured stand a little beside the axis
            aside = 0.0 if surface.coaxial else 5e-3 * surface.outer_radius
            assert np.hypot(x, y) < 1e-9 * (1 + abs(surface.z)) + aside
        assert abs(np.linalg.norm(step.before) - 1) < 1e-12


@pytest.mark.parametrize("path", SCENES, ids=IDS)
def test_first_hits_are_those_of_the_oracle(path):
    """Rays from anywhere to anywhere; one in 100 may graze a rim, or meet an asphere where Newton finds another hit."""
    scene = mistray.load(path)
    table, model = SurfaceTable(scene, 550.0), read_scene(path)
    rng = np.random.default_rng(1)
    low, high = np.array(scene.bbox().min), np.array(scene.bbox().max)
    o, ends = low + (high - low) * rng.random((2, 400, 3))
    d = (ends - o) / np.linalg.norm(ends - o, axis=1, keepdims=True)
    surface, p, normal = first_hit(table, o, d, np.full(len(o), -1))
    t, number = nearest_hits(model, o, d, np.full(len(o), -1))
    names = np.array([*table.ids, "-"])[surface]
    expected = np.array([*(shape.shape_id for shape in model.shapes), "-"])[number]
    hit = surface >= 0
    far = np.zeros(len(o))
    far[hit] = np.linalg.norm(p[hit] - (o + t[:, None] * d)[hit], axis=1)
    same = (names == expected) & ~(far > 1e-8 * np.max(high - low))
    assert np.mean(same) > 0.99
    for shape in model.shapes:
        here = same & hit & (expected == shape.shape_id)
        if here.any():
            np.testing.assert_allclose(normal[here], shape.normal(p[here]), atol=1e-6)


def test_total_reflection_is_part_of_the_path():
    glass, after = {"type": "interface", "back": "1.5"}, {"type": "interface", "front": "1.5"}
    shapes = {
        "front": {"half_width": 4.0, "half_height": 4.0, "bsdf": glass},
        "slope": {"half_width": 9.0, "half_height": 9.0, "z": 5.0, "tilt_x": -45.0, "bsdf": after},
        "side": {"half_width": 4.0, "half_height": 4.0, "y": -5.0, "z": 5.0, "tilt_x": -90.0, "bsdf": glass},
    }
    meter = square(9.0, y=-20.0, z=5.0, tilt_x=90.0)
    planes = {name: {"type": "asphere", **shape} for name, shape in shapes.items()}
    scene = lit({"type": "collimated", "radius": 1.0}, **planes, detector=meter)
    table = SurfaceTable(scene, 550.0)
    path = find_design_path(table, scene)
    assert [table.ids[step.surface] for step in path.steps] == ["front", "slope", "side", "detector"]
    assert [step.reflects for step in path.steps] == [False, True, False, False]


@pytest.mark.parametrize("radius", [0.01, 150.0, 1e5])
def test_the_path_does_not_depend_on_the_size_of_the_beam(radius):
    """Beams that the lens takes next to nothing of, and that pass it by on all sides on their way to the detector."""
    prescription = importlib.import_module("mistray.scenes.cooke_triplet.prescription").build()
    scene = replace(prescription, source=replace(prescription.source, radius=radius)).to_scene()
    table = SurfaceTable(scene, 550.0)
    names = [surface.name for surface in (*prescription.surfaces, prescription.detector)]
    path = find_design_path(table, scene)
    assert path is not None
    assert [table.ids[step.surface] for step in path.steps] == names
    (sequences,) = design_sequences(scene, table).lists.values()
    assert [[table.ids[code >> EVENT_BITS] for code in one] for one in sequences] == [names[:-1]]


@pytest.mark.parametrize(
    ("inside", "radius", "aimed"),
    [("1.0 scatter=0.002 g=0.8", 0.0, "lens"), ("N-BK7", 0.0, "lens"), ("N-BK7", 300.0, "front")],
)
def test_light_is_aimed_at_the_lens_behind_a_large_front(load_scene, inside: str, radius: float, aimed: str) -> None:
    scene = load_scene(
        scene_text(
            shape_xml("asphere", "front", -50.0, interface_xml("air", inside), semi_diameter=60.0, radius=radius),
            shape_xml("asphere", "behind", -20.0, interface_xml(inside, "air"), semi_diameter=60.0, radius=radius),
            shape_xml("asphere", "lens", 0.0, interface_xml("air", "N-BK7"), semi_diameter=6.0, radius=30.0),
            shape_xml("asphere", "rear", 4.0, interface_xml("N-BK7", "air"), semi_diameter=6.0),
            shape_xml("asphere", "detector", 50.0, sensor=True, semi_diameter=6.0),
            radius=5.0,
            distance=80.0,
        )
    )
    sphere = first_aperture(SurfaceTable(scene, 550.0), scene)
    assert sphere is not None
    assert sphere.radius == pytest.approx({"lens": 6.0, "front": 60.0}[aimed], rel=1e-6)

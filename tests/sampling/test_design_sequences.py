"""What is direct light: sequences and paths of the design of scenes, and their first hits beside the oracle."""

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lit_detector import lit, square
from oracles.nonsequential import nearest_hits
from oracles.scene_xml import read_scene
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray import Coating, Detector, MistrayError, Prescription, Source, Structure, Surface, Trace
from mistray.events import EVENT_BITS
from mistray.physics.sags.terms import sag
from mistray.prescription import beam_splitter_cube, moved_as_one, prism
from mistray.sampling.design.search import design_sequences
from mistray.sampling.design_path import find_design_path, first_aperture
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.surfaces import SurfaceTable

BLACK = Coating(R=0.0)
LENS = (
    Surface("front", radius=51.7, z=-12.0, semi_diameter=9.0, back="N-BK7"),
    Surface("rear", z=-8.0, semi_diameter=9.0, front="N-BK7"),
)
ACROSS: dict[str, Any] = {"tilt_deg": (90.0, 0.0, 0.0), "half_width": 12.0, "half_height": 12.0}


def system(surfaces: tuple[Surface, ...], *detectors: Detector, radius: float = 4.0, **more: Any) -> Prescription:
    more |= {"detector": detectors[0], "more_detectors": detectors[1:], "source": Source(radius=radius, z=-60.0)}
    return Prescription(name="system", surfaces=surfaces, **more)


def traced(surfaces: tuple[Surface, ...], *detectors: Detector, field_deg: float = 0.0, **more: Any) -> Trace:
    scene = system(surfaces, *detectors, **more).to_scene()
    return mistray.trace(scene, rays=2000, max_reflections=2, field_deg=field_deg)


def kinds(t: Trace) -> dict[str, str]:
    return {" ".join(row.events.split()[:-1]): row.kind for row in t.paths}


def share(t: Trace, kind: str) -> float:
    return sum(row.power_W for row in t.paths if row.kind == kind) / sum(row.power_W for row in t.paths)


def cassegrain(filtered: bool) -> Prescription:
    """f/5 Cassegrain of 1 m with an open hole, and a plane filter before the detector or none."""
    d, s1, s2 = 700.0, 300.0, 800.0
    mirror: dict[str, Any] = {"coating": Coating(R=1.0), "mirror": True}
    conic = -(((s2 / s1 + 1) / (s2 / s1 - 1)) ** 2)
    surfaces = [
        Surface("primary", radius=-2000.0, conic=-1.0, semi_diameter=100, inner_semi_diameter=20, **mirror),
        Surface("secondary", z=-d, radius=-2 / (1 / s1 - 1 / s2), conic=conic, semi_diameter=32, **mirror),
    ]
    if filtered:
        surfaces += [
            Surface("filter_front", z=60, semi_diameter=25, back="N-BK7"),
            Surface("filter_rear", z=63, semi_diameter=25, front="N-BK7"),
        ]
    walls = (
        Structure("tube", 110.0, -900.0, 110.0, 5.0, coating=BLACK),
        Structure("rear_wall", 110.0, 5.0, 25.0, 5.0, coating=BLACK),
        Structure("rear_tube", 25.0, 5.0, 25.0, 110.0, coating=BLACK),
    )
    parts: dict[str, Any] = {"surfaces": tuple(surfaces), "structures": walls, "source": Source(radius=100, z=-950)}
    return Prescription(name="cassegrain", detector=Detector(z=101, half_width=10, half_height=10), **parts)


@pytest.mark.parametrize("filtered", [False, True])
def test_light_through_the_hole_of_a_cassegrain_is_a_straight_shot(filtered: bool) -> None:
    """At 5° a geometric Monte Carlo of the open hole has a PST of 0.958 ± 1 %; a filter passes 0.92 of it."""
    scene = cassegrain(filtered).to_scene()
    found = mistray.pst(scene, [5.0], rays=20_000, max_reflections=2)
    (direct, _), (shot, _) = (found.curve(name) for name in ("direct", "straight_shot"))
    assert direct[0] == 0
    forward = mistray.pst(scene, [5.0], method="forward", rays=2000, max_reflections=2)  # the same classes
    assert forward.curve("direct")[0][0] == 0 < forward.curve("straight_shot")[0][0]
    assert shot[0] == pytest.approx(0.958 * (0.92 if filtered else 1.0), rel=0.05)
    assert {row.kind for row in mistray.trace(scene, rays=5000, field_deg=5.0).paths} <= {"straight shot", "ghost"}
    assert share(mistray.trace(scene, rays=2000), "direct") > 0.98


def test_design_paths_through_cubes_roofs_and_mirrors() -> None:
    """Of a Michelson interferometer one mirror is declared, the other only shines."""
    cube = beam_splitter_cube("cube", 20.0, material="N-BK7", splitter=Coating(R=0.48, T=0.48))
    camera = Detector("camera", z=60.0, half_width=8.0, half_height=8.0)
    t = traced(cube, camera, Detector("monitor", y=60.0, **ACROSS))
    assert {row.detector for row in t.paths if row.kind == "direct"} == {"camera", "monitor"}
    (image,) = (row for row in t.paths if row.detector == "monitor" and row.kind == "direct")
    assert (image.order, image.ghost_1) == (0, "-")
    assert share(t.on("monitor"), "direct") > 0.95
    assert t.paths.select("G(cube_splitter) & kind = direct") == []
    half = Coating(R=0.5, T=0.5)
    splitter = Surface("splitter", tilt_deg=(45.0, 0, 0), half_width=20.0, half_height=20.0, coating=half)
    ahead = Surface("ahead", z=50.0, semi_diameter=12.0, coating=Coating(R=0.95))
    aside = Surface("aside", y=50.0, tilt_deg=(90.0, 0, 0), semi_diameter=12.0, coating=Coating(R=0.95), mirror=True)
    t = traced((splitter, ahead, aside), Detector("screen", y=-50.0, **ACROSS))
    assert kinds(t) == {"splitter:R aside:R splitter:T": "direct", "splitter:T ahead:R splitter:R": "direct"}
    bounds = {"half_width": 12.0, "half_height": 11.0, "coating": Coating(R=0.9), "mirror": True}
    faces = [Surface(f"face_{k}", y=8 * s, z=-8, tilt_deg=(-45 * s, 0, 0), **bounds) for k, s in enumerate((1.0, -1.0))]
    aside = Detector("camera", x=-60.0, tilt_deg=(0.0, 90.0, 0.0), half_width=15.0, half_height=15.0)
    t = traced(tuple(moved_as_one(faces, tilt_deg=(0.0, 45.0, 0.0))), aside, radius=5.0)
    assert kinds(t) == {"face_0:R face_1:R": "direct", "face_1:R face_0:R": "direct"}
    assert [row.kind for row in mistray.trace(mistray.load("segmented_mirror"), rays=20_000).paths] == ["direct"] * 18
    faces = prism("prism", [(-10.0, 0.0), (10.0, 0.0), (-10.0, 20.0)], 20.0, material="N-BK7")
    t = traced(LENS + faces, Detector("camera", y=-90.0, z=10.0, **ACROSS))
    assert (share(t, "direct"), share(t, "TIR")) == (pytest.approx(0.993, abs=0.002), 0)
    assert t.paths[0].tir == 1
    # Its reflection counts neither as a ghost nor as one of `max_reflections`; a dark one is no mirror
    camera = Detector("camera", y=-70.0, z=20.0, **ACROSS)
    fold = {"z": 20.0, "tilt_deg": (-45.0, 0.0, 0.0), "semi_diameter": 15.0}
    bright = traced((*LENS, Surface("fold", **fold, coating=Coating(R=0.9))), camera)
    assert kinds(bright) == kinds(traced((*LENS, Surface("fold", **fold, coating=Coating(R=0.9), mirror=True)), camera))
    assert share(bright, "direct") > 0.95
    assert "ghost" in kinds(bright).values()
    assert share(traced((*LENS, Surface("fold", **fold, back="Al")), camera), "direct") > 0.95
    dark = traced((*LENS, Surface("fold", **fold, coating=Coating(R=0.3))), camera)
    assert share(dark, "direct") == 0
    assert any("front:T rear:T fold:R" in note for note in dark.notes)


@pytest.mark.parametrize("field", [0.0, 10.0])
def test_a_shiny_tube_without_optics_has_no_direct_light(field: float) -> None:
    tube = Structure("tube", 10.0, -50.0, 10.0, 50.0, coating=Coating(R=0.9))
    t = traced((), Detector(z=51.0, half_width=12.0, half_height=12.0), structures=(tube,), radius=9.0, field_deg=field)
    assert share(t, "direct") == 0
    assert any("tube:R" in note for note in t.notes) == (field > 0)


def test_filters_over_parts_of_a_beam() -> None:
    """Strips are alternatives, a filter over half of the beam may be missed, and the gap between strips is a leak."""

    def strip(name: str, x: float, half: float, **coated: Any) -> tuple[Surface, Surface]:
        bounds = {"x": x, "half_width": half, "half_height": 9.0}
        return (
            Surface(f"{name}_a", z=-30.0, back="N-BK7", **bounds, **coated),
            Surface(f"{name}_b", z=-28.0, front="N-BK7", **bounds),
        )

    screen = Detector("screen", z=88.0, half_width=6.0, half_height=6.0)
    left, right = strip("left", -4.0, 3.9), strip("right", 4.0, 3.9, coating=Coating(R=0.05, T=0.9))
    both = kinds(traced(left + right + LENS, screen, radius=6.0))
    assert both["left_a:T left_b:T front:T rear:T"] == both["right_a:T right_b:T front:T rear:T"] == "direct"
    assert both["front:T rear:T"] == "straight shot"
    half = kinds(traced(left + LENS, screen, radius=6.0))
    assert half["left_a:T left_b:T front:T rear:T"] == half["front:T rear:T"] == "direct"


def test_light_around_a_small_lens_is_a_straight_shot_unless_declared(tmp_path) -> None:
    window = (
        Surface("window_a", z=70.0, half_width=25.0, half_height=25.0, back="N-BK7"),
        Surface("window_b", z=72.0, half_width=25.0, half_height=25.0, front="N-BK7"),
    )
    screen = {"z": 88.0, "half_width": 24.0, "half_height": 24.0}
    found = kinds(traced(LENS + window, Detector("screen", **screen), radius=20.0))
    assert found["window_a:T window_b:T"] == "straight shot"
    assert found["front:T rear:T window_a:T window_b:T"] == "direct"
    other = Detector("screen", **screen, design_path="window_a:T window_b:T")
    stated = system(LENS + window, other, radius=20.0)
    stated.to_xml(tmp_path / "scene.xml")  # a declaration survives the file
    for scene in (stated.to_scene(), mistray.load(tmp_path / "scene.xml")):
        declared = kinds(mistray.trace(scene, rays=2000, max_reflections=2))
        assert declared["window_a:T window_b:T"] == "direct"
        assert declared["front:T rear:T window_a:T window_b:T"] == "straight shot"


@pytest.mark.parametrize(
    ("text", "part"),
    [("front:T lens_9:T", "lens_9"), ("front:T rear", "rear"), ("front:T rear:t", ":t"), ("front|lens_9:T", "lens_9")],
)
def test_a_wrong_declaration_is_refused(text: str, part: str) -> None:
    with pytest.raises(MistrayError, match=f"camera.*{part}"):
        traced(LENS, Detector("camera", z=88.0, half_width=6.0, half_height=6.0, design_path=text))


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
    low, high = np.array(scene.bbox().min), np.array(scene.bbox().max)
    o, ends = low + (high - low) * np.random.default_rng(1).random((2, 400, 3))
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
    planes = {name: {"type": "asphere", **shape} for name, shape in shapes.items()}
    scene = lit({"type": "collimated", "radius": 1.0}, **planes, detector=square(9.0, y=-20.0, z=5.0, tilt_x=90.0))
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
    shapes = (
        shape_xml("asphere", "front", -50.0, interface_xml("air", inside), semi_diameter=60.0, radius=radius),
        shape_xml("asphere", "behind", -20.0, interface_xml(inside, "air"), semi_diameter=60.0, radius=radius),
        shape_xml("asphere", "lens", 0.0, interface_xml("air", "N-BK7"), semi_diameter=6.0, radius=30.0),
        shape_xml("asphere", "rear", 4.0, interface_xml("N-BK7", "air"), semi_diameter=6.0),
        shape_xml("asphere", "detector", 50.0, sensor=True, semi_diameter=6.0),
    )
    scene = load_scene(scene_text(*shapes, radius=5.0, distance=80.0))
    sphere = first_aperture(SurfaceTable(scene, 550.0), scene)
    assert sphere is not None
    assert sphere.radius == pytest.approx({"lens": 6.0, "front": 60.0}[aimed], rel=1e-6)

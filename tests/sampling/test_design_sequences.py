"""What is direct light: the sequences of the design of systems whose paths are known beforehand."""

from __future__ import annotations

from typing import Any

import pytest

import mistray
from mistray.errors import MistrayError
from mistray.prescription import (
    Coating,
    Detector,
    Prescription,
    Source,
    Structure,
    Surface,
    beam_splitter_cube,
    moved_as_one,
    prism,
)

BLACK = Coating(R=0.0)
LENS = (
    Surface("front", radius=51.7, z=-12.0, semi_diameter=9.0, back="N-BK7"),
    Surface("rear", z=-8.0, semi_diameter=9.0, front="N-BK7"),
)
ACROSS: dict[str, Any] = {"tilt_deg": (90.0, 0.0, 0.0), "half_width": 12.0, "half_height": 12.0}


def traced(
    surfaces: tuple[Surface, ...],
    *detectors: Detector,
    radius: float = 4.0,
    structures: tuple[Structure, ...] = (),
    **settings: Any,
) -> mistray.trace.Trace:
    system = Prescription(
        name="system",
        surfaces=surfaces,
        structures=structures,
        detector=detectors[0],
        more_detectors=detectors[1:],
        source=Source(radius=radius, z=-60.0),
    )
    return mistray.trace(system.to_scene(), **({"rays": 2000, "max_reflections": 2} | settings))


def kinds(t: mistray.trace.Trace) -> dict[str, str]:
    return {" ".join(row.events.split()[:-1]): row.kind for row in t.paths}


def share(t: mistray.trace.Trace, kind: str) -> float:
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
    return Prescription(
        name="cassegrain",
        surfaces=tuple(surfaces),
        structures=(
            Structure("tube", 110.0, -900.0, 110.0, 5.0, coating=BLACK),
            Structure("rear_wall", 110.0, 5.0, 25.0, 5.0, coating=BLACK),
            Structure("rear_tube", 25.0, 5.0, 25.0, 110.0, coating=BLACK),
        ),
        detector=Detector(z=101, half_width=10, half_height=10),
        source=Source(radius=100, z=-950),
    )


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
    t = mistray.trace(scene, rays=5000, field_deg=5.0)
    assert {row.kind for row in t.paths} <= {"straight shot", "ghost"}
    assert share(mistray.trace(scene, rays=2000), "direct") > 0.98


def test_both_arms_of_a_cube_and_of_an_interferometer_are_design_paths() -> None:
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


def test_the_halves_of_a_roof_count_in_either_order() -> None:
    bounds = {"half_width": 12.0, "half_height": 11.0, "coating": Coating(R=0.9), "mirror": True}
    faces = [
        Surface(f"face_{k}", y=8.0 * s, z=-8.0, tilt_deg=(-45.0 * s, 0, 0), **bounds) for k, s in enumerate((1, -1))
    ]
    aside = Detector("camera", x=-60.0, tilt_deg=(0.0, 90.0, 0.0), half_width=15.0, half_height=15.0)
    t = traced(tuple(moved_as_one(faces, tilt_deg=(0.0, 45.0, 0.0))), aside, radius=5.0)
    assert kinds(t) == {"face_0:R face_1:R": "direct", "face_1:R face_0:R": "direct"}


def test_images_by_total_reflection_and_by_every_segment_are_the_image() -> None:
    segments = mistray.trace(mistray.load("segmented_mirror"), rays=20_000).paths
    assert [row.kind for row in segments] == ["direct"] * 18
    faces = prism("prism", [(-10.0, 0.0), (10.0, 0.0), (-10.0, 20.0)], 20.0, material="N-BK7")
    t = traced(LENS + faces, Detector("camera", y=-90.0, z=10.0, **ACROSS))
    assert share(t, "direct") == pytest.approx(0.993, abs=0.002)
    assert share(t, "TIR") == 0
    assert t.paths[0].tir == 1


def test_an_undeclared_fold_mirror_is_a_mirror_where_the_design_is_reflected() -> None:
    """Its reflection counts neither as a ghost nor as one of `max_reflections`; a dark one is no mirror."""
    camera = Detector("camera", y=-70.0, z=20.0, **ACROSS)
    fold = {"z": 20.0, "tilt_deg": (-45.0, 0.0, 0.0), "semi_diameter": 15.0}
    declared = traced((*LENS, Surface("fold", **fold, coating=Coating(R=0.9), mirror=True)), camera)
    bright = traced((*LENS, Surface("fold", **fold, coating=Coating(R=0.9))), camera)
    assert kinds(bright) == kinds(declared)
    assert share(bright, "direct") > 0.95
    assert "ghost" in kinds(bright).values()
    metal = traced((*LENS, Surface("fold", **fold, back="Al")), camera)
    assert share(metal, "direct") > 0.95
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
    system = Prescription(name="system", surfaces=LENS + window, detector=other, source=Source(radius=20.0, z=-60.0))
    system.to_xml(tmp_path / "scene.xml")  # a declaration survives the file
    for scene in (system.to_scene(), mistray.load(tmp_path / "scene.xml")):
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

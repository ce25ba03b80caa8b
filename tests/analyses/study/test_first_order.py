"""First-order numbers and critical rays, against closed forms and a table of paraxial rays."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import fails, succeeds
from oracles.closed_forms import ParaxialSurface, back_focus
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.analyses.export.critical_rays import critical_rays
from mistray.analyses.study.first_order import FirstOrder, first_order
from mistray.sampling.design_path import find_design_path
from mistray.sampling.sources import scene_sources
from mistray.scenes.cooke_triplet.prescription import build as triplet
from mistray.surfaces.surfaces import SurfaceTable


def measured(name: str) -> tuple[FirstOrder, SurfaceTable]:
    scene = mistray.load(name)
    table = SurfaceTable(scene, scene_sources(scene)[0].wavelength_nm)
    path = find_design_path(table, scene)
    assert path is not None
    return first_order(scene, path), table


def marginal_sine(curvature, z, index, height) -> float:
    """Sine of the angle with the axis that a ray parallel to it has behind spheres, by Snell's law in the plane."""
    p, d = np.array([height, -10.0]), np.array([0.0, 1.0])  # y and z
    for k, (c, vertex) in enumerate(zip(curvature, z, strict=True)):
        centre = np.array([0.0, vertex + 1 / c])
        along = (p - centre) @ d
        root = math.sqrt(along**2 - (p - centre) @ (p - centre) + 1 / c**2)
        p = p + (-along - math.copysign(root, c)) * d
        normal = (centre - p) * c
        eta, cosine = index[k] / index[k + 1], float(d @ normal)
        d = eta * d + (math.sqrt(1 - eta**2 * (1 - cosine**2)) - eta * cosine) * normal
    return abs(float(d[0]))


def test_triplet_against_paraxial_rays():
    found, table = measured("cooke_triplet")
    surfaces = triplet().surfaces
    n = table.optics.host_indices[[table.ids.index(s.name) for s in surfaces], :2]
    index = [*n[:, 0], n[-1, 1]]
    focal, back = back_focus(
        [ParaxialSurface(s.z, 1 / s.radius, *index[k : k + 2], 0.0, 1.0) for k, s in enumerate(surfaces)]
    )
    assert found.focal_length_mm == pytest.approx(focal, rel=1e-6)
    assert found.focal_lengths_mm[0] == pytest.approx(found.focal_lengths_mm[1], rel=1e-9)
    assert found.back_focus_mm == pytest.approx(back, rel=1e-6)
    assert found.focal_length_mm / found.pupil_diameter_mm == pytest.approx(4.0, rel=1e-3)
    sine = marginal_sine([1 / s.radius for s in surfaces], [s.z for s in surfaces], index, found.pupil_diameter_mm / 2)
    assert found.f_number == pytest.approx(1 / (2 * sine), rel=1e-5)


def test_thick_lens():
    """R = ±100 mm, 5 mm of n = 1.5168: f = 97.58041 mm by the lensmaker's equation; then a window."""
    found, table = measured("singlet_window_detector")
    n = float(table.optics.host_indices[table.ids.index("L1_front"), 1])
    focal = 1 / ((n - 1) * (2 / 100 - (n - 1) * 5 / (n * 100**2)))
    assert found.focal_length_mm == pytest.approx(focal, rel=1e-7)
    assert abs(found.defocus_mm) < 1e-5
    found, _ = measured("plate")
    assert math.isinf(found.focal_length_mm)
    assert math.isnan(found.defocus_mm)


def test_image_in_glass_and_near_object(load_scene):
    """An ellipsoid of conic -1/n² focuses in its glass at f' = n R/(n - 1); sin u = y/hypot(y, f' - z) at its rim."""
    n, radius, y = 1.4, 20.0, 14.0
    focus = n * radius / (n - 1)
    sag = y * y / radius / (1 + math.sqrt(1 - (1 - 1 / n**2) * (y / radius) ** 2))
    glass = interface_xml("air", "1.4")
    front = shape_xml("asphere", "front", 0.0, glass, radius=radius, conic=-1 / n**2, semi_diameter=y)
    detector = shape_xml("asphere", "detector", focus, sensor=True, half_width=2.0, half_height=2.0)
    scene = load_scene(scene_text(front, detector, radius=20.0))
    path = find_design_path(SurfaceTable(scene, 550.0), scene)
    found = first_order(scene, path)
    assert found.focal_length_mm == pytest.approx(focus, rel=1e-6)
    assert found.f_number == pytest.approx(math.hypot(y, focus - sag) / (2 * n * y), rel=1e-3)
    # Rays of a point 100 mm before the origin: the pupil where they pass it, and fields by the ray through it
    black = {"type": "interface", "R": 0.0}
    stop = {"type": "asphere", "semi_diameter": 40.0, "inner_semi_diameter": 5.0, "z": 10.0, "bsdf": black}
    detector = {"type": "asphere", "half_width": 20.0, "half_height": 15.0, "z": 30.0, "bsdf": black}
    detector["sensor"] = {"type": "irradiancemeter"}
    given = {"type": "scene", "stop": stop, "detector": detector}
    scene = mistray.load(given, "point:0,0,-100")
    found = first_order(scene, find_design_path(SurfaceTable(scene, 550.0), scene))
    assert found.pupil_diameter_mm == pytest.approx(2 * 5 * 100 / 110, rel=1e-3)
    assert found.stop == "stop"
    assert found.field_deg["x"] == pytest.approx(np.degrees(np.arctan(20 / 30)), rel=1e-6)
    assert found.field_deg["y"] == pytest.approx(np.degrees(np.arctan(15 / 30)), rel=1e-6)
    laser = mistray.load(given, "laser:0,0,-100,waist_x=1,waist_y=1")
    with pytest.raises(mistray.MistrayError, match=r"'source'.*point_source"):
        first_order(laser, find_design_path(SurfaceTable(laser, 550.0), laser))


def test_newtonian():
    """A paraboloid: half its radius of curvature; its rim is the stop; the diagonal and its holder obstruct it."""
    found, _ = measured("newtonian")
    assert found.focal_length_mm == pytest.approx(50 * 25.4, rel=1e-7)
    assert found.pupil_diameter_mm == pytest.approx(2 * 95.25, rel=1e-4)
    assert found.stop == "mirror_cell"
    # A paraboloid: y = 2f tan(u/2)
    assert found.f_number == pytest.approx(1 / (2 * math.sin(2 * math.atan(95.25 / 2540))), rel=1e-4)
    # Round detector of half an inch: the base ray meets its edge at atan(h / f) of a mirror
    assert found.field_deg["y"] == pytest.approx(math.degrees(math.atan(12.7 / 1270)), rel=1e-3)
    assert found.field_deg["diagonal"] == found.field_deg["x"]
    # Seen along the axis: the square diagonal with its holder 3 mm behind it, and the eyepiece tube in the beam
    half = 0.6 * 25.4
    diagonal = 2 * half * (2 * half + 3 / math.sqrt(2))
    tube = 25.4 * (95.25 - 3 * 25.4)
    assert found.pupil_area_mm2 == pytest.approx(math.pi * 95.25**2 - diagonal - tube, rel=0.01)


def test_phone_camera():
    """Focal length and chief ray of the float64 trace that scenes/phone_camera/SOURCE.md quotes; the stop's radius."""
    found, _ = measured("phone_camera")
    assert found.focal_length_mm == pytest.approx(7.0734, abs=1e-4)
    assert found.pupil_diameter_mm == pytest.approx(2 * 1.25171162, rel=1e-4)
    assert found.stop == "stop_front"
    assert found.defocus_mm == pytest.approx(-0.335, abs=0.005)
    # The chief ray lands at 2.06523 and 2.18592 mm at 17 and 18° on the d line (docs/validation/phone_camera.md), in
    # proportion to the focal length; the edge of the detector is at 2.18394 mm
    heights = np.array([1.93940, 2.06523, 2.18592]) * 7.0734 / 7.0750
    edge = np.interp(4.36788654 / 2, np.polyval(np.polyfit([16, 17, 18], heights, 2), np.linspace(17, 18.2, 500)),
                     np.linspace(17, 18.2, 500))  # fmt: skip
    assert found.field_deg["y"] == pytest.approx(edge, abs=0.002)


RADIUS, FOCUS = 4.0, 60.0  # of the stop; of the mirror


def test_the_rim_of_a_stop(load_scene: Callable[[str], Any]) -> None:
    """A parabolic mirror behind a stop: rim rays come through its edge, and in the axis all end in the focus."""
    text = scatter_scene(
        beam_xml(9.0),
        placed_xml("asphere", "stop", at=(0, 0, -70.0), semi_diameter=20.0, inner_semi_diameter=RADIUS),
        placed_xml("asphere", "mirror", interface_xml(R=0.9, mirror=True), radius=-2 * FOCUS, conic=-1.0,
                   semi_diameter=20.0),
        placed_xml("asphere", "detector", at=(0, 0, -FOCUS), half_width=0.5, half_height=0.5, pixels=4),
    )  # fmt: skip
    table = critical_rays(load_scene(text), [0.0], rim=4, rays=20_000)
    assert table.name.unique().tolist() == ["centre", "rim 0°", "rim 90°", "rim 180°", "rim 270°"]
    starts = table[table.node == 0].set_index("name")[["x_mm", "y_mm"]]
    expected = {"rim 0°": (1, 0), "rim 90°": (0, 1), "rim 180°": (-1, 0), "rim 270°": (0, -1)}
    for name, (x, y) in expected.items():
        along = starts.loc[name].to_numpy() @ (x, y)
        assert RADIUS * (1 - 3 / 20_000**0.5) < along <= RADIUS
    assert np.linalg.norm(starts.loc["centre"]) < 0.5 * 2**0.5 + 0.1
    ends = table[table.intercept == "Absorbed"]
    np.testing.assert_allclose(ends[["x_mm", "y_mm"]], 0, atol=1e-9)
    assert np.ptp(ends.opl_mm) < 1e-9


@pytest.mark.long
def test_rays_of_fields_and_wavelengths_and_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = mistray.load("cooke_triplet")
    table = critical_rays(scene, [0.0, 8.0], wavelength_nm=[486.1, 656.3], rays=2000)
    assert set(zip(table.field_deg, table.wavelength_nm, strict=True)) == {
        (field, line) for field in (0.0, 8.0) for line in (486.1, 656.3)
    }
    names = table.groupby(["field_deg", "wavelength_nm"]).name.unique()
    assert all(group[0] == "centre" and 5 <= len(group) <= 9 for group in names)
    for _, ray in table.groupby("ray"):
        assert ray.intercept.tolist() == ["Emitted", *["SpecTran"] * 6, "Absorbed"]
        assert ray.node.tolist() == list(range(8))
        d = ray[["dx", "dy", "dz"]].iloc[0].to_numpy(np.float64)
        assert np.degrees(np.arctan2(d[1], d[2])) == pytest.approx(ray.field_deg.iloc[0], abs=1e-6)
    file = tmp_path / "critical.csv"
    record = json.loads(succeeds(capsys, "export", "cooke_triplet", "-o", file, "--field-deg", 0, 5, "--json"))
    with open(file, encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    assert record["rays"] == len({row["ray"] for row in rows})
    assert {float(row["field_deg"]) for row in rows} == set(record["fields_deg"]) == {0.0, 5.0}
    assert "field 80 deg" in fails(capsys, "export", "cooke_triplet", "-o", file, "--force", "--field-deg", 80)
    with pytest.raises(mistray.MistrayError, match="rim is 0"):
        critical_rays(mistray.load("cooke_triplet"), rim=0)

"""The floor of the RMS radius by diffraction, against cones whose aperture is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.analysis.airy import with_airy
from mistray.cli.ghosts_json import as_json
from mistray.report.tables.ghosts import AIRY_TEXT, main_table
from mistray.report.tables.ghosts_csv import path_table
from mistray.trace.light_cones import LightCone

LAMBDA_MM, INDEX, RADIUS = 550e-6, 1.5, 10.0
FOCUS = INDEX * RADIUS / (INDEX - 1)  # mm behind the vertex
FIRST_ZERO = 3.8317059702075125  # of J1


def ellipsoid(half: float, inner: float = 0.0) -> str:
    """A surface into glass of conic constant -1/n² (Descartes), a detector at its focus, its middle covered or not."""
    glass = interface_xml("air", f"{INDEX}", R=0.0, T=1.0)
    shapes = [
        shape_xml("asphere", "front", 0.0, glass, radius=RADIUS, conic=-1 / INDEX**2, semi_diameter=half),
        shape_xml("asphere", "detector", FOCUS, interface_xml(f"{INDEX}", R=0.0), sensor=True, semi_diameter=1.0),
    ]
    if inner:
        shapes.append(shape_xml("asphere", "spot", -1.0, interface_xml(R=0.0), semi_diameter=inner))
    return scene_text(*shapes, radius=half)


def aperture(half: float, inner: float) -> float:
    """√(2 <n² sin²u>) over an evenly lit annulus, by Gauss-Legendre over the squares of the heights."""
    x, weight = np.polynomial.legendre.leggauss(40)
    square = inner**2 + (half**2 - inner**2) * (x + 1) / 2
    sag = square / RADIUS / (1 + np.sqrt(1 - (1 - 1 / INDEX**2) * square / RADIUS**2))
    sine = square / (square + (FOCUS - sag) ** 2)
    return float(INDEX * np.sqrt(2 * np.sum(weight * sine) / 2))


@pytest.mark.parametrize(("half", "inner"), [(1.5, 0.0), (4.0, 2.0)])
def test_airy_radius_of_a_perfect_focus_in_glass(load_scene, half: float, inner: float) -> None:
    """The aperture is n sin u in the glass, within 4 errors (false alarm 6e-5 each) of below 3 %; P/(π r²) follows."""
    report = mistray.ghosts(load_scene(ellipsoid(half, inner)), [0.0], rays=4000, seed=1)
    table = report.table(0.0)
    (cone,) = report[0.0].light_cones(list(table.path_id)).values()
    exact = aperture(half, inner)
    assert cone.aperture_se < 0.03 * exact
    assert abs(cone.aperture - exact) < 4 * cone.aperture_se
    row = report.with_airy(0.0, table).iloc[0]
    expected = FIRST_ZERO / (2 * math.pi) * LAMBDA_MM / exact
    assert row.rms_radius_mm < 0.05 * expected  # the raw value stays
    assert row.airy_radius_mm == pytest.approx(expected, abs=4 * row.airy_radius_se_mm)
    assert row.airy_radius_se_mm / row.airy_radius_mm == pytest.approx(cone.aperture_se / cone.aperture, rel=1e-9)
    assert row.airy_irradiance_W_mm2 == pytest.approx(row.power_W / (math.pi * row.airy_radius_mm**2), rel=1e-12)
    assert row.airy_irradiance_W_mm2 < row.rms_irradiance_W_mm2
    assert list(path_table(report).airy_radius_mm) == [row.airy_radius_mm]


def test_only_radii_below_the_floor_of_a_known_cone_have_one() -> None:
    """Of F/4: 1.22 λN = 2.684 µm; half of it at half of the wavelength. Then cones of few or parallel rays, none."""
    lines, radii = [550, 550, 275, 275, 550, 550, 550], [2.6e-3, 2.7e-3, 1.3e-3, 1.4e-3, 1e-4, 1e-4, 1e-4]
    table = pd.DataFrame({"path_id": range(7), "wavelength_nm": lines, "rms_radius_mm": radii})
    cones = dict.fromkeys(range(4), LightCone(0.125, 0.0025, 99))
    cones |= {4: LightCone(0.125, 0.01, 9), 5: LightCone(0.0, 0.0, 99)}
    found = with_airy(table.assign(power_W=2.0, power_se_W=0.1), cones)
    assert list(found.airy_radius_mm[[0, 2]]) == pytest.approx([2.683274e-3, 1.341637e-3], rel=1e-6)
    names = [name for name in found if str(name).startswith("airy")]
    assert len(names) == 4
    assert found[names].isna().all(axis=1).tolist() == [False, True, False, True, True, True, True]
    row = found.iloc[0]  # errors of cone and power add up
    assert row.airy_radius_se_mm == pytest.approx(0.02 * row.airy_radius_mm)
    assert row.airy_irradiance_se_W_mm2 == pytest.approx(math.hypot(0.05, 0.04) * row.airy_irradiance_W_mm2)


@pytest.mark.long
def test_where_it_is_told() -> None:
    """The ghost between two reflections at the lune of the stop of a camera, and not the others that are listed."""
    report = mistray.ghosts(mistray.load("phone_camera"), [10.0], rays=50_000, contested_rays=0, seed=2)
    listed = report.with_airy(10.0, report.listed(10.0, 4))
    floored = listed[listed.airy_radius_mm.notna()]
    assert 0 < len(floored) < len(listed)
    assert floored.label.str.contains("stop_front").all()
    assert AIRY_TEXT in main_table(report)
    paths = as_json(report)["fields"][0]["worst_paths"]
    assert [path["airy_radius_mm"] is not None for path in paths] == list(listed.airy_radius_mm.notna())

"""The steps of a study, against numbers that are known without it; images of points, or why there are none."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.rough_paraboloid import paraboloid_text
from oracles.scatter_scenes import bsdf_xml

import mistray
from mistray.analyses.study.analysis import stray_light_analysis
from mistray.analyses.study.image import transfer_findings
from mistray.analyses.study.models import mechanical_model, optical_model, role
from mistray.analyses.study.objects import source_angles
from mistray.analyses.study.result import Study
from mistray.analyses.study.run import study
from mistray.analyses.study.step import STEPS
from mistray.analyses.study.surfaces import coatings_and_scatter, importance_sampling
from mistray.errors import MistrayError
from mistray.sampling.design_path import find_design_path
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.sources import scene_sources
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace import Settings

ANGLES = (0.0, 20.0, 40.0, 60.0)
FIELDS = (0.0, 20.0)
RAYS = 3000


def prepared(name: str):
    scene = mistray.load(name)
    table = SurfaceTable(scene, scene_sources(scene)[0].wavelength_nm)
    return scene, table, find_design_path(table, scene)


@pytest.fixture(scope="module")
def camera():
    return prepared("phone_camera_scatter")


@pytest.fixture(scope="module")
def small() -> Study:
    return study(mistray.load("plate_and_wall"), ANGLES, FIELDS, rays=RAYS, name="plate and wall")


@pytest.mark.long
def test_surfaces_in_the_order_of_the_light_and_their_targets(camera):
    step = optical_model(*camera)
    table = step.table
    assert list(table.surface[:4]) == ["window_front", "window_rear", "L1_front", "L1_rear"]
    assert list(table.does[-2:]) == ["refracts", "detects"]
    row = table.set_index("surface").loc["L2_rear"]
    assert (row.radius_mm, row.conic, row.asphere) == (3.482, 8.701, 12)
    assert row.semi_diameter_mm == pytest.approx(1.06523826)
    assert row.distance_mm == pytest.approx(1.1305)
    assert step.fact("focal length") == pytest.approx(7.0734, abs=1e-4)
    assert step.warnings == ()
    # The rear of the filter sees the detector itself, 0.1363 mm away; its front is given a target far away
    scene, table, path = camera
    step = importance_sampling(table, path, importance_targets(table, scene, Settings.of(scene)), None)
    rows = step.table.set_index("surface")
    assert rows.distance_mm["filter_rear"] == pytest.approx(0.1363)
    assert rows.half_width_mm["filter_rear"] == pytest.approx(4.36788654 / 2)
    assert rows.leaves["filter_rear"] == "back"
    assert math.isinf(rows.distance_mm["filter_front"])
    assert 0 < rows.half_angle_deg["filter_front"] < 90
    beside = step.tables["paraxial_targets"]
    assert list(dict.fromkeys(beside.surface)) == [table.ids[s.surface] for s in path.steps[:-1]]
    last = beside[beside.surface == "filter_rear"].iloc[0]
    assert (last.distance_mm, last.half_width_mm) == pytest.approx((0.1363, 4.36788654 / 2), rel=1e-6)
    assert last.traced_distance_mm == pytest.approx(last.distance_mm)
    optics = [table.ids[s.surface] for s in path.steps[:-1] if table.interfaces[s.surface].scatter]
    assert (beside.number[beside.surface.isin(optics)] > 0).all()


def test_structure_has_extents_and_roles(camera):
    _, table, path = camera
    frame = mechanical_model(table, path).table.set_index("surface")
    assert len(frame) == table.count - len(path.steps)
    wall = frame.loc["stop_wall"]
    assert (wall["shape"], wall.role, wall.space) == ("cylinder", "structure", 1)
    assert (wall.z_from_mm, wall.z_to_mm) == (-0.075, 0.0)
    assert wall.r_from_mm == wall.r_to_mm == pytest.approx(1.25171162)
    assert frame.role["L3_bevel_2"] == "bevel or edge"
    assert role(table, path, table.detector) == "detector"
    # TIS = (2π Δn σ/λ)² of the transmitted light, for 4 nm at 550 nm (eq. 7 of the phone camera study)
    _, table, path = camera
    step = coatings_and_scatter(table, path)
    frame, models = step.tables["surface_budget"], step.tables["scatter_models"]
    parts = frame[["R_percent", "T_percent", "TIS_reflected_percent", "TIS_transmitted_percent", "A_percent"]]
    np.testing.assert_allclose(parts.sum(axis=1), 100, atol=1e-9)
    assert (parts >= 0).all(axis=None)
    assert int(step.table["count"].sum()) == len(frame)  # treatments: every row once
    of_window = models[(models.surface == "window_front") & models.model.str.startswith("harvey_shack")].iloc[0]
    index = float(table.optics.host_indices[table.ids.index("window_front"), 1])
    tis = (2 * math.pi * (index - 1) * 4 / 550) ** 2
    assert of_window.TIS_transmitted_percent == pytest.approx(100 * 0.99 * tis, rel=1e-4)
    wall = models[(models.surface == "stop_wall") & models.model.str.startswith("paint")]
    assert wall.TIS_reflected_percent.iloc[0] == pytest.approx(4.5)
    # Product of the coatings' T, less what scatter takes: 0.99⁴ 0.98¹⁰ = 0.7849 times 0.98
    frame = frame.set_index("surface")
    expected = np.prod([frame.T_percent[table.ids[s.surface]] / 100 for s in path.steps[:-1]])
    assert step.fact("transmittance of the design path") == pytest.approx(expected, rel=1e-9)
    assert 0.95 < expected / (0.99**4 * 0.98**10) < 1
    # A source that does not fill the pupil is named
    scene, table, path = prepared("singlet_window_detector")
    step = optical_model(scene, table, path)
    assert "the source reaches 10 mm from the axis, the entrance pupil 20 mm" in step.warnings[0]
    none = optical_model(scene, table, None)
    assert none.result is None
    assert "no design path" in none.warnings[0]
    assert none.table.empty


@pytest.mark.core
def test_direct_light_on_axis_is_the_transmittance_times_the_areas() -> None:
    """PST(0) = T A/A_det: a pupil of 12.5 mm, a detector of 38 mm by 38 mm, and six surfaces."""
    scene, table, path = prepared("cooke_triplet")
    curve = mistray.pst(scene, [0.0, 5.0], method="forward", rays=4096, seed=1)
    report = mistray.ghosts(scene, rays=500, field_deg=[0.0])
    n = table.optics.host_indices[[step.surface for step in path.steps[:-1]]]
    transmittance = float(np.prod(1 - ((n[:, 0] - n[:, 1]) / (n[:, 0] + n[:, 1])) ** 2))
    first = optical_model(scene, table, path).result
    step = stray_light_analysis(report, curve, first, transmittance)
    (told,) = re.findall(r"T A/A_det = ([0-9.]+) ", " ".join(step.findings))
    exact = transmittance * math.pi * 6.25**2 / 38.0**2
    assert float(told) == pytest.approx(exact, rel=2e-3)
    direct, error = (float(values[0]) for values in curve.curve("direct"))
    assert abs(direct - exact) < 4 * error + 2e-3 * exact


def test_every_traced_target_stands_beside_the_paraxial_image(camera):
    """A surface of the path with three targets, as a user may give them, has three rows; the others have one."""
    scene, table, path = camera
    found = dict(importance_targets(table, scene, Settings.of(scene)))
    places = [(s.surface, s.to_back) for s in path.steps[:-1]]
    more = [replace(target, share=1 / 3) for place in places[:3] for target in found[place].targets]
    found[places[1]] = replace(found[places[1]], targets=tuple(more))
    step = importance_sampling(table, path, found, None)
    beside, targets = step.tables["paraxial_targets"], step.table
    names = {(table.ids[surface], "back" if to_back else "front") for surface, to_back in places}
    expected = targets[[place in names for place in zip(targets.surface, targets.leaves, strict=True)]]
    assert len(expected) == len(places) + 2
    both = expected.merge(beside, on=["surface", "leaves", "number"], suffixes=("_all", ""))
    assert len(both) == len(expected) == len(beside)
    for key in ("distance_mm", "half_width_mm", "half_height_mm", "half_angle_deg"):
        np.testing.assert_array_equal(both[f"traced_{key}"], both[f"{key}_all"])


def test_eight_steps_in_order(small):
    assert list(small) == [step.key for step in small.steps] == [key for key, _ in STEPS]
    assert all(step.text and step.findings and step.seconds >= 0 for step in small.steps)
    assert (list(small.pst.field_deg), list(small.ghosts)) == (list(ANGLES), list(FIELDS))
    assert math.isinf(small.first_order.focal_length_mm)
    common = {row.id for row in small.objects.common}
    assert "screen" in common
    assert common == set(small["common_objects"].table.id)
    assert small["analysis"].table.set_index("angle_deg").main_cause[40.0] == "screen"
    assert any("screen" in text for text in small["analysis"].findings)
    with pytest.raises(MistrayError, match="no step 'ghosts'"):
        small["ghosts"]


@pytest.mark.long
def test_one_report_and_a_csv_of_every_table(small, tmp_path: Path):
    files = small.write(tmp_path / "out", "mistray study plate_and_wall")
    assert files[-1].name == "report.html"
    tables = [f"{step.number}_{name}.csv" for step in small.steps for name in step.tables]
    assert sorted(path.name for path in files) == sorted([*tables, "report.html"])
    text = files[-1].read_text(encoding="utf-8")
    for key, title in STEPS:
        assert f'id="{key}"' in text
        assert title in text
    back = pd.read_csv(tmp_path / "out" / "8_pst.csv")
    np.testing.assert_allclose(back.pst_total, small.pst.value, rtol=1e-8)
    step = mistray.study(mistray.load("plate_and_wall"), (0, 40), (0,), rays=500, next_order=False)["analysis"]
    assert "There are no images of points" in step.text
    assert "books" not in step.tables
    assert step.result["images"] is None


def test_bad_arguments_are_one_line():
    """And angles of the source that are asked for reach beyond the fields."""
    assert source_angles([0.0, 18.0, -22.0], 80.0) == [0.0, 18.0, 22.0, 30.0, 40.0, 60.0, 80.0]
    scene = mistray.load("plate")
    for arguments, words in (
        ({"max_ghosts": 3}, "study: there is no argument 'max_ghosts'"),
        ({"convention": "cosine"}, "convention is 'cosine'"),
        ({"field_deg": []}, "field_deg is empty; give at least one"),
        ({"max_random_scatters": 1}, "max_random_scatters is 1"),
    ):
        with pytest.raises(MistrayError, match=words):
            study(scene, **arguments)
    with pytest.raises(MistrayError, match="load the scene first"):
        study("plate")


HALO = bsdf_xml("abg", A=1e-3, B=1e-6, g=2.0, event="reflection")


@pytest.mark.long
def test_tables_facts_and_findings(load_scene):
    scene = load_scene(paraboloid_text(HALO, detector=5.0))
    # At 4° the direct image misses the detector
    images = mistray.study(scene, (0, 20), (0, 0.5, 4), rays=20_000, quick=True, name="rough mirror", next_order=False)
    assert [one.image.field_deg for one in images.images] == [0, 0.5]  # whose image meets the detector
    step = images["analysis"]
    assert list(step.tables["image_with_stray_light"].field_deg) == [0, 0.5]
    books = step.tables["books"].drop(columns="field_deg")
    shares = books[[name for name in books if not name.endswith("_se")]].sum(axis=1)
    np.testing.assert_allclose(shares, 1, atol=1e-6)
    assert len(step.tables["transfer_functions"]) == 2 * len(images.images[0].frequencies_per_mm)
    assert len(step.tables["image_rings"]) > 100
    assert step.fact("veiling floor at 0°") == images.images[0].veiling_floor
    (text,) = transfer_findings(images.images)
    assert text in step.findings
    lost = 100 * (1 - min(one.veiling_floor.value for one in images.images))
    assert f"{lost:.3g} %" in text


@pytest.mark.long
def test_every_face_has_its_models() -> None:
    """Table 12: polish on what light crosses, flat black on the structure, particles on everything."""
    outside = {"window_front", "barrel_0_recess", "barrel_0_front_face"}
    for shape in mistray.load("phone_camera_scatter").shapes():
        found = {type(model): model for model in shape.bsdf().scatter}
        assert found[Particulate].level == (400 if shape.id() in outside else 300), shape.id()
        assert found[Particulate].slope == pytest.approx(0.926)
        if shape.id() == "detector":
            assert len(found) == 1
        elif shape.bsdf().opaque:
            assert found[Paint].reflectance == pytest.approx(0.045)
            assert float(shape.bsdf().R[0]) == pytest.approx(0.07)
        else:
            polish = found[HarveyShack]
            assert (polish.rms_nm, polish.l, polish.s) == pytest.approx((4.0, 0.01, -1.5))

"""Edits that open a gap between a diffusing sheet and the tube behind it: named, measured, and no gain."""

import json
import math
from pathlib import Path

import pytest
from oracles.scatter_scenes import beam_xml, diffuser_xml, placed_xml, scatter_scene

from mistray.analyses.sweep import page
from mistray.analyses.sweep.edit_tables import pst_sweep_record, pst_sweep_text
from mistray.sweeps import PstSweep, rank_edits, sweep, sweep_pst

RADIUS, LENGTH, LIFTED, ANGLE = 8.0, 20.0, 0.7, 20.0
# Lifted, the sheet lets light pass beside it that falls on the detector; with less scatter there is less of the other
EDITS = {
    "into the tube": {"sheet.z": 1.0},
    "lifted": {"sheet.z": -LIFTED},
    "lifted and clear": {"sheet.z": -LIFTED, "sheet.bsdf.paint.reflectance": 0.01},
    "clear": {"sheet.bsdf.paint.reflectance": 0.01},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sheet = placed_xml("asphere", "sheet", diffuser_xml(0.6), semi_diameter=RADIUS)
    tube = placed_xml("frustum", "tube", r0=RADIUS, z0=0.0, r1=RADIUS, z1=LENGTH)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, LENGTH), pixels=8, semi_diameter=3.0)
    file = tmp_path_factory.mktemp("opened") / "scene.xml"
    file.write_text(scatter_scene(beam_xml(15.0), sheet, tube, detector), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def pst(scene: Path) -> PstSweep:
    return sweep_pst(scene, EDITS, [0.0, ANGLE], rays=40_000, max_scatters=1, cell_deg=2.0)


@pytest.mark.parametrize("name", ["lifted", "lifted and clear"])
def test_first_surface(pst: PstSweep, name: str) -> None:
    """Light that meets the detector first is of the class of straight shots, which another recorder counts."""
    (one,) = pst.changed(name, ANGLE).entering
    assert one.surface == "detector"
    shots, stray = (pst.changed(name, ANGLE, light).after for light in ("straight_shot", "stray"))
    assert one.share == pytest.approx(shots / stray, rel=1e-3)
    assert one.share > 0.2
    assert pst.changed(name, 0.0).entering == ()  # along the axis nothing passes beside the sheet
    (gap,) = pst.gaps[name]
    assert set(gap.surfaces) == {"sheet", "tube"}
    assert gap.gap_mm == pytest.approx(LIFTED, abs=1e-6)


def test_gain(pst: PstSweep) -> None:
    assert pst.gaps["into the tube"] == pst.gaps["clear"] == pst.gaps["as it is"] == ()
    clear, lifted = (pst.changed(name, ANGLE) for name in ("clear", "lifted and clear"))
    assert clear.ratio < lifted.ratio < 1
    assert (clear.gain, lifted.gain) == (True, False)
    assert pst.changed("lifted and clear", 0.0).gain
    row = pst.to_pandas().set_index(["configuration", "angle_deg"]).loc["lifted and clear", ANGLE]
    assert (row.entering, row.gain, row.gap_mm) == ("detector", False, pytest.approx(LIFTED, abs=1e-6))
    assert row.entering_percent == 100 * lifted.entering[0].share
    record = json.loads(json.dumps(pst_sweep_record(pst)))
    assert record["gaps"]["lifted"][0]["gap_mm"] == pytest.approx(LIFTED, abs=1e-6)
    (row,) = (r for r in record["rows"] if (r["configuration"], r["angle_deg"]) == ("lifted", ANGLE))
    assert row["entering"][0]["surface"] == "detector"
    assert pst_sweep_text(pst).count("is no gain") == 1
    assert len(pst.warnings) == 4


def test_fields(scene: Path) -> None:
    """Before and after in a sweep of fields that has the scene as it is."""
    states = {"as it is": {}, **EDITS}
    fields = sweep(scene, [0.0, ANGLE], 550.0, states, rays=20_000, max_scatters=1, cache=False)
    assert {name for name, gaps in fields.gaps.items() if gaps} == {"lifted", "lifted and clear"}
    (one,) = fields.entering("lifted and clear", ANGLE)
    assert one.surface == "detector"
    assert fields.entering("clear", ANGLE) == fields.entering("as it is", ANGLE) == ()
    shots, stray = (fields.estimate(key, "lifted and clear", ANGLE) for key in ("straight_shot_W", "stray_W"))
    assert one.share == pytest.approx(shots.value / stray.value, rel=1e-6)
    table = fields.to_pandas().set_index(["configuration", "field_deg"])
    assert (table.loc["lifted", ANGLE].entering, table.loc["lifted", 0.0].entering) == ("detector", "")
    assert "first_light" not in table
    record = json.loads(json.dumps(page.record(fields)))
    assert record["gaps"]["lifted"][0]["gap_mm"] == pytest.approx(LIFTED, abs=1e-6)
    assert len(record["warnings"]) == 4
    assert page.text(fields).count("no gain") == 1


def test_ranking_and_a_sweep_without_the_scene_as_it_is(scene: Path) -> None:
    """There is nothing to compare light with; gaps are found against the file."""
    found = sweep(scene, ANGLE, 550.0, {"lifted": EDITS["lifted"]}, rays=2000, max_scatters=1, cache=False)
    assert found.entering("lifted", ANGLE) == ()
    assert len(found.gaps["lifted"]) == 1
    assert "entering" not in found.to_pandas()
    # A step of an edit that opens a gap is named, and comes after those that open none
    ranking = rank_edits(scene, ANGLE, "single_scatter", rays=10_000, max_scatters=1)
    opening = [edit.label for edit in ranking.edits if edit.gaps]
    sheet = ranking["sheet.z"]
    assert ("sheet.z" in opening) == (sheet.change[0].value > 0)  # lifting it lowers the light, or does not
    certain = [edit for edit in ranking.edits if max(abs(c.value) - 2 * c.se for c in edit.change) > 0]
    assert [bool(edit.gaps) for edit in certain] == sorted(bool(edit.gaps) for edit in certain)
    assert opening
    expected = {"position": 0.1, "tilt": RADIUS * math.sin(math.radians(0.1)), "rim": 0.1}
    for edit in ranking.edits:
        for gap in edit.gaps:
            assert gap.gap_mm == pytest.approx(expected[edit.kind], rel=1e-3), edit.label

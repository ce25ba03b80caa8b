"""Tables of a PST: what they say is what the result holds; JSON and warnings."""

from __future__ import annotations

import json

import numpy as np
import pytest
from report.fake_pst import FACTS, fake_pst

from mistray.analysis.pst.causes import field_edge, stray_paths
from mistray.analysis.pst.result import CLASSES, Pst
from mistray.report.tables.pst import (
    cell_frame,
    curve_frame,
    curve_text,
    path_frame,
    pst_record,
    pst_text,
    top_paths_text,
)


@pytest.fixture(scope="module")
def pst() -> Pst:
    return fake_pst()


@pytest.fixture(scope="module")
def around() -> Pst:
    return fake_pst(field_deg=(0, 20, 40), azimuths_deg=(0, 90, 180, 270))


def rows(text: str) -> list[list[str]]:
    """Cells of the rows below the rule of a table."""
    lines = text.splitlines()
    rule = next(k for k, line in enumerate(lines) if set(line) <= {"-", " "} and line.strip())
    return [[cell for cell in line.split("  ") if cell.strip()] for line in lines[rule + 1 :]]


def test_curve_frame_holds_the_means_of_the_batches(pst: Pst) -> None:
    frame = curve_frame(pst)
    batches = pst.by_batch[:, :, 0]  # (c, n, b)
    total, stray = batches.sum(axis=0), batches[1:].sum(axis=0)
    np.testing.assert_allclose(frame.pst_total, total.mean(axis=-1), rtol=1e-12)
    np.testing.assert_allclose(frame.pst_stray_se, stray.std(axis=-1, ddof=1) / np.sqrt(32), rtol=1e-9)
    for k, name in enumerate(CLASSES):
        np.testing.assert_allclose(frame[f"pst_{name}"], batches[k].mean(axis=-1), rtol=1e-12)
    assert list(frame.largest_share[[0, 40]]) == [0.002, 0.31]
    assert list(frame.angle_from_deg[:2]) == [0.0, 1.0]


def test_projected_is_normal_over_the_cosine(pst: Pst) -> None:
    ratio = curve_frame(pst.to("projected")).pst_total / curve_frame(pst).pst_total
    low, high = np.radians(pst.grid.edges_deg).T
    np.testing.assert_allclose(ratio, 2 / (np.cos(low) + np.cos(high)), rtol=1e-12)


def test_cells_have_a_row_for_each_angle_and_azimuth(around: Pst) -> None:
    frame = cell_frame(around)
    assert len(frame) == 12
    np.testing.assert_allclose(
        frame.pst_total.to_numpy().reshape(3, 4).mean(axis=1), curve_frame(around).pst_total, rtol=1e-12
    )
    assert set(frame.largest_share) == {0.002}


def test_path_frame_ranks_the_paths_of_each_cell(around: Pst) -> None:
    frame = path_frame(around)
    cells = frame.groupby(["angle_deg", "azimuth_deg"])
    assert len(cells) == 12
    for _, part in cells:
        assert list(part["rank"]) == list(range(1, len(part) + 1))
        assert part.pst.is_monotonic_decreasing
    stray = cells.percent_of_stray.sum()
    np.testing.assert_allclose(stray, 100, rtol=1e-6)
    assert frame.percent_of_stray.isna().sum() == (frame.kind == "direct").sum()


def test_paths_of_several_azimuths_are_their_mean(around: Pst) -> None:
    merged = stray_paths(around, 40.0).set_index("events")
    each = [around.paths(40.0, azimuth).set_index("events") for azimuth in (0, 90, 180, 270)]
    name = "L1_front:T barrel_1:r detector:A"
    np.testing.assert_allclose(merged.pst[name], np.mean([part.pst[name] for part in each]), rtol=1e-12)
    np.testing.assert_allclose(merged.pst_se[name], np.linalg.norm([part.pst_se[name] for part in each]) / 4)
    assert merged.rays[name] == sum(part.rays[name] for part in each)
    assert merged.percent_of_stray.sum() == pytest.approx(100)


def test_curve_text_has_the_numbers_with_their_errors(pst: Pst) -> None:
    table = rows(curve_text(pst))
    assert len(table) == 41
    angle, total, stray, *classes, share = table[20]
    value, _, error = stray.strip().partition(" ± ")
    assert angle.strip() == "40"
    assert float(value) == pytest.approx(pst.stray[20], rel=0.02)
    assert float(error) == pytest.approx(pst.stray_se[20], rel=0.1)
    assert total.strip() == stray.strip()
    assert classes[0].strip() == "–"  # no direct light there
    assert float(share) == 0.2


def test_straight_shots_have_a_column_where_there_are_any(pst: Pst) -> None:
    assert "straight shot" in curve_text(pst)
    assert "straight shot" not in curve_text(fake_pst(field_deg=(0, 20)))
    assert stray_paths(pst, 44.0).label.isin(["straight shot"]).sum() == 1


def test_top_paths_stand_beside_each_other_with_their_shares(pst: Pst) -> None:
    table = rows(top_paths_text(pst, 2))
    expected = stray_paths(pst, 20.0, 2)
    angle, first, share, second, second_share = (cell.strip() for cell in table[10])
    assert angle == "20"
    assert [first, second] == list(expected.label) == ["barrel_1 (structure)", "detector → L1_rear"]
    assert [float(share), float(second_share)] == pytest.approx(list(expected.percent_of_stray), rel=5e-3)


def test_names_are_those_of_the_rows() -> None:
    """Whatever the other rows of an angle are; that names tell paths apart is held where they are made."""
    pst = fake_pst(field_deg=(40,))
    pst.path_rows.loc[pst.path_rows.scatter_1 == "stop_wall", "label"] = "L1_front:T barrel_1:r mirror:R"
    text = top_paths_text(pst, 4)
    assert "scatter at barrel_1  " in text
    assert "  L1_front:T barrel_1:r mirror:R" in text


def test_text_names_convention_method_and_denominator(pst: Pst) -> None:
    text = pst_text(pst)
    assert "PST = E_det/E_⊥" in text
    assert "joined: rays from the detector" in text
    assert "1e+06 start rays; 550 nm; means over cells of 2° and all azimuths" in text
    assert "%: share of the stray light at that angle, which is all light but the direct image" in text
    assert "edge of the field, half of the direct light at 0°, interpolated: 26.1°" in text
    assert "cos θ" in pst_text(pst.to("projected"))
    assert "30° of azimuth" in pst_text(fake_pst(field_deg=(0, 20), azimuths_deg=range(0, 360, 30)))
    assert "Strongest stray paths" not in pst_text(fake_pst(paths=False))
    assert "Strongest stray paths" not in pst_text(pst, 0)


def test_breaks_name_the_causes_on_either_side(pst: Pst) -> None:
    text = pst_text(pst)
    table = rows(text[text.index("Breaks of the curve") : text.index("±: one standard error")])
    assert any("ghosts" in row[3] and "barrel_1 (reflects)" in row[4] for row in table if len(row) == 5)


def test_field_edge_is_where_direct_light_is_half() -> None:
    edge = field_edge(fake_pst(field_deg=np.arange(0, 40, 0.5), noise=1e-3))
    assert edge == pytest.approx(26.0, abs=0.05)  # of the logistic edge that the camera has
    assert field_edge(fake_pst(field_deg=(0, 5, 10))) is None
    assert field_edge(fake_pst(field_deg=(40, 50))) is None


def test_warnings_are_the_notes_and_large_errors() -> None:
    assert fake_pst().notes == FACTS["notes"]
    noisy = fake_pst(field_deg=(0, 70, 80), noise=0.5, notes=[]).notes
    assert len(noisy) == 1
    assert noisy[0].startswith("standard error up to ")
    assert "at 70, 80°" in noisy[0]
    many = fake_pst(noise=1.0, notes=[]).notes[0]
    assert "angles from" in many


def test_dark_angles_are_no_numbers() -> None:
    table = rows(curve_text(fake_pst(dark_from_deg=50)))
    assert [cell.strip() for cell in table[-1][:-1]] == ["80", *["–"] * 7]


def test_a_dark_pst_has_tables_too() -> None:
    dark = fake_pst(dark_from_deg=0, notes=["PST is 0"])
    assert dark.is_dark
    text = pst_text(dark)
    assert "no stray light was seen" in text
    assert "warning: PST is 0" in text
    record = pst_record(dark)
    assert record["field_edge_deg"] is None
    assert all(row["pst_total"] == 0 for row in record["curve"])


def test_record_is_json(around: Pst) -> None:
    text = json.dumps(pst_record(around, 2), allow_nan=False)
    record = json.loads(text)
    assert record["convention"] == "normal"
    assert [row["angle_deg"] for row in record["curve"]] == [0, 20, 40]
    assert record["curve"][1]["pst_total"] == pytest.approx(around.value[1])
    assert [len(row["paths"]) for row in record["curve"]] == [2, 2, 2]
    assert len(record["cells"]) == 12
    assert record["facts"]["seed"] == 0
    assert "cells" not in pst_record(fake_pst(field_deg=(0, 20)))

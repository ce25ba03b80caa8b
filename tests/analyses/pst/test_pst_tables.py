"""Tables, pictures and files of a PST: what they say is what the result holds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import html_pages
import numpy as np
import pandas as pd
import pytest
from analyses.fake_pst import FACTS, fake_pst
from matplotlib.collections import QuadMesh

from mistray.analyses.pst.causes import cause_frame, field_edge, stray_paths
from mistray.analyses.pst.figures import pst_causes, pst_curve, pst_irradiance, pst_map
from mistray.analyses.pst.page import pst_report, write_pst
from mistray.analyses.pst.result import CLASSES, Pst
from mistray.analyses.pst.tables import (
    cell_frame,
    curve_frame,
    curve_text,
    path_frame,
    pst_record,
    pst_text,
    top_paths_text,
)
from mistray.errors import MistrayError
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.render import html_page


@pytest.fixture(scope="module")
def pst() -> Pst:
    return fake_pst()


@pytest.fixture(scope="module")
def around() -> Pst:
    return fake_pst(field_deg=(0, 20, 40), azimuths_deg=(0, 90, 180, 270), map_pixels=8)


def rows(text: str) -> list[list[str]]:
    """Cells of the rows below the rule of a table."""
    lines = text.splitlines()
    rule = next(k for k, line in enumerate(lines) if set(line) <= {"-", " "} and line.strip())
    return [[cell.strip() for cell in line.split("  ") if cell.strip()] for line in lines[rule + 1 :]]


def test_curve_frame_holds_the_means_of_the_batches(pst: Pst, around: Pst) -> None:
    frame = curve_frame(pst)
    batches = pst.by_batch[:, :, 0]  # (c, n, b)
    total, stray = batches.sum(axis=0), batches[1:].sum(axis=0)
    np.testing.assert_allclose(frame.pst_total, total.mean(axis=-1), rtol=1e-12)
    np.testing.assert_allclose(frame.pst_stray_se, stray.std(axis=-1, ddof=1) / np.sqrt(32), rtol=1e-9)
    for k, name in enumerate(CLASSES):
        np.testing.assert_allclose(frame[f"pst_{name}"], batches[k].mean(axis=-1), rtol=1e-12)
    assert list(frame.largest_share[[0, 40]]) == [0.002, 0.31]
    assert list(frame.angle_from_deg[:2]) == [0.0, 1.0]
    low, high = np.radians(pst.grid.edges_deg).T
    ratio = curve_frame(pst.to("projected")).pst_total / frame.pst_total
    np.testing.assert_allclose(ratio, 2 / (np.cos(low) + np.cos(high)), rtol=1e-12)
    # The edge of the field is where direct light is half
    edge = field_edge(fake_pst(field_deg=np.arange(0, 40, 0.5), noise=1e-3))
    assert edge == pytest.approx(26.0, abs=0.05)  # of the logistic edge that the camera has
    assert field_edge(fake_pst(field_deg=(0, 5, 10))) is None
    assert field_edge(fake_pst(field_deg=(40, 50))) is None
    assert fake_pst().notes == FACTS["notes"]
    (noisy,) = fake_pst(field_deg=(0, 70, 80), noise=0.5, notes=[]).notes
    assert re.match("standard error up to .* at 70, 80°", noisy)
    assert "angles from" in fake_pst(noise=1.0, notes=[]).notes[0]
    cells = cell_frame(around)
    means = cells.pst_total.to_numpy().reshape(3, 4).mean(axis=1)
    np.testing.assert_allclose(means, curve_frame(around).pst_total, rtol=1e-12)
    assert set(cells.largest_share) == {0.002}
    frame = path_frame(around)
    of_cells = frame.groupby(["angle_deg", "azimuth_deg"])
    assert len(of_cells) == 12
    for _, part in of_cells:
        assert list(part["rank"]) == list(range(1, len(part) + 1))
        assert part.pst.is_monotonic_decreasing
    np.testing.assert_allclose(of_cells.percent_of_stray.sum(), 100, rtol=1e-6)
    assert frame.percent_of_stray.isna().sum() == (frame.kind == "direct").sum()
    merged = stray_paths(around, 40.0).set_index("events")
    each = [around.paths(40.0, azimuth).set_index("events") for azimuth in (0, 90, 180, 270)]
    name = "L1_front:T barrel_1:r detector:A"
    np.testing.assert_allclose(merged.pst[name], np.mean([part.pst[name] for part in each]), rtol=1e-12)
    np.testing.assert_allclose(merged.pst_se[name], np.linalg.norm([part.pst_se[name] for part in each]) / 4)
    assert merged.rays[name] == sum(part.rays[name] for part in each)
    assert merged.percent_of_stray.sum() == pytest.approx(100)


def test_curve_text_has_the_numbers_with_their_errors(pst: Pst) -> None:
    text = curve_text(pst)
    table = rows(text)
    assert len(table) == 41
    angle, total, stray, *classes, share = table[20]
    value, _, error = stray.partition(" ± ")
    assert (angle, total) == ("40", stray)
    assert float(value) == pytest.approx(pst.stray[20], rel=0.02)
    assert float(error) == pytest.approx(pst.stray_se[20], rel=0.1)
    assert classes[0] == "–"  # no direct light there
    assert float(share) == 0.2
    assert stray_paths(pst, 44.0).label.isin(["straight shot"]).sum() == 1
    assert rows(curve_text(fake_pst(dark_from_deg=50)))[-1][:-1] == ["80", *["–"] * 7]
    expected = stray_paths(pst, 20.0, 2)
    angle, first, share, second, second_share = rows(top_paths_text(pst, 2))[10]
    assert angle == "20"
    assert [first, second] == list(expected.label) == ["barrel_1 (structure)", "detector → L1_rear"]
    assert [float(share), float(second_share)] == pytest.approx(list(expected.percent_of_stray), rel=5e-3)


def test_text(pst: Pst) -> None:
    text = pst_text(pst)
    assert "edge of the field, half of the direct light at 0°, interpolated: 26.1°" in text
    assert "Strongest stray paths" not in pst_text(fake_pst(paths=False))
    assert "Strongest stray paths" not in pst_text(pst, 0)
    breaks = rows(text[text.index("Breaks of the curve") : text.index("±: one standard error")])
    assert any("ghosts" in row[3] and "barrel_1 (reflects)" in row[4] for row in breaks if len(row) == 5)
    dark = fake_pst(dark_from_deg=0, notes=["PST is 0: it sees no opening"])
    assert dark.is_dark
    assert "no stray light was seen" in pst_text(dark)
    record = pst_record(dark)
    assert record["field_edge_deg"] is None
    assert all(row["pst_total"] == 0 for row in record["curve"])
    assert "it sees no opening" in html_page(pst_report(dark))


def test_files(around: Pst, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    files = write_pst(around, out, "a <b> & c", "mistray pst 'a <b> & c'", 3, [(20.0, 90.0), (40.0, 0.0)])
    assert {file.name for file in files} == {entry.name for entry in out.iterdir()}
    written = out
    assert {file.name for file in written.iterdir()} == {
        "pst.csv", "pst_cells.csv", "pst_paths.csv", "pst.png", "pst_causes.png", "pst_map.png",
        "irradiance_20deg_90deg.png", "irradiance_40deg_0deg.png", "pst.json", "report.html",
    }  # fmt: skip
    curve = pd.read_csv(written / "pst.csv")
    assert curve.pst_stray.to_list() == pytest.approx(list(around.stray), rel=1e-8)
    assert len(pd.read_csv(written / "pst_cells.csv")) == 12
    assert len(pd.read_csv(written / "pst_paths.csv")) == len(around.path_rows)
    files = write_pst(fake_pst(field_deg=(0, 20), paths=False), tmp_path)
    assert {file.name for file in files} == {"pst.csv", "pst.png", "pst.json", "report.html"}
    record = json.loads((written / "pst.json").read_text(encoding="utf-8"))
    assert (record["title"], record["convention"]) == ("a <b> & c", "normal")
    assert record["curve"][1]["pst_total"] == pytest.approx(around.value[1])
    assert [len(row["paths"]) for row in record["curve"]] == [3, 3, 3]
    assert (len(record["cells"]), record["facts"]["seed"]) == (12, 0)
    assert "cells" not in pst_record(fake_pst(field_deg=(0, 20)))
    text = (written / "report.html").read_text(encoding="utf-8")
    html_pages.check(text)
    assert "a <b> & c" not in text
    assert "Point source transmittance: a &lt;b&gt; &amp; c" in text
    assert "single rays carry more than 10 %" in text
    assert html_pages.table_of(text, "t-paths").count("<tr>") == 1 + 3 * len(around.field_deg)


@pytest.fixture(scope="module")
def mapped() -> Pst:
    return fake_pst(map_pixels=16, relative_error=0.02, error_up_to_deg=60)


def lines(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axes.get_lines()}


def texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_curve_shows_every_class_with_its_error(mapped: Pst) -> None:
    above, below = pst_curve(mapped, "camera").axes
    names = {"all light": "total", "stray light: all but direct": "stray", "direct image": "direct", "ghosts": "ghost",
             "single scatter": "single_scatter", "multiple scatter": "multiple_scatter",
             "straight shots": "straight_shot"}  # fmt: skip
    for label, group in names.items():
        value = mapped.curve(group)[0]
        np.testing.assert_array_equal(lines(above)[label].get_ydata(), np.where(value > 0, value, np.nan))
    assert "edge of the field, 26.1°" in texts(above)
    # Bands are one standard error, which stands below with the one that was asked for
    value, se = mapped.curve("total")
    vertices = above.collections[0].get_paths()[0].vertices
    at_40 = vertices[np.isclose(vertices[:, 0], 40.0)][:, 1]
    np.testing.assert_allclose([at_40.min(), at_40.max()], [value[20] - se[20], value[20] + se[20]], rtol=1e-9)
    errors = lines(below)
    np.testing.assert_allclose(errors["standard error, all light"].get_ydata(), 100 * se / value)
    np.testing.assert_allclose(errors["requested error"].get_xydata(), [[0, 2], [60, 2]])
    np.testing.assert_allclose(errors["largest ray of scatter"].get_ydata()[[0, -1]], [0.2, 31])
    # A point without neighbours has its error, too
    few = fake_pst(field_deg=(0, 10, 45, 60))  # straight shots at 45° only
    value, se = few.curve("straight_shot")
    segments = [line for item in pst_curve(few).axes[0].collections for line in getattr(item, "get_segments", list)()]
    (bar,) = [line for line in segments if line[0][0] == 45.0]
    np.testing.assert_allclose(bar[:, 1], [value[2] - se[2], value[2] + se[2]])


@pytest.mark.long
def test_dark_angles_and_deep_curves() -> None:
    """Angles without light are marked at the bottom; ten decades between the field and 80° are within the axis."""
    above = pst_curve(fake_pst(dark_from_deg=55)).axes[0]
    marks = lines(above)["no light found"]
    np.testing.assert_array_equal(marks.get_xdata(), np.arange(56, 81, 2))
    assert np.all(marks.get_ydata() < 10 * above.get_ylim()[0])
    deep = fake_pst()
    deep.by_batch[:, 20:] *= 1e-6
    low, high = pst_curve(deep).axes[0].get_ylim()
    assert low < deep.value.min()
    assert deep.value.max() < high
    dark = fake_pst(azimuths_deg=(0, 90), dark_from_deg=0)
    assert texts(pst_curve(dark).axes[0]) == ["no light was seen"]
    for draw in (pst_causes, pst_map):
        assert as_png(draw(dark)).startswith(b"\x89PNG")


def test_causes_are_stacked_shares_and_irradiance_a_log_map(mapped: Pst) -> None:
    axes, table, tops = pst_causes(mapped).axes[0], cause_frame(mapped), np.zeros(41)
    for bars, name in zip(axes.containers, table.columns, strict=True):
        assert bars.get_label() == name
        np.testing.assert_allclose([bar.get_y() for bar in bars], tops)
        np.testing.assert_allclose([bar.get_height() for bar in bars], table[name], atol=1e-12)
        tops += table[name]
    np.testing.assert_allclose(tops, 100, rtol=1e-6)
    few = fake_pst(field_deg=(0, 20, 40))
    rows = few.path_rows
    copies = [rows.assign(scatter_1=f"wall_{k}", events=f"wall_{k}:r detector:A") for k in range(12)]
    many = type(few)(**{**vars(few), "path_rows": type(rows)(np.vstack(copies), columns=rows.columns).infer_objects()})
    labels = [bars.get_label() for bars in pst_causes(many).axes[0].containers]
    assert len(labels) == 10
    assert labels[-1].endswith(" more")
    axes, _ = pst_irradiance(mapped, 40.0).axes
    (image,) = axes.get_images()
    np.testing.assert_allclose(image.get_array(), np.log10(mapped.irradiance(40.0)[0]))
    assert tuple(image.get_extent()) == mapped.extent_mm
    several = fake_pst(field_deg=(0, 60), azimuths_deg=(0, 90), map_pixels=4, dark_from_deg=50)
    assert texts(pst_irradiance(several, 60.0, 90.0).axes[0]) == ["no light"]


@pytest.mark.long
def test_map_shows_the_cells_where_they_are(mapped: Pst) -> None:
    around = fake_pst(field_deg=(10, 20, 40), azimuths_deg=(0, 90, 200))
    panels = [axes for axes in pst_map(around).axes if axes.name == "polar"]
    for axes, group in zip(panels, ("total", "stray"), strict=True):
        (mesh,) = [item for item in axes.collections if isinstance(item, QuadMesh)]
        corners, shown = mesh.get_coordinates(), mesh.get_array()
        middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
        value = around.map(group)[0]
        for i, angle in enumerate(around.field_deg):
            for j, azimuth in enumerate(around.grid.azimuths_deg):
                turned = np.degrees(middle[..., 0]) - azimuth
                here = (np.abs((turned + 180) % 360 - 180) < 1.0) & np.isclose(middle[..., 1], angle)
                assert here.any()
                np.testing.assert_allclose(shown[here], np.log10(value[i, j]))
        between = np.isclose(middle[..., 1], 15.0)
        assert between.any()
        assert np.ma.getmaskarray(shown)[between].all()
    with pytest.raises(MistrayError, match="two azimuths or more"):
        pst_map(mapped)

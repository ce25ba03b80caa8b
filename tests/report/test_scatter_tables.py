"""Scattered light in the tables, the CSV files, the HTML report and the JSON, from a trace whose numbers are known."""

import json
import re

import pandas as pd
import pytest
from report.fake_scene import lens_scene
from report.fake_trace import FakePath, FakeTrace, scatter_trace_at, trace_at

from mistray.analysis.ghosts import GhostReport
from mistray.cli.ghosts_json import as_json
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.report.figures.plots import KINDS
from mistray.report.ghosts.report import html_text
from mistray.report.rays.path_sort import parse_path_sort, path_sort_text
from mistray.report.tables.ghosts import main_table
from mistray.report.tables.ghosts_csv import csv_tables, write_csv
from mistray.report.tables.scatter import scatter_text

WINDOW, STOP, GHOST, TWICE = 8e-5, 2e-5, 4e-6, 1e-6
STRAY = 2e-4 + 1e-4 + 3e-6 + 1e-9 + WINDOW + STOP + GHOST + TWICE


@pytest.fixture(scope="module")
def report():
    traces = {field: scatter_trace_at(field) for field in (0.0, 10.0)}
    return GhostReport(lens_scene(), traces, traces[0.0], {})


def test_random_and_aimed_light_is_one_path(report):
    table = report.table(10.0)
    (row,) = table[(table.scatter_1 == "window_rear") & (table.kind == "single scatter")].itertuples(index=False)
    assert len(row.path_ids) == 2
    assert row.power_W == pytest.approx(WINDOW, rel=1e-9)
    assert row.rays == 350
    assert row.label == "scatter at window_rear"
    assert row.percent_of_stray == pytest.approx(100 * WINDOW / STRAY, rel=1e-9)
    assert row.percent == pytest.approx(100 * WINDOW / (3.0 + STRAY), rel=1e-9)
    assert table.percent_of_stray[table.kind == DIRECT].isna().all()
    assert table.percent_of_stray.sum() == pytest.approx(100, rel=1e-9)
    assert report.summary(10.0).paths_of_kind["single scatter"] == 2


def test_kinds_have_their_power_and_their_colour(report):
    s = report.summary(0.0)
    powers = {kind: power.value for kind, power in s.stray_of_kind_W.items()}
    assert powers["single scatter"] == pytest.approx(WINDOW + STOP, rel=1e-9)
    assert powers["multiple scatter"] == pytest.approx(TWICE, rel=1e-9)
    assert powers["ghost + scatter"] == pytest.approx(GHOST, rel=1e-9)
    assert sum(powers.values()) == pytest.approx(s.stray_W.value, rel=1e-9)
    for style in ({kind: look[k] for kind, look in KINDS.items()} for k in (0, 1)):
        assert set(style) == {DIRECT, *STRAY_KINDS}
        assert len(set(style.values())) == len(style)


def test_light_by_the_first_surface_that_scatters(report):
    table = report.scatter_surfaces(0.0)
    assert list(table.surface) == ["window_rear", "stop_wall", "window_front"]
    assert list(table.part) == ["window", "stop", "window"]
    assert list(table.paths) == [2, 1, 1]
    assert list(table.rays) == [410, 200, 40]
    assert table.power_W.to_numpy() == pytest.approx([WINDOW + GHOST, STOP, TWICE], rel=1e-9)
    assert table.percent_of_stray.to_numpy() == pytest.approx(100 * table.power_W.to_numpy() / STRAY, rel=1e-9)
    assert table.equals(report.scatter_surfaces(0.0, 550.0))
    # Events within a body bear the name of the material in brackets
    t = FakeTrace([FakePath("window_front:T (glass):t window_rear:T detector:A", 1e-5, 40)])
    body = GhostReport(lens_scene(), {0.0: t}, trace_at(0.0), {})
    assert list(body.scatter_surfaces(0.0).part) == ["(glass)"]
    assert "(glass)" in path_sort_text(t)


def test_the_main_table_names_surfaces_and_shares(report):
    text = main_table(report, 3)
    assert "% of stray light" in text
    lines = text.splitlines()
    start = lines.index("Scattered light by the first surface that scatters it")
    assert [line.split()[:3] for line in lines[start + 4 : start + 10]] == [
        [field, surface, part]
        for field in ("0", "10")
        for surface, part in (("window_rear", "window"), ("stop_wall", "stop"), ("window_front", "window"))
    ]
    table = report.table(0.0)
    rest = table[table.rank_rms_irradiance > 3]
    assert f"… and {len(rest)} more paths: {rest.percent_of_stray.sum():.3g} % of the stray light" in text
    assert len(rest) == 5


def test_the_sampling_is_judged(report):
    text = main_table(report)
    assert re.search(r"^ *0 +0\.65 +400 +1$", text, re.MULTILINE)
    assert re.search(r"^window_rear +0\.8 +0\.8$", text, re.MULTILINE)
    assert re.search(r"^stop_wall +0\.05! +0\.05!$", text, re.MULTILINE)
    (few,) = (line for line in report.notes if "few aimed rays" in line)
    assert few.startswith("field 0, 10 deg:")
    assert "stop_wall" in few


def test_without_scatter_nothing_is_said_about_it():
    t = trace_at(0.0)
    report = GhostReport(lens_scene(), {0.0: t}, t, {})
    assert "catter" not in main_table(report).replace("ghost and scatter surfaces", "")
    assert "scatter.csv" not in csv_tables(report)
    assert report.scatter_surfaces(0.0).empty
    page = html_text(report)
    assert 'id="scatter"' not in page
    assert "no scattered light reaches the detector" in page


def test_csv_files(report, tmp_path):
    names = [file.name for file in write_csv(report, tmp_path, per_wavelength=True)]
    assert {"scatter.csv", "scatter_per_wavelength.csv", "aiming.csv"} <= set(names)
    scatter, waves, aiming = (pd.read_csv(tmp_path / name) for name in
                              ("scatter.csv", "scatter_per_wavelength.csv", "aiming.csv"))  # fmt: skip
    assert list(scatter.columns) == [
        "field_deg", "surface", "part", "paths", "rays", "power_W", "power_se_W", "percent_of_stray",
    ]  # fmt: skip
    assert list(waves.columns[:2]) == ["field_deg", "wavelength_nm"]
    assert waves.drop(columns="wavelength_nm").equals(scatter)
    assert list(aiming.landed_share) == [0.8, 0.05, 0.8, 0.05]
    summary = pd.read_csv(tmp_path / "summary.csv")
    assert summary.ghost_scatter_W[0] == pytest.approx(GHOST, rel=1e-9)
    assert {"paths_single_scatter", "paths_multiple_scatter", "paths_ghost_scatter"} <= set(summary.columns)
    paths = pd.read_csv(tmp_path / "paths.csv")
    assert len(paths) == 2 * 9
    assert set(paths.scatters) == {0, 1, 2}


def test_html(report):
    page = html_text(report)
    section = page[page.index('id="scatter"') : page.index('id="surfaces"')]
    assert '<a href="#scatter">' in page
    assert "window_rear" in section
    assert f"({100 * (WINDOW + GHOST) / STRAY:.3g} %)" in section
    assert "0.05!" in section
    assert "up to 2 reflections and 1 scatter event." in page
    assert "of stray light" in page
    for table in re.findall(r"<table.*?</table>", page, re.DOTALL):
        counts = {len(re.findall(r"<t[dh][ >]", row)) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)}
        assert len(counts) == 1


def test_json(report):
    answer = json.loads(json.dumps(as_json(report), allow_nan=False))
    field = answer["fields"][0]
    assert [row["surface"] for row in field["scattered_by"]] == ["window_rear", "stop_wall", "window_front"]
    assert field["sampling"]["rows"][1] == {
        "surface": "stop_wall",
        "aimed": 1000,
        "share_landed": 0.05,
        "low": True,
        "tight": False,
    }
    assert field["sampling"]["hits_per_start"] == 0.65
    assert field["single_scatter_W"] == pytest.approx(WINDOW + STOP)


def test_rays_to_draw_are_random_and_aimed(report):
    table = report.table(0.0)
    (path_id,) = table.path_id[(table.scatter_1 == "window_rear") & (table.kind == "single scatter")]
    members = table.path_ids[table.path_id == path_id].iloc[0]
    seen = []
    t = scatter_trace_at(0.0)
    t.sampled_rays = lambda ids, n: seen.extend(ids) or {i: [] for i in ids}
    GhostReport(lens_scene(), {0.0: t}, t, {}).rays_of(0.0, path_id)
    assert set(members) <= set(seen)
    assert len(members) == 2


def test_the_path_sort_file_tells_random_from_aimed_and_what_it_leaves_out():
    t = scatter_trace_at(0.0)
    paths = parse_path_sort(path_sort_text(t))
    kinds = {event[0] for path in paths for event in path.events}
    assert {"RandTran", "ImpTran", "ImpRefl"} <= kinds
    assert any("(1 ImpTran)" in path.intercepts for path in paths)
    text = path_sort_text(t, 4)
    rest = sum(row.percent for row in t.paths[4:])
    assert f"6 weaker paths are left out; together they hold {rest:.3g} % of the detected flux." in text
    assert len(parse_path_sort(text)) == 4
    assert "Percent of detected flux" in text


def test_long_lists_are_cut_and_say_so(report, monkeypatch):
    monkeypatch.setattr("mistray.report.tables.scatter.SURFACES_SHOWN", 1)
    text = scatter_text(report)
    rest = report.scatter_surfaces(0.0).iloc[1:]
    (line,) = re.findall(r"^ +0  … and 2 more .*$", text, re.MULTILINE)
    assert line.split()[-1] == f"{rest.percent_of_stray.sum():.4g}"
    assert text.splitlines()[-2:] == ["… and 1 more", "!: below 0.2"]

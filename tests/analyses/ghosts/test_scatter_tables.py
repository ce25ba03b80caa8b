"""Scattered light and ranks in tables, files and pages, from traces whose numbers are known."""

import json
import re

import json_units
import pandas as pd
import pytest
from analyses.fake_trace import ORDERS, WIDE, FakePath, FakeTrace, ghosts_of, ranked_report, scatter_trace_at, trace_at

from mistray.analyses.ghosts.figures.ghost_images import KINDS
from mistray.analyses.ghosts.page.fields import shown_paths
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.page.report import html_text
from mistray.analyses.ghosts.path_sort import parse_path_sort, path_sort_text, sorted_paths
from mistray.analyses.ghosts.request import GhostTables
from mistray.analyses.ghosts.tables.ghosts import STRONGEST, beyond, main_table
from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables, path_table, write_csv
from mistray.analyses.ghosts.tables.scatter import scatter_text
from mistray.errors import MistrayError
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.drawings.layout import worst_paths

WINDOW, STOP, GHOST, TWICE = 8e-5, 2e-5, 4e-6, 1e-6
STRAY = 2e-4 + 1e-4 + 3e-6 + 1e-9 + WINDOW + STOP + GHOST + TWICE


@pytest.fixture(scope="module")
def report():
    return ghosts_of(*map(scatter_trace_at, (0.0, 10.0)))


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
    s = report.summary(0.0)
    powers = {kind: power.value for kind, power in s.stray_of_kind_W.items()}
    assert powers["single scatter"] == pytest.approx(WINDOW + STOP, rel=1e-9)
    assert powers["multiple scatter"] == pytest.approx(TWICE, rel=1e-9)
    assert powers["ghost + scatter"] == pytest.approx(GHOST, rel=1e-9)
    assert sum(powers.values()) == pytest.approx(s.stray_W.value, rel=1e-9)
    assert set(KINDS) == {DIRECT, *STRAY_KINDS}
    assert [len({look[k] for look in KINDS.values()}) for k in (0, 1)] == [len(KINDS)] * 2
    # Light by the first surface that scatters
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
    body = ghosts_of(t, nominal=trace_at(0.0))
    assert list(body.scatter_surfaces(0.0).part) == ["(glass)"]
    assert "(glass)" in path_sort_text(t)
    # The path-sort file comes back in the order of the flux
    t = trace_at(10.0)
    text, written = path_sort_text(t), sorted_paths(t)
    read = parse_path_sort(text)
    assert [(path.path_id, path.rays, path.events) for path in read] == [(p.path_id, p.rays, p.events) for p in written]
    for a, b in zip(written, read, strict=True):
        assert (b.absorbed_W, b.percent) == pytest.approx((a.absorbed_W, a.percent), rel=1e-8)
    flux = [path.absorbed_W for path in read]
    assert flux == sorted(flux, reverse=True)
    assert sum(path.percent for path in read) == pytest.approx(100, abs=1e-6)
    assert [path.path_id for path in parse_path_sort(path_sort_text(t, count=2))] == [0, 1]
    direct, ghost = written[:2]
    assert (direct.intercepts, ghost.intercepts) == ("(4 SpecTran)", "(8 SpecTran)(2 SpecRefl)")
    assert ghost.events[:2] == (("Emitted", "", ""), ("SpecTran", "window", "window_front"))
    assert ghost.events[-1] == ("Absorbed", "detector", "detector")
    title, cut = "the title or the column line is missing", text[: text.index("Path 4: ")]
    for wrong, words in ((cut, "path 4 has no representative ray"), ("", title), ("something else\n", title)):
        with pytest.raises(MistrayError, match=words):
            parse_path_sort(wrong)
    t = scatter_trace_at(0.0)
    paths = parse_path_sort(path_sort_text(t))
    kinds = {event[0] for path in paths for event in path.events}
    assert {"RandTran", "ImpTran", "ImpRefl"} <= kinds
    assert any("(1 ImpTran)" in path.intercepts for path in paths)
    rest = sum(row.percent for row in t.paths[4:])
    assert f"6 weaker paths are left out; together they hold {rest:.3g} %" in path_sort_text(t, 4)


def test_the_main_table_names_surfaces_and_shares(report, monkeypatch, tmp_path):
    text = main_table(report, 3)
    lines = text.splitlines()
    start = lines.index("Scattered light by the first surface that scatters it")
    named = [line.split()[1] for line in lines[start + 4 : start + 10]]
    assert named == 2 * ["window_rear", "stop_wall", "window_front"]
    table = report.table(0.0)
    rest = table[table.rank_rms_irradiance > 3]
    assert f"… and {len(rest)} more paths: {rest.percent_of_stray.sum():.3g} % of the stray light" in text
    assert len(rest) == 5
    text = main_table(report)
    assert re.search(r"^ *0 +0\.65 +400 +1$", text, re.MULTILINE)
    assert re.search(r"^window_rear +0\.8 +0\.8$", text, re.MULTILINE)
    assert re.search(r"^stop_wall +0\.05! +0\.05!$", text, re.MULTILINE)
    (few,) = (line for line in report.notes if "few aimed rays" in line)
    assert few.startswith("field 0, 10 deg:")
    assert "stop_wall" in few
    monkeypatch.setattr("mistray.analyses.ghosts.tables.scatter.SURFACES_SHOWN", 1)
    text = scatter_text(report)
    rest = report.scatter_surfaces(0.0).iloc[1:]
    (line,) = re.findall(r"^ +0  … and 2 more .*$", text, re.MULTILINE)
    assert line.split()[-1] == f"{rest.percent_of_stray.sum():.4g}"
    assert text.splitlines()[-2:] == ["… and 1 more", "!: below 0.2"]
    names = [file.name for file in write_csv(report, tmp_path, per_wavelength=True)]
    assert {"scatter.csv", "scatter_per_wavelength.csv", "aiming.csv"} <= set(names)
    tables = {name: pd.read_csv(tmp_path / name) for name in names}
    scatter, waves = (tables[name] for name in ("scatter.csv", "scatter_per_wavelength.csv"))
    assert list(scatter.power_W[:3]) == pytest.approx([WINDOW + GHOST, STOP, TWICE], rel=1e-9)
    assert waves.drop(columns="wavelength_nm").equals(scatter)
    assert list(tables["aiming.csv"].landed_share) == [0.8, 0.05, 0.8, 0.05]
    assert tables["summary.csv"].ghost_scatter_W[0] == pytest.approx(GHOST, rel=1e-9)
    assert set(tables["paths.csv"].scatters) == {0, 1, 2}
    answer = json.loads(json.dumps(record(report), allow_nan=False))
    field = answer["fields"][0]
    assert [row["surface"] for row in field["scattered_by"]] == ["window_rear", "stop_wall", "window_front"]
    stop = field["sampling"]["rows"][1]
    assert (stop["surface"], stop["share_landed"], stop["low"], stop["tight"]) == ("stop_wall", 0.05, True, False)
    assert field["sampling"]["hits_per_start"] == 0.65
    assert field["single_scatter_W"] == pytest.approx(WINDOW + STOP)


def test_without_scatter_nothing_is_said_about_it():
    t = trace_at(0.0)
    report = ghosts_of(t)
    assert "catter" not in main_table(report).replace("ghost and scatter surfaces", "")
    assert "scatter.csv" not in csv_tables(report)
    assert report.scatter_surfaces(0.0).empty
    assert 'id="scatter"' not in html_text(report)


by_rank = pytest.mark.parametrize("rank", ORDERS)


def label(report, events):
    table = report.table(0.0)
    return table.label[table.events == events].item()


@pytest.mark.long
@by_rank
def test_text(rank):
    report = ranked_report(rank)
    lines = main_table(report, 1).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Worst 1 "))
    rows = [line for line in lines[start:] if re.match(r"\s*0 .* ghost ", line)]
    assert [label(report, ORDERS[rank][0]) in rows[0], label(report, WIDE) in rows[-1]] == [True, True]
    assert len(rows) == len({ORDERS[rank][0], WIDE})
    assert [STRONGEST in line for line in rows] == [label(report, WIDE) in line for line in rows]
    assert len(beyond(report, 0.0, 1)) == 3 - len(rows)
    assert STRONGEST in main_table(report, per_wavelength=True)
    found = json.loads(json.dumps(record(ranked_report(rank), GhostTables(per_wavelength=True))))
    assert not json_units.wrong(found)
    assert found["ranked_by"] == rank
    (field,) = found["fields"]
    assert [row["events"] for row in field["worst_paths"]] == list(ORDERS[rank])
    assert [row["events"] for row in field["worst_paths"] if row["rank_power"] == 1] == [WIDE]
    table = path_table(ranked_report(rank))
    assert ("peak_W_mm2" in table) == ("rank_peak" in table) == (rank == "peak")


@pytest.mark.long
@by_rank
def test_layout_and_report(rank):
    report = ranked_report(rank)
    assert label(report, WIDE) in [text.partition(" (")[0] for _, _, text in worst_paths(report, 0.0, 1)]
    assert [events for events in shown_paths(report, 0.0).events if events in ORDERS[rank]] == list(ORDERS[rank])
    head = html_text(report, per_wavelength=True).partition("</header>")[0]
    assert f"the strongest path is <b>{label(report, WIDE)}</b>" in head

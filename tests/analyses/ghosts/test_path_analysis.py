"""Paths with their lengths, objects and sort keys, under other names; scattered light and ranks in tables and pages."""

import json
import re
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import json_units
import numpy as np
import pandas as pd
import pytest
from analyses.fake_trace import ORDERS, WIDE, FakePath, FakeTrace, ghosts_of, ranked_report, scatter_trace_at, trace_at
from command_line import fails, run, succeeds
from oracles.scatter_scenes import beam_xml, bsdf_xml, lenses_text, placed_xml, scatter_scene, scattering_xml, wall_xml
from oracles.small_scenes import interface_xml
from refusals import each_refused, refused

import mistray
from mistray import GhostReport
from mistray.analyses.ghosts.figures.ghost_images import KINDS
from mistray.analyses.ghosts.page.fields import shown_paths
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.page.report import html_text
from mistray.analyses.ghosts.path_analysis import path_analysis
from mistray.analyses.ghosts.path_sort_text import parse_path_sort, path_sort_text, sorted_paths
from mistray.analyses.ghosts.request import SORT_KEYS, GhostTables
from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables, path_table, write_csv
from mistray.analyses.ghosts.tables.levels import level_rows, level_text
from mistray.analyses.ghosts.tables.printed import STRONGEST, beyond, main_table
from mistray.analyses.ghosts.tables.scatter import scatter_text
from mistray.recorders.path_events import DIRECT, STRAY_KINDS, way_text
from mistray.toolkit.drawings.section_layout import worst_paths

INDEX, PLATE, GAP, BEFORE = 1.5, 2.0, 7.0, 3.0


@pytest.fixture(scope="module")
def lenses(load_scene: Any) -> Any:
    scene = load_scene(lenses_text(bsdf_xml("abg", A=1e-4, B=1e-3, g=2.0), wall=wall_xml(0.3)))
    return mistray.trace(scene, rays=200, max_scatters=1, scatter_threshold=0.0)


@pytest.fixture(scope="module")
def ring(load_scene: Any) -> Any:
    edge = scattering_xml([bsdf_xml("edge_diffraction", width_mm=0.05)], R=0.0, T=1.0)
    text = scatter_scene(
        beam_xml(2.0),
        placed_xml("frustum", "ring", edge, r0=1.0, z0=0.0, r1=1.1, z1=0.0, at=(0, 0, -BEFORE)),
        placed_xml("asphere", "p_front", interface_xml("air", str(INDEX)), semi_diameter=4.0),
        placed_xml("asphere", "p_rear", interface_xml(str(INDEX), "air"), at=(0, 0, PLATE), semi_diameter=4.0),
        placed_xml("asphere", "detector", interface_xml(R=0.2), at=(0, 0, PLATE + GAP), half_width=5.0,
                   half_height=5.0, pixels=16),
    )  # fmt: skip
    return mistray.trace(load_scene(text), rays=3000)


def test_lengths_in_closed_form(ring: Any) -> None:
    """Two passages more through plate or gap than straight light: the differences are 2 n d and 2 g."""
    table = path_analysis(ring).set_index("events")
    straight = "p_front:T p_rear:T detector:A"
    inside = "p_front:T p_rear:R p_front:R p_rear:T detector:A"
    behind = "p_front:T p_rear:T detector:R p_rear:R detector:A"
    for events, more in ((inside, 2 * INDEX * PLATE), (behind, 2 * GAP)):
        assert table.opl_mm[events] - table.opl_mm[straight] == pytest.approx(more, abs=1e-9)
        assert table.opl_se_mm[events] < 1e-9
    (diffracted, *_) = table[(table.kind == "edge diffraction") & (table.objects == 4)].itertuples()
    assert diffracted.diffractions == 1
    # by less than λ/(16 w), 7e-4, as a rule: hardly longer than straight on
    assert 0 <= diffracted.opl_mm - table.opl_mm[straight] < 0.1


def test_the_mean_is_that_of_all_rays(lenses: Any) -> None:
    """A false alarm in one of 370 for each path; the seed is fixed."""
    found = path_analysis(lenses).set_index("path_id")
    rays = lenses.rays(n=None)
    assert len(found) > 40
    for path_id, own in rays.groupby("path_id"):
        exact = np.average(own.opl_mm, weights=own.flux_W)
        assert abs(found.opl_mm[path_id] - exact) <= 3.5 * np.nan_to_num(found.opl_se_mm[path_id], posinf=0) + 1e-9
        assert found.branches[path_id] == len(own)
    whole = path_analysis(lenses)
    table = path_analysis(lenses, least_share=1e-3)
    rest = table.iloc[-1]
    weak = whole[whole.power_W < 1e-3 * whole.power_W.sum()]
    assert 0 < len(weak) < len(whole)
    assert (rest.path_id, rest.kind) == (-1, "uncategorised")
    assert rest.branches == weak.branches.sum()
    assert (rest.power_W, rest.power_se_W) == pytest.approx(lenses.paths.power(weak.path_id.to_numpy()), rel=1e-12)
    assert len(table) == len(whole) - len(weak) + 1
    assert table.power_W.sum() == pytest.approx(whole.power_W.sum(), rel=1e-12)
    assert table.percent.sum() == pytest.approx(100)
    some = [row.path_id for row in lenses.paths.select("G")]
    assert set(path_analysis(lenses, path_ids=some).path_id) == set(some)
    each_refused(
        ("power_W", 1.0, "least_share is 1"), ("flux", 0.0, "'flux'"), by=lambda *given: path_analysis(lenses, *given)
    )


@pytest.mark.parametrize("key", SORT_KEYS)
def test_seven_keys(lenses: Any, ring: Any, key: str) -> None:
    for trace in (lenses, ring):
        table = path_analysis(trace, sort=key)
        values = table[key].tolist()
        assert values == sorted(values, reverse=key != "last_object")
        for _, same in table.groupby(key):
            assert same.power_W.is_monotonic_decreasing
        assert table.power_W.sum() == pytest.approx(trace.energy.detected_W, rel=1e-9)
        for row in table.itertuples():
            names = [word.rsplit(":", 1)[0] for word in row.events.split()]
            assert (row.objects, row.unique_objects) == (len(names), len(set(names)))
            assert row.last_object == (names[-2] if len(names) > 1 else "-")


@pytest.mark.parametrize("aliases", ["part", {"a_*": "first", "b_*": "second", "tube": "tube"}, {"?_*": "lenses"}])
def test_aliases_collapse_paths_and_keep_the_flux(lenses: Any, aliases: Any) -> None:
    plain, table = lenses.paths.by_way(), lenses.paths.by_way(aliases)
    assert sorted(i for ids in table.path_ids for i in ids) == list(range(len(lenses.paths)))
    assert table.power_W.sum() == pytest.approx(plain.power_W.sum(), rel=1e-12)
    assert table.rays.sum() == plain.rays.sum()
    assert table.percent.sum() == pytest.approx(100)
    if aliases == "part":  # every surface of this scene is a part of its own
        assert table.events.tolist() == plain.events.tolist()
        return
    assert len(table) < len(plain)
    named = {"a_front": "first", "a_rear": "first", "b_front": "second", "b_rear": "second"}
    if "?_*" in aliases:
        named = dict.fromkeys(named, "lenses")
    for row in table.itertuples():
        rows = [lenses.paths[i] for i in row.path_ids]
        for one in rows:
            same = ("kind", "order", "scatters", "structure_bounces", "tir")
            assert [getattr(one, name) for name in same] == [getattr(row, name) for name in same]
            events = [word.rsplit(":", 1) for word in way_text([one.events])[0].split()]
            runs = [(name, "".join(what for _, what in run)) for name, run in
                    groupby(((named.get(name, name), what) for name, what in events), key=itemgetter(0))]  # fmt: skip
            visits = [f"{name}:{what}" for name, run in runs for what in run.replace("T", "") or "T"]
            assert row.events.split() == visits
            assert row.critical == named.get(one.critical, one.critical)
        words = [word.rsplit(":", 1) for word in row.events.split()]
        assert (row.objects, row.unique_objects) == (len(words), len({name for name, _ in words}))
        power, se = lenses.paths.power(row.path_ids)
        assert row.power_W == pytest.approx(power, rel=1e-12)
        if len(rows) > 1 and not row.few_rays:
            assert row.power_se_W == pytest.approx(se, rel=1e-9), "from the batches: what they have in common is in it"
    assert not table.duplicated(["events", "kind", "order"]).any()


def test_optical_spaces(load_scene: Any, lenses: Any) -> None:
    wall = wall_xml(0.5)
    segments = [
        placed_xml("frustum", f"tube_{k}", wall, r0=3.0, z0=2.0 * k, r1=3.0, z1=2.0 * k + 2.0).replace(
            "<float", f'<integer name="space" value="{k // 2}"/><float', 1
        )
        for k in range(4)
    ]
    detector = placed_xml("asphere", "detector", at=(0, 0, 9.0), semi_diameter=3.5, pixels=8)
    scene = load_scene(scatter_scene(beam_xml(2.9, field_deg=20.0), *segments, detector))
    t = mistray.trace(scene, rays=2000, max_scatters=1)
    table = t.paths.by_way("space").set_index("events")
    whole = t.paths.to_pandas()
    for space, tubes in ((0, ("tube_0", "tube_1")), (1, ("tube_2", "tube_3"))):
        row = table.loc[f"space_{space}:r detector:A"]
        assert row.power_W == pytest.approx(whole.power_W[whole.scatter_1.isin(tubes)].sum(), rel=1e-12)
        assert row.scatter_1 == row.critical == f"space_{space}"
    assert "detector:A" in table.index
    wrong = ({"c_*": "third"}, r"'c_\*'"), ({"a_*": "=first"}, "=first"), ("parent", "'part'")
    each_refused(*wrong, by=lenses.paths.by_way)


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ghosts", "singlet_window_detector", "--field-deg", "2", "--rays", "400", "--alias", "L1*=lens",
             "--path-analysis", "objects", "--least-share", "0.05", "--quiet"]  # fmt: skip
    (field,) = json.loads(succeeds(capsys, *words, "--json", "--out", tmp_path))["fields"]
    t = mistray.trace(mistray.load(words[1]), rays=400, field_deg=2.0)
    expected = path_analysis(t, "objects", 0.05)
    assert [row["events"] for row in field["path_analysis"]] == expected.events.tolist()
    assert field["path_analysis"][-1]["kind"] == "uncategorised"
    assert [row["events"] for row in field["aliased_paths"]] == t.paths.by_way({"L1*": "lens"}).events.tolist()
    assert {"aliased_paths.csv", "path_analysis.csv"} <= {file.name for file in tmp_path.iterdir()}
    printed = run(capsys, *words[:-1])[1]
    assert "uncategorised" in printed
    assert "lens:T" in printed
    assert "λ" in printed.partition("Paths under other names")[2].partition("Path analysis")[0]  # each has rows
    for wrong, named in ((["--alias", "part", "a=b"], "part"), (["--least-share", "0.1"], "--path-analysis")):
        assert named in fails(capsys, *words[:6], *wrong)


FIELD = 4.0
STRAIGHT = "SpecTran", "TIR", "Absorbed"


@pytest.fixture(scope="module")
def report(load_scene: Any) -> GhostReport:
    scene = load_scene(lenses_text(bsdf_xml("abg", A=1e-4, B=1e-3, g=2.0), wall=wall_xml(0.3)))
    return mistray.ghosts(scene, field_deg=[FIELD], rays=60, max_scatters=2, scatter_threshold=0.0)


@pytest.mark.parametrize("by", ["scatter", "split"])
def test_every_path_is_in_one_cell(report: GhostReport, by: str) -> None:
    """Its surface is that of the last event which is scattered, or reflected other than totally, before the end."""
    t, table = report[FIELD], report.stray_levels(FIELD, by)
    assert sorted(i for ids in table.path_ids for i in ids) == [r.path_id for r in t.paths if r.kind != "direct"]
    for cell in table.itertuples(index=False):
        rows = [t.paths[i] for i in cell.path_ids]
        turns = [["-", *(at for at, what in row.event_list if what not in STRAIGHT)] for row in rows]
        assert {row.critical for row in rows} == {names[-1] for names in turns} == {cell.surface}
        levels = {row.scatters if by == "scatter" else row.order + row.structure_bounces for row in rows}
        assert levels == {cell.level}
        assert cell.rays == sum(row.rays for row in rows)
        assert (cell.power_W, cell.power_se_W) == t.paths.power(cell.path_ids)
    stray = report.summary(FIELD).stray_W
    assert table.power_W.sum() == pytest.approx(stray.value, rel=1e-12)
    assert table.percent_of_stray.sum() == pytest.approx(100)
    assert not table.duplicated(["level", "surface"]).any()
    # Printed, the last row is all stray light with the error of the sum, and so is the last column of every surface
    levels, printed = level_rows(report, FIELD, by)
    assert levels == ["0", "1", "2"]
    assert all(len(row) == len(levels) + 2 for row in printed)
    words = printed[-1][-1].split(" ± ")
    assert [float(word) for word in words] == [pytest.approx(stray.value, rel=0.01), pytest.approx(stray.se, rel=0.06)]


def test_it_is_in_the_tables(report: GhostReport) -> None:
    sums = csv_tables(report)["stray_levels.csv"].groupby("by").power_W.sum()
    assert sums["scatter"] == pytest.approx(sums["split"], rel=1e-12)
    assert level_text(report).count("all stray light") == 2
    with refused("by is 'ghost'"):
        report.stray_levels(FIELD, "ghost")


def test_levels_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ghosts", "singlet_window_detector", "--field-deg", "0", "2", "--rays", "800", "--quiet"]
    text = "G(window*) & rays > 5"
    printed = run(capsys, *words[:-1], "--levels", "--filter", text)[1]
    assert text in printed
    assert printed.count("all stray light") == 4
    fields = json.loads(succeeds(capsys, *words, "--json", "--filter", text, "--out", tmp_path))["fields"]
    t = mistray.trace(mistray.load(words[1]), rays=800, field_deg=2.0)
    ids = [row.path_id for row in t.paths.select(text)]
    power, se = t.paths.power(ids)
    found = fields[1]["filtered"]
    assert (found["power_W"], found["power_se_W"]) == (pytest.approx(power, rel=1e-9), pytest.approx(se, rel=1e-6))
    assert [row["events"] for row in found["paths"]] == [t.paths[i].events for i in ids]
    assert sum(row["percent_of_stray"] for row in fields[1]["stray_levels"]["split"]) == pytest.approx(100)
    rays = pd.read_csv(tmp_path / "filtered_rays.csv")
    assert set(rays.field_deg) == {0.0, 2.0}
    assert set(rays.path_id[rays.field_deg == 2.0]) <= set(ids)
    assert "filter 'G(window'" in fails(capsys, *words, "--filter", "G(window")
    assert "--path-ids" in fails(capsys, "view", words[1], "--filter", "G", "--path-ids", "1")


WINDOW, STOP, GHOST, TWICE = 8e-5, 2e-5, 4e-6, 1e-6
STRAY = 2e-4 + 1e-4 + 3e-6 + 1e-9 + WINDOW + STOP + GHOST + TWICE


@pytest.fixture(scope="module")
def scattering():
    return ghosts_of(*map(scatter_trace_at, (0.0, 10.0)))


def test_random_and_aimed_light_is_one_path(scattering):
    table = scattering.table(10.0)
    (row,) = table[(table.scatter_1 == "window_rear") & (table.kind == "single scatter")].itertuples(index=False)
    assert (len(row.path_ids), row.rays, row.label) == (2, 350, "scatter at window_rear")
    shares = WINDOW, 100 * WINDOW / STRAY, 100 * WINDOW / (3.0 + STRAY)
    assert (row.power_W, row.percent_of_stray, row.percent) == pytest.approx(shares, rel=1e-9)
    assert table.percent_of_stray[table.kind == DIRECT].isna().all()
    assert table.percent_of_stray.sum() == pytest.approx(100, rel=1e-9)
    assert scattering.summary(10.0).paths_of_kind["single scatter"] == 2
    s = scattering.summary(0.0)
    powers = {kind: power.value for kind, power in s.stray_of_kind_W.items()}
    for kind, power in (("single scatter", WINDOW + STOP), ("multiple scatter", TWICE), ("ghost + scatter", GHOST)):
        assert powers[kind] == pytest.approx(power, rel=1e-9), kind
    assert sum(powers.values()) == pytest.approx(s.stray_W.value, rel=1e-9)
    assert set(KINDS) == {DIRECT, *STRAY_KINDS}
    assert [len({look[k] for look in KINDS.values()}) for k in (0, 1)] == [len(KINDS)] * 2
    # Light by the first surface that scatters
    table = scattering.scatter_surfaces(0.0)
    rows = ["window_rear", "window", 2, 410], ["stop_wall", "stop", 1, 200], ["window_front", "window", 1, 40]
    assert table[["surface", "part", "paths", "rays"]].to_numpy().tolist() == [*rows]
    assert table.power_W.to_numpy() == pytest.approx([WINDOW + GHOST, STOP, TWICE], rel=1e-9)
    assert table.percent_of_stray.to_numpy() == pytest.approx(100 * table.power_W.to_numpy() / STRAY, rel=1e-9)
    assert table.equals(scattering.scatter_surfaces(0.0, 550.0))
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
    last = text[: text.rindex("\n", 0, len(text.rstrip()))]
    in_event, in_row = text[: text.index("\t", len(last))], text[: text.index("\n4\t") + 2]
    cuts = [(part, "no whole") for part in (last, in_event, in_row)]
    wrong = *cuts, (cut, "path 4 has no whole representative ray"), ("", title), ("something else\n", title)
    each_refused(*wrong, by=parse_path_sort)
    t = scatter_trace_at(0.0)
    paths = parse_path_sort(path_sort_text(t))
    assert {"RandTran", "ImpTran", "ImpRefl"} <= {event[0] for path in paths for event in path.events}
    assert any("(1 ImpTran)" in path.intercepts for path in paths)
    rest = sum(row.percent for row in t.paths[4:])
    assert f"6 weaker paths are left out; together they hold {rest:.3g} %" in path_sort_text(t, 4)


def test_the_main_table_names_surfaces_and_shares(scattering, monkeypatch, tmp_path):
    text = main_table(scattering, 3)
    lines = text.splitlines()
    start = lines.index("Scattered light by the first surface that scatters it")
    named = [line.split()[1] for line in lines[start + 4 : start + 10]]
    assert named == 2 * ["window_rear", "stop_wall", "window_front"]
    table = scattering.table(0.0)
    rest = table[table.rank_rms_irradiance > 3]
    assert f"… and {len(rest)} more paths: {rest.percent_of_stray.sum():.3g} % of the stray light" in text
    assert len(rest) == 5
    text = main_table(scattering)
    assert re.search(r"^ *0 +0\.65 +400 +1$", text, re.MULTILINE)
    assert re.search(r"^window_rear +0\.8 +0\.8$", text, re.MULTILINE)
    assert re.search(r"^stop_wall +0\.05! +0\.05!$", text, re.MULTILINE)
    (few,) = (line for line in scattering.notes if "few aimed rays" in line)
    assert re.match("field 0, 10 deg:.*stop_wall", few)
    monkeypatch.setattr("mistray.analyses.ghosts.tables.scatter.SURFACES_SHOWN", 1)
    text = scatter_text(scattering)
    rest = scattering.scatter_surfaces(0.0).iloc[1:]
    (line,) = re.findall(r"^ +0  … and 2 more .*$", text, re.MULTILINE)
    assert line.split()[-1] == f"{rest.percent_of_stray.sum():.4g}"
    assert text.splitlines()[-2:] == ["… and 1 more", "!: below 0.2"]
    tables = {file.name: pd.read_csv(file) for file in write_csv(scattering, tmp_path, per_wavelength=True)}
    scatter, waves = (tables[name] for name in ("scatter.csv", "scatter_per_wavelength.csv"))
    assert list(scatter.power_W[:3]) == pytest.approx([WINDOW + GHOST, STOP, TWICE], rel=1e-9)
    assert waves.drop(columns="wavelength_nm").equals(scatter)
    assert list(tables["aiming.csv"].landed_share) == [0.8, 0.05, 0.8, 0.05]
    assert tables["summary.csv"].ghost_scatter_W[0] == pytest.approx(GHOST, rel=1e-9)
    assert set(tables["paths.csv"].scatters) == {0, 1, 2}
    field = json.loads(json.dumps(record(scattering), allow_nan=False))["fields"][0]
    assert [row["surface"] for row in field["scattered_by"]] == ["window_rear", "stop_wall", "window_front"]
    stop = field["sampling"]["rows"][1]
    assert (stop["surface"], stop["share_landed"], stop["low"], stop["tight"]) == ("stop_wall", 0.05, True, False)
    assert field["sampling"]["hits_per_start"] == 0.65
    assert field["single_scatter_W"] == pytest.approx(WINDOW + STOP)


def test_without_scatter_nothing_is_said_about_it():
    scattering = ghosts_of(trace_at(0.0))
    assert "catter" not in main_table(scattering).replace("ghost and scatter surfaces", "")
    assert "scatter.csv" not in csv_tables(scattering)
    assert scattering.scatter_surfaces(0.0).empty
    assert 'id="scatter"' not in html_text(scattering)


@pytest.mark.parametrize("rank", ORDERS)
def test_text_layout_and_report(rank):
    scattering = ranked_report(rank)
    labels = scattering.table(0.0).set_index("events").label
    first, wide = labels[ORDERS[rank][0]], labels[WIDE]
    lines = main_table(scattering, 1).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Worst 1 "))
    rows = [line for line in lines[start:] if re.match(r"\s*0 .* ghost ", line)]
    assert (first in rows[0], wide in rows[-1]) == (True, True)
    assert len(rows) == len({ORDERS[rank][0], WIDE})
    assert [STRONGEST in line for line in rows] == [wide in line for line in rows]
    assert len(beyond(scattering, 0.0, 1)) == 3 - len(rows)
    assert STRONGEST in main_table(scattering, per_wavelength=True)
    found = json.loads(json.dumps(record(scattering, GhostTables(per_wavelength=True))))
    assert not json_units.wrong(found)
    assert found["ranked_by"] == rank
    (field,) = found["fields"]
    assert [row["events"] for row in field["worst_paths"]] == list(ORDERS[rank])
    assert [row["events"] for row in field["worst_paths"] if row["rank_power"] == 1] == [WIDE]
    assert [name in path_table(scattering) for name in ("peak_W_mm2", "rank_peak")] == [rank == "peak"] * 2
    assert wide in [text.partition(" (")[0] for _, _, text in worst_paths(scattering, 0.0, 1)]
    assert [events for events in shown_paths(scattering, 0.0).events if events in ORDERS[rank]] == list(ORDERS[rank])
    head = html_text(scattering, per_wavelength=True).partition("</header>")[0]
    assert f"the strongest path is <b>{wide}</b>" in head

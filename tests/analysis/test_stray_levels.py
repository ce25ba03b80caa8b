"""Stray light by level and critical surface: every stray path in one cell, sums and errors those of the trace."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import fails, run, succeeds
from oracles.scatter_scenes import bsdf_xml, lenses_text, wall_xml

import mistray
from mistray.analysis.ghosts import GhostReport
from mistray.report import main_table
from mistray.report.tables.ghosts_csv import csv_tables
from mistray.report.tables.levels import level_rows, level_text

FIELD = 4.0


@pytest.fixture(scope="module")
def report(load_scene: Any) -> GhostReport:
    scene = load_scene(lenses_text(bsdf_xml("abg", A=1e-4, B=1e-3, g=2.0), wall=wall_xml(0.3)))
    return mistray.ghosts(scene, field_deg=[FIELD], rays=60, max_scatters=2, scatter_threshold=0.0)


def last_turn(row: Any) -> str:
    """The last event of a path that is scattered, or reflected other than totally, before the detector takes it."""
    turns = [name for name, what in row.event_list if what not in ("SpecTran", "TIR", "Absorbed")]
    return turns[-1] if turns else "-"


@pytest.mark.parametrize("by", ["scatter", "split"])
def test_every_path_is_in_one_cell(report: GhostReport, by: str) -> None:
    t, table = report[FIELD], report.stray_levels(FIELD, by)
    assert sorted(i for ids in table.path_ids for i in ids) == [r.path_id for r in t.paths if r.kind != "direct"]
    for cell in table.itertuples(index=False):
        rows = [t.paths[i] for i in cell.path_ids]
        assert {row.critical for row in rows} == {last_turn(row) for row in rows} == {cell.surface}
        levels = {row.scatters if by == "scatter" else row.order + row.structure_bounces for row in rows}
        assert levels == {cell.level}
        assert cell.rays == sum(row.rays for row in rows)
        assert (cell.power_W, cell.power_se_W) == t.paths.power(cell.path_ids)
    stray = report.summary(FIELD).stray_W
    assert table.power_W.sum() == pytest.approx(stray.value, rel=1e-12)
    assert table.percent_of_stray.sum() == pytest.approx(100)
    pivot = table.pivot_table(index="surface", columns="level", values="power_W", aggfunc="sum")
    assert np.nansum(pivot) == pytest.approx(stray.value, rel=1e-12)
    assert not table.duplicated(["level", "surface"]).any()
    # Printed, the last row is all stray light with the error of the sum, and so is the last column of every surface
    levels, printed = level_rows(report, FIELD, by)
    assert levels == ["0", "1", "2"]
    assert all(len(row) == len(levels) + 2 for row in printed)
    words = printed[-1][-1].split(" ± ")
    assert [float(word) for word in words] == [pytest.approx(stray.value, rel=0.01), pytest.approx(stray.se, rel=0.06)]


def test_it_is_in_the_tables(report: GhostReport) -> None:
    table = csv_tables(report)["stray_levels.csv"]
    assert list(table.columns[:4]) == ["field_deg", "by", "level", "surface"]
    sums = table.groupby("by").power_W.sum()
    assert sums["scatter"] == pytest.approx(sums["split"], rel=1e-12)
    assert level_text(report).count("all stray light") == 2
    assert "critical surface" not in main_table(report)
    with pytest.raises(mistray.MistrayError, match="by is 'ghost'"):
        report.stray_levels(FIELD, "ghost")


@pytest.mark.long
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A filter on the command line: its paths, its rays, and their power, as the trace has them."""
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
    with open(tmp_path / "filtered_rays.csv", encoding="utf-8") as file:
        rays = list(csv.DictReader(file))
    assert {float(row["field_deg"]) for row in rays} == {0.0, 2.0}
    assert {int(row["path_id"]) for row in rays if row["field_deg"] == "2.0"} <= set(ids)
    assert "filter 'G(window'" in fails(capsys, *words, "--filter", "G(window")
    assert "--path-ids" in fails(capsys, "view", words[1], "--filter", "G", "--path-ids", "1")

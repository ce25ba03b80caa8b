"""Every list of worst paths goes by the rank that was asked for and has the strongest path by power."""

import json
import re

import json_units
import pytest
from report.ranked_paths import ORDERS, WIDE, ranked_report

from mistray.analysis.ranking import RANKS
from mistray.cli.commands import ghosts as command
from mistray.cli.ghosts_json import as_json
from mistray.report.figures.layout import worst_paths
from mistray.report.ghosts.fields import shown_paths
from mistray.report.ghosts.report import html_text
from mistray.report.tables.ghosts import STRONGEST, beyond, main_table
from mistray.report.tables.ghosts_csv import path_table

by_rank = pytest.mark.parametrize("rank", ORDERS)


def label(report, events):
    table = report.table(0.0)
    return table.label[table.events == events].item()


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
    # JSON and CSV
    found = json.loads(json.dumps(as_json(ranked_report(rank), per_wavelength=True)))
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
    assert tuple(RANKS) == command.RANKS

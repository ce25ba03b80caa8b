"""A section of one's own in the report of a ghost analysis: this file is all that a user writes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import Captured, succeeds

import mistray
from mistray import GhostReport, MistrayError
from mistray.estimate import Estimate
from mistray.report import main_table, remove_section, report_section, write_all
from mistray.toolkit.figures.figure import Figure as Drawing
from mistray.toolkit.pages.model import FigurePart, Map, NotePart, Section, Table, columns

BRIGHTEST = 3  # ghosts of each field


def reflecting(report: GhostReport) -> list[tuple[float, str, Estimate]]:
    """Field, surface, and power of the brightest ghosts by the surface that reflects them first."""
    found = []
    for field in report:
        rows = report.top(field, BRIGHTEST, "power")
        for surface, own in rows[rows.ghost_1.astype(bool)].groupby("ghost_1", sort=False):
            found.append((field, str(surface), report.power_of(field, own)))
    return found


def brightest_ghosts(report: GhostReport) -> Section:
    """Which surfaces the brightest ghosts come from: a table, a picture, a map and a remark."""
    found = reflecting(report)

    def bars() -> Drawing:
        drawn = Drawing(figsize=(6, 3))
        axes = drawn.subplots()
        axes.barh([f"{surface}, {field:g}°" for field, surface, _ in found], [power.value for *_, power in found])
        axes.set_xlabel("power [W]")
        return drawn

    first = next(iter(report.values()))
    rows = [[f"{field:g}", surface, power] for field, surface, power in found]
    return Section(
        "brightest",
        "Surfaces of the brightest ghosts",
        [
            NotePart(f"The {BRIGHTEST} brightest ghosts of each field <by power>."),
            Table(columns("field [deg]", "<surface", "power [W]"), rows, "ghost_surfaces"),
            FigurePart(bars, "Power by the surface that reflects first."),
            Map(first.irradiance, first.extent, "all light of the first field", name="light"),
        ],
        link="Brightest",
    )


@pytest.fixture
def section() -> Iterator[Any]:
    """The section, which every report has while a test runs."""
    yield report_section(brightest_ghosts)
    remove_section(brightest_ghosts)


@pytest.fixture(scope="module")
def report() -> GhostReport:
    return mistray.ghosts(mistray.load("plate"), field_deg=[0.0, 5.0], rays=2000, seed=1)


def test_the_section_is_on_the_page_and_among_the_tables(section: Any, report: GhostReport, tmp_path: Path) -> None:
    assert "ghost_surfaces.csv" in {file.name for file in write_all(report, tmp_path / "out", "plate")}
    table = pd.read_csv(tmp_path / "out" / "ghost_surfaces.csv")
    assert list(table.columns) == ["field_deg", "surface", "power_W", "power_se_W"]
    expected = reflecting(report)
    assert len(expected) >= 2
    assert list(table.surface) == [surface for _, surface, _ in expected]
    np.testing.assert_allclose(table.power_W, [power.value for *_, power in expected], rtol=1e-8)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    body = page[page.index('<h2 id="brightest">') :]
    body = body[: body.index("</section>")]
    assert '<a href="#brightest">Brightest</a>' in page
    assert body.count("<svg") == 2  # the figure and the map
    assert body.count("<tr>") == 1 + len(expected)
    assert "&lt;by power&gt;" in body
    assert page.index('id="surfaces"') < page.index('id="brightest"') < page.index('id="settings"')
    printed = main_table(report).split("Surfaces of the brightest ghosts")[1]
    assert all(surface in printed for _, surface, _ in expected)


def test_the_command_has_it_too(section: Any, capsys: Captured) -> None:
    command = ("ghosts", "plate", "--rays", "1000", "--field-deg", "0", "--json")
    found = json.loads(succeeds(capsys, *command))["sections"]["brightest"]
    remove_section(brightest_ghosts)
    assert "sections" not in json.loads(succeeds(capsys, *command))
    report_section(brightest_ghosts)
    assert found["title"] == "Surfaces of the brightest ghosts"
    assert found["ghost_surfaces"][0]["power_W"] > 0
    assert found["light"]["largest"] > found["light"]["smallest"] == 0


@pytest.mark.parametrize("name", ["", "paths"])
def test_a_table_needs_a_file_name_of_its_own(report: GhostReport, tmp_path: Path, name: str) -> None:
    def section(_: GhostReport) -> Section:
        return Section("mine", "Mine", [Table(columns("a"), [["1"]], name)])

    report_section(section)
    try:
        with pytest.raises(MistrayError, match="'Mine'"):
            write_all(report, tmp_path / "out", "plate")
    finally:
        remove_section(section)
    assert not (tmp_path / "out").exists()

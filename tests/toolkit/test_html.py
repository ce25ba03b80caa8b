"""Reports as HTML and PDF: what is on their pages, files all there or none, and where headings of columns stand."""

import ast
import contextlib
import itertools
import json
import re
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import html_pages
import numpy as np
import pandas as pd
import pytest
from analyses.fake_trace import SHARES, FakeTrace, ghosts_of, trace_at, trace_in_colours
from command_line import Captured, Patch, succeeds
from markupsafe import Markup

import mistray
from mistray.analyses.ghosts.page import output
from mistray.analyses.ghosts.page import report as html
from mistray.analyses.ghosts.page.report import html_text, write_html
from mistray.analysis import Estimate, GhostReport, ThermalReport
from mistray.report import Look, remove_section, report_section, write_all, write_thermal
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import FIGURE, within
from mistray.toolkit.figures.figure import Figure as Drawing
from mistray.toolkit.pages import model
from mistray.toolkit.pages.embedded import palette_png
from mistray.toolkit.pages.formats import write_formats
from mistray.toolkit.pages.model import Items, NotePart, Report, Section, Table, columns
from mistray.toolkit.pages.own_sections import section_record, section_tables, section_texts
from mistray.toolkit.pages.pdf import _cell, _Writer, pdf_bytes
from mistray.toolkit.pages.render import html_page, html_parts, runs


@pytest.fixture(scope="module")
def report() -> GhostReport:
    return ghosts_of(*map(trace_at, (0.0, 20.0)))


def test_page_of_one_wavelength(tmp_path: Path, report: GhostReport) -> None:
    out = tmp_path / "out"
    files = write_all(report, out, "a <b> & c", "mistray ghosts 'a <b> & c' --rays 1e6")
    assert sorted(file.name for file in files) == sorted(entry.name for entry in out.iterdir())
    text, names = (out / "report.html").read_text(encoding="utf-8"), {file.name for file in files}
    html_pages.check(text)
    assert "a <b> & c" not in text
    assert "Ghost analysis: a &lt;b&gt; &amp; c" in text
    assert {"paths.csv", "overview.png", "ghosts_0deg.png", "layout_20deg.png", "path_sort_0deg.txt"} <= names
    for name, paths in (("t-field-0", 5), ("t-field-20", 4)):
        table = html_pages.table_of(text, name)
        assert table.count("data:image/png;base64,") == table.count('class="pick"') == paths
    assert not {name for name in names if name.startswith("colour") or "per_wavelength" in name}
    assert "in colour" not in text
    report = ghosts_of(*map(trace_in_colours, (0.0, 20.0)))
    names = {file.name for file in write_all(report, tmp_path, per_wavelength=True, look=Look())}
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    html_pages.check(text)
    assert {"colour_0deg.png", "colour_20deg.png", "paths_per_wavelength.csv"} <= names
    assert "450, 550, 650\u00a0nm with 25, 50, 25\u00a0% of the flux" in text
    assert "the detector in colour, field 20°" in text
    for name in ("t-summary-waves", "t-waves-field-20", "t-energy-450", "t-energy-650", "t-surfaces-wavelengths"):
        assert f'id="{name}"' in text
    table, waves = (html_pages.table_of(text, name) for name in ("t-field-0", "t-waves-field-0"))
    assert (table.count("detector → L1_rear"), waves.count("detector → L1_rear")) == (1, 3)
    assert ("λ" in table, "λ" in waves) == (False, True)


@pytest.mark.parametrize("shares", [None, SHARES])
def test_a_detector_in_the_dark(tmp_path: Path, shares: dict[float, float] | None) -> None:
    dark = FakeTrace([], shares=shares)
    report = ghosts_of(dark)
    write_all(report, tmp_path / "out", per_wavelength=True, look=Look() if shares else None)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "No stray path reaches the detector." in text
    assert "no direct light reaches the detector on axis" in text


def test_assumptions_name_the_polarisation(report: GhostReport, monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value, words in (
        ("polarization", "stokes", "the light of the source is unpolarised"),
        ("source_stokes", {"laser": (0.6, 0.0, -0.8)}, "0.6, 0, −0.8 (laser)"),
    ):
        assert words not in html_parts(html._settings(report, "").parts)
        monkeypatch.setitem(report[0.0].settings, key, value)
        assert words in html_parts(html._settings(report, "").parts)


@pytest.mark.quick
def test_coatings_of_a_real_scene_under_the_light_of_a_fake_trace() -> None:
    """n = 1.5: R = (0.5/2.5)² = 4 %; surfaces alike stand together, and their light is accounted for."""
    scene, t = mistray.load("plate"), trace_at(0.0)
    t.tables = [SurfaceTable(scene, 550.0)]
    text = html_text(GhostReport(scene, {0.0: t}, t, {}), "plate")

    def rows(name: str) -> list[dict[str, str]]:
        body = html_pages.table_of(text, name)
        heads = re.findall(r"<th [^>]*>(.*?)</th>", re.sub(r"<small>.*?</small>", "", body), re.DOTALL)
        lines = re.findall(r"<tr>(<td.*?)</tr>", body, re.DOTALL)
        return [dict(zip(heads, re.findall(r"<td[^>]*>(.*?)</td>", line, re.DOTALL), strict=True)) for line in lines]

    front = next(row for row in rows("t-surface-budget-0") if row["surface"] == "plate_front")
    assert (float(front["R"]), float(front["T"]), float(front["A"])) == pytest.approx((4, 96, 0), abs=1e-9)
    table = rows("t-coatings-0")
    assert any({"plate_front", "plate_rear"} <= set(row["surfaces"].split(", ")) for row in table)
    for row in table:
        shares = [float(row[name]) for name in ("R", "T", "TIS reflected", "TIS transmitted", "A")]
        assert sum(shares) == pytest.approx(100, abs=1e-6)
    assert '<a href="#coatings">' in text


def test_a_failure_leaves_nothing(report: GhostReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fail = Mock(side_effect=RuntimeError("out of paper"))
    monkeypatch.setattr(html, "html_text", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_html(report, tmp_path / "report.html")
    monkeypatch.setattr(output, "draw", lambda report, _: ({"overview.png": b"picture"}, report))
    monkeypatch.setattr(output, "ghosts_report", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_all(report, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fields", [0, 2])
def test_a_page_shows_the_fields_that_there_was_time_for(fields: int, tmp_path: Path, monkeypatch: Patch) -> None:
    report = mistray.ghosts(mistray.load("singlet_window_detector"), [0, 2, 4], rays=200)
    # Time is asked for twice a field, before and after its pictures
    left = itertools.chain([1e6] * 2 * fields, itertools.repeat(0.0))
    monkeypatch.setattr(output, "left", lambda: next(left))
    with within(1000), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        files = {path.name for path in write_all(report, tmp_path)}
    shown = {name for name in files if name.startswith("ghosts_")}
    assert len(shown) == fields
    assert {"report.html", "levels.png", *(f"layout_{name[7:]}" for name in shown)} <= files
    assert set(pd.read_csv(tmp_path / "summary.csv").field_deg) == {0, 2, 4}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert len(set(re.findall(r'id="(field-[\d_]+)"', page))) == fields


def drawing() -> Drawing:
    made = Drawing(figsize=(4, 3))
    made.subplots().plot([0, 1])
    return made


def test_a_figure_is_drawn_or_named() -> None:
    report = Report("Page", "scene", [Section("a", "Curve", [model.FigurePart(drawing, "A <curve>.")], "Curve")])
    whole = html_page(report)
    assert whole.count("<figcaption>A &lt;curve&gt;.</figcaption>") == 1
    with within(FIGURE / 2):
        cut = html_page(report)
    assert "A &lt;curve&gt;." in cut
    assert "<figcaption>" not in cut
    assert len(cut) < len(whole) - 1000  # the SVG


def pages_of(pdf: bytes) -> int:
    assert pdf.startswith(b"%PDF")
    return len(re.findall(rb"/Type /Page\b", pdf))


def texts_of(pdf: bytes, key: str) -> list[str]:
    plain = re.findall(rf"/{key} \((.*?)(?<!\\)\)".encode(), pdf, re.DOTALL)
    coded = re.findall(rf"/{key} <feff([0-9a-f]*)>".encode(), pdf)
    return [
        *(re.sub(rb"\\(.)", rb"\1", text, flags=re.DOTALL).decode("latin-1") for text in plain),
        *(bytes.fromhex(text.decode()).decode("utf-16-be") for text in coded),
    ]


def wide_table(count: int) -> Table:
    heads = columns("<path", "<kind", *(f"number {k} of many [W/mm²]" for k in range(12)))
    numbers = [Estimate(1.2345e-4 * k, 3e-6) for k in range(1, 13)]
    return Table(heads, [[f"detector → L1_rear, {k}", "ghost", *numbers] for k in range(count)], "t")


@pytest.mark.quick
def test_every_part_of_the_model():
    dot = palette_png(np.zeros((9, 9), dtype=np.uint8), np.zeros((1, 3), dtype=np.uint8))
    parts = [
        NotePart("$x_{1}$ **no** markdown & <tags> ± → λ"), NotePart("a heading", "h3"),
        NotePart("mistray --help", "pre"),
        Items([Markup("a <b>bold &amp; true</b> word")], "verdict"), Items(["one", "two"]), NotePart("word " * 4000),
        model.Terms([("name", "value")]),
        model.FigurePart(dot, "a dot", "a black dot"), model.FigurePart(drawing, "a line"),
        model.Map(np.ones((3, 4)), (0.0, 4.0, 0.0, 3.0), "a map"), model.Html("<script>1</script>"),
        wide_table(70), Table(columns("none"), []), model.Folded("behind", [NotePart("hidden")]),
    ]  # fmt: skip
    sections = [Section("a", "First (part)", parts), Section("b", "Folded", [NotePart("x")], folded="always")]
    pdf = pdf_bytes(Report("Heading", "scene", sections, warnings=["careful"]))
    assert 4 <= pages_of(pdf) <= 12  # of which the long paragraph takes four
    assert "First (part)" in texts_of(pdf, "Title")
    assert {"a black dot", "a line", "a map"} <= set(texts_of(pdf, "Alt"))
    assert all(float(size) == pytest.approx(595.28) for size in re.findall(rb"/MediaBox \[0 0 ([\d.]+)", pdf))


def test_tables_are_no_wider_than_the_page(tmp_path):
    table = wide_table(3)
    rows = [[column.head for column in table.columns], *([_cell(value) for value in row] for row in table.rows)]
    with contextlib.closing(_Writer("title")) as writer:
        _, widths = writer._widths(rows, [column.style == "t" for column in table.columns])
        size, narrow = writer._widths([["a", "b"], ["1", "2"]], [True, False])
        assert sum(widths) <= writer.pdf.epw + 1e-6
    assert min(widths) > 3
    assert (size, sum(narrow) < 20) == (7.0, True)
    assert _cell(model.HtmlCell("<td>one.<br>two &amp; <b>three</b></td>")) == "one.\ntwo & three"
    letters = Table(columns("<path", "<events"), [["a", model.Fold("TTTRA", "L1:T", "path m")]])
    assert [column.head for column in letters.kept([0]).columns] == ["path"]
    assert runs("TTTRA") == "T×3 R A"
    assert [_cell(value) for value in (Estimate(1.5, 0.1), "a </ b")] == ["1.50\n±\u00a00.10", "a </ b"]
    report = Report("Heading", "scene", [Section("a", "First", [NotePart("text")])], page="objects.html")
    (path,) = write_formats(iter(["pdf"]), tmp_path, {}, {}, report=report)
    assert path.name == "objects.pdf"
    assert pages_of(path.read_bytes()) == 1


ANALYSES = Path(mistray.__file__).parent / "analyses"
DECLARES = ("column", "derived.column")  # what a column of a row is declared with
HEADS = ("columns", "Column.of")  # what makes columns of a table from texts


def texts(node: ast.AST) -> Iterator[str]:
    """The text that an expression is, if it ends in a unit in brackets; without the sign of a flush left column."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.endswith("]"):
        yield node.value.removeprefix("<")


def test_no_table_repeats_a_heading_of_a_row() -> None:
    """What a row of an analysis declares, such as "power [W absorbed]", no other table of the analysis says again."""
    declared: dict[str, set[str]] = defaultdict(set)
    said: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for path in sorted(ANALYSES.rglob("*.py")):
        place = path.relative_to(ANALYSES)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in DECLARES:
                heads = [keyword.value for keyword in node.keywords if keyword.arg == "head"]
                declared[place.parts[0]] |= {text for head in heads for text in texts(head)}
            is_heads = isinstance(node, ast.Call) and ast.unparse(node.func) in HEADS
            if is_heads or isinstance(node, ast.Dict | ast.List | ast.Tuple):
                parts = ast.iter_child_nodes(node)
                said[place.parts[0]] += [(str(place), text) for part in parts for text in texts(part)]
    assert sum(map(len, declared.values())) > 20
    again = [f"{name}: '{text}'" for own, found in said.items() for name, text in found if text in declared[own]]
    assert not again, f"{again}: take the column of the row, with table(kind, rows, only=…)"


def test_a_section_of_thermal_emission(capsys: Captured, tmp_path: Path) -> None:
    """It stands on the page, among the tables, in the JSON of the folder, and in what is printed; not elsewhere."""

    @report_section(of=ThermalReport)
    def warmest(report: ThermalReport) -> Section:
        most = max(emitter.temperature_K for emitter in report.emitters)
        return Section("warmest", "Warmest", [Table(columns("warmest [K]"), [[f"{most:g}"]], "warmest")], "Warmest")

    out = tmp_path / "out"
    try:
        words = ("thermal", "plate", "--wavelength-um", "9", "--rays", "500")
        printed = succeeds(capsys, *words)
        write_thermal(mistray.thermal(mistray.load("plate"), wavelengths_um=9, rays=500), out)
        told = json.loads(succeeds(capsys, *words, "--json"))
        other = json.loads(succeeds(capsys, "image", "cooke_triplet", "--grid", "16", "--json"))
    finally:
        remove_section(warmest)
    assert "\nWarmest\n" in printed
    assert told["sections"]["warmest"]["warmest"] == [{"warmest_K": 293}]
    assert json.loads((out / "thermal.json").read_text(encoding="utf-8"))["sections"] == told["sections"]
    assert pd.read_csv(out / "warmest.csv").warmest_K.tolist() == [293]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index('<h2 id="warmest">') < page.index('id="settings"')
    assert "sections" not in other


def test_parts_in_groups_and_folds_are_printed_and_exported() -> None:
    found = Table(columns("a"), [["1"]], "mine")
    parts = [model.PartGroup("box", [NotePart("first")]), model.Folded("more", [model.PartGroup("box", [found])])]
    sections = [Section("own", "Own", parts)]
    assert section_texts(sections) == ["Own\nfirst\nmore\na\n-\n1"]
    assert list(section_tables(sections)) == ["mine.csv"]
    assert section_record(sections)["sections"]["own"]["mine"] == [{"a": "1"}]


def test_columns_of_equal_headings_are_all_in_the_file() -> None:
    heads = columns("x", "y [W]", "rays", "y [W]", "rays")
    found = Table(heads, [["a", Estimate(1.0, 0.1), 2, Estimate(3.0, 0.2), 4]], "mine")
    table = section_tables([Section("own", "Own", [found])])["mine.csv"]
    assert table.to_dict("records") == [
        {"x": "a", "y_W": 1.0, "y_se_W": 0.1, "rays": 2, "y_2_W": 3.0, "y_2_se_W": 0.2, "rays_2": 4}
    ]

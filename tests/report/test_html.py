"""The HTML report: self-contained, well-formed, complete or absent."""

import re
from html.parser import HTMLParser

import pytest
from report.fake_scene import lens_scene
from report.fake_trace import SHARES, FakeTrace, trace_at, trace_in_colours

from mistray.analysis.ghosts import GhostReport
from mistray.errors import MistrayError
from mistray.report import Look
from mistray.report import ghosts_output as output
from mistray.report.ghosts import report as html
from mistray.report.ghosts.report import html_text, write_html
from mistray.report.ghosts_output import write_all
from mistray.report.html.render import html_parts
from mistray.report.output import writable_directory

VOID = {"meta", "img", "input", "br", "path", "use", "rect"}


class Page(HTMLParser):
    """Notes the open tags, ids, links and the cells of each row."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links, self.rows, self.svg = [], [], [], [], 0

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        if "svg" not in self.open:
            self.ids += [attributes["id"]] if "id" in attributes else []
            self.links += [attributes[key] for key in ("href", "src") if key in attributes]
        if tag == "tr":
            self.rows.append([self.open.count("table"), 0])
        if tag in ("td", "th"):
            self.rows[-1][1] += 1

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag


@pytest.fixture(scope="module")
def report():
    traces = {field: trace_at(field) for field in (0.0, 20.0)}
    return GhostReport(lens_scene(), traces, traces[0.0], {})


@pytest.fixture(scope="module")
def colours():
    traces = {field: trace_in_colours(field) for field in (0.0, 20.0)}
    return GhostReport(lens_scene(), traces, traces[0.0], {})


@pytest.fixture(scope="module")
def coloured(colours, tmp_path_factory):
    """The report with everything in it."""
    out = tmp_path_factory.mktemp("out")
    files = write_all(colours, out, per_wavelength=True, look=Look())
    return (out / "report.html").read_text(encoding="utf-8"), {file.name for file in files}


@pytest.fixture(scope="module")
def text(report):
    return html_text(report, "a <b> & c", "mistray ghosts 'a <b> & c' --rays 1e6")


def test_nothing_comes_from_the_network(text):
    without_namespaces = re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    page = Page()
    page.feed(text)
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert not re.search(r'(src|href)="(https?:)?//', without_namespaces)
    assert not re.search(r"@import|url\(\s*['\"]?http|fetch\(|XMLHttpRequest", without_namespaces)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["one wavelength", "in colours"])
def test_tags_are_balanced_and_ids_are_unique(text, coloured, kind):
    page = Page()
    page.feed(text if kind == "one wavelength" else coloured[0])
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)


@pytest.mark.parametrize("kind", ["one wavelength", "in colours"])
def test_rows_have_as_many_cells_as_their_header(text, coloured, kind):
    for table in re.findall(r"<table.*?</table>", text if kind == "one wavelength" else coloured[0], re.DOTALL):
        counts = {len(re.findall(r"<t[dh][ >]", row)) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)}
        assert len(counts) == 1


def test_names_are_escaped(text):
    assert "a <b> & c" not in text
    assert "Ghost analysis: a &lt;b&gt; &amp; c" in text


@pytest.mark.parametrize(
    "words",
    [
        "mistray ghosts",
        "3.9.1",
        "closure",
        "W/mm²",
        "few rays: its numbers have no errors",
        "detector → L1_rear",
        "one standard error",
        "max_events",
    ],
)
def test_report_says(text, words):
    assert words in text


def test_every_field_has_its_table_and_thumbnails(text):
    for name, paths in (("t-field-0", 5), ("t-field-20", 4)):
        table = re.search(rf'<table id="{name}".*?</table>', text, re.DOTALL)[0]
        assert table.count("data:image/png;base64,") == paths
        assert table.count('class="pick"') == paths
        assert len(re.findall(r"(?:1e-?\d+ … 1e-?\d+|dark)<br>", table)) == paths  # the scale of each


def test_a_failure_leaves_nothing(report, tmp_path, monkeypatch):
    def fail(*_):
        raise RuntimeError("out of paper")

    monkeypatch.setattr(html, "html_text", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_html(report, tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def undrawn(monkeypatch):
    """Reports of one picture and one word, for tests of what happens to the files."""
    monkeypatch.setattr(output, "draw", lambda report, _: ({"overview.png": b"picture"}, report))
    monkeypatch.setattr(output, "pages", lambda *_: {"report.html": b"text"})


def test_write_all_writes_every_file(report, tmp_path):
    files = write_all(report, tmp_path / "out", "x", "mistray ghosts x")
    assert sorted(file.name for file in files) == sorted(entry.name for entry in (tmp_path / "out").iterdir())
    names = {file.name for file in files}
    assert not {name for name in names if name.startswith("colour") or "per_wavelength" in name}
    assert {
        "report.html",
        "paths.csv",
        "overview.png",
        "ghosts_0deg.png",
        "layout_20deg.png",
        "path_sort_0deg.txt",
    } <= names
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("shares", [None, SHARES])
def test_write_all_of_a_detector_in_the_dark(tmp_path, shares):
    dark = FakeTrace([], shares=shares)
    report = GhostReport(lens_scene(), {0.0: dark}, dark, {})
    write_all(report, tmp_path / "out", per_wavelength=True, look=Look() if shares else None)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "No stray path reaches the detector." in text
    assert "no direct light reaches the detector on axis" in text


def test_write_all_fails_without_a_trace(report, undrawn, tmp_path, monkeypatch):
    def fail(*_):
        raise RuntimeError("out of ink")

    monkeypatch.setattr(output, "pages", fail)
    with pytest.raises(RuntimeError, match="out of ink"):
        write_all(report, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_write_all_keeps_files_of_others(report, undrawn, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "paths.csv").write_text("old")
    write_all(report, tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "paths.csv").read_text().startswith("field_deg,")


def test_output_directory_that_is_a_file_is_an_error(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(MistrayError, match="out' is a file"):
        writable_directory(tmp_path / "out")


def test_missing_directories_are_made(report, undrawn, tmp_path):
    write_all(report, tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b" / "report.html").read_text() == "text"
    assert (tmp_path / "a" / "b" / "overview.png").read_bytes() == b"picture"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_report_in_colours(coloured):
    text, files = coloured
    assert {"colour_0deg.png", "colour_20deg.png", "paths_per_wavelength.csv"} <= files
    assert "450, 550, 650 nm with 25, 50, 25 % of the flux" in text
    assert "the detector in colour, field 20°" in text
    for name in ("t-summary-waves", "t-waves-field-20", "t-energy-450", "t-energy-650", "t-surfaces-wavelengths"):
        assert f'id="{name}"' in text


def test_a_path_has_one_row_in_its_field_and_one_for_each_wavelength_below(coloured):
    text, _ = coloured
    table = re.search(r'<table id="t-field-0".*?</table>', text, re.DOTALL)[0]
    waves = re.search(r'<table id="t-waves-field-0".*?</table>', text, re.DOTALL)[0]
    assert table.count("detector → L1_rear") == 1
    assert waves.count("detector → L1_rear") == 3
    assert "λ" in waves
    assert "λ" not in table


def test_without_the_flags_there_are_no_colours(text):
    assert "in colour" not in text
    assert "At each wavelength" not in text


def test_assumptions_name_the_polarisation(text, report, monkeypatch):
    assert "Unpolarised light at every surface" in text
    assert "as a Stokes vector" not in text
    monkeypatch.setitem(report[0.0].settings, "polarization", "stokes")
    said = html_parts(html._settings(report, "").parts)
    assert "as a Stokes vector" in said
    assert "the light of the source is unpolarised" in said
    monkeypatch.setitem(report[0.0].settings, "source_stokes", {"laser": (0.6, 0.0, -0.8)})
    said = html_parts(html._settings(report, "").parts)
    assert "0.6, 0, -0.8 (laser)" in said
    assert "unpolarised;" not in said

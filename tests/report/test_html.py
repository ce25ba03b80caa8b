"""The HTML report of ghosts: names, coatings, colours and wavelengths on its page; its files are all there or none."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import html_pages
import pytest
from report.fake_trace import SHARES, FakeTrace, ghosts_of, trace_at, trace_in_colours

import mistray
from mistray.analysis.ghosts import GhostReport
from mistray.errors import MistrayError
from mistray.report import Look, write_all
from mistray.report import ghosts_output as output
from mistray.report.ghosts import report as html
from mistray.report.ghosts.report import html_text, write_html
from mistray.report.html.render import html_parts
from mistray.report.output import writable_directory
from mistray.surfaces.surfaces import SurfaceTable


@pytest.fixture(scope="module")
def report() -> GhostReport:
    return ghosts_of(*map(trace_at, (0.0, 20.0)))


@pytest.fixture(scope="module")
def written(report: GhostReport, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, set[str]]:
    """The page, and the names of all files."""
    out = tmp_path_factory.mktemp("plain") / "out"
    files = write_all(report, out, "a <b> & c", "mistray ghosts 'a <b> & c' --rays 1e6")
    assert sorted(file.name for file in files) == sorted(entry.name for entry in out.iterdir())
    return (out / "report.html").read_text(encoding="utf-8"), {file.name for file in files}


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, set[str]]:
    """The same with everything in it."""
    report, out = ghosts_of(*map(trace_in_colours, (0.0, 20.0))), tmp_path_factory.mktemp("out")
    files = write_all(report, out, per_wavelength=True, look=Look())
    return (out / "report.html").read_text(encoding="utf-8"), {file.name for file in files}


def test_page_of_one_wavelength(written: tuple[str, set[str]], coloured: tuple[str, set[str]]) -> None:
    text, names = written
    html_pages.check(text)
    assert "a <b> & c" not in text
    assert "Ghost analysis: a &lt;b&gt; &amp; c" in text
    assert {"paths.csv", "overview.png", "ghosts_0deg.png", "layout_20deg.png", "path_sort_0deg.txt"} <= names
    for name, paths in (("t-field-0", 5), ("t-field-20", 4)):
        table = html_pages.table_of(text, name)
        assert table.count("data:image/png;base64,") == table.count('class="pick"') == paths
    assert not {name for name in names if name.startswith("colour") or "per_wavelength" in name}
    assert "in colour" not in text
    # The page in colours
    text, names = coloured
    html_pages.check(text)
    assert {"colour_0deg.png", "colour_20deg.png", "paths_per_wavelength.csv"} <= names
    assert "450, 550, 650 nm with 25, 50, 25 % of the flux" in text
    assert "the detector in colour, field 20°" in text
    for name in ("t-summary-waves", "t-waves-field-20", "t-energy-450", "t-energy-650", "t-surfaces-wavelengths"):
        assert f'id="{name}"' in text
    # One row for each path of a field, and one for each wavelength below
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
        ("source_stokes", {"laser": (0.6, 0.0, -0.8)}, "0.6, 0, -0.8 (laser)"),
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
    def fail(*_: Any) -> None:
        raise RuntimeError("out of paper")

    monkeypatch.setattr(html, "html_text", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_html(report, tmp_path / "report.html")
    monkeypatch.setattr(output, "draw", lambda report, _: ({"overview.png": b"picture"}, report))
    monkeypatch.setattr(output, "pages", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_all(report, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
    # Files of others stay, and folders are made
    monkeypatch.setattr(output, "draw", lambda report, _: ({"overview.png": b"picture"}, report))
    monkeypatch.setattr(output, "pages", lambda *_: {"report.html": b"text"})
    out = tmp_path / "a" / "b"
    write_all(report, out)
    (out / "notes.txt").write_text("mine")
    (out / "paths.csv").write_text("old")
    write_all(report, out)
    assert (out / "notes.txt").read_text() == "mine"
    assert (out / "paths.csv").read_text().startswith("field_deg,")
    assert ((out / "report.html").read_text(), (out / "overview.png").read_bytes()) == ("text", b"picture")
    with pytest.raises(MistrayError, match="is a file; name a directory"):
        writable_directory(out / "notes.txt")

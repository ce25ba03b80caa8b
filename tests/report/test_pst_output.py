"""Files of a PST: complete, named as documented, and a report that is self-contained and well-formed."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from report.fake_pst import fake_pst

from mistray.errors import MistrayError
from mistray.report.html.render import html_page
from mistray.report.pst_output import pst_report, write_pst

VOID = {"meta", "img", "input", "br", "path", "use", "rect"}


class Page(HTMLParser):
    """Notes the open tags, ids and links."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        if "svg" not in self.open:
            self.ids += [attributes["id"]] if "id" in attributes else []
            self.links += [attributes[key] for key in ("href", "src") if key in attributes]

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    pst = fake_pst(field_deg=range(0, 81, 10), azimuths_deg=(0, 90, 180), map_pixels=8)
    out = tmp_path_factory.mktemp("pst") / "new" / "out"
    files = write_pst(pst, out, "a <b> & c", "mistray pst 'a <b> & c'", 3, [(20.0, 90.0), (40.0, 0.0)])
    return pst, out, files


def test_files_are_those_listed(written) -> None:
    _, out, files = written
    names = {file.name for file in files}
    assert names == {entry.name for entry in out.iterdir()}
    assert names == {
        "pst.csv",
        "pst_cells.csv",
        "pst_paths.csv",
        "pst.png",
        "pst_causes.png",
        "pst_map.png",
        "irradiance_20deg_90deg.png",
        "irradiance_40deg_0deg.png",
        "pst.json",
        "report.html",
    }
    for file in files:
        if file.suffix == ".png":
            assert file.read_bytes().startswith(b"\x89PNG")


def test_fewer_files_of_a_simpler_pst(tmp_path: Path) -> None:
    files = write_pst(fake_pst(field_deg=(0, 20), paths=False), tmp_path)
    assert {file.name for file in files} == {"pst.csv", "pst.png", "pst.json", "report.html"}


def test_csv_holds_nine_digits(written) -> None:
    pst, out, _ = written
    curve = pd.read_csv(out / "pst.csv")
    assert curve.pst_stray.to_list() == pytest.approx(list(pst.stray), rel=1e-8)
    assert set(curve.convention) == {"normal"}
    assert len(pd.read_csv(out / "pst_cells.csv")) == 27
    paths = pd.read_csv(out / "pst_paths.csv")
    assert len(paths) == len(pst.path_rows)
    assert {"angle_deg", "azimuth_deg", "rank", "events", "pst", "pst_se", "percent_of_stray"} <= set(paths.columns)


def test_json_names_scene_and_command(written) -> None:
    _, out, _ = written
    record = json.loads((out / "pst.json").read_text(encoding="utf-8"))
    assert (record["title"], record["command"]) == ("a <b> & c", "mistray pst 'a <b> & c'")
    assert len(record["curve"]) == 9


def test_report_is_self_contained_and_well_formed(written) -> None:
    _, out, _ = written
    text = (out / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    without_namespaces = re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    assert not re.search(r"@import|url\(\s*['\"]?http|fetch\(|XMLHttpRequest", without_namespaces)
    for table in re.findall(r"<table.*?</table>", text, re.DOTALL):
        counts = {len(re.findall(r"<t[dh][ >]", row)) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)}
        assert len(counts) == 1


def test_report_says_what_matters(written) -> None:
    pst, out, _ = written
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "a <b> & c" not in text
    assert "Point source transmittance: a &lt;b&gt; &amp; c" in text
    assert "single rays carry more than 10 %" in text
    assert "%: share of the stray light at that angle" in text
    assert text.count("data:image/png;base64,") == 3
    table = re.search(r'<table id="t-paths".*?</table>', text, re.DOTALL)[0]
    assert table.count("<tr>") == 1 + 3 * len(pst.field_deg)
    assert "direct image" not in table


def test_report_of_a_dark_pst() -> None:
    text = html_page(pst_report(fake_pst(dark_from_deg=0, notes=["PST is 0: it sees no opening"])))
    assert "No light was seen at any angle." in text
    assert "it sees no opening" in text


def test_a_failure_leaves_the_old_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pst.csv").write_text("old")

    def fail(*_):
        raise RuntimeError("out of paper")

    monkeypatch.setattr("mistray.report.html.render.html_page", fail)
    with pytest.raises(RuntimeError, match="out of paper"):
        write_pst(fake_pst(field_deg=(0, 20)), tmp_path)
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("pst.csv", "old")]


def test_a_file_for_a_directory_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(MistrayError, match="is a file; name a directory"):
        write_pst(fake_pst(field_deg=(0, 20)), tmp_path / "out")

"""Reports as PDF: the parts of the model on pages of A4."""

from __future__ import annotations

import contextlib
import re

import numpy as np
import pytest
from markupsafe import Markup

from mistray.analysis.estimate import Estimate
from mistray.report.figures.figure import Figure as Drawing
from mistray.report.formats import write_formats
from mistray.report.html.embedded import palette_png
from mistray.report.model import FigurePart, Folded, Html, Items, Map, NotePart, Report, Section, Table, Terms, columns
from mistray.report.pdf import _cell, _Writer, pdf_bytes


def pages_of(pdf: bytes) -> int:
    assert pdf.startswith(b"%PDF")
    return len(re.findall(rb"/Type /Page\b", pdf))


def texts_of(pdf: bytes, key: str) -> list[str]:
    """Texts of the document that are not drawn: titles of the outline and what pictures show."""
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
    def draw():
        drawn = Drawing(figsize=(4, 3))
        drawn.subplots().plot([0, 1], [0, 1])
        return drawn

    dot = palette_png(np.zeros((9, 9), dtype=np.uint8), np.zeros((1, 3), dtype=np.uint8))
    parts = [
        NotePart("$x_{1}$ **no** markdown & <tags> ± → λ"), NotePart("a heading", "h3"),
        NotePart("mistray --help", "pre"),
        Items([Markup("a <b>bold &amp; true</b> word")], "verdict"), Items(["one", "two"]), NotePart("word " * 4000),
        Terms([("name", "value")]),
        FigurePart(dot, "a dot", "a black dot"), FigurePart(draw, "a line"),
        Map(np.ones((3, 4)), (0.0, 4.0, 0.0, 3.0), "a map"),
        wide_table(70), Table(columns("none"), []), Html("<script>1</script>"), Folded("behind", [NotePart("hidden")]),
    ]  # fmt: skip
    sections = [Section("a", "First (part)", parts), Section("b", "Folded", [NotePart("x")], folded="always")]
    pdf = pdf_bytes(Report("Heading", "scene", sections, warnings=["careful"]))
    assert 4 <= pages_of(pdf) <= 12  # of which the long paragraph takes four
    assert "First (part)" in texts_of(pdf, "Title")
    assert {"a black dot", "a line", "a map"} <= set(texts_of(pdf, "Alt"))
    assert all(float(size) == pytest.approx(595.28) for size in re.findall(rb"/MediaBox \[0 0 ([\d.]+)", pdf))


def test_tables_are_no_wider_than_the_page():
    table = wide_table(3)
    rows = [[column.head for column in table.columns], *([_cell(value) for value in row] for row in table.rows)]
    with contextlib.closing(_Writer("title")) as writer:
        _, widths = writer._widths(rows, [column.style == "t" for column in table.columns])
        size, narrow = writer._widths([["a", "b"], ["1", "2"]], [True, False])
        assert sum(widths) <= writer.pdf.epw + 1e-6
    assert min(widths) > 3
    assert (size, sum(narrow) < 20) == (7.0, True)
    assert [_cell(value) for value in (Estimate(1.5, 0.1), "a </ b")] == ["1.50\n± 0.10", "a </ b"]


def test_written_beside_the_page(tmp_path):
    report = Report("Heading", "scene", [Section("a", "First", [NotePart("text")])], page="objects.html")
    (path,) = write_formats(["pdf"], tmp_path, {}, {}, report=report)
    assert path.name == "objects.pdf"
    assert pages_of(path.read_bytes()) == 1

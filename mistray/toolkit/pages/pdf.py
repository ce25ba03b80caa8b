"""Report as a PDF document of A4 pages, made without a browser from the same `Report` as its page.

Sections that are always folded, `Folded` parts and HTML appear only on the page. The document names these sections, and
holds the summaries of these parts.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from hashlib import sha256
from html import unescape
from pathlib import Path

import matplotlib
from markupsafe import Markup

from mistray.estimate import Estimate
from mistray.files.packages import format_package
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages import model
from mistray.toolkit.pages.output import csv_text
from mistray.toolkit.pages.render import drawn_map
from mistray.toolkit.tables.text import cell_text
from mistray.toolkit.typeset import typeset, value_and_error
from mistray.trace.forward import versions

MARGIN, POINT = 12.0, 25.4 / 72  # mm
FONT, MONO = "DejaVu Sans", "DejaVu Sans Mono"
TEXT, SMALL, TITLE, HEAD, SUBHEAD = 9.5, 7.5, 15.0, 12.0, 10.0  # points
TABLE_SIZES = (7.0, 6.5, 6.0, 5.5, 5.0)  # points; the first at which a table fits
LINE = 1.35  # distance of lines, in font sizes
PADDING, NARROWEST = 1.0, 12.0  # mm: beside a cell, and the least width of a column of text
LEAD_HEIGHT, MOST_HEIGHT = 74.0, 150.0  # mm, of pictures on the first page and of others
ROOM, PICTURE_ROOM = 35.0, 110.0  # mm that a heading needs below it
BELOW = 9.0  # mm below a picture, for its caption
SMALLEST = 0.6  # of its size, to which a picture may shrink to stay on the page
PNG_PER_INCH = 140.0  # pixels of finished pictures
DRAWN_DPI = 170
INK, SOFT, RULE, WARN = (27, 31, 36), (87, 96, 106), (213, 218, 224), (213, 94, 0)
_TAG = re.compile(r"<[^>]*>")


def pdf_bytes(report: model.Report) -> bytes:
    """
    Return a report as PDF.

    Parameters
    ----------
    report : Report
        Report to write.

    Raises
    ------
    MistrayError
        If fpdf2 is not installed.
    """
    with contextlib.closing(_Writer(f"{report.heading}: {report.title}")) as writer:
        _write(report, writer)
        return bytes(writer.pdf.output())


def _write(report: model.Report, writer: _Writer) -> None:
    writer.heading(f"{report.heading}: {report.title}", TITLE, 0)
    writer.title_block(report)
    writer.parts(report.lead, LEAD_HEIGHT)
    if report.warnings:
        writer.parts([model.Items(report.warnings, "warnings")])
    for section in report.sections:
        if section.folded != "always":
            drawn = any(isinstance(part, model.FigurePart | model.Map) for part in section.parts[:2])
            writer.heading(section.title, HEAD, 1, PICTURE_ROOM if drawn else ROOM)
            writer.parts(section.parts)
    folded = [section.title for section in report.sections if section.folded == "always"]
    if folded:
        writer.text(f"In {report.page}: {', '.join(folded)}.", SMALL, SOFT)


class _Writer:
    """
    Writer that sets the parts of a report one below the other on PDF pages.

    Attributes
    ----------
    pdf : fpdf.FPDF
        Document.
    """

    def __init__(self, title: str) -> None:
        class Document(format_package("pdf").FPDF):  # type: ignore[misc]
            def footer(self) -> None:
                self.set_y(-9)
                self.set_font(FONT, size=SMALL)
                self.set_text_color(*SOFT)
                self.cell(0, 4, f"{title}   {self.page_no()}/{{nb}}", align="R")

        pdf = self.pdf = Document(format="A4")
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        for family, style, file in (
            (FONT, "", "DejaVuSans"),
            (FONT, "B", "DejaVuSans-Bold"),
            (MONO, "", "DejaVuSansMono"),
        ):
            pdf.add_font(family, style, fonts / f"{file}.ttf")
        pdf.set_margin(MARGIN)
        pdf.set_auto_page_break(True, MARGIN + 2)
        pdf.set_title(title)
        pdf.set_creator("mistray")
        pdf.set_lang("en")
        pdf.add_page()

    def close(self) -> None:
        """Close the font files, which stay open until the document is finished."""
        for font in self.pdf.fonts.values():
            font.ttfont.close()

    def parts(self, parts: Sequence[model.PagePart], most: float = MOST_HEIGHT) -> None:
        """
        Write parts of a report; pictures are at most `most` mm high.

        Of a `Folded` part only the summary is written, of `Html` and `Filter` nothing.
        """
        for part in parts:
            if isinstance(part, model.Table):
                self.table(part)
            elif isinstance(part, model.NotePart):
                self.note(part)
            elif isinstance(part, model.Items):
                self.items(part)
            elif isinstance(part, model.Terms):
                self.terms(part)
            elif isinstance(part, model.FigurePart):
                self.figure(part, most)
            elif isinstance(part, model.Map):
                self.figure(drawn_map(part), most)
            elif isinstance(part, model.PartGroup):
                self.parts(part.parts, most)
            elif isinstance(part, model.Folded):
                self.text(f"▸ {part.summary}", SMALL, SOFT)

    def heading(self, text: str, size: float, level: int, room: float = ROOM) -> None:
        """
        Write a heading, `size` points high, and its entry in the outline, with `room` mm left below it on the page.

        `level` is its level in the outline: 0 for the title, 1 for a section, which gets a line below.
        """
        self.room(room)
        if level:
            self.pdf.ln(3)
        self.pdf.start_section(text, level=level)
        self.text(text, size, bold=True)
        if level == 1:
            self.rule()

    def title_block(self, report: model.Report) -> None:
        """Write system, analysis, date, program and, if there are tables, their checksum, between two lines."""
        tables = "".join(csv_text(frame, report.in_full) for frame in report.csv.values())
        program = ", ".join(f"{name} {version}" for name, version in versions().items())
        pairs = [
            ("system", report.title),
            ("analysis", report.heading),
            ("date", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
            ("computed with", program),
            *([("checksum of the tables", f"SHA-256 {sha256(tables.encode()).hexdigest()[:16]}")] if tables else []),
        ]
        self.rule()
        self.terms(model.Terms(pairs))
        self.rule()

    def rule(self) -> None:
        """Draw a line across the page."""
        self.pdf.set_draw_color(*RULE)
        self.pdf.line(MARGIN, self.pdf.y, MARGIN + self.pdf.epw, self.pdf.y)
        self.pdf.ln(1.5)

    def note(self, note: model.NotePart) -> None:
        if note.style == "h3":
            self.room(ROOM / 2)
            self.pdf.ln(1.5)
            self.text(note.text, SUBHEAD, bold=True)
        elif note.style == "pre":
            self.text(note.text, SMALL, family=MONO)
        else:
            soft = note.style in ("note", "sub")
            self.text(note.text, SMALL if note.style == "note" else TEXT, SOFT if soft else INK)

    def items(self, items: model.Items) -> None:
        if items.style == "verdict":
            for text in items.texts:
                self.text(text, TEXT + 1)
            return
        if items.style == "warnings":
            self.text("Warnings", TEXT, WARN, bold=True)
        for text in items.texts:
            self.text(Markup("• {}").format(text) if isinstance(text, Markup) else f"• {text}", TEXT)
        self.pdf.ln(1)

    def terms(self, terms: model.Terms) -> None:
        from fpdf.enums import TableBordersLayout

        self._font(SMALL)
        widest = max((self.pdf.get_string_width(name) for name, _ in terms.pairs), default=0.0)
        first = min(widest + 2 * PADDING + 2, 0.35 * self.pdf.epw)
        with self.pdf.table(
            col_widths=(first, self.pdf.epw - first), first_row_as_headings=False, text_align="LEFT", align="LEFT",
            v_align="TOP", borders_layout=TableBordersLayout.NONE, line_height=SMALL * LINE * POINT,
        ) as table:  # fmt: skip
            for pair in terms.pairs:
                row = table.row()
                for text in pair:
                    row.cell(typeset(text))
        self.pdf.ln(1.5)

    def figure(self, figure: model.FigurePart, most: float) -> None:
        """Write a picture with its caption, at its natural size if that fits; it is at most `most` mm high."""
        if callable(figure.picture):
            drawn = figure.picture()
            drawn.set_dpi(DRAWN_DPI)
            png, per_inch = as_png(drawn), float(DRAWN_DPI)
        else:
            png, per_inch = figure.picture, PNG_PER_INCH
        across, down = _size(png)
        scale = min(25.4 / per_inch, self.pdf.epw / across, most / down)
        left = self.pdf.page_break_trigger - self.pdf.y - BELOW
        if SMALLEST * down * scale <= left < down * scale:  # a little smaller, so that no heading stands alone
            scale = left / down
        self.room(down * scale + BELOW - 1)
        self.pdf.image(
            io.BytesIO(png),
            x=MARGIN + (self.pdf.epw - across * scale) / 2,
            w=across * scale,
            h=down * scale,
            alt_text=figure.text or figure.caption,
        )
        self.pdf.set_x(MARGIN)
        if figure.caption:
            self.text(figure.caption, SMALL, SOFT)
        self.pdf.ln(1)

    def table(self, table: model.Table) -> None:
        """
        Write a table as wide as needed; if it is wider than the page, its font shrinks, then text is wrapped.

        A table without rows is left out, and so are columns of event letters. A long table is cut as in printed text,
        see `Table.most`.
        """
        from fpdf.enums import TableBordersLayout
        from fpdf.fonts import FontFace

        if not table.rows:
            return
        table = table.kept(
            [k for k, value in enumerate(table.rows[0]) if not (isinstance(value, model.Fold) and value.of_letters)]
        )
        short = table.rows if table.most is None else table.rows[: table.most]
        rest = [table.rest] if table.rest and len(short) < len(table.rows) else []
        heads = [f"{column.head}\n{column.unit}" if column.unit else column.head for column in table.columns]
        rows = [heads, *([_cell(value) for value in row] for row in (*short, *rest))]
        left = [column.style.split(" ")[0] in ("t", "path") for column in table.columns]
        size, widths = self._widths(rows, left)
        self._font(size)
        self.pdf.set_draw_color(*RULE)
        with self.pdf.table(
            col_widths=widths, width=sum(widths), align="LEFT", text_align=["LEFT" if own else "RIGHT" for own in left],
            borders_layout=TableBordersLayout.HORIZONTAL_LINES, line_height=size * 1.25 * POINT, v_align="TOP",
            headings_style=FontFace(emphasis="BOLD"), padding=(0.4, PADDING),
        ) as drawn:  # fmt: skip
            for texts in rows:
                row = drawn.row()
                for text in texts:
                    row.cell(text)
        self.pdf.ln(2)

    def _widths(self, rows: Sequence[Sequence[str]], left: Sequence[bool]) -> tuple[float, list[float]]:
        """
        Return the size of the font, points, and the widths of the columns, mm, that fit a table on the page.

        The first of `rows` holds the headings; `left` is True for columns of text. If no size fits, the smallest is
        used and columns of text are narrowed. All are if that is not enough.
        """
        room, widths = self.pdf.epw, [0.0]
        for size in TABLE_SIZES:
            widths = []
            for column in zip(*rows, strict=True):
                self._font(size, bold=True)
                head = max(map(self.pdf.get_string_width, column[0].split() or [""]))  # at blanks it breaks
                self._font(size)
                lines = [line for text in column[1:] for line in text.split("\n")]
                widths.append(max(head, *map(self.pdf.get_string_width, lines)) + 2 * PADDING + 0.5)
            if sum(widths) <= room:
                return size, widths
        texts = sum(width for width, own in zip(widths, left, strict=True) if own)
        too_much = sum(widths) - room
        if texts - too_much >= NARROWEST * sum(left) > 0:
            share = (texts - too_much) / texts
            widths = [width * share if own else width for width, own in zip(widths, left, strict=True)]
        return TABLE_SIZES[-1], [width * room / sum(widths) for width in widths]

    def text(
        self,
        text: str,
        size: float,
        colour: tuple[int, int, int] = INK,
        bold: bool = False,
        family: str = FONT,
    ) -> None:
        """
        Write a paragraph with a font size in points, in a colour (RGB) and a font family.

        In `Markup`, text within <b> is bold.
        """
        self.pdf.set_text_color(*colour)
        self.pdf.set_x(MARGIN)
        pieces = re.split(r"</?b>", text) if isinstance(text, Markup) else [text]
        with self.pdf.text_columns() as columns, columns.paragraph(line_height=LINE) as paragraph:
            for number, piece in enumerate(pieces):
                self._font(size, bold or number % 2 == 1, family)
                plain = _plain(piece) if isinstance(text, Markup) else piece
                paragraph.write(plain if family == MONO else typeset(plain))
        self.pdf.ln(1)
        self.pdf.set_text_color(*INK)

    def room(self, height: float) -> None:
        """Start a new page if less than `height` mm is left on this one."""
        if self.pdf.will_page_break(min(height, self.pdf.eph)):
            self.pdf.add_page()

    def _font(self, size: float, bold: bool = False, family: str = FONT) -> None:
        self.pdf.set_font(family, "B" if bold and family == FONT else "", size)


def _cell(value: model.Value) -> str:
    if isinstance(value, model.Noted):
        return f"{_cell(value.number)}\n{typeset(value.note)}"
    if isinstance(value, model.HtmlCell):
        return _plain(Markup(value.html))
    text = cell_text(value)
    return "\n".join(filter(None, value_and_error(text))) if isinstance(value, Estimate) else typeset(text)


def _plain(text: str) -> str:
    """Return text without its HTML tags and entities; a break of the line remains one."""
    return unescape(_TAG.sub("", text.replace("<br>", "\n")))


def _size(png: bytes) -> tuple[int, int]:
    """Return the width and height of a PNG file, pixels, from its header."""
    return int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")

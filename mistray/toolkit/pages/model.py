"""Elements of a report: sections of tables, pictures, maps and texts. Renderers turn them into HTML, text and JSON.

A text is plain and escaped where a page shows it; `Markup` of markupsafe stands for text with tags of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from mistray.estimate import Estimate

if TYPE_CHECKING:
    import pandas as pd

    from mistray.files.irradiance_files import IrradianceMap
    from mistray.files.ray_sets import RaySet
    from mistray.toolkit.figures.figure import Figure as Drawing


@dataclass(frozen=True)
class Fold:
    """A cell of a page that opens: what stands in it, and what it shows when it is opened."""

    summary: str
    text: str
    style: str = "t"


@dataclass(frozen=True)
class Noted:
    """A number with a remark below it."""

    number: Estimate
    note: str


@dataclass(frozen=True)
class StyledCell:
    """Text with a CSS class that differs from that of its column."""

    text: str
    style: str


@dataclass(frozen=True)
class Link:
    """Text that leads to a place on the same page."""

    text: str
    anchor: str


@dataclass(frozen=True)
class HtmlCell:
    """A whole cell as HTML, for what only a page shows."""

    html: str


Value = str | int | Estimate | Fold | Noted | StyledCell | Link | HtmlCell
"""Of a cell. Text and whole numbers stand as they are, an `Estimate` with its standard error."""


@dataclass(frozen=True)
class Column:
    """Heading and unit of a column, and its CSS class on a page; class "t" is flush left, in text too."""

    head: str
    unit: str = ""
    style: str = ""

    @classmethod
    def of(cls, text: str) -> Column:
        """A column from "head [unit]"; "<head [unit]" is flush left."""
        found = re.fullmatch(r"(<?)(.*?)(?: ?\[(.*)\])?", text)
        assert found is not None
        return cls(found[2], found[3] or "", "t" if found[1] else "")


def columns(*given: str | Column) -> list[Column]:
    """Columns from their short forms, see `Column.of`."""
    return [Column.of(one) if isinstance(one, str) else one for one in given]


class PagePart:
    """A part of a section; `kind` says which."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Table(PagePart):
    """
    A table with a heading and a unit for each column.

    Attributes
    ----------
    columns : sequence of Column
    rows : sequence of sequence of Value
    name : str
        Id on a page, and name of the table in JSON and of its CSV file.
    sortable : bool
        Whether a click on a page sorts it.
    filter : (str, str), optional
        A `Filter` above it: what stands in it, and what screen readers say.
    fold : str
        Text of the line that opens the table on a page; empty: it is open.
    most : int, optional
        Rows at most in text.
    rest : sequence of Value
        A row in text that stands for those left out.
    empty : str
        What stands in text for a table without rows.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    name: str = ""
    sortable: bool = True
    filter: tuple[str, str] | None = None
    fold: str = ""
    most: int | None = None
    rest: Sequence[Value] = ()
    empty: str = ""
    kind: ClassVar[str] = "table"

    def rows_in_text(self, most: int | None = None) -> list[Sequence[Value]]:
        """Return the rows that a text shows, at most so many or `most`, and one for the rest."""
        most = self.most if most is None else most
        rows = list(self.rows if most is None else self.rows[:most])
        return [*rows, self.rest] if len(self.rows) > len(rows) and self.rest else rows

    def without(self, *heads: str) -> Table:
        """Return the table without some columns."""
        kept = [k for k, column in enumerate(self.columns) if column.head not in heads]
        rows = [[row[k] for k in kept] for row in self.rows]
        rest = [self.rest[k] for k in kept] if self.rest else ()
        return replace(self, columns=[self.columns[k] for k in kept], rows=rows, rest=rest)

    def beside(self, *others: Table) -> Table:
        """Return the table with the columns of others, which have as many rows, on its right."""
        rows = [[*chain(*parts)] for parts in zip(self.rows, *(one.rows for one in others), strict=True)]
        return replace(self, columns=[*self.columns, *(c for one in others for c in one.columns)], rows=rows)


@dataclass(frozen=True)
class Filter(PagePart):
    """A field on a page that leaves the rows of a table that hold some words; `label` is for screen readers."""

    table: str
    placeholder: str
    label: str
    kind: ClassVar[str] = "filter"


@dataclass(frozen=True)
class NotePart(PagePart):
    """
    A text of its own; `style` "note" is small print, "h3" a heading, "pre" a command, "sub" what was computed.

    A heading with an `anchor` can be linked to.
    """

    text: str
    style: str = ""
    anchor: str = ""
    kind: ClassVar[str] = "note"


Note = NotePart  # its name before version 0.3


@dataclass(frozen=True)
class Items(PagePart):
    """Short texts as a list; `style` "warnings" is a box, "verdict" the result of all in a few sentences."""

    texts: Sequence[str]
    style: str = ""
    kind: ClassVar[str] = "items"


@dataclass(frozen=True)
class Terms(PagePart):
    """Words and what they mean, or names and values."""

    pairs: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "terms"


@dataclass(frozen=True)
class Hover:
    """Values of a plot that stand beside the pointer: places along x, a heading for each, and names with values."""

    name: str
    x: Sequence[float]
    titles: Sequence[str]
    values: Sequence[Sequence[tuple[str, str]]]


@dataclass(frozen=True)
class FigurePart(PagePart):
    """
    A picture.

    Attributes
    ----------
    picture : bytes or callable
        PNG, or what draws a figure of Matplotlib, which a page holds as SVG.
    caption, text : str
        Below it; and what it shows, for those who do not see it (default: the caption).
    hover : Hover, optional
        Of a drawn figure, along x of its first axes.
    """

    picture: bytes | Callable[[], Drawing]
    caption: str = ""
    text: str = ""
    hover: Hover | None = None
    kind: ClassVar[str] = "figure"


@dataclass(frozen=True)
class Map(PagePart):
    """
    A quantity over the detector, which a page shows on a log10 scale.

    Attributes
    ----------
    values : (H, W) float
        The first row is that of the smallest y.
    extent_mm : (float, float, float, float)
        x0, x1, y0, y1 of the detector.
    title, unit : str
    name : str
        Of the map in JSON.
    """

    values: npt.NDArray[np.float64]
    extent_mm: tuple[float, float, float, float]
    title: str = ""
    unit: str = "W/mm²"
    name: str = ""
    kind: ClassVar[str] = "map"


@dataclass(frozen=True)
class Html(PagePart):
    """Finished HTML, for what only a page can do."""

    html: str
    kind: ClassVar[str] = "html"


@dataclass(frozen=True)
class Folded(PagePart):
    """Parts of a page behind a line that opens them, which can be linked to if it has an `anchor`."""

    summary: str
    parts: Sequence[PagePart]
    style: str = ""
    anchor: str = ""
    kind: ClassVar[str] = "folded"


@dataclass(frozen=True)
class PartGroup(PagePart):
    """Parts of a page that belong together, with a CSS class."""

    style: str
    parts: Sequence[PagePart]
    kind: ClassVar[str] = "group"


@dataclass(frozen=True)
class Section:
    """
    A chapter of a report.

    Attributes
    ----------
    anchor : str
        Id on a page.
    title : str
    parts : sequence of PagePart
    link : str
        Its name among the links at the top of a page; empty: it has none.
    folded : {"", "screen", "always"}
        Whether a page shows the title alone until it is opened; "screen": on paper it is open.
    """

    anchor: str
    title: str
    parts: Sequence[PagePart]
    link: str = ""
    folded: str = ""


@dataclass(frozen=True)
class Report:
    """
    All that a command writes.

    Attributes
    ----------
    heading, title : str
        What was computed, and the name of the optical system.
    sections : sequence of Section
    lead : sequence of PagePart
        Below the title: the result in a few sentences.
    warnings : sequence of str
        What a reader must know before trusting the numbers.
    tab : str
        Heading in the title of the window (default: `heading`).
    contents : bool
        Whether the links are a list of contents, above the warnings.
    scripts : sequence of {"report", "hover", "drawing", "explorer"}
        What the page can do: sort and filter tables, show the values of plots, explore the paths of a field.
    csv : mapping of str to DataFrame
        Tables with full precision by file name.
    json : mapping of str to mapping
        Values for JSON by file name.
    files : mapping of str to str or bytes
        Pictures and other files by name.
    page : str
        File name of the page.
    result
        What it shows; the sections that users add are made from it. None: they are there, or there can be none.
    in_full : bool
        Whether numbers in CSV have all of their digits; else nine.
    maps : mapping of str to IrradianceMap
        By file name without ending, for further formats.
    rays : mapping of str to RaySet
        Likewise.
    """

    heading: str
    title: str
    sections: Sequence[Section]
    lead: Sequence[PagePart] = ()
    warnings: Sequence[str] = ()
    tab: str = ""
    contents: bool = False
    scripts: Sequence[str] = ("report",)
    csv: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    json: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    page: str = "report.html"
    result: Any = None
    in_full: bool = False
    maps: Mapping[str, IrradianceMap] = field(default_factory=dict)
    rays: Mapping[str, RaySet] = field(default_factory=dict)

"""Elements of a report: sections of tables, pictures, maps and texts. Renderers turn them into HTML, text and JSON.

Plain text is escaped on a page; `Markup` of markupsafe marks text that contains tags.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
    """Text of a table cell that unfolds on a click: a summary, the text shown when open, and the cell's CSS class."""

    summary: str
    text: str
    style: str = "t"

    @property
    def of_letters(self) -> bool:
        """True if the summary is the letters of a path's events, of use only beside the text."""
        return self.style.startswith("path")


@dataclass(frozen=True)
class Noted:
    """Number with its standard error and a remark, as content of a table cell."""

    number: Estimate
    note: str


@dataclass(frozen=True)
class StyledCell:
    """Text of a table cell with a CSS class different from its column's."""

    text: str
    style: str


@dataclass(frozen=True)
class Link:
    """Text that links to an anchor on the same page."""

    text: str
    anchor: str


@dataclass(frozen=True)
class HtmlCell:
    """Table cell given as HTML, for content that only a page can show."""

    html: str


Value = str | int | Estimate | Fold | Noted | StyledCell | Link | HtmlCell
"""Value of a cell; text and whole numbers are shown unchanged, an `Estimate` with its standard error."""


@dataclass(frozen=True)
class Column:
    """Heading and unit of a table column, and its CSS class on a page; class "t" is left-aligned, also in text."""

    head: str
    unit: str = ""
    style: str = ""

    @classmethod
    def of(cls, text: str) -> Column:
        """Return a column from "head [unit]", or left-aligned from "<head [unit]"; the unit may be missing."""
        found = re.fullmatch(r"(<?)(.*?)(?: ?\[(.*)\])?", text)
        assert found is not None
        return cls(found[2], found[3] or "", "t" if found[1] else "")


def columns(*given: str | Column) -> list[Column]:
    """Return table columns from their short forms "head [unit]", see `Column.of`."""
    return [Column.of(one) if isinstance(one, str) else one for one in given]


class PagePart:
    """Base class of the parts of a section; `kind` names the type for the templates."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Table(PagePart):
    """
    Table with a heading and a unit for each column.

    Attributes
    ----------
    columns : sequence of Column
        Headings and units.
    rows : sequence of sequence of Value
        Cells of each row, in the order of the columns.
    name : str
        Id on a page, and name of the table in JSON and of its CSV file.
    sortable : bool
        Whether a click on a heading sorts the table on a page.
    filter : (str, str), optional
        Placeholder and screen-reader label of a `Filter` above the table; None: there is none.
    fold : str
        Text of the line that opens the table on a page; empty: it is open.
    most : int, optional
        Largest number of rows in text; None: all rows.
    rest : sequence of Value
        Row in text that replaces those left out; empty: none does.
    empty : str
        Text in place of a table without rows.
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
        """
        Return the rows printed as text: at most `most`, or if that is None at most as many as the table says.

        If rows are left out, the row `rest` follows, unless it is empty.
        """
        most = self.most if most is None else most
        rows = list(self.rows if most is None else self.rows[:most])
        return [*rows, self.rest] if len(self.rows) > len(rows) and self.rest else rows

    def without(self, *heads: str) -> Table:
        """Return a copy of the table without the columns of these headings."""
        return self.kept([k for k, column in enumerate(self.columns) if column.head not in heads])

    def kept(self, kept: Sequence[int]) -> Table:
        """Return a copy of the table with only the columns at the indices `kept`, in the order of these indices."""
        rows = [[row[k] for k in kept] for row in self.rows]
        rest = [self.rest[k] for k in kept] if self.rest else ()
        return replace(self, columns=[self.columns[k] for k in kept], rows=rows, rest=rest)

    def beside(self, *others: Table) -> Table:
        """
        Return the table with the columns of other tables on its right; all have as many rows, else `ValueError`.

        The row `rest` is that of all tables if this one has it. The cells of others without one are empty there.
        """
        rows = [[*chain(*parts)] for parts in zip(self.rows, *(one.rows for one in others), strict=True)]
        more = chain(*(one.rest or [""] * len(one.columns) for one in others))
        return replace(
            self,
            columns=[*self.columns, *(c for one in others for c in one.columns)],
            rows=rows,
            rest=[*self.rest, *more] if self.rest else (),
        )


@dataclass(frozen=True)
class Filter(PagePart):
    """
    Input field on a page that filters the rows of a table by words.

    `table` is the id of the table, `label` is for screen readers.
    """

    table: str
    placeholder: str
    label: str
    kind: ClassVar[str] = "filter"


@dataclass(frozen=True)
class NotePart(PagePart):
    """
    Text in a report: a paragraph, or by `style` small print ("note"), a heading ("h3") or a command ("pre").

    The style "sub" is for the computed quantity. A heading with an `anchor` can be linked to.
    """

    text: str
    style: str = ""
    anchor: str = ""
    kind: ClassVar[str] = "note"


Note = NotePart  # its name before version 0.3


@dataclass(frozen=True)
class Items(PagePart):
    """List of short texts; `style` "warnings" shows them in a box, "verdict" as the result in a few sentences."""

    texts: Sequence[str]
    style: str = ""
    kind: ClassVar[str] = "items"


@dataclass(frozen=True)
class Terms(PagePart):
    """List of words with their meanings, or of names with values."""

    pairs: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "terms"


@dataclass(frozen=True)
class Hover:
    """Values that a plot shows at the pointer; for the attributes see the parameters of `hover_figure`."""

    name: str
    x: Sequence[float]
    titles: Sequence[str]
    values: Sequence[Sequence[tuple[str, str]]]


@dataclass(frozen=True)
class FigurePart(PagePart):
    """
    Picture in a report, with its caption.

    Attributes
    ----------
    picture : bytes or callable
        PNG, or a function that draws a Matplotlib figure, which a page holds as SVG.
    caption, text : str
        Caption below the picture, and description for screen readers (default: the caption).
    hover : Hover, optional
        Values along x of the first axes of a drawn figure; None: it shows none.
    """

    picture: bytes | Callable[[], Drawing]
    caption: str = ""
    text: str = ""
    hover: Hover | None = None
    kind: ClassVar[str] = "figure"


@dataclass(frozen=True)
class Map(PagePart):
    """
    Quantity over the detector, shown on a page on a log10 scale.

    Attributes
    ----------
    values : (H, W) float
        Values in `unit`; row 0 is at the smallest y.
    extent_mm : (float, float, float, float)
        Extent x0, x1, y0, y1 on the detector, mm.
    title, unit : str
        Heading of the map, and unit of its values.
    name : str
        Name of the map in JSON.
    """

    values: npt.NDArray[np.float64]
    extent_mm: tuple[float, float, float, float]
    title: str = ""
    unit: str = "W/mm²"
    name: str = ""
    kind: ClassVar[str] = "map"


@dataclass(frozen=True)
class Html(PagePart):
    """Part given as HTML, for content that only a page can show."""

    html: str
    kind: ClassVar[str] = "html"


@dataclass(frozen=True)
class Folded(PagePart):
    """
    Parts of a page that unfold on a click on a line, the `summary`.

    `style` is a CSS class, and `anchor` an id for links; empty: there is none.
    """

    summary: str
    parts: Sequence[PagePart]
    style: str = ""
    anchor: str = ""
    kind: ClassVar[str] = "folded"


@dataclass(frozen=True)
class PartGroup(PagePart):
    """Group of page parts in one HTML element with a CSS class."""

    style: str
    parts: Sequence[PagePart]
    kind: ClassVar[str] = "group"


def without_groups(parts: Iterable[PagePart]) -> Iterator[PagePart]:
    """
    Yield parts in order, with the parts of groups and folds in place of these.

    The summary of a fold comes before its parts, as a note.
    """
    for part in parts:
        if isinstance(part, Folded):
            yield NotePart(part.summary)
        if isinstance(part, Folded | PartGroup):
            yield from without_groups(part.parts)
        else:
            yield part


@dataclass(frozen=True)
class Section:
    """
    Chapter of a report.

    Attributes
    ----------
    anchor : str
        Id on a page.
    title : str
        Heading of the chapter.
    parts : sequence of PagePart
        Tables, pictures and texts, in order.
    link : str
        Name in the links at the top of a page; empty: no link.
    folded : {"", "screen", "always"}
        "": the chapter is open. Otherwise a page shows only its title until a click; with "screen" it is open on paper.
    """

    anchor: str
    title: str
    parts: Sequence[PagePart]
    link: str = ""
    folded: str = ""


@dataclass(frozen=True)
class Report:
    """
    Full output of a command: page, tables, JSON and pictures.

    Attributes
    ----------
    heading, title : str
        Computed quantity, and name of the optical system.
    sections : sequence of Section
        Chapters, in order.
    lead : sequence of PagePart
        Parts below the title: the result in a few sentences.
    warnings : sequence of str
        Warnings that limit how far the numbers can be trusted.
    tab : str
        Heading in the title of the window (default: `heading`).
    contents : bool
        Whether the links form a list of contents above the warnings.
    scripts : sequence of {"report", "hover", "drawing", "explorer"}
        Scripts of the page: sort and filter tables, show values of plots, draw the section, explore paths.
    csv : mapping of str to DataFrame
        Tables with full precision by file name.
    json : mapping of str to mapping
        JSON-serialisable values by file name.
    files : mapping of str to str or bytes
        Pictures and other files by name.
    page : str
        File name of the page.
    result
        Result from which sections that users add are made. None: they are already added, or there are none.
    in_full : bool
        Whether numbers in CSV have all digits; else nine.
    maps : mapping of str to IrradianceMap
        Irradiance maps, W/mm², by file name without ending, for further formats.
    rays : mapping of str to RaySet
        Rays by file name without ending, for the format "dat".
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

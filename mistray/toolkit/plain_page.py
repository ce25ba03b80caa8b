"""Generic text, JSON and report page for analyses without their own: tables and figures, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from mistray.files.json_values import plain
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, Report, Section
from mistray.toolkit.pages.parts import settings_section
from mistray.toolkit.rows import frame, records, table
from mistray.toolkit.tables.text import parts_text

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure

Rows = tuple[type, Sequence[Any]]


class Tabled(Protocol):
    """
    Interface of a result that a `PlainPage` can show.

    It may also have attributes `notes`, its warnings, and `facts`, its settings by name.
    """

    def tables(self) -> Mapping[str, Rows]:
        """Return the row class and the rows of each table, by name of the table."""

    def figures(self) -> Mapping[str, Callable[[], Figure]]:
        """Return a function that draws each figure, by name of the figure."""


@dataclass(frozen=True)
class PlainPage:
    """
    Generic output of a result: text, JSON and report page.

    Attributes
    ----------
    name : str
        Name of the command, and of its JSON file.
    heading : str
        Heading of the report: the computed quantity.
    """

    name: str
    heading: str

    def text(self, result: Tabled) -> str:
        """Return all tables as text, followed by the notes."""
        shown = [table(*rows, name) for name, rows in result.tables().items()]
        return "\n".join([parts_text(shown), *(f"warning: {note}" for note in _notes(result))])

    def record(self, result: Tabled) -> dict[str, Any]:
        """Return all tables as JSON-serialisable values, with notes and facts."""
        found: dict[str, Any] = {name: records(*rows) for name, rows in result.tables().items()}
        return dict(plain(found | {"notes": _notes(result), "facts": _facts(result)}))

    def page(self, result: Tabled, title: str, command: str) -> Report:
        """
        Return the report: a section for each figure and each table, with the CSV, JSON and PNG files.

        `title` is the name of the optical system, and `command` the command line; empty: none.
        """
        drawn, tables = result.figures(), result.tables()
        pictures = [Section(f"figure-{name}", _words(name), [FigurePart(draw)]) for name, draw in drawn.items()]
        shown = [
            Section(name, _words(name), [table(*rows, f"t-{name}")], _words(name)) for name, rows in tables.items()
        ]
        return Report(
            self.heading,
            title,
            [*pictures, *shown, settings_section(_facts(result), command)],
            warnings=_notes(result),
            csv={f"{name}.csv": frame(*rows) for name, rows in tables.items()},
            json={f"{self.name}.json": {"title": title, "command": command} | self.record(result)},
            files={f"{name}.png": as_png(draw()) for name, draw in drawn.items()},
            result=result,
        )


def _notes(result: Any) -> list[str]:
    return [str(note) for note in getattr(result, "notes", ())]


def _facts(result: Any) -> dict[str, Any]:
    return dict(getattr(result, "facts", {}))


def _words(name: str) -> str:
    return name.replace("_", " ").capitalize()

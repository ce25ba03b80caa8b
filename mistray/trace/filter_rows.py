"""Rows that a filter of paths and rays is evaluated on: events, columns, and names that exist."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import DIRECT, STRAY_KINDS, Events

if TYPE_CHECKING:
    from mistray.recorders.ledger import DecodedPaths
    from mistray.surfaces.surfaces import SurfaceTable

SURFACE_COLUMNS = ("ghost_1", "ghost_2", "scatter_1", "last_object", "critical")


class Bounds(NamedTuple):
    """Whether a filter holds for certain, and whether it may hold, by row; they differ where a ray is to decide."""

    certain: np.ndarray
    possible: np.ndarray


def exactly(held: np.ndarray) -> Bounds:
    """Return the bounds where nothing is left to a ray."""
    return Bounds(held, held)


@dataclass(frozen=True)
class Rows:
    """
    Rows that a filter is evaluated on.

    Attributes
    ----------
    events : Events
        Events of each row.
    parts : sequence of str
        Parts of the places of events.
    columns : mapping of str to (n,) array
        Columns by name.
    by_ray : frozenset of str
        Names of columns that a ray has and a path does not: the filter may hold for rays of a path, and may not.
    surfaces : int
        Number of places that are surfaces; the others are media.
    sources : sequence of str
        Ids of all sources of the scene; empty: any text may be one.
    """

    events: Events
    parts: Sequence[str]
    columns: Mapping[str, np.ndarray]
    surfaces: int
    by_ray: frozenset[str] = field(default_factory=frozenset)
    sources: Sequence[str] = ()

    @property
    def ids(self) -> Sequence[str]:
        """Names of the places of events."""
        return self.events.ids

    def texts_of(self, column: str) -> Sequence[str]:
        """Return all texts that a column can have; empty where it can have any."""
        if column in SURFACE_COLUMNS:
            return [*self.ids, "-"]
        return {"kind": (DIRECT, *STRAY_KINDS), "source": self.sources, "detector": self.ids}.get(column, ())


class UnknownError(Exception):
    """Name that the scene or the table does not have."""


def places(name: str, rows: Rows) -> np.ndarray:
    """Return which places of events a name means, (s,)."""
    # A misspelt name is an error: that it selects nothing would go unnoticed
    found = named_like(name, rows.ids, rows.parts)
    if not found.any():
        raise UnknownError(unknown_name(name, rows.ids, rows.parts))
    return found


def named_like(name: str, ids: Sequence[str], parts: Sequence[str]) -> np.ndarray:
    """Return which surfaces or materials have this name or this part, (s,); * and ? stand for any letters."""
    # A surface has both an id and a part, and either may be meant
    fits = like_pattern(name)
    return np.array([any(map(fits, pair)) for pair in zip(ids, parts, strict=True)], dtype=bool)


def unknown_name(name: str, ids: Sequence[str], parts: Sequence[str]) -> str:
    """Return the message for a name that does not exist."""
    return f"no surface, part or material is called '{name}'{like(name, [*ids, *parts])}"


def like_pattern(name: str) -> Callable[[str], bool]:
    """Return a predicate: whether a text is this name, in which * and ? stand for any letters and any one letter."""
    # Not `fnmatch`, in which square brackets would be classes of letters
    pattern = re.compile(re.escape(name).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
    return lambda text: pattern.fullmatch(text) is not None


def like(name: str, known: Iterable[str]) -> str:
    """Return the end of a message: the nearest name that exists, or a list of the first few."""
    names = list(dict.fromkeys(known))
    # A single suggestion where one is close, by difflib's ratio of at least 0.5
    near = difflib.get_close_matches(name, names, 1, 0.5)
    return f"; did you mean '{near[0]}'?" if near else f"; use one of {', '.join(names[:12])}"


class RunPaths(NamedTuple):
    """Ledger of a run: contents, start rays by batch (BATCHES,), flux of one (W), surfaces, design, source."""

    paths: DecodedPaths
    started: np.ndarray
    unit: float
    table: SurfaceTable
    design: DesignSequences
    source: str

    def events(self, place: np.ndarray) -> Events:
        """Return the events of the paths at these places of the ledger."""
        return Events.of(self.table, self.design, self.paths.events[place], self.paths.lengths[place])

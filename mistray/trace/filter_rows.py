"""Rows of a path or ray table to which filters apply, and checks that the names in a filter exist."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mistray.events import INTERCEPTS
from mistray.recorders.path_events import DIRECT, STRAY_KINDS, Events

SURFACE_COLUMNS = ("ghost_1", "ghost_2", "scatter_1", "last_object", "critical")


class Bounds(NamedTuple):
    """Result of a filter as two masks of rows, (n,): those that pass for certain, and those that may pass in part."""

    certain: np.ndarray
    possible: np.ndarray


def exactly(held: np.ndarray) -> Bounds:
    """Return a mask of rows, (n,), as both bounds of a filter that treats all rays of a path alike."""
    return Bounds(held, held)


@dataclass(frozen=True)
class Rows:
    """
    Rows of a table of paths or rays on which a filter is evaluated.

    Attributes
    ----------
    events : Events
        Events of each row.
    parts : sequence of str
        Part to which each place of events, a surface or medium, belongs.
    columns : mapping of str to (n,) array
        Columns by name.
    by_ray : frozenset of str
        Names of columns that a ray has and a path does not: the filter may hold for rays of a path, and may not.
    surfaces : int
        Number of places that are surfaces; the others are media.
    sources : sequence of str
        Ids of all sources of the scene; empty: any string may be one.
    """

    events: Events
    parts: Sequence[str]
    columns: Mapping[str, np.ndarray]
    surfaces: int
    by_ray: frozenset[str] = field(default_factory=frozenset)
    sources: Sequence[str] = ()

    def texts_of(self, column: str) -> Sequence[str]:
        """Return the strings that can occur in a column; empty if any string can."""
        if column in SURFACE_COLUMNS:
            return [*self.events.ids, "-"]
        surfaces = dict.fromkeys(("surface", "detector"), self.events.ids)
        types = {"type": ("Emitted", *INTERCEPTS.values())}
        return ({"kind": (DIRECT, *STRAY_KINDS), "source": self.sources} | surfaces | types).get(column, ())


class UnknownError(Exception):
    """Exception for a filter with the name of a surface, medium or column that the scene or the table does not have."""


def places(name: str, rows: Rows) -> np.ndarray:
    """Return a mask of the surfaces and media that match a name, (s,) bool; raise `UnknownError` if none does."""
    # A misspelt name is an error: that it selects nothing would go unnoticed
    found = named_like(name, rows.events.ids, rows.parts)
    if not found.any():
        raise UnknownError(unknown_name(name, rows.events.ids, rows.parts))
    return found


def named_like(name: str, ids: Sequence[str], parts: Sequence[str]) -> np.ndarray:
    """
    Return a mask of surfaces or media whose id or part matches a name, (s,) bool; all False if none does.

    In the name * is any text, ? one character.
    """
    # A surface has both an id and a part, and either may be meant
    fits = like_pattern(name)
    return np.array([any(map(fits, pair)) for pair in zip(ids, parts, strict=True)], dtype=bool)


def unknown_name(name: str, ids: Sequence[str], parts: Sequence[str]) -> str:
    """Return an error message for a name that matches no surface, part or material, with the closest known name."""
    return f"no surface, part or material is called '{name}'{like(name, [*ids, *parts])}"


def like_pattern(name: str) -> Callable[[str], bool]:
    """Return a function that tests whether a string matches `name`, where * stands for any text, ? for a character."""
    # Not `fnmatch`, in which square brackets would be classes of letters
    pattern = re.compile(re.escape(name).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
    return lambda text: pattern.fullmatch(text) is not None


def like(name: str, known: Iterable[str]) -> str:
    """Return the end of an error message for an unknown name: the closest known name, or the first twelve names."""
    names = list(dict.fromkeys(known))
    # A single suggestion where one is close, by difflib's ratio of at least 0.5
    near = difflib.get_close_matches(name, names, 1, 0.5)
    return f"; did you mean '{near[0]}'?" if near else f"; use one of {', '.join(names[:12])}"

"""
Selection of paths by their kind, their name in a report, or all their events.

A name is the `label` of a table, in which ``->`` may stand for the arrow, ``*`` for any letters and ``?`` for one. In a
scene of several detectors a name may leave out ``, on detector``, and a name of structure its ``(structure)``; then
it means all paths that it fits. A text of events up to a detector, ``… detector:A``, is one path. Light that was
scattered at random and light that was aimed follow the same path.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mistray.errors import MistrayWarning
from mistray.events import ABSORBED, EVENT_LETTERS, FIRST_SCATTERED, LETTERS, kind_of
from mistray.ids import event_words
from mistray.messages import Message
from mistray.recorders.path_events import ARROW, DIRECT, DIRECT_IMAGE, PAST, SCATTER_AT, STRAY_KINDS, way, way_text
from mistray.trace.filter_rows import Bounds, Rows, UnknownError, exactly, like, like_pattern, named_like, unknown_name

ALL, STRAY = "all", "stray"
KINDS = (ALL, STRAY, DIRECT, *STRAY_KINDS)
END = f":{LETTERS[ABSORBED]}"
LISTED = 3  # number of paths that a warning lists
_ARROW = re.compile(r"\s*(?:->|→)\s*")
_FLAGS = re.compile(r"\b[A-Z]\([^)]*\)")
_QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'")
_STRUCTURE = re.compile(r" \(structure(?:\+ghost)?\)$")
# Names that begin with the kind of the path, followed by the surfaces that it passes
_UNTURNED = "|".join(map(re.escape, (DIRECT_IMAGE, *STRAY_KINDS)))
_PASSED = re.compile(rf"^(?:{_UNTURNED})(?: through | {PAST} all surfaces|, on |$)")
_EVENT = re.compile(rf"(?:.*:[{EVENT_LETTERS}]|{PAST})", re.DOTALL)


@dataclass(frozen=True)
class Kind:
    """Filter of paths by class: all light, all stray light, or one kind such as "ghost"."""

    kind: str
    columns: ClassVar = frozenset({"kind"})

    def bounds(self, rows: Rows) -> Bounds:
        """Return masks of the table rows whose path is of this kind."""
        kinds = np.asarray(rows.columns["kind"])
        if self.kind == ALL:
            return exactly(np.full(len(kinds), True))
        return exactly((kinds != DIRECT) if self.kind == STRAY else (kinds == self.kind))


@dataclass(frozen=True)
class Whole:
    """Filter that selects one path by its complete list of events."""

    text: str
    columns: ClassVar = frozenset({"events"})

    def bounds(self, rows: Rows) -> Bounds:
        """Return masks of the rows whose path has exactly these events; raise `UnknownError` for unknown ones."""
        _check_events(event_words(self.text), rows)
        requested = way_text([" ".join(event_words(self.text))])[0]
        return exactly(np.array([one == requested for one in way_text(rows.columns["events"])], dtype=bool))


@dataclass(frozen=True)
class Named:
    """Filter that selects the paths whose name, as printed in tables and reports, matches a string."""

    text: str
    columns: ClassVar = frozenset({"label", "detector", "kind"})

    def bounds(self, rows: Rows) -> Bounds:
        """Return masks of the table rows whose path has this name; raise `UnknownError` as `check` does."""
        self.check(rows)
        fits = like_pattern(_typed_alike(self.text))
        labels = _way_labels(rows)
        ends = np.asarray(rows.columns["detector"]).tolist()
        # Few labels are of many rows, so that each is matched once
        known = {pair: any(map(fits, _forms(*pair))) for pair in set(zip(labels, ends, strict=True))}
        return exactly(np.array([known[pair] for pair in zip(labels, ends, strict=True)], dtype=bool))

    def check(self, rows: Rows) -> None:
        """Raise `UnknownError` if the name contains a surface, event or detector that does not exist."""
        text = _typed_alike(self.text)
        before, comma, detector = text.rpartition(", on ")
        if comma and not any(", on " in name for name in rows.events.ids):
            _check_pieces([detector], "", rows)
            text = before
        if _PASSED.match(text) and " through " not in text:
            return
        # Surfaces that the name contains, by the form of the name
        text = _STRUCTURE.sub("", text)
        if text.startswith(SCATTER_AT):
            _check_pieces([text.removeprefix(SCATTER_AT)], "", rows)
        elif _PASSED.match(text):
            pieces = text.split(" through ", 1)[1].split(", ")
            _check_pieces([re.sub(rf":[{EVENT_LETTERS}]$", "", piece) for piece in pieces], ", ", rows)
        elif ARROW in text:
            _check_pieces(text.split(ARROW), ARROW, rows)
        elif read_events(text) is not None:
            _check_events(_name_words(text), rows)
        else:
            _check_pieces([text], "", rows)


def read_name(text: str) -> Kind | Whole | Named | None:
    """
    Return the filter that a kind, a list of events or a path name means.

    It is None for any other string, such as an expression.
    """
    text = text.strip()
    if text in KINDS:
        return Kind(text)
    bare = _FLAGS.sub("", _QUOTED.sub("", text))
    if _ARROW.search(bare) and text.endswith(END) and (whole := read_events(text)):
        return whole  # the id of a surface may hold an arrow
    if _ARROW.search(bare) or text.startswith(SCATTER_AT) or _STRUCTURE.search(bare) or _PASSED.match(text):
        return Named(text)
    return None


def read_events(text: str) -> Whole | Named | None:
    """
    Return the filter that a list of events means: one exact path if it ends at a detector, else all of that name.

    It is None for any other string.
    """
    text = text.strip()
    if not (":" in text and all(_EVENT.fullmatch(word) for word in _name_words(text))):
        return None
    return Whole(text) if text.endswith(END) else Named(text)


def warn_unless_one(name: str, rows: Sequence[Rows], held: Sequence[np.ndarray]) -> None:
    """
    Warn if a path name matches several paths, or none of those that a trace has.

    `rows` are all paths of a trace, `held` the masks of those matched.
    """
    labels: dict[str, str] = {}
    meant: dict[str, str] = {}
    for one, here in zip(rows, held, strict=True):
        events, names = way_text(one.columns["events"]), _way_labels(one)
        labels |= zip(events, names, strict=True)
        meant |= {events[k]: names[k] for k in np.flatnonzero(here).tolist()}
    if labels and not meant:
        # A ghost between the same surfaces in the other order is the likely mistake
        backwards = ARROW.join(reversed(_typed_alike(name).split(ARROW)))
        near = f"; did you mean '{backwards}'?" if backwards in labels.values() else like(name, labels.values())
        note = Message.NO_PATH.note(name=name, near=near)
        warnings.warn(MistrayWarning(note, note.code), stacklevel=2)
    elif len(meant) > 1:
        listed = "; ".join(list(meant.values())[:LISTED]) + (" …" if len(meant) > LISTED else "")
        note = Message.SEVERAL_PATHS.note(name=name, count=len(meant), listed=listed)
        warnings.warn(MistrayWarning(note, note.code), stacklevel=2)


def _typed_alike(text: str) -> str:
    """Return a path name with ``->`` replaced by the printed arrow and with single spaces."""
    return _ARROW.sub(ARROW, " ".join(text.split()))


def _name_words(text: str) -> list[str]:
    """Return a path name split into events; the word `PAST` before an event is an item of its own."""
    found: list[str] = []
    for word in event_words(text):
        before, blank, event = word.partition(" ")
        found += [before, event] if blank and before == PAST else [word]
    return found


def _forms(label: str, detector: str) -> set[str]:
    """Return all forms in which a path name is accepted, with and without ``, on detector`` and ``(structure)``."""
    label = _typed_alike(label)
    short = label.removesuffix(f", on {detector}")
    return {label, short, _STRUCTURE.sub("", short), label.replace(short, _STRUCTURE.sub("", short), 1)}


def _way_labels(rows: Rows) -> list[str]:
    """Return the path name of each row, with aimed scatter named as ordinary random scatter."""
    labels, e = list(rows.columns["label"]), rows.events
    codes = way(e.codes)
    aimed = np.flatnonzero((e.inside & (codes != e.codes) & (kind_of(e.codes) >= FIRST_SCATTERED)).any(axis=1))
    named = replace(e, codes=codes)[aimed].labels(np.asarray(rows.columns["kind"])[aimed])
    for k, label in zip(aimed.tolist(), named, strict=True):
        labels[k] = label
    return labels


def _all_known(pieces: Sequence[str], rows: Rows) -> bool:
    return all(named_like(piece, rows.events.ids, rows.events.ids).any() for piece in pieces)


def _check_pieces(pieces: Sequence[str], between: str, rows: Rows) -> None:
    """Raise `UnknownError` unless all pieces of a name, some joined by `between`, are ids of surfaces or media."""
    while pieces:
        # The longest known id first
        for count in range(len(pieces), 0, -1):
            if _all_known([between.join(pieces[:count])], rows):
                pieces = pieces[count:]
                break
        else:
            hint = (
                "; within a filter a name of a path stands in quotation marks" if re.search("[&|]", pieces[0]) else ""
            )
            raise UnknownError(unknown_name(pieces[0], rows.events.ids, rows.events.ids) + hint)


def _check_events(words: Sequence[str], rows: Rows) -> None:
    """Raise `UnknownError` for an event such as ``lens:R`` whose surface or letter does not exist."""
    for event in words:
        surface, _, letter = event.rpartition(":")
        if event == PAST:
            continue
        if not _all_known([surface], rows):  # a wrong letter does not end its event: the next one belongs to it
            surface = next((name for name in rows.events.ids if event.startswith(f"{name}:")), surface)
            letter = event.removeprefix(f"{surface}:").split(" ")[0]
        if not _all_known([surface], rows):
            raise UnknownError(unknown_name(surface, rows.events.ids, rows.events.ids))
        if letter not in LETTERS.values():
            raise UnknownError(
                f"'{letter}' after '{surface}:' is not an event; use one of {', '.join(LETTERS.values())}"
            )

"""Event lists of paths: their text and letters, the names of paths, and the kinds of stray light."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from mistray.events import (
    AIMED_REFLECTED,
    AIMED_TRANSMITTED,
    FIRST_SCATTERED,
    INTERCEPTS,
    LETTERS,
    RANDOM_REFLECTED,
    RANDOM_TRANSMITTED,
    REFLECTED,
    TOTAL,
    TRANSMITTED,
    event_of,
    event_text,
    kind_of,
    place_of,
)
from mistray.recorders.design_sequences import DesignSequences
from mistray.surfaces.optics import DETECTOR, DIFFRACTS, MIRROR, OPAQUE, WALL
from mistray.surfaces.surfaces import SurfaceTable

# Random and aimed directions are two sampling techniques for the same path
_SAMPLED_ALIKE = {AIMED_TRANSMITTED: RANDOM_TRANSMITTED, AIMED_REFLECTED: RANDOM_REFLECTED}
_WAY_LETTERS = {LETTERS[aimed]: LETTERS[random] for aimed, random in _SAMPLED_ALIKE.items()}
_AIMED_LETTER = re.compile(f"(?<=:)[{''.join(_WAY_LETTERS)}](?= |$)")
PAST = "past"
ARROW, SCATTER_AT, DIRECT_IMAGE = " → ", "scatter at ", "direct image"
SOURCE = -1  # in place of the number of a surface
DIRECT = "direct"
STRAY_KINDS = (
    "ghost",
    "structure",
    "structure+ghost",
    "single scatter",
    "multiple scatter",
    "ghost + scatter",
    "edge diffraction",
    "diffraction + others",
    "TIR",
    "straight shot",
)


def way(events: np.ndarray) -> np.ndarray:
    """Return event lists, (p, k), with aimed scatter written as random scatter: both sample the same physical path."""
    events = events.copy()
    for aimed, random in _SAMPLED_ALIKE.items():
        events[kind_of(events) == aimed] -= np.uint32(aimed - random)
    return events


def sampled_alike(kind: int) -> tuple[int, ...]:
    """Return a kind of event and, for random scatter, that of aimed scatter, which samples the same physical path."""
    return kind, *(aimed for aimed, random in _SAMPLED_ALIKE.items() if random == kind)


def way_text(events: Iterable[str]) -> list[str]:
    """Return event lists as strings, with aimed scatter written by the letter of random scatter."""
    return [_AIMED_LETTER.sub(lambda found: _WAY_LETTERS[found[0]], text) for text in events]


def way_letters(paths: Iterable[str]) -> list[str]:
    """Return strings of event letters, with aimed scatter written by the letter of random scatter."""
    table = str.maketrans(_WAY_LETTERS)
    return [path.translate(table) for path in paths]


class PathNames:
    """
    Names of paths: the events that turn the light, and the surfaces it passes where it leaves the design sequence.

    A name follows from the events of its own path and from the scene, so that a path has one name in every table.
    Events that are not of the design are its turns: reflections, scatter, total reflection. From one turn to the next
    light usually goes by the surfaces that lie between them in the design sequence, forward or backward; then they are
    left out. Otherwise the name lists the surfaces that it passes, or has the word `PAST` where it passes none. So
    different paths have different names.

    Parameters
    ----------
    ids : sequence of str
        Names of the surfaces.
    bits : (s,) uint32
        Flags of the surfaces, see `mistray.surfaces.optics`.
    design : DesignSequences
        Sequences of the design. The names of paths to a detector without one list all the surfaces that they pass.
    """

    def __init__(self, ids: Sequence[str], bits: np.ndarray, design: DesignSequences) -> None:
        self._ids, self._bits, self._design = ids, np.asarray(bits).tolist(), design
        self._several = sum(bool(word & DETECTOR) for word in self._bits) > 1
        self._expected: dict[tuple[int, int, int], list[int]] = {}

    def name(self, codes: Sequence[int], kind: str) -> str:
        """
        Return the name of a path: its turns, and the surfaces it passes where it leaves the design sequence.

        Parameters
        ----------
        codes : sequence of int
            Events of the path, the absorption in the detector at the end.
        kind : str
            See `mistray.trace.path_row.PathRow`.
        """
        *events, end = codes
        detector, designed = place_of(end), set(self._sequence(place_of(end)))
        turns: list[int] = []
        words: list[str] = []
        passed: list[int] = []
        # Split the events at the turns; `regular` while the light follows the design sequence between them
        regular, before = True, SOURCE
        for code in codes:
            if code != end and (code in designed or kind_of(code) == TRANSMITTED):
                passed.append(code)
                continue
            # A turn, or the end: compare the surfaces passed since the last one with the design
            if passed != self._between(before, place_of(code), detector):
                regular = False
                words += [event_text(one, self._ids) for one in passed] or [PAST]
            if code != end:
                turns.append(code)
                words.append(event_text(code, self._ids))
            before, passed = place_of(code), []
        # Short name where there is one; else the turns with the surfaces passed
        if turns:
            text = self._short(turns, kind, designed) if regular else ""
            text = text or " ".join(words)
        else:
            text = DIRECT_IMAGE if kind == "direct" else kind
            if not regular:
                through = ", ".join(
                    event_text(code, self._ids).removesuffix(f":{LETTERS[TRANSMITTED]}") for code in events
                )
                text += f" through {through}" if events else f" {PAST} all surfaces"
        return f"{text}, on {self._ids[detector]}" if self._several else text

    def _short(self, turns: Sequence[int], kind: str, designed: set[int]) -> str:
        """
        Return the short name of a path of the given `kind` and event codes at its `turns`; "" if it has none.

        A path has a short name if all its turns are reflections. It has one, too, if its only turn is scatter to the
        side to which the surface sends most of its scatter. `designed` holds the codes of the design sequence.
        """
        names = [self._ids[place_of(code)] for code in turns]
        if all(kind_of(code) == REFLECTED for code in turns):
            return ARROW.join(names) + (f" ({kind})" if kind.startswith("structure") else "")
        # A surface sends most of its scatter to the side of its specular beam
        surface, what = place_of(turns[0]), kind_of(turns[0])
        reflects = bool(self._bits[surface] & OPAQUE) or event_of(surface, REFLECTED) in designed
        if len(turns) == 1 and what == (RANDOM_REFLECTED if reflects else RANDOM_TRANSMITTED):
            return f"{SCATTER_AT}{names[0]}"
        return ""

    def _sequence(self, detector: int) -> Sequence[int]:
        """Return the event codes of the first design sequence to a detector, without the absorption; () for none."""
        return next(iter(self._design.lists.get(detector, ())), ())

    def _between(self, first: int, last: int, detector: int) -> list[int]:
        """
        Return the event codes of the design sequence between surfaces `first` and `last`, in this order, from a cache.

        If a surface occurs in it several times, the shortest part counts. The list is empty where a surface is not in
        the sequence.
        """
        key = first, last, detector
        if key not in self._expected:
            sequence = self._sequence(detector)
            places: dict[int, list[int]] = {SOURCE: [-1], detector: [len(sequence)]} if sequence else {}
            for number, code in enumerate(sequence):
                places.setdefault(place_of(code), []).append(number)
            # A surface may occur several times in a sequence, as in a folded system
            pairs = list(product(places.get(first, []), places.get(last, [])))
            i, j = min(pairs, key=lambda pair: abs(pair[0] - pair[1]), default=(0, 0))
            between = sequence[min(i, j) + 1 : max(i, j)]
            self._expected[key] = list(between if i < j else between[::-1])
        return self._expected[key]


@dataclass(frozen=True)
class Events:
    """
    Event lists of paths, with masks of their events by kind and surface.

    Parameters
    ----------
    codes : (p, k) uint32
        Event codes, see `mistray.events`, padded with 0 at the ends.
    lengths : (p,) int
        Number of events of each path, at least 1.
    ids : sequence of str
        Names of the surfaces and media.
    words : (s,) uint32
        Flags of the surfaces, see `mistray.surfaces.optics`, and zeros for the media.
    design : DesignSequences
        Sequences of the direct image.
    """

    codes: np.ndarray
    lengths: np.ndarray
    ids: Sequence[str]
    words: np.ndarray
    design: DesignSequences

    @classmethod
    def of(cls, table: SurfaceTable, design: DesignSequences, codes: np.ndarray, lengths: np.ndarray) -> Events:
        """Create the events of paths from their codes, taking names and flags of surfaces from a surface table."""
        return cls(codes, lengths, table.event_ids, table.event_words, design)

    def __getitem__(self, rows: np.ndarray) -> Events:
        """Return the event lists of the paths that indices or a mask select."""
        return replace(self, codes=self.codes[rows], lengths=self.lengths[rows])

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def lists(self) -> list[list[int]]:
        """Event codes of each path, without the padding."""
        return [row[:length] for row, length in zip(self.codes.tolist(), self.lengths.tolist(), strict=True)]

    @property
    def text(self) -> list[str]:
        """Event list of each path as a string, such as "L1_front:T … detector:A"."""
        # Few different codes make up many events: each is formatted once
        codes = np.unique(self.codes).tolist()
        words = {code: event_text(code, self.ids) for code in codes}
        return [" ".join([words[code] for code in row]) for row in self.lists]

    @property
    def letters(self) -> list[str]:
        """Event letters of each path, without the names of the surfaces."""
        return ["".join([LETTERS[kind_of(code)] for code in row]) for row in self.lists]

    @property
    def intercepts(self) -> list[list[str]]:
        """Type names of each path's events, such as SpecTran, see `mistray.events`."""
        return [[INTERCEPTS[kind_of(code)] for code in row] for row in self.lists]

    def labels(self, kinds: Iterable[str]) -> list[str]:
        """Return the name of each path for people to read, given its kind; see `PathNames`."""
        names = PathNames(self.ids, self.words, self.design)
        return [names.name(row, kind) for row, kind in zip(self.lists, kinds, strict=True)]

    @property
    def places(self) -> np.ndarray:
        """Index of the surface of each event, (p, k); of a medium, its position after all surfaces."""
        return np.asarray(place_of(self.codes))

    @property
    def inside(self) -> np.ndarray:
        """Mask of true events in the padded lists, (p, k) bool; False for padding."""
        return np.asarray(np.arange(self.codes.shape[1]) < self.lengths[:, None])

    def happens(self, *what: int) -> np.ndarray:
        """Return a mask of the events of any of the given kinds, (p, k) bool; False for padding."""
        return self.inside & np.isin(kind_of(self.codes), what)

    def at(self, bit: int) -> np.ndarray:
        """Return a mask of events at surfaces that have the flag `bit`, (p, k) bool; padding is not masked out."""
        # Padding reads the flags of surface 0; callers mask it
        return (self.words[self.places] & np.uint32(bit)) != 0

    @property
    def direct(self) -> np.ndarray:
        """Mask of the paths that follow a design sequence of the detector where they end, (p,) bool."""
        return self.design.direct(self.codes, self.lengths)

    @cached_property
    def as_designed(self) -> np.ndarray:
        """Mask of events at surfaces where a design sequence of the path's detector reflects, (p, k) bool."""
        return self.inside & self.design.reflects(self.codes, self.lengths)

    @property
    def reflected(self) -> np.ndarray:
        """
        Mask of stray specular reflections, (p, k) bool.

        It leaves out total reflections, reflections at mirrors, and reflections at surfaces where a design sequence of
        the path's detector reflects.
        """
        return self.happens(REFLECTED) & ~self.at(MIRROR) & ~self.as_designed

    @property
    def on_structure(self) -> np.ndarray:
        """Mask of stray specular reflections at opaque surfaces other than the detector, (p, k) bool."""
        return self.reflected & self.at(OPAQUE) & ~self.at(DETECTOR)

    @property
    def deflected(self) -> np.ndarray:
        """Mask of the events that are scatter or diffraction, (p, k) bool."""
        return self.inside & (kind_of(self.codes) >= FIRST_SCATTERED)

    @property
    def diffracted(self) -> np.ndarray:
        """Mask of the events that are diffraction at an edge, (p, k) bool."""
        return self.happens(RANDOM_TRANSMITTED, AIMED_TRANSMITTED) & self.at(DIFFRACTS)

    @property
    def before_the_end(self) -> np.ndarray:
        """Mask of the events before the last of their path, which is at the detector, (p, k) bool."""
        return np.asarray(np.arange(self.codes.shape[1]) < self.lengths[:, None] - 1)

    @property
    def distinct_places(self) -> np.ndarray:
        """Number of different surfaces and media that each path meets, (p,)."""
        # Padding becomes -1, which sorts first and differs from nothing before it
        order = np.sort(np.where(self.inside, self.places.astype(np.int64), -1), axis=1)
        new = np.diff(order, axis=1, prepend=-1) != 0
        return np.asarray(new.sum(axis=1))


def event_keys(events: Iterable[str]) -> list[str]:
    """
    Return a hash of each event list, given as text: ten hexadecimal digits.

    It depends on nothing but the text, and is the same for random and for aimed scatter.
    """
    return [hashlib.blake2b(text.encode(), digest_size=5).hexdigest() for text in way_text(events)]


def describe_events(e: Events) -> dict[str, np.ndarray]:
    """
    Return the columns that describe each path: name, text, kind of stray light, and numbers of its events.

    Returns
    -------
    dict
        Columns key, label, events, path, order, kind, ghost_1, ghost_2, scatter_1, edges, scatters, diffractions,
        structure_bounces, tir, objects, unique_objects, last_object and critical of `PathRow`, (p,) each.
    """
    # Masks over the events
    surfaces, reflecting, scattering = e.places, e.reflected, e.deflected

    structure, scatters, diffractions = (mask.sum(axis=1) for mask in (e.on_structure, scattering, e.diffracted))
    order, total = reflecting.sum(axis=1) - structure, e.happens(TOTAL)
    # Kind, by the first condition that holds: diffraction before scatter, scatter before reflections
    kind = np.select(
        [
            (diffractions > 0) & ((scatters > diffractions) | (order + structure > 0)),
            diffractions > 0,
            (scatters > 0) & (order + structure > 0),
            scatters > 1,
            scatters == 1,
            (order > 0) & (structure > 0),
            order > 0,
            structure > 0,
            e.direct,
            (total & ~e.as_designed).any(axis=1),
        ],
        ["diffraction + others", "edge diffraction", "ghost + scatter", "multiple scatter", "single scatter",
         "structure+ghost", "ghost", "structure", DIRECT, "TIR"],
        "straight shot",
    )  # fmt: skip
    known = np.array([*e.ids, "-"], dtype=object)

    def surface(chosen: np.ndarray, n: int = 1, step: int = 1) -> np.ndarray:
        """Return the id of the place of each path's n-th event in `chosen`, (p,), or "-"; step -1: from the end."""
        here = chosen & (np.cumsum(chosen[:, ::step], axis=1)[:, ::step] == n)
        return known[np.where(here.any(axis=1), np.where(here, surfaces, 0).sum(axis=1), len(e.ids))]

    # Columns of the table
    text = e.text
    return {
        "key": np.array(event_keys(text), dtype=object),
        "label": np.array(e.labels(kind.tolist()), dtype=object),
        "events": np.array(text, dtype=object),
        "path": np.array(e.letters, dtype=object),
        "order": order,
        "kind": kind.astype(object),
        "ghost_1": surface(reflecting),
        "ghost_2": surface(reflecting, 2),
        "scatter_1": surface(scattering),
        "edges": _names(e.before_the_end & e.at(WALL) & ~e.at(OPAQUE) & ~e.at(DIFFRACTS), surfaces, e.ids),
        "scatters": scatters,
        "diffractions": diffractions,
        "structure_bounces": structure,
        "tir": total.sum(axis=1),
        "objects": e.lengths,
        "unique_objects": e.distinct_places,
        "last_object": surface(e.before_the_end, step=-1),
        "critical": surface(reflecting | scattering, step=-1),
    }


def _names(chosen: np.ndarray, surfaces: np.ndarray, ids: Sequence[str]) -> np.ndarray:
    """Return the surface ids of each path's chosen events, (p,) str, separated by spaces; "-" if there are none."""
    names = np.full(len(chosen), "-", dtype=object)
    for row in np.flatnonzero(chosen.any(axis=1)):
        names[row] = " ".join(ids[k] for k in surfaces[row][chosen[row]])
    return names

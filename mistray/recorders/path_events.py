"""What the event lists of paths say: their text, their letters and the class of each path."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mistray.ids import event_words
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_key import (
    ABSORBED,
    AIMED_REFLECTED,
    AIMED_TRANSMITTED,
    EVENT_BITS,
    RANDOM_REFLECTED,
    RANDOM_TRANSMITTED,
    REFLECTED,
    TOTAL,
    TRANSMITTED,
)
from mistray.surfaces.optics import DETECTOR, DIFFRACTS, MIRROR, OPAQUE, WALL

if TYPE_CHECKING:
    import pandas as pd

EVENT_MASK = (1 << EVENT_BITS) - 1
FIRST_SCATTERED = RANDOM_TRANSMITTED  # this event and those above it are scattered ones
INTERCEPTS = {
    ABSORBED: "Absorbed",
    TRANSMITTED: "SpecTran",
    REFLECTED: "SpecRefl",
    TOTAL: "TIR",
    RANDOM_TRANSMITTED: "RandTran",
    RANDOM_REFLECTED: "RandRefl",
    AIMED_TRANSMITTED: "ImpTran",
    AIMED_REFLECTED: "ImpRefl",
}
LETTERS = {
    ABSORBED: "A",
    TRANSMITTED: "T",
    REFLECTED: "R",
    TOTAL: "I",
    RANDOM_TRANSMITTED: "t",
    RANDOM_REFLECTED: "r",
    AIMED_TRANSMITTED: "i",
    AIMED_REFLECTED: "j",
}
# Light that is scattered at random and light that is aimed takes one and the same way
_SAMPLED_ALIKE = {AIMED_TRANSMITTED: RANDOM_TRANSMITTED, AIMED_REFLECTED: RANDOM_REFLECTED}
_WAY_LETTERS = {LETTERS[aimed]: LETTERS[random] for aimed, random in _SAMPLED_ALIKE.items()}
_AIMED_LETTER = re.compile(f"(?<=:)[{''.join(_WAY_LETTERS)}](?= |$)")
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
    """Event lists with aimed events as random ones: two paths that differ in nothing else are one way of the light."""
    events = events.copy()
    for aimed, random in _SAMPLED_ALIKE.items():
        events[(events & EVENT_MASK) == aimed] -= np.uint32(aimed - random)
    return events


def way_text(events: Iterable[str]) -> list[str]:
    """Event lists as text with the letters of random events for aimed ones too."""
    return [_AIMED_LETTER.sub(lambda found: _WAY_LETTERS[found[0]], text) for text in events]


def way_letters(paths: Iterable[str]) -> list[str]:
    """The same for letters alone."""
    table = str.maketrans(_WAY_LETTERS)
    return [path.translate(table) for path in paths]


@dataclass(frozen=True)
class Events:
    """
    What happens along paths, as masks over their events.

    Parameters
    ----------
    codes : (p, k) uint32
        Surface << EVENT_BITS | what, filled up at the ends.
    lengths : (p,) int
        Number of events of each, at least 1.
    words : (s,) uint32
        Bits of the surfaces, see `mistray.surfaces.optics`, and zeros for the media.
    design : DesignSequences
        The sequences of the direct image.
    """

    codes: np.ndarray
    lengths: np.ndarray
    words: np.ndarray
    design: DesignSequences

    def __getitem__(self, rows: np.ndarray) -> Events:
        """Those of some of the paths."""
        return Events(self.codes[rows], self.lengths[rows], self.words, self.design)

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def places(self) -> np.ndarray:
        """(p, k) numbers of the surfaces and media."""
        return np.asarray(self.codes >> EVENT_BITS)

    @property
    def inside(self) -> np.ndarray:
        """(p, k) whether a list is as long as that."""
        return np.asarray(np.arange(self.codes.shape[1]) < self.lengths[:, None])

    def happens(self, *what: int) -> np.ndarray:
        """(p, k) whether an event is one of these."""
        return self.inside & np.isin(self.codes & EVENT_MASK, what)

    def at(self, bit: int) -> np.ndarray:
        """(p, k) whether an event is at a surface that has this bit."""
        return (self.words[self.places] & np.uint32(bit)) != 0

    @property
    def direct(self) -> np.ndarray:
        """(p,) whether a path is a sequence of the design."""
        return self.design.direct(self.codes, self.lengths)

    @cached_property
    def as_designed(self) -> np.ndarray:
        """(p, k) whether an event is where a sequence of the design is reflected."""
        return self.inside & self.design.reflects(self.codes, self.lengths)

    @property
    def reflected(self) -> np.ndarray:
        """Specular reflections, those at mirrors, where the design reflects and total ones apart."""
        return self.happens(REFLECTED) & ~self.at(MIRROR) & ~self.as_designed

    @property
    def on_structure(self) -> np.ndarray:
        """Those of them at opaque surfaces other than the detector."""
        return self.reflected & self.at(OPAQUE) & ~self.at(DETECTOR)

    @property
    def deflected(self) -> np.ndarray:
        """Scattered and diffracted light."""
        return self.inside & ((self.codes & EVENT_MASK) >= FIRST_SCATTERED)

    @property
    def diffracted(self) -> np.ndarray:
        """What the ring of an edge deflects."""
        return self.happens(RANDOM_TRANSMITTED, AIMED_TRANSMITTED) & self.at(DIFFRACTS)

    @property
    def before_the_end(self) -> np.ndarray:
        """All but the last event, which is that at the detector."""
        return np.asarray(np.arange(self.codes.shape[1]) < self.lengths[:, None] - 1)


def event_text(events: np.ndarray, lengths: np.ndarray, ids: Sequence[str]) -> tuple[list[str], list[str]]:
    """
    Event lists as text.

    Parameters
    ----------
    events : (p, k) uint32
        Surface << EVENT_BITS | what, filled up at the ends.
    lengths : (p,) int
        Number of events of each.
    ids : sequence of str
        Names of the surfaces.

    Returns
    -------
    events, path : list of str
        "L1_front:T … detector:A" and the letters alone.
    """
    words = {code: f"{ids[code >> EVENT_BITS]}:{LETTERS[code & EVENT_MASK]}" for code in np.unique(events).tolist()}
    lists = [row[:length] for row, length in zip(events.tolist(), lengths.tolist(), strict=True)]
    return (
        [" ".join([words[code] for code in row]) for row in lists],
        ["".join([LETTERS[code & EVENT_MASK] for code in row]) for row in lists],
    )


def path_labels(table: pd.DataFrame) -> list[str]:
    """
    Names of the paths of a table: what they are called in short, made longer where that does not tell them apart.

    In short that is the surfaces that reflect and scatter, or the kind where none does. Paths of the same events at
    several wavelengths or from several sources have these in their names, and so have those to several detectors.

    Parameters
    ----------
    table : DataFrame
        With the columns events, kind, ghost_1, ghost_2, scatter_1 and scatters of `mistray.trace.paths.PathRow`, and
        where there are any source, wavelength_nm and detector.

    Returns
    -------
    list of str
        One for each row, none of them blank.
    """
    rows = table[["ghost_1", "ghost_2", "kind", "scatter_1", "scatters"]].itertuples(index=False)
    short = [short_label(*row) for row in rows]
    events, names = table.events.tolist(), list(short)
    ends = table["detector"].tolist() if "detector" in table else [""] * len(short)
    for end in dict.fromkeys(ends):
        here = [k for k, other in enumerate(ends) if other == end]
        for k, name in zip(here, path_names([events[k] for k in here], [short[k] for k in here]), strict=True):
            names[k] = name
    for column, form in (("wavelength_nm", "{:.9g} nm"), ("source", "{}"), ("detector", "on {}")):
        if column in table and table[column].nunique() > 1:
            count = Counter(names)
            values = table[column].tolist()
            names = [
                f"{name}, {form.format(value)}" if count[name] > 1 else name
                for name, value in zip(names, values, strict=True)
            ]
    return names


def short_label(ghost_1: str, ghost_2: str, kind: str, scatter_1: str = "-", scatters: int = 0) -> str:
    """A path in short: its ghost surfaces in the order of the light and where it scatters, or its kind."""
    ghosts = " → ".join(name for name in (ghost_1, ghost_2) if name != "-")
    if kind.startswith("structure"):
        ghosts += f" ({kind})"  # reads like the surface alone
    if scatters:
        more = f" and {scatters - 1} more" if scatters > 1 else ""
        return f"{ghosts}{', ' if ghosts else ''}scatter at {scatter_1}{more}"
    return ghosts or ("direct image" if kind == DIRECT else kind)


def path_names(events: Sequence[str], labels: Sequence[str]) -> list[str]:
    """
    Names of the paths of one table that tell them apart.

    A path keeps its label where no other path of the table has the same one. Paths that share a label are named by
    their reflections and scatter events; where these are the same too, the surfaces that the light passes on one of
    these paths and not on all of them are added; and last, if need be, all events.

    Parameters
    ----------
    events : sequence of str
        As of `event_text`, the absorption in the detector at the ends.
    labels : sequence of str
        What the paths are called in short, none of them blank.

    Returns
    -------
    list of str
        Different for different event lists.
    """
    groups: dict[str, list[int]] = {}
    for number, label in enumerate(labels):
        groups.setdefault(label, []).append(number)
    names = list(labels)
    for label, members in groups.items():
        words = {k: event_words(events[k])[:-1] for k in members}
        if len({tuple(some) for some in words.values()}) == 1:
            continue
        common = set.intersection(*(set(some) for some in words.values()))
        for form in (_turns, lambda some, common=common: _turns(some, common), " ".join):
            detail = {k: form(some) for k, some in words.items()}
            of_name: dict[str, set[tuple[str, ...]]] = {}
            for k, text in detail.items():
                of_name.setdefault(text, set()).add(tuple(words[k]))
            done = [k for k, text in detail.items() if text and len(of_name[text]) == 1]
            for k in done:
                passed_only = all(word.endswith(":T") for word in event_words(detail[k]))
                names[k] = (
                    f"{label} through {', '.join(w.removesuffix(':T') for w in event_words(detail[k]))}"
                    if passed_only
                    else detail[k]
                )
                del words[k]
        for k in words:  # it meets nothing
            names[k] = f"{label} past all surfaces"
    return names


def _turns(words: Sequence[str], common: Set[str] | None = None) -> str:
    """The events that turn the light, and those surfaces that it passes which are not common to all paths."""
    return " ".join(w for w in words if not w.endswith(":T") or (common is not None and w not in common))


def describe_events(
    events: np.ndarray, lengths: np.ndarray, ids: Sequence[str], words: np.ndarray, design: DesignSequences
) -> dict[str, np.ndarray]:
    """
    Text and classification of event lists.

    Parameters
    ----------
    events : (p, k) uint32
        Surface << EVENT_BITS | what, filled up at the ends.
    lengths : (p,) int
        Number of events of each, at least 1.
    ids : sequence of str
        Names of the surfaces.
    words : (s,) uint32
        Bits of the surfaces, see `mistray.surfaces.optics`.
    design : DesignSequences
        The sequences of the direct image.

    Returns
    -------
    dict
        Columns events, path, order, kind, ghost_1, ghost_2, scatter_1, edges, scatters, diffractions,
        structure_bounces, tir, objects, unique_objects, last_object and critical of `PathRow`, (p,) each.
    """
    e = Events(events, lengths, words, design)
    surfaces, reflecting, scattering = e.places, e.reflected, e.deflected

    structure, scatters, diffractions = (mask.sum(axis=1) for mask in (e.on_structure, scattering, e.diffracted))
    order, total = reflecting.sum(axis=1) - structure, e.happens(TOTAL)
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
    last = np.where(lengths > 1, surfaces[np.arange(len(surfaces)), np.maximum(lengths - 2, 0)], len(ids))
    text, letters = event_text(events, lengths, ids)
    return {
        "events": np.array(text, dtype=object),
        "path": np.array(letters, dtype=object),
        "order": order,
        "kind": kind.astype(object),
        "ghost_1": _nth_name(reflecting, 1, surfaces, ids),
        "ghost_2": _nth_name(reflecting, 2, surfaces, ids),
        "scatter_1": _nth_name(scattering, 1, surfaces, ids),
        "edges": _names(e.before_the_end & e.at(WALL) & ~e.at(OPAQUE) & ~e.at(DIFFRACTS), surfaces, ids),
        "scatters": scatters,
        "diffractions": diffractions,
        "structure_bounces": structure,
        "tir": total.sum(axis=1),
        "objects": lengths,
        "unique_objects": distinct(surfaces, e.inside),
        "last_object": np.array([*ids, "-"], dtype=object)[last],
        "critical": _nth_name((reflecting | scattering)[:, ::-1], 1, surfaces[:, ::-1], ids),
    }


def distinct(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """(p,) number of different values of each row, of those inside."""
    order = np.sort(np.where(inside, values.astype(np.int64), -1), axis=1)
    new = np.diff(order, axis=1, prepend=-1) != 0
    return np.asarray(new.sum(axis=1))


def _names(chosen: np.ndarray, surfaces: np.ndarray, ids: Sequence[str]) -> np.ndarray:
    """Names of the surfaces of the chosen events of each list, with blanks between, or "-"."""
    names = np.full(len(chosen), "-", dtype=object)
    for row in np.flatnonzero(chosen.any(axis=1)):
        names[row] = " ".join(ids[k] for k in surfaces[row][chosen[row]])
    return names


def _nth_name(chosen: np.ndarray, n: int, surfaces: np.ndarray, ids: Sequence[str]) -> np.ndarray:
    """Name of the surface of the n-th chosen event of each list, or "-"."""
    here = chosen & (np.cumsum(chosen, axis=1) == n)
    number = np.where(here.any(axis=1), np.where(here, surfaces, 0).sum(axis=1), len(ids))
    return np.array([*ids, "-"], dtype=object)[number]

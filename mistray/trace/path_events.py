"""What the event lists of paths say: their text, their letters and the class of each path."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from mistray.trace.ledger import (
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
from mistray.trace.optics import DETECTOR, MIRROR, OPAQUE, WALL

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


def describe_events(
    events: np.ndarray, lengths: np.ndarray, ids: Sequence[str], words: np.ndarray
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
        Bits of the surfaces, see `mistray.trace.optics`.

    Returns
    -------
    dict
        Columns events, path, order, kind, ghost_1, ghost_2, scatter_1, scatters, structure_bounces and tir of
        `PathRow`, (p,) each.
    """
    surfaces, kinds = events >> EVENT_BITS, events & EVENT_MASK
    inside = np.arange(events.shape[1]) < lengths[:, None]
    bits = words[surfaces]
    reflecting = inside & (kinds == REFLECTED) & ((bits & MIRROR) == 0)
    on_structure = reflecting & ((bits & OPAQUE) != 0) & ((bits & DETECTOR) == 0)
    scattering = inside & (kinds >= FIRST_SCATTERED)
    before_the_end = np.arange(events.shape[1]) < lengths[:, None] - 1
    past_the_optics = (lengths == 1) | (before_the_end & ((bits & WALL) != 0)).any(axis=1)

    structure, scatters = on_structure.sum(axis=1), scattering.sum(axis=1)
    order, tir = reflecting.sum(axis=1) - structure, (inside & (kinds == TOTAL)).sum(axis=1)
    kind = np.select(
        [
            (scatters > 0) & (order + structure > 0),
            scatters > 1,
            scatters == 1,
            (order > 0) & (structure > 0),
            order > 0,
            structure > 0,
            tir > 0,
            past_the_optics,
        ],
        ["ghost + scatter", "multiple scatter", "single scatter", "structure+ghost", "ghost", "structure", "TIR",
         "straight shot"],
        DIRECT,
    )  # fmt: skip
    text, letters = event_text(events, lengths, ids)
    return {
        "events": np.array(text, dtype=object),
        "path": np.array(letters, dtype=object),
        "order": order,
        "kind": kind.astype(object),
        "ghost_1": _nth_name(reflecting, 1, surfaces, ids),
        "ghost_2": _nth_name(reflecting, 2, surfaces, ids),
        "scatter_1": _nth_name(scattering, 1, surfaces, ids),
        "scatters": scatters,
        "structure_bounces": structure,
        "tir": tir,
    }


def _nth_name(chosen: np.ndarray, n: int, surfaces: np.ndarray, ids: Sequence[str]) -> np.ndarray:
    """Name of the surface of the n-th chosen event of each list, or "-"."""
    here = chosen & (np.cumsum(chosen, axis=1) == n)
    number = np.where(here.any(axis=1), np.where(here, surfaces, 0).sum(axis=1), len(ids))
    return np.array([*ids, "-"], dtype=object)[number]

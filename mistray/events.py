"""
Events of a path: interactions of its light with a surface or a medium.

An event is one integer, ``place << EVENT_BITS | kind``. The place is the index of a surface or a medium. The functions
accept integers and arrays of NumPy and Dr.Jit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple


class EventKind(NamedTuple):
    """Kind of event: its letter in the notation of a path, and its name in ray history tables."""

    letter: str
    intercept: str


KINDS = (
    # Specular events
    EventKind("A", "Absorbed"),
    EventKind("T", "SpecTran"),
    EventKind("R", "SpecRefl"),
    EventKind("I", "TIR"),
    # Scattered at random from the BSDF
    EventKind("t", "RandTran"),
    EventKind("r", "RandRefl"),
    # Aimed at a target
    EventKind("i", "ImpTran"),
    EventKind("j", "ImpRefl"),
)
# Numbers of the kinds
ABSORBED, TRANSMITTED, REFLECTED, TOTAL = range(4)
RANDOM_TRANSMITTED, RANDOM_REFLECTED, AIMED_TRANSMITTED, AIMED_REFLECTED = range(4, 8)
FIRST_SCATTERED = RANDOM_TRANSMITTED  # kinds from this one on are scatter events
EVENT_BITS = 3
EVENT_MASK = (1 << EVENT_BITS) - 1
LETTERS = {number: kind.letter for number, kind in enumerate(KINDS)}
INTERCEPTS = {number: kind.intercept for number, kind in enumerate(KINDS)}
EVENT_LETTERS = "".join(LETTERS.values())


def place_of(event: Any) -> Any:
    """Return the index of the surface or medium of each event code."""
    return event >> EVENT_BITS


def kind_of(event: Any) -> Any:
    """Return the kind of interaction (such as reflection) of each event code, as an index into `KINDS`."""
    return event & EVENT_MASK


def stays(event: Any) -> Any:
    """True where light does not pass to the other side: it is reflected, scattered back, or absorbed."""
    what = kind_of(event)
    specular = (what < FIRST_SCATTERED) & (what != TRANSMITTED)
    return specular | ((what >= FIRST_SCATTERED) & ((what & 1) != 0))


def event_of(place: Any, kind: Any) -> Any:
    """Return event codes made of the indices of surfaces or media and of kinds of interaction."""
    return (place << EVENT_BITS) | kind


def event_text(event: int, ids: Sequence[str]) -> str:
    """Return an event in letters, such as ``L1_front:T``; `ids` are the ids of surfaces and media by index."""
    return f"{ids[place_of(event)]}:{LETTERS[kind_of(event)]}"

"""
Names of paths: the events that turn the light, and the surfaces it passes where it leaves the design sequence.

A name follows from the events of its own path and from the scene, so that a path has one name in every table. Events
that are not of the design are its turns: reflections, scatter, total reflection. From one turn to the next light
usually goes by the surfaces that lie between them in the design sequence, forward or backward; then they are left out.
Otherwise the name lists the surfaces that it passes, or has the word `PAST` where it passes none. So different paths
have different names.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from mistray.events import (
    LETTERS,
    RANDOM_REFLECTED,
    RANDOM_TRANSMITTED,
    REFLECTED,
    TRANSMITTED,
    event_of,
    event_text,
    kind_of,
    place_of,
)
from mistray.recorders.design_sequences import DesignSequences
from mistray.surfaces.optics import DETECTOR, OPAQUE

PAST = "past"
ARROW, SCATTER_AT, DIRECT_IMAGE = " → ", "scatter at ", "direct image"
SOURCE = -1  # in place of the number of a surface


class PathNames:
    """
    Names of the paths of a scene, from their events and the design sequences.

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
            See `mistray.trace.paths.PathRow`.
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
        Return the short name of a path; empty where it has none.

        Paths with reflections alone have one, and those with a single scatter event on the side to which the surface
        sends most of its scatter.
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
        """Return the first sequence of the design to a detector, without the absorption there."""
        return next(iter(self._design.lists.get(detector, ())), ())

    def _between(self, first: int, last: int, detector: int) -> list[int]:
        """Return the events of the design sequence between two surfaces, at their closest occurrences."""
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

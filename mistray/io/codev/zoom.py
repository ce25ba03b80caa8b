"""Selection of the commands of one zoom position from a CODE V file.

``ZOO n`` gives the number of positions, ``ZOO command [S3 or F2] v1 … vn`` a value for each, ``command S3 Z2 v`` one
for position 2 alone, ``TIT Z2 'name'`` a name. Commands without a position apply to all positions. Solves and pick-ups
are not carried out: at another position than the first they keep their values, and the note names them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from mistray.errors import MistrayError
from mistray.io.codev.commands import HAS_NO_EFFECT, SOLVES, SeqCommand
from mistray.io.conventions import choose_position

_POSITION = re.compile(r"Z(\d{1,3})")
_PLACE = re.compile(r"(?:[SFWR]\d{1,6}|S[OIS])(?:\.\.\d{1,6})?")


class ZoomPosition:
    """
    Selected zoom position of a CODE V file.

    Parameters
    ----------
    given : int, str or None
        Number of the position from 1 on, or its name; None means the first one.

    Attributes
    ----------
    number, count : int
        Number of the position, from 1, and how many there are; both are 1 until `commands` has begun.
    names : dict
        Names of positions, by number.
    note : str
        Note on the positions that are left out, and on solves that keep the values of the first one, once `commands`
        has begun; "" if there is only one position.
    """

    def __init__(self, given: int | str | None) -> None:
        self._given = given
        self.number, self.count, self.note = 1, 1, ""
        self.names: dict[int, str] = {}

    def commands(self, found: Iterable[SeqCommand]) -> Iterator[SeqCommand]:
        """
        Yield the commands that apply at the position, with the marks of positions removed.

        Raises
        ------
        MistrayError
            If there is no such position, or a ZOO command does not have one value for each position.
        """
        every = list(found)
        for command in every:
            self._look(command)
        self.number, self.note = choose_position(self._given, 1, self.names, self.count, "zoom position")
        solved = [f"{c.text} (line {c.line})" for c in every if c.name in SOLVES and self.number != 1]
        self.note += f"; not solved anew, but as in zoom position 1: {', '.join(solved)}" if solved else ""
        for command in every:
            position = self._position(command)
            if command.name == "ZOO":
                yield from self._of_all(command)
            elif position is None:
                yield command
            elif command.name != "TIT" and position == self.number:
                place = next(k for k, word in enumerate(command.words) if _POSITION.fullmatch(word.upper()))
                yield replace(command, words=(*command.words[:place], *command.words[place + 1 :]))

    def _look(self, command: SeqCommand) -> None:
        """Record the number of zoom positions, or the name of one, if the command gives it."""
        words = command.words[1:]
        if command.name == "ZOO" and len(words) == 1 and words[0].isdecimal():
            self.count = int(words[0])
        elif command.name == "TIT" and (position := self._position(command)):
            self.names[position] = " ".join(words[1:])

    def _of_all(self, command: SeqCommand) -> Iterator[SeqCommand]:
        words = command.words[1:]
        if not words or words[0].isdecimal() or words[0].upper() == "TIT":
            return
        name, *values = words
        places = [values.pop(0)] if values and _PLACE.fullmatch(values[0].upper()) else []
        if not values:  # the values follow, position by position
            return
        plain = replace(command, words=(name, *places, values[min(self.number, len(values)) - 1]))
        if len(values) != self.count and plain.name not in HAS_NO_EFFECT:
            raise MistrayError(
                f"line {command.line}: '{command.text}': {len(values)} values for {self.count} zoom positions; "
                "give one for each"
            )
        yield plain

    @staticmethod
    def _position(command: SeqCommand) -> int | None:
        if command.name in HAS_NO_EFFECT:
            return None
        end = -1 if command.name in ("SLB", "TIT") else None  # their last word is a text, whatever it looks like
        words = [word.upper() for word in command.words[1:end]][:2]
        behind = words[1:] if words and _PLACE.fullmatch(words[0]) else [] if command.name == "SCO" else words[:1]
        match = _POSITION.fullmatch(behind[0]) if behind else None  # SCO Z5 is a term, SCO S3 Z2 C6 a position
        return int(match[1]) if match else None

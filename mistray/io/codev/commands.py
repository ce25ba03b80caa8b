"""Parser of the commands in a CODE V command file (.seq).

``!`` begins a comment, ``&`` at the end of a line continues it on the next one, ``;`` separates commands, and text
between two ``'`` or two ``"`` is one word. Case does not matter. These rules, like those of `read_codev`, follow D. C.
O'Shea and J. L. Bentley, *Designing Optics Using CODE V* (SPIE, 2018), and files that CODE V wrote.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.named_values import finite_of

ORDERS = "ABCDEFGHJ"
"""Names of the coefficients of r⁴, r⁶, … r²⁰."""

CHANGES_THE_LENS = {
    **dict.fromkeys(("SPL", "UDS", "UD1", "UD2"), "this kind of surface has no counterpart"),
    **dict.fromkeys(("DIF", "GRT", "HOE", "GRS"), "diffracting surfaces are not traced"),
    **dict.fromkeys(("MOD", "MFL", "MRD"), "a lens module has no surfaces to trace"),
    **dict.fromkeys(("GRI", "URN", "INC"), "media whose index varies are not traced"),
    **dict.fromkeys(("XOD", "YOD", "ZOD", "RET", "GLB"), "only moves relative to the surface before are read"),
    **dict.fromkeys(("NSS", "NSC"), "a non-sequential part has no order of surfaces"),
    **dict.fromkeys(("INS", "DEL", "FLI", "SCA"), "commands that edit the lens are not carried out"),
    **dict.fromkeys(("IN", "RES"), "another file is not read"),
}
"""Commands that change the lens and are not supported, with the reason for the message."""

SOLVES = ("PIM", "PIY", "CUM", "THM", "PIK", "UMY", "HMY")
"""Solves and pick-ups. Their values, which also stand in the file, are those of the first zoom position."""

HAS_NO_EFFECT = {
    **dict.fromkeys(("INI", "DES", "COM", "VER"), "a remark"),
    **dict.fromkeys(("TEM", "PRE"), "indices are those of the catalogue, near 20 °C and 1 atm"),
    **dict.fromkeys(("CWL",), "wavelength of coatings: the file has no coatings"),
    **dict.fromkeys(("GLO", "UID", "DOR"), "frame of reports, labels of the program, tolerances of its searches"),
    "SCC": "what optimisation may vary",
    **dict.fromkeys(("WTF", "WTA"), "weights of fields belong to optimisation"),
    **dict.fromkeys(("THC", "CCY", "CCX", "KC", "GLC", "CPL"), "what optimisation may vary"),
    **dict.fromkeys([f"{letter}C" for letter in ORDERS], "what optimisation may vary"),
    **dict.fromkeys(("XDC", "YDC", "ZDC", "ADC", "BDC", "CDC"), "what optimisation may vary"),
    **dict.fromkeys(SOLVES, "a solve or pick-up: the value in the file holds"),
    **dict.fromkeys(("DER", "DLT", "DLF", "DLR", "TOL", "CLS", "WID", "POL"), "nothing to trace"),
    "CA": "whether stated apertures clip rays: here they always do",
    "CUF": "curvature of the Fresnel base: 0 is none",
}
"""Commands that change no ray, with the reason for the list of unread content."""

_WORD = re.compile(r"""'[^']*'|"[^"]*"|[A-Za-z]+'[^']*'|\S+""")


@dataclass(frozen=True)
class SeqCommand:
    """
    Command of a CODE V file, as words.

    Attributes
    ----------
    line : int
        Number of the line on which the command begins, from 1.
    words : tuple of str
        Words of the command, at least one. Quotes around a word are removed, quotes inside (``L'A'``) are kept.
    text : str
        Command as written in the file; shortened if it is long.
    """

    line: int
    words: tuple[str, ...]
    text: str

    @property
    def name(self) -> str:
        """Name of the command: its first word in capitals, cut to three letters, as CODE V reads it."""
        word = self.words[0].upper()
        return word[:3] if word.isalpha() else word

    def numbers(self) -> list[float]:
        """Return the words behind the command's name as numbers; raise `MistrayError` for other words or for none."""
        if len(self.words) < 2:
            raise MistrayError(f"'{self.text}': no value; give one at least")
        return [self.number(place) for place in range(len(self.words) - 1)]

    def number(self, place: int = 0) -> float:
        """
        Return the value at a place behind the command's name, counted from 0, as a finite number.

        Raise `MistrayError` if there is no finite number there.
        """
        word = self.words[1 + place] if len(self.words) > 1 + place else ""
        value = finite_of(word)
        if value is None:
            raise MistrayError(f"'{self.text}': '{shown([word])}' is not a number; write it as in 1.5e-3")
        return value

    def positive(self, place: int = 0) -> float:
        """
        Return the value at a place behind the command's name, counted from 0, as a number above 0.

        Raise `MistrayError` if there is no such number there.
        """
        value = self.number(place)
        if value <= 0:
            raise MistrayError(f"'{self.text}': {value:g}; it must be greater than 0")
        return value


def commands(text: str) -> Iterator[SeqCommand]:
    """Yield the commands in the text of a file, in order."""
    start, parts = 0, list[str]()
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        start = start or number
        part = next(_pieces(line, "!")).rstrip()
        parts.append(part.removesuffix("&"))
        if part.endswith("&") and number < len(lines):
            continue
        for piece in _pieces(" ".join(parts), ";"):
            words = tuple(_bare(word) for word in _WORD.findall(piece))
            if words:
                yield SeqCommand(start, words, shown(piece.split()))
        start, parts = 0, []


def _pieces(line: str, separator: str) -> Iterator[str]:
    """Yield the parts of a line between separators that are not in quotes; an unpaired quote is plain text."""
    begin, place = 0, 0
    while place < len(line):
        letter = line[place]
        if letter in "'\"":
            place = max(place, line.find(letter, place + 1))
        elif letter == separator:
            yield line[begin:place]
            begin = place + 1
        place += 1
    yield line[begin:]


def _bare(word: str) -> str:
    return word[1:-1].strip() if len(word) > 1 and word[0] == word[-1] and word[0] in "'\"" else word

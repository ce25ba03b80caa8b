"""Lines of a Zemax .zmx file: a keyword and its values, first for the system, then surface by surface.

Lines of a surface are indented below their ``SURF n``; unindented lines behind the last surface are the merit function,
tolerances and configurations. Every line is taken by the reader, known to have no effect on rays, or left over.
`ZemaxSection.left` lists the lines left over, so that none gets lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mistray.errors import MistrayError
from mistray.materials.agf import decode
from mistray.materials.mate import shown
from mistray.named_values import finite_of
from mistray.prescription.sequential.table import Unread
from mistray.read_file import read_file

# Keywords whose lines say nothing about where rays go. Meanings: OpticStudio's dialogs, whose entries these lines hold
# in their order; checked against files of OpticStudio, Thorlabs and Edmund Optics.
NO_EFFECT = {
    "VERS": "version of the program",
    "AUTH": "author",
    "NOTE": "remarks",
    "DBDT": "entry of a vendor's database",
    "PFIL": "pupil filter of diffraction analyses",
    "LANG": "language",
    "RAIM": "ray aiming: how the program searches its rays",
    "PUSH": "pupil shifts of ray aiming",
    "SDMA": "margin that was added to drawn semi-diameters",
    "OMMA": "margin that was added to drawn semi-diameters",
    "ROPD": "reference of the optical path difference",
    "HYPR": "hyper-hemispheric display",
    "PICB": "display",
    "POLS": "polarisation of analyses",
    "GLRS": "surface whose frame reports call global",
    "GSTD": "Gaussian quadrature of analyses",
    "NSCD": "limits of non-sequential tracing",
    "COFN": "names of the coating, scatter and profile files",
    "FWGN": "weights of the fields",
    "FWGT": "weights of the fields",
    "TOL": "tolerances",
    "MOFF": "multi-configuration editor",
    "BLNK": "blank line of the merit function",
    "LUID": "internal number of the newest surface",
}
# Their values, which also stand in the file, are those of the configuration that it was saved in
SOLVES = {
    "PPAR": "pickup of a parameter, whose value stands in PARM",
    "PZUP": "pickup of the thickness, whose value stands in DISZ",
    "PKUP": "pickup, whose value stands in the line of its quantity",
    "MAZH": "solve for the thickness, whose value stands in DISZ",
    "CHZH": "solve for the thickness, whose value stands in DISZ",
    "EDGE": "solve for the thickness, whose value stands in DISZ",
}
NO_EFFECT_ON_SURFACE = {
    "HIDE": "drawing",
    "MIRR": "drawn substrate of a mirror",
    "SLAB": "internal label",
    "SSID": "internal number of the surface",
    "POPS": "physical optics propagation",
    "FIMP": "name of a film of impurities",
    "MEMA": "mechanical semi-diameter of the drawing",
    "OEMA": "mechanical semi-diameter of the drawing, as it was",
    "VDSZ": "thickness is a variable of the optimisation",
    "VPAR": "parameter is a variable of the optimisation",
    "VCON": "conic constant is a variable of the optimisation",
    **SOLVES,
}
# What may stand below SURF; decides what an unknown keyword belongs to where a file has no indentation
_OF_SURFACE = {
    *("TYPE", "STOP", "COMM", "CURV", "CONI", "DISZ", "GLAS", "COAT", "DIAM", "PARM", "XDAT", "SCBD", "OBDC"),
    *("CLAP", "FLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID", "UDAD", "UDOB", "USAP", "UDAP"),
    *NO_EFFECT_ON_SURFACE,
}
_OF_SYSTEM = {
    *("MODE", "NAME", "UNIT", "ENPD", "FNUM", "OBNA", "FLOA", "ENVD", "FTYP", "GCAT", "PWAV", "WAVM", "WAVL", "WAVN"),
    *("WWGT", "WWGN", "XFLN", "YFLN", "XFLD", "YFLD", "VDXN", "VDYN", "VCXN", "VCYN", "VANN", "GFAC"),
}
# The table of surfaces is over where one of these stands without indentation
_AFTER = {"TOL", "MNUM", "MOFF", "BLNK"}


@dataclass(frozen=True)
class ZemaxLine:
    """
    One line of a .zmx file.

    Attributes
    ----------
    path : Path
        File of the line.
    number : int
        Line number, from 1.
    text : str
        Line without spaces around it.
    key : str
        First word in capitals, the keyword.
    words : tuple of str
        Words behind the keyword.
    """

    path: Path
    number: int
    text: str
    key: str
    words: tuple[str, ...]

    @property
    def shown(self) -> str:
        """Text of the line for a message: shortened, with unprintable characters as codes."""
        return shown([self.key, *self.words])

    def word(self, place: int) -> str:
        """Return the word at a place behind the keyword, for a message; "" if the line is too short."""
        return shown([*self.words[place : place + 1]])

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"lens '{self.path}', line {self.number}"

    def error(self, message: str) -> MistrayError:
        """Return an error that names the file and the line."""
        return MistrayError(f"{self.where}: {message}")

    def value(self, place: int = 0, what: str = "a number") -> float:
        """
        Return the word at a place behind the keyword as a finite number.

        A decimal comma, as in some files, is accepted.

        Raises
        ------
        MistrayError
            If the word is missing or is not a finite number.
        """
        if place >= len(self.words):
            raise self.error(f"'{self.shown}' ends before {what}; complete it")
        number = finite_of(self.words[place].replace(",", "."))
        if number is None:
            raise self.error(f"'{self.word(place)}' in '{self.shown}' is not {what}; correct it")
        return number

    def whole(self, place: int = 0, what: str = "a whole number", default: int | None = None) -> int:
        """
        Return the word at a place behind the keyword as a whole number, or `default` if the line is too short.

        Raise `MistrayError` if it is not a whole number, or is missing and there is no default.
        """
        if default is not None and place >= len(self.words):
            return default
        value = self.value(place, what)
        if value != int(value):
            raise self.error(f"'{self.word(place)}' in '{self.shown}' is not {what}; correct it")
        return int(value)

    def values(self, what: str = "numbers") -> tuple[float, ...]:
        """Return all words behind the keyword as numbers; raise `MistrayError` if one is not a number."""
        return tuple(self.value(place, what) for place in range(len(self.words)))

    def unread(self, reason: str) -> Unread:
        """Return a record that the line has no effect, with the reason."""
        return Unread(self.number, self.text, reason)


class ZemaxSection:
    """
    Lines of the system, of one surface, or of the end of a file. The reader removes each line that it uses.

    `name` is that of the section, for messages, and `head` the line ``SURF n`` of a surface; None: it is no surface.
    """

    def __init__(self, name: str, head: ZemaxLine | None = None) -> None:
        self.name, self.head = name, head
        self._lines: list[ZemaxLine] = []

    def add(self, line: ZemaxLine) -> None:
        """Append a line to the section."""
        self._lines.append(line)

    def has(self, key: str) -> bool:
        """True if the section still holds a line with a keyword."""
        return any(line.key == key for line in self._lines)

    def take(self, key: str) -> ZemaxLine | None:
        """
        Remove and return the line with a keyword; None if there is none.

        Raises
        ------
        MistrayError
            If there are two or more.
        """
        found = self.take_all(key)
        if len(found) > 1:
            raise found[1].error(f"{key} of {self.name} is there already, on line {found[0].number}; remove one")
        return found[0] if found else None

    def take_all(self, *keys: str) -> list[ZemaxLine]:
        """Remove and return the lines with some keywords, in the order of the file."""
        found = [line for line in self._lines if line.key in keys]
        self._lines = [line for line in self._lines if line.key not in keys]
        return found

    def take_rest(self) -> list[ZemaxLine]:
        """Remove and return all lines that are left."""
        found, self._lines = self._lines, []
        return found

    def left(self) -> Iterator[ZemaxLine]:
        """Yield lines that the reader has not taken, unless they are known to have no effect."""
        known = NO_EFFECT if self.head is None else NO_EFFECT_ON_SURFACE
        return (line for line in self._lines if line.key not in known)


@dataclass(frozen=True)
class Sections:
    """
    Sections of a .zmx file.

    Attributes
    ----------
    system : ZemaxSection
        Lines about the whole system.
    surfaces : list of ZemaxSection
        Lines of each surface in order, the object first.
    after : ZemaxSection
        Lines of the merit function, tolerances and configurations.
    indented : bool
        Whether the lines of surfaces are indented, so that `after` can be told apart reliably.
    """

    system: ZemaxSection
    surfaces: list[ZemaxSection]
    after: ZemaxSection
    indented: bool


def read_sections(path: Path) -> Sections:
    """
    Read the lines of a .zmx file in UTF-16 or UTF-8, with or without byte order mark, else in Latin-1.

    Raises
    ------
    MistrayError
        If the file cannot be read, has no surfaces, or its surfaces are not numbered from 0 on.
    """
    text = decode(read_file(path, "lens"))
    system, after, surfaces = ZemaxSection("the system"), ZemaxSection("the end of the file"), list[ZemaxSection]()
    place, over, indented = system, False, False
    for number, raw in enumerate(text.splitlines(), 1):
        words = raw.split()
        if not words:
            continue
        line = ZemaxLine(path, number, raw.strip(), words[0].upper(), tuple(words[1:]))
        flush = not raw[0].isspace()
        if line.key == "SURF":
            if line.whole(0, "the number of the surface") != len(surfaces):
                raise line.error(
                    f"'{line.shown}' where surface {len(surfaces)} should stand; they are numbered from 0 on"
                )
            _move(after, place)
            place, over = ZemaxSection(f"surface {len(surfaces)}", line), False
            surfaces.append(place)
        elif not surfaces:
            system.add(line)
        elif over or (flush and line.key in _AFTER):
            over = True
            after.add(line)
        elif flush and line.key not in _OF_SURFACE:
            (system if line.key in NO_EFFECT or line.key in _OF_SYSTEM else after).add(line)
        else:
            indented = indented or not flush
            _move(after, place)
            place.add(line)
    if not surfaces:
        raise MistrayError(f"lens '{path}': it has no line 'SURF 0'; give a Zemax .zmx file in text form")
    return Sections(system, surfaces, after, indented)


def _move(after: ZemaxSection, place: ZemaxSection) -> None:
    """Move the lines of `after` back to a surface, as a later surface shows that the surfaces had not ended."""
    for line in after.take_rest():
        place.add(line)

"""Lookup of glasses as Zemax files name them: ``GLAS name flag pickup nd Vd dPgF …``.

Flag 0 is a glass of the catalogues that the file lists (``GCAT``); the values behind it are left over from earlier.
Flag 1 is a model glass of nd and Vd (Vd 0: no dispersion). Flag 2 is a pickup from another surface, 3 a glass that
optimisation may replace, and 4 a glass with an offset. Source: OpticStudio help, "Glass solves", in the order of its
list; checked against files that OpticStudio wrote.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from mistray.errors import errors_of
from mistray.io.glasses import FileGlasses, remedy
from mistray.io.zemax.lines import ZemaxLine
from mistray.materials.agf import glass_names
from mistray.materials.catalogue import MAKERS, PINNED, glasses
from mistray.materials.infrared import OTHER_NAMES, plain, without_page
from mistray.prescription.sequential.table import Unread

MODEL_NAMES = ("___BLANK", "MODEL")
_NO_GLASSES = ("MISC", "INFRARED")  # catalogues of what is no maker's glass
NO_DISPERSION_VD = 1e6  # and above: what writers put where a model glass without dispersion may not have Vd = 0

SYNONYMS = {
    "AIR": "air",
    "VACUUM": "air",
    "BK7": "schott/N-BK7",
    "SILICA": "fused silica",
    "F_SILICA": "fused silica",
    "C79-80": "fused silica",
    "SAPPHIRE": "sapphire",
    "CAF2": "CaF2",
    "BAF2": "BaF2",
    "LIF": "LiF",
    "GERMANIUM": "Ge",
    "SILICON": "Si",
    "ZNSE": "ZnSe",
    "ZNS_IR": "ZnS",
    "ZNS_BROAD": "ZnS",
    "CDTE": "CdTe",
    "KRS5": "KRS-5",
    "MGF2": "MgF2 crystal",
    "WATER": "water",
    "PMMA": "PMMA",
    "ACRYLIC": "PMMA",
    "POLYCARB": "PC",
    "POLYSTYR": "PS",
    "E48R": "Zeonex E48R",
}
"""Materials of mistray by names in Zemax's catalogues MISC, INFRARED and CORNING, and of obsolete Schott glasses."""


class ZemaxGlasses(FileGlasses):
    """
    Finder of materials for the glass names in a Zemax file.

    Parameters
    ----------
    catalogues : sequence of str
        Names of the file's glass catalogues, in its order.
    agf : sequence of Path
        AGF files, which take precedence over catalogues.
    replaced, wavelengths_nm
        User's replacements and wavelengths in nm, as in `FileGlasses`.

    Attributes
    ----------
    unread : list of Unread
        Parts of GLAS lines that have no effect.
    """

    def __init__(
        self,
        catalogues: Sequence[str],
        agf: Sequence[Path],
        replaced: Mapping[str, str],
        wavelengths_nm: Sequence[float],
    ) -> None:
        super().__init__(replaced, wavelengths_nm)
        self.unread: list[Unread] = []
        self._agf = [(file, {name.upper() for name in glass_names(file)}) for file in agf]
        self._catalogues = tuple(catalogues)
        self._found: dict[tuple[str, ...], str] = {}

    def material(self, line: ZemaxLine, picked_up: Mapping[int, str]) -> str:
        """
        Return the material string for a GLAS line other than MIRROR.

        Parameters
        ----------
        line : ZemaxLine
            Line of the glass.
        picked_up : mapping of int to str
            Materials of the preceding surfaces, keyed by surface number.

        Raises
        ------
        MistrayError
            If the glass is unknown or has no index at one of the wavelengths; the message names file and line.
        """
        if not line.words:
            raise line.error("GLAS without a name; write the glass")
        name, flag = line.words[0], line.whole(1, "0, 1, 2, 3 or 4", default=0)
        if flag == 2 and name.upper() in MODEL_NAMES:
            other = line.whole(2, "the surface of the pickup")
            if other not in picked_up:
                raise line.error(f"'{line.shown}' picks up the glass of surface {other}, which has none; correct it")
            return picked_up[other]
        if flag == 1:
            return self._model(line)
        if name.upper() in MODEL_NAMES:
            raise line.error(
                f"'{line.shown}' names no glass, and its flag {flag} says it is not a model glass; use flag 1"
            )
        if flag == 4:
            self.unread.append(line.unread("the glass is read, its offset of nd and Vd is not"))
        key = (name.upper(),)
        if key not in self._found:
            material = self._named(line, name)
            with errors_of(line.where):
                self._found[key] = self._checked(material, name)
        return self._found[key]

    def _model(self, line: ZemaxLine) -> str:
        nd, vd = line.value(3, "nd of the model glass"), line.value(4, "Vd of the model glass")
        offset = line.value(5, "dPgF") if len(line.words) > 5 else 0.0
        key = (repr(nd), repr(vd))
        if key not in self._found:
            constant = vd == 0 or vd >= NO_DISPERSION_VD
            text = f"{nd:.12g}" if constant else f"nd={nd:.12g} Vd={vd:.12g} k=0"
            with errors_of(line.where):
                self._found[key] = self._checked(text, text)
            if not constant:
                partial = f" and dPgF = {offset:g} is not used" if offset else ""
                self.notes.append(
                    f"model glass nd = {nd:g}, Vd = {vd:g}: its index is exact at 587.56 nm; elsewhere it follows "
                    f"a two-term Cauchy formula{partial}"
                )
        return self._found[key]

    def _named(self, line: ZemaxLine, name: str) -> str:
        if (asked := self._asked_for(name)) is not None:
            return asked
        for file, names in self._agf:
            if name.upper() in names:
                return f"{file}:{name}"
        for word in self._catalogues:  # BAF2 is a glass of CDGM and a crystal of INFRARED: the first has it
            if word.upper() in _NO_GLASSES and name.upper() in SYNONYMS:
                break
            for maker in _makers(word):
                if (found := _of_maker(maker, name)) is not None:
                    return found
        if name.upper() in SYNONYMS:
            material = SYNONYMS[name.upper()]
            if material != "air":
                self.notes.append(f"glass {name}: taken to be {material}")
            return material
        if plain(name) in OTHER_NAMES:
            self.notes.append(f"glass {name}: taken to be {OTHER_NAMES[plain(name)]}")
            return OTHER_NAMES[plain(name)]
        if (why := without_page(name)) is not None:
            raise line.error(f"glass '{line.word(0)}' {why}; {remedy(name)}")
        for maker in MAKERS:
            if (found := _of_maker(maker, name)) is not None:
                listed = (
                    f"the file's catalogues {' '.join(self._catalogues)} do" if self._catalogues else "the file does"
                )
                self.notes.append(f"glass {name}: {listed} not decide whose it is; taken to be {found}")
                return found
        raise line.error(f"glass '{line.word(0)}' is unknown; {self._remedy(name)}")

    def _remedy(self, name: str) -> str:
        known: dict[str, str] = {key: key for _, names in self._agf for key in names}
        listed = (maker for word in self._catalogues for maker in _makers(word))
        for maker in dict.fromkeys((*listed, *MAKERS)):
            for key, entry in glasses()[maker].items():
                known.setdefault(key.upper(), entry.name)
        known |= {key.upper(): key for key in PINNED if key.upper() not in known}
        # N-BAK1 for BAK1 comes before what merely looks alike
        close = [key for key in known if re.sub(r"^[A-Z]{1,2}-", "", key) == re.sub(r"^[A-Z]{1,2}-", "", name.upper())]
        close += [key for key in difflib.get_close_matches(name.upper(), known, n=3) if key not in close]
        nearest = f"like it: {', '.join(known[key] for key in close[:3])}; " if close else ""
        return nearest + remedy(name)


def _makers(catalogue: str) -> list[str]:
    """Return the makers of `MAKERS` of a catalogue of Zemax; none of MISC and others."""
    return [maker for maker in MAKERS if catalogue.lower().startswith(maker)]


def _of_maker(maker: str, name: str) -> str | None:
    wanted = name.replace("*", "star").lower()
    return next((entry.name for key, entry in glasses()[maker].items() if key.lower() == wanted), None)

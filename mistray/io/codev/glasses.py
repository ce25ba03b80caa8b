"""Lookup of glasses as CODE V files name them.

- ``NBK7_SCHOTT``: name without its hyphens, and the maker; a name alone is looked up with every maker. A name that no
  maker has may be one of `mistray.io.zemax.glasses.SYNONYMS`: ``BK7`` is read as N-BK7, and a note says so.
- ``517642``: glass code, nd - 1 in thousandths and 10 Vd. ``517.642`` and ``516800.641700`` are codes with a point
  between the digits of nd - 1 and Vd. CODE V has its own dispersion formulas for them; mistray uses `cauchy_index`
  through nd and Vd.
- ``1.5168:64.17``: nd and Vd.
- ``'E48'``: glass of the private catalogue (PRV … END), a table of n over wavelength.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.io.glasses import FileGlasses, remedy
from mistray.io.zemax.glasses import SYNONYMS
from mistray.materials.agf import glass_names
from mistray.materials.catalogue import MAKERS, PINNED, glasses
from mistray.materials.infrared import OTHER_NAMES, plain, without_page
from mistray.materials.mate import shown

_CODE = re.compile(r"(\d{1,12})\.(\d{2,12})|(\d{3})(\d{3})")
_PAIR = re.compile(r"(\d+\.?\d*):(\d+\.?\d*)")
_NEIGHBOURS = 4
_DIGITS = 7


class CodevGlasses(FileGlasses):
    """
    Finder of materials for the glass names in a CODE V file.

    Parameters
    ----------
    private : mapping of str to str
        Material strings of the private catalogue, keyed by name in capitals.
    agf : sequence of Path
        AGF files, which take precedence over the makers' catalogues.
    replaced, wavelengths_nm
        User's replacements and wavelengths in nm, as in `FileGlasses`.
    """

    def __init__(
        self,
        private: Mapping[str, str],
        agf: Sequence[str | Path],
        replaced: Mapping[str, str],
        wavelengths_nm: Sequence[float],
    ) -> None:
        super().__init__(replaced, wavelengths_nm)
        self._private = private
        self._agf = [(file, {plain(name): name for name in glass_names(Path(file))}) for file in agf]

    def material(self, word: str) -> str:
        """
        Return the material string of a glass named as in the file; its extinction k, if unknown, is set to 0.

        Raises
        ------
        MistrayError
            If no catalogue has the glass, or it has no index at one of the wavelengths.
        """
        return self._checked(self._named(word), word)

    def _named(self, word: str) -> str:
        name = word.upper()
        if (asked := self._asked_for(word)) is not None:
            return asked
        if name in self._private:
            return self._private[name]
        if match := _PAIR.fullmatch(word):
            return self._fictitious(word, float(match[1]), float(match[2]))
        if match := _CODE.fullmatch(word):
            n, v = (match[1], match[2]) if match[1] else (match[3], match[4])
            return self._fictitious(word, 1 + int(n) / 10 ** len(n), int(v) / 10 ** (len(v) - 2))
        glass, _, maker = name.rpartition("_")
        special = maker == "SPECIAL"  # CODE V's catalogue of what is no glass, such as GERMLW_SPECIAL
        if maker.lower() not in MAKERS:
            glass, maker = glass if special else name, ""
        wanted = plain(glass)
        for file, names in self._agf:
            if wanted in names:
                return f"{file}:{names[wanted]}"
        makers = [maker.lower()] if maker else list(MAKERS)
        known = {plain(key): entry.name for each in reversed(makers) for key, entry in glasses()[each].items()}
        usual = {plain(key): name for key, name in SYNONYMS.items()}
        other = OTHER_NAMES | {plain(key): key for key in PINNED} | usual
        # BAF2 is the crystal, unless the maker says that it is CDGM's glass
        if wanted in known and (maker or wanted not in (other if special else usual)):
            return known[wanted]
        if not maker and wanted in other:
            if other[wanted] != "air":
                self.notes.append(f"glass {word}: taken to be {other[wanted]}")
            return other[wanted]
        if (why := without_page(word)) is not None:
            raise MistrayError(f"glass '{shown([word])}' {why}; {remedy(word)}")
        raise self._unknown(word, wanted, known, maker)

    def _fictitious(self, word: str, nd: float, vd: float) -> str:
        self.notes.append(
            f"glass {word}: nd = {nd:.9g}, Vd = {vd:.9g}; its index is exact at 587.56 nm, elsewhere it follows a "
            "two-term Cauchy formula"
        )
        return f"nd={nd:.9g} Vd={vd:.9g}"

    def _unknown(self, word: str, wanted: str, known: Mapping[str, str], maker: str) -> MistrayError:
        close = [f"N{wanted}"] if f"N{wanted}" in known else []
        close += [key for key in difflib.get_close_matches(wanted, known, n=3) if key not in close]
        like = f" (like it: {', '.join(known[key] for key in close[:3])})" if close else ""
        return MistrayError(
            f"glass '{shown([word])}' is not in the catalogue{'' if maker else 's'} of "
            f"{maker.lower() or ', '.join(MAKERS)}{like}; {remedy(word)}"
        )


def table_material(wavelengths_nm: Sequence[float], indices: Sequence[float], used_nm: Sequence[float]) -> str:
    """
    Return the material string of a table of refractive indices over `wavelengths_nm`, with points added at `used_nm`.

    The added points, at the lens's wavelengths within the table, are interpolated by a cubic in 1/λ² through the
    nearest four. mistray interpolates tables linearly, which between points 50 nm apart gives an index error of 2e-4.
    """
    order = np.argsort(wavelengths_nm)
    x, n = np.asarray(wavelengths_nm, dtype=float)[order], np.asarray(indices, dtype=float)[order]
    points = dict(zip(x.tolist(), n.tolist(), strict=True))
    for wavelength in used_nm:
        if x[0] < wavelength < x[-1]:
            first = int(np.clip(np.searchsorted(x, wavelength) - _NEIGHBOURS // 2, 0, max(len(x) - _NEIGHBOURS, 0)))
            near = slice(first, first + _NEIGHBOURS)
            points.setdefault(wavelength, round(_lagrange(x[near] ** -2, n[near], wavelength**-2), _DIGITS))
    return " ".join(f"n({wavelength!r})={index!r}" for wavelength, index in sorted(points.items()))


def _lagrange(x: np.ndarray, y: np.ndarray, at: float) -> float:
    others = [np.delete(x, k) for k in range(len(x))]
    return float(sum(y[k] * np.prod((at - rest) / (x[k] - rest)) for k, rest in enumerate(others)))

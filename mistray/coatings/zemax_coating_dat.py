"""Coating files of Zemax OpticStudio (COATING.DAT).

    MATE name / wavelength n k                               µm; see `mistray.materials.mate`
    COAT name / material thickness is_absolute loop taper    layers, the outermost first
    COAT I.t                                                 T = 0.t, R = 1 - T
    IDEAL name T R                                           R defaults to 1 - T
    IDEAL2 name srr sri str sti prr pri ptr pti no_pi        complex amplitudes of reflection and transmission
    TABLE name / ANGL a / WAVE w Rs Rp Ts Tp Ars Arp Ats Atp degrees, µm; phases in degrees, 0 where left out
    TAPR name / …                                            variation over the aperture
    ENCRYPTED file

A thickness is in µm if ``is_absolute`` is 1. Otherwise it is in waves at the primary wavelength of the lens, which is
not in the file. Layers from one with a loop index L ≠ 0 to the next with the same index are repeated L times.
OpticStudio reverses the order where light passes from glass to air, as `Stack.first` = "outside" does. Its tables hold
the angle in the medium of lower index, like `CoatingTable.cos_rare`.

Phases: OpticStudio writes its waves exp(+iωt), so that a phase changes its sign here; 0 means that of an ordinary
mirror or window. Only the difference of s and p is kept. A coating with a taper, or an encrypted one, is an error when
it is requested. Source: OpticStudio user guide, "Defining Coatings", "The TABLE Data Section", "Specifying Coatings on
Surfaces".
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mistray.coatings.response import CoatingModel
from mistray.coatings.simple import Ideal
from mistray.coatings.stack import Layer, Stack, waves
from mistray.coatings.table import CoatingTable
from mistray.errors import MistrayError, UnknownKeyError, errors_of
from mistray.materials import complex_index, nearest_known_nm
from mistray.materials.mate import SECTIONS, numbered_lines, numbers, read_mate, shown

# In OpticStudio the last layer of a mirror's coating is its substrate, however thin. So much of a material of this k is
# opaque to 20 µm; the k of a clear substrate is raised to it
SUBSTRATE_NM, SUBSTRATE_K = 1e9, 1e-4
MOST_LAYERS = 10_000  # layers of a stack with its groups repeated
BUILT_IN = ("AIR", "VACUUM")


@dataclass
class _Section:
    """
    One coating of a Zemax coating file, as words.

    Attributes
    ----------
    kind, name : str
        First word of its first line, such as COAT, and name of the coating.
    line : int
        Line number of its first line, from 1.
    words : list of str
        Words of its first line.
    lines : list of (int, list of str)
        Line number and words of each line below.
    """

    kind: str
    name: str
    line: int
    words: list[str]
    lines: list[tuple[int, list[str]]] = field(default_factory=list)


class CoatingFile(Mapping[str, CoatingModel]):
    r"""
    Coatings of a Zemax file, by name; case does not matter.

    `read_coating_file` makes this mapping. A coating is made when it is looked up: a `Stack` from COAT, an `Ideal` from
    IDEAL and ``COAT I.t``, and a `CoatingTable` from IDEAL2 and TABLE.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("COATING.DAT").write_text("MATE MGF2\n0.55 1.38 0\nCOAT AR\nMGF2 0.25\nCOAT I.98\n")
    >>> coatings = mistray.coatings.read_coating_file("COATING.DAT")
    >>> list(coatings)
    ['AR', 'I.98']
    >>> coatings["I.98"].T
    0.98
    """

    def __init__(self, path: Path, sections: dict[str, _Section], design_nm: float) -> None:
        self.path, self.design_nm = path, design_nm
        self._sections = sections

    def __getitem__(self, name: str) -> CoatingModel:
        """
        Return the coating with a given name.

        Raises
        ------
        MistrayError
            If no coating has that name, its lines are malformed, or it needs an unsupported feature: a taper, or an
            encrypted file.
        """
        return self._make(self._find(name), mirror=False)

    def __iter__(self) -> Iterator[str]:
        return (section.name for section in self._sections.values())

    def __len__(self) -> int:
        return len(self._sections)

    def mirror(self, name: str) -> CoatingModel:
        """
        Return the coating of a mirror, which is opaque: the last layer is the substrate, and other coatings have T = 0.

        Raises
        ------
        MistrayError
            If a look-up fails, as of an item.
        """
        found = self._make(self._find(name), mirror=True)
        if isinstance(found, Ideal):
            return replace(found, T=0.0)
        if isinstance(found, CoatingTable):
            return replace(found, shares=found.shares * [[1.0], [1.0], [0.0]])
        return found

    def _find(self, name: str) -> _Section:
        section = self._sections.get(name.upper())
        if section is None:
            close = difflib.get_close_matches(name.upper(), self._sections, n=1)
            names = ", ".join(self)
            hint = f"did you mean '{self._sections[close[0]].name}'? There are" if close else "there are"
            raise UnknownKeyError(f"coating file '{self.path}': no coating '{name}'; {hint} {names or 'none'}")
        return section

    def _where(self, section: _Section, line: int | None = None) -> str:
        return f"coating file '{self.path}', line {line or section.line}"

    def _make(self, section: _Section, mirror: bool) -> CoatingModel:
        if section.kind == "ENCRYPTED":
            raise MistrayError(
                f"{self._where(section)}: coating {section.name} is encrypted; ask its vendor for a table of R and T"
            )
        if section.kind == "IDEAL":
            return self._ideal(section)
        if section.kind == "IDEAL2":
            return self._ideal2(section)
        if section.kind == "TABLE":
            return self._table(section)
        if _is_transmission(section.name):
            t = float("0" + section.name[1:])
            return Ideal(1 - t, t, section.name)
        return self._stack(section, mirror)

    def _ideal(self, section: _Section) -> Ideal:
        where = self._where(section)
        t, r = (*numbers(section.words[2:], 1, 2, where, "IDEAL, a name, T and R"), None)[:2]
        assert t is not None
        with errors_of(where):
            return Ideal(1 - t if r is None else r, t, section.name)

    def _ideal2(self, section: _Section) -> CoatingTable:
        where = self._where(section)
        values = numbers(section.words[2:], 8, 9, where, "IDEAL2, a name, 8 parts of amplitudes and the pi flag")
        s_r, s_t, p_r, p_t = (complex(*values[k : k + 2]) for k in (0, 2, 4, 6))
        largest = max(abs(value) for value in values[:8])
        if largest > 1:
            raise MistrayError(
                f"{where}: an amplitude of {largest:g}; their squares are shares of the light, give -1 … 1"
            )
        columns = {"R_s": abs(s_r) ** 2, "R_p": abs(p_r) ** 2, "T_s": abs(s_t) ** 2, "T_p": abs(p_t) ** 2}
        phases = _phases(*(math.degrees(math.atan2(z.imag, z.real)) for z in (s_r, p_r, s_t, p_t)))
        return self._tabled(section, [{"wavelength_nm": self.design_nm, "angle_deg": 0.0} | columns | phases])

    def _table(self, section: _Section) -> CoatingTable:
        rows: list[dict[str, float]] = []
        angle: float | None = None
        for line, words in section.lines:
            where, key = self._where(section, line), words[0].upper()
            if key == "ANGL":
                (angle,) = numbers(words[1:], 1, 1, where, "ANGL and an angle in degrees")
            elif key == "WAVE" and angle is not None:
                values = numbers(words[1:], 5, 9, where, "WAVE, a wavelength in µm, Rs Rp Ts Tp and up to 4 phases")
                phases = [*values[5:], *[0.0] * (9 - len(values))]
                shares = dict(zip(("R_s", "R_p", "T_s", "T_p"), values[1:5], strict=True))
                for pol in "sp":
                    if (
                        min(shares[f"R_{pol}"], shares[f"T_{pol}"]) < 0
                        or shares[f"R_{pol}"] + shares[f"T_{pol}"] > 1 + 1e-6
                    ):
                        raise MistrayError(
                            f"{where}: R{pol} = {shares[f'R_{pol}']:g}, T{pol} = {shares[f'T_{pol}']:g}; both must be "
                            "0 or greater and their sum must not exceed 1"
                        )
                nm = round(values[0] * 1e3, 6)
                rows.append({"wavelength_nm": nm, "angle_deg": angle} | shares | _phases(*phases))
            else:
                raise MistrayError(f"{where}: '{shown(words)}'; expected ANGL, then WAVE lines")
        if not rows:
            raise MistrayError(f"{self._where(section)}: table {section.name} has no data; add ANGL and WAVE lines")
        return self._tabled(section, rows)

    def _tabled(self, section: _Section, rows: list[dict[str, float]]) -> CoatingTable:
        columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        with errors_of(self._where(section)):
            return CoatingTable.from_columns(f"{self.path}:{section.name}", columns)

    def _stack(self, section: _Section, mirror: bool) -> Stack:
        layers: list[Layer] = []
        start: int | None = None  # first layer of the group that is open, its loop index and line
        loop, opened = 0, 0
        for line, words in section.lines:
            where = self._where(section, line)
            layer, index = self._layer(words, where)
            layers.append(layer)
            if index and start is None:
                start, loop, opened = len(layers) - 1, index, line
            elif index and index != loop:
                raise MistrayError(
                    f"{where}: loop index {index} inside the group of line {opened}, whose index is {loop}; close "
                    "that group first"
                )
            elif index:
                assert start is not None
                count = len(layers) + (len(layers) - start) * (loop - 1)
                if count > MOST_LAYERS:
                    raise MistrayError(
                        f"{where}: with its groups repeated the coating has {count:.6g} layers, more than "
                        f"{MOST_LAYERS}; correct the loop index"
                    )
                layers += layers[start:] * (loop - 1)
                start = None
        if start is not None:
            raise MistrayError(
                f"{self._where(section, opened)}: the group of loop index {loop} has no end; give its last layer the "
                "same index"
            )
        if mirror and layers:
            material = layers[-1].material
            known = nearest_known_nm(material, self.design_nm, with_k=True)
            clear = complex_index(material, known).imag < SUBSTRATE_K
            layers[-1] = Layer(f"{material} k={SUBSTRATE_K:g}" if clear else material, SUBSTRATE_NM)
        return Stack(tuple(layers), name=section.name, opaque=mirror)

    def _layer(self, words: list[str], where: str) -> tuple[Layer, int]:
        """
        Return the layer that the words of a COAT line describe, and its loop index; 0 if it bounds no group.

        Raise `MistrayError` if the line is malformed, a value is out of range, or the layer has a taper.
        """
        if len(words) > 5 or len(words) < 2:
            raise MistrayError(f"{where}: '{shown(words)}'; expected material thickness is_absolute loop taper")
        if len(words) == 5:
            raise MistrayError(f"{where}: taper {words[4]}; mistray has no coatings that vary over the aperture")
        value, *flags = numbers(words[1:], 1, 3, where, "material thickness is_absolute loop")
        absolute, loop = [*flags, 0.0, 0.0][:2]
        if value < 0 or absolute not in (0, 1) or loop < 0 or loop != int(loop):
            raise MistrayError(
                f"{where}: thickness {value:g}, is_absolute {absolute:g}, loop index {loop:g}; they must be 0 or "
                "greater, 0 or 1, and a whole number"
            )
        material = words[0].lower() if words[0].upper() in BUILT_IN else f"{self.path}:{words[0]}"
        layer = Layer(material, value * 1e3) if absolute else waves(material, value, self.design_nm, where)
        return layer, int(loop)


def read_coating_file(path: str | Path, design_nm: float = 550.0) -> CoatingFile:
    r"""
    Return the coatings of a Zemax coating file.

    Parameters
    ----------
    path : str or Path
        File to read.
    design_nm : float
        Primary wavelength of the lens, nm, for thicknesses in waves.

    Returns
    -------
    CoatingFile
        Mapping from names to coatings.

    Raises
    ------
    MistrayError
        If the file is missing, `design_nm` is not greater than 0, a section's first line or a MATE section is
        malformed, a name occurs twice, or a layer's material is not in the file. Other errors are raised when a coating
        is looked up.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("COATING.DAT").write_text("MATE MGF2\n0.55 1.38 0\nCOAT AR\nMGF2 0.25\n")
    >>> coating = mistray.coatings.read_coating_file("COATING.DAT", design_nm=550)["AR"]
    >>> print(f"{coating.layers[0].thickness_nm:.1f} nm")
    99.6 nm
    """
    if not design_nm > 0:
        raise MistrayError(f"coating file '{path}': design_nm = {design_nm:g}; it must be greater than 0")
    materials = {name.upper() for name in read_mate(path)}
    sections: dict[str, _Section] = {}
    current: _Section | None = None
    seen = False
    for number, words in numbered_lines(path):
        where, key = f"coating file '{path}', line {number}", words[0].upper()
        if key in SECTIONS:
            seen, current = True, None
            if key in ("MATE", "TAPR"):
                continue
            if len(words) < 2 or (key in ("COAT", "TABLE", "ENCRYPTED") and len(words) > 2):
                raise MistrayError(f"{where}: '{shown(words)}'; write {key} and one name")
            current = _Section(key, words[1], number, words)
            other = sections.setdefault(current.name.upper(), current)
            if other is not current:
                raise MistrayError(
                    f"{where}: coating {current.name} is there already, on line {other.line}; rename one"
                )
        elif not seen:
            raise MistrayError(f"{where}: '{shown(words)}' before the first section; begin with {', '.join(SECTIONS)}")
        elif current is not None:
            if current.kind not in ("COAT", "TABLE") or _is_transmission(current.name):
                raise MistrayError(
                    f"{where}: '{shown(words)}' follows {current.kind} {current.name}, which is one line; remove it"
                )
            if current.kind == "COAT" and words[0].upper() not in materials and words[0].upper() not in BUILT_IN:
                raise MistrayError(f"{where}: material {words[0]} has no MATE section in this file; add one")
            current.lines.append((number, words))
    return CoatingFile(Path(path), sections, design_nm)


def _is_transmission(name: str) -> bool:
    """True if a name is that of an ideal coating with a stated transmittance, such as I.99."""
    return name[:2].upper() == "I." and name[2:].isdecimal()


def _phases(r_s: float, r_p: float, t_s: float, t_p: float) -> dict[str, float]:
    """Return phase differences s minus p, degrees, by `CoatingTable` column, from those of OpticStudio, degrees."""
    return {"phase_r_deg": 180.0 - (r_s - r_p), "phase_t_deg": -(t_s - t_p), "phase_r_back_deg": 180.0 - (r_s - r_p)}

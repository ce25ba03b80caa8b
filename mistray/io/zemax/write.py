"""Writer of sequential lenses as Zemax .zmx files.

Lines, units (mm) and senses of tilts are those of `read_zemax`. Programs differ in how they combine tilts about several
axes, and some ignore the order flag of coordinate breaks. So each break rotates about one axis at most and decentres
before it rotates. All programs read such a break alike.

Makers' glasses are written by name, with their catalogue in ``GCAT`` and with nd and Vd. OpticStudio does not need nd
and Vd, but other programs use them to distinguish glasses of equal names. A material without a catalogue name becomes a
model glass: for a single wavelength with its index and no dispersion, else with nd and Vd.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mistray.errors import MistrayError
from mistray.io.zemax.glasses import SYNONYMS
from mistray.io.zemax.sags import type_of
from mistray.io.zemax.system import MOST_WAVELENGTHS
from mistray.materials import LINE_C_NM, LINE_D_NM, LINE_F_NM, nearest_known_nm, refractive_index, source
from mistray.materials.catalogue import MAKERS
from mistray.materials.spec import AbbeNumber, Constant, Name, Spec, UserFile, parse
from mistray.physics.geometry.outline import ALL
from mistray.prescription.sequential.table import Decentre, Row, Sequential
from mistray.replace_file import replace_file

_INFRARED = ("GERMANIUM", "SILICON", "ZNSE", "ZNS_IR", "CDTE", "KRS5")  # these are not in Zemax's catalogue MISC
# A Vd of 0 means "no dispersion" to OpticStudio and a division by zero to others. In light of the d line alone no
# program looks at Vd, so that there one stands that all can divide by, and `read_zemax` takes it for 0.
_NO_DISPERSION_VD, _ANY_VD = 0.0, 1e10
_D_LINE_NM = 0.01  # nearness to it
_FIELD_TYPES = {"angle_deg": 0, "object_height": 1, "image_height": 2}
_ZEMAX_NAMES = {material: name for name, material in reversed(SYNONYMS.items()) if "/" not in material}


def write_zemax(lens: Sequential, path: str | Path) -> tuple[str, ...]:
    """
    Write a lens as a .zmx file, atomically.

    The file is in ASCII, or in UTF-16 as OpticStudio writes it if it has other characters.

    Parameters
    ----------
    lens : Sequential
        Lens to write.
    path : str or Path
        File to write.

    Returns
    -------
    tuple of str
        Losses: content that the file lacks or only approximates, one phrase each; empty if the file is complete.

    Raises
    ------
    MistrayError
        If no surface type of .zmx files has all terms of a sag, the lens has more than 24 wavelengths, a material has
        no index at one of them, or the file cannot be written.

    Examples
    --------
    >>> from mistray.scenes.cooke_triplet.prescription import build
    >>> lens = mistray.prescription.to_sequential(build())
    >>> losses = mistray.prescription.write_zemax(lens, "triplet.zmx")
    >>> losses
    ()
    """
    if len(lens.wavelengths_nm) > MOST_WAVELENGTHS:
        raise MistrayError(
            f"lens '{lens.name}': {len(lens.wavelengths_nm)} wavelengths; .zmx files hold {MOST_WAVELENGTHS}, leave "
            "some out"
        )
    writer = _Writer(lens)
    text = writer.text()
    replace_file(path, text if text.isascii() else f"\ufeff{text}".encode("utf-16-le"), "lens")
    return tuple(writer.losses)


@dataclass
class _Break:
    """Coordinate break: decentre (mm), then one tilt (degrees) about `axis` (0, 1, 2: x, y, z), then thickness (mm)."""

    x: float = 0.0
    y: float = 0.0
    axis: int = 0
    tilt_deg: float = 0.0
    thickness: float = 0.0


@dataclass
class _Writer:
    lens: Sequential
    losses: list[str] = field(default_factory=list)
    catalogues: list[str] = field(default_factory=list)
    number: int = 0

    def text(self) -> str:
        surfaces = [line for block in self._surfaces() for line in block]
        return "\n".join([*self._head(), *surfaces, ""])

    def _head(self) -> Iterator[str]:
        lens = self.lens
        yield from ("VERS 140124 258 36214", "MODE SEQ", f"NAME {_one_line(lens.name)}")
        if lens.source:
            yield f"NOTE 0 {_one_line(lens.source)}"
        yield "UNIT MM X W X CM MR CPMM"
        if lens.aperture <= 0:
            self._lose("the aperture of the system, which the lens does not have")
        elif lens.aperture_kind == "entrance_pupil_diameter":
            yield f"ENPD {_number(lens.aperture)}"
        elif lens.aperture_kind == "f_number":
            yield f"FNUM {_number(lens.aperture)} 0"
        elif lens.aperture_kind == "object_na":
            yield f"OBNA {_number(lens.aperture)} 0"
        else:
            yield "FLOA"
        yield "ENVD 20 1 0"
        if self.catalogues:
            yield f"GCAT {' '.join(self.catalogues)}"
        counts = f"{len(lens.fields)} {len(lens.wavelengths_nm)}"
        yield f"FTYP {_FIELD_TYPES[lens.field_kind]} {int(lens.telecentric)} {counts} 0 0 0"
        columns = {
            "XFLN": [x for x, _ in lens.fields],
            "YFLN": [y for _, y in lens.fields],
            "FWGN": [1.0] * len(lens.fields),
        }
        for place, key in enumerate(("VDXN", "VDYN", "VCXN", "VCYN")):
            columns[key] = [row[place] for row in lens.vignetting] or [0.0] * len(lens.fields)
        for key, values in columns.items():
            yield f"{key} {' '.join(map(_number, values))}"
        for place, (nm, weight) in enumerate(zip(lens.wavelengths_nm, lens.weights, strict=True), 1):
            yield f"WAVM {place} {_number(nm / 1e3)} {_number(weight)}"
        yield f"PWAV {lens.primary + 1}"

    def _surfaces(self) -> Iterator[list[str]]:
        lens = self.lens
        yield self._block(
            "STANDARD", thickness=lens.object_distance, extra=self._glass(lens.object_material, "the object")
        )
        for place, row in enumerate(lens.rows):
            moves = _moves(row.decentre) if row.decentre else []
            if row.kind == "coordinate_break":
                moves = [_Break()] if row.decentre is None or row.decentre.returns else moves
                moves[-1].thickness += row.thickness
                yield from map(self._break, moves)
                continue
            back = _moves(row.decentre, undo=True) if row.decentre and row.decentre.returns else []
            yield from map(self._break, moves)
            if back:
                back[-1].thickness += row.thickness
            yield self._surface(row, 0.0 if back else row.thickness, lens.rows[place - 1] if place else None)
            yield from map(self._break, back)

    def _block(self, kind: str, *, thickness: float, curvature: float = 0.0, extra: list[str]) -> list[str]:
        """Return the lines of a surface (mm, curvature in 1/mm); `extra` follows the lines that every surface has."""
        distance = "INFINITY" if math.isinf(thickness) else _number(thickness)
        lines = [
            f"SURF {self.number}",
            f"  TYPE {kind}",
            f'  CURV {_number(curvature)} 0 0 0 0 ""',
            f"  DISZ {distance}",
        ]
        self.number += 1
        return [*lines, *(f"  {line}" for line in extra)]

    def _break(self, move: _Break) -> list[str]:
        tilts = [move.tilt_deg if axis == move.axis else 0.0 for axis in range(3)]
        values = enumerate((move.x, move.y, *tilts, 0.0), 1)
        extra = [f"PARM {place} {_number(value)}" for place, value in values]
        return self._block("COORDBRK", thickness=move.thickness, extra=extra)

    def _surface(self, row: Row, thickness: float, before: Row | None) -> list[str]:
        extra = ["STOP"] if row.stop else []
        if row.label:
            extra.append(f"COMM {_one_line(row.label)}")
        if row.conic:
            extra.append(f"CONI {_number(row.conic)}")
        kind, numbers = type_of(row)
        extra += numbers
        if row.mirror:
            extra.append("GLAS MIRROR 0 0 1.5 40 0 0 0 0 0 0")
        elif row.kind == "surface":
            extra += self._glass(row.material, f"surface {row.number}")
        if row.coating:
            name = row.coating.rpartition(":")[2]
            extra.append(f"COAT {'_'.join(name.split())}")
            if name.split() != [name]:
                self._lose(f"coating '{name}': its name is written with '_' for spaces")
        extra += self._aperture(row)
        curvature = 0.0 if row.radius == 0 else 1 / row.radius
        return self._block(kind, thickness=0.0 if row.kind == "image" else thickness, curvature=curvature, extra=extra)

    def _aperture(self, row: Row) -> list[str]:
        lines = []
        floats = row.stop and self.lens.aperture_kind == "stop_diameter"  # FLOA takes the diameter from here
        size = self.lens.aperture / 2 if floats else row.semi_diameter
        if size is not None:
            lines.append(f'DIAM {_number(size)} {int(row.semi_diameter_fixed or floats)} 0 0 1 ""')
        outline, obscures = row.aperture, False
        if outline is None or (row.obscuration is not None and outline.annulus and not row.semi_diameter_fixed):
            outline, obscures = row.obscuration, row.obscuration is not None
        elif row.obscuration is not None:
            self._lose(f"surface {row.number}: its obscuration, as .zmx files have one aperture a surface")
        if obscures and (row.semi_diameter_fixed or row.aperture is not None):
            self._lose(f"surface {row.number}: its edge stops no light, as .zmx files have one aperture a surface")
        if outline is None:
            if row.semi_diameter_fixed and size is not None:
                lines.append(f"FLAP 0 {_number(size)} 0")
            return lines
        first, *more = outline.figures
        hole = more[0].sizes[0] if more else 0.0
        inside_out = first.sign == "-"  # a hole in what has no end of its own
        rings = all(f.kind == "circle" and (f.x, f.y) == (first.x, first.y) for f in outline.figures)
        if first.kind == "circle" and rings and len(more) < 2 and all(f.sign == "-" for f in more):
            inner, outer = (first.sizes[0], size) if inside_out else (hole, first.sizes[0])
            if outer is None:
                self._lose(f"surface {row.number}: its hole of radius {inner:g} mm, as it has no rim")
                return lines
            lines.append(f"{'OBSC' if obscures else 'CLAP'} {_number(inner)} {_number(outer)} 0")
        elif first.kind in ("rectangle", "ellipse") and not more and not first.angle_deg and not inside_out:
            key = {"rectangle": ("SQAP", "SQOB"), "ellipse": ("ELAP", "ELOB")}[first.kind][obscures]
            sides = [half if half < ALL else size for half in first.sizes]
            if None in sides:
                self._lose(f"surface {row.number}: its slit, as it has no rim that ends it")
                return lines
            lines.append(f"{key} {' '.join(_number(side) for side in sides if side is not None)} 0")
        else:
            self._lose(f"surface {row.number}: its {'obscuration' if obscures else 'aperture'} of several figures")
            return lines
        if first.x or first.y:
            lines.append(f"OBDC {_number(first.x)} {_number(first.y)}")
        return lines

    def _glass(self, material: str, where: str) -> list[str]:
        spec = parse(material)
        if isinstance(spec.form, Constant) and spec.form.n == 1:
            return []
        if spec.k or spec.bulk.per_mm or (isinstance(spec.form, Constant) and spec.form.k):
            self._lose(f"material '{material}' ({where}): its absorption and scatter")
        if isinstance(spec.form, (Name, UserFile)) and not spec.shift and (name := self._catalogue_name(spec)):
            nd, vd = self._abbe(material) if self._visible(material) else (0.0, 0.0)
            return [f"GLAS {name} 0 0 {_number(nd)} {_number(vd)} 0 0 0 0 0 0"]
        at_d = all(abs(nm - LINE_D_NM) < _D_LINE_NM for nm in self.lens.wavelengths_nm)
        if isinstance(spec.form, AbbeNumber) and not spec.shift:
            nd, vd = spec.form.nd, spec.form.vd
            if not at_d:
                self._lose(f"material '{material}': programs have formulas of their own for nd and Vd off 587.56 nm")
        elif isinstance(spec.form, Constant) or len(self.lens.wavelengths_nm) == 1 or not self._visible(material):
            nd, vd = refractive_index(material, self.lens.wavelength_nm), _ANY_VD if at_d else _NO_DISPERSION_VD
            if not at_d:
                self._lose(f"material '{material}': written with Vd = 0, no dispersion, which not all programs know")
            if not isinstance(spec.form, Constant):
                self._lose(f"material '{material}' ({where}): its index at {self.lens.wavelength_nm:g} nm alone")
        else:
            nd, vd = self._abbe(material)
            self._lose(f"material '{material}' ({where}): as a model glass of its nd and Vd, which is approximate")
        return [f"GLAS ___BLANK 1 0 {_number(nd)} {_number(vd)} 0 0 0 0 0 0"]

    def _catalogue_name(self, spec: Spec) -> str | None:
        """Return the name of a glass in a Zemax catalogue, which is added to `catalogues`; None if there is none."""
        name: str | None = None
        catalogue = "MISC"
        if isinstance(spec.form, UserFile) and spec.form.path.lower().endswith(".agf"):
            name, catalogue = spec.form.entry, Path(spec.form.path).stem.upper()
        elif isinstance(spec.form, Name):
            found = source(spec.form.name).name
            maker, _, glass = found.partition("/")
            if maker in MAKERS:
                name, catalogue = glass.replace("star", "*"), maker.upper()  # as `catalogue.find` has it
            else:
                name = _ZEMAX_NAMES.get(found)
        if name in _INFRARED:
            catalogue = "INFRARED"
        if name is not None and catalogue not in self.catalogues:
            self.catalogues.append(catalogue)
        return name

    def _visible(self, material: str) -> bool:
        """True if the index of a material is known at the F and the C line, which nd and Vd need."""
        return all(nearest_known_nm(material, nm) == nm for nm in (LINE_F_NM, LINE_C_NM))

    def _abbe(self, material: str) -> tuple[float, float]:
        f, d, c = (refractive_index(material, nm) for nm in (LINE_F_NM, LINE_D_NM, LINE_C_NM))
        return d, (d - 1) / (f - c) if f > c else _NO_DISPERSION_VD

    def _lose(self, text: str) -> None:
        if text not in self.losses:
            self.losses.append(text)


def _moves(decentre: Decentre, *, undo: bool = False) -> list[_Break]:
    """Return coordinate breaks that together move the frame as a `Decentre` does, or back if `undo`."""
    sign = -1.0 if undo else 1.0
    shift = _Break(x=sign * decentre.x, y=sign * decentre.y, thickness=sign * decentre.z)
    turns = [_Break(axis=axis, tilt_deg=sign * tilt) for axis, tilt in enumerate(decentre.tilt_deg) if tilt]
    tilt_first = decentre.tilt_first
    if tilt_first != undo:  # about z, y, x: the reverse of the order that undoes it
        turns.reverse()
    moves = [*turns, shift] if tilt_first != undo else [shift, *turns]
    moves = [move for move in moves if move.x or move.y or move.thickness or move.tilt_deg]
    if len(moves) > 1 and moves[0] is shift and not shift.thickness:  # one break decentres, then turns
        moves[1].x, moves[1].y = shift.x, shift.y
        moves = moves[1:]
    return moves or [_Break()]


def _number(value: float) -> str:
    """Return the shortest string that reads back as the same number."""
    return repr(float(value)).removesuffix(".0").upper()


def _one_line(text: str) -> str:
    return " ".join(text.split())

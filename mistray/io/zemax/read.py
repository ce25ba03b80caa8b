"""Reader for sequential lenses of Zemax OpticStudio (.zmx).

Surfaces ``STANDARD`` (conics), ``EVENASPH`` and ``COORDBRK``; a lens with another type is refused. See `zemax_system`
for the lines of the system, `zemax_glass` for glasses and `zemax_lines` for the lines that have no effect.

=========================  ========================================================================================
``CURV c``                 curvature, per lens unit
``DISZ t``                 to the next surface; INFINITY for a distant object
``CONI k``                 conic constant
``PARM i v``               EVENASPH: coefficient of r^2i; COORDBRK: decentre x, y, tilt about x, y, z, order
``GLAS …``                 see `zemax_glass`; MIRROR reflects; without it air follows, and behind a coordinate break
                           what was before it
``DIAM s f …``             clear semi-diameter; 0 where rays decide
``CLAP i o``, ``OBSC``     circular aperture or obscuration between two radii
``FLAP``                   the semi-diameter is an aperture
``SQAP x y``, ``SQOB``     rectangular aperture or obscuration, half widths
``OBDC x y``               centre of the aperture
``COAT name``              of a coating file
``COMM text``, ``STOP``    name; aperture stop
``SCBD 1 o p …``           the frame moves before the surface: order, 0 for numbers of its own, then as COORDBRK
=========================  ========================================================================================

Tilts. OpticStudio turns the frame about x, then about the new y, then about the newest z, R = Rx·Ry·Rz with
right-handed rotations, so that +90° about x turns the z axis to -y; an order other than 0 turns about z, y, x and
decentres afterwards. The thickness follows in any case. This is the sense of `Decentre`. Sources: OpticStudio knowledge
base, "Rotation Matrix and Tilt About X/Y/Z in OpticStudio" (M. Cheng, Y. Chen, M. Humphreys) and "How to tilt and
decenter a sequential optical component" (M. Nicholson).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mistray.coatings import read_coating_file
from mistray.coatings.zemax import CoatingFile
from mistray.errors import MistrayError
from mistray.io.conventions import object_na
from mistray.io.zemax.glasses import Glasses
from mistray.io.zemax.lines import Line, Section, read_sections
from mistray.io.zemax.system import System, read_system
from mistray.materials import refractive_index
from mistray.prescription.sequential.table import ClearAperture, Decentre, Row, Sequential, Unread

_TYPES = ("STANDARD", "EVENASPH", "COORDBRK")
_EVEN_TERMS = 8
_FIT = "fit an EVENASPH to it"
_ROUND = "only surfaces of revolution are read, model it as STANDARD or EVENASPH or leave it out"
_REMEDIES = {
    **dict.fromkeys(("ODDASPHE", "XASPHERE", "QED_TYPE"), _FIT),
    **dict.fromkeys(("TOROIDAL", "BICONICX", "IRREGULA", "XPOLYNOM", "SZERNSAG", "TILTSURF"), _ROUND),
    **dict.fromkeys(("DGRATING", "BINARY_1", "BINARY_2"), "diffracting surfaces are not traced, leave it out"),
    "PARAXIAL": "put the real surfaces of that lens in its place",
    "NONSEQCO": "a non-sequential component has no order of surfaces, bring it in as STEP",
}
_APERTURES = ("CLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID", "UDAD", "UDOB", "UDAP", "USAP")


def read_zemax(
    path: str | Path,
    *,
    coatings: str | Path | None = None,
    glass_catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
) -> Sequential:
    """
    Read a sequential lens.

    Parameters
    ----------
    path : str or Path
        File in UTF-16 or UTF-8 with or without byte order mark, or Latin-1.
    coatings : str or Path or None
        Coating file (COATING.DAT). With it, `Row.coating` is ``file:name`` as `Coating.table` takes it, and a name that
        it lacks is an error; without it, coatings are listed in `Sequential.unread`.
    glass_catalogues : sequence of str or Path
        AGF files; a glass that one of them holds is taken from there.
    glasses : mapping of str to str or None
        Material strings (see `mistray.materials`) for names of glasses, which go before all catalogues.

    Returns
    -------
    Sequential
        In mm. `unread` has every line that had no effect and is not known to need none.

    Raises
    ------
    MistrayError
        If the file is missing or broken, is not sequential, has a surface of a type that mistray does not know, or a
        glass is unknown. The message names the line.
    """
    path = Path(path)
    return _Reader(path, coatings, [Path(file) for file in glass_catalogues], glasses or {}).sequential()


class _Reader:
    def __init__(
        self, path: Path, coatings: str | Path | None, agf: Sequence[Path], replaced: Mapping[str, str]
    ) -> None:
        self.path = path
        self.sections = read_sections(path)
        self.system: System = read_system(self.sections.system, path)
        self.unit = self.system.unit_mm
        self.unread: list[Unread] = list(self.system.unread)
        self.notes: list[str] = list(self.system.notes)
        wavelengths = self.system.wavelengths_nm
        self.glasses = Glasses(self.system.catalogues, agf, replaced, wavelengths)
        self.coating_file: CoatingFile | None = None
        if coatings is not None:
            self.coating_file = read_coating_file(coatings, wavelengths[self.system.primary])
        self.materials: dict[int, str] = {}

    def sequential(self) -> Sequential:
        distance, material = self._object(self.sections.surfaces[0])
        rows: list[Row] = []
        for number, section in enumerate(self.sections.surfaces[1:], 1):
            before = rows[-1].material if rows else material
            rows.append(self._row(number, section, before, image=number == len(self.sections.surfaces) - 1))
        self._after()
        kind, aperture = self.system.aperture_kind, self.system.aperture
        if self.system.floating:
            aperture = 2 * self._stop_semi_diameter(rows)
        telecentric = self.system.telecentric
        if telecentric is not None and math.isinf(distance):
            self.unread.append(telecentric.unread("telecentric object space: the object lies at infinity"))
        lens = Sequential(
            name=self.system.name,
            rows=tuple(rows),
            source=f"Zemax file {self.path.name}",
            object_distance=distance,
            object_material=material,
            aperture_kind=kind,
            aperture=aperture,
            telecentric=telecentric is not None and math.isfinite(distance),
            field_kind=self.system.field_kind,
            fields=self.system.fields,
            vignetting=self.system.vignetting,
            wavelengths_nm=self.system.wavelengths_nm,
            weights=self.system.weights,
            primary=self.system.primary,
            unread=tuple(sorted((*self.unread, *self.glasses.unread), key=lambda line: line.line)),
            notes=(*self.notes, *self.glasses.notes),
        )
        if not self.system.working or math.isinf(distance):
            return lens
        cone = object_na(lens, 1 / (2 * aperture * refractive_index(rows[-2].material, lens.wavelength_nm)))
        note = f"paraxial working F-number {aperture:g} is the paraxial cone of object-space NA {cone:.6g}"
        return replace(lens, aperture_kind="object_na", aperture=cone, notes=(*lens.notes, note))

    def _object(self, section: Section) -> tuple[float, str]:
        """Distance and material of the object."""
        kind = section.take("TYPE")
        if kind is not None and kind.word(0).upper() != "STANDARD":
            raise kind.error(f"the object is of type '{kind.word(0)}'; mistray knows STANDARD objects")
        for line in section.take_all("CURV", "CONI"):
            if line.value(0):
                self.unread.append(line.unread("the object is taken as a plane"))
        glass = section.take("GLAS")
        material = "air" if glass is None else self.glasses.material(glass, {})
        self.materials[0] = material
        thickness = section.take("DISZ")
        section.take_all("COMM", "DIAM", "STOP")
        self._list_rest(section)
        if thickness is None or (thickness.words and thickness.words[0].upper() == "INFINITY"):
            return math.inf, material
        return thickness.value(0, "a thickness or INFINITY") * self.unit, material

    def _row(self, number: int, section: Section, before: str, image: bool) -> Row:
        head = section.head
        assert head is not None
        kind = section.take("TYPE")
        name = kind.words[0].upper() if kind and kind.words else "STANDARD"
        if name not in _TYPES:
            assert kind is not None
            remedy = _REMEDIES.get(name, f"mistray knows {', '.join(_TYPES)}, use one of them")
            raise kind.error(f"surface {number} is of type '{kind.word(0)}'; {remedy}")
        comment = section.take("COMM")
        label = comment.text[len("COMM") :].strip() if comment else ""
        thickness = self._thickness(section)
        if name == "COORDBRK":
            if image:
                raise head.error(f"surface {number}, the image, is a coordinate break; add an image behind it")
            row = self._break(number, section, before)
            row = replace(row, label=label, thickness=thickness, line=head.number)
        else:
            row = self._surface(number, section, before, image, name)
            row = replace(row, label=label, thickness=0.0 if image else thickness, line=head.number)
        self._list_rest(section)
        self.materials[number] = row.material
        return row

    def _thickness(self, section: Section) -> float:
        line = section.take("DISZ")
        return (
            0.0 if line is None else line.value(0, "a thickness; only that of the object may be infinite") * self.unit
        )

    def _break(self, number: int, section: Section, before: str) -> Row:
        section.take_all("CURV", "CONI", "DIAM")
        values = self._parameters(section, 6)
        return Row(number, kind="coordinate_break", material=before, decentre=self._decentre(values))

    def _decentre(self, values: Sequence[float]) -> Decentre:
        """Of x, y, the three tilts and the order."""
        x, y, *tilt, order = values
        return Decentre(x=x * self.unit, y=y * self.unit, tilt_deg=(tilt[0], tilt[1], tilt[2]), tilt_first=order != 0)

    def _parameters(self, section: Section, count: int) -> list[float]:
        """PARM 1 to `count`; others must be 0."""
        values = [0.0] * count
        seen: dict[int, Line] = {}
        for line in section.take_all("PARM"):
            place, value = line.whole(0, "the number of the parameter"), line.value(1, "its value")
            if place in seen:
                raise line.error(f"parameter {place} is there already, on line {seen[place].number}; remove one")
            seen[place] = line
            if 1 <= place <= count:
                values[place - 1] = value
            elif value:
                self.unread.append(line.unread(f"{section.name} has {count or 'no'} parameters"))
        return values

    def _surface(self, number: int, section: Section, before: str, image: bool, name: str) -> Row:
        curvature = self._first(section, "CURV") / self.unit
        conic = self._first(section, "CONI")
        coefficients: tuple[float, ...] = ()
        if name == "EVENASPH":
            curvature, conic, coefficients = self._asphere(number, section, curvature, conic)
        else:
            self._parameters(section, 0)
        material, mirror = self._glass(section, before, image)
        semi_diameter, fixed, aperture = self._aperture(section)
        return Row(
            number,
            kind="image" if image else "surface",
            radius=1 / curvature if curvature else math.inf,
            conic=conic,
            coefficients=coefficients,
            material=material,
            mirror=mirror,
            stop=bool(section.take("STOP")),
            semi_diameter=semi_diameter,
            semi_diameter_fixed=fixed,
            aperture=aperture,
            coating=self._coating(section),
            decentre=self._before(section),
        )

    def _first(self, section: Section, key: str) -> float:
        line = section.take(key)
        return 0.0 if line is None else line.value(0)

    def _asphere(
        self, number: int, section: Section, curvature: float, conic: float
    ) -> tuple[float, float, tuple[float, ...]]:
        """Curvature, conic constant and (a4, …, a16); a term in r² is put into the conic where that is exact."""
        values = self._parameters(section, _EVEN_TERMS)
        scaled = [value * self.unit ** (1 - 2 * power) for power, value in enumerate(values, 1)]
        if scaled[0]:
            # c r²/2 + a2 r² is a paraboloid again; a plane is one with c = 0
            if curvature and conic != -1:
                assert section.head is not None
                raise section.head.error(
                    f"surface {number} has a term in r² beside radius {1 / curvature:g} mm and conic {conic:g}; "
                    "mistray has terms from r⁴ on, fit the surface again without it"
                )
            curvature, conic = curvature + 2 * scaled[0], -1.0
        higher = scaled[1:]
        while higher and not higher[-1]:
            higher.pop()
        return curvature, conic, tuple(higher)

    def _glass(self, section: Section, before: str, image: bool) -> tuple[str, bool]:
        line = section.take("GLAS")
        if line is None:
            return "air", False
        if image:
            self.unread.append(line.unread("what lies behind the image has no effect"))
            return "air", False
        if line.words and line.words[0].upper() == "MIRROR":
            return before, True
        return self.glasses.material(line, self.materials), False

    def _aperture(self, section: Section) -> tuple[float | None, bool, ClearAperture | None]:
        """Clear semi-diameter, whether it stops light, and the aperture that the file states."""
        diameter = section.take("DIAM")
        drawn = abs(diameter.value(0, "a semi-diameter")) * self.unit if diameter else 0.0
        floating = section.take("FLAP")
        centre = section.take("OBDC")
        x, y = (centre.value(0) * self.unit, centre.value(1) * self.unit) if centre else (0.0, 0.0)
        lines = section.take_all(*_APERTURES)
        if len(lines) + bool(floating) > 1:
            raise lines[-1].error(f"{section.name} has two apertures; keep one")
        if floating is not None:
            inner, outer = (abs(floating.value(k, "two radii")) * self.unit for k in (0, 1))
            if inner and not inner < outer:
                raise floating.error(f"radii {inner:g} and {outer:g} mm; the second must be the greater one")
            hole = ClearAperture(inner=inner, outer=outer, x=x, y=y) if inner or x or y else None
            return (drawn or outer or None), hole is None, hole
        aperture = self._stated(lines[0], x, y) if lines else None
        if centre is not None and not lines and (x or y):
            self.unread.append(centre.unread("centre of an aperture that the surface does not have"))
        if aperture is None or aperture.obscures:
            return drawn or None, False, aperture
        reach = math.hypot(x, y)
        if aperture.kind == "circle":
            reach += aperture.outer
        else:
            reach = math.hypot(abs(x) + aperture.half_width, abs(y) + aperture.half_height)
        return reach, aperture.kind == "circle" and not (x or y or aperture.inner), aperture

    def _stated(self, line: Line, x: float, y: float) -> ClearAperture | None:
        ellipse = line.key in ("ELAP", "ELOB")
        if not ellipse and line.key not in ("CLAP", "OBSC", "SQAP", "SQOB"):
            what = "spider" if line.key == "SPID" else "aperture of a user's file"
            self.unread.append(line.unread(f"{what}: it stops no light here, the surface keeps its semi-diameter"))
            return None
        first, second = (abs(line.value(k, "two lengths")) * self.unit for k in (0, 1))
        obscures = line.key in ("OBSC", "SQOB", "ELOB")
        if line.key in ("CLAP", "OBSC") or (ellipse and first == second):
            inner, outer = (0.0, first) if ellipse else (first, second)
            if not inner < outer:
                raise line.error(f"radii {inner:g} and {outer:g} mm; the second must be the greater one")
            return ClearAperture(inner=inner, outer=outer, x=x, y=y, obscures=obscures)
        if line.key in ("SQAP", "SQOB"):
            if not min(first, second) > 0:
                raise line.error(f"half widths {first:g} and {second:g} mm; both must be greater than 0")
            return ClearAperture(kind="rectangle", half_width=first, half_height=second, x=x, y=y, obscures=obscures)
        self.unread.append(line.unread("ellipse: it stops no light here, the surface keeps its semi-diameter"))
        return None

    def _coating(self, section: Section) -> str:
        line = section.take("COAT")
        if line is None or not line.words:
            return ""
        name = line.words[0]
        if self.coating_file is None:
            self.unread.append(line.unread("bare surface; give the coating file (coatings, --coatings) that holds it"))
            return name
        try:
            self.coating_file[name]
        except MistrayError as error:
            raise line.error(str(error)) from None
        return f"{self.coating_file.path}:{name}"

    def _before(self, section: Section) -> Decentre | None:
        found = None
        for line in section.take_all("SCBD"):
            values = line.values("numbers")
            if not any(values[2:]) and len(values) > 1:
                continue
            if len(values) != 8 or values[0] != 1 or values[2] != 0 or found:
                raise line.error(
                    f"'{line.shown}': tilts and decentres before a surface are read, not those behind it or picked up; "
                    "replace them by coordinate breaks (Convert Local To Global …)"
                )
            found = self._decentre((*values[3:], values[1]))
        return found

    def _stop_semi_diameter(self, rows: Sequence[Row]) -> float:
        stops = [row for row in rows if row.stop]
        if not stops or not stops[0].semi_diameter:
            raise MistrayError(
                f"lens '{self.path}': its aperture floats by the stop (FLOA), but no surface is a STOP with a "
                "semi-diameter (DIAM); add it"
            )
        return stops[0].semi_diameter

    def _list_rest(self, section: Section) -> None:
        self.unread += [line.unread(f"not known to mistray, on {section.name}") for line in section.left()]

    def _after(self) -> None:
        """What follows the surfaces: configurations other than the current one are lost, the rest has no effect."""
        after = self.sections.after
        for line in after.take_all("MNUM"):
            if line.whole(0, "the number of configurations", default=1) > 1:
                self.unread.append(line.unread("the configuration that the file was saved in is read, no other"))
        if not self.sections.indented:
            self.unread += [line.unread("not known to mistray, behind the surfaces") for line in after.left()]

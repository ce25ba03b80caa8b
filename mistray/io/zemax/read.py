"""Reader of sequential lenses of Zemax OpticStudio (.zmx).

Surface types are those of `mistray.io.zemax.sags` and ``COORDBRK``; a lens with another type is refused. See `system`
for the lines of the system, `glasses` for glasses, `configurations` for configurations, and `lines` for the lines that
have no effect.

=========================  ========================================================================================
``CURV c``                 curvature, per lens unit
``DISZ t``                 thickness to the next surface; INFINITY, or 1e10 and more, for a distant object
``CONI k``                 conic constant
``PARM i v``, ``XDAT``     see `sags`; COORDBRK: decentre x, y, tilt about x, y, z, order
``GLAS …``                 see `glasses`; MIRROR reflects; without it air follows, and behind a coordinate break
                           what was before it
``DIAM s f …``             clear semi-diameter; 0 where rays decide
``CLAP i o``, ``OBSC``     circular aperture or obscuration between two radii
``FLAP``                   the semi-diameter is an aperture
``SQAP x y``, ``SQOB``     rectangular aperture or obscuration, half widths
``ELAP x y``, ``ELOB``     elliptical aperture or obscuration, half axes
``SPID w n``               spider: n arms of width w from the middle, the first along x
``OBDC x y``               centre of the aperture
``COAT name``              name of a coating in a coating file
``COMM text``, ``STOP``    name; aperture stop
``SCBD 1 o p …``           the frame moves before the surface: order, 0 for values of its own, then as COORDBRK
=========================  ========================================================================================

Tilts. OpticStudio rotates the frame about x, then about the new y, then about the newest z: R = Rx·Ry·Rz. Rotations are
right-handed, so that +90° about x turns the z axis to -y. An order other than 0 rotates about z, y, x and decentres
afterwards. The thickness follows in any case. `Decentre` has the same sense. Sources: OpticStudio knowledge base,
"Rotation Matrix and Tilt About X/Y/Z in OpticStudio" (M. Cheng, Y. Chen, M. Humphreys) and "How to tilt and decenter a
sequential optical component" (M. Nicholson).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mistray.coatings import read_coating_file
from mistray.coatings.zemax_coating_dat import CoatingFile
from mistray.errors import MistrayError, errors_of
from mistray.io.conventions import object_na
from mistray.io.glasses import CATALOGUES, FILE, GLASSES
from mistray.io.zemax.configurations import at_configuration
from mistray.io.zemax.glasses import ZemaxGlasses
from mistray.io.zemax.lines import Sections, ZemaxLine, ZemaxSection, read_sections
from mistray.io.zemax.sags import KINDS, SagNumbers, figure_of
from mistray.io.zemax.system import System, read_system
from mistray.materials import refractive_index
from mistray.physics.geometry.outline import MOST_FIGURES, Outline, OutlineFigure, circle
from mistray.prescription.sequential.table import Decentre, Row, Sequential, Unread

_REMEDIES = {
    **dict.fromkeys(("DGRATING", "BINARY_1", "BINARY_2"), "diffracting surfaces are not traced, leave it out"),
    "PARAXIAL": "put the real surfaces of that lens in its place",
    "NONSEQCO": "a non-sequential component has no order of surfaces, bring it in as STEP",
}
_INFINITE = 1e10  # lens units, from which on OpticStudio takes an object to be at infinity
_SPIDER = 4.0  # length of an arm by the drawn radius
_SPIDER_MM = 1e4  # the same where none is drawn
_FIGURES = {
    "CLAP": "circle", "OBSC": "circle", "SQAP": "rectangle", "SQOB": "rectangle", "ELAP": "ellipse", "ELOB": "ellipse",
}  # fmt: skip
_OBSCURATIONS = ("OBSC", "SQOB", "ELOB", "SPID")
_APERTURES = ("CLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID", "UDAD", "UDOB", "UDAP", "USAP")


def read_zemax(
    path: str | Path,
    *,
    coatings: str | Path | None = None,
    configuration: int | str | None = None,
    glass_catalogues: str | Path | Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
) -> Sequential:
    """
    Read a sequential lens of Zemax OpticStudio.

    Parameters
    ----------
    path : str or Path
        .zmx file in UTF-16 or UTF-8 with or without byte order mark, or Latin-1.
    coatings : str or Path or None
        Coating file (COATING.DAT). With it, `Row.coating` is ``file:name`` as in `Coating.table`, and a missing name is
        an error. Without it, coatings are listed in `Sequential.unread`.
    configuration : int, str or None
        Number of the configuration from 1 on, or its name; ``None``: the one that the file was saved in. See
        `configurations`.
    glass_catalogues : str, Path or sequence of them
        AGF files; they take precedence over all other catalogues.
    glasses : mapping of str to str or None
        Glass name → material string (see `mistray.materials`); takes precedence over all catalogues.

    Returns
    -------
    Sequential
        Lens in mm. `unread` lists every line that was ignored although it may matter.

    Raises
    ------
    MistrayError
        If the file is missing or broken, is not sequential, has an unsupported surface type, or a glass, a coating or
        the configuration is unknown. The message names the line.

    Examples
    --------
    >>> from mistray.scenes.cooke_triplet.prescription import build
    >>> _ = mistray.prescription.write_zemax(mistray.prescription.to_sequential(build()), "triplet.zmx")
    >>> triplet = mistray.prescription.read_zemax("triplet.zmx")
    >>> [(row.radius, row.material) for row in triplet.rows[:2]]
    [(23.713, 'schott/N-LAK9'), (7331.287999999999, 'air')]
    """
    path = Path(path)
    FILE.check_all("", coatings=coatings)
    agf = [Path(file) for file in CATALOGUES.check("glass_catalogues", glass_catalogues)]
    replaced = GLASSES.check("glasses", {} if glasses is None else glasses)
    sections = read_sections(path)
    note = at_configuration(sections, configuration)
    return _Reader(path, sections, coatings, agf, replaced).sequential(note)


class _Reader:
    def __init__(
        self,
        path: Path,
        sections: Sections,
        coatings: str | Path | None,
        agf: Sequence[Path],
        replaced: Mapping[str, str],
    ) -> None:
        self.path = path
        self.sections = sections
        self.system: System = read_system(self.sections.system, path)
        self.unit = self.system.unit_mm
        self.unread: list[Unread] = list(self.system.unread)
        self.notes: list[str] = list(self.system.notes)
        wavelengths = self.system.wavelengths_nm
        self.glasses = ZemaxGlasses(self.system.catalogues, agf, replaced, wavelengths)
        self.coating_file: CoatingFile | None = None
        if coatings is not None:
            self.coating_file = read_coating_file(coatings, wavelengths[self.system.primary])
        self.materials: dict[int, str] = {}
        self.stop_mm = 0.0  # semi-diameter of the stop in the file, whatever aperture the surface has

    def sequential(self, note: str = "") -> Sequential:
        """
        Return the lens as read; a `note` is added to its notes.

        A paraxial working F-number of a near object is converted to the object-space NA.
        """
        if note:
            self.notes.append(note)
        distance, material = self._object(self.sections.surfaces[0])
        rows: list[Row] = []
        for number, section in enumerate(self.sections.surfaces[1:], 1):
            before = rows[-1].material if rows else material
            rows.append(self._row(number, section, before, image=number == len(self.sections.surfaces) - 1))
        self._after()
        kind, aperture = self.system.aperture_kind, self.system.aperture
        if self.system.floating:
            aperture = 2 * self._stop_semi_diameter(rows)
        if self.system.cone:
            aperture *= refractive_index(material, self.system.wavelengths_nm[self.system.primary])
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
        cone = object_na(lens, 1 / (2 * aperture))
        note = f"paraxial working F-number {aperture:g} is the paraxial cone of object-space NA {cone:.6g}"
        return replace(lens, aperture_kind="object_na", aperture=cone, notes=(*lens.notes, note))

    def _object(self, section: ZemaxSection) -> tuple[float, str]:
        """
        Return the object's distance from the first surface, mm (inf: far away), and the material between them.

        Raise `MistrayError` if the object is not of type STANDARD.
        """
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
        distance = thickness.value(0, "a thickness or INFINITY")
        return math.inf if distance >= _INFINITE else distance * self.unit, material

    def _row(self, number: int, section: ZemaxSection, before: str, image: bool) -> Row:
        head = section.head
        assert head is not None
        kind = section.take("TYPE")
        name = kind.words[0].upper() if kind and kind.words else "STANDARD"
        if name not in KINDS and name != "COORDBRK":
            assert kind is not None
            remedy = _REMEDIES.get(name, f"mistray knows {', '.join(KINDS)} and COORDBRK, use one of them")
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

    def _thickness(self, section: ZemaxSection) -> float:
        line = section.take("DISZ")
        return (
            0.0 if line is None else line.value(0, "a thickness; only that of the object may be infinite") * self.unit
        )

    def _break(self, number: int, section: ZemaxSection, before: str) -> Row:
        section.take_all("CURV", "CONI", "DIAM")
        n = SagNumbers.of(section, self.unit)
        decentre = self._decentre([n.take(place) for place in range(1, 7)])
        self._rest(n, "COORDBRK")
        return Row(number, kind="coordinate_break", material=before, decentre=decentre)

    def _decentre(self, values: Sequence[float]) -> Decentre:
        """Return a decentre, mm, from x and y (lens units), three tilts (degrees) and the order (0: shift first)."""
        x, y, *tilt, order = values
        return Decentre(x=x * self.unit, y=y * self.unit, tilt_deg=(tilt[0], tilt[1], tilt[2]), tilt_first=order != 0)

    def _rest(self, n: SagNumbers, kind: str) -> None:
        """List as unread the values of a surface that its Zemax type `kind` does not use."""
        self.unread += [line.unread(f"{n.owner}: {kind} has no {what}") for what, line in n.left()]

    def _surface(self, number: int, section: ZemaxSection, before: str, image: bool, name: str) -> Row:
        head = section.head
        assert head is not None
        n = SagNumbers.of(section, self.unit, self._semi_diameter(section))
        figure = figure_of(name, n, self._first(section, "CURV"), self._first(section, "CONI"), head)
        self._rest(n, name)
        material, mirror = self._glass(section, before, image)
        stop = bool(section.take("STOP"))
        if stop:
            self.stop_mm = n.semi_diameter * self.unit
        return Row(
            number,
            kind="image" if image else "surface",
            material=material,
            mirror=mirror,
            stop=stop,
            coating=self._coating(section),
            decentre=self._before(section),
            **figure,
            **self._aperture(section),
        )

    def _semi_diameter(self, section: ZemaxSection) -> float:
        """Return the semi-diameter in the file, lens units, or 0; the line stays in the section."""
        lines = section.take_all("DIAM")
        for line in lines:
            section.add(line)
        return abs(lines[0].value(0, "a semi-diameter")) if lines and lines[0].words else 0.0

    def _first(self, section: ZemaxSection, key: str) -> float:
        line = section.take(key)
        return 0.0 if line is None else line.value(0)

    def _glass(self, section: ZemaxSection, before: str, image: bool) -> tuple[str, bool]:
        line = section.take("GLAS")
        if line is None:
            return "air", False
        if image:
            self.unread.append(line.unread("what lies behind the image has no effect"))
            return "air", False
        if line.words and line.words[0].upper() == "MIRROR":
            return before, True
        return self.glasses.material(line, self.materials), False

    def _aperture(self, section: ZemaxSection) -> dict[str, Any]:
        """
        Return the clear semi-diameter (mm), whether it stops light, and stated apertures, as arguments of `Row`.

        Raise `MistrayError` if there are two apertures, or the radii or half widths of one are not valid.
        """
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
            hole = circle(outer, inner, x, y) if inner or x or y else None
            return {"semi_diameter": drawn or outer or None, "semi_diameter_fixed": hole is None, "aperture": hole}
        stated = self._stated(lines[0], x, y, drawn) if lines else None
        if centre is not None and not lines and (x or y):
            self.unread.append(centre.unread("centre of an aperture that the surface does not have"))
        if stated is None or lines[0].key in _OBSCURATIONS:
            return {"semi_diameter": drawn or None, "obscuration": stated}
        x0, x1, y0, y1 = stated.bounds()
        (first, *more) = stated.figures
        reach = math.hypot(x, y) + first.sizes[0] if first.kind == "circle" else math.hypot(max(-x0, x1), max(-y0, y1))
        fixed = stated.annulus is not None and not more
        return {"semi_diameter": reach, "semi_diameter_fixed": fixed, "aperture": stated}

    def _stated(self, line: ZemaxLine, x: float, y: float, drawn: float) -> Outline | None:
        """
        Return the outline, mm, that a line of an aperture or obscuration in the Zemax file describes.

        None, for an aperture from a user's file, means that it stops no light. `x` and `y` are its centre, `drawn` is
        the semi-diameter in the file, or 0, all in mm. Raise `MistrayError` if radii or half widths are not valid.
        """
        if line.key not in _FIGURES and line.key != "SPID":
            self.unread.append(
                line.unread("aperture of a user's file: it stops no light here, the surface keeps its semi-diameter")
            )
            return None
        first = abs(line.value(0, "two numbers")) * self.unit
        if line.key == "SPID":
            return self._spider(line, first, x, y, drawn)
        second = abs(line.value(1, "two lengths")) * self.unit
        kind = _FIGURES[line.key]
        if kind == "circle":
            if not first < second:
                raise line.error(f"radii {first:g} and {second:g} mm; the second must be the greater one")
            return circle(second, first, x, y)
        if not min(first, second) > 0:
            raise line.error(f"half widths {first:g} and {second:g} mm; both must be greater than 0")
        if kind == "ellipse" and first == second:
            return circle(first, 0.0, x, y)
        return Outline((OutlineFigure(kind, "+", x, y, sizes=(first, second)),))

    def _spider(self, line: ZemaxLine, width: float, x: float, y: float, drawn: float) -> Outline | None:
        arms = line.whole(1, "the number of arms")
        if not (width > 0 and 1 <= arms <= MOST_FIGURES - 2):
            raise line.error(f"{arms} arms of {width:g} mm; give 1 to {MOST_FIGURES - 2} of a width above 0")
        half = 0.5 * (_SPIDER * drawn or _SPIDER_MM)
        angles = [360.0 * k / arms for k in range(arms)]
        return Outline(
            tuple(
                OutlineFigure(
                    "rectangle", "+", x + half * math.cos(math.radians(a)), y + half * math.sin(math.radians(a)), a,
                    (half, 0.5 * width),
                )
                for a in angles
            )
        )  # fmt: skip

    def _coating(self, section: ZemaxSection) -> str:
        line = section.take("COAT")
        if line is None or not line.words:
            return ""
        name = line.words[0]
        if self.coating_file is None:
            self.unread.append(line.unread("bare surface; give the coating file (coatings, --coatings) that holds it"))
            return name
        with errors_of(line.where):
            self.coating_file[name]
        return f"{self.coating_file.path}:{name}"

    def _before(self, section: ZemaxSection) -> Decentre | None:
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
        size = self.stop_mm or next((row.semi_diameter for row in rows if row.stop), None)
        if not size:
            raise MistrayError(
                f"lens '{self.path}': its aperture floats by the stop (FLOA), but no surface is a STOP with a "
                "semi-diameter (DIAM); add it"
            )
        return size

    def _list_rest(self, section: ZemaxSection) -> None:
        self.unread += [line.unread(f"not known to mistray, on {section.name}") for line in section.left()]

    def _after(self) -> None:
        """List lines behind the surfaces as unread if lines are not indented, as they may belong to a surface."""
        if not self.sections.indented:
            self.unread += [
                line.unread("not known to mistray, behind the surfaces") for line in self.sections.after.left()
            ]

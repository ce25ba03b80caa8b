"""Reader of the system data of a .zmx file: units, aperture, fields, wavelengths.

======================  ==========================================================================================
``UNIT MM …``           lens units: MM, CM, IN, METER
``ENPD d``              entrance pupil diameter
``FNUM f p``            image-space F-number; p = 1: paraxial working F-number
``OBNA a p``            object-space NA n sin θ; p = 1: half angle θ of the object's cone, degrees
``FLOA``                the stop's semi-diameter decides
``FTYP t c f w …``      t: 0 angle, 1 object height, 2 paraxial and 3 real image height, 4 theodolite angles; c = 1:
                        object space is telecentric; f, w: number of fields and wavelengths that count
``XFLN``, ``YFLN``      fields, degrees or lens units; ``XFLD``, ``YFLD`` in old files
``VDXN`` … ``VANN``     vignetting: decentre, compression, angle
``WAVM i λ w``          wavelength i in µm and its weight; ``WAVL``, ``WAVN`` and ``WWGT``, ``WWGN``: lists of them
``PWAV i``              the primary wavelength
``GFAC t f``            apodisation of the pupil, t = 0: none
======================  ==========================================================================================

Source: OpticStudio help, "System Explorer"; the lines hold its entries in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mistray.io.zemax.lines import ZemaxLine, ZemaxSection
from mistray.prescription.sequential.table import ApertureKind, FieldKind, Unread

_UNIT_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "M": 1000.0, "METER": 1000.0, "METERS": 1000.0}
_FIELD_KINDS: tuple[FieldKind, ...] = ("angle_deg", "object_height", "image_height", "image_height", "angle_deg")
_THEODOLITE = 4
MOST_WAVELENGTHS = 24


@dataclass(frozen=True)
class System:
    """
    System data of a lens; see `Sequential` for the attributes with equal names.

    Attributes
    ----------
    unit_mm : float
        Lens unit in mm.
    floating : bool
        Whether the semi-diameter of the stop decides; `aperture` is still 0 then.
    cone : bool
        Whether `aperture` is the sine of the object's cone, without the index of the object's medium.
    working : bool
        Whether `aperture` is the paraxial F-number for the file's object distance, not for an object at infinity.
    telecentric : ZemaxLine or None
        Line that makes object space telecentric; None if it is not.
    catalogues : tuple of str
        Names of the glass catalogues.
    """

    name: str
    unit_mm: float
    aperture_kind: ApertureKind
    aperture: float
    floating: bool
    cone: bool
    working: bool
    telecentric: ZemaxLine | None
    field_kind: FieldKind
    fields: tuple[tuple[float, float], ...]
    vignetting: tuple[tuple[float, float, float, float], ...]
    wavelengths_nm: tuple[float, ...]
    weights: tuple[float, ...]
    primary: int
    catalogues: tuple[str, ...]
    unread: tuple[Unread, ...]
    notes: tuple[str, ...]


def read_system(section: ZemaxSection, path: Path) -> System:
    """
    Read the system data of a lens: units, aperture, fields, wavelengths.

    Raises
    ------
    MistrayError
        If the file is not sequential, or a value is missing or out of its range; the message names file and line.
    """
    return _Reader(section, path).system()


class _Reader:
    def __init__(self, section: ZemaxSection, path: Path) -> None:
        self.section, self.path = section, path
        self.unread: list[Unread] = []
        self.notes: list[str] = []
        self.cone = self.working = False

    def system(self) -> System:
        self._mode()
        name = self.section.take("NAME")
        unit = self._unit()
        kind, aperture, floating = self._aperture(unit)
        head = self.section.take("FTYP")
        field_kind, fields, vignetting = self._fields(head, unit)
        wavelengths, weights, primary = self._wavelengths(head)
        self._environment()
        telecentric = head is not None and head.whole(1, "0 or 1", default=0) != 0
        return System(
            name=" ".join(name.words).strip('"') if name and name.words else self.path.stem,
            unit_mm=unit,
            aperture_kind=kind,
            aperture=aperture,
            floating=floating,
            cone=self.cone,
            working=self.working,
            telecentric=head if telecentric else None,
            field_kind=field_kind,
            fields=fields,
            vignetting=vignetting,
            wavelengths_nm=wavelengths,
            weights=weights,
            primary=primary,
            catalogues=tuple(word for line in self.section.take_all("GCAT") for word in line.words),
            unread=(*self.unread, *(line.unread("not known to mistray") for line in self.section.left())),
            notes=tuple(self.notes),
        )

    def _mode(self) -> None:
        mode = self.section.take("MODE")
        if mode is not None and mode.words[:1] != ("SEQ",):
            raise mode.error(f"'{mode.shown}': mistray reads sequential lenses (MODE SEQ); bring the rest in as STEP")

    def _unit(self) -> float:
        line = self.section.take("UNIT")
        if line is None:
            self.notes.append("the file names no unit; taken to be mm")
            return 1.0
        word = line.words[0].upper() if line.words else ""
        if word not in _UNIT_MM:
            raise line.error(f"unit '{line.word(0)}'; it is one of {', '.join(_UNIT_MM)}")
        return _UNIT_MM[word]

    def _aperture(self, unit: float) -> tuple[ApertureKind, float, bool]:
        lines = self.section.take_all("ENPD", "FNUM", "OBNA", "FLOA")
        if not lines:
            self.notes.append("the file says nothing about the aperture of the system (ENPD, FNUM, OBNA, FLOA)")
            return "entrance_pupil_diameter", 0.0, False
        if len(lines) > 1:
            raise lines[1].error(f"'{lines[1].shown}' beside '{lines[0].shown}'; a lens has one aperture, remove one")
        (line,) = lines
        if line.key == "FLOA":
            return "stop_diameter", 0.0, True
        value = line.value(0, "the aperture")
        if value <= 0:
            raise line.error(f"aperture {value:g}; it must be greater than 0")
        if line.key == "ENPD":
            return "entrance_pupil_diameter", value * unit, False
        special = line.whole(1, "0 or 1", default=0) == 1
        if line.key == "FNUM":
            self.working = special
            return "f_number", value, False
        self.cone = special
        if special and value >= 90:
            raise line.error(f"object cone angle {value:g} degrees; it must be below 90")
        return "object_na", math.sin(math.radians(value)) if special else value, False

    def _fields(
        self, head: ZemaxLine | None, unit: float
    ) -> tuple[FieldKind, tuple[tuple[float, float], ...], tuple[tuple[float, float, float, float], ...]]:
        kind = head.whole(0, "a field type", default=0) if head else 0
        if head is not None and not 0 <= kind < len(_FIELD_KINDS):
            raise head.error(f"field type {kind}; it lies between 0 and {len(_FIELD_KINDS) - 1}")
        columns = {key: self._column(key) for key in ("XFLN", "YFLN", "XFLD", "YFLD")}
        x, y = columns["XFLN"] or columns["XFLD"], columns["YFLN"] or columns["YFLD"]
        count, listed = head.whole(2, "the number of fields", default=0) if head else 0, max(len(x), len(y), 1)
        if head is not None and count > listed:
            raise head.error(f"{count} fields, but the file lists {listed}; correct the number")
        points = [(_at(x, i), _at(y, i)) for i in range(count if count > 0 else listed)]
        if head is not None and kind == _THEODOLITE:
            points = [_field_angles(head, *point) for point in points]
        elif kind:
            points = [(a * unit, b * unit) for a, b in points]
        if kind == 3:
            self.notes.append("fields are real image heights; they are taken as paraxial ones")
        return _FIELD_KINDS[kind], tuple(points), self._vignetting(len(points))

    def _vignetting(self, count: int) -> tuple[tuple[float, float, float, float], ...]:
        columns = [self._column(key) for key in ("VDXN", "VDYN", "VCXN", "VCYN")]
        rows = tuple(
            (_at(columns[0], i), _at(columns[1], i), _at(columns[2], i), _at(columns[3], i)) for i in range(count)
        )
        angle = self.section.take("VANN")
        if angle is not None and any(angle.values("angles")):
            self.unread.append(angle.unread("vignetted pupils are not turned"))
        return rows

    def _column(self, key: str) -> tuple[float, ...]:
        line = self.section.take(key)
        return line.values("numbers") if line else ()

    def _wavelengths(self, head: ZemaxLine | None) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        found = self._single_wavelengths() or self._listed_wavelengths()
        count = head.whole(3, "the number of wavelengths", default=0) if head else 0
        if not 0 < count <= len(found):
            if count > len(found) > 0 and head is not None:
                raise head.error(f"{count} wavelengths, but the file lists {len(found)}; correct the number")
            # Files without the number fill their list up with one value
            found = {place: value for place, value in found.items() if value not in list(found.values())[: place - 1]}
            count = len(found)
        line = self.section.take("PWAV")
        primary = line.whole(0, "the primary wavelength") if line else 1
        if not found:
            self.notes.append("the file lists no wavelength; taken to be 587.56 nm")
            return (587.56,), (1.0,), 0
        used = list(found)[:count]
        if primary not in used:
            where = line or head
            assert where is not None  # else it is the first
            raise where.error(f"primary wavelength {primary}; the lens has {count} wavelengths")
        return (
            tuple(found[place][0] for place in used),
            tuple(found[place][1] for place in used),
            used.index(primary),
        )

    def _single_wavelengths(self) -> dict[int, tuple[float, float]]:
        found: dict[int, tuple[float, float]] = {}
        for line in self.section.take_all("WAVM"):
            place = line.whole(0, "the number of the wavelength")
            if place != len(found) + 1 or place > MOST_WAVELENGTHS:
                raise line.error(f"'{line.shown}' follows wavelength {len(found)}; they are numbered from 1 on")
            weight = line.value(2, "a weight") if len(line.words) > 2 else 1.0
            found[place] = _nm(line, line.value(1, "a wavelength in µm")), weight
        return found

    def _listed_wavelengths(self) -> dict[int, tuple[float, float]]:
        line = self.section.take("WAVL") or self.section.take("WAVN")
        weights = self._column("WWGT") or self._column("WWGN")
        if line is None:
            return {}
        values = line.values("wavelengths in µm")
        return {
            place: (_nm(line, um), weights[place - 1] if place <= len(weights) else 1.0)
            for place, um in enumerate(values, 1)
        }

    def _environment(self) -> None:
        line = self.section.take("ENVD")
        if line is not None and (line.value(0, "a temperature") != 20 or line.value(1, "a pressure") != 1):
            self.unread.append(line.unread("indices and lengths are those at 20 °C and 1 atm"))
        apodised = self.section.take("GFAC")
        if apodised is not None and apodised.whole(0, "the kind of apodisation", default=0) != 0:
            self.unread.append(apodised.unread("the pupil is lit evenly, without apodisation"))


def _at(column: tuple[float, ...], place: int) -> float:
    return column[place] if place < len(column) else 0.0


def _nm(line: ZemaxLine, um: float) -> float:
    if not um > 0:
        raise line.error(f"wavelength {um:g} µm; it must be greater than 0")
    return round(um * 1e3, 9)


def _field_angles(head: ZemaxLine, azimuth: float, elevation: float) -> tuple[float, float]:
    """
    Return field angles in x and y, degrees, whose tangents give the direction, from theodolite angles, degrees.

    Raise `MistrayError` for angles of 90° or more.
    """
    if max(abs(azimuth), abs(elevation)) >= 90:
        raise head.error(f"field of theodolite angles {azimuth:g}, {elevation:g} degrees; both must be within ±90")
    cosine = math.cos(math.radians(azimuth))
    return azimuth, math.degrees(math.atan(math.tan(math.radians(elevation)) / cosine))

"""Reader of CODE V command files (.seq).

It reads the system data (DIM, EPD, FNO, NA, NAO, TEL, WL, WTW, REF, XAN YAN, XOB YOB, XIM YIM, XRI YRI, VUX VLX VUY
VLY, TIT, RDM, PRV … END) and the surfaces: ``S``, ``SO``, ``SI`` with curvature or radius, thickness and glass; RDY,
CUY, THI, GLA, RMD, STO, SLB; SPH, CON, ASP with K and A … J; CYL, YTO, XTO, AAS and SPS, see `sags`; CIR, REX, REY,
ELX, ELY (clear, EDG, OBS, HOL) with ADX, ADY, ARO; XDE … CDE with DAR, REV, BEN; zoom positions, see `zoom`. Any other
command is refused if ignoring it would change the lens, else listed in `Sequential.unread`.

Meaning of commands, from O'Shea and Bentley (see `mistray.io.codev.commands`) and from designs whose images are known:

- ADE and BDE rotate left-handed about x and y, CDE right-handed about z, in this order, after the shift.
- DAR: later surfaces are placed as if there had been no move. REV: the surface stays, and later ones move by the
  inverse. BEN: behind the mirror the axis follows the reflected axial ray.
- Clear apertures of a surface clip together. ARO rotates them about their own centre, right-handed about z like CDE.
- The thickness of SI is a defocus: it adds to the thickness before the image.
- An object 1e9 units away or farther is at infinity.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError, errors_of
from mistray.io.codev.commands import CHANGES_THE_LENS, HAS_NO_EFFECT, ORDERS, SeqCommand, commands
from mistray.io.codev.glasses import CodevGlasses, table_material
from mistray.io.codev.rows import CodevSurface, rows_of
from mistray.io.codev.sags import ANAMORPHIC, SPECIAL
from mistray.io.codev.zoom import ZoomPosition
from mistray.io.conventions import object_na, squeezed
from mistray.io.glasses import CATALOGUES, GLASSES
from mistray.materials.agf import decode
from mistray.prescription.sequential.table import ApertureKind, FieldKind, Row, Sequential, Unread
from mistray.read_file import read_file

_UNITS_MM = {"M": 1.0, "C": 10.0, "I": 25.4}
_INFINITE = 1e9
_SURFACE = re.compile(r"S(\d{0,6}|[OI])")
_APERTURES = ("CLR", "EDG", "OBS", "HOL")
_QUALIFIER = re.compile(r"S(\d{1,6}|[OIS])(?:\.\.(\d{1,6}|I))?", re.IGNORECASE)
_FIELD_KINDS: dict[str, FieldKind] = {
    "AN": "angle_deg",
    "OB": "object_height",
    "IM": "image_height",
    "RI": "image_height",
}


def _inverse(radius: float) -> float:
    """
    Return the curvature for a radius, in the inverse of its unit; radius 0 means a plane.

    Raise `MistrayError` if the radius is too small for a finite curvature.
    """
    curvature = 1 / radius if radius else 0.0
    if math.isinf(curvature):
        raise MistrayError(f"radius {radius:g} is too small; 0 is a plane")
    return curvature


# Commands that state an attribute of a surface, and what it is made of
_STATED: dict[str, tuple[str, Callable[[SeqCommand], Any]]] = {
    "CUY": ("curvature", SeqCommand.number),
    "RDY": ("curvature", lambda command: _inverse(command.number())),
    "CUX": ("curvature_x", SeqCommand.number),
    "RDX": ("curvature_x", lambda command: _inverse(command.number())),
    "THI": ("thickness", SeqCommand.number),
    "K": ("conic", SeqCommand.number),
    "SLB": ("label", lambda command: " ".join(command.words[1:])),
    **dict.fromkeys(("CYL", "XTO", "YTO", "AAS"), ("kind", lambda command: command.name)),
    **dict.fromkeys(("DAR", "REV", "BEN"), ("mode", lambda command: command.name)),
}
# Commands that state an entry of an attribute, and its key
_ENTRIES: dict[str, tuple[str, Any]] = {
    **{name: ("extra", name) for name in ("KX", *ANAMORPHIC)},
    **{name: ("coefficients", place) for place, name in enumerate(ORDERS)},
    **{name: ("moves", name[0]) for name in ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE")},
}


def read_codev(
    path: str | Path,
    *,
    radius_mode: bool | None = None,
    configuration: int | str | None = None,
    glass_catalogues: str | Path | Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
) -> Sequential:
    r"""
    Read a sequential lens from a CODE V command file.

    Parameters
    ----------
    path : str or Path
        The .seq file.
    radius_mode : bool or None
        Whether surfaces are given by radii, for files without RDM. ``None``: by curvatures, the default of CODE V; the
        lens's `notes` then state both readings.
    configuration : int, str or None
        Number of the zoom position, from 1 on, or its name; ``None``: the first one.
    glass_catalogues : str, Path or sequence of them
        AGF files, which take precedence over the glasses of `mistray.materials`.
    glasses : mapping of str to str
        Glass as named in the file → material string; takes precedence over all catalogues.

    Returns
    -------
    Sequential
        Lens in mm and degrees.

    Raises
    ------
    MistrayError
        If the file cannot be read, a number or a glass is not understood, an unsupported command would change the lens,
        or ``radius_mode`` contradicts the file. The message names file and line.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "RDM; LEN; EPD 8; DIM M; WL 588; YAN 0; SO 0 1E20; S 50 5 NBK7_SCHOTT; STO; S -50 46; SI 0 0; GO"
    >>> _ = Path("singlet.seq").write_text(text.replace("; ", "\n"))
    >>> lens = mistray.prescription.read_codev("singlet.seq")
    >>> [(row.radius, row.thickness, row.material) for row in lens.rows[:2]]
    [(50.0, 5.0, 'schott/N-BK7'), (-50.0, 46.0, 'air')]
    """
    path = Path(path)
    data = read_file(path, "CODE V file")
    replaced = GLASSES.check("glasses", {} if glasses is None else glasses)
    reader = _Reader(path, radius_mode, CATALOGUES.check("glass_catalogues", glass_catalogues), replaced)
    zoom = ZoomPosition(configuration)
    with errors_of(f"CODE V file '{path.name}'"):
        found = list(zoom.commands(commands(decode(data))))
    for command in found:
        with errors_of(f"CODE V file '{path.name}' line {command.line}"):
            reader.take(command)
    reader.notes += [zoom.note] if zoom.note else []
    with errors_of(f"CODE V file '{path.name}'"):
        return reader.lens()


class _Reader:
    """Reader of CODE V commands: `take` processes one, and `lens` returns the finished lens."""

    def __init__(
        self,
        path: Path,
        radius_mode: bool | None,
        catalogues: Sequence[str | Path],
        replaced: Mapping[str, str],
    ) -> None:
        self.path = path
        self.catalogues, self.replaced = catalogues, replaced
        self.asked_radius = radius_mode
        self.radius: bool | None = None
        self.first_value: tuple[int, float] | None = None
        self.telecentric: SeqCommand | None = None
        self.title = ""
        self.unit_mm = 1.0
        self.pupil: tuple[str, float] | None = None
        self.field_kind: FieldKind | None = None
        self.fields: dict[str, list[float]] = {}
        self.vignetting: dict[str, list[float]] = {}
        self.wavelengths: list[float] = []
        self.weights: list[float] = []
        self.reference: float | None = None
        self.object = CodevSurface(0, thickness=math.inf)
        self.surfaces: list[CodevSurface] = []
        self.image: CodevSurface | None = None
        self.current: CodevSurface | None = None
        self.stop: CodevSurface | None = None
        self.glass_words: list[tuple[CodevSurface, str, int]] = []
        self.in_catalogue = False
        self.table_nm: list[float] = []
        self.tables: dict[str, tuple[list[float], list[float]]] = {}
        self.unread: list[Unread] = []
        self.notes: list[str] = []
        self.ended = False

    # Commands

    def take(self, command: SeqCommand) -> None:
        """
        Process one command: store what it states, or list it as unread.

        Raise `MistrayError` if the command changes the lens in a way that is not read.
        """
        name = command.name
        if self.ended:
            self._skip(command, "after GO: commands that analyse the lens")
        elif name == "END":
            self.in_catalogue = False
        elif self.in_catalogue:
            self._catalogue(command)
        elif match := _SURFACE.fullmatch(name):
            self._surface(command, match[1])
        elif name in CHANGES_THE_LENS:
            where = "".join(f" on surface {k}" for k, each in enumerate(self.surfaces, 1) if each is self.current)
            raise MistrayError(
                f"'{command.text}'{where}: {CHANGES_THE_LENS[name]}; remove it if the lens is right without"
            )
        elif name == "CUF" and command.number():
            raise MistrayError(f"'{command.text}': Fresnel surfaces have no counterpart; replace it by an asphere")
        elif name in HAS_NO_EFFECT:
            self._skip(command, HAS_NO_EFFECT[name])
        elif not (self._system(command) or self._of_surface(command)):
            self._skip(command, "an unknown command; if it changes the lens, this is another one")

    def _skip(self, command: SeqCommand, reason: str) -> None:
        self.unread.append(Unread(command.line, command.text, reason))

    def _system(self, command: SeqCommand) -> bool:
        """
        Process a command about the whole system; return False if it is not one.

        Raise `MistrayError` if it states an unknown unit, a second kind of fields, or another radius mode than the
        caller's.
        """
        name, words = command.name, command.words[1:]
        if name == "LEN":
            pass
        elif name == "GO":
            self.ended = True
        elif name == "RDM":
            self.radius = not words or words[0][:1].upper() != "N"
            if self.asked_radius is not None and self.asked_radius is not self.radius:
                raise MistrayError(f"'{command.text}' against radius_mode={self.asked_radius}; leave radius_mode out")
        elif name == "TIT":
            self.title = " ".join(words)
        elif name == "DIM":
            unit = words[0][:1].upper() if words else ""
            if unit not in _UNITS_MM:
                raise MistrayError(f"'{command.text}': unknown unit; it is M (mm), C (cm) or I (inch)")
            self.unit_mm = _UNITS_MM[unit]
        elif name == "TEL":
            self.telecentric = command if not words or words[0][:1].upper() != "N" else None
        elif name in ("EPD", "FNO", "NA", "NAO"):
            self.pupil = name, command.positive()
        elif name == "WL":
            self.wavelengths = [command.positive(place) for place in range(len(words))] or [command.positive()]
        elif name == "WTW":
            self.weights = command.numbers()
        elif name == "REF":
            self.reference = command.number()
        elif name[:1] in "XY" and name[1:] in _FIELD_KINDS:
            kind = _FIELD_KINDS[name[1:]]
            if self.field_kind not in (None, kind):
                raise MistrayError(f"'{command.text}': other fields are of kind '{self.field_kind}'; use one kind")
            self.field_kind = kind
            self.fields[name[0]] = self._listed(command, self.fields.get(name[0], []))
            if name[1:] == "RI" and any(self.fields[name[0]]):
                self.notes.append(f"{name}: real image heights are taken as paraxial ones")
        elif name in ("VUX", "VLX", "VUY", "VLY"):
            self.vignetting[name] = self._listed(command, self.vignetting.get(name, []))
        elif name == "PRV":
            self.in_catalogue = True
        else:
            return False
        return True

    @staticmethod
    def _listed(command: SeqCommand, known: list[float]) -> list[float]:
        """
        Return the values of a command for all fields. In ``YAN F2 10`` it is `known` with one value replaced.

        Raise `MistrayError` if the number of a field is below 1.
        """
        words = command.words[1:]
        if not words or not re.fullmatch(r"[Ff]\d{1,3}", words[0]):
            return command.numbers()
        place = int(words[0][1:])
        if place < 1:
            raise MistrayError(f"'{command.text}': fields are numbered from F1 on")
        found = known + [0.0] * (place - len(known))
        found[place - 1] = command.number(1)
        return found

    def _catalogue(self, command: SeqCommand) -> None:
        """
        Process a line of the private glass catalogue, between PRV and END.

        A glass given by coefficients is listed as unread. Raise `MistrayError` if a glass does not have one index for
        each wavelength.
        """
        if command.name == "PWL":
            self.table_nm = command.numbers()
            return
        try:
            indices = command.numbers()
        except MistrayError:
            return self._skip(command, "a private glass given by coefficients; only tables are read")
        if len(indices) != len(self.table_nm) or len(set(self.table_nm)) < len(indices) or not indices:
            raise MistrayError(f"'{command.text}': {len(indices)} indices for {len(self.table_nm)} wavelengths of PWL")
        self.tables[command.words[0].upper()] = self.table_nm, indices

    def _surface(self, command: SeqCommand, which: str) -> None:
        """
        Process ``S``, ``S3``, ``SO`` (also ``S0``) or ``SI``, with curvature or radius, thickness and glass.

        `which` is what stands behind the S. ``S`` without a number adds a surface. Raise `MistrayError` if a number
        leaves out a surface.
        """
        if which in ("O", "0"):
            surface = self.object
        elif which == "I":
            surface = self.image = self.image or CodevSurface(command.line)
        elif which and int(which) <= len(self.surfaces):
            surface = self._numbered(which)
        elif which and int(which) > len(self.surfaces) + 1:
            raise MistrayError(f"'{command.text}': there are {len(self.surfaces)} surfaces so far")
        else:
            surface = CodevSurface(command.line)
            self.surfaces.append(surface)
        surface.line, self.current = command.line, surface
        values = command.words[1:]
        if values:
            self._shape(surface, command.number())
        if len(values) > 1:
            surface.thickness = command.number(1)
        for word in values[2:4]:
            self._glass(surface, word, command.line)
        if len(values) > 4:
            self._skip(command, "there are words behind the glass and the mode")

    def _shape(self, surface: CodevSurface, value: float) -> None:
        if value and self.first_value is None and surface in self.surfaces:
            self.first_value = len(self.surfaces), value
        radius = self.radius if self.radius is not None else bool(self.asked_radius)
        surface.curvature = _inverse(value) if radius else value

    def _glass(self, surface: CodevSurface, word: str, line: int) -> None:
        """Record the glass of a surface, or that it is a mirror; the glass is looked up after the last line."""
        if word.upper() in ("REFL", "REFR"):
            surface.mirror = word.upper() == "REFL"
        else:
            self.glass_words.append((surface, word, line))

    def _of_surface(self, command: SeqCommand) -> bool:
        """
        Process a command about surfaces; return False if it is not one.

        Raise `MistrayError` if no surface has been stated so far and the command names none.
        """
        name = command.name
        takers = {
            "GLA": self._take_glass,
            "RMD": self._take_glass,
            "STO": self._take_stop,
            "SPS": self._take_special,
            "SCO": self._take_special_number,
            **dict.fromkeys(("CIR", "REX", "REY", "ELX", "ELY"), self._take_aperture),
            **dict.fromkeys(("ADX", "ADY", "ARO"), self._take_offset),
        }
        if not (name in takers or name in _STATED or name in _ENTRIES or name in ("SPH", "CON", "ASP")):
            return False
        words = command.words[1:]
        surfaces = [self.current] if self.current else []
        labels = name == "SLB" and len(words) < 2  # a label may look like a surface
        if words and not labels and (match := _QUALIFIER.fullmatch(words[0])):
            surfaces, words = self._meant(match), words[1:]
        if not surfaces:
            raise MistrayError(f"'{command.text}': it stands before the first surface; give it a surface, as in 'S1'")
        for surface in surfaces:
            own = replace(command, words=(name, *words))
            if name in takers:
                takers[name](surface, own)
            elif name in _STATED:
                attribute, value = _STATED[name]
                setattr(surface, attribute, value(own))
            elif name in _ENTRIES:
                attribute, key = _ENTRIES[name]
                getattr(surface, attribute)[key] = own.number()
            elif name == "SPH":
                surface.conic, surface.coefficients, surface.kind = 0.0, {}, ""
        return True

    def _meant(self, match: re.Match[str]) -> list[CodevSurface]:
        """Return the surfaces that a designation such as ``S3``, ``SO``, ``SI``, ``SS`` or ``S2..4`` stands for."""
        first, last = match[1].upper(), match[2]
        if last:
            end = len(self.surfaces) if last.upper() == "I" else int(last)
            return [self._numbered(str(number)) for number in range(int(first) if first.isdigit() else 1, end + 1)]
        if first in ("O", "0"):
            return [self.object]
        if first == "I":
            self.image = self.image or CodevSurface(0)
            return [self.image]
        if first == "S":
            return [self.stop or self._numbered("1")]
        return [self._numbered(first)]

    def _numbered(self, number: str) -> CodevSurface:
        if not 1 <= int(number) <= len(self.surfaces):
            raise MistrayError(f"surface {number} is not there; the lens has {len(self.surfaces)} so far")
        return self.surfaces[int(number) - 1]

    # Commands about one surface

    def _take_glass(self, surface: CodevSurface, command: SeqCommand) -> None:
        if len(command.words) < 2:
            raise MistrayError(f"'{command.text}': no glass; name one, AIR or REFL")
        self._glass(surface, command.words[1], command.line)

    def _take_stop(self, surface: CodevSurface, command: SeqCommand) -> None:
        if self.stop not in (None, surface):
            self.notes.append(f"line {command.line}: the stop moves here from the surface of line {self.stop.line}")
        self.stop = surface

    def _take_special(self, surface: CodevSurface, command: SeqCommand) -> None:
        kind = command.words[1].upper() if len(command.words) > 1 else ""
        if kind not in SPECIAL:
            raise MistrayError(
                f"'{command.text}': of special surfaces {', '.join(SPECIAL)} are read; convert it, or fit an asphere"
            )
        surface.kind = kind
        if len(command.words) > 2:
            surface.extra["NRADIUS"] = command.number(1)

    def _take_special_number(self, surface: CodevSurface, command: SeqCommand) -> None:
        if len(command.words) < 3:
            raise MistrayError(f"'{command.text}': it needs a coefficient and a value, as in SCO C4 1e-3")
        name, value = command.words[1].upper(), command.number(1)
        if name in ("K", "C1"):
            surface.conic = value
        else:
            surface.extra[name] = value

    def _take_aperture(self, surface: CodevSurface, command: SeqCommand) -> None:
        words = [word for word in command.words[1:] if not re.match(r"L'", word, re.IGNORECASE)]
        kind = "CLR"
        if words and words[0].upper() in _APERTURES:
            kind = words.pop(0).upper()
        value = replace(command, words=(command.name, *words)).positive()
        known = surface.apertures.setdefault(kind, {})
        if command.name in known:
            self._skip(known[command.name][1], f"line {command.line} replaces it; one aperture of a kind is read")
        known[command.name] = value, command

    def _take_offset(self, surface: CodevSurface, command: SeqCommand) -> None:
        words = list(command.words[1:])
        kind = words.pop(0).upper() if words and words[0].upper() in _APERTURES else ""
        surface.offset[kind + command.name[-1]] = replace(command, words=(command.name, *words)).number()

    # The lens

    def lens(self) -> Sequential:
        """
        Return the lens of all commands, in mm and degrees.

        Raise `MistrayError` if there is no surface or wavelength, or the reference wavelength is not one of them.
        """
        if not self.surfaces:
            raise MistrayError("it has no surface; a lens has lines 'S curvature thickness glass'")
        wavelengths = self.wavelengths
        if not wavelengths:
            raise MistrayError("it has no wavelength; add a line such as 'WL 587.6'")
        self._note_radius_mode()
        materials = self._materials()
        rows = self._rows(materials)
        primary = (len(wavelengths) - 1) // 2 if self.reference is None else int(self.reference) - 1
        if self.reference is None and len(wavelengths) > 1:
            self.notes.append(
                f"no REF: {wavelengths[primary]:g} nm, the one in the middle, is the reference wavelength"
            )
        if not 0 <= primary < len(wavelengths):
            raise MistrayError(f"REF {self.reference or 0:g} of {len(wavelengths)} wavelengths; give one of them")
        distance = self.object.thickness
        distance = math.inf if abs(distance) >= _INFINITE else distance * self.unit_mm
        object_material = materials.get(id(self.object), "air")
        self._unread_of_ends()
        if self.telecentric is not None and math.isinf(distance):
            self._skip(self.telecentric, "telecentric object space: the object lies at infinity")
        fields, vignetting = self._fields()
        lens = Sequential(
            self.title or self.path.stem,
            tuple(rows),
            source=f"CODE V file {self.path.name}",
            object_distance=distance,
            object_material=object_material,
            telecentric=self.telecentric is not None and math.isfinite(distance),
            field_kind=self.field_kind or "angle_deg",
            fields=fields,
            vignetting=vignetting,
            wavelengths_nm=tuple(wavelengths),
            weights=tuple((self.weights + [1.0] * len(wavelengths))[: len(wavelengths)]),
            primary=primary,
            unread=tuple(sorted(self.unread, key=lambda entry: entry.line)),
        )
        kind, aperture = self._aperture(lens)
        return replace(lens, aperture_kind=kind, aperture=aperture, notes=tuple(self.notes))

    def _materials(self) -> dict[int, str]:
        """Return the material string behind each surface, keyed by Python's `id` of the surface."""
        private = {key: table_material(*table, self.wavelengths) for key, table in self.tables.items()}
        found = CodevGlasses(private, self.catalogues, self.replaced, self.wavelengths)
        materials: dict[int, str] = {}
        for surface, word, line in self.glass_words:
            with errors_of(f"line {line}"):
                materials[id(surface)] = found.material(word)
        self.notes += found.notes
        return materials

    def _rows(self, materials: dict[int, str]) -> list[Row]:
        stop = self.stop
        if stop is None:
            self.notes.append("no STO: surface 1 is the stop, the default of CODE V")
            stop = self.surfaces[0]
        if self.image is None:
            self.notes.append("no SI: the image is a plane at the thickness of the last surface")
        image = self.image or CodevSurface(0)
        self.surfaces[-1].thickness += image.thickness
        image.thickness = 0.0
        rows: list[Row] = []
        before = materials.get(id(self.object), "air")
        for number, surface in enumerate(self.surfaces, 1):
            surface.material = materials.get(id(surface), "")
            more = {"stop": surface is stop}
            new = rows_of(surface, number, unit_mm=self.unit_mm, before=before, unread=self.unread, **more)
            rows += new
            before = new[-1].material
        image.material = before
        image.mode = ""
        last = rows_of(image, len(rows), unit_mm=self.unit_mm, before=before, unread=self.unread, kind="image")
        return [*rows, replace(last[0], number=len(self.surfaces) + 1)]

    def _unread_of_ends(self) -> None:
        """List curvature, moves and apertures of the object surface as unread."""
        if self.object.curvature or self.object.kind or self.object.moves or self.object.apertures:
            self.unread.append(
                Unread(self.object.line, "SO", "the object is taken for plane, unmoved and without an aperture")
            )

    def _note_radius_mode(self) -> None:
        if self.radius is not None or self.first_value is None:
            return
        number, value = self.first_value
        as_radius, as_curvature = (
            f"radius {value * self.unit_mm:.6g} mm",
            f"curvature {value / self.unit_mm:.6g} /mm (radius {self.unit_mm / value:.6g} mm)",
        )
        if self.asked_radius is None:
            self.notes.append(
                f"no RDM: {value:g} of surface {number} is read as {as_curvature}, the default of CODE V; "
                f"radius_mode=True reads it as {as_radius}"
            )
        else:
            self.notes.append(
                f"no RDM: {value:g} of surface {number} is read as {(as_curvature, as_radius)[self.asked_radius]}"
            )

    def _aperture(self, lens: Sequential) -> tuple[ApertureKind, float]:
        if self.pupil is None:
            raise MistrayError("it has none of EPD, FNO, NA and NAO; add one, as in 'EPD 25'")
        name, value = self.pupil
        if name == "EPD":
            return "entrance_pupil_diameter", value * self.unit_mm
        if name == "NAO":
            return "object_na", value
        if math.isinf(lens.object_distance):
            return "f_number", value if name == "FNO" else 1 / (2 * value)
        found = object_na(lens, 1 / (2 * value) if name == "FNO" else value)
        self.notes.append(f"{name} {value:g} at a finite distance is the paraxial cone of object-space NA {found:.6g}")
        return "object_na", found

    def _fields(self) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float, float, float], ...]]:
        """Return fields (x, y), mm or degrees, and for each the vignetting (VDX, VDY, VCX, VCY) of `squeezed`."""
        count = max((len(values) for values in self.fields.values()), default=1)
        if not self.fields:
            self.notes.append("no field: the axis alone")
        factor = self.unit_mm if self.field_kind not in (None, "angle_deg") else 1.0
        x, y = (self.fields.get(axis, []) + [0.0] * count for axis in "XY")
        fields = tuple((x[k] * factor, y[k] * factor) for k in range(count))
        ux, lx, uy, ly = (self.vignetting.get(key, []) + [0.0] * count for key in ("VUX", "VLX", "VUY", "VLY"))
        return fields, tuple(squeezed(ux[k], lx[k], uy[k], ly[k]) for k in range(count))

"""Reader of lens files of other programs as prescriptions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.analyses.import_lens.request import LensRequest
from mistray.errors import MistrayError
from mistray.read_file import require_file
from mistray.toolkit.field_options import flag

if TYPE_CHECKING:
    from mistray.prescription import Prescription, Sequential
    from mistray.prescription.closing.system import Built
    from mistray.scene import Rules

FORMATS = {
    ".json": "JSON",
    ".yaml": "batoid",
    ".yml": "batoid",
    ".zmx": "Zemax",
    ".seq": "CODE V",
    ".len": "OSLO",
    ".lens": "FlareSim",
    ".roa": "ray-optics",
}
"""Kinds of lens files by the endings of their names."""
_SEQUENTIAL = ("Zemax", "CODE V", "OSLO", "FlareSim", "ray-optics")
_WITH_GLASSES = ("Zemax", "CODE V", "OSLO")
# Fields that only some formats know: each with the words for it and the formats
ONLY = {
    "variant": ("variants", ("JSON",)),
    "wavelength_nm": ("wavelength of a source", ("JSON", "batoid", *_SEQUENTIAL)),
    "edges": ("edges to choose", _SEQUENTIAL),
    "coatings": ("coatings by name", ("Zemax",)),
    "glass": ("glass names", _WITH_GLASSES),
    "glass_catalogue": ("glass names", _WITH_GLASSES),
    "radius_mode": ("radius mode", ("CODE V",)),
    "configuration": ("configurations", _WITH_GLASSES),
    "margin": ("clear radii to choose", _SEQUENTIAL),
    "beam": ("beam of a source", ("JSON", "batoid", *_SEQUENTIAL)),
    "detector_half_mm": ("detector to choose", _SEQUENTIAL),
}


MOST_ALIKE = 3  # lines with the same keyword that are printed one by one


@dataclass(frozen=True)
class Imported:
    """
    Lens read from a file, with notes on what was read.

    Attributes
    ----------
    prescription : Prescription
        Optical system that was read.
    record : dict
        JSON values: notes, lines without effect, and for sequential lenses first-order data (mm, nm).
    """

    prescription: Prescription
    record: dict[str, Any]

    def coated(self, rules: Rules) -> Imported:
        """
        Return the imported lens with coatings, paint and scatter put on its surfaces by rules.

        Notes on the detector that these settle are dropped, and notes on the limits of presets added. Without rules it
        is returned as it is.
        """
        if not rules:
            return self
        from mistray.scene.coat import coated_prescription

        detector = self.prescription.detector
        made, found = coated_prescription(self.prescription, rules)
        said = set(detector.notes() if detector else ()) - set(made.detector.notes() if made.detector else ())
        notes = [note for note in self.record["notes"] if note not in said]
        notes += found.notes
        return Imported(made, self.record | {"notes": notes})

    def lines(self, name: str) -> list[str]:
        """Return the lines of text to print about the lens; `name` is the name of its file."""
        record, lines = self.record, []
        if "efl_mm" in record:
            pupil = (
                "telecentric in object space"
                if math.isinf(record["entrance_pupil_z_mm"])
                else f"F/{record['f_number']:.4g}, entrance pupil {record['epd_mm']:.6g} mm"
            )
            focus = (
                "afocal"
                if math.isinf(record["efl_mm"])
                else f"focal length {record['efl_mm']:.6g} mm, back focus {record['bfl_mm']:.6g} mm"
            )
            lines.append(f"at {record['wavelength_nm']:g} nm: {focus}, {pupil}")
        lines += [f"note: {note}" for note in record["notes"]]
        unread = record["unread"]
        if unread:
            lines.append(f"{len(unread)} {'line' if len(unread) == 1 else 'lines'} of {name} had no effect:")
            lines += _told(unread)
        return lines


def _told(unread: Sequence[Mapping[str, Any]]) -> list[str]:
    """
    Return lines of text on entries of a lens file that had no effect.

    More than three with one keyword and reason share a line.
    """
    from mistray.materials.mate import shown

    alike: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for item in unread:
        keyword, reason = item["text"].split(" ", 1)[0], item["reason"].split(", on ", 1)[0]
        alike.setdefault((keyword, reason), []).append(item)
    width = max(len(str(item["line"])) for item in unread)
    told = []
    for (keyword, reason), items in alike.items():
        if len(items) > MOST_ALIKE:
            told.append(f"  line {items[0]['line']:>{width}} and {len(items) - 1} more: {shown([keyword])}  ({reason})")
        else:
            told += [f"  line {one['line']:>{width}}: {shown([one['text']])}  ({one['reason']})" for one in items]
    return told


def kind_of(path: Path) -> str | None:
    """Return the kind of a lens file, such as "Zemax", by the suffix of its name; None for other files."""
    return FORMATS.get(path.suffix.lower())


def read_lens(request: LensRequest) -> Imported:
    """
    Return the lens read from the file of a request, of a type known to `kind_of`, with its light set.

    Raises
    ------
    MistrayError
        If the file is missing or cannot be read, or a batoid file comes without a wavelength.
    """
    lens = Path(request.lens)
    kind = FORMATS[lens.suffix.lower()]
    if kind != "batoid":  # it has files of its own
        require_file(lens, "lens")
    if kind in _SEQUENTIAL:
        built = _from_sequential(lens, kind, request)
        return Imported(_lit(built.prescription, request), _record(built))
    from mistray.prescription import from_batoid, from_json

    beam: Any = _given(request, "beam")
    if kind == "JSON":
        prescription = _lit(from_json(lens, variant=request.variant, **beam), request)
    elif request.wavelength_nm is None:
        raise MistrayError(f"lens '{lens}': batoid media depend on the wavelength; give --wavelength-nm")
    else:
        prescription = from_batoid(lens, wavelength_nm=request.wavelength_nm, **beam)
    return Imported(prescription, {"notes": prescription.provenance.splitlines()[1:], "unread": []})


def check_options(options: Mapping[str, Any], kind: str) -> None:
    """Raise `MistrayError` for options that have no meaning for a kind of file."""
    for name, (words, kinds) in ONLY.items():
        value = options[name]
        if value is not None and kind not in kinds:
            given = " ".join(map(str, value if isinstance(value, list) else [value]))
            raise MistrayError(f"{flag(name)} {given}: {kind} files hold no {words}; leave it out")


def _given(request: LensRequest, *names: str) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(request, name)) is not None}


def _from_sequential(lens: Path, kind: str, request: LensRequest) -> Built:
    from mistray.io.codev.read import read_codev
    from mistray.io.flaresim import read_flaresim
    from mistray.io.oslo import read_oslo
    from mistray.io.rayoptics import read_rayoptics
    from mistray.io.zemax.read import read_zemax
    from mistray.prescription.closing.system import build

    radii = None if request.radius_mode is None else request.radius_mode == "yes"
    shared: dict[str, Any] = {"glass_catalogues": request.glass_catalogue or (), "glasses": request.glass or None}
    chosen = request.configuration
    readers: Mapping[str, Callable[[], Sequential]] = {
        "OSLO": lambda: read_oslo(lens, configuration=_number(chosen), **shared),
        "Zemax": lambda: read_zemax(lens, coatings=request.coatings, configuration=chosen, **shared),
        "CODE V": lambda: read_codev(lens, radius_mode=radii, configuration=chosen, **shared),
        "FlareSim": lambda: read_flaresim(lens),
        "ray-optics": lambda: read_rayoptics(lens),
    }
    return build(readers[kind](), **_given(request, "edges", "margin", "beam", "detector_half_mm"))


def _number(configuration: str | None) -> int:
    if configuration is None:
        return 1
    if not configuration.isdecimal() or int(configuration) < 1:
        raise MistrayError(f"--configuration '{configuration}': OSLO files number theirs from 1 on; give a number")
    return int(configuration)


def _lit(prescription: Prescription, request: LensRequest) -> Prescription:
    """Return the lens with its source at the requested wavelength, nm, if the request has one."""
    wavelength = request.wavelength_nm
    return prescription if wavelength is None else prescription.with_source(wavelength_nm=(wavelength,), weights=None)


def _record(built: Built) -> dict[str, Any]:
    """
    Return first-order data, lengths in mm, and notes of a sequential lens as JSON-serialisable values.

    Infinite lengths are ``inf`` here, and become null in JSON.
    """
    lens, data = built.lens, built.first_order
    return {
        "efl_mm": data.efl,
        "bfl_mm": data.bfl,
        "f_number": data.f_number,
        "epd_mm": data.epd,
        "entrance_pupil_z_mm": data.entrance_pupil_z,
        "wavelength_nm": data.wavelength_nm,
        "wavelengths_nm": list(lens.wavelengths_nm),
        "field_kind": lens.field_kind,
        "fields_deg" if lens.field_kind == "angle_deg" else "fields_mm": [list(field) for field in lens.fields],
        "telecentric": lens.telecentric,
        "notes": list(built.notes),
        "unread": [{"line": item.line, "text": item.text.strip(), "reason": item.reason} for item in lens.unread],
    }

"""Lens files of other programs, as `mistray import` reads them, and as every command does that takes a scene."""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.options import Options
from mistray.errors import MistrayError
from mistray.read_file import require_file
from mistray.toolkit.field_options import flag

if TYPE_CHECKING:
    from mistray.prescription import Prescription, Sequential
    from mistray.prescription.closing.system import Built

FORMATS = {
    ".json": "json", ".yaml": "yaml", ".yml": "yaml", ".zmx": "zmx", ".seq": "seq", ".len": "len", ".lens": "lens",
    ".roa": "roa",
}  # fmt: skip
"""Kinds of lens files by the endings of their names."""
CALLED = {
    "json": "JSON", "yaml": "batoid", "zmx": "Zemax", "seq": "CODE V", "len": "OSLO", "lens": "FlareSim",
    "roa": "ray-optics",
}  # fmt: skip
_SEQUENTIAL = ("zmx", "seq", "len", "lens", "roa")
# Options that only some formats know: each with the words for it and the formats
ONLY = {
    "variant": ("variants", ("json",)),
    "wavelength_nm": ("wavelength of a source", ("json", "yaml", *_SEQUENTIAL)),
    "edges": ("edges to choose", _SEQUENTIAL),
    "coatings": ("coatings by name", ("zmx",)),
    "glass": ("glass names", ("zmx", "seq", "len")),
    "glass_catalogue": ("glass names", ("zmx", "seq", "len")),
    "radius_mode": ("radius mode", ("seq",)),
    "configuration": ("configurations", ("zmx", "seq", "len")),
    "margin": ("clear radii to choose", _SEQUENTIAL),
    "beam": ("beam of a source", ("json", "yaml", *_SEQUENTIAL)),
    "detector_half_mm": ("detector to choose", _SEQUENTIAL),
}


@dataclass(frozen=True)
class Imported:
    """
    A lens file that was read.

    Attributes
    ----------
    prescription : Prescription
    record : dict
        What JSON has of it: notes, lines without effect, of sequential lenses first-order data.
    """

    prescription: Prescription
    record: dict[str, Any]

    def coated(self, options: Options) -> Imported:
        """
        Return the lens with --coating, --paint and --scatter.

        Without the notes on a detector that these answer, with what presets reach.
        """
        rules = options.rules()
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
        """Return the lines of text that are printed of it."""
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
            from mistray.materials.mate import shown

            lines.append(f"{len(unread)} {'line' if len(unread) == 1 else 'lines'} of {name} had no effect:")
            width = max(len(str(item["line"])) for item in unread)
            lines += [f"  line {item['line']:>{width}}: {shown([item['text']])}  ({item['reason']})" for item in unread]
        return lines


def kind_of(path: Path) -> str | None:
    """The kind of a lens file by its name; None of other files."""
    return FORMATS.get(path.suffix.lower())


@contextlib.contextmanager
def lens_as_scene(options: Options) -> Iterator[None]:
    """
    The block in which the scene of a command, if it is named by a lens file, is a scene file made of that.

    The scene lives as long as the block, its notes go to stderr. `mistray import` has more options and writes a file.
    """
    lens = Path(options.has("scene") or "")
    if kind_of(lens) is None or not options.has("scene"):
        yield
        return
    wavelengths = options.has("wavelength_nm") or [None]
    asked = Options(**dict.fromkeys(ONLY), lens=str(lens))
    if kind_of(lens) == "yaml":  # whose media have no index without it
        asked.wavelength_nm = wavelengths[0]
    found = read_lens(asked)
    from mistray.prescription.scene_file import beside

    with tempfile.TemporaryDirectory(prefix="mistray-") as folder:
        scene = Path(folder) / f"{lens.stem}.xml"
        beside(found.prescription, scene.parent).to_xml(scene)
        if len(list(scene.parent.iterdir())) > 1:  # what a command writes would name files that go with the folder
            raise MistrayError(f"lens '{lens}': its sags are grids, in files of their own; run 'mistray import' first")
        options.lens_file, options.scene = str(lens), str(scene)  # the file too must not be overwritten
        if not options.has("quiet"):
            print(f"mistray: {lens} is imported as it stands; 'mistray import' has options for it", file=sys.stderr)
            for line in found.lines(lens.name):
                print(f"mistray: {line}", file=sys.stderr)
        yield


def read_lens(options: Options) -> Imported:
    """Read the file `options.lens`, with the options of `mistray import`."""
    lens = Path(options.lens)
    kind = FORMATS[lens.suffix.lower()]
    if kind != "yaml":  # batoid has files of its own
        require_file(lens, "lens")
    if kind in _SEQUENTIAL:
        built = _from_sequential(lens, kind, options)
        return Imported(built.prescription, _record(built))
    prescription = _from_json(lens, options) if kind == "json" else _from_batoid(lens, options)
    return Imported(prescription, {"notes": prescription.provenance.splitlines()[1:], "unread": []})


def check_options(options: Options, kind: str, called: str) -> None:
    """Refuse options that mean nothing for a kind of file."""
    for name, (words, kinds) in ONLY.items():
        value = getattr(options, name)
        if value is not None and kind not in kinds:
            given = " ".join(map(str, value if isinstance(value, list) else [value]))
            raise MistrayError(f"{flag(name)} {given}: {called} files hold no {words}; leave it out")


def _from_sequential(lens: Path, kind: str, options: Options) -> Built:
    from mistray.io.codev.read import read_codev
    from mistray.io.flaresim import read_flaresim
    from mistray.io.oslo import read_oslo
    from mistray.io.rayoptics import read_rayoptics
    from mistray.io.zemax.read import read_zemax
    from mistray.prescription.closing.system import build

    shared: dict[str, Any] = {
        "configuration": options.configuration,
        "glass_catalogues": options.glass_catalogue or (),
        "glasses": dict(options.glass or ()) or None,
    }
    readers: Mapping[str, Callable[[], Sequential]] = {
        "len": lambda: read_oslo(lens, **(shared | {"configuration": _number(options.configuration)})),
        "zmx": lambda: read_zemax(lens, coatings=options.coatings, **shared),
        "seq": lambda: read_codev(
            lens, radius_mode=None if options.radius_mode is None else options.radius_mode == "yes", **shared
        ),
        "lens": lambda: read_flaresim(lens),
        "roa": lambda: read_rayoptics(lens),
    }
    chosen = options.given("edges", "margin", "beam")
    half = options.detector_half_mm
    built = build(readers[kind](), detector_half_mm=None if half is None else (half[0], half[1]), **chosen)
    if options.wavelength_nm is None:
        return built
    return replace(built, prescription=_at(built.prescription, options.wavelength_nm))


def _number(configuration: str | None) -> int:
    if configuration is None:
        return 1
    if not configuration.isdigit() or int(configuration) < 1:
        raise MistrayError(f"--configuration '{configuration}': OSLO files number theirs from 1 on; give a number")
    return int(configuration)


def _at(prescription: Prescription, wavelength_nm: float) -> Prescription:
    return prescription.with_source(wavelength_nm=(wavelength_nm,), weights=None)


def _from_json(lens: Path, options: Options) -> Prescription:
    from mistray.prescription import from_json

    prescription = from_json(lens, variant=options.variant, **options.given("beam"))
    return prescription if options.wavelength_nm is None else _at(prescription, options.wavelength_nm)


def _from_batoid(lens: Path, options: Options) -> Prescription:
    if options.wavelength_nm is None:
        raise MistrayError(f"lens '{lens}': batoid media depend on the wavelength; give --wavelength-nm")
    from mistray.prescription import from_batoid

    return from_batoid(lens, wavelength_nm=options.wavelength_nm, **options.given("beam"))


def _record(built: Built) -> dict[str, Any]:
    """Return the record that is printed of a sequential lens; infinite numbers are null in JSON."""
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

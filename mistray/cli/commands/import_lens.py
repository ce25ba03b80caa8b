"""`mistray import`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli import import_mechanics
from mistray.cli.arguments import pairs
from mistray.cli.arriving import arriving
from mistray.cli.command import Command, Group, Option
from mistray.cli.options import Options, print_json
from mistray.cli.shared import FORCE, SURFACES, flag
from mistray.errors import MistrayError
from mistray.ranges import MARGIN, SIZE_MM, WAVELENGTH_NM
from mistray.read_file import require_file

if TYPE_CHECKING:
    from mistray.prescription import Prescription, Sequential
    from mistray.prescription.closing.system import Built

# Options that only some formats know: each with the words for it and the formats
_SEQUENTIAL = ("zmx", "seq", "len")
_ONLY = {
    "variant": ("variants", ("json",)),
    "wavelength_nm": ("wavelength of a source", ("json", "yaml", *_SEQUENTIAL)),
    "edges": ("edges to choose", _SEQUENTIAL),
    "coatings": ("coatings by name", ("zmx",)),
    "glass": ("glass names", _SEQUENTIAL),
    "glass_catalogue": ("glass names", _SEQUENTIAL),
    "radius_mode": ("radius mode", ("seq",)),
    "configuration": ("configurations", _SEQUENTIAL),
    "margin": ("clear radii to choose", _SEQUENTIAL),
    "beam": ("beam of a source", ("json", "yaml", *_SEQUENTIAL)),
    "detector_half_mm": ("detector to choose", _SEQUENTIAL),
}
_FORMATS = {".json": "json", ".yaml": "yaml", ".yml": "yaml", ".zmx": "zmx", ".seq": "seq", ".len": "len"}
_MECHANICS = "mechanics"
_CALLED = {"json": "JSON", "yaml": "batoid", "zmx": "Zemax", "seq": "CODE V", "len": "OSLO", _MECHANICS: "mechanical"}


# fmt: off
COMMAND = Command(
    "import",
    "turn a lens file or mechanics into a scene",
    "Read a lens or mechanics and write them as a scene (Mitsuba XML). Lines of the file that have no "
    "effect are listed. Where no light of the source reaches the detector the scene is written, the exit code is 2 "
    "and a line says what takes the light.",
    (
        "mistray import triplet.zmx -o triplet.xml --edges ground",
        "mistray import triplet.seq --radius-mode yes",
        "mistray import scenes/phone_camera/prescription.json -o scene.xml",
        "mistray import LSST_r.yaml -o lsst.xml --wavelength-nm 620",
        "mistray import tube.step --into triplet.xml -o both.xml --paint 'vane*=black'",
    ),
    (
        Option("lens", "lens as Zemax .zmx, CODE V .seq, OSLO .len, batoid .yaml or .json (like scenes/phone_camera), "
               "or mechanics as .step, .stl, .obj or .ply", metavar="FILE"),
        Option("-o --output", "file to write (default: FILE with .xml, in this folder)", Path, "XML", writes=()),
        Option("--json", "print JSON instead of text", bool),
        FORCE,
        Group("lenses", (
            Option("--wavelength-nm", "wavelength of the source, nm (batoid: required; others: as the file says)",
                   WAVELENGTH_NM, "NM"),
            Option("--beam", "the source overfills the entrance pupil by 5 %, so that the stop has derivatives "
                   "(pupil), just fills it (exact), or overfills the first surface (front; lens files only) (pupil)",
                   metavar="KIND"),
            Option("--variant", "design variant that a JSON file holds, such as R13=5.272", metavar="NAME"),
        )),
        Group("Zemax, CODE V and OSLO files (in brackets: the default)", (
            Option("--edges", "lens edges: blackened, ground, or open, which are polished and without a barrel "
                   "(blackened)", metavar="KIND"),
            Option("--coatings", "COATING.DAT that holds the coatings of a .zmx file", metavar="FILE"),
            Option("--glass", "material of a glass name, such as 'MYGLASS=nd=1.62 Vd=36.4 k=0'",
                   pairs("no glass; write NAME=MATERIAL, such as 'MYGLASS=N-BK7'"), "NAME=MATERIAL", "+"),
            Option("--glass-catalogue", "further glass catalogues", metavar="AGF", nargs="+"),
            Option("--radius-mode", "a .seq file gives radii (yes) or curvatures (no), where it does not say",
                   ("yes", "no")),
            Option("--configuration", "configuration or zoom position, by number or name (that the file was saved in, "
                   "or the first one)", metavar="NAME"),
            Option("--margin", "clear radii that the file does not give exceed the rays by this part (0.02)",
                   MARGIN, "PART"),
            Option("--detector-half-mm", "half width and height of the detector, mm (as the image of all fields)",
                   SIZE_MM, ("X", "Y"), 2),
        )),
        SURFACES,
        import_mechanics.GROUP,
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    lens = Path(options.lens)
    require_file(lens, "lens")
    suffix = lens.suffix.lower()
    kind = _MECHANICS if suffix in import_mechanics.SUFFIXES else _FORMATS.get(suffix)
    if kind is None:
        known = ", ".join([*_FORMATS, *import_mechanics.SUFFIXES])
        raise MistrayError(f"lens '{lens}': files of type '{lens.suffix}' cannot be read; give one of {known}")
    _check(options, kind)
    if kind == _MECHANICS:
        return import_mechanics.run(options)
    output = options.claim_output(Path(lens.with_suffix(".xml").name))
    if kind in _SEQUENTIAL:
        built = _from_sequential(lens, kind, options)
        prescription, record = built.prescription, _record(built)
    else:
        prescription = _from_json(lens, options) if kind == "json" else _from_batoid(lens, options)
        record = {"notes": prescription.provenance.splitlines()[1:], "unread": []}
    from mistray.prescription.scene_file import beside

    if rules := options.rules():
        from mistray.scene import coat

        prescription = coat(prescription, rules.coatings, paint=rules.paint, scatter=rules.scatter)
    beside(prescription, output.parent).to_xml(output)
    shapes = sum(1 for _ in prescription.shapes())
    angles = _angles(record, prescription)
    light = arriving(output)
    record = {"name": prescription.name, "surfaces": shapes, **record, **light.record()}
    if options.json:
        from mistray.files.json_values import plain

        print_json(plain(record), [output])
    else:
        print(_text(record, angles, lens, output))
        print(light.entrances)
    light.require()
    return 0


def _check(options: Options, kind: str) -> None:
    """Refuse options that mean nothing for a kind of file."""
    for name, (words, kinds) in _ONLY.items():
        value = getattr(options, name)
        if value is not None and kind not in kinds:
            shown = " ".join(map(str, value if isinstance(value, list) else [value]))
            raise MistrayError(f"{flag(name)} {shown}: {_CALLED[kind]} files hold no {words}; leave it out")
    if kind != _MECHANICS:
        options.refuse(import_mechanics.NAMES, f": {_CALLED[kind]} files hold no mechanics; leave it out")


def _from_sequential(lens: Path, kind: str, options: Options) -> Built:
    from mistray.io.codev.read import read_codev
    from mistray.io.oslo import read_oslo
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
    }
    chosen = options.given("edges", "margin", "beam")
    half = options.detector_half_mm
    built = build(readers[kind](), detector_half_mm=None if half is None else (half[0], half[1]), **chosen)
    if options.wavelength_nm is None:
        return built
    from dataclasses import replace

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
    """What is printed of a sequential lens; infinite numbers are null in JSON."""
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


def _text(record: Mapping[str, Any], angles: list[float], lens: Path, output: Path) -> str:
    command = ["mistray", "ghosts", str(output)]
    heights = _heights(record)
    if angles not in ([], [0.0]):
        command += ["--field-deg", *(f"{angle:g}" for angle in angles)]
    elif heights not in ([], [0.0]):
        command += ["--field-mm", *(f"{height:g}" for height in heights)]
    from mistray.materials.mate import shown

    lines = [f"{output}: {record['surfaces']} surfaces; next: {shlex.join(command)}"]
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
        lines.append(f"{len(unread)} {'line' if len(unread) == 1 else 'lines'} of {lens.name} had no effect:")
        width = max(len(str(item["line"])) for item in unread)
        lines += [f"  line {item['line']:>{width}}: {shown([item['text']])}  ({item['reason']})" for item in unread]
    return "\n".join(lines)


def _angles(record: Mapping[str, Any], prescription: Prescription) -> list[float]:
    """
    Field angles to trace, degrees.

    About one axis a field is its angle to that. Otherwise its sign counts, and fields off the yz plane are left out.
    """
    fields = record.get("fields_deg", ())
    if all(surface.coaxial for surface in prescription.surfaces):
        return sorted({_angle(*field) for field in fields})
    return sorted({round(y, 6) for x, y in fields if x == 0})


def _heights(record: Mapping[str, Any]) -> list[float]:
    """Heights of a near object to trace, mm; those beside the yz plane are left out."""
    if record.get("field_kind") != "object_height":
        return []
    return sorted({float(y) for x, y in record["fields_mm"] if x == 0})


def _angle(x_deg: float, y_deg: float) -> float:
    """Angle to the axis of a field whose slopes are tan x and tan y, degrees."""
    slope = math.hypot(math.tan(math.radians(x_deg)), math.tan(math.radians(y_deg)))
    return round(math.degrees(math.atan(slope)), 6)

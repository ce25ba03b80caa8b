"""Command `mistray import`, which turns a lens file or mechanics into a scene."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.read_file import require_file
from mistray.replace_file import opened
from mistray.toolkit.command import Command
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import FORCE, JSON, SURFACES, written

if TYPE_CHECKING:
    from mistray.analyses.import_lens.read import Imported
    from mistray.cli.parsed_options import Options
    from mistray.prescription import Prescription

# Formats of CAD that have a near relative among those that are read
_INSTEAD = {
    **dict.fromkeys((".igs", ".iges", ".sat", ".x_t", ".sldprt"), "export it as STEP,"),
    **dict.fromkeys((".3mf", ".dae", ".fbx"), "export it as STL, OBJ, PLY or GLB,"),
}

Found = tuple[Path, dict[str, Any], list[str], Sequence[Path]]  # scene, record for JSON, lines of text, meshes

COMMAND = Command(
    "import",
    "turn a lens file or mechanics into a scene",
    "Read a lens or mechanics and write them as a scene (Mitsuba XML). Lines of the file that have no effect are "
    "listed, and what the import assumed. Where no light of the source reaches the detector the scene is written, the "
    "exit code is 2 and a line says what takes the light.",
    (
        "mistray import triplet.zmx -o triplet.xml --edges ground",
        "mistray import triplet.seq --radius-mode yes",
        "mistray import scenes/phone_camera/prescription.json -o scene.xml",
        "mistray import LSST_r.yaml -o lsst.xml --wavelength-nm 620",
        "mistray import tube.step --into triplet.xml -o both.xml --paint 'vane*=black'",
    ),
    lambda request: (
        *options_of(request.LensRequest, "lens"),
        written("-o --output", "file to write (default: FILE with .xml, in this folder)", "XML"),
        JSON,
        FORCE,
        group("lenses", request.LensRequest, "wavelength_nm", "beam", "variant"),
        group(
            "files of surfaces in a row (in brackets: the default)",
            request.LensRequest,
            "edges",
            "coatings",
            "glass",
            "glass_catalogue",
            "radius_mode",
            "configuration",
            "margin",
            "detector_half_mm",
        ),
        SURFACES,
        group("mechanics (STEP, STL, OBJ, PLY, glTF)", request.MechanicsRequest),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray import` with parsed options and return the exit code."""
    from mistray.analyses.import_lens.arriving import arriving
    from mistray.analyses.import_lens.parts import SUFFIXES
    from mistray.files.json_values import plain

    source = Path(options.lens)
    mechanics = source.suffix.lower() in SUFFIXES
    output, record, lines, meshes = (_mechanics if mechanics else _lens)(options, source)
    light = None if mechanics and options.into is None else arriving(output)
    if light is not None:
        record |= light.record()
        lines.append(str(light.entrances))
    options.say(lambda: plain(record), lambda: "\n".join(lines), [output, *meshes])
    if light is not None:
        light.require()
    return 0


def _lens(options: Options, lens: Path) -> Found:
    """Import a lens file as a scene. Return scene file, record for JSON, lines of text, and no meshes."""
    from mistray.analyses.import_lens.parts import SUFFIXES
    from mistray.analyses.import_lens.read import FORMATS, check_options, kind_of, read_lens
    from mistray.analyses.import_lens.request import LensRequest, MechanicsRequest
    from mistray.prescription.scene_file import beside

    kind = kind_of(lens)
    if kind is None:
        require_file(lens, "lens")
        instead = _INSTEAD.get(lens.suffix.lower(), "give")
        known = ", ".join([*FORMATS, *SUFFIXES])
        raise MistrayError(f"lens '{lens}': files of type '{lens.suffix}' cannot be read; {instead} one of {known}")
    check_options(vars(options), kind)
    names = (option.dest for option in options_of(MechanicsRequest))
    options.refuse(names, f": {kind} files hold no mechanics; leave it out")
    output = options.claim_output(Path(lens.with_suffix(".xml").name))
    found = read_lens(request_of(LensRequest, vars(options))).coated(options.rules())
    beside(found.prescription, output.parent).to_xml(output)
    shapes = sum(1 for _ in found.prescription.shapes())
    record = {"name": found.prescription.name, "surfaces": shapes, **found.record}
    return output, record, [f"{output}: {shapes} surfaces; next: {_next(found, output)}", *found.lines(lens.name)], ()


def _mechanics(options: Options, source: Path) -> Found:
    """
    Import the parts of a mechanics file as a scene.

    Return the scene file, the record for JSON, lines of text, and the mesh files.
    """
    from mistray.analyses.import_lens.parts import parts_record, parts_text, read_parts
    from mistray.analyses.import_lens.read import check_options
    from mistray.analyses.import_lens.request import MechanicsRequest

    require_file(source, "mechanics")
    check_options(vars(options), "mechanical")
    output = options.output or Path(source.with_suffix(".xml").name)
    if opened(output) is not None or (output.exists() and not output.is_file()):
        raise MistrayError(
            f"output '{output}' is not a regular file, and meshes are written beside it; name a scene file"
        )
    options.claim_output(output)
    options.refuse(("coating", "scatter"), ": parts get their coating and scatter by --paint; leave it out")
    request = request_of(MechanicsRequest, vars(options))
    with options.working(f"reading {source.name}"):
        mechanics, shapes = read_parts(source, output, request, dict(options.paint or ()))
    record = parts_record(mechanics, shapes)
    meshes = [output.parent / file for shape in shapes if (file := getattr(shape, "file", None)) is not None]
    return output, record, [parts_text(record, output, traceable=request.into is not None)], meshes


def _next(found: Imported, output: Path) -> str:
    """Return the `mistray ghosts` command line that traces the fields of an imported lens."""
    command = ["mistray", "ghosts", str(output)]
    angles, heights = _angles(found.record, found.prescription), _heights(found.record)
    if angles not in ([], [0.0]):
        command += ["--field-deg", *(f"{angle:g}" for angle in angles)]
    elif heights not in ([], [0.0]):
        command += ["--field-mm", *(f"{height:g}" for height in heights)]
    return shlex.join(command)


def _angles(record: Mapping[str, Any], prescription: Prescription) -> list[float]:
    """
    Return the field angles to trace, degrees.

    In a rotationally symmetric system a field is its angle to the axis. Otherwise its sign counts, and fields off the
    yz plane are left out.
    """
    fields = record.get("fields_deg", ())
    if all(surface.coaxial for surface in prescription.surfaces):
        return sorted({_angle(*field) for field in fields})
    return sorted({round(y, 6) for x, y in fields if x == 0})


def _heights(record: Mapping[str, Any]) -> list[float]:
    """
    Return the object heights to trace, mm; empty for other kinds of fields.

    Heights off the yz plane are left out.
    """
    if record.get("field_kind") != "object_height":
        return []
    return sorted({float(y) for x, y in record["fields_mm"] if x == 0})


def _angle(x_deg: float, y_deg: float) -> float:
    """Return the angle to the axis, degrees, of a field with angles x and y, degrees, whose tangents are its slopes."""
    slope = math.hypot(math.tan(math.radians(x_deg)), math.tan(math.radians(y_deg)))
    return round(math.degrees(math.atan(slope)), 6)

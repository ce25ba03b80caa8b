"""`mistray import`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli import import_mechanics
from mistray.cli.arriving import arriving
from mistray.cli.lens_files import CALLED, FORMATS, Imported, check_options, kind_of, read_lens
from mistray.cli.options import Options, print_json
from mistray.errors import MistrayError
from mistray.ranges import MARGIN, SIZE_MM, WAVELENGTH_NM
from mistray.read_file import require_file
from mistray.toolkit.arguments import pairs
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import FORCE, SURFACES

if TYPE_CHECKING:
    from mistray.prescription import Prescription

# Formats of CAD that have a near relative among those that are read
_INSTEAD = {
    **dict.fromkeys((".igs", ".iges", ".sat", ".x_t", ".sldprt"), "export it as STEP,"),
    **dict.fromkeys((".3mf", ".dae", ".fbx"), "export it as STL, OBJ, PLY or GLB,"),
}

# fmt: off
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
    (
        Option("lens", "lens as .zmx, .seq, .len, .roa, .lens, batoid .yaml (also one of its own, by name) or .json "
               "(like scenes/phone_camera), or mechanics as .step, .stl, .obj, .ply or .glb", metavar="FILE"),
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
        Group("files of surfaces in a row (in brackets: the default)", (
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
            Option("--detector-half-mm", "half width and height of the detector, mm (as the file states, or the "
                   "image of all fields)", SIZE_MM, ("X", "Y"), 2),
        )),
        SURFACES,
        import_mechanics.GROUP,
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    lens = Path(options.lens)
    suffix = lens.suffix.lower()
    kind = kind_of(lens)
    if suffix in import_mechanics.SUFFIXES:
        require_file(lens, "mechanics")
        check_options(options, "", "mechanical")
        return import_mechanics.run(options)
    if kind is None:
        require_file(lens, "lens")
        known = ", ".join([*FORMATS, *import_mechanics.SUFFIXES])
        instead = _INSTEAD.get(suffix, "give")
        raise MistrayError(f"lens '{lens}': files of type '{lens.suffix}' cannot be read; {instead} one of {known}")
    check_options(options, kind, CALLED[kind])
    options.refuse(import_mechanics.NAMES, f": {CALLED[kind]} files hold no mechanics; leave it out")
    output = options.claim_output(Path(lens.with_suffix(".xml").name))
    found = read_lens(options).coated(options)
    from mistray.prescription.scene_file import beside

    beside(found.prescription, output.parent).to_xml(output)
    shapes = sum(1 for _ in found.prescription.shapes())
    light = arriving(output)
    if options.json:
        from mistray.files.json_values import plain

        record = {"name": found.prescription.name, "surfaces": shapes, **found.record, **light.record()}
        print_json(plain(record), [output])
    else:
        command = _next(found, output)
        print(
            "\n".join([f"{output}: {shapes} surfaces; next: {command}", *found.lines(lens.name), str(light.entrances)])
        )
    light.require()
    return 0


def _next(found: Imported, output: Path) -> str:
    """The command that traces the fields of a lens."""
    command = ["mistray", "ghosts", str(output)]
    angles, heights = _angles(found.record, found.prescription), _heights(found.record)
    if angles not in ([], [0.0]):
        command += ["--field-deg", *(f"{angle:g}" for angle in angles)]
    elif heights not in ([], [0.0]):
        command += ["--field-mm", *(f"{height:g}" for height in heights)]
    return shlex.join(command)


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

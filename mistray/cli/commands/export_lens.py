"""`mistray export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mistray.cli.command import Command, Option
from mistray.cli.options import Options, print_json
from mistray.cli.shared import FORCE
from mistray.errors import MistrayError
from mistray.ranges import FIELD_DEG, WAVELENGTH_NM

# fmt: off
COMMAND = Command(
    "export",
    "write the optical surfaces of a scene as a lens file, or its critical rays",
    "Write the optical surfaces of a scene, in the order of light, as a sequential lens for Zemax "
    "OpticStudio and programs that read its files. Structure, scatter and coatings without a name are left out, "
    "and the command says what was.\n"
    "Into a .csv file: the critical rays, centre and rim of the beam of each field, node by node, to check mounts\n"
    "and baffles with.",
    (
        "mistray export cooke_triplet -o triplet.zmx",
        "mistray export cooke_triplet -o critical.csv --field-deg 0 7 10",
        "mistray export camera.xml -o camera.zmx --json",
    ),
    (
        Option("scene", "scene XML file, or the name of a shipped scene such as cooke_triplet", metavar="SCENE"),
        Option("-o --output", "file to write, .zmx or .csv (default: SCENE with .zmx, in this folder)", Path, "FILE",
               writes=()),
        Option("--field-deg", "of critical rays: field angles, degrees (that of the scene)", FIELD_DEG, "DEG", "+"),
        Option("--wavelength-nm", "of critical rays: wavelengths, nm (those of the scene)", WAVELENGTH_NM, "NM", "+"),
        Option("--json", "print JSON instead of text", bool),
        FORCE,
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    from mistray.io.to_sequential import to_sequential
    from mistray.io.zemax.write import write_zemax
    from mistray.scene.read_optics import read_optics

    output = options.claim_output(Path(f"{Path(options.scene).stem}.zmx"))
    if output.suffix.lower() == ".csv":
        return _critical_rays(output, options)
    options.refuse(
        ["field_deg", "wavelength_nm"], " is about critical rays; name a .csv file as output, or leave it out"
    )
    if output.suffix.lower() != ".zmx":
        raise MistrayError(f"output '{output}': '{output.suffix}' cannot be written; end it in .zmx or .csv")
    prescription, left_out = read_optics(options.scene)
    lens = to_sequential(prescription)
    if left_out:
        lens = replace(lens, notes=(*lens.notes, f"structure is left out ({len(left_out)} shapes)"))
    lost = write_zemax(lens, output)
    surfaces = sum(row.kind == "surface" for row in lens.rows)
    if options.json:
        shown = {
            "surfaces": surfaces,
            "entrance_pupil_diameter_mm": lens.aperture,
            "wavelengths_nm": list(lens.wavelengths_nm),
            "notes": list(lens.notes),
            "approximate": list(lost),
            "left_out": list(left_out),
        }
        print_json(shown, [output])
        return 0
    print(f"{output}: {surfaces} surfaces, entrance pupil {lens.aperture:.6g} mm")
    for note in (*lens.notes, *lost):
        print(f"  {note}")
    return 0


def _critical_rays(output: Path, options: Options) -> int:
    """Write the critical rays."""
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.analysis.critical_rays import critical_rays
    from mistray.replace_file import replace_file
    from mistray.scene import load

    table = critical_rays(load(options.scene), options.field_deg, options.wavelength_nm)
    replace_file(output, table.to_csv(index=False, lineterminator="\n"), "ray file")
    count = int(table.ray.max()) + 1
    if options.json:
        fields, lines = (table[name].unique().tolist() for name in ("field_deg", "wavelength_nm"))
        print_json({"rays": count, "fields_deg": fields, "wavelengths_nm": lines}, [output])
    else:
        print(f"{output}: {count} critical rays")
    return 0

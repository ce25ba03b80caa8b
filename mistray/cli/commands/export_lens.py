"""`mistray export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mistray.cli.options import Options, print_json
from mistray.errors import MistrayError
from mistray.ranges import FIELD_DEG, RAYS, RAYS_DRAWN, ROWS, SIZE_MM, WAVELENGTH_NM
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import FORCE

STEP = (".step", ".stp")
OF_STEP = ("paths", "rays", "rays_per_path", "mirror_thickness_mm", "freeform_tolerance_mm")

# fmt: off
COMMAND = Command(
    "export",
    "write a scene as a lens file, for CAD programs, or its critical rays",
    "Write the optical surfaces of a scene, in the order of light, as a sequential lens for Zemax "
    "OpticStudio and programs that read its files. Structure, scatter and coatings without a name are left out, "
    "and the command says what was.\n"
    "Into a .step file: lenses, mirrors and mechanics as exact solids and sheets for CAD programs, the clear beams\n"
    "of fields as solids, and stray paths as polylines.\n"
    "Into a .csv file: the critical rays, centre and rim of the beam of each field, node by node, to check mounts\n"
    "and baffles with.",
    (
        "mistray export cooke_triplet -o triplet.zmx",
        "mistray export cooke_triplet -o critical.csv --field-deg 0 7 10",
        "mistray export cooke_triplet -o triplet.step --field-deg 0 10 --paths 3",
        "mistray export camera.xml -o camera.zmx --json",
    ),
    (
        Option("scene", "scene XML file, lens file, or the name of a shipped scene such as cooke_triplet",
               metavar="SCENE"),
        Option("-o --output", "file to write, .zmx, .step or .csv (default: SCENE with .zmx, in this folder)", Path,
               "FILE", writes=()),
        Group("critical rays (.csv) and beams (.step)", (
            Option("--field-deg", "field angles, degrees (.csv: that of the scene; .step: no beams)", FIELD_DEG, "DEG",
                   "+"),
            Option("--wavelength-nm", "wavelengths, nm, of a .step file one (those of the scene)", WAVELENGTH_NM, "NM",
                   "+"),
        )),
        Group("only .step", (
            Option("--paths", "strongest stray paths of each field, as polylines (0)", ROWS, "N"),
            Option("--rays", "start rays of the trace that finds them (20 000)", RAYS, "N"),
            Option("--rays-per-path", "most rays of each path (10)", RAYS_DRAWN, "N"),
            Option("--mirror-thickness-mm", "makes round mirrors without a body solids with a flat back, nowhere "
                   "thinner than this, mm (sheets)", SIZE_MM, "MM"),
            Option("--freeform-tolerance-mm", "largest distance of a B-spline from a freeform, mm (1e-5)", SIZE_MM,
                   "MM"),
        )),
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
    ending = output.suffix.lower()
    if ending in STEP:
        return _step(output, options)
    options.refuse(OF_STEP, " is about STEP files; name a .step file as output, or leave it out")
    if ending == ".csv":
        return _critical_rays(output, options)
    options.refuse(
        ["field_deg", "wavelength_nm"], " is about light; name a .csv or .step file as output, or leave it out"
    )
    if ending != ".zmx":
        raise MistrayError(f"output '{output}': '{output.suffix}' cannot be written; end it in .zmx, .step or .csv")
    prescription, left_out = read_optics(options.scene)
    lens = to_sequential(prescription)
    if left_out:
        lens = replace(lens, notes=(*lens.notes, f"structure is left out ({len(left_out)} shapes)"))
    lost = write_zemax(lens, output)
    surfaces = sum(row.kind == "surface" for row in lens.rows)
    if options.json:
        shown = {
            "surfaces": surfaces,
            ("object_na" if lens.aperture_kind == "object_na" else "entrance_pupil_diameter_mm"): lens.aperture,
            "wavelengths_nm": list(lens.wavelengths_nm),
            "notes": list(lens.notes),
            "approximate": list(lost),
            "left_out": list(left_out),
        }
        print_json(shown, [output])
        return 0
    near = lens.aperture_kind == "object_na"
    beam = f"object NA {lens.aperture:.6g}" if near else f"entrance pupil {lens.aperture:.6g} mm"
    print(f"{output}: {surfaces} surfaces, {beam}")
    for note in (*lens.notes, *lost):
        print(f"  {note}")
    return 0


def _critical_rays(output: Path, options: Options) -> int:
    """Write the critical rays."""
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.analyses.export.critical_rays import critical_rays
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


def _step(output: Path, options: Options) -> int:
    """Write a STEP file."""
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.analyses.export.run import export_step
    from mistray.scene import load

    if options.wavelength_nm is not None and len(options.wavelength_nm) > 1:
        raise MistrayError(f"--wavelength-nm has {len(options.wavelength_nm)} values; a STEP file takes one")
    if not options.paths:
        options.refuse(["rays", "rays_per_path"], " has no effect without --paths; leave it out")
        if options.field_deg is None:
            options.refuse(["wavelength_nm"], " has no effect without --field-deg or --paths; leave it out")
    given = options.given(*OF_STEP, "wavelength_nm")
    if "wavelength_nm" in given:
        given["wavelength_nm"] = given["wavelength_nm"][0]
    written = export_step(load(options.scene), output, options.field_deg, name=Path(options.scene).stem, **given)
    if options.json:
        shown = {name: getattr(written, name) for name in ("solids", "sheets", "beams", "paths", "error_mm",
                                                           "rim_error_mm", "left_out", "notes")}  # fmt: skip
        print_json(shown, [output])
        return 0
    kinds = ((written.solids, "solids"), (written.sheets, "sheets"), (written.beams, "beams"), (written.paths, "paths"))
    print(f"{output}: {', '.join(f'{len(names)} {kind}' for names, kind in kinds if names)}")
    if written.error_mm:
        print(f"  B-splines are within {written.error_mm:.1g} mm of their surfaces")
    if written.beams:
        print(f"  rims of beams are within {written.rim_error_mm:.1g} mm of the light")
    for name, reason in written.left_out.items():
        print(f"  left out: {name}, {reason}")
    for note in written.notes:
        print(f"  {note}")
    return 0

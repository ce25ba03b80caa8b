"""Command `mistray export`, which writes a scene as a lens file, a STEP file or critical rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.toolkit.command import Command
from mistray.toolkit.field_options import group, request_of
from mistray.toolkit.shared_options import FORCE, JSON, SCENE, written

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

OF_STEP = ("paths", "rays", "rays_per_path", "mirror_thickness_mm", "freeform_tolerance_mm")
Found = tuple[dict[str, Any], Sequence[str]]  # record for JSON, and lines

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
    lambda request: (
        SCENE,
        written("-o --output", "file to write, .zmx, .step or .csv (default: SCENE with .zmx, in this folder)"),
        group(
            "critical rays (.csv), and beams (.step: of the fields that are given, at one wavelength)",
            request.CriticalRaysRequest,
            "field_deg",
            "wavelength_nm",
        ),
        group("only .step", request.StepRequest, *OF_STEP),
        JSON,
        FORCE,
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray export` with parsed options and return the exit code."""
    output = options.claim_output(Path(f"{Path(options.scene).stem}.zmx"))
    ending = output.suffix.lower()
    if ending in (".step", ".stp"):
        record, (first, *lines) = _step(output, options)
    else:
        options.refuse(OF_STEP, " is about STEP files; name a .step file as output, or leave it out")
        record, (first, *lines) = (_critical_rays if ending == ".csv" else _lens)(output, options)
    return options.say(lambda: record, lambda: "\n  ".join([f"{output}: {first}", *lines]), [output])


def _lens(output: Path, options: Options) -> Found:
    """Write a sequential lens for OpticStudio; return the record for JSON and the lines to print."""
    from mistray.io.to_sequential import to_sequential
    from mistray.io.zemax.write import write_zemax
    from mistray.scene.read_optics import read_optics

    wrong = " is about light; name a .csv or .step file as output, or leave it out"
    options.refuse(["field_deg", "wavelength_nm"], wrong)
    if output.suffix.lower() != ".zmx":
        raise MistrayError(f"output '{output}': '{output.suffix}' cannot be written; end it in .zmx, .step or .csv")
    prescription, left_out = read_optics(options.scene)
    lens = to_sequential(prescription)
    notes = [*lens.notes, *prescription.provenance.splitlines()]
    if left_out:
        notes.append(f"structure is left out ({len(left_out)} shapes)")
    lost = write_zemax(lens, output)
    surfaces, near = sum(row.kind == "surface" for row in lens.rows), lens.aperture_kind == "object_na"
    record = {
        "surfaces": surfaces,
        "object_na" if near else "entrance_pupil_diameter_mm": lens.aperture,
        "wavelengths_nm": list(lens.wavelengths_nm),
        "notes": notes,
        "approximate": list(lost),
        "left_out": list(left_out),
    }
    beam = f"object NA {lens.aperture:.6g}" if near else f"entrance pupil {lens.aperture:.6g} mm"
    return record, (f"{surfaces} surfaces, {beam}", *notes, *lost)


def _critical_rays(output: Path, options: Options) -> Found:
    """Write the critical rays as a CSV file; return the record for JSON and the lines to print."""
    from mistray.analyses.export.request import CriticalRaysRequest

    request = request_of(CriticalRaysRequest, vars(options))
    options.prepare_mitsuba()
    from mistray.analyses.export.critical_rays import run
    from mistray.replace_file import replace_file

    table = run(options.load(), request)
    replace_file(output, table.to_csv(index=False, lineterminator="\n"), "ray file")
    count = int(table.ray.max()) + 1
    angles, wavelengths = (table[name].unique().tolist() for name in ("field_deg", "wavelength_nm"))
    return {"rays": count, "fields_deg": angles, "wavelengths_nm": wavelengths}, (f"{count} critical rays",)


def _step(output: Path, options: Options) -> Found:
    """Write a STEP file; return the record for JSON and the lines to print."""
    from mistray.analyses.export.request import StepRequest

    given = vars(options)
    if options.wavelength_nm is not None:
        if len(options.wavelength_nm) > 1:
            raise MistrayError(f"--wavelength-nm has {len(options.wavelength_nm)} values; a STEP file takes one")
        given = given | {"wavelength_nm": options.wavelength_nm[0]}
    if not options.paths:
        options.refuse(["rays", "rays_per_path"], " has no effect without --paths; leave it out")
        if options.field_deg is None:
            options.refuse(["wavelength_nm"], " has no effect without --field-deg or --paths; leave it out")
    request = request_of(StepRequest, given)
    options.prepare_mitsuba()
    from mistray.analyses.export.run import run

    found = run(options.load(), request, path=output, name=Path(options.scene).stem)
    kinds = {kind: getattr(found, kind) for kind in ("solids", "sheets", "beams", "paths")}
    lines = [", ".join(f"{len(names)} {kind}" for kind, names in kinds.items() if names)]
    if found.error_mm:
        lines.append(f"B-splines are within {found.error_mm:.1g} mm of their surfaces")
    if found.beams:
        lines.append(f"rims of beams are within {found.rim_error_mm:.1g} mm of the light")
    lines += [f"left out: {name}, {reason}" for name, reason in found.left_out.items()]
    return {one.name: getattr(found, one.name) for one in fields(found)[1:]}, (*lines, *found.notes)

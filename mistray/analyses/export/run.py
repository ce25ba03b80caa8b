"""Export of a scene and its beams and stray paths as a STEP file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from mistray.analyses.export.beams import BeamFinder, FieldBeam
from mistray.analyses.export.bodies import DETECTORS, MECHANICS, OPTICS, bodies_of
from mistray.analyses.export.request import StepRequest
from mistray.errors import MistrayError
from mistray.io.cad.part import unique_names
from mistray.io.cad.write_step import Colour, StepFile
from mistray.recorders.path_events import DIRECT
from mistray.result import KeyNumber, Result
from mistray.toolkit.analysis import analysis
from mistray.toolkit.drawings.path_polylines import one_of_each, rays_of_paths
from mistray.trace import trace

COLOURS: dict[str, Colour] = {
    "glass": (0.55, 0.75, 0.92),
    "mirror": (0.80, 0.80, 0.84),
    "structure": (0.45, 0.45, 0.45),
    "detector": (0.15, 0.15, 0.15),
}
BEAM_COLOUR, PATH_COLOUR = (1.0, 0.85, 0.35), (0.85, 0.15, 0.10)
BEAMS, PATHS = "beams", "stray_paths"
BREP, SHEETS, WIRES = "ADVANCED_BREP", "MANIFOLD_SURFACE", "GEOMETRICALLY_BOUNDED_WIREFRAME"


@dataclass(frozen=True, repr=False)
class StepExport(Result):
    """
    Result of `export_step`: the written file and its contents.

    Attributes
    ----------
    path : Path
        File written.
    solids, sheets, beams, paths : tuple of str
        Names of the products: bodies with a volume, faces that enclose none, clear beams, stray paths.
    error_mm : float
        Largest distance of a B-spline from the surface that it represents, mm; 0 if all are exact.
    rim_error_mm : float
        Largest distance of the rim of a beam from rays between those that it goes through, mm.
    left_out : dict
        Reason for each shape that is not in the file, by its id.
    notes : tuple of str
        Remarks on the bodies.

    Examples
    --------
    >>> found = mistray.export_step(mistray.load("lens_and_window"), "lens.step")
    >>> found.solids, found.error_mm
    (('L1', 'window'), 0.0)
    """

    path: Path
    solids: tuple[str, ...]
    sheets: tuple[str, ...]
    beams: tuple[str, ...]
    paths: tuple[str, ...]
    error_mm: float
    rim_error_mm: float
    left_out: dict[str, str]
    notes: tuple[str, ...]

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the file name, numbers of products by kind, and the largest error of surfaces (mm), by label."""
        counts = {name: len(getattr(self, name)) for name in ("solids", "sheets", "beams", "paths")}
        return {"file": self.path.name, **counts, "error [mm]": self.error_mm}


def run(scene: mi.Scene, request: StepRequest, *, path: str | Path, name: str = "system") -> StepExport:
    """
    Write a scene as a STEP file (AP214, mm): lenses, mirrors, mechanics, clear beams and stray paths by their names.

    Closed volumes are written as solids: lenses with their edges, walls of a closed cross-section, boxes and prisms of
    flat faces. Everything else is written as sheets, each face with the id of its shape. Planes, cylinders, cones,
    spheres and conics are exact. Even aspheres are B-splines turned about the axis, within 1e-6 mm of the sag, or 1e-7
    of their size if that is less. Freeforms are B-splines within `freeform_tolerance_mm`.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : StepRequest
    path : str or Path
        File to write; one that exists is replaced.
    name : str
        Name of the assembly.

    Returns
    -------
    StepExport

    Raises
    ------
    MistrayError
        If a value is out of range, a field has no light on the detector, no surface can be written in STEP, or the file
        cannot be written. Also if mirrors shall have a thickness and no light of the source reaches the detector.

    Examples
    --------
    >>> found = mistray.export_step(mistray.load("lens_and_window"), "lens.step", 0, paths=2, rays=2000)
    >>> found.path.name, found.solids
    ('lens.step', ('L1', 'window'))
    >>> found.beams, found.paths
    (('beam 0 deg',), ('0 deg: detector → window_rear, 0.959 W', '0 deg: detector → window_front, 0.826 W'))
    """
    fields, thickness_mm = list(dict.fromkeys(request.field_deg or ())), request.mirror_thickness_mm
    finder = BeamFinder(scene, request.wavelength_nm) if fields or thickness_mm is not None else None
    beams = [finder.beam(field) for field in fields] if finder else []
    found = bodies_of(scene, finder.lit if finder else {}, thickness_mm, request.freeform_tolerance_mm)
    file = StepFile(name)
    groups: dict[str, list[tuple[str, tuple[int, int]]]] = {}
    solids: list[str] = []
    sheets: list[str] = []
    errors = [0.0]
    names = unique_names(body.name for body in found.bodies)
    for own, body in zip(names, found.bodies, strict=True):
        try:
            faces = body.faces(file)
        except MistrayError as error:
            for patch in body.patches:
                found.left_out[patch.name] = str(error)
            continue
        item = file.solid(own, faces) if body.solid else file.sheets(own, faces)
        file.paint(item, COLOURS[body.role])
        groups.setdefault(body.group, []).append((own, file.part(own, BREP if body.solid else SHEETS, [item])))
        (solids if body.solid else sheets).append(own)
        errors.append(body.error_mm)
    for beam in beams:
        groups.setdefault(BEAMS, []).append((beam.name, _beam(file, beam)))
    written = _paths(file, scene, fields, request) if request.paths else []
    if written:
        groups[PATHS] = written
    if not groups:
        raise MistrayError("the scene has no surfaces that a STEP file can hold; see left_out")
    order = [group for group in (OPTICS, MECHANICS, DETECTORS, BEAMS, PATHS) if group in groups]
    file.assembly(name, [(group, file.assembly(group, groups[group])) for group in order])
    return StepExport(
        file.write(path),
        tuple(solids),
        tuple(sheets),
        tuple(beam.name for beam in beams),
        tuple(own for own, _ in written),
        max(errors),
        max((beam.rim_error_mm for beam in beams), default=0.0),
        found.left_out,
        tuple(found.notes),
    )


def _beam(file: StepFile, beam: FieldBeam) -> tuple[int, int]:
    """Add a clear beam to a file as a product, and return the entity numbers of the product."""
    solids, sides = beam.write(file)
    items = solids + ([file.sheets(beam.name, sides)] if sides else [])
    for item in items:
        file.paint(item, BEAM_COLOUR)
    kind = BREP if not sides else SHEETS if not solids else ""
    return file.part(beam.name, kind, items)


export_step = analysis("export_step", StepRequest, run, ("path", "field_deg"))


def _paths(
    file: StepFile, scene: mi.Scene, fields: Sequence[float], request: StepRequest
) -> list[tuple[str, tuple[int, int]]]:
    """Add the strongest stray paths to a file as products; return their names and entity numbers."""
    written = []
    asked: Sequence[float | None] = fields or [None]
    for field in asked:
        t = trace(scene, rays=request.rays, field_deg=field, wavelength_nm=request.wavelength_nm)
        angle = float(t.settings["field_deg"])
        stray = one_of_each((row for row in t.paths if row.kind != DIRECT), request.paths)
        for row in stray:
            lines = rays_of_paths(t, [row.path_id], request.rays_per_path)
            if not lines:
                continue
            curves = [file.polyline(line.points, f"ray {number}") for number, line in enumerate(lines, start=1)]
            item = file.curves(row.label, curves)
            file.paint(item, PATH_COLOUR, line=True)
            own = f"{angle:g} deg: {row.label}, {row.power_W:.3g} W"
            written.append((own, file.part(own, WIRES, [item])))
    return written

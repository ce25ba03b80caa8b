"""`mistray import` of mechanics: STEP, STL, OBJ, PLY, glTF."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arriving import arriving
from mistray.cli.options import Options, print_json
from mistray.cli.progress import working
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, PLACE_MM, ROWS, SECONDS, SPACE, TOLERANCE_MM
from mistray.replace_file import opened
from mistray.toolkit.arguments import pairs
from mistray.toolkit.command import Group, Option

if TYPE_CHECKING:
    from mistray.mechanics import Finish, Mechanics
    from mistray.prescription import MeshStructure, Structure

SUFFIXES = (".step", ".stp", ".stl", ".obj", ".ply", ".glb", ".gltf")
# fmt: off
GROUP = Group("mechanics (STEP, STL, OBJ, PLY, glTF)", (
    Option("--into", "scene that the parts are added to (default: a file for <include>)", metavar="SCENE"),
    Option("--space", "optical space of parts or faces",
           pairs("no optical space; write PATTERN=N, such as 'vane*=2'", SPACE), "PATTERN=N", "+"),
    Option("--unit", "of STL, OBJ, PLY (mm) and glTF (m): um, mm, cm, m, inch or ft", metavar="UNIT"),
    Option("--move-mm", "where the origin of the parts goes after the tilt, mm (0 0 0)", PLACE_MM, ("X", "Y", "Z"), 3),
    Option("--tilt-deg", "turns about x, then y, then z of the scene, degrees (0 0 0)",
           AZIMUTH_DEG, ("X", "Y", "Z"), 3),
    Option("--most-analytic", "surfaces made exact at most, the largest; 0: all are meshes (64)", ROWS, "N"),
    Option("--tolerance-mm", "largest distance of the facets of a STEP file from its surfaces, mm (0.01)",
           TOLERANCE_MM, "MM"),
    Option("--time-limit-s", "for reading a STEP file, processor time, seconds (5, and 30 for each MB)", SECONDS, "S"),
))
# fmt: on
NAMES = tuple(option.dest for option in GROUP.options)  # of the options that only mechanics have


def run(options: Options) -> int:
    """Import the parts of `options.lens` into `options.output`."""
    from mistray.mechanics import read_mechanics
    from mistray.mechanics.mechanics import MOST_ANALYTIC
    from mistray.prescription.mesh_structure import MeshStructure
    from mistray.prescription.model import Placed

    source = Path(options.lens)
    output = options.output or Path(source.with_suffix(".xml").name)
    if opened(output) is not None or (output.exists() and not output.is_file()):
        raise MistrayError(f"output '{output}' is no regular file, and meshes are written beside it; name a scene file")
    options.claim_output(output)
    options.refuse(("coating", "scatter"), ": parts get their coating and scatter by --paint; leave it out")
    known = _known(options.into) if options.into else {}
    x, y, z = options.move_mm or (0.0, 0.0, 0.0)
    most = MOST_ANALYTIC if options.most_analytic is None else options.most_analytic
    at = Placed(x=x, y=y, z=z, tilt_deg=tuple(options.tilt_deg or (0.0, 0.0, 0.0)))
    with working(f"reading {source.name}"):
        mechanics = read_mechanics(
            source,
            unit=options.unit,
            at=at,
            most_analytic=most,
            tolerance_mm=options.tolerance_mm,
            time_limit_s=options.time_limit_s,
        )
    mechanics = mechanics.painted(dict(options.paint or ()), space=dict(options.space or ()), known=known)
    if options.into:
        from mistray.scene import add_structures

        shapes, meshes = mechanics.beside(output)
        add_structures(options.into, shapes, output, f"Mechanics of {source.name}", meshes)
    else:
        shapes = mechanics.to_xml(output)
    record = _record(mechanics, shapes)
    light = arriving(output) if options.into else None
    if light is not None:
        record |= light.record()
    if options.json:
        files = [output.parent / shape.file for shape in shapes if isinstance(shape, MeshStructure)]
        print_json(record, [output, *files])
    else:
        print(_text(record, output, traceable=light is not None))
        if light is not None:
            print(light.entrances)
    if light is not None:
        light.require()
    return 0


def _known(scene: str) -> dict[str, Finish]:
    """Coatings and scatter models of a scene, as paints."""
    from mistray.mechanics.finish import known_finishes
    from mistray.scene import find
    from mistray.scene.add_structures import shared_objects
    from mistray.scene.xml_file import SceneFile

    return known_finishes(shared_objects(SceneFile(find(scene))).values())


def _record(mechanics: Mechanics, shapes: Sequence[Structure | MeshStructure]) -> dict[str, Any]:
    counts: dict[str | None, Counter[str]] = {part.name: Counter() for part in mechanics.parts}
    for shape in shapes:
        counts[shape.part]["meshes" if hasattr(shape, "file") else "analytic"] += 1
    beyond = mechanics.beyond_limit
    notes = [f"{beyond} more surfaces could be exact; they stay meshes by --most-analytic {mechanics.most_analytic}"]
    return {
        "parts": [
            {
                "name": part.name,
                "title": part.title,
                "product": part.product,
                "path": part.path,
                "analytic_surfaces": counts[part.name]["analytic"],
                "meshes": counts[part.name]["meshes"],
                "triangles": len(part.triangles),
                "painted": any(shape.scatter or shape.coating is None or shape.coating.R != 0
                               for shape in shapes if shape.part == part.name),
            }
            for part in mechanics.parts
        ],
        "notes": notes if beyond else [],
        "unread": [asdict(item) for item in mechanics.unread],
    }  # fmt: skip


def _text(record: Mapping[str, Any], output: Path, traceable: bool) -> str:
    lines = [
        f"{part['name']}: {part['analytic_surfaces']} analytic surfaces, {part['meshes']} meshes"
        + ("" if part["painted"] else ", black")
        for part in record["parts"]
    ]
    lines += [f"note: {note}" for note in record["notes"]]
    lines += [f"not read: {item['text']}: {item['reason']}" for item in record["unread"]]
    then = (
        shlex.join(["mistray", "ghosts", str(output)])
        if traceable
        else f'<include filename="{output}"/> in a scene, or --into SCENE'
    )
    lines.append(f"{output}: {len(record['parts'])} parts; next: {then}")
    return "\n".join(lines)

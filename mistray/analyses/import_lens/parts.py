"""Import of mechanics as scenes from STEP, STL, OBJ, PLY and glTF files."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.analyses.import_lens.request import MechanicsRequest

if TYPE_CHECKING:
    from mistray.mechanics import Finish, Mechanics
    from mistray.prescription import MeshStructure, Structure

SUFFIXES = (".step", ".stp", ".stl", ".obj", ".ply", ".glb", ".gltf")


def read_parts(
    source: Path, output: Path, request: MechanicsRequest, paint: Mapping[str, str]
) -> tuple[Mechanics, Sequence[Structure | MeshStructure]]:
    """
    Read the parts of a mechanics file and write them as a scene.

    Parameters
    ----------
    source, output : Path
        File of mechanics, and scene file; meshes are written beside the scene file.
    request : MechanicsRequest
    paint : mapping of str to str
        Name of a paint by pattern of part names.

    Returns
    -------
    Mechanics
        Parts that were read.
    sequence of Structure or MeshStructure
        Shapes that were written.
    """
    from mistray.mechanics import read_mechanics
    from mistray.prescription.model import Placed

    x, y, z = request.move_mm
    mechanics = read_mechanics(
        source,
        unit=request.unit,
        at=Placed(x=x, y=y, z=z, tilt_deg=request.tilt_deg),
        most_analytic=request.most_analytic,
        tolerance_mm=request.tolerance_mm,
        time_limit_s=request.time_limit_s,
    )
    known = _known(request.into) if request.into else {}
    mechanics = mechanics.painted(paint, space=request.space or {}, known=known)
    if not request.into:
        return mechanics, mechanics.to_xml(output)
    from mistray.scene import add_structures

    shapes, meshes = mechanics.beside(output)
    add_structures(request.into, shapes, output, f"Mechanics of {source.name}", meshes)
    return mechanics, shapes


def _known(scene: str) -> dict[str, Finish]:
    """Return coatings and scatter models of a scene by name, to be used as paints."""
    from mistray.mechanics.finish import known_finishes
    from mistray.scene import find
    from mistray.scene.add_structures import shared_objects
    from mistray.scene.xml_file import SceneFile

    return known_finishes(shared_objects(SceneFile(find(scene))).values())


def parts_record(mechanics: Mechanics, shapes: Sequence[Structure | MeshStructure]) -> dict[str, Any]:
    """Return the imported parts, notes and unread entries as JSON-serialisable values."""
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
                "painted": any(map(_is_painted, (shape for shape in shapes if shape.part == part.name))),
            }
            for part in mechanics.parts
        ],
        "notes": notes if beyond else [],
        "unread": [asdict(item) for item in mechanics.unread],
    }


def _is_painted(shape: Structure | MeshStructure) -> bool:
    return bool(shape.scatter) or shape.coating is None or shape.coating.R != 0


def parts_text(record: Mapping[str, Any], output: Path, traceable: bool) -> str:
    """
    Return a record of imported parts as text.

    Its last line has the `mistray ghosts` command if the scene is `traceable`, else how to include the parts in a
    scene.
    """
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

"""Adding structures (baffles, barrels, stops) to a scene file while everything else in it stays as it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from mistray.errors import MistrayError
from mistray.prescription.coating import Coating
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.model import STRUCTURES, Structure, Surface
from mistray.prescription.scatter import Scatter, Value
from mistray.prescription.scene_file import comment_text, structure_text
from mistray.ranges import OfType, shown
from mistray.replace_file import replace_files
from mistray.scatter.kinds import KINDS
from mistray.scene.files import with_includes
from mistray.scene.load import find
from mistray.scene.xml_file import Element, SceneFile, is_true

Shared = Coating | Scatter
AnyStructure = Structure | Surface | MeshStructure
COATING_KEYS = {"R", "T", "table", "layers", "preset", "first", "design_nm"}


def add_structures(
    source: str | Path,
    structures: AnyStructure | Iterable[AnyStructure],
    target: str | Path,
    note: str = "",
    files: Mapping[Path, bytes] = MappingProxyType({}),
) -> Path:
    """
    Write a scene with further structures, atomically: on an error an old file stays.

    Parameters
    ----------
    source : str or Path
        Scene XML file, or the name of a shipped scene.
    structures : Structure, Surface, MeshStructure or iterable of them
        Structures to add. A coating or scatter model named like one in the scene refers to that one.
    target : str or Path
        File to write; may be `source` itself.
    note : str
        Comment written before the structures.
    files : mapping of Path to bytes
        Contents of files that structures refer to, such as the meshes of `Mechanics.beside`, by path. They are written
        together with the scene.

    Returns
    -------
    Path
        Written scene file.

    Raises
    ------
    MistrayError
        If the scene cannot be read or a file cannot be written. It is also raised if two structures have one name, the
        scene already has an object named like a structure, or a different one named like its coating or scatter model.

    Examples
    --------
    >>> shade = mistray.Structure("shade", 14, -30, 14, -1)
    >>> file = mistray.scene.add_structures("cooke_triplet", [shade], "shaded.xml")
    >>> "shade" in [shape.id() for shape in mistray.load(file).shapes()]
    True
    """
    file, target = SceneFile(find(source)), Path(target)
    structures = STRUCTURES.check("structures", structures, f"scene '{file.path}'")
    OfType(Mapping, "must be a mapping of paths to bytes").check("files", files)
    if not all(isinstance(path, str | Path) for path in files):
        raise MistrayError(f"files is {shown(files)}; give a mapping of paths to bytes, as of Mechanics.beside")
    whole = with_includes(file.path)
    known = shared_objects(whole)
    taken = set(whole.ids)
    for shape in structures:
        if shape.name in taken:
            raise MistrayError(
                f"scene '{file.path}': it has an object '{shape.name}' already; rename the part, or that object"
            )
        taken.add(shape.name)
        for item in (*((shape.coating,) if shape.coating else ()), *shape.scatter):
            if item.name in whole.ids and known.get(item.name) != item:
                raise MistrayError(
                    f"scene '{file.path}': its object '{item.name}' differs from the one of structure "
                    f"'{shape.name}'; rename one"
                )
    text = structure_text(structures, whole.ids)
    head = f"    <!-- {comment_text(note)} -->\n" if note else ""
    at = file.root.close
    start = "" if file.data[:at].endswith(b"\n") else "\n"
    edit = (at, at, f"{start}\n{head}{text}\n".encode())
    content = file.edited([edit], target.parent)
    return replace_files({**files, target: content}, "scene file")[-1]


def shared_objects(file: SceneFile) -> Mapping[str, Shared]:
    """
    Return the coatings and scatter models that stand at the top level of a scene file with an id, by id.

    Objects with values that `_values` does not read are skipped, and so are coatings with values that no `Coating` has.
    """
    found: dict[str, Shared] = {}
    for element in file.root.children:
        name, kind = element.values.get("id"), element.values.get("type")
        values = _values(element)
        if element.tag != "bsdf" or name is None or values is None or kind is None:
            continue
        if kind in KINDS:
            found[name] = Scatter(kind, values, name=name)
        elif kind == "thinfilm" and set(values) <= COATING_KEYS:
            found[name] = Coating(**values, name=name)  # type: ignore[arg-type]
    return found


def _values(element: Element) -> dict[str, Value] | None:
    """Return a scene element's values by name if all are numbers, strings or booleans without ``$``; else None."""
    values: dict[str, Value] = {}
    for child in element.children:
        name, text = child.values.get("name"), child.values.get("value")
        if name is None or text is None or "$" in text:
            return None
        try:
            if child.tag == "float":
                values[name] = float(text)
            elif child.tag == "integer":
                values[name] = int(text)
            elif child.tag == "boolean":
                values[name] = is_true(text)
            elif child.tag == "string":
                values[name] = text
            else:
                return None
        except ValueError:
            return None
    return values

"""Change of parameter values in a scene file; everything else, comments and layout included, stays as it is.

Values are changed in place. A shared object is changed once, for all shapes that refer to it. A value that the file
leaves at its default is added after the other values. A curvature is written as a radius if the file has a radius.
Thicknesses of a preset or of a table become a list of layers.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray._mitsuba_compat import peek
from mistray.coatings import LAYER_PARAMETERS
from mistray.errors import MistrayError
from mistray.materials import resolved
from mistray.prescription.scene_file import comment_text
from mistray.replace_file import replace_file
from mistray.scene.load import load
from mistray.scene.xml_file import INDENT, Edit, Element, SceneFile

NOTE = "Values set by mistray"
# What a value may stand as instead of by its own name
INSTEAD = {"curvature": ("radius",), "thickness_nm": ("layers", "preset", "table"), "reflectance": ("preset",)}
VALUE_TAGS = ("float", "integer", "boolean", "string")


def rewritten(source: str | Path, values: Mapping[str, npt.ArrayLike], folder: str | Path, note: str = "") -> str:
    """
    Return the text of a scene with other values of parameters.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    values : mapping of str to float or sequence of float
        Key in ``mi.traverse(scene)`` → value; for a coating, one number per layer. A scene loaded from the text has
        exactly these values, but only to single precision outside shapes.
    folder : str or Path
        Folder in which the text will be stored, see `SceneFile.edited`.
    note : str
        Beginning of the comment that lists the old and new values.

    Raises
    ------
    MistrayError
        If the scene cannot be loaded; if a key does not exist, does not belong to a surface, coating or scatter model,
        or is in another file; if a value has the wrong number of entries or is not finite.
    """
    file = SceneFile(Path(source))
    params = mi.traverse(load(source))
    texts: dict[int, tuple[Element, dict[str, str]]] = {}
    lines = []
    for key, value in values.items():
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
        plugin, name = _plugin(file, params, key), key.rpartition(".")[2]
        before = np.array(peek(params, key)).ravel()
        if numbers.shape != before.shape:
            raise MistrayError(f"parameter '{key}': {numbers.size} numbers are given; it has {before.size}")
        if not np.all(np.isfinite(numbers)):
            raise MistrayError(f"parameter '{key}': {_list(numbers)} is given; it must be finite")
        element = _element(file, key)
        new = texts.setdefault(element.start, (element, {}))[1]
        if name == "thickness_nm":
            new |= _layers(file, element, plugin, numbers)
        elif name == "curvature":
            new[name] = _curvature(element, float(numbers[0]))
        elif name in LAYER_PARAMETERS:
            new[name] = f'<string name="{name}" value="{_list(numbers.astype(np.float32))}"/>'
        else:
            exact = numbers if _is_shape(plugin) else numbers.astype(np.float32)
            new[name] = f'<float name="{name}" value="{_list(exact)}"/>'
        lines.append(f"{key} = {_list(numbers.astype(before.dtype))} (was {_list(before)})")
    edits = [edit for element, new in texts.values() for edit in _edits(file, element, new)]
    if lines:
        pad = next((file.indent(child) for child in file.root.children), INDENT)
        title = f"{NOTE}: {note}" if note else NOTE
        text = f"\n{pad}     ".join(comment_text(line) for line in [title, *lines])
        edits.append((file.root.inside, file.root.inside, f"\n{pad}<!-- {text} -->".encode()))
    return file.edited(edits, Path(folder))


def write_rewritten(
    source: str | Path, values: Mapping[str, npt.ArrayLike], target: str | Path, note: str = ""
) -> Path:
    """
    Write `rewritten` text to a file, atomically: on an error an old file stays.

    Returns
    -------
    Path
        Written scene file.
    """
    target = Path(target)
    return replace_file(target, rewritten(source, values, target.parent, note), "scene file")


def _plugin(file: SceneFile, params: Any, key: str) -> Any:
    """Return the plugin that has a parameter; raise `MistrayError` if a scene file holds no value for the parameter."""
    if key not in params:
        close = difflib.get_close_matches(key, list(params.keys()))
        hint = f"did you mean {' or '.join(close)}?" if close else "list(mi.traverse(scene).keys()) shows them all"
        raise MistrayError(f"scene '{file.path}': it has no parameter '{key}'; {hint}")
    plugin, name = params.properties[key][2], key.rpartition(".")[2]
    film = getattr(plugin, "film", None)
    known = {*getattr(plugin, "values", {})}
    known |= {*LAYER_PARAMETERS, "R", "T"} if film is not None and film is plugin else set()
    known |= {"n_front_shift", "n_back_shift"} if hasattr(plugin, "complex_indices") else set()
    if name not in known:
        raise MistrayError(
            f"scene '{file.path}': parameter '{key}' is no value of a surface, coating or scatter that a file states; "
            "leave it out"
        )
    return plugin


def _is_shape(plugin: Any) -> bool:
    return hasattr(plugin, "surface")


def _element(file: SceneFile, key: str) -> Element:
    """Return the XML element of the object that has a scene parameter."""
    first, *path = key.split(".")[:-1]
    element = file.ids.get(first)
    for part in path:
        element = None if element is None else _child(file, element, part)
    if element is None:
        raise MistrayError(
            f"scene '{file.path}': the object of parameter '{key}' does not stand in the file with an id; give it one, "
            "or change the file that it is included from"
        )
    return element


def _child(file: SceneFile, element: Element, part: str) -> Element | None:
    """Return the object that ``mi.traverse`` names `part` within an element."""
    if element.tag == "shape":
        found = file.surface(element)
        return found[1] if found is not None and part == "bsdf" else None
    counts: dict[str, int] = {}
    for child in element.children:
        meant = file.meant(child)
        if meant is None or meant.tag != "bsdf":
            continue
        kind = meant.values.get("type", "")
        counts[kind] = counts.get(kind, 0) + 1
        name = "coating" if kind == "thinfilm" else kind if counts[kind] == 1 else f"{kind}_{counts[kind]}"
        if name == part:
            return meant
    return None


def _edits(file: SceneFile, element: Element, new: Mapping[str, str]) -> list[Edit]:
    """Return edits that put values into an element: each in place of the old one, or behind the last value."""
    edits: list[Edit] = []
    more = []
    values = [child for child in element.children if child.tag in VALUE_TAGS]
    for name, text in new.items():
        names = (name, *INSTEAD.get(name, ()))
        old = next((child for child in values if child.values.get("name") in names), None)
        if old is None:
            more.append(text)
        else:
            edits.append((old.start, old.end, text.encode()))
    if not more:
        return edits
    if element.end == element.inside:  # <bsdf …/>
        tag = re.sub(rb"\s*/>$", b">", file.text(element))
        return [(element.start, element.end, tag + "".join(more).encode() + f"</{element.tag}>".encode())]
    if values:
        pad = file.indent(values[-1])
        added = "".join(f"\n{pad}{text}" if pad else text for text in more)
        at = file.tail(values[-1]) if pad else values[-1].end
        return [*edits, (at, at, added.encode())]
    pad = file.indent(element.children[0]) if element.children else ""
    added = "".join(f"\n{pad}{text}" if pad else text for text in more)
    return [*edits, (element.inside, element.inside, added.encode())]


def _curvature(element: Element, curvature: float) -> str:
    """Return XML for a curvature in 1/mm, as a radius if the file has one and the reciprocal is exact."""
    given = {child.values.get("name") for child in element.children}
    radius = 1 / curvature if curvature else 0.0
    if "radius" in given and (not curvature or 1 / radius == curvature):
        return f'<float name="radius" value="{_number(radius)}"/>'
    return f'<float name="curvature" value="{_number(curvature)}"/>'


def _layers(file: SceneFile, element: Element, film: Any, thickness_nm: np.ndarray) -> dict[str, str]:
    """Return the XML values of a layered coating with these thicknesses, nm."""
    given = {child.values.get("name"): child.values.get("value", "") for child in element.children}
    numbers = [_number(value) for value in thickness_nm.astype(np.float32)]
    if "layers" in given and "$" not in given["layers"]:
        parts = [part.strip() for part in re.split(r"[,\n]", given["layers"]) if part.strip()]
        materials = [part.rpartition(" ")[0].strip() for part in parts]
    else:
        folder = file.path.resolve().parent
        materials = [
            resolved(layer.material, lambda path: os.path.relpath(path, folder)) for layer in film.coating.layers
        ]
    text = ", ".join(f"{material} {number}" for material, number in zip(materials, numbers, strict=True))
    new = {"thickness_nm": f'<string name="layers" value={quoteattr(text)}/>'}
    if film.coating.opaque and "opaque" not in given:
        new["opaque"] = '<boolean name="opaque" value="true"/>'
    return new


def _number(value: float | np.floating[Any]) -> str:
    """Return the shortest text that reads back as the same number, in its own precision."""
    return str(value).removesuffix(".0") if isinstance(value, np.float32) else repr(float(value)).removesuffix(".0")


def _list(values: np.ndarray) -> str:
    return ", ".join(_number(value) for value in values)

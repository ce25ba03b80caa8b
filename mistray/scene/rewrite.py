"""Change of parameter values in a scene file; everything else, comments and layout included, stays as it is.

Values are changed in place. A shared object is changed once, for all shapes that refer to it. A value that the file
leaves at its default is added after the other values. A curvature is written as a radius if the file has a radius.
Thicknesses of a preset or of a table become a list of layers, and ABg parameters of a catalogue become numbers.
"""

from __future__ import annotations

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
from mistray.errors import MistrayError, nearest_parameters
from mistray.materials import resolved
from mistray.physics.sags.terms import RADII
from mistray.prescription.scene_file import comment_text
from mistray.replace_file import replace_file
from mistray.scene.load import load, load_text
from mistray.scene.xml_file import INDENT, INSTEAD, Element, SceneFile

NOTE = "Values set by mistray"
ABG = ("A", "B", "g")  # what a catalogue states together


def rewritten(
    source: str | Path,
    values: Mapping[str, npt.ArrayLike],
    folder: str | Path,
    note: str = "",
    text: str | None = None,
) -> str:
    """
    Return the text of a scene with other values of parameters; without values, only its search path may change.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    values : mapping of str to float or sequence of float
        Key in ``mi.traverse(scene)`` → value in the unit of the parameter; for layers of a coating, one number each. A
        scene loaded from the text has exactly these values, but only to single precision outside shapes.
    folder : str or Path
        Folder in which the text will be stored, see `SceneFile.edited`.
    note : str
        Text in the head of the comment that lists the new and old values.
    text : str, optional
        Text to change instead of the content of the file.

    Raises
    ------
    MistrayError
        If the scene cannot be loaded, or a value has the wrong number of entries or is not finite. It is also raised if
        a key does not exist, does not belong to a surface, coating or scatter model, or is in another file.
    """
    file = SceneFile(Path(source), None if text is None else text.encode())
    if not values:
        return file.edited([], Path(folder))
    params = mi.traverse(load(source) if text is None else load_text(Path(source), text))
    new: list[tuple[Element, str, str]] = []
    lines = []
    for key, value in values.items():
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
        plugin, name = _plugin(file, params, key), key.rpartition(".")[2]
        before = np.array(peek(params, key)).ravel()
        if numbers.shape != before.shape:
            raise MistrayError(f"parameter '{key}': {numbers.size} numbers are given; it has {before.size}")
        if not np.all(np.isfinite(numbers)):
            raise MistrayError(f"parameter '{key}': {_list(numbers)} is given; it must be finite")
        element = file.named(key.rpartition(".")[0])
        if element is None:
            raise MistrayError(
                f"scene '{file.path}': the object of parameter '{key}' does not stand in the file with an id; give it "
                "one, or change the file that it is included from"
            )
        exact = numbers if hasattr(plugin, "surface") else numbers.astype(np.float32)
        written = {name: f'<float name="{name}" value="{_list(exact)}"/>'}
        if name == "thickness_nm":
            written = _layers(file, element, plugin, numbers)
        elif name in RADII.values():
            written = {name: _curvature(element, name, float(numbers[0]))}
        elif name in ABG and any(child.values.get("name") == "file" for child in element.children):
            place = key.rpartition(".")[0]
            rest = {one: getattr(plugin.model, one) for one in (*ABG, "reference_nm") if f"{place}.{one}" not in values}
            stated = {one: number for one, number in rest.items() if number is not None}
            written |= {one: f'<float name="{one}" value="{_number(number)}"/>' for one, number in stated.items()}
        elif name in LAYER_PARAMETERS:
            written = {name: f'<string name="{name}" value="{_list(exact)}"/>'}
        new += [(element, one, xml) for one, xml in written.items()]
        lines.append(f"{key} = {_list(numbers.astype(before.dtype))} (was {_list(before)})")
    pad = next((file.indent(child) for child in file.root.children), INDENT)
    title = f"{NOTE}: {note}" if note else NOTE
    comment = f"\n{pad}     ".join(comment_text(line) for line in [title, *lines])
    edits = [*file.with_values(new), (file.root.inside, file.root.inside, f"\n{pad}<!-- {comment} -->".encode())]
    return file.edited(edits, Path(folder))


def write_rewritten(
    source: str | Path, values: Mapping[str, npt.ArrayLike], target: str | Path, note: str = ""
) -> Path:
    """
    Write the text that `rewritten` returns to a file, atomically: on an error an old file stays.

    Raise `MistrayError` as `rewritten` does, or if the file cannot be written.

    Returns
    -------
    Path
        Written scene file.
    """
    target = Path(target)
    return replace_file(target, rewritten(source, values, target.parent, note), "scene file")


def _plugin(file: SceneFile, params: Any, key: str) -> Any:
    """
    Return the plugin that has a parameter.

    Raise `MistrayError` if there is no such parameter, or if a scene file holds no value for it.
    """
    if key not in params:
        hint = nearest_parameters(key, params.keys())
        raise MistrayError(f"scene '{file.path}': it has no parameter '{key}'; {hint}")
    plugin, name = params.properties[key][2], key.rpartition(".")[2]
    film = getattr(plugin, "film", None)
    known = {*getattr(plugin, "values", {})}
    known |= {*LAYER_PARAMETERS, "R", "T"} if film is not None and film is plugin else set()
    known |= {"n_front_shift", "n_back_shift"} if hasattr(plugin, "complex_indices") else set()
    if name not in known:
        raise MistrayError(
            f"scene '{file.path}': parameter '{key}' is not a value of a surface, coating or scatter that a file "
            "states; leave it out"
        )
    return plugin


def _curvature(element: Element, name: str, curvature: float) -> str:
    """Return the XML value for a curvature, 1/mm; as a radius if the file has one and the reciprocal is exact."""
    given = {child.values.get("name") for child in element.children}
    (by_radius,) = INSTEAD[name]
    radius = 1 / curvature if curvature else 0.0
    if by_radius in given and (not curvature or 1 / radius == curvature):
        return f'<float name="{by_radius}" value="{_number(radius)}"/>'
    return f'<float name="{name}" value="{_number(curvature)}"/>'


def _layers(file: SceneFile, element: Element, film: Any, thickness_nm: np.ndarray) -> dict[str, str]:
    """
    Return the XML of the layers of a coating with these thicknesses, nm, under the key ``thickness_nm``.

    If the coating is opaque and the file does not say so, the XML of ``opaque`` comes with it.
    """
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
    """Return the shortest string that reads back as the same number, in its own precision."""
    return str(value).removesuffix(".0") if isinstance(value, np.float32) else repr(float(value)).removesuffix(".0")


def _list(values: np.ndarray) -> str:
    return ", ".join(_number(value) for value in values)

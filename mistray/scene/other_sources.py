"""Sources that replace those of a scene, from a line of text or a dict."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.named_values import as_number, named_values
from mistray.scene.allowed_plugins import check_dict

# Words for the command line, and the plugins that they stand for
KINDS = {
    "beam": "collimated",
    "point": "point_source",
    "surface": "surface_source",
    "laser": "gaussian_beam",
    "sun": "distant_disc",
    "sky": "sky",
    "rays": "ray_file",
    "led": "point_source",
    "thermal": "thermal",
}
PLACE = ("x", "y", "z")
LISTS = ("profile", "wavelength_nm", "weights", "band_nm", "stokes", "jones")  # properties that are no single number
TEXT = ("id", "filename", "unit", "plane", "pattern", "spectrum", "parts")


def source_dict(source: str | Mapping[str, Any]) -> dict[str, Any]:
    """
    Return a source as the dict of its plugin.

    Parameters
    ----------
    source : str or mapping
        A dict, or text such as ``"point:0,0,-500"``, ``"surface:0,0,-80,radius=5,radiance=2"``, ``"sun:field_deg=30"``:
        a word of `KINDS` or the type of a plugin, its place in mm, and properties by their names. Spaces separate the
        numbers of a list: ``"sun:wavelength_nm=450 550 650"``.

    Raises
    ------
    MistrayError
        If the text is not understood, or the dict has no type.
    """
    if not isinstance(source, str):
        return given_dict("source", source, "point:0,0,-500")
    word, place, found = parsed("source", source, LISTS, TEXT)
    if not word.isidentifier():
        raise MistrayError(f"source '{source}': it names no kind; give {', '.join(KINDS)} or a plugin")
    return {"type": KINDS.get(word, word), **dict(zip(PLACE, place, strict=False)), **found}


def parsed(
    what: str, text: str, lists: Collection[str], words: Collection[str]
) -> tuple[str, list[float], dict[str, Any]]:
    """
    Parse a string ``WORD:x,y,z,name=value,…`` into its word, its place, mm, and its properties.

    Parameters
    ----------
    what : str
        Kind of thing that the text describes, for messages.
    text : str
        Text to parse.
    lists, words : collection of str
        Names of properties that are lists, with spaces between the entries, and of properties that are strings. Any
        other property is a number.

    Returns
    -------
    (str, list of float, dict)
        The word; x, y and z, mm, or an empty list; properties by name: numbers, strings, and lists as strings with
        commas.

    Raises
    ------
    MistrayError
        If the text is not understood.
    """
    word, _, rest = text.strip().partition(":")
    parts = [part.strip() for part in rest.split(",")] if rest.strip() else []
    owner = f"{what} '{text}'"
    place = [part for part in parts if "=" not in part]
    if place and (len(place) != len(PLACE) or parts[: len(place)] != place):
        raise MistrayError(f"{owner}: its place is {','.join(place)}; give x,y,z in mm, then names=values")
    at = {axis: as_number(value, axis, owner) for axis, value in zip(PLACE, place, strict=False)}
    named = named_values([*(f"{axis}=" for axis in at), *parts[len(place) :]], owner)
    found: dict[str, Any] = {key: value for key, value in named.items() if key not in at}
    for key, value in found.items():
        if key in lists:
            found[key] = value.replace(" ", ",")
        elif key not in words:
            found[key] = as_number(value, key, owner)
    return word, list(at.values()), found


def source_dicts(sources: Sequence[str | Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the dicts of sources by id; raise `MistrayError` for the reasons of `source_dict` and `keyed`."""
    return keyed("source", [source_dict(source) for source in sources], ["source"] * len(sources))


def given_dict(what: str, part: Any, example: str) -> dict[str, Any]:
    """
    Return a copy of a source or sensor that is given as a dict.

    Raise `MistrayError` if it is not a dict or has no type; `what` and `example` are for its message.
    """
    if not isinstance(part, Mapping) or "type" not in part:
        raise MistrayError(f"{what} {part!r}: give a text such as '{example}', or a dict with a 'type'")
    return dict(part)


def keyed(what: str, parts: Sequence[dict[str, Any]], words: Sequence[str]) -> dict[str, dict[str, Any]]:
    """
    Return the dicts of sources or sensors by id, which is taken out of them.

    One without id is named by its word in `words`, numbered if the word repeats. Raise `MistrayError` if two have the
    same id, or a plugin is not allowed; `what` is for its message.
    """
    result: dict[str, dict[str, Any]] = {}
    for number, (found, word) in enumerate(zip(parts, words, strict=True)):
        numbered = f"{word}_{list(words[:number]).count(word) + 1}"
        name = str(found.pop("id", word if list(words).count(word) == 1 else numbered))
        if name in result:
            raise MistrayError(f"{what} '{name}': two {what}s have this id; give every {what} an id of its own")
        result[name] = found
    check_dict(result)
    return result


def with_parts(
    scene: mi.Scene, sources: Mapping[str, dict[str, Any]], sensors: Mapping[str, dict[str, Any]] | None = None
) -> mi.Scene:
    """
    Return a scene with other sources, if any are given, and with further sensors.

    Parameters
    ----------
    scene : mi.Scene
        Scene to change. Its shapes and its integrator move to the result; do not use it afterwards. Shapes that carry
        an emitter keep it.
    sources, sensors : mapping of str to dict
        Plugin dicts, keyed by id; without sources the scene keeps its own.

    Raises
    ------
    MistrayError
        If the scene already has an object with one of these ids.
    RuntimeError
        If Mitsuba refuses a dict.
    """
    parts: dict[str, Any] = {"type": "scene", "integrator": scene.integrator()}
    parts |= {shape.id() or f"shape_{number}": shape for number, shape in enumerate(scene.shapes())}
    alone = [sensor for sensor in scene.sensors() if sensor.get_shape() is None]
    if not sources:
        alone += [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    parts |= {one.id() or f"part_{number}": one for number, one in enumerate(alone)}
    for what, described in (("source", sources), ("sensor", sensors or {})):
        for name in described:
            if name in parts:
                raise MistrayError(f"{what} '{name}': the scene has something else of that id; give it another id")
        parts |= described
    return mi.load_dict({key: part for key, part in parts.items() if part is not None}, optimize=False)

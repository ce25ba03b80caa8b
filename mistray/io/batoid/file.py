"""Telescope files of batoid (YAML), checked before batoid's parser evaluates the types that they name."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError, foreign_errors
from mistray.files.packages import package
from mistray.materials.mate import shown
from mistray.read_file import read_text

if TYPE_CHECKING:
    import batoid

# Every type that batoid's parser knows, `Clear…` being the complement of `Obsc…`
OBSCURATIONS = ("Circle", "Annulus", "Ray", "Rectangle", "Polygon", "Negation", "Union", "Intersection")
TYPES = frozenset(
    [
        *("Mirror", "RefractiveInterface", "OPDScreen", "Baffle", "Detector", "Lens", "CompoundOptic", "Interface"),
        *("Plane", "Sphere", "Paraboloid", "Quadric", "Asphere", "Bicubic", "Zernike", "Tilted", "Sum"),
        *("Air", "ConstMedium", "SellmeierMedium", "SumitaMedium", "TableMedium"),
        *(head + name for name in OBSCURATIONS for head in ("Obsc", "Clear")),
    ]
)
MOST_ENTRIES = 1_000_000  # of a file, what it repeats by an alias included; the camera of LSST has some 600
_UNKNOWN = re.compile(r"(\w+)\.__init__\(\) got an unexpected keyword argument '(\w+)'")
_GROUPS = ("items", "surface", "coordSys", "obscuration", "screen", "stopSurface")
DEEPEST = 100  # levels; telescopes need about twenty


def read_optic(path: str | Path) -> batoid.Optic:
    """
    Return the optic that a telescope file of batoid describes.

    Parameters
    ----------
    path : str or Path
        YAML file. A name without a folder may also name a file that comes with batoid, such as ``"LSST_r.yaml"``.

    Returns
    -------
    batoid.Optic
        Optic read by batoid.

    Raises
    ------
    MistrayError
        If batoid is missing or cannot read the file, or the file names a type that is not in `TYPES`. In the last case
        nothing that the file names is evaluated.
    """
    parse_optic = package("batoid files need batoid", "batoid.parse", "batoid").parse_optic
    import yaml  # type: ignore[import-untyped]

    text = read_text(_own_file(Path(path)), "lens")
    with foreign_errors(f"lens '{path}'", "it must be a batoid YAML file"):
        content = yaml.safe_load(text)
        system = content["opticalSystem"] if isinstance(content, dict) else None
        if not isinstance(system, dict):
            raise ValueError("it has no 'opticalSystem'")
        for kind in _types(system):
            if kind not in TYPES:
                raise ValueError(f"there is no type '{shown(str(kind).split())}'")
    try:
        return parse_optic(_unshared(system))
    except Exception as error:  # batoid raises all kinds
        item, error = _faulty(system, error, parse_optic)
        raise MistrayError(f"lens '{path}': {shown([_place(item)])} {_reason(item, error)}; correct it") from None


def _own_file(path: Path) -> Path:
    """Return a path; if nothing exists there, that of the file of this name in batoid's own data."""
    import batoid

    if path.exists() or path.name != str(path):
        return path
    return next(iter(sorted(Path(batoid.datadir).rglob(path.name))), path)


def _unshared(item: Any) -> Any:
    """Return a deep copy of nested data, because batoid changes entries that it reads."""
    if isinstance(item, dict):
        return {key: _unshared(value) for key, value in item.items()}
    return [_unshared(value) for value in item] if isinstance(item, list) else item


def _faulty(item: dict[str, Any], error: Exception, parse: Callable[[Any], Any]) -> tuple[dict[str, Any], Exception]:
    """
    Return the innermost element of a telescope file that batoid cannot read, and the exception that it raises.

    The search begins at the element `item`, for which batoid's parser `parse` has raised `error`.
    """
    for part in item["items"] if isinstance(item.get("items"), list) else ():
        try:
            parse(_unshared(part))
        except Exception as own:  # whatever batoid raises
            return _faulty(part, own, parse) if isinstance(part, dict) else (item, own)
    return item, error


def _place(item: dict[str, Any]) -> str:
    return f"{item.get('type', 'optic')} '{item.get('name', '')}'"


def _reason(item: dict[str, Any], error: Exception) -> str:
    """Return the words that say what is wrong with an element of a telescope file, from batoid's exception."""
    if isinstance(error, KeyError):
        return f"has no '{shown([str(error.args[0])])}'"
    if word := _UNKNOWN.search(str(error)):
        return f"has a {word[1]} with '{word[2]}', which batoid does not know"
    flat = [key for key in _GROUPS if key in item and not isinstance(item[key], dict | list)]
    if isinstance(error, TypeError | AttributeError) and flat:
        return f"has {flat[0]} = {shown([str(item[flat[0]])])}, which must be a group of entries"
    return f"cannot be read: {shown(str(error).split()) or type(error).__name__}"


def _types(system: dict[str, Any]) -> Iterator[Any]:
    """
    Yield every type name in a telescope file, at any depth, because batoid evaluates these names as code.

    Raise ValueError if the file is nested too deeply or has too many entries.
    """
    waiting: list[tuple[Any, int]] = [(system, 1)]
    seen = 0
    while waiting:
        item, depth = waiting.pop()
        seen += 1
        if depth > DEEPEST or seen > MOST_ENTRIES:
            raise ValueError(f"it has more than {DEEPEST} levels or {MOST_ENTRIES} entries")
        if isinstance(item, dict):
            if "type" in item:
                yield item["type"]
            waiting += [(value, depth + 1) for value in item.values()]
        elif isinstance(item, list | tuple):
            waiting += [(value, depth + 1) for value in item]

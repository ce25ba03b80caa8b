"""Telescope files of batoid (YAML), checked before batoid reads them: its parser evaluates the types that they name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
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
DEEPEST = 100  # levels; telescopes need about twenty


def read_optic(path: str | Path) -> batoid.Optic:
    """
    Read a telescope file of batoid.

    Parameters
    ----------
    path : str or Path
        YAML file.

    Returns
    -------
    batoid.Optic

    Raises
    ------
    MistrayError
        If batoid is missing, the file cannot be read, or it names a type that is not in `TYPES`. Nothing that the file
        names is evaluated then.
    """
    try:
        import yaml  # type: ignore[import-untyped]
        from batoid.parse import parse_optic
    except ImportError:
        raise MistrayError("batoid is not installed; run: pip install 'mistray[batoid]'") from None
    text = read_text(path, "lens")
    try:
        content = yaml.safe_load(text)
        system = content["opticalSystem"] if isinstance(content, dict) else None
        if not isinstance(system, dict):
            raise ValueError("it has no 'opticalSystem'")
        for kind in _types(system):
            if kind not in TYPES:
                raise ValueError(f"there is no type '{shown(str(kind).split())}'")
        return parse_optic(system)
    except Exception as error:  # yaml and batoid raise all kinds
        reason = shown(str(error).split()) or type(error).__name__
        raise MistrayError(f"lens '{path}': {reason}; it must be a batoid YAML file") from None


def _types(system: dict[str, Any]) -> Iterator[Any]:
    """Every type of a system, wherever it stands: batoid evaluates those of surfaces, media and obscurations."""
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

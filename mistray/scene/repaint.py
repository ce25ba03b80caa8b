"""Paint put on surfaces of a scene file; everything else in the file stays as it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

from mistray.replace_file import replace_file
from mistray.scatter.kinds import KINDS
from mistray.scatter.paint import Paint
from mistray.scene.recoat import is_coating, refitted
from mistray.scene.xml_file import Element, SceneFile


def write_repainted(source: str | Path, paints: Mapping[str, str | float], target: str | Path) -> Path:
    """
    Write a scene with surfaces painted, atomically: on an error an old file stays.

    A painted surface is opaque. Its coating and its models of scatter go; its materials stay.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    paints : mapping of str to str or float
        Id of a shape → preset of `mistray.scatter.paint.PRESETS`, or the reflectance of a Lambertian paint, 0 … 1.
    target : str or Path
        May be `source` itself.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MistrayError
        If the file cannot be read, a shape is missing or has no ``interface``, or a paint is none.
    """
    file, target = SceneFile(Path(source)), Path(target)
    edits = [refitted(file, surface, _goes, _lines(paint)) for surface, paint in paints.items()]
    return replace_file(target, file.edited(edits, target.parent), "scene file")


def _goes(file: SceneFile, child: Element) -> bool:
    """Whether a child of an interface is its coating or a model of scatter."""
    return is_coating(file, child) or (file.meant(child) or child).values.get("type") in KINDS


def _lines(paint: str | float) -> list[str]:
    if isinstance(paint, str):
        Paint.preset(paint)
        value = f'<string name="preset" value={quoteattr(paint)}/>'
    elif paint == 0:
        return ['<float name="R" value="0"/>']
    else:
        value = f'<float name="reflectance" value="{Paint(float(paint)).reflectance!r}"/>'
    return ['<float name="R" value="0"/>', f'<bsdf type="paint">{value}</bsdf>']

"""Plates of any outline with holes and finite thickness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.outline import Outline, OutlineFigure, rectangle
from mistray.prescription.bodies.placing import face_place
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.model import Structure, Surface
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import SIZE_MM

Z = np.array([0.0, 0.0, 1.0])
RIM_POINTS = 64  # of a side of a figure, or of a quarter of a circle


def plate(
    name: str,
    outline: Outline,
    thickness: float,
    *,
    z: float = 0.0,
    coating: Coating | None = BLACK,
    scatter: Scatter | Sequence[Scatter] = (),
) -> tuple[Surface | Structure, ...]:
    """
    Return the faces of an opaque plate normal to z, with the walls of its rim and of its holes.

    Parameters
    ----------
    name : str
        Name of the part. Faces are ``<name>_front`` (-z), ``<name>_rear``, and ``<name>_wall_<k>`` for circle k of the
        outline, or ``<name>_wall_<k>_<side>`` for another figure. An ellipse has four sides, each about the end of a
        half axis.
    outline : Outline
        A circle, ellipse, rectangle or polygon, then holes of these kinds ("-") that lie within it and apart from each
        other.
    thickness : float
        Thickness, mm.
    z : float
        Position of the front, mm.
    coating, scatter
        Coating (None: bare Fresnel interface) and scatter models of all faces.

    Returns
    -------
    tuple of Surface and Structure
        Faces for `Prescription.structures`; `moved_as_one` moves the whole plate.

    Raises
    ------
    MistrayError
        If the thickness is not above 0, the outline has other figures, or holes cross the rim or each other.

    Examples
    --------
    >>> mask = mistray.prescription.plate("mask", mistray.prescription.circle(30, inner=10), 2)
    >>> [face.name for face in mask]
    ['mask_front', 'mask_rear', 'mask_wall_1', 'mask_wall_2']
    """
    owner = f"plate '{name}'"
    SIZE_MM.check("thickness", thickness, owner)
    outline.check(owner)
    _check_holes(outline, owner)
    common: dict[str, Any] = {"coating": coating, "scatter": SCATTER.check("scatter", scatter, owner), "part": name}
    found: list[Surface | Structure] = [
        Surface(f"{name}_{face}", outline=outline, z=height, **common)
        for face, height in (("front", z), ("rear", z + thickness))
    ]
    for k, figure in enumerate(outline.figures, start=1):
        wall = f"{name}_wall_{k}"
        if figure.kind == "circle":
            (r,) = figure.sizes
            found.append(Structure(wall, r, 0.0, r, thickness, x=figure.x, y=figure.y, z=z, **common))
        elif figure.kind == "ellipse":
            found += _elliptic_walls(wall, figure, thickness, z, common)
        else:
            found += _flat_walls(wall, figure, thickness, z, common)
    return tuple(found)


def _elliptic_walls(
    name: str, figure: OutlineFigure, thickness: float, z: float, common: dict[str, Any]
) -> list[Surface]:
    """
    Return the wall of an elliptic figure of a plate as four conic cylinders, each about the end of a half axis.

    `thickness` and the front's place `z` are in mm; `common` are further arguments of `Surface`.

    Let p be the half axis along the normal and q the one across it. There the ellipse is the conic of curvature p/q²
    and conic constant q²/p² - 1. Two pieces meet where x/a = y/b, at q/√2 from their vertices.
    """
    c, s = math.cos(math.radians(figure.angle_deg)), math.sin(math.radians(figure.angle_deg))
    axes = np.array([[c, s, 0.0], [-s, c, 0.0]])
    walls = []
    for k in range(4):
        p, q = figure.sizes[k % 2], figure.sizes[1 - k % 2]
        outwards = axes[k % 2] * (1 if k < 2 else -1)
        at = np.array([figure.x, figure.y, z + thickness / 2]) + p * outwards
        place = face_place(at, (np.cross(Z, -outwards), Z, -outwards))
        conic: dict[str, Any] = {"curvature_x": p / q**2, "conic_x": (q / p) ** 2 - 1}
        half = rectangle(q / math.sqrt(2), thickness / 2)
        walls.append(Surface(f"{name}_{k + 1}", sag=conic, outline=half, **place, **common))
    return walls


def _flat_walls(name: str, figure: OutlineFigure, thickness: float, z: float, common: dict[str, Any]) -> list[Surface]:
    corners = figure.placed(figure.corners)
    walls = []
    for k, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True), start=1):
        along = np.array([*(b - a), 0.0]) / np.linalg.norm(b - a)
        at = np.array([*(a + b) / 2, z + thickness / 2])
        place = face_place(at, (along, Z, np.cross(along, Z)))
        half: dict[str, Any] = {"half_width": float(np.linalg.norm(b - a)) / 2, "half_height": thickness / 2}
        walls.append(Surface(f"{name}_{k}", **place, **half, **common))
    return walls


def _check_holes(outline: Outline, owner: str) -> None:
    """Raise `MistrayError` for unsuitable figures, and for holes that cross the rim or each other at tested points."""
    kinds = ("circle", "ellipse", "rectangle", "polygon")
    for k, figure in enumerate(outline.figures, start=1):
        if figure.kind not in kinds or figure.sign != ("+" if k == 1 else "-"):
            raise MistrayError(
                f"{owner}: figure {k} of its outline is '{figure.sign}{figure.kind}'; give a circle, ellipse, "
                "rectangle or polygon first, then holes of these kinds"
            )
    rims = [_rim(figure) for figure in outline.figures]
    alone = [Outline((replace(figure, sign="+"),)) for figure in outline.figures]
    for k in range(1, len(rims)):
        if not np.all(alone[0].contains(*rims[k].T)):
            raise MistrayError(f"{owner}: hole {k} reaches over its rim; make it smaller or move it")
        for j in range(1, k):
            if np.any(alone[j].contains(*rims[k].T)) or np.any(alone[k].contains(*rims[j].T)):
                raise MistrayError(f"{owner}: holes {j} and {k} overlap; make one hole of them or move one")


def _rim(figure: OutlineFigure) -> np.ndarray:
    """Return points on the border of a figure of the outline, (n, 2), mm."""
    if figure.kind in ("circle", "ellipse"):
        a, b = figure.sizes if len(figure.sizes) == 2 else 2 * figure.sizes
        angle = 2 * np.pi * np.arange(4 * RIM_POINTS) / (4 * RIM_POINTS)
        return figure.placed(np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1))
    corners = figure.placed(figure.corners)
    part = np.arange(RIM_POINTS)[:, None, None] / RIM_POINTS
    points: np.ndarray = corners + part * (np.roll(corners, -1, axis=0) - corners)
    return points.reshape(-1, 2)

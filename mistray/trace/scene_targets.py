"""Targets that a scene brings along: shapes that carry a `target` instead of an `interface`."""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import mesh_arrays
from mistray.errors import MistrayError
from mistray.trace.host_points import outline, surface_points
from mistray.trace.settings import MOST_RAYS_PER_HIT
from mistray.trace.surfaces import SurfaceTable
from mistray.trace.targets import AimSet, Target

MOST_TRIANGLES = 64
PROBES = 256  # pairs of a point of the surface and one of the target that tell on which sides the target lies


def scene_targets(table: SurfaceTable, scene: mi.Scene) -> dict[tuple[int, bool], AimSet]:
    """
    The targets of the scene, by the surfaces that they name and the sides on which they lie.

    Each target has a share of the aimed rays by its own number of rays.

    Returns
    -------
    dict
        (surface, whether the light leaves to the back) → AimSet.

    Raises
    ------
    MistrayError
        If a target names no surface of the scene, has an impossible shape or size, or a surface has too many rays.
    """
    found: dict[tuple[int, bool], list[tuple[int, Target]]] = {}
    rng = np.random.default_rng(0)
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if not getattr(bsdf, "is_target", False):
            continue
        targets = shape_targets(shape)
        for surface in _named(table, shape.id(), bsdf.surfaces):
            points, normals = surface_points(table, surface, PROBES, rng)
            for target in targets:
                d = (target.points(rng.random((PROBES, 2))) - points) * (-1 if target.reverse else 1)
                outward = np.einsum("ij,ij->i", d, normals)
                for to_back, reached in ((False, outward < 0), (True, outward > 0)):
                    if np.any(reached):
                        found.setdefault((surface, to_back), []).append((bsdf.rays, target))
    return {side: _aim_set(table.ids[side[0]], entries) for side, entries in found.items()}


def _named(table: SurfaceTable, name: str, patterns: tuple[str, ...]) -> list[int]:
    """Numbers of the surfaces whose ids fit the patterns of a target."""
    numbers: dict[int, None] = {}
    for pattern in patterns:
        fitting = [i for i, surface in enumerate(table.ids) if fnmatchcase(surface, pattern)]
        if not fitting:
            raise MistrayError(f"target '{name}': no surface of the scene is called '{pattern}'; correct surfaces")
        numbers.update(dict.fromkeys(fitting))
    return list(numbers)


def _aim_set(surface: str, entries: list[tuple[int, Target]]) -> AimSet:
    """Targets of one side with their numbers of rays; the parts of one mesh share its rays by their `share`."""
    weights = [rays * target.share for rays, target in entries]
    total = round(sum(weights))
    if total > MOST_RAYS_PER_HIT:
        raise MistrayError(
            f"surface '{surface}': {total} aimed rays; its targets may have {MOST_RAYS_PER_HIT} together"
        )
    shares = np.array(weights) / sum(weights)
    return AimSet(
        tuple(target.with_share(float(share)) for (_, target), share in zip(entries, shares, strict=True)),
        max(total, 1),
    )


def shape_targets(shape: Any) -> list[Target]:
    """
    The flat targets of a shape that carries a `target`.

    A rectangle, a disk, an `asphere` (by its rim) and a flat `frustum` are one target; a mesh is one for each triangle,
    with shares by area. `scale` is about the centre (of a mesh: the centroid of its area).

    Raises
    ------
    MistrayError
        For another shape, a mesh of too many triangles, or a hole in a target without a round rim.
    """
    name, bsdf = shape.id(), shape.bsdf()
    own, kind = getattr(shape, "kind", ""), str(shape).partition("[")[0].strip()
    if (own == "frustum" and shape.flat) or own == "asphere" or kind in ("Rectangle", "Disk"):
        found = [outline(shape)]
        found = [replace(found[0], u=bsdf.scale * found[0].u, v=bsdf.scale * found[0].v)]
    elif shape.is_mesh() and not own:
        found = _triangles(name, *mesh_arrays(shape), bsdf.scale)
    else:
        raise MistrayError(
            f"target '{name}' is {own or kind}; use a disk, a rectangle, a flat frustum, an asphere or a mesh"
        )
    if bsdf.hole and found[0].shape != "ellipse":
        raise MistrayError(f"target '{name}': hole is {bsdf.hole:g}; only a disk, a ring or a round asphere has one")
    hole = max(found[0].hole, bsdf.hole)
    return [replace(target, hole=hole, reverse=bsdf.reverse) for target in found]


def _triangles(name: str, vertices: np.ndarray, faces: np.ndarray, scale: float) -> list[Target]:
    corners = vertices.astype(np.float64)[faces]
    if len(corners) > MOST_TRIANGLES:
        raise MistrayError(
            f"target '{name}': a mesh of {len(corners)} triangles; at most {MOST_TRIANGLES} are possible"
        )
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(u, v), axis=1)
    if not np.all(area > 0):
        raise MistrayError(f"target '{name}': a triangle of its mesh has no area; remove it")
    middle = np.average(corners.mean(axis=1), axis=0, weights=area)
    starts = middle + scale * (corners[:, 0] - middle)
    return [
        Target("triangle", start, scale * a, scale * b, share=float(part))
        for start, a, b, part in zip(starts, u, v, area / area.sum(), strict=True)
    ]

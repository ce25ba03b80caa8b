"""Importance targets that a scene defines: shapes that carry a `target` instead of an `interface`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import mesh_arrays
from mistray.errors import MistrayError
from mistray.ids import fits
from mistray.kernel.targets import AimSet, AnyTarget, Ellipsoid, Place, Target, TargetCone
from mistray.ranges import RAYS_PER_HIT
from mistray.sampling.bulk_aiming import scattering_bodies
from mistray.sampling.outlines import outline
from mistray.surfaces.host_points import surface_points
from mistray.surfaces.surfaces import SurfaceTable, is_analytic

MOST_TRIANGLES = 64  # of a mesh, each of which is a target of its own
PROBES = 256  # pairs of a point of the surface and one of the target, from which the sides of the target follow


def scene_targets(table: SurfaceTable, scene: mi.Scene) -> dict[int, dict[Place, AimSet]]:
    """
    Return the importance targets that a scene defines, by surface and by place of scatter.

    Aimed rays are shared among the targets in proportion to each target's own number of rays.

    Returns
    -------
    dict
        Index of a surface → place → targets. Places are the sides to which light can leave towards a target, and the
        scattering media there.

    Raises
    ------
    MistrayError
        If a target names a surface that is not there, or has an impossible shape or size, or a surface has too
        many rays.
    """
    found: dict[int, dict[Place, list[tuple[int, AnyTarget]]]] = {}
    rng = np.random.default_rng(0)
    # Sides that bound scattering media: what a medium scatters is aimed whichever side the target lies on
    insides = [side for body in scattering_bodies(table) for side in body.sides] if table.optics.scatters else []
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if not getattr(bsdf, "is_target", False):
            continue
        targets = shape_targets(shape, table)
        for surface in _named(table, shape.id(), bsdf.surfaces):
            # Sides of the surface from which the target can be seen, by random pairs of points
            points, normals = surface_points(table, surface, PROBES, rng)
            places = found.setdefault(surface, {})
            for target in targets:
                reached: list[Place] = [inside for inside in insides if inside.surface == surface]
                sides = target.sides(points, normals, rng)
                reached += [(surface, to_back) for to_back, side in zip((False, True), sides, strict=True) if side]
                for place in reached:
                    places.setdefault(place, []).append((bsdf.rays, target))
    return {
        surface: {place: _aim_set(table.ids[surface], entries) for place, entries in places.items()}
        for surface, places in found.items()
    }


def _named(table: SurfaceTable, name: str, patterns: tuple[str, ...], one: bool = False) -> list[int]:
    """
    Return the indices of the surfaces whose ids match a target's patterns, each surface once.

    With `one` the pattern is the target's entity, which must match one surface.

    Raises
    ------
    MistrayError
        If a pattern matches no surface, or with `one` several.
    """
    # A dict keeps the order of the patterns, and each surface once
    numbers: dict[int, None] = {}
    for pattern in patterns:
        fitting = [i for i, surface in enumerate(table.ids) if fits(surface, pattern)]
        if not fitting:
            key = "entity" if one else "surfaces"
            raise MistrayError(f"target '{name}': no surface of the scene is called '{pattern}'; correct {key}")
        if one and len(fitting) > 1:
            raise MistrayError(f"target '{name}': entity '{pattern}' fits {len(fitting)} surfaces; name one")
        numbers.update(dict.fromkeys(fitting))
    return list(numbers)


def _aim_set(surface: str, entries: list[tuple[int, AnyTarget]]) -> AimSet:
    """
    Return the set of targets of one surface side; each has a share in proportion to its aimed rays.

    The triangles of a mesh share its rays. Raise `MistrayError` if there are too many rays together.
    """
    weights = [rays * target.share for rays, target in entries]
    total = round(sum(weights))
    if total > RAYS_PER_HIT.high:
        raise MistrayError(
            f"surface '{surface}': {total} aimed rays; its targets may have {RAYS_PER_HIT.high:g} together"
        )
    return AimSet.of([target for _, target in entries], max(total, 1), weights)


def shape_targets(shape: Any, table: SurfaceTable) -> list[AnyTarget]:
    """
    Return the importance targets that a shape with a `target` defines.

    A target with `about` is a cone, and one with `entity` covers that surface. Otherwise a rectangle, a disk, an
    `asphere` (by its rim), a flat `frustum` and a sphere are one target each. A mesh is one target for each triangle,
    with shares by area. `scale` is about the centre (of a mesh: the centroid of its area).

    Raises
    ------
    MistrayError
        For another shape, a mesh of too many triangles or one without area, a hole in a target without a round rim,
        half axes of anything but a sphere, a direction of a shape that is no sheet, or an entity that does not name one
        surface.
    """
    # Cones and entities, which do not use the outline of the shape
    name, bsdf = shape.id(), shape.bsdf()
    if bsdf.about:
        return [_cone(shape)]
    if bsdf.entity:
        (number,) = _named(table, name, (bsdf.entity,), one=True)
        return [replace(_around(table.shapes[number], bsdf.scale), reverse=bsdf.reverse)]
    # Spheres
    own, kind = _kind(shape)
    found: list[Target]
    no_hole = f"target '{name}': hole is {bsdf.hole:g}; only a disk, a ring or a round asphere has one"
    if kind == "Sphere":
        if bsdf.hole:
            raise MistrayError(no_hole)
        return [replace(_sphere(shape, bsdf.scale, bsdf.half_axes), reverse=bsdf.reverse)]
    if bsdf.half_axes:
        raise MistrayError(f"target '{name}' is {own or kind}; half_axes are those of a sphere: use one or leave them")
    # Flat shapes and meshes
    if _is_flat(shape):
        found = [_scaled(outline(shape), bsdf.scale)]
    elif shape.is_mesh() and not own:
        found = _triangles(name, *mesh_arrays(shape), bsdf.scale)
    else:
        raise MistrayError(
            f"target '{name}' is {own or kind}; use a disk, a rectangle, a flat frustum, an asphere, a sphere or a mesh"
        )
    if bsdf.hole and found[0].shape != "ellipse":
        raise MistrayError(no_hole)
    hole = max(found[0].hole, bsdf.hole)
    return [replace(target, hole=hole, reverse=bsdf.reverse) for target in found]


def _kind(shape: Any) -> tuple[str, str]:
    """Return the plugin name of an analytic shape ("" for other shapes), and the class name of the shape."""
    kind = str(shape).partition("[")[0].strip()
    return kind.lower() if is_analytic(shape) else "", kind


def _is_flat(shape: Any) -> bool:
    """True if a shape is a sheet, flat or like an `asphere`, for which its flat outline stands as target."""
    return shape.sheet if is_analytic(shape) else _kind(shape)[1] in ("Rectangle", "Disk")


def _scaled(target: Target, scale: float) -> Target:
    """Return a flat target enlarged by the factor `scale` about its centre."""
    return replace(target, u=scale * target.u, v=scale * target.v)


def _middle(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and half edges of the bounding box of a shape in the world, (3,) each, mm."""
    low, high = (np.array(corner, dtype=np.float64) for corner in (shape.bbox().min, shape.bbox().max))
    return 0.5 * (low + high), 0.5 * (high - low)


def _sphere(shape: Any, scale: float, half_axes: tuple[float, ...]) -> Ellipsoid:
    """Return a sphere, or an ellipsoid of given half axes, mm, along its own axes; both are enlarged by `scale`."""
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    centre, half = _middle(shape)
    # Columns of the matrix without their lengths
    frame = matrix[:3, :3].T / np.linalg.norm(matrix[:3, :3], axis=0)[:, None]
    lengths = np.array(half_axes) if half_axes else half
    return Ellipsoid(centre, scale * lengths[:, None] * frame)


def _around(shape: Any, scale: float) -> AnyTarget:
    """
    Return the target that covers a surface, enlarged by the factor `scale`.

    It is the outline of a sheet, see `_is_flat`, or a sphere itself. For any other surface it is an ellipsoid about the
    bounding box.
    """
    if _is_flat(shape):
        return _scaled(outline(shape), scale)
    if _kind(shape)[1] == "Sphere":
        return _sphere(shape, scale, ())
    centre, half = _middle(shape)
    # Flat boxes keep some thickness; √3 brings the corners onto the ellipsoid
    half = np.maximum(half, 1e-6 * half.max())
    return Ellipsoid(centre, scale * np.sqrt(3) * np.diag(half))


def _cone(shape: Any) -> TargetCone:
    """
    Return the cone of directions that a shape's `target` plugin with `about` defines.

    About "direction" its axis is the normal of the shape, else the axis leads to the middle of the shape. Raise
    `MistrayError` for a direction of a shape that is no sheet, see `_is_flat`.
    """
    bsdf = shape.bsdf()
    if bsdf.about == "direction" and not _is_flat(shape):
        own, kind = _kind(shape)
        raise MistrayError(
            f"target '{shape.id()}' is {own or kind}, which has no direction; use a disk, a rectangle, a flat frustum "
            "or an asphere, whose local z is the direction"
        )
    axis = outline(shape).normal if bsdf.about == "direction" else _middle(shape)[0]
    return TargetCone(bsdf.about, axis, float(np.radians(bsdf.cone_deg)), reverse=bsdf.reverse)


def _triangles(name: str, vertices: np.ndarray, faces: np.ndarray, scale: float) -> list[Target]:
    """
    Return the triangles of a mesh as targets, scaled about the centroid of its area, with shares by area.

    Raise `MistrayError` for too many triangles, or one without area.
    """
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
    # Scaled about the centroid of the whole mesh, so that triangles stay together
    starts = middle + scale * (corners[:, 0] - middle)
    return [
        Target("triangle", start, scale * a, scale * b, share=float(part))
        for start, a, b, part in zip(starts, u, v, area / area.sum(), strict=True)
    ]

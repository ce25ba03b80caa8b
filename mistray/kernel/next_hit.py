"""Next hit of a ray, and position of a hit on the detector."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable

GRAZING = 0.01  # smallest cosine by which the offset from a Mitsuba surface is divided


def next_hit(
    table: SurfaceTable,
    intersector: Intersector,
    o: mi.Vector3f,
    d: mi.Vector3f,
    last: mi.UInt32,
    active: mi.Bool,
    normal: mi.Vector3f | None = None,
) -> tuple[mi.Float, mi.UInt32, mi.Vector3f]:
    """Return the nearest hit of each ray: distance, mm, number of the surface, and normal if it is Mitsuba's."""
    # Analytic surfaces first: they bound the ray for Mitsuba's tracer
    t, s = intersector.nearest(o, d, last, active)
    if table.mitsuba_scene is None:
        return t, s, mi.Vector3f(0)
    if table.free_space is not None:
        # Rays that stay in the space without Mitsuba shapes skip their tracer
        active = active & ~table.free_space.holds(o, d, t)
    skip = mi.Float(0)
    if normal is not None:  # offset from a Mitsuba surface by a few roundings, along the ray so that it stays the same
        slant = dr.maximum(dr.abs(dr.dot(normal, d)), GRAZING)
        skip = dr.select(last >= len(table.pieces), table.mitsuba_epsilon / slant, 0)
    ray = mi.Ray3f(mi.Point3f(dr.fma(skip, d, o) + table.mitsuba_offset), d)
    ray.maxt = dr.select(dr.isfinite(t), t - skip, dr.largest(mi.Float))
    hit = table.mitsuba_scene.ray_intersect_preliminary(ray, coherent=False, active=active)
    nearer = active & hit.is_valid() & (hit.t + skip < t)
    si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, nearer)
    number = dr.gather(mi.UInt32, table.mitsuba_lookup, dr.reinterpret_array(mi.UInt32, si.shape), nearer)
    return dr.select(nearer, si.t + skip, t), dr.select(nearer, number, s), mi.Vector3f(si.n)


def film_coordinates(table: SurfaceTable, it: Any, s: mi.UInt32) -> tuple[mi.Float, mi.Float]:
    """Return the coordinates x and y of hits in the frame of the detector that they meet, mm."""
    x, y = it.local.x, it.local.y
    for detector, (middle, right, up) in table.detector_axes.items():
        if detector in table.detectors:
            here = mi.Bool(True) if len(table.detectors) == 1 else s == detector
            x = dr.select(here, dr.dot(it.p - middle, right), x)
            y = dr.select(here, dr.dot(it.p - middle, up), y)
    return x, y

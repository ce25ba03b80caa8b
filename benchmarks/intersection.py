"""The whole ray tree, against Mitsuba's own ray intersection (Embree) on the same lens as a mesh.

The mesh is the one that the plugins give to stock integrators, with twice as many rings. Its rays are segments of the
same tree, in the order of their start rays, long ready in memory; Embree only finds the hit, in float32. A segment
here, float32 too, includes the search for the next surface, Snell's law, R and T of both polarisations, the walk over
the tree, the film and the books of energy. Embree gets the faster of its two modes, for coherent rays and for others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from unittest.mock import patch

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import REPEATS, NotTheSameWorkError, Row, alternate, measured

import mistray
from mistray.execute.tracer import Run, prepare
from mistray.recorders.tallies import SEGMENTS
from mistray.settings import Settings

CASES = (("double_gauss", 1 << 18, 14.0), ("phone_camera", 1 << 14, 6.0))
OFFSET_MM = 1e-3  # along the ray: the facets lie up to their sag beside the surface that the ray leaves
RINGS = 65  # of a surface's mesh: those of stock integrators are so coarse that a tenth of the hits lie elsewhere
CLOSE_MM = 0.05  # a hit of the mesh this near to that of the tree is the same
SAME = 0.95  # least share of such hits


def tree_segments(run: Run, most: int) -> tuple[mi.Point3f, mi.Vector3f, np.ndarray]:
    """Segments of a run's own ray tree, of branches that end in the detector: origins, directions and lengths."""
    recorder = run.record(None, most)
    count = min(int(recorder.count[0]), recorder.capacity)
    lengths, lanes = np.array(recorder.length)[:count], np.array(recorder.lane)[:count]
    nodes = np.array(recorder.nodes).reshape(recorder.capacity, run.settings.max_events, -1)[:count]
    order = np.argsort(lanes, kind="stable")
    origins, directions, distances = [], [], []
    for depth in range(1, int(lengths.max())):
        here = order[lengths[order] > depth]
        start, end, along = nodes[here, depth - 1, :3], nodes[here, depth, :3], nodes[here, depth, 3:6]
        origins.append(start + OFFSET_MM * along)
        directions.append(along)
        distances.append(np.linalg.norm(end - start, axis=1) - OFFSET_MM)
    o, d = mi.Point3f(np.concatenate(origins).T), mi.Vector3f(np.concatenate(directions).T)
    dr.eval(o, d)
    return o, d, np.concatenate(distances)


def against_mesh(name: str, rays: int, bar: float, repeats: int) -> Row:
    """Segments per second of a trace without the path table over rays per second of the mesh."""
    mistray.ensure_variant()
    from mistray.plugins.shapes.revolution import Revolution  # once there is a variant

    with patch.object(Revolution, "mesh_points", RINGS):
        scene = mistray.load(name)
    settings = Settings(rays=rays)
    segments = 0.0

    def tree() -> None:
        nonlocal segments
        (run,) = prepare(scene, settings)
        segments = float(run.execute(False).sums.channels[SEGMENTS].sum())

    (sample,) = prepare(scene, settings)
    o, d, lengths = tree_segments(sample, 1 << 14)

    def mesh(coherent: bool) -> Callable[[], mi.PreliminaryIntersection3f]:
        def action() -> mi.PreliminaryIntersection3f:
            hit = scene.ray_intersect_preliminary(mi.Ray3f(o, d), coherent=coherent)
            dr.eval(hit.t, hit.prim_index)
            dr.sync_thread()
            return hit

        return action

    same = float(np.mean(np.abs(np.array(mesh(True)().t) - lengths) < CLOSE_MM))
    if not same >= SAME:
        raise NotTheSameWorkError(
            f"not the same work: {same:.0%} of the mesh's hits are those of the tree, {SAME:.0%} needed; no ratio"
        )
    ours, *others = alternate(tree, mesh(True), mesh(False), repeats=repeats)
    rate, other = segments / ours.seconds, dr.width(o) / min(timing.seconds for timing in others)
    library = "OptiX" if mi.variant().startswith("cuda") else "Embree"
    triangles = sum(shape.face_count() for shape in scene.shapes())
    return Row(
        name,
        f"ray tree of `{name}` (segments/s), Mitsuba {mi.__version__} `ray_intersect_preliminary` "
        f"({library}) of {dr.width(o)} segments on its mesh of {triangles / 1000:.0f} k triangles (rays/s)",
        f"{rate / 1e6:.1f} M/s, {ours.cores:.1f} cores",
        f"{other / 1e6:.1f} M/s, {min(others, key=lambda timing: timing.seconds).cores:.1f} cores",
        rate / other,
        bar,
        equal=f"{same:.1%} of the hits within {CLOSE_MM:g} mm",
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `embree`."""
    for name, rays, bar in CASES:
        make = partial(against_mesh, name, rays >> 5 if quick else rays, bar, 1 if quick else REPEATS)
        yield measured(name, f"ray tree of `{name}`, Mitsuba's ray intersection of its mesh", make)

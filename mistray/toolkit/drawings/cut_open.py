"""Surfaces of a scene as triangle meshes, cut open by a plane parallel to the z axis.

Vertices on `asphere`, `frustum` and Mitsuba's rectangle, disk, sphere and cylinder lie on the formula of the surface,
not on chords of a tessellation. Those on other shapes lie on the triangles of the shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray._mitsuba_compat import import_mitsuba, mesh_arrays
from mistray.errors import MistrayError
from mistray.surfaces.surfaces import solid_shapes

Points = npt.NDArray[Any]
Faces = npt.NDArray[np.int64]
Onto = Callable[[Points], Points]

TURN_PER_RING = math.radians(4.0)  # of the normal along the generatrix, between two rings of the mesh
FEWEST_RINGS, MOST_RINGS = 7, 25  # of a curved surface
GRID = 24  # cells along each side of a curved rectangle
MOST_STEPS, FEWEST_STEPS = 36, 12  # around half a turn
VERTICES = 14_000  # of all surfaces of revolution together, so that a page stays small


@dataclass(frozen=True)
class CutPlane:
    """
    Plane that opens a scene and removes the half beyond it.

    Parameters
    ----------
    azimuth_deg : float
        Direction of the removed half, degrees about z from x: 180 removes x < 0, 90 removes y > 0.
    offset_mm : float
        Distance of the plane from the z axis along that direction, mm.
    """

    azimuth_deg: float = 180.0
    offset_mm: float = 0.0

    @property
    def normal(self) -> npt.NDArray[np.float64]:
        """Unit vector, (3,), towards the half that is removed."""
        turn = math.radians(self.azimuth_deg)
        normal = np.array([math.cos(turn), math.sin(turn), 0.0])
        return np.round(normal) if self.azimuth_deg % 90 == 0 else normal

    def height(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the signed distance of points (…, 3) from the plane, mm; positive in the removed half."""
        return np.asarray(points, dtype=np.float64) @ self.normal - self.offset_mm


@dataclass(frozen=True)
class OpenSurface:
    """
    Part of one surface that remains after the cut.

    Attributes
    ----------
    name, part : str
        Shape id and the object that it belongs to.
    role : {"glass", "structure", "mirror", "detector"}
        Role of the surface for the light.
    materials : str
        Materials in front and behind, for glass; else empty.
    vertices : (n, 3) float
        Vertices, mm; empty if nothing is left.
    faces : (m, 3) int
        Vertex indices of each triangle.
    lines : list of (k, 3) float
        Rim curves, and the curves along which the plane cuts the surface, mm.
    """

    name: str
    part: str
    role: str
    materials: str
    vertices: Points
    faces: Faces
    lines: list[Points]


def surface_names(scene: Any) -> list[tuple[str, Any]]:
    """Return pairs of id and shape of all shapes that light can hit, without those that are only targets of rays."""
    return [(shape.id() or f"shape_{number}", shape) for number, shape in enumerate(solid_shapes(scene), start=1)]


def role_of(shape: Any) -> str:
    """
    Return the role of a shape for the light: "detector", "mirror", "structure" (opaque) or "glass" (refracts).

    A shape with a BSDF of Mitsuba's own, which states no role, is a structure.
    """
    if shape.is_sensor():
        return "detector"
    bsdf = shape.bsdf()
    if not hasattr(bsdf, "mirror"):
        return "structure"
    if bsdf.mirror:
        return "mirror"
    return "structure" if bsdf.opaque else "glass"


def open_surfaces(scene: Any, cut: CutPlane | None) -> list[OpenSurface]:
    """
    Return all surfaces of a scene as triangle meshes, cut open by a plane.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    cut : CutPlane or None
        Plane of the cut; None leaves surfaces whole.

    Raises
    ------
    MistrayError
        If a shape has neither a formula nor triangles.
    """
    named = surface_names(scene)
    rings = {name: _rings(shape) for name, shape in named if _of_revolution(shape)}
    whole = sum(rings.values()) or 1
    steps = int(np.clip(VERTICES / whole, FEWEST_STEPS, MOST_STEPS)) * (2 if cut is None else 1)
    surfaces = []
    for name, shape in named:
        if _of_revolution(shape):
            mesh = turned(shape.profile(rings[name]), np.asarray(shape.matrix), steps, cut, _onto(shape))
        elif getattr(shape, "rectangular", False):
            mesh = _rectangular(shape, cut)
        else:
            mesh = _stock(name, shape, steps, cut)
        role, bsdf = role_of(shape), shape.bsdf()
        materials = f"{bsdf.front} | {bsdf.back}" if role == "glass" else ""
        surfaces.append(OpenSurface(name, getattr(shape, "part", "") or name, role, materials, *mesh))
    return surfaces


def triangles(shape: Any, name: str) -> tuple[Points, Faces]:
    """
    Return the triangle mesh of a whole shape: vertices (n, 3) in the world, mm, and their indices by face (m, 3).

    A shape without formula or triangles raises `MistrayError`, in which `name` is its name.
    """
    if hasattr(shape, "profile"):
        vertices, faces = mesh_arrays(shape)
        return vertices, faces.astype(np.int64)
    vertices, numbers, _ = _stock(name, shape, 2 * MOST_STEPS, None)
    return vertices, numbers


def turned(
    profile: npt.ArrayLike,
    matrix: npt.NDArray[np.float64],
    steps: int,
    cut: CutPlane | None,
    onto: Onto | None = None,
) -> tuple[Points, Faces, list[Points]]:
    """
    Return the mesh of a generatrix turned about the local z axis, without the half that a plane removes.

    Every ring of the mesh is the arc that is left of a circle. Its points lie on the circle and its ends on the plane,
    whatever the axis.

    Parameters
    ----------
    profile : (n, 2) float
        r and z along the generatrix, mm.
    matrix : (4, 4) float
        Rigid transform to the world, mm.
    steps : int
        Steps of the mesh along each arc.
    cut : CutPlane or None
        Plane of the cut; None: nothing is removed.
    onto : callable, optional
        Function that moves points (n, 2) near a curved generatrix onto it; none for one of straight lines. Circles that
        only touch the plane are added to the rings, and lie on it.

    Returns
    -------
    vertices : (k, 3) float64
        Vertices that faces use, mm.
    faces : (m, 3) int
        Vertex indices of each triangle.
    lines : list of (k, 3) float64
        First and last ring, and the two ends of all arcs where they lie on the plane.
    """
    profile = np.asarray(profile, dtype=np.float64)
    profile = profile if cut is None else _with_touching(profile, matrix, cut, onto)
    rotation, origin = matrix[:3, :3], matrix[:3, 3]
    r, z = profile[:, 0], profile[:, 1]
    centres = origin + z[:, None] * rotation[:, 2]
    near = 1e-11 * (1.0 + np.abs(centres).max() + r.max())
    if cut is None:
        middle, half, touching = 0.0, np.full(len(r), math.pi), np.zeros(len(r), dtype=bool)
    else:
        along = cut.normal @ rotation  # the plane's normal in the local frame
        reach, level = r * math.hypot(along[0], along[1]), -cut.height(centres)
        middle = math.atan2(along[1], along[0]) + math.pi
        cosine = np.clip(np.divide(level, reach, out=np.sign(level), where=reach > near), -1.0, 1.0)
        half = math.pi - np.arccos(cosine)
        touching = np.abs(reach - np.abs(level)) <= near
        half[touching & (reach <= near)] = math.pi  # a point on the plane, as every point of its circle
    turn = half[:, None] * np.linspace(-1.0, 1.0, steps + 1)
    if cut is not None and onto is None and np.ptp(z) * abs(along[2]) > near:  # a straight line, oblique to the plane
        # Triangles between arcs of different lengths would lie across a cone or cylinder
        turn = np.clip(np.linspace(-math.pi, math.pi, steps + 1), -half[:, None], half[:, None])
    turn += middle
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * r[:, None, None]
    grid = centres[:, None] + circle @ rotation[:, :2].T
    vertices, faces = grid.reshape(-1, 3), _strips(len(r), steps)
    gone, single = (half <= 0) & ~touching, (half <= 0) | (r <= 0)
    ring = faces // (steps + 1)
    flat = ((ring == np.roll(ring, 1, axis=1)) & single[ring]).any(axis=1)  # two corners in one point
    left = ~flat & ~gone[ring].any(axis=1)
    lines = [grid[k] for k in (0, -1) if half[k] > 0 and r[k] > 0]
    ends = touching | ((half > 0) & (half < math.pi))
    if ends.sum() > 1:
        lines += [grid[ends, k] for k in (0, -1)]
    return *_used(vertices, faces[left]), lines


def clip(vertices: npt.ArrayLike, faces: npt.ArrayLike, cut: CutPlane | None) -> tuple[Points, Faces, list[Points]]:
    """
    Return a triangle mesh without the half that a plane removes.

    Parameters
    ----------
    vertices : (n, 3) float
        Vertices, mm; the values keep their data type.
    faces : (m, 3) int
        Vertex indices of each triangle.
    cut : CutPlane or None
        Plane of the cut; None: nothing is removed.

    Returns
    -------
    vertices : (k, 3) float
        Vertices, mm.
    faces : (l, 3) int
        Vertex indices of each triangle.
    lines : list of (2, 3) float
        One segment for each triangle that is cut, mm.
    """
    vertices, faces = np.asarray(vertices), np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if cut is None:
        return vertices, faces, []
    height = cut.height(vertices)
    kept = height <= 0
    count = kept[faces].sum(axis=1)
    parts, segments, new = [faces[count == 3]], [], [vertices]
    for inside in (1, 2):
        crossed = faces[count == inside]
        if not len(crossed):
            continue
        # The corner that is alone on its side comes first; the winding stays
        alone = np.argmax(kept[crossed] == (inside == 1), axis=1)
        a, b, c = np.take_along_axis(crossed, (alone[:, None] + np.arange(3)) % 3, axis=1).T
        first = sum(map(len, new))
        for other in (b, c):
            share = (height[a] / (height[a] - height[other]))[:, None]
            new.append((vertices[a] + share * (vertices[other] - vertices[a])).astype(vertices.dtype))
        ab = first + np.arange(len(a))
        ac = ab + len(a)
        if inside == 1:
            parts.append(np.column_stack([a, ab, ac]))
        else:
            parts += [np.column_stack([ab, b, c]), np.column_stack([ab, c, ac])]
        segments.append(np.column_stack([ab, ac]))
    points = np.concatenate(new)
    lines = [points[segment] for segment in np.concatenate(segments)] if segments else []
    return *_used(points, np.concatenate(parts)), lines


def _of_revolution(shape: Any) -> bool:
    return hasattr(shape, "profile") and not getattr(shape, "rectangular", False)


def _onto(shape: Any) -> Onto | None:
    """Return the function of `turned` for a shape with a profile; None for a straight profile."""
    if not hasattr(shape, "sag"):
        return None
    return lambda points: np.column_stack([points[:, 0], shape.sag(points[:, 0])])


def _with_touching(profile: Points, matrix: Points, cut: CutPlane, onto: Onto | None) -> Points:
    """
    Return the points (r, z) of a generatrix, mm, and more where the plane begins or ceases to cut the circles.

    A straight line gets further points between these, because the cut of its surface is a curve. The arguments are
    those of `turned`.
    """
    along = cut.normal @ matrix[:3, :3]
    across, middle = math.hypot(along[0], along[1]), float(cut.height(matrix[:3, 3]))

    def ends(points: Points) -> Points:
        """Return the greatest and the least height of circles over the plane, (2, n), mm."""
        height, reach = middle + along[2] * points[:, 1], across * points[:, 0]
        return np.stack([height + reach, height - reach])

    height = ends(profile)
    slanted = onto is None and len(profile) == 2 and profile[0, 1] != profile[1, 1]
    if slanted and across and height[1].min() < 0 < height[0].max():
        roots = np.divide(height[:, 0], height[:, 0] - height[:, 1], out=np.zeros(2), where=np.ptp(height, axis=1) > 0)
        first, last = np.clip(np.sort(roots), 0.0, 1.0)
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, MOST_RINGS))  # about even in angle
        way = np.unique([0.0, *(first + (last - first) * share), 1.0])
        return np.asarray(profile[0] + way[:, None] * (profile[1] - profile[0]))
    height[np.abs(height) <= 1e-11 * (1.0 + np.abs(profile).max() + abs(middle))] = 0.0
    places: list[float] = []
    added: list[Points] = []
    for side, k in np.argwhere(height[:, :-1] * height[:, 1:] < 0):
        low, high = 0.0, 1.0
        for _ in range(60):  # bisection
            place = 0.5 * (low + high)
            point = profile[k : k + 1] + place * (profile[k + 1] - profile[k])
            point = point if onto is None else onto(point)
            low, high = (place, high) if ends(point)[side, 0] * height[side, k] > 0 else (low, place)
        places.append(k + place)
        added.append(point[0])
    if not places:
        return profile
    order = np.argsort(places)
    return np.insert(profile, np.array(places)[order].astype(int) + 1, np.array(added)[order], axis=0)


def _rings(shape: Any) -> int:
    """Return the number of mesh rings that resolves the curvature of a profile; two for a straight profile."""
    steps = np.diff(shape.profile(65), axis=0)
    turning = float(np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))).sum())
    return 2 if turning < 1e-9 else int(np.clip(1 + math.ceil(turning / TURN_PER_RING), FEWEST_RINGS, MOST_RINGS))


def _rectangular(shape: Any, cut: CutPlane | None) -> tuple[Points, Faces, list[Points]]:
    """
    Return the mesh of a rectangular `asphere`, cut open: vertices, faces, rims, as `clip` does.

    Where a curved one is cut, the new points are moved onto its sag too.
    """
    half = np.array([shape.values["half_width"], shape.values["half_height"]])
    cells = 1 if shape.plane else GRID
    u, v = np.meshgrid(*(np.linspace(-1.0, 1.0, cells + 1),) * 2, indexing="ij")
    matrix = np.asarray(shape.matrix)

    def lifted(xy: Points) -> Points:
        local = np.column_stack([xy, shape.sag(np.hypot(xy[:, 0], xy[:, 1]))])
        return np.asarray(local @ matrix[:3, :3].T + matrix[:3, 3])

    vertices, faces, lines = clip(
        lifted(np.column_stack([u.ravel(), v.ravel()]) * half), _strips(cells + 1, cells), cut
    )
    turn = np.linspace(-1.0, 1.0, cells + 1)
    ones = np.ones(cells + 1)
    sides = [lifted(np.column_stack(s) * half) for s in ((turn, -ones), (turn, ones), (-ones, turn), (ones, turn))]
    rims = sides if cut is None else [side[kept] for side in sides if (kept := cut.height(side) <= 0).sum() > 1]
    if shape.plane:
        return vertices, faces, lines + rims

    def onto(points: Points) -> Points:
        return lifted(((points - matrix[:3, 3]) @ matrix[:3, :3])[:, :2])

    return onto(vertices), faces, [onto(line) for line in lines] + rims


def _stock(name: str, shape: Any, steps: int, cut: CutPlane | None) -> tuple[Points, Faces, list[Points]]:
    """
    Return the mesh of a shape of Mitsuba, cut open, as `clip` does.

    It follows the shape's formula if `primitive` has one. A shape with neither formula nor triangles raises
    `MistrayError`.
    """
    kind, rigid, size = primitive(shape)
    if not kind:
        if not shape.is_mesh():
            kind = str(shape).partition("[")[0].strip()
            raise MistrayError(
                f"shape '{name}' is {kind}, which has no triangles to draw; use a mesh, an 'asphere' or a 'frustum'"
            )
        return clip(*mesh_arrays(shape), cut)
    if kind == "Rectangle":
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]) * size[:2]
        corners = np.column_stack([corners, np.zeros(5)]) @ rigid[:3, :3].T + rigid[:3, 3]
        vertices, faces, lines = clip(corners[:4], [[0, 1, 2], [0, 2, 3]], cut)
        return vertices, faces, [*lines, *([corners] if cut is None else [])]
    turn = np.linspace(0.0, math.pi, MOST_RINGS)
    profile = {
        "Disk": [[0.0, 0.0], [size[0], 0.0]],
        "Cylinder": [[size[0], 0.0], [size[0], size[2]]],
        "Sphere": size[0] * np.column_stack([np.sin(turn), -np.cos(turn)]),
    }[kind]

    def on_sphere(points: Points) -> Points:
        return np.asarray(size[0] * points / np.linalg.norm(points, axis=1, keepdims=True))

    return turned(profile, rigid, steps, cut, on_sphere if kind == "Sphere" else None)


def primitive(shape: Any) -> tuple[str, Points, Points]:
    """
    Return the kind, frame and size of a Mitsuba shape that has an analytic formula.

    Returns
    -------
    kind : str
        "Rectangle", "Disk", "Sphere" or "Cylinder"; empty for other shapes, whose transform is the identity and whose
        scale is 1.
    rigid : (4, 4) float64
        Transform from its frame to the world, without scale, mm.
    size : (3,) float64
        Scale along the axes of the frame, mm.
    """
    kind = str(shape).partition("[")[0].strip()
    if kind not in ("Rectangle", "Disk", "Sphere", "Cylinder"):
        return "", np.eye(4), np.ones(3)
    rigid = np.array(import_mitsuba().traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    size = np.linalg.norm(rigid[:3, :3], axis=0)
    rigid[:3, :3] /= size
    return kind, rigid, size


def _strips(rows: int, steps: int) -> Faces:
    """Return triangles, (m, 3) vertex indices, of a grid of `rows` rows of vertices with `steps` cells in each."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(steps), indexing="ij")
    a = (i * (steps + 1) + j).ravel()
    b, c, d = a + 1, a + steps + 1, a + steps + 2
    return np.concatenate([np.column_stack([a, c, d]), np.column_stack([a, d, b])])


def _used(vertices: Points, faces: Faces) -> tuple[Points, Faces]:
    """Return the vertices that faces use, and the faces renumbered to these vertices."""
    numbers, renumbered = np.unique(faces, return_inverse=True)
    return vertices[numbers], renumbered.reshape(-1, 3)


def triangulate(outline: npt.ArrayLike) -> Faces:
    """
    Return the triangles of a simple polygon, by cutting off corners whose triangles contain no other corner.

    Parameters
    ----------
    outline : (n, 2) float
        Corners in either sense of rotation; the last is joined to the first.

    Returns
    -------
    (m, 3) int
        Corner indices of each triangle; together they cover the polygon.

    Notes
    -----
    G. H. Meisters, "Polygons have ears", Am. Math. Mon. 82 (1975) 648.
    """
    points = np.asarray(outline, dtype=np.float64)
    x, y = points.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0:
        return (len(points) - 1 - triangulate(points[::-1]))[:, ::-1]
    apart = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-12 * np.ptp(points)
    ring = np.flatnonzero(apart).tolist()
    faces = []
    while len(ring) > 3:
        corner = next((k for k in range(len(ring)) if _is_ear(points, ring, k)), None)
        if corner is None:  # what is left has no area beyond rounding
            break
        faces.append([ring[corner - 1], ring[corner], ring[(corner + 1) % len(ring)]])
        del ring[corner]
        ring = [*ring[corner:], *ring[:corner]]  # go on where the ear was, or slivers fan out from one corner
    if len(ring) == 3:
        faces.append(ring)
    return np.array(faces, dtype=np.int64).reshape(-1, 3)


def _is_ear(points: Points, ring: Sequence[int], k: int) -> bool:
    """
    True if corner `k` of a polygon and its neighbours form a convex triangle that holds no other corner.

    It is also True if the three lie on one line.
    """
    a, b, c = (points[ring[i]] for i in (k - 1, k, (k + 1) % len(ring)))
    size = _side(a, b, c)
    if size <= 0:
        return bool(size == 0)
    others = points[[number for number in ring if number not in (ring[k - 1], ring[k], ring[(k + 1) % len(ring)])]]
    bound = 1e-12 * size
    return not np.any((_side(a, b, others) > bound) & (_side(b, c, others) > bound) & (_side(c, a, others) > bound))


def _side(a: Points, b: Points, c: Points) -> Any:
    """Return twice the signed area of the triangle a, b, c, positive if counter-clockwise; a, b or c may be (n, 2)."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])

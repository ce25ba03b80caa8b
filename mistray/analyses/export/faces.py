"""Faces of STEP files: profiles revolved about an axis, flat polygons, and sags within outlines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from mistray.analyses.export.profiles import Profile
from mistray.errors import MistrayError
from mistray.io.cad.write_step import StepFile
from mistray.physics.geometry.outline import Outline, OutlineFigure

Array = npt.NDArray[np.float64]
Height = Callable[[Array, Array], Array]

DEGREE = 5
FEWEST, MOST = 8, 256  # points each way that a B-spline goes through
BETWEEN = 3  # points between two of these at which it is compared
ROUNDING = 1e-10  # slope of a profile, below which it is flat or upright
FLAT = 1e-12  # of its size, by which a sag may depart from a plane
TOUCHING = 1e-6  # of its size: borders of an outline that are nearer meet


class Turner:
    """
    Writer of faces of revolution about one axis into a STEP file.

    Parameters
    ----------
    file : StepFile
        File to which faces are added.
    matrix : (4, 4) float64
        Rigid transform from the frame of the profiles to the world, mm.
    """

    def __init__(self, file: StepFile, matrix: Array) -> None:
        self.file = file
        self.origin, self.x, self.axis = matrix[:3, 3], matrix[:3, 0], matrix[:3, 2]

    def place(self, point: Array) -> Array:
        """Return a profile point (r, z) in world coordinates, (3,), mm, in the half plane where revolution starts."""
        return np.asarray(self.origin + point[0] * self.x + point[1] * self.axis)

    def frame(self, z: float, sign: float = 1.0) -> int:
        """Add a frame on the axis at z, mm, with its z axis along `sign` times the axis; return its entity number."""
        return self.file.placement(self.origin + z * self.axis, sign * self.axis, self.x)

    def faces(self, chain: Sequence[Profile], ring: bool = False) -> list[int]:
        """
        Add the faces of consecutive profiles, and return their entity numbers.

        Parameters
        ----------
        chain : sequence of Profile
            Profiles, with the body to the left of each for r to the right and z up; normals point away from it.
        ring : bool
            Whether the last one ends at the start of the first.
        """
        nodes = [profile.start for profile in chain] + ([] if ring else [chain[-1].end])
        corners = [self.file.vertex(self.place(node)) for node in nodes]
        circles = [
            self.file.edge(corner, corner, self.file.circle(self.frame(node[1]), float(node[0]))) if node[0] > 0 else 0
            for node, corner in zip(nodes, corners, strict=True)
        ]
        faces = []
        for k, profile in enumerate(chain):
            other = (k + 1) % len(nodes)
            faces.append(self._face(profile, (circles[k], circles[other]), (corners[k], corners[other])))
        return faces

    def _face(self, profile: Profile, circles: tuple[int, int], corners: tuple[int, int]) -> int:
        file, (r0, z0), (r1, z1) = self.file, profile.start, profile.end
        if profile.kind == "line" and abs(z0 - z1) <= ROUNDING * abs(r0 - r1):
            surface = file.plane(self.frame(float(z0), float(np.sign(r0 - r1))))
            loops = [file.loop([(circle, k == 0)]) for k, circle in enumerate(circles) if circle]
            return file.face(profile.name, surface, True, loops[::-1] if r1 > r0 else loops)
        surface, curve, along = self._surface(profile)
        seam = file.edge(corners[0], corners[1], curve)
        loop = [(circles[0], True), (seam, True), (circles[1], False), (seam, False)]
        return file.face(profile.name, surface, along, [file.loop([edge for edge in loop if edge[0]])])

    def _surface(self, profile: Profile) -> tuple[int, int, bool]:
        """
        Add the surface and the curve of a profile to the file.

        Return their entity numbers, and whether the surface's normal points out of the body to the left of the profile.
        """
        file, (r0, z0), (r1, z1) = self.file, profile.start, profile.end
        if profile.kind == "line":
            curve = file.line(self.place(profile.start), self.place(profile.end))
            upwards = bool(z1 > z0)
            if abs(r0 - r1) <= ROUNDING * abs(z0 - z1):
                return file.cylinder(self.frame(float(z0)), float(r0)), curve, upwards
            wider = float(np.sign((r1 - r0) * (z1 - z0)))
            low, z = (r0, z0) if r0 < r1 else (r1, z1)
            angle = float(np.arctan2(abs(r1 - r0), abs(z1 - z0)))
            return file.cone(self.frame(float(z), wider), float(low), angle), curve, upwards
        if profile.kind == "circle":
            centre = profile.centre
            angles = [np.arctan2(p[1] - centre, p[0]) for p in (profile.start, profile.end)]
            turns = float(np.sign(angles[1] - angles[0]))
            # The circle in the half plane of the seams, turning the way that the profile goes
            across = -turns * np.cross(self.axis, self.x)
            at = file.placement(self.origin + centre * self.axis, across, self.x)
            curve = file.circle(at, profile.radius)
            # Away from the body is to the right of the profile, and from the centre where the angle grows
            return file.sphere(self.frame(centre), profile.radius), curve, turns > 0
        assert profile.knots is not None
        poles = np.array([self.place(pole) for pole in profile.poles])
        curve = file.spline(poles, profile.knots, profile.degree, profile.weights)
        return file.revolution(curve, self.origin, self.axis), curve, True


def polygon_normal(corners: Array) -> Array:
    """Return the unit normal of a flat polygon (n, 3), about which its corners run counter-clockwise."""
    area = np.cross(corners - corners[0], np.roll(corners, -1, axis=0) - corners[0]).sum(axis=0)
    return np.asarray(area / np.linalg.norm(area))


def polygon_plane(file: StepFile, corners: Array) -> int:
    """Add the plane of a polygon with corners, (n, 3), mm, to the file; return its entity number."""
    along = corners[1] - corners[0]
    return file.plane(file.placement(corners[0], polygon_normal(corners), along / np.linalg.norm(along)))


def polyhedron(polygons: Sequence[Array]) -> list[list[int]] | None:
    """
    Join flat polygons into the closed surface of a body, with shared corners and outward orientation.

    Parameters
    ----------
    polygons : sequence of (n, 3) float64
        Consecutive corners, either way round; mm.

    Returns
    -------
    list of list of int, or None
        Corner indices of each polygon, counted over all polygons; equal corners have the index of the first. The order
        is counter-clockwise from outside. None unless each side belongs to just two polygons and all are connected.
    """
    points = np.concatenate(polygons)
    near = 1e-6 * float(np.ptp(points, axis=0).max())
    first = [int(np.flatnonzero(np.linalg.norm(points - p, axis=1) <= near)[0]) for p in points]
    starts = np.cumsum([0, *map(len, polygons)])
    rings = [first[a:b] for a, b in pairwise(starts.tolist())]
    sides: dict[tuple[int, int], list[int]] = {}
    for number, ring in enumerate(rings):
        for a, b in zip(ring, [*ring[1:], ring[0]], strict=True):
            sides.setdefault((min(a, b), max(a, b)), []).append(number)
    if any(len(owners) != 2 for owners in sides.values()):
        return None
    done, waiting = {0}, [0]
    while waiting:  # neighbours go along a shared side in opposite directions
        here = waiting.pop()
        ring = rings[here]
        directed = set(zip(ring, [*ring[1:], ring[0]], strict=True))
        for a, b in directed:
            other = next(k for k in sides[min(a, b), max(a, b)] if k != here)
            if other in done:
                continue
            theirs = rings[other]
            if (a, b) in zip(theirs, [*theirs[1:], theirs[0]], strict=True):
                rings[other] = theirs[::-1]
            done.add(other)
            waiting.append(other)
    if len(done) < len(rings):
        return None
    middle = points.mean(axis=0)
    volume = sum(
        float(np.cross(points[a] - middle, points[b] - middle) @ (points[ring[0]] - middle))
        for ring in rings
        for a, b in pairwise(ring[1:])
    )
    return rings if volume > 0 else [ring[::-1] for ring in rings]


def polyhedron_faces(
    file: StepFile, polygons: Sequence[Array], names: Sequence[str], rings: list[list[int]]
) -> list[int]:
    """Add the faces of a body, with shared edges, from the rings of `polyhedron`; return their entity numbers."""
    points = np.concatenate(polygons)
    vertices: dict[int, int] = {}
    edges: dict[tuple[int, int], int] = {}
    faces = []
    for name, ring in zip(names, rings, strict=True):
        loop = []
        for a, b in zip(ring, [*ring[1:], ring[0]], strict=True):
            for corner in (a, b):
                if corner not in vertices:
                    vertices[corner] = file.vertex(points[corner])
            if (b, a) in edges:
                loop.append((edges[b, a], False))
                continue
            edges[a, b] = file.edge(vertices[a], vertices[b], file.line(points[a], points[b]))
            loop.append((edges[a, b], True))
        faces.append(file.face(name, polygon_plane(file, points[ring]), True, [file.loop(loop)]))
    return faces


# ---- sags within outlines


class Patch:
    """
    Sag surface within an outline, as one face of a STEP file.

    Parameters
    ----------
    name : str
        Id of the shape.
    height : callable
        Sag, mm, at points x, y of the frame, mm.
    figures : tuple of OutlineFigure
        The border, then holes in it that neither meet it nor each other, see `loops_of`.
    matrix : (4, 4) float64
        Rigid transform from the frame of the patch to the world, mm.
    tolerance : float
        Largest deviation of a B-spline from the sag, mm.
    """

    def __init__(
        self, name: str, height: Height, figures: tuple[OutlineFigure, ...], matrix: Array, tolerance: float
    ) -> None:
        self.name, self.height, self.figures, self.matrix, self.tolerance = name, height, figures, matrix, tolerance
        self.error_mm = 0.0
        # With the border, since a narrow patch has few points of a grid, which may lie in a plane
        points = np.concatenate([np.column_stack(Outline(figures).sample(17)), *map(_border_points, figures)])
        points = points[np.isfinite(height(*points.T))]
        (x, y), z = points.T, height(*points.T)
        terms = np.column_stack([np.ones(len(x)), x, y])
        self._plane = np.linalg.lstsq(terms, z, rcond=None)[0]
        size = float(max(np.ptp(x), np.ptp(y)))
        self.flat = bool(np.abs(z - terms @ self._plane).max() <= FLAT * size)

    def world(self, local: Array) -> Array:
        """Transform points (…, 3) of the frame to the world, mm."""
        return np.asarray(local @ self.matrix[:3, :3].T + self.matrix[:3, 3])

    @property
    def polygon(self) -> Array | None:
        """Corners in world coordinates, (n, 3), mm, if the patch is a flat polygon without holes; else None."""
        if not self.flat or len(self.figures) > 1 or self.figures[0].kind not in ("polygon", "rectangle"):
            return None
        return self.world(self._lift(corners_of(self.figures[0])))

    def _lift(self, xy: Array) -> Array:
        x, y = xy.T
        z = self._plane @ [np.ones(len(x)), x, y] if self.flat else self.height(x, y)
        return np.column_stack([x, y, z])

    def face(self, file: StepFile) -> int:
        """
        Add the patch as a face with its normal on the side of +z of its frame, and return its entity number.

        Raises
        ------
        MistrayError
            If no B-spline of reasonable size meets the tolerance, or the sag ends within the box around the outline.
        """
        if self.flat:
            corner, across = self.world(self._lift(np.array([[0.0, 0.0], [1.0, 0.0]])))
            normal = self.matrix[:3, :3] @ [-self._plane[1], -self._plane[2], 1.0]
            x = across - corner
            surface = file.plane(file.placement(corner, normal / np.linalg.norm(normal), x / np.linalg.norm(x)))
        else:
            surface = self._spline(file)
        loops = [self._loop(file, figure, number == 0) for number, figure in enumerate(self.figures)]
        return file.face(self.name, surface, True, loops)

    def _spline(self, file: StepFile) -> int:
        x0, x1, y0, y1 = Outline(self.figures).bounds()

        def grid(count: int) -> Array:
            x, y = np.meshgrid(np.linspace(x0, x1, count), np.linspace(y0, y1, count), indexing="ij")
            z = self.height(x.ravel(), y.ravel()).reshape(x.shape)
            return np.stack([x, y, z], axis=-1)

        count = FEWEST
        while count <= MOST:
            known = grid(count)
            if not np.isfinite(known).all():
                raise MistrayError(f"shape '{self.name}': its sag ends within the box around its outline")
            u = np.linspace(0.0, 1.0, count)
            across = make_interp_spline(u, known, DEGREE)
            along = make_interp_spline(u, across.c.swapaxes(0, 1), DEGREE)  # (y, x, 3)
            fine = BETWEEN * (count - 1) + 1
            v = np.linspace(0.0, 1.0, fine)
            found = BSpline(across.t, along(v).swapaxes(0, 1), DEGREE)(v)
            error = float(np.abs(found - grid(fine)).max())
            if error <= self.tolerance:
                self.error_mm = max(self.error_mm, error)
                poles = self.world(along.c.swapaxes(0, 1))
                return file.spline_surface(poles, (across.t, along.t), (DEGREE, DEGREE))
            count *= 2
        raise MistrayError(
            f"shape '{self.name}': a B-spline through {MOST}² points is {error:.2g} mm off its sag, more than "
            f"{self.tolerance:.2g} mm; give a larger freeform_tolerance_mm"
        )

    def _loop(self, file: StepFile, figure: OutlineFigure, outer: bool) -> int:
        """
        Add the border of a figure to the file, and return its entity number.

        It runs counter-clockwise about the normal if `outer`, and clockwise for a hole.
        """
        pieces: list[Callable[[Array], Array]] = []
        if figure.kind in ("circle", "ellipse"):
            pieces.append(partial(round_border, figure))
        else:
            corners = corners_of(figure)
            pieces += [partial(_side, a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        starts = [file.vertex(self.world(self._lift(piece(np.zeros(1))))[0]) for piece in pieces]
        edges = []
        for k, piece in enumerate(pieces):
            curve = self._curve(file, piece, figure.kind)
            edges.append((file.edge(starts[k], starts[(k + 1) % len(starts)], curve), outer))
        return file.loop(edges if outer else edges[::-1])

    def _curve(self, file: StepFile, piece: Callable[[Array], Array], kind: str) -> int:
        ends = self.world(self._lift(piece(np.array([0.0, 1.0]))))
        if self.flat and kind in ("polygon", "rectangle"):
            return file.line(ends[0], ends[1])
        count = 2 * FEWEST
        while True:
            u = np.linspace(0.0, 1.0, count)
            known = self._lift(piece(u))
            spline = make_interp_spline(u, known, DEGREE)
            fine = np.linspace(0.0, 1.0, BETWEEN * (count - 1) + 1)
            error = float(np.abs(spline(fine) - self._lift(piece(fine))).max())
            if error <= self.tolerance:
                self.error_mm = max(self.error_mm, error)
                poles = spline.c
                poles[0], poles[-1] = known[0], known[-1]
                return file.spline(self.world(poles), spline.t, DEGREE)
            if count > MOST**2:
                raise MistrayError(
                    f"shape '{self.name}': a B-spline is {error:.2g} mm off its border, more than {self.tolerance:.2g} "
                    "mm; give a larger freeform_tolerance_mm"
                )
            count *= 2


def _side(a: Array, b: Array, u: Array) -> Array:
    return np.asarray(a + u[:, None] * (b - a))


def corners_of(figure: OutlineFigure) -> Array:
    """Return the corners, (n, 2), mm, of a polygon or rectangle in the frame of its outline, counter-clockwise."""
    corners = figure.corners
    x, y = corners.T
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0:
        corners = corners[::-1]
    turn = np.radians(figure.angle_deg)
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(corners @ np.array([[c, s], [-s, c]]) + [figure.x, figure.y])


def round_border(figure: OutlineFigure, u: Array) -> Array:
    """Return points, (n, 2), mm, on the border of a circle or ellipse, for u, (n,), 0 … 1 counter-clockwise."""
    a, b = figure.sizes if len(figure.sizes) == 2 else 2 * figure.sizes
    turn, angle = np.radians(figure.angle_deg), 2 * np.pi * u
    p, q = a * np.cos(angle), b * np.sin(angle)
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([figure.x + c * p - s * q, figure.y + s * p + c * q])


def loops_of(outline: Outline) -> tuple[OutlineFigure, ...] | None:
    """
    Return the figures of an outline if they are a border and separate holes within it, else None.

    Only the first figure may be added, and all others must be cut away.
    """
    first, *more = outline.figures
    if first.sign != "+" or any(figure.sign != "-" for figure in more):
        return None
    borders = [_border_points(figure).T for figure in outline.figures]
    near = TOUCHING * first.reach
    for k, hole in enumerate(more, start=1):
        x, y = borders[k]
        inside = Outline((first,)).touches(x, y, -near)
        own = Outline((_added(hole),))
        apart = [not own.touches(x, y, near).any() for x, y in borders[:k] + borders[k + 1 :]]
        if not inside.all() or not all(apart):
            return None
    return outline.figures


def _added(figure: OutlineFigure) -> OutlineFigure:
    return OutlineFigure(figure.kind, "+", figure.x, figure.y, figure.angle_deg, figure.sizes)


def _border_points(figure: OutlineFigure) -> Array:
    u = np.linspace(0.0, 1.0, 257)[:-1]
    if figure.kind in ("circle", "ellipse"):
        return round_border(figure, u)
    corners = corners_of(figure)
    return np.concatenate(
        [a + u[::8, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    )

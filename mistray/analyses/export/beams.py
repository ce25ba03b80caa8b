"""Clear beams, the volumes that the light of a field fills on its way to the detector, as solids between surfaces.

Rays at the rim are found in float64: along many directions in the entrance, the last ray that passes all apertures.
Their convex hull is the rim, so that the shadow of a spider or a secondary mirror counts as light. Between two
surfaces the beam is bounded by a ruled surface through these rays. At a surface it ends on a cap through points of that
surface, and at a focus in a point.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.spatial import ConvexHull

from mistray.analyses.export.faces import polygon_normal
from mistray.errors import MistrayError
from mistray.io.cad.write_step import StepFile
from mistray.sampling.design_path import DesignPath, find_design_path, sphere_of
from mistray.sampling.outlines import outline
from mistray.sampling.sources import spectrum_of
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.bundle import PointBundle, field_bundle
from mistray.trace.host.stop import Region, lit_region

Array = npt.NDArray[np.float64]

RIM = 72  # rays round a smooth rim; as many between them say how far off the spline through them is
SECTIONS = (24, *9 * (4,))  # parts of the way across the rim that it is looked for in, again and again
ROUNDS, STRAIGHT, MOST_RIM = 8, 2e-4, 200  # of a rim with corners: more rays where it is not so straight, in its size
CORNERS = 1e-3  # of its size, by which a smooth rim is off where there are corners
FOCUS = 0.02  # of the beam at the next surface: where its rays come together nearer than this it ends in a point
FLAT = 1e-9  # of its size, by which a cap may depart from a plane
CAP = 5  # rings of a cap, from its middle to its rim


@dataclass(frozen=True, eq=False)
class FieldBeam:
    """
    Clear beam of one field: rays at its rim and through its middle, from the start to the detector.

    Attributes
    ----------
    field_deg : float
        Field angle, degrees.
    places : list of str
        Places along its rays: "start", the surfaces that they meet, and "focus" where the light comes together.
    middle : (p, 3) float64
        Points of the middle ray at these places in world coordinates, mm.
    caps : (p, n, CAP, 3) float64
        World points on each surface from the middle ray to the n rays at the rim, mm; all equal where the beam comes to
        a point.
    smooth : bool
        Whether a smooth curve follows the rim; else it is a polygon, because the rim has corners.
    rim_error_mm : float
        Largest distance of this curve from rays at the rim between those that it goes through, mm. It is measured at
        the start, or at the first surface for light from a point.
    """

    field_deg: float
    places: list[str]
    middle: Array
    caps: Array
    smooth: bool
    rim_error_mm: float

    @property
    def name(self) -> str:
        """Name of the beam by its field angle, such as "beam 10 deg"."""
        return f"beam {self.field_deg:g} deg"

    def write(self, file: StepFile) -> tuple[list[int], list[int]]:
        """
        Write a solid between each two consecutive places, or only its side face where rays cross in between.

        Return the entity numbers of the solids and of the side faces.
        """
        solids, sides = [], []
        for k, (here, there) in enumerate(pairwise(self.places)):
            name = f"{self.name}: {here} to {there}"
            rims = self.caps[k, :, -1], self.caps[k + 1, :, -1]
            along = self.middle[k + 1] - self.middle[k]
            senses = [_sense(rim, along) for rim in rims if not _point(rim)]
            stretch = _Stretch(file, rims, self.smooth)
            faces = [stretch.side(name, senses[0] >= 0)]
            if len(set(senses)) > 1 or not senses[0]:
                sides += faces
                continue
            for end, rim in enumerate(rims):
                if not _point(rim):
                    faces.append(self._cap(file, k + end, stretch, end, (senses[0] > 0) == (end == 0)))
            solids.append(file.solid(name, faces))
        return solids, sides

    def _cap(self, file: StepFile, k: int, stretch: _Stretch, end: int, outwards: bool) -> int:
        """
        Add the end face of a beam section at place `k` to the file, and return its entity number.

        `end` is 0 where the section begins and 1 where it ends; `outwards`: whether the normal about which the rim runs
        counter-clockwise points into the solid.
        """
        rings = self.caps[k]
        normal = polygon_normal(rings[:, -1])
        away = (rings - self.middle[k]) @ normal
        if np.abs(away).max() <= FLAT * np.ptp(rings, axis=(0, 1)).max():
            ahead = outwards == (end == 0)  # the rim goes round counter-clockwise about the light
            sign = 1.0 if ahead == (end == 1) else -1.0
            across = rings[0, -1] - self.middle[k]
            across = across - (across @ normal) * normal
            place = file.placement(self.middle[k], sign * normal, across / np.linalg.norm(across))
            border = file.loop([(stretch.circles[end], sign > 0)])
            return file.face(self.places[k], file.plane(place), True, [border])
        known = np.concatenate([np.tile(self.middle[k], (len(rings), 1, 1)), rings], axis=1)
        u = np.linspace(0.0, 1.0, CAP + 1)
        along = make_interp_spline(u, known.swapaxes(0, 1), 3)
        turned = [_round(row, self.smooth) for row in along.c]
        poles = np.stack([own for own, _ in turned], axis=1)
        surface = file.spline_surface(poles, (turned[0][1], along.t), (stretch.degree, 3))
        spoke = make_interp_spline(u, known[0], 3)
        curve = file.spline(spoke.c, spoke.t, 3)
        seam = file.edge(file.vertex(self.middle[k]), stretch.starts[end], curve)
        return _face(
            file, self.places[k], surface, [(seam, True), (stretch.circles[end], False), (seam, False)], outwards
        )


class _Stretch:
    """
    Section of a clear beam between two rims, each of points (n, 3), mm; the points of one rim may all be equal.

    Its side is a ruled surface.
    """

    def __init__(self, file: StepFile, rims: tuple[Array, Array], smooth: bool) -> None:
        self.file, self.rims, self.degree = file, rims, 3 if smooth else 1
        self.splines = [_round(rim, smooth) for rim in rims]
        self.starts = [file.vertex(rim[0]) for rim in rims]
        self.circles = [
            0 if _point(rim) else file.edge(start, start, file.spline(poles, knots, self.degree))
            for rim, start, (poles, knots) in zip(rims, self.starts, self.splines, strict=True)
        ]

    def side(self, name: str, outwards: bool) -> int:
        """
        Add the ruled side face of the beam section to the file, and return its entity number.

        `outwards`: whether its rims run counter-clockwise about the direction of the light.
        """
        file, (first, last) = self.file, self.circles
        seam = file.edge(self.starts[0], self.starts[1], file.line(self.rims[0][0], self.rims[1][0]))
        poles = np.stack([poles for poles, _ in self.splines], axis=1)
        surface = file.spline_surface(poles, (self.splines[0][1], np.array([0.0, 0.0, 1.0, 1.0])), (self.degree, 1))
        loop = [(first, True), (seam, True), (last, False), (seam, False)]
        return _face(file, name, surface, [edge for edge in loop if edge[0]], outwards)


def _point(rim: Array) -> bool:
    return bool(np.ptp(rim, axis=0).max() == 0)


def _face(file: StepFile, name: str, surface: int, loop: list[tuple[int, bool]], along: bool) -> int:
    """
    Add a face to a STEP file, and return its entity number.

    `along`: whether the face has the normal of `surface`, and `loop` runs counter-clockwise about it; else both are
    reversed.
    """
    edges = loop if along else [(edge, not forwards) for edge, forwards in loop[::-1]]
    return file.face(name, surface, along, [file.loop(edges)])


def _sense(rim: Array, along: Array) -> int:
    """Return how rim points, (n, 3), turn about the vector `along`: 1 counter-clockwise, -1 clockwise, 0 both ways."""
    middle = rim.mean(axis=0)
    turns = np.cross(rim - middle, np.roll(rim, -1, axis=0) - middle) @ along
    return int(np.sign(turns[0])) if np.all(turns * turns[0] > 0) else 0


def _round(points: Array, smooth: bool) -> tuple[Array, Array]:
    """
    Return poles, mm, and knots of a closed curve through points, (n, 3), mm.

    The curve is a periodic cubic spline if `smooth`, else a polygon.
    """
    closed = np.concatenate([points, points[:1]])
    u = np.linspace(0.0, 1.0, len(closed))
    if not smooth:
        return closed, np.concatenate([[0.0], u, [1.0]])
    slope = CubicSpline(u, closed, bc_type="periodic")(0.0, 1)
    spline = make_interp_spline(u, closed, 3, bc_type=([(1, slope)], [(1, slope)]))
    spline.c[-1] = spline.c[0] = closed[0]
    return spline.c, spline.t


class BeamFinder:
    """
    Construction of clear beams along the design path of a scene.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    wavelength_nm : float, optional
        Wavelength, nm; by default the first one of the scene's source.

    Raises
    ------
    MistrayError
        If no light of the source reaches the detector by way of lenses or mirrors.
    """

    def __init__(self, scene: Any, wavelength_nm: float | None = None) -> None:
        self.scene = scene
        self.wavelength_nm = float(spectrum_of(scene, wavelength_nm, None)[0][0])
        table = SurfaceTable(scene, self.wavelength_nm)
        first = table.on(table.detectors[0])
        path = find_design_path(first, scene)
        if path is None or not path.has_optics:
            raise MistrayError(
                "no lens or mirror sends light of the scene's source to the detector, so that there are no beams; "
                "check their places"
            )
        self.path: DesignPath = path
        self.aperture = sphere_of(outline(first.shapes[path.steps[0].surface]))

    @property
    def lit(self) -> dict[str, int]:
        """Side of each mirror on the design path that light comes from, by shape id: -1 the front, 1 the back."""
        ids = self.path.table.ids
        return {ids[step.surface]: -1 if step.from_front else 1 for step in self.path.steps if step.reflects}

    def beam(self, field_deg: float, azimuth_deg: float | None = None) -> FieldBeam:
        """
        Return the clear beam of a field as far as the detector.

        `field_deg` and `azimuth_deg` are in degrees; the azimuth is by default that of the scene.

        Raises
        ------
        MistrayError
            If no light of the field reaches the detector, or rays at the rim are lost on the way.
        """
        bundle = field_bundle(self.scene, field_deg, azimuth_deg, self.aperture)
        region = lit_region(self.path, bundle, self.aperture)
        if region is None:
            raise MistrayError(f"field {field_deg:g} deg: no light reaches the detector; leave the field out")
        outermost = _Rim(self.path, bundle, region)
        turns = 2 * np.pi * np.arange(RIM) / RIM
        points, between = self._at_rim(outermost, bundle, turns, turns + np.pi / RIM)
        entrance = int(bundle.near)  # of light from a point the first surface
        error = _off(points[entrance, 1:], between[entrance])
        smooth = error < CORNERS * float(np.ptp(points[entrance], axis=0).max())
        if not smooth:
            points, between = self._at_rim(outermost, bundle, *outermost.refined(turns))
            error = float(_aside(between[entrance], points[entrance, 1:]).max())
        if not np.isfinite(points).all():
            raise MistrayError(f"field {field_deg:g} deg: rays at its rim are lost on the way; leave the field out")
        ids = self.path.table.ids
        places = ["start", *(ids[step.surface] for step in self.path.steps)]
        caps = [self._cap(k, points[k, 0], points[k, 1:]) for k in range(len(places))]
        return FieldBeam(field_deg, *_with_foci(places, points[:, 0], caps), smooth, error)

    def _at_rim(self, outermost: _Rim, bundle: PointBundle, turns: Array, between: Array) -> tuple[Array, Array]:
        """
        Return points, mm, of the middle ray and the rim rays at angles `turns`, and of the rim rays at `between`.

        Angles are in rad about the middle of the lit part of the entrance. Shapes are (p, 1 + n, 3) and (p, m, 3), with
        p places along the rays.
        """
        others = outermost.at(between)
        rim = outermost.at(turns)
        points = self._follow(bundle, np.concatenate([rim.mean(axis=0)[None], rim, others]))
        return points[:, : len(rim) + 1], points[:, len(rim) + 1 :]

    def _follow(self, bundle: PointBundle, x: Array) -> Array:
        """
        Return points, (p, n, 3), mm, of rays at the start and at each surface of the path.

        `x`, (n, 2): coordinates of the rays in the entrance, mm, or slopes for a near object.
        """
        o, d = bundle.rays(x)
        points = [o]
        for step in self.path.steps:
            o, normal = self.path.meet(step, o, d)
            points.append(o)
            if step is not self.path.steps[-1]:
                d = self.path.leave(step, d, normal)
        return np.stack(points)

    def _cap(self, k: int, middle: Array, rim: Array) -> Array:
        """
        Return points between the middle ray and each rim ray on the surface at place `k`, (n, CAP, 3), mm.

        At the start, and on a shape that is not one of Mistray's, they lie on straight lines instead.
        """
        share = np.arange(1, CAP + 1)[:, None] / CAP
        straight = middle + share * (rim - middle)[:, None]
        table, surface = self.path.table, self.path.steps[k - 1].surface
        if k == 0 or surface >= len(table.pieces):  # a plane across the light, or a stock shape
            return np.asarray(straight)
        inner = straight[:, :-1].reshape(-1, 3)
        axis = table.rotations[surface][:, 2]
        met = self.path.meet(self.path.steps[k - 1], inner, np.tile(axis, (len(inner), 1)))[0]
        whole = np.where(np.isfinite(met), met, inner).reshape(len(rim), CAP - 1, 3)
        return np.concatenate([whole, rim[:, None]], axis=1)


def _off(rim: Array, between: Array) -> float:
    """Return the largest distance, mm, of rays `between` rim points, (n, 3), from the cubic spline through these."""
    poles, knots = _round(rim, True)
    half = (np.arange(len(rim)) + 0.5) / len(rim)
    return float(np.linalg.norm(BSpline(knots, poles, 3)(half) - between, axis=1).max())


def _with_foci(places: list[str], middle: Array, caps: list[Array]) -> tuple[list[str], Array, Array]:
    """
    Make a section that is nearly a point into one, and insert a place where the beam is focused between surfaces.

    Return the names of the places, (p,), points of the middle ray, (p, 3), mm, and points of the sections, (p, n, CAP,
    3), mm.
    """
    spread = [float(np.ptp(cap[:, -1], axis=0).max()) for cap in caps]
    for k, cap in enumerate(caps):
        beside = max(spread[k - 1] if k else 0.0, spread[k + 1] if k + 1 < len(caps) else 0.0)
        if 0 < spread[k] < FOCUS * beside and not (k and _point(caps[k - 1][:, -1])):
            caps[k] = np.broadcast_to(middle[k], cap.shape)
    names, points, rings = [places[0]], [middle[0]], [caps[0]]
    for k in range(1, len(places)):
        a, b = caps[k - 1][:, -1], caps[k][:, -1]
        p, q = a - middle[k - 1], (b - middle[k]) - (a - middle[k - 1])
        t = -float(np.sum(p * q)) / max(float(np.sum(q * q)), 1e-300)  # where Σ |p + t q|² is least
        waist = float(np.ptp(p + t * q, axis=0).max())
        if 0 < t < 1 and waist < FOCUS * max(spread[k - 1 : k + 1]) and not (_point(a) or _point(b)):
            names.append("focus")
            points.append(middle[k - 1] + t * (middle[k] - middle[k - 1]))
            rings.append(np.broadcast_to(points[-1], caps[k].shape))
        names.append(places[k])
        points.append(middle[k])
        rings.append(caps[k])
    return names, np.array(points), np.array(rings)


class _Rim:
    """
    Rim of a field's light in entrance coordinates: the convex hull of the outermost rays that reach the detector.

    The coordinates are mm in the entrance plane for a far object, and slopes of the rays for a near one
    (`PointBundle`).
    """

    def __init__(self, path: DesignPath, bundle: PointBundle, region: Region) -> None:
        self._path, self._bundle = path, bundle
        self._middle = region.points.mean(axis=0)
        self._limit = float(np.linalg.norm(region.points - self._middle, axis=1).max()) + 2 * region.cell
        self._known: dict[float, float] = {}  # direction → distance

    def at(self, turns: Array) -> Array:
        """
        Return rim points in the directions `turns`, (n,), rad, about the middle.

        They are entrance coordinates, (n, 2): mm, or slopes of rays for a near object.
        """
        new = np.setdiff1d(turns, list(self._known))
        self._known |= dict(zip(new.tolist(), self._outermost(_unit(new)).tolist(), strict=True))
        reached = np.array(list(self._known.values()))[:, None] * _unit(np.array(list(self._known)))
        sides = ConvexHull(self._middle + reached).equations  # unit normals outwards, and offsets
        along = _unit(turns)
        slope = along @ sides[:, :2].T
        with np.errstate(divide="ignore"):
            reach = np.where(slope > 0, -(sides[:, :2] @ self._middle + sides[:, 2]) / slope, np.inf).min(axis=1)
        return np.asarray(self._middle + reach[:, None] * along)

    def refined(self, turns: Array) -> tuple[Array, Array]:
        """Return directions, rad, with more of them where the rim bends, and those half-way between neighbours."""
        for _ in range(ROUNDS):
            between = turns + 0.5 * np.diff(turns, append=turns[0] + 2 * np.pi)
            middles = self.at(between)
            rim = self.at(turns)
            far = _aside(middles, rim) > STRAIGHT * np.ptp(rim, axis=0).max()
            if not far.any() or len(turns) + far.sum() > MOST_RIM:
                break
            turns = np.sort(np.concatenate([turns, between[far]]))
        return turns, turns + 0.5 * np.diff(turns, append=turns[0] + 2 * np.pi)

    def _outermost(self, along: Array) -> Array:
        """
        Return the distance, (n,), from the middle to the last ray that passes, in each direction `along`, (n, 2).

        It is in mm in the entrance plane, or in slopes for a near object. Rays pass if they reach the plane of the
        detector.
        """
        inside, outside = np.zeros(len(along)), np.full(len(along), self._limit)
        rows = np.arange(len(along))
        for sections in SECTIONS:
            parts = np.arange(1, sections) / sections  # both ends are known
            tried = inside[:, None] + parts * (outside - inside)[:, None]
            x = self._middle + tried[..., None] * along[:, None]
            found = self._path.unobstructed(*self._bundle.rays(x.reshape(-1, 2)), beyond_end=True)
            good = found.passes.reshape(tried.shape)
            last = np.where(good.any(axis=1), sections - 1 - np.argmax(good[:, ::-1], axis=1), 0)
            edges = np.concatenate([inside[:, None], tried, outside[:, None]], axis=1)
            inside, outside = edges[rows, last], edges[rows, last + 1]
        return inside


def _unit(turns: Array) -> Array:
    """Return the unit vectors, (n, 2), at angles (n,), rad, from the x axis."""
    return np.column_stack([np.cos(turns), np.sin(turns)])


def _aside(points: Array, corners: Array) -> Array:
    """
    Return the distance, (n,), of each point, (n, d), from the polygon side that begins at the corner of the same index.

    It is in the unit of the coordinates: mm, or slopes for rays of a near object.
    """
    side = np.roll(corners, -1, axis=0) - corners
    away = points - corners
    share = np.sum(away * side, axis=1) / np.maximum(np.sum(side * side, axis=1), 1e-300)
    return np.asarray(np.linalg.norm(away - np.clip(share, 0, 1)[:, None] * side, axis=1))

"""
Start rays of a backward trace, which leave the detector like light from a Lambertian surface.

A share c of the rays on the lit side is aimed at targets. All of them are weighted by the balance heuristic (E. Veach,
Robust Monte Carlo methods for light transport simulation, 1997, section 9.2):

    w = n² pdf_L/((1 - c - g + g m) pdf_L + c pdf_T),

where pdf_L = cos θ/π is the Lambertian density (`lambertian`) at the angle θ from the normal, pdf_T that of the targets
(`density`), both in 1/sr, c is `AIMED`, and n the refractive index of the medium before the detector. A share g,
`GUIDED`, starts where a pilot has found light, with the density m in units of the Lambertian one. Its map has the
coordinates of `DetectorStart.place`, in which a ring of the detector that sees a ring of the scene is a box. Without
targets c is 0, and without a map g.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.kernel.device_targets import DeviceTargets
from mistray.kernel.lobes import tangents
from mistray.kernel.targets import AimSet
from mistray.messages import Message
from mistray.notes import Note
from mistray.physics.geometry.sag import in_proportion, sag, sag_derivative
from mistray.recorders.sampler import tree_seeds
from mistray.recorders.start_rays import StartRays, generators
from mistray.sampling.outlines import detector_area
from mistray.sampling.sharing.start_map import DeviceMap, StartMap
from mistray.sampling.strata import curve_points
from mistray.settings import BATCHES
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.host_points import lambertian_directions, surface_points
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import opaque

FROM_BACK = 1 / 16  # share of the rays that start on the side away from the light of the design
PROBES = 256  # rays that find the medium around the detector
BOUNCES = 8  # their reflections at walls that declare no material
LEAST_SAID = 1 / 16  # share of them below which a declaration is ignored, as of a lens that is open at its side
AIMED = 0.4  # share of the rays on the lit side that are aimed at the opening
GUIDED = 0.4  # share of them that start by a map of a pilot
AXIS = 1e-12  # mm², squared distance from the middle within which azimuth 0 is that of +x


class DetectorStart:
    """
    Detector of a scene as a Lambertian source of backward rays, to one side or to both.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    light : (3,) float64
        Unit direction of the design path's light at the detector.
    aim : AimSet, optional
        Targets of a part of the rays towards the light; None: no ray is aimed.
    both_sides : bool
        Whether rays leave to both sides; otherwise they leave only towards the light.

    Attributes
    ----------
    area : float
        Area of the detector, mm².
    width, height, extent : int, int, tuple of float
        Columns and rows of pixels, and borders x0, x1, y0, y1 of the film, mm.
    notes : list of Note
        Notes on a material before the detector that walls alone declare.

    Raises
    ------
    MistrayError
        If the detector is a tube or one of Mitsuba's own shapes other than a rectangle, see `SurfaceTable.film`; or if
        the detector and the surfaces that it sees declare different materials before it.
    """

    def __init__(self, table: SurfaceTable, light: np.ndarray, aim: AimSet | None, both_sides: bool) -> None:
        self.notes: list[Note] = []
        self._back = FROM_BACK if both_sides else 0.0
        self._table = table
        self.width, self.height, (x0, x1, y0, y1) = table.film()
        self.extent = (x0, x1, y0, y1)
        # Shape and frame of the detector; the third axis is its normal
        self._targets = (DeviceTargets([aim], table.centre), len(aim.targets)) if aim is not None else None
        self._half = [dr.opaque(mi.Float, 0.5 * (x1 - x0)), dr.opaque(mi.Float, 0.5 * (y1 - y0))]
        self._round = False
        self._curved = False
        self.area = detector_area(table)
        if table.detector < len(table.pieces):
            self._analytic()
        else:
            origin, x_axis, y_axis = table.detector_axes[table.detector]
            self._origin, self._axes = origin, [x_axis, y_axis, dr.cross(x_axis, y_axis)]
            (normal,) = table.mitsuba_normals(table.download_points(origin)[:1], np.array(self._axes[2]).reshape(1, 3))
            if normal @ np.array(self._axes[2]).ravel() < 0:
                self._axes[2] = -self._axes[2]
        normal = np.array(self._axes[2]).ravel()
        towards = -1.0 if normal @ light > 0 else 1.0  # side of the normal that the light of the design comes from
        self._towards = dr.opaque(mi.Float, towards)
        # Media of the lit side and of the other one
        media = [self._medium(side, side == towards) for side in (towards, -towards)]
        self._media = [dr.opaque(mi.UInt32, number) for number, _ in media]
        self._index2 = [dr.opaque(mi.Float, n * n) for _, n in media]
        self._guide: DeviceMap | None = None
        self._guide_given: StartMap | None = None

    def guide(self, given: StartMap | None) -> None:
        """Set the start map that draws part of the rays on the lit side; None: no rays are drawn from a map."""
        if given is not self._guide_given:
            self._guide_given, self._guide = given, None if given is None else DeviceMap(given)

    def _analytic(self) -> None:
        """Upload the frame, aperture (mm) and sag coefficients of an analytic detector to the device."""
        table = self._table
        piece = table.pieces[table.detector]
        assert isinstance(piece, SagSurface)  # see `SurfaceTable.film`
        self._origin = table.upload_point(table.vertices[table.detector])
        axes = table.rotations[table.detector].T
        self._axes = [opaque(mi.Vector3f, axis) for axis in axes]
        self._round = piece.outer > 0
        self._radii2 = [dr.opaque(mi.Float, r * r) for r in (piece.inner, piece.outer)]
        self._curved = not piece.flat
        coefficients, per_area = in_proportion(piece.coefficients, piece.size)
        c, k, w, *rest = (dr.opaque(mi.Float, v) for v in (piece.curvature, piece.conic, per_area, *coefficients))
        self._shape = c, k, rest, w
        x0, x1, y0, y1 = self.extent
        # Mean stretch of the surface over its projection, by which weights are normalised
        flat = np.pi * (piece.outer**2 - piece.inner**2) if self._round else (x1 - x0) * (y1 - y0)
        self._stretch = dr.opaque(mi.Float, self.area / flat)

    def _medium(self, side: float, lit: bool) -> tuple[int, float]:
        """
        Return the position in `Optics.media`, and the refractive index, of the medium that adjoins the detector.

        This is the medium on the side `side` (±1) of the detector's normal. It is the material that the detector
        declares there, else the one that the surfaces declare which its rays meet first. Of these, refracting surfaces
        decide by majority; opaque ones decide where there are none, or too few to test the detector's own declaration.
        It is vacuum where nothing is declared. On the side of the light, `lit`, a contradiction raises `MistrayError`.
        On the other side the declared material may be the detector's substrate, so that none is reported.
        """
        # Declarations of the surfaces that probes meet first
        table, optics = self._table, self._table.optics
        own = int(optics.declared[table.detector, int(side > 0)])
        hit, from_back = self._first_to_declare(side)
        said = optics.declared[hit, from_back]
        opaque = (optics.host_words[hit] & OPAQUE) != 0
        counts = np.bincount(said[~opaque], minlength=1)
        if counts.sum() >= (LEAST_SAID * PROBES if own else 1):
            others = [int(counts.argmax())]
        else:  # walls decide only here: a mirror may declare its glass, in which there is no light
            counts = np.bincount(said[opaque], minlength=1)
            others = np.argsort(-counts)[: max(1, np.count_nonzero(counts >= LEAST_SAID * PROBES))].tolist()
        # The detector's own declaration first; on the lit side others must agree with it
        found = [(own, "")] if own else []
        found += [(number, table.ids[hit[said == number][0]]) for number in others if counts[number]]
        for other in found[1:]:
            if lit and other[0] != found[0][0]:
                raise MistrayError(self._contradiction(found[0], other, side))
        if lit and found and found[0][1] and not np.any(~opaque):
            medium, where = optics.media[found[0][0]], "back" if side > 0 else "front"
            self.notes.append(Message.INFERRED_MEDIUM.note(medium=medium, surface=found[0][1], side=where))
        number = found[0][0] if found else 0
        return number, float(optics.host_media_n[number])

    def _first_to_declare(self, side: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the first surfaces with a declared medium on rays from the detector, and a mask of hits from the back.

        Surfaces that declare none reflect the rays.
        """
        table, rng = self._table, np.random.default_rng(0)
        o, outward = surface_points(table, table.detector, PROBES, rng)
        outward, left = side * outward, np.full(PROBES, table.detector)
        met: list[np.ndarray] = []
        for _ in range(BOUNCES):
            d = lambertian_directions(outward, rng)
            left, o, normal = first_hit(table, o, d, left)
            from_back = np.einsum("ij,ij->i", d, normal) < 0
            declares = table.optics.declared[left, from_back.astype(int)] > 0
            hit = (left >= 0) & ~np.isin(left, table.detectors)  # a detector declares the substrate behind it
            met.append(np.stack([left, from_back])[:, hit & declares])
            on = hit & ~declares
            outward = np.where(from_back, 1.0, -1.0)[on, None] * normal[on]
            left, o = left[on], o[on]
        surfaces, sides = np.concatenate(met, axis=1)
        return surfaces, sides

    def _contradiction(self, first: tuple[int, str], second: tuple[int, str], side: float) -> str:
        """
        Return the error message for two different media declared in front of the detector.

        Each is given as its position in `Optics.media` and the surface that declares it, "" for the detector. `side`
        is that of `_medium`.
        """
        media, detector = self._table.optics.media, self._table.ids[self._table.detector]
        key = "back" if side > 0 else "front"
        by = f"surface '{first[1]}'" if first[1] else f"its {key}"
        return (
            f"detector '{detector}': it stands in '{media[first[0]]}' by {by}, and in '{media[second[0]]}' by surface "
            f"'{second[1]}', which it sees; correct front or back of one of them"
        )

    def pixel(self, x: mi.Float, y: mi.Float, columns: int, rows: int) -> mi.UInt32:
        """
        Return the index of the pixel at x, y, mm, in a map of the detector with `columns` × `rows`.

        Row 0 is at the smallest y.
        """
        column = dr.clip(mi.Int32((0.5 + 0.5 * x / self._half[0]) * columns), 0, columns - 1)
        row = dr.clip(mi.Int32((0.5 + 0.5 * y / self._half[1]) * rows), 0, rows - 1)
        return mi.UInt32(row * columns + column)

    def pass_rays(self, seed: int, lanes: int, weight: float, pixels: tuple[int, int] = (0, 0)) -> StartRays:
        """
        Return the start rays of a backward pass: `lanes` rays that leave the detector.

        Parameters
        ----------
        seed : int
            Seed of the random numbers.
        lanes : int
            Number of rays, a multiple of the number of batches.
        weight : float
            Mean weight of the rays.
        pixels : tuple of int
            Columns and rows of the maps; 0: there are no maps.
        """
        index = dr.arange(mi.UInt32, lanes)
        rng, _ = generators(seed, index)
        batch, place = stratified_places(index, lanes, rng)
        return self.rays(index, batch, place, rng, tree_seeds(seed, batch), dr.opaque(mi.Float, weight), pixels)

    def rays(
        self,
        lane: mi.UInt32,
        batch: mi.UInt32,
        place: mi.Float64,
        rng: mi.PCG32,
        seed: mi.UInt32,
        weight: mi.Float,
        pixels: tuple[int, int],
    ) -> StartRays:
        """
        Return backward start rays of given lanes, which leave the detector at stratified points and directions.

        Parameters
        ----------
        lane, batch : mi.UInt32
            Index and batch of each ray.
        place : mi.Float64
            Random number, 0 … 1, stratified within each batch.
        rng : mi.PCG32
            Random number generator of each lane.
        seed : mi.UInt32
            Seed of the random numbers of each ray's tree.
        weight : mi.Float
            Mean weight of the rays.
        pixels : tuple of int
            Columns and rows of the maps; 0: there are no maps.
        """
        # Stratum: away from the light, towards targets, or Lambertian; each is sorted along a curve of its own
        back = place < self._back
        aimed_share = AIMED if self._targets is not None else 0.0
        first_guided = self._back + (1 - self._back) * aimed_share
        first_random = first_guided + (1 - self._back) * (GUIDED if self._guide is not None else 0.0)
        aim, guided = ~back & (place < first_guided), (place >= first_guided) & (place < first_random)
        low = dr.select(back, 0, dr.select(aim, self._back, dr.select(guided, first_guided, first_random)))
        high = dr.select(back, self._back, dr.select(aim, first_guided, dr.select(guided, first_random, 1)))
        within = (place - low) / (high - low)
        u = curve_points(within, 4, rng)
        # The two dimensions that change fastest are those of the direction, which most decides where a ray goes
        x, y = self._planar(u[2], u[3])
        if self._guide is not None:
            v, _ = self._guide.sample(dr.zeros(mi.UInt32, dr.width(lane)), dr.clip(within, 0, 1 - 1e-12), rng)
            u = [dr.select(guided, new, old) for new, old in zip(v, u, strict=True)]
            guided_x, guided_y = self._planar_guided(v[2], v[3])
            x, y = dr.select(guided, guided_x, x), dr.select(guided, guided_y, y)
        p, normal, stretch = self._surface(x, y)
        outward = normal * dr.select(back, -self._towards, self._towards)
        # Cosine-weighted hemisphere
        disk = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u[0], u[1]))
        cosine = dr.sqrt(dr.maximum(1 - dr.squared_norm(disk), 0))
        across, along = tangents(outward)
        if self._guide is not None:
            across, along = (
                dr.select(guided, own, other)
                for own, other in zip(self._polar_frame(x, y, outward), (across, along), strict=True)
            )
        d = dr.normalize(disk.x * across + disk.y * along + cosine * outward)
        w = stretch * weight / dr.select(back, self._back, 1 - self._back)
        own = mi.UInt32(0)
        if self._targets is not None:
            targets, count = self._targets
            plan = dr.zeros(mi.Vector2u, dr.width(lane)) + mi.Vector2u(0, count)
            to_target, own = targets.sample(plan, rng.next_float32(), (u[0], u[1]), p, outward, aim)
            d = dr.select(aim, to_target, d)
        if self._targets is not None or self._guide is not None:
            at = None
            # Rays keep the places that were drawn: rounding would move some to other leaves
            if self._guide is not None:
                at = [dr.select(guided, *pair) for pair in zip(v, self.place(p, d, outward), strict=True)]
            w = dr.select(back, w, w * self._over_all(p, d, outward, ~back, aim, own, at))
            w = dr.select(dr.isfinite(w), w, 0)
        # Radiance over n² is invariant, so that n² of the detector's medium enters the weight
        w = w * dr.select(back, self._index2[1], self._index2[0])
        left = dr.full(mi.UInt32, self._table.detector, dr.width(lane))
        medium = dr.select(back, self._media[1], self._media[0])
        pixel = self.pixel(x, y, *pixels)
        return StartRays(lane, batch, seed, p, d, w, left=left, normal=normal, pixel=pixel, medium=medium, scale=w)

    def weight_at(self, p: mi.Vector3f, d: mi.Vector3f, outward: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """
        Return the start weight that `rays`, called with weight 1, gives rays from points of the detector along d.

        Parameters
        ----------
        p, d : mi.Vector3f
            Points relative to `SurfaceTable.centre`, mm, and unit directions.
        outward : mi.Vector3f
            Unit normal on the side that the rays leave to.
        active : mi.Bool
            Lanes that take part.
        """
        # The same factors as in `rays`, for rays that were drawn otherwise
        upright = dr.dot(outward, self._axes[2])
        back = upright * self._towards < 0
        w = dr.rcp(dr.select(back, self._back, 1 - self._back))
        if self._curved:
            w = w / (dr.abs(upright) * self._stretch)
        if self._targets is not None or self._guide is not None:
            over_all = self._over_all(p, d, outward, active & ~back)
            w = dr.select(back, w, w * over_all)
        return w * dr.select(back, self._index2[1], self._index2[0])

    def place(self, p: mi.Vector3f, d: mi.Vector3f, outward: mi.Vector3f) -> list[mi.Float]:
        """
        Return the points, in the unit cube of a start map, of rays that leave the detector at p, mm, along d.

        Two coordinates are for the direction in a frame that turns with the azimuth of p, two for that azimuth and the
        squared radius, or for x and y of a rectangle. In them the Lambertian density is uniform. The first is -1 on the
        side away from the light, which has no map. The arguments are those of `weight_at`.
        """
        q = p - self._origin
        x, y = dr.dot(q, self._axes[0]), dr.dot(q, self._axes[1])
        across, along = self._polar_frame(x, y, outward)
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(dr.dot(d, across), dr.dot(d, along)))
        if self._round:
            inner2, outer2 = self._radii2
            at = [(dr.fma(x, x, y * y) - inner2) / (outer2 - inner2), 0.5 + 0.5 * dr.atan2(y, x) / dr.pi]
        else:
            at = [0.5 + 0.5 * x / self._half[0], 0.5 + 0.5 * y / self._half[1]]
        found = [dr.clip(value, 0, 1 - 2.0**-24) for value in (square.x, square.y, *at)]
        found[0] = dr.select(dr.dot(outward, self._axes[2]) * self._towards < 0, -1, found[0])
        return found

    def _polar_frame(self, x: mi.Float, y: mi.Float, outward: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return unit vectors normal to `outward`, radial (from the detector's centre) and tangential, at x, y, mm."""
        r2 = dr.fma(x, x, y * y)
        scale, off_axis = dr.rsqrt(dr.maximum(r2, AXIS)), r2 > AXIS
        radial = dr.select(off_axis, x * scale, 1) * self._axes[0] + dr.select(off_axis, y * scale, 0) * self._axes[1]
        along = dr.normalize(dr.cross(outward, radial))
        return dr.cross(along, outward), along

    def _over_all(
        self,
        p: mi.Vector3f,
        d: mi.Vector3f,
        outward: mi.Vector3f,
        active: mi.Bool,
        aim: mi.Bool | bool = False,
        own: mi.UInt32 | int = 0,
        at: list[mi.Float] | None = None,
    ) -> mi.Float:
        """
        Return the Lambertian pdf over the pdf of all sampling techniques together, for rays on the lit side.

        `aim` is a mask of rays that were aimed; `own` is the index of their target. `at` are the points of the rays in
        the start map; None: those of `place`. For the others see `weight_at`.
        """
        lambertian = dr.maximum(dr.dot(d, outward), 0) / dr.pi
        density = lambertian
        if self._targets is not None:
            targets, count = self._targets
            plan = dr.zeros(mi.Vector2u, dr.width(d)) + mi.Vector2u(0, count)
            to_targets = targets.density(plan, p, d, outward, mi.Bool(aim), mi.UInt32(own), active)
            density = dr.lerp(lambertian, to_targets, AIMED)
        if self._guide is not None:
            cell = dr.zeros(mi.UInt32, dr.width(d))
            map_density = self._guide.density(cell, at or self.place(p, d, outward), active)
            density = dr.fma(GUIDED * lambertian, map_density - 1, density)
        return lambertian / density

    def _planar(self, u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return positions on the projected detector, mm, uniform over its rectangle or ring, for u and v in 0 … 1."""
        if not self._round:
            return (2 * u - 1) * self._half[0], (2 * v - 1) * self._half[1]
        disk = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u, v))
        r2 = dr.squared_norm(disk)
        inner2, outer2 = self._radii2
        scale = dr.sqrt((inner2 + r2 * (outer2 - inner2)) / dr.maximum(r2, 1e-12))
        return disk.x * scale, disk.y * scale

    def _planar_guided(self, u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return positions on the projected detector, mm, with coordinates u and v in a start map (see `place`)."""
        if not self._round:
            return self._planar(u, v)
        inner2, outer2 = self._radii2
        r, (sine, cosine) = dr.sqrt(dr.lerp(inner2, outer2, u)), dr.sincos(dr.pi * (2 * v - 1))
        return r * cosine, r * sine

    def _surface(self, x: mi.Float, y: mi.Float) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
        """Return the point, unit normal, and local over mean area stretch of the detector at coordinates x, y, mm."""
        normal, stretch, z = mi.Vector3f(0, 0, 1), mi.Float(1), mi.Float(0)
        # Sag and normal there
        if self._curved:
            r2 = dr.fma(x, x, y * y)
            z, slope = sag(r2, *self._shape), 2 * sag_derivative(r2, *self._shape)
            normal = dr.normalize(mi.Vector3f(-slope * x, -slope * y, 1))
            stretch = 1 / (normal.z * self._stretch)
        first, second, third = self._axes
        p = self._origin + x * first + y * second + z * third
        n = normal.x * first + normal.y * second + normal.z * third
        return p, n + dr.zeros(mi.Vector3f, dr.width(x)), stretch


def stratified_places(index: mi.UInt32, lanes: int, rng: mi.PCG32) -> tuple[mi.UInt32, mi.Float64]:
    """
    Return the batch of each lane, and a random number 0 … 1 per lane, stratified within the batch.

    Parameters
    ----------
    index : mi.UInt32
        Indices of the lanes, 0 … lanes - 1.
    lanes : int
        Number of lanes, a multiple of the number of batches.
    rng : mi.PCG32
        Random number generator of each lane.
    """
    strata = lanes // BATCHES
    batch = index // dr.opaque(mi.UInt32, strata)
    within = mi.Float64(index - batch * dr.opaque(mi.UInt32, strata)) + mi.Float64(rng.next_float32())
    return batch, dr.minimum(within / dr.opaque(mi.Float64, strata), 1 - 1e-15)

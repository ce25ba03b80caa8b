"""
Surfaces in float64 for recorded events: the hit, Snell's law, R and T, differentiable by every number of a surface.

The kernel looks for the next surface in float32 and keeps no derivatives. Here the surface is given, and so is the
place of the hit up to rounding. One Newton step on the implicit equation F(o + t d) = 0,

    t ← t - F/(∇F · d)   with the denominator detached,

is exact to second order and carries the first derivatives of the hit by the ray and by the surface. All is computed in
the frame of the surface; a displacement and a rotation of that frame, both zero, are among the numbers. In the code F
is `value`, ½∇F is `gradient`, and ∇F · d is `slope`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import RANDOM_TRANSMITTED, TOTAL, TRANSMITTED, kind_of, place_of
from mistray.gradients.number_rows import NumberRows, tracked_array
from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.scatter_replay import ScatterEvent
from mistray.gradients.table_gradient import Derivatives, GradientRequest
from mistray.physics.fresnel import reflectance
from mistray.physics.geometry.sag import polynomial, polynomial_derivative, polynomial_second_derivative
from mistray.recorders.adjoint import CHANNELS
from mistray.sampling.source import SceneSource
from mistray.settings import BATCHES
from mistray.surfaces.gradient_columns import COEFFICIENTS, GEOMETRY, OWN, RIM_COLUMNS, SHAPE_COLUMNS
from mistray.surfaces.optics import (
    BACK_MEDIUM_SHIFT,
    FRESNEL,
    FRONT_MEDIUM_SHIFT,
    IDEAL,
    MEDIUM_MASK,
    OPAQUE,
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TABLED,
    TRANSMISSION,
    total_variable,
)
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

TABLE_CHANNELS = 3  # R from the front, R from the back, T


@dataclass(kw_only=True)
class ReplayedEvent(ScatterEvent):
    """
    Events of recorded paths in float64, differentiable; hits and directions in the frames of the surfaces.

    Attributes
    ----------
    active : mi.Bool
        Lanes that have an event.
    length : mi.Float64
        Length of the segment that led to the hit, mm.
    turn : mi.Vector3d
        Rotation of the frame (rad), zero but with derivatives.
    p : mi.Vector3d
        Point in the world, mm.
    scattered : mi.Bool
        Whether the surface scatters the light.
    heading : mi.Vector3d
        Direction in the world after reflection or refraction.
    medium_in, medium_out : mi.UInt32
        Media on the side of incidence and on the other one.
    """

    q: mi.Vector3d
    active: mi.Bool
    length: mi.Float64
    turn: mi.Vector3d
    p: mi.Vector3d
    scattered: mi.Bool
    heading: mi.Vector3d
    medium_in: mi.UInt32
    medium_out: mi.UInt32


class AsphericTerms(dr.CustomOp):
    """
    Polynomial terms of an aspheric sag with a hand-written adjoint, which is shorter than the automatic one.

    The terms are P = Σ a_i r^(2i), i = 2, 3, …, mm, or P' = dP/d(r²), 1/mm.

    With the adjoint p of P, or q of P', the adjoint of a_i is p r^(2i), or q i r^(2i-2); that of r² is p P', or q P''.
    """

    def eval(self, r2: Any, coefficients: Sequence[Any], still: Sequence[Any], derivative: bool) -> Any:
        """
        Return the polynomial terms P of the sag, mm, or their derivative P' with respect to r², 1/mm.

        Parameters
        ----------
        r2 : mi.Float64
            Squared radius, mm².
        coefficients : sequence of mi.Float64
            Coefficients a_i, which receive the derivatives.
        still : sequence of mi.Float64
            Coefficients without derivatives; trailing zeros may be missing.
        derivative : bool
            Whether to return P' instead of P.
        """
        self.r2, self.still, self.orders = dr.detach(r2), [dr.detach(a) for a in still], len(coefficients)
        self.derivative = derivative
        # The zero term makes the result as wide as r²: a literal 0 would receive the sum of the adjoints of all lanes
        return (polynomial_derivative if derivative else polynomial)(self.r2, self.still) + mi.Float64(0) * self.r2

    def backward(self) -> None:
        """Propagate the adjoint of the result to r² and to the coefficients a_i."""
        adjoint = self.grad_out()
        further = polynomial_second_derivative if self.derivative else polynomial_derivative
        self.set_grad_in("r2", adjoint * further(self.r2, self.still))
        # Adjoints of a_i, by ascending powers of r²
        power, found = adjoint * (self.r2 if self.derivative else self.r2 * self.r2), []
        for order in range(2, 2 + self.orders):
            found.append(order * power if self.derivative else power)
            power = power * self.r2
        self.set_grad_in("coefficients", found)

    def name(self) -> str:
        """Return the name of this operation in Dr.Jit's messages."""
        return "aspheric terms"


class ReplaySurfaces:
    """
    Differentiable copy of all surfaces in float64: geometry, refractive indices, R and T of coatings.

    Numbers whose derivatives are requested have one copy for each batch of start rays.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces at the wavelength.
    request : GradientRequest
        Requested derivatives.
    moved : SurfaceNumbers, optional
        Numbers of the surfaces, if not the present ones.
    start : SceneSource or int, optional
        Source of the rays, or the surface from which backward rays start; None: the start does not move.
    """

    def __init__(
        self,
        table: SurfaceTable,
        request: GradientRequest,
        moved: SurfaceNumbers | None = None,
        start: SceneSource | int | None = None,
    ) -> None:
        self.table, self.request = table, request
        self._start: Any = start
        moving = sorted(request.sources & {*start.moving}) if isinstance(start, SceneSource) else ()
        self._by_source = {name: dr.zeros(mi.Float64, BATCHES) for name in moving}
        self.count = table.count
        self._surfaces = dr.opaque(mi.UInt32, self.count)
        # Shapes and rims; `_still` has no derivatives, and reads fewer columns
        numbers = numbers_of(table) if moved is None else moved
        self._still = NumberRows(numbers.geometry, SHAPE_COLUMNS)
        self._shape = NumberRows(numbers.geometry, SHAPE_COLUMNS, request.geometry)
        self._rims = NumberRows(numbers.geometry, RIM_COLUMNS, request.geometry)
        # Indices, rows of the tables of R and T, ideal coatings
        optics = table.optics
        indices, rows, ideal = numbers.indices, numbers.rows, numbers.ideal
        self._indices = tracked_array(np.tile(indices.ravel(), BATCHES)) if request.indices else None
        self._plain_indices = upload(mi.Float64, indices)
        if request.rows:
            self._rows, self._ideal = (tracked_array(np.tile(v.ravel(), BATCHES)) for v in (rows, ideal))
        else:
            self._rows, self._ideal = upload(mi.Float64, rows), upload(mi.Float64, ideal)
        self._row_stride = dr.opaque(mi.UInt32, rows.size if request.rows else 0)
        self._ideal_stride = dr.opaque(mi.UInt32, ideal.size if request.rows else 0)
        # Frames
        self._rotations = upload(mi.Float64, table.rotations)
        # Vertices, and the sign of ∇F · n
        places = np.column_stack([table.vertices - table.centre, np.full(self.count, -1.0)])
        for piece in table.pieces:
            places[piece.index, 3] = piece.sign
        self._places = upload(mi.Float64, places)
        self._extinction = upload(mi.Float64, np.array(optics.extinction))
        dr.eval(self._indices, self._plain_indices, self._rows, self._ideal, self._places)
        dr.eval(self._rotations, self._extinction)

    # ---- numbers

    def _sides(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> mi.Vector2d:
        """Return the refractive indices in front of the surfaces s and behind them."""
        if self._indices is None:
            return dr.gather(mi.Vector2d, self._plain_indices, s, active)
        return dr.gather(mi.Vector2d, self._indices, batch * self._surfaces + s, active)

    def to_world(self, v: mi.Vector3d, s: mi.UInt32, active: mi.Bool, inverse: bool = False) -> mi.Vector3d:
        """Return vectors rotated from the frames of the surfaces s, held fixed, to the world; `inverse`: back."""
        if not self.table.rotated:
            return v
        m = [dr.gather(mi.Float64, self._rotations, 9 * s + k, active) for k in range(9)]
        rows = [m[k::3] for k in range(3)] if inverse else [m[3 * k : 3 * k + 3] for k in range(3)]
        return mi.Vector3d(*(row[0] * v.x + row[1] * v.y + row[2] * v.z for row in rows))

    def to_local(self, v: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return vectors rotated from the world to the frames of the surfaces s, the inverse of `to_world`."""
        return self.to_world(v, s, active, inverse=True)

    def vertex(self, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the vertices of the surfaces s, mm, relative to the centre of the scene."""
        return mi.Vector3d(*list(self._place(s, active))[:3])

    def _place(self, s: mi.UInt32, active: mi.Bool) -> mi.Vector4d:
        return dr.gather(mi.Vector4d, self._places, s, active)

    def extinction(self, medium: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """Return the extinction coefficients of media, absorption and scatter, 1/mm."""
        return dr.gather(mi.Float64, self._extinction, medium, active)

    # ---- geometry

    def event(
        self,
        o: mi.Vector3d,
        d: mi.Vector3d,
        t: mi.Float64,
        code: mi.UInt32,
        batch: mi.UInt32,
        active: mi.Bool,
        steps: int = 1,
        still: bool = False,
    ) -> ReplayedEvent:
        """
        Return the differentiable events of rays at surfaces given by their codes, at hits near the distances t.

        Parameters
        ----------
        o, d : mi.Vector3d
            Origin (mm) and unit direction in the world.
        t : mi.Float64
            Distance of a point near the hit, mm.
        code, batch : mi.UInt32
            Events, see `mistray.events`, and batches of the start rays.
        active : mi.Bool
            Lanes that have an event.
        steps : int
            Newton steps; one is enough for derivatives at the hit itself.
        still : bool
            Whether to leave out derivatives by shapes, and the work for terms that are 0.
        """
        s, what = place_of(code), kind_of(code)
        transmitted, scattered = what == TRANSMITTED, what >= RANDOM_TRANSMITTED
        # Ray in the frame of the surface; to first order in the rotation, which is 0
        numbers = self.numbers(s, batch, active, still)
        shift, turn = self._pose(numbers)
        p, d = self._at_rest(self.local_point(o, s, active), shift, turn), self.to_local(d, s, active)
        d = d - dr.cross(turn, d)
        # Newton steps; the last one carries the derivatives
        for _ in range(steps):
            value, gradient = self.implicit(p + t * d, numbers)
            step = value / dr.detach(2 * dr.dot(gradient, d))
            t = t - dr.select(active & dr.isfinite(step), step, 0)
        q = p + t * d
        _, gradient = self.implicit(q, numbers)
        normal = dr.normalize(gradient) * self._place(s, active).w
        # Side of incidence, media, R and T
        cosine = dr.dot(d, normal)
        from_front = dr.detach(cosine) > 0
        axis, cos_i = dr.select(from_front, normal, -normal), dr.abs(cosine)
        word = dr.gather(mi.UInt32, self.table.optics.words, s, active)
        R, T, cos_t, eta = self._coated(s, word, from_front, cos_i, what == TOTAL, batch, active)
        front, back = ((word >> place) & MEDIUM_MASK for place in (FRONT_MEDIUM_SHIFT, BACK_MEDIUM_SHIFT))
        # Reflection and Snell's law
        after = dr.select(transmitted, eta * d + (cos_t - eta * cos_i) * axis, d - 2 * cosine * normal)
        return ReplayedEvent(
            s,
            batch,
            dr.select(scattered, (what & 1) != 0, ~transmitted),
            from_front,
            d,
            axis,
            cos_i,
            cos_t,
            eta,
            R,
            T,
            lambda side, cos_i: self._coated(s, word, side, cos_i, mi.Bool(False), batch, active)[:2],
            q=q,
            active=active,
            length=t,
            turn=turn,
            p=self.to_world(q + dr.cross(turn, q) + shift, s, active) + self.vertex(s, active),
            scattered=scattered,
            heading=self.to_world(after + dr.cross(turn, after), s, active),
            medium_in=dr.select(from_front, front, back),
            medium_out=dr.select(from_front, back, front),
        )

    def numbers(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool, still: bool = False) -> dict[str, Any]:
        """Return the numbers of the shapes of the surfaces s, such as curvature and conic constant, by name."""
        rows = self._still if still else self._shape
        numbers = rows.read(s, batch, active)
        numbers["cone"] = self._place(s, active).w > 0
        numbers["families"] = [
            (here, family, dict(zip(family.numbers, (numbers[name] for name in OWN), strict=False)))
            for here, family in self.table.families.members(s, active)
        ]
        # Coefficients up to the last one that is used at any surface
        for key, some in (("coefficients", rows), ("still", self._still)):
            known = [order for order, name in enumerate(COEFFICIENTS, 1) if name in some.names]
            numbers[key] = [numbers[name] for name in COEFFICIENTS[: max(known, default=0)]]
        return numbers

    def implicit(self, q: mi.Vector3d, n: dict[str, Any]) -> tuple[mi.Float64, mi.Vector3d]:
        """
        Return the implicit function F, zero on the surface, and half its gradient, in the surface's own frame.

        A conic of curvature c and conic constant k has F = c (x² + y² + (1 + k) z²) - 2z. An asphere replaces z by z
        less the polynomial terms, which needs no root.
        """
        c, k1, coefficients = n["curvature"], 1 + n["conic"], n["coefficients"]
        r2 = q.x * q.x + q.y * q.y
        z, bend = q.z, mi.Float64(0)
        if coefficients:
            z = z - dr.custom(AsphericTerms, r2, coefficients, n["still"], False)
            bend = 2 * dr.custom(AsphericTerms, r2, coefficients, n["still"], True)
        radius = n["r0"] + n["slope"] * q.z
        cone = n["cone"]
        along = c * k1 * z - 1
        across = c - along * bend
        value = dr.select(cone, r2 - radius * radius, c * (r2 + k1 * z * z) - 2 * z)
        gradient = mi.Vector3d(
            dr.select(cone, q.x, across * q.x),
            dr.select(cone, q.y, across * q.y),
            dr.select(cone, -n["slope"] * radius, along),
        )
        for here, family, own in n["families"]:
            value = dr.select(here, family.residual(*q, own), value)
            gradient = dr.select(here, 0.5 * mi.Vector3d(*family.gradient(*q, own)), gradient)
        return value, gradient

    def local_point(self, p: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return points of the world in the frames of the surfaces s, mm, these frames held fixed."""
        return self.to_local(p - self.vertex(s, active), s, active)

    def rims(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """Return radii, half sides and ends of the surfaces s, mm, by the names of `RIM_COLUMNS`; 0 for none."""
        return self._rims.read(s, batch, active)

    def rim_distances(self, q: mi.Vector3d, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> list[mi.Float64]:
        """Return distances of points in the surfaces' frames from the rims, mm, as in `RIM_COLUMNS`; ≥ 0 inside."""
        rho = dr.sqrt(dr.maximum(q.x * q.x + q.y * q.y, 1e-24))
        x, y, z = dr.abs(q.x), dr.abs(q.y), q.z
        for here, family, own in self.numbers(s, batch, active)["families"]:
            z = dr.select(here, family.coordinate(*q, own), z)
        # Place of the hit along the coordinate, and 1 if the surface lies below the rim in it, else -1
        places = ((rho, 1), (rho, -1), (x, 1), (y, 1), (z, -1), (z, 1))
        values = self.rims(s, batch, active)
        return [sign * (values[name] - place) for name, (place, sign) in zip(RIM_COLUMNS, places, strict=True)]

    def sheet(self, p: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> tuple[mi.Float64, mi.Vector3d]:
        """
        Return the distances of world points from the unbounded surfaces s, mm, and the unit gradients of F there.

        The distance is F/|∇F|. It is infinite next to the far half of a quadric, which is no part of the surface.
        """
        numbers = self.numbers(s, mi.UInt32(0), active, still=True)
        value, gradient = self.implicit(self.local_point(p, s, active), numbers)
        length = dr.norm(gradient)
        here = numbers["cone"] | (gradient.z < 0)
        return dr.select(here, 0.5 * value / length, dr.inf), self.to_world(gradient / length, s, active)

    def distance_from(self, p: mi.Vector3d, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """Return the signed distances F/|∇F| of world points from the surfaces s next to them, mm."""
        numbers = self.numbers(s, batch, active)
        q = self._at_rest(self.local_point(p, s, active), *self._pose(numbers))
        value, gradient = self.implicit(q, numbers)
        return value / dr.detach(2 * dr.norm(gradient))

    @staticmethod
    def _pose(numbers: dict[str, Any]) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Return displacement, mm, and rotation vector, rad, of the frames of surfaces."""
        shift, turn = (mi.Vector3d(*(numbers[prefix + axis] for axis in "xyz")) for prefix in ("", "tilt_"))
        return shift, turn

    @staticmethod
    def _at_rest(q: mi.Vector3d, shift: mi.Vector3d, turn: mi.Vector3d) -> mi.Vector3d:
        """Return points of frames, mm, relative to the frames after displacement (mm) and a small rotation (rad)."""
        q = q - shift
        return q - dr.cross(turn, q)

    def move_start(self, rays: RecordedRays, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """
        Accumulate the part of the derivatives that comes from moving ray starts.

        `by_o` and `by_d` are the derivatives of the metric with respect to origins and directions.
        """
        for name, sums in self._by_source.items():
            # Rate at which origin and direction move with the parameter, times the adjoints of both
            o, d = self._start.motion(name, rays.o + mi.Vector3d(*self.table.centre.tolist()), rays.d)
            gain = dr.select(active, dr.dot(by_o, o) + dr.dot(by_d, d), 0)
            dr.scatter_reduce(dr.ReduceOp.Add, sums, gain, rays.batch, active)
        if not isinstance(self._start, int):
            return
        # Backward rays move with the surface that they start from
        s = dr.full(mi.UInt32, self._start, dr.width(rays.batch))
        with dr.resume_grad():
            shift, turn = self._pose(self.numbers(s, rays.batch, active))
            q, along = self.local_point(rays.o, s, active), self.to_local(rays.d, s, active)
            moved = self.to_world(shift + dr.cross(turn, q), s, active)
            turned = self.to_world(dr.cross(turn, along), s, active)
            value = dr.dot(by_o, moved) + dr.dot(by_d, turned)
            if dr.grad_enabled(value):
                dr.set_grad(value, dr.select(active, mi.Float64(1), 0))
                dr.enqueue(dr.ADMode.Backward, value)
                dr.traverse(dr.ADMode.Backward)

    # ---- optics

    def _coated(
        self,
        s: mi.UInt32,
        word: mi.UInt32,
        from_front: mi.Bool,
        cos_i: mi.Float64,
        known_total: mi.Bool,
        batch: mi.UInt32,
        active: mi.Bool,
    ) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
        """Return R and T of coatings (means of s and p), the cosine of refraction, and n_i/n_t."""
        front, back = self._sides(s, batch, active)
        n_i, n_t = dr.select(from_front, front, back), dr.select(from_front, back, front)
        # Refraction
        eta = n_i / n_t
        sin2_t = eta * eta * (1 - cos_i * cos_i)
        opaque = (word & OPAQUE) != 0
        total = known_total | ((dr.detach(sin2_t) >= 1) & ~opaque)
        cos_t = dr.select(total, 0, dr.sqrt(dr.maximum(dr.select(total, mi.Float64(1), 1 - sin2_t), 1e-24)))
        # Coating: bare interface, ideal, or from the table of the run
        kind, kinds = word & 3, self.table.optics.kinds
        R, T = mi.Float64(0), mi.Float64(0)
        if FRESNEL in kinds:
            bare = reflectance(cos_i, cos_t, n_i, n_t)
            R, T = bare, 1 - bare
        if IDEAL in kinds:
            ideal = active & (kind == IDEAL)
            base = batch * self._ideal_stride + 2 * s
            own = [dr.gather(mi.Float64, self._ideal, base + k, ideal) for k in range(2)]
            R = dr.select(ideal, dr.select(total, own[0] + own[1], own[0]), R)
            T = dr.select(ideal, own[1], T)
        if TABLED in kinds:
            tabled = active & (kind == TABLED)
            places = dr.gather(mi.Vector4u, self.table.optics.places, s, tabled)
            w = total_variable(dr.select(total, sin2_t, 2), eta, cos_i)
            x = dr.select(total, w, dr.select(eta <= 1, cos_i, cos_t))
            start, last = dr.select(total, places.z, places.x), dr.select(total, places.w, places.y)
            x = x * mi.Float64(last)
            node = dr.minimum(mi.UInt32(dr.detach(x)), last - 1)
            fraction = x - mi.Float64(node)

            still = dr.detach(fraction)

            def value(k: mi.UInt32, channel: mi.UInt32) -> mi.Float64:
                index = batch * self._row_stride + TABLE_CHANNELS * (start + k) + channel
                return dr.gather(mi.Float64, self._rows, index, tabled)

            def read(channel: mi.UInt32) -> mi.Float64:
                # Between the nodes the value is linear as in the kernel. Its slope has an error of first order in the
                # spacing; central differences, interpolated between the nodes, have one of second order
                low, high = value(node, channel), value(node + 1, channel)
                before, after = dr.maximum(node, 1) - 1, dr.minimum(node + 2, last)
                slopes = (
                    (dr.detach(high) - dr.detach(value(before, channel))) / mi.Float64(node + 1 - before),
                    (dr.detach(value(after, channel)) - dr.detach(low)) / mi.Float64(after - node),
                )
                return dr.lerp(low, high, still) + dr.lerp(*slopes, still) * (fraction - still)

            side = dr.select(from_front, mi.UInt32(REFLECTION_FRONT), mi.UInt32(REFLECTION_BACK))
            R = dr.select(tabled, read(side), R)
            T = dr.select(tabled, read(mi.UInt32(TRANSMISSION)), T)
        return R, dr.select(total | opaque, 0, T), cos_t, eta

    # ---- results

    def derivatives(self) -> Derivatives:
        """Return the requested derivatives of the metric accumulated so far, by batch of start rays."""
        found = Derivatives()
        for name, sums in self._by_source.items():
            found.sources.append((self._start.emitter, name, np.array(sums)))
        if self.request.geometry:
            found.geometry = np.zeros((BATCHES, self.count, len(GEOMETRY)))
            for rows in (self._shape, self._rims):
                for name, values in rows.gradient().items():
                    found.geometry[:, :, GEOMETRY.index(name)] = values
        if self.request.indices:
            found.indices = np.array(dr.grad(self._indices)).reshape(BATCHES, self.count, 2)
        if self.request.rows:
            found.rows = np.zeros((BATCHES, self.table.optics.rows, CHANNELS))
            found.rows[:, :, :TABLE_CHANNELS] = np.array(dr.grad(self._rows)).reshape(BATCHES, -1, TABLE_CHANNELS)
            ideal = np.array(dr.grad(self._ideal)).reshape(BATCHES, self.count, 2)
            for s, place in enumerate(self.table.optics.host_places):
                if int(self.table.optics.host_words[s]) & 3 == IDEAL:
                    found.rows[:, place[0], [REFLECTION_FRONT, TRANSMISSION]] += ideal[:, s]
        return found


@dataclass
class SurfaceNumbers:
    """
    Differentiable numbers of all surfaces: geometry, refractive indices, R and T of coatings.

    Attributes
    ----------
    geometry : (surfaces, len(GEOMETRY)) float64
        Columns of `mistray.surfaces.gradient_columns.GEOMETRY`, in their units.
    indices : (surfaces, 2) float64
        Refractive indices in front and behind.
    rows : (rows, TABLE_CHANNELS) float64
        Rows of the tables of R and T.
    ideal : (surfaces, 2) float64
        R and T of ideal coatings.
    """

    geometry: np.ndarray
    indices: np.ndarray
    rows: np.ndarray
    ideal: np.ndarray


def numbers_of(table: SurfaceTable) -> SurfaceNumbers:
    """Return the present differentiable numbers of the surfaces of a table, in float64."""
    geometry = np.zeros((table.count, len(GEOMETRY)))
    for piece in table.pieces:
        for name, value in piece.columns.items():
            geometry[piece.index, GEOMETRY.index(name)] = value
    optics = table.optics
    rows = np.array(optics.table, dtype=np.float64).reshape(-1, 4)[:, :TABLE_CHANNELS]
    # The kernel's rows are float32; slopes are differences of neighbours, and need the host's float64
    for known, (first, _, total, _) in zip(optics.tables, optics.host_places, strict=True):
        if known is not None:
            for place, part in ((first, known.refraction), (total, known.total)):
                rows[place : place + len(part)] = part[:, :, 0]
    return SurfaceNumbers(geometry, optics.host_indices[:, :2].copy(), rows, optics.host_indices[:, 2:].copy())

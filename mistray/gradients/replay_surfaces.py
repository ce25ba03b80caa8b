"""
Surfaces for recorded events: the hit, Snell's law, R and T, and derivatives with respect to surface parameters.

The kernel looks for the next surface and keeps no derivatives. Here the surface is known, and so is the place x of the
hit. In the frame of the surface let F(x) = 0 be its implicit equation, g = ½∇F, H = ½∇∇F, n = ±g/|g| the normal on the
side of transmission, d the direction of the ray and t its length. Let λ_x, λ_d, λ_n and λ_t be the derivatives of a
function of the event with respect to x, d, n and t, found by Dr.Jit. With the part λ of λ_n across n, the adjoints are

    ν = (n · g) λ/|g|²                                of g
    β = -((λ_x + Hν) · d + λ_t)/(2 g · d)             of F, as ∇F · dx + dF = 0 along the ray
    p = Hν + 2βg,   λ_x + p,   λ_d + t (λ_x + p)      of motions of the surface (less), of the origin and of d

A parameter of the shape gets β ∂F + ν · ∂g, a displacement of the surface -p, and a rotation n × λ - x × p. Sources: A.
Griewank and A. Walther, Evaluating Derivatives, 2nd ed., 2008, chapter 3; and the implicit function theorem. In the
code F is `value`, g `gradient`, ν `by_gradient` and β `by_value`.

A surface computes in float32 or in float64; derivatives are summed in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import RANDOM_TRANSMITTED, TOTAL, TRANSMITTED, kind_of, place_of, stays
from mistray.gradients.number_rows import NumberRows, derived, tracked
from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.replayed_event import Hit, ReplayedEvent
from mistray.gradients.surface_numbers import (
    TABLE_CHANNELS,
    AsphericTerms,
    SurfaceNumbers,
    numbers_of,
    of_four,
    proportions,
    row_slopes,
)
from mistray.gradients.table_gradient import Derivatives, GradientRequest
from mistray.physics.fresnel import reflectance
from mistray.recorders.adjoint import CHANNELS
from mistray.recorders.branch_recorder import Node
from mistray.sampling.source import SceneSource
from mistray.settings import BATCHES
from mistray.surfaces.gradient_columns import COEFFICIENTS, GEOMETRY, OWN, POSE, RIM_COLUMNS, SHAPE_COLUMNS
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


def _backward(value: Any, adjoint: Any, keep: bool = False) -> None:
    """
    Propagate the adjoint of a value, if it depends on tracked inputs, back to them.

    `keep` keeps the graph for another value.
    """
    if dr.grad_enabled(value):
        dr.set_grad(value, adjoint)
        dr.enqueue(dr.ADMode.Backward, value)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearInterior if keep else dr.ADFlag.Default)


class ReplaySurfaces:
    """
    Differentiable copy of all surfaces: geometry, refractive indices, R and T of coatings.

    Derivatives are kept for each batch of start rays.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces at the wavelength.
    request : GradientRequest
        Requested derivatives.
    moved : SurfaceNumbers, optional
        Geometry, indices, R and T of the surfaces, if not the present ones.
    start : SceneSource or int, optional
        Source of the rays, or the surface from which backward rays start; None: the start does not move.
    real : type, optional
        Type of the values, ``mi.Float`` or, by default, ``mi.Float64``; derivatives are summed in float64.

    Attributes
    ----------
    vector : type
        Type of vectors of such values.
    count : int
        Number of surfaces.
    """

    def __init__(
        self,
        table: SurfaceTable,
        request: GradientRequest,
        moved: SurfaceNumbers | None = None,
        start: SceneSource | int | None = None,
        real: Any = None,
    ) -> None:
        self.table, self.request = table, request
        self.real = mi.Float64 if real is None else real
        self.vector = mi.Vector3f if self.real is mi.Float else mi.Vector3d
        self._start: Any = start
        moving = sorted(request.sources & {*start.moving}) if isinstance(start, SceneSource) else ()
        self._by_source = {name: dr.zeros(mi.Float64, BATCHES) for name in moving}
        self.count = table.count
        self._surfaces = dr.opaque(mi.UInt32, self.count)
        # Shapes and rims; `_still` has no derivatives, and reads fewer columns
        numbers = numbers_of(table) if moved is None else moved
        self._scales, per_area = proportions(table)
        geometry = numbers.geometry * self._scales
        self._per_area = upload(self.real, per_area)
        self._still = NumberRows(geometry, SHAPE_COLUMNS, real=self.real)
        self._shape, self._rims = (
            NumberRows(geometry, columns, request.geometry, self.real) for columns in (SHAPE_COLUMNS, RIM_COLUMNS)
        )
        # Indices, rows of the tables of R and T, ideal coatings; zeros that carry the derivatives by batch
        optics = table.optics
        indices, rows, ideal = numbers.indices, numbers.rows, numbers.ideal
        self._indices, self._ideal = upload(self.real, indices), upload(self.real, ideal)
        self._rows = upload(self.real, np.hstack([of_four(rows), of_four(row_slopes(optics, rows))]))
        self._by_index = tracked(BATCHES * indices.size) if request.indices else None
        self._by_row = tracked(BATCHES * rows.size) if request.rows else None
        self._by_ideal = tracked(BATCHES * ideal.size) if request.rows else None
        self._row_stride = dr.opaque(mi.UInt32, rows.size)
        # Frames
        self._rotations = upload(self.real, table.rotations)
        # Vertices, and the sign of ∇F · n
        places = np.column_stack([table.vertices - table.centre, np.full(self.count, -1.0)])
        for piece in table.pieces:
            places[piece.index, 3] = piece.sign
        self._places = upload(self.real, places)
        self._extinction = upload(self.real, np.array(optics.extinction))

    # ---- numbers

    def _sides(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> list[Any]:
        """Return the real indices in front of and behind the surfaces s, differentiable if so requested."""
        sides = [dr.gather(self.real, self._indices, 2 * s + side, active) for side in range(2)]
        if self._by_index is None:
            return sides
        row = batch * self._surfaces + s
        return [derived(value, self._by_index, 2 * row + side, active) for side, value in enumerate(sides)]

    def to_world(self, v: mi.Vector3d, s: mi.UInt32, active: mi.Bool, inverse: bool = False) -> mi.Vector3d:
        """Return vectors turned from the frames of surfaces s, held fixed, to the world; `inverse`: the other way."""
        if not self.table.rotated:
            return v
        m = [dr.gather(self.real, self._rotations, 9 * s + k, active) for k in range(9)]
        rows = [m[k::3] for k in range(3)] if inverse else [m[3 * k : 3 * k + 3] for k in range(3)]
        return self.vector(*(row[0] * v.x + row[1] * v.y + row[2] * v.z for row in rows))

    def to_local(self, v: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return vectors turned from the world into the frames of the surfaces s; the inverse of `to_world`."""
        return self.to_world(v, s, active, inverse=True)

    def vertex(self, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the vertices of the surfaces s, mm, relative to the centre of the scene."""
        return self.vector(*list(self._place(s, active))[:3])

    def _place(self, s: mi.UInt32, active: mi.Bool) -> mi.Vector4d:
        four = mi.Vector4f if self.real is mi.Float else mi.Vector4d
        return dr.gather(four, self._places, s, active)

    def extinction(self, medium: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """Return the extinction coefficients of media, absorption and scatter, 1/mm."""
        return dr.gather(self.real, self._extinction, medium, active)

    # ---- geometry

    def followed(
        self, o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64, code: mi.UInt32, batch: mi.UInt32, active: mi.Bool
    ) -> ReplayedEvent:
        """
        Return the events of rays at surfaces given by event codes, with hits recomputed near the distances t, mm.

        Parameters
        ----------
        o, d : mi.Vector3d
            Origin (mm, relative to the centre of the scene) and unit direction in the world.
        t : mi.Float64
            Distance of a point near the hit, mm.
        code, batch : mi.UInt32
            Events, see `mistray.events`, and batches of the start rays.
        active : mi.Bool
            Lanes that have an event.
        """
        s = place_of(code)
        # Ray in the frame of the surface; to first order in the rotation
        numbers = self.numbers(s, batch, active)
        shift, turn = self.pose(numbers)
        local = self.to_local(d, s, active)
        p, along = self._at_rest(self.local_point(o, s, active), shift, turn), local - dr.cross(turn, local)
        # Two Newton steps from the float32 point, with its error of 1e-6
        for _ in range(2):
            value, gradient = self.implicit(p + t * along, numbers)
            step = 0.5 * value / dr.dot(gradient, along)
            t = t - dr.select(active & dr.isfinite(step), step, 0)
        q = p + t * along
        axis, from_front = self.axis(self.implicit(q, numbers)[1], along, s, active)
        hit = Hit(
            q + dr.cross(turn, q) + shift, local, axis + dr.cross(turn, axis), t, shift, turn, from_front=from_front
        )
        return self.event(hit, code, batch, active)

    def axis(self, gradient: mi.Vector3f, d: mi.Vector3f, s: mi.UInt32, active: mi.Bool) -> tuple[Any, mi.Bool]:
        """
        Return unit normals on the side that light along d is transmitted to, and a mask of light from the front.

        `gradient` of F and `d` are in the frames of the surfaces s, and so are the normals.
        """
        normal = dr.normalize(gradient) * self._place(s, active).w
        from_front = dr.dot(d, normal) > 0
        return dr.select(from_front, normal, -normal), from_front

    def event(self, hit: Hit, code: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> ReplayedEvent:
        """
        Return the events at hits, differentiable with respect to the values in `hit` and to indices, R and T.

        `code` and `batch` are as in `followed`.
        """
        s, what = place_of(code), kind_of(code)
        transmitted, scattered = what == TRANSMITTED, what >= RANDOM_TRANSMITTED
        d, axis, shift, turn = hit.d, hit.axis, hit.shift, hit.turn
        cos_i = dr.dot(d, axis)
        word = dr.gather(mi.UInt32, self.table.optics.words, s, active)
        R, T, cos_t, eta = self._coated(s, word, hit.from_front, cos_i, what == TOTAL, batch, active)
        # Reflection and Snell's law
        after = dr.select(transmitted, eta * d + (cos_t - eta * cos_i) * axis, d - 2 * cos_i * axis)
        return ReplayedEvent(
            s,
            batch,
            stays(code),
            hit.from_front,
            d - dr.cross(turn, d),
            axis - dr.cross(turn, axis),
            cos_i,
            cos_t,
            eta,
            R,
            T,
            lambda side, cos_i: self._coated(s, word, side, cos_i, mi.Bool(False), batch, active)[:2],
            q=self._at_rest(hit.x, shift, turn),
            active=active,
            length=hit.length,
            turn=turn,
            p=self.to_world(hit.x, s, active) + self.vertex(s, active),
            scattered=scattered,
            heading=self.to_world(after, s, active),
        )

    def differentiate(
        self, origin: mi.Vector3f, node: Node, batch: mi.UInt32, active: mi.Bool, gain: Callable[[ReplayedEvent], Any]
    ) -> tuple[mi.Vector3f, mi.Vector3f, Any]:
        """
        Add derivatives of a function of recorded events to the sums for the parameters of the surfaces.

        Parameters
        ----------
        origin : mi.Vector3f
            Origins of the segments that lead to the events, mm, relative to the centre of the scene.
        node : Node
            Recorded events.
        batch : mi.UInt32
            Batches of the start rays.
        active : mi.Bool
            Lanes that have an event.
        gain : callable
            (event) → value of the function, differentiable, one for each lane.

        Returns
        -------
        by_o, by_d : mi.Vector3f
            Derivatives of the values by the origins (per mm) and unit directions of the segments, in the world frame.
        value : mi.Float or mi.Float64
            Values of the function.
        """
        s = place_of(node.code)
        with dr.resume_grad():
            rows = self._shape.read(s, batch, active)
            # Surface: F and ½∇F, with derivatives by the hit x and by the numbers of the shape
            leaves = {name: dr.detach(number) for name, number in rows.items()}
            x = self.local_point(self.vector(node.p), s, active)
            dr.enable_grad(x, *(leaves[name] for name in self._shape.moving))
            value, gradient = self.implicit(x, self._named(leaves, self._shape, s, active))
            # Event, with derivatives by hit, direction, normal, length and pose
            point, g = dr.detach(x), dr.detach(gradient)
            d, length = self.to_local(self.vector(node.d), s, active), dr.norm(self.vector(node.p) - origin)
            axis, from_front = self.axis(g, d, s, active)
            still = dr.zeros(self.vector, dr.width(s)), dr.zeros(self.vector, dr.width(s))
            parts = [self.vector(point), self.vector(d), self.vector(axis), self.real(length), *still]
            dr.enable_grad(parts)
            event = self.event(Hit(*parts, from_front=from_front), node.code, batch, active)
            gained = gain(event)
            _backward(gained, dr.select(active, type(gained)(1), 0))
            by_x, by_d, by_axis, by_length, by_shift, by_turn = map(dr.grad, parts)
            # Normal n = ±∇F/|∇F|: its adjoint across n is that of ½∇F, which leads to x by the Hessian
            across = by_axis - dr.dot(by_axis, axis) * axis
            by_gradient = dr.dot(axis, g) / dr.squared_norm(g) * across
            _backward(gradient, by_gradient, keep=True)
            bent = self.vector(dr.grad(x))
            # Distance t along the ray: ∇F · dx + dF = 0 on the moved surface
            by_value = -0.5 * (dr.dot(by_x + bent, d) + by_length) / dr.dot(g, d)
            by_value = dr.select(active & dr.isfinite(by_value), by_value, 0)
            _backward(value, by_value)
            pushed = bent + 2 * by_value * g
            by_o = by_x + pushed
            # The surface moves against the hit, and the normal turns with it. About its axis a surface of revolution
            # turns into itself: the terms cancel, but for rounding
            turned = dr.cross(axis, across) - dr.cross(point, pushed)
            turned.z = dr.select(self.table.families.holds(s, active), turned.z, 0)
            moves = [*(by_shift - pushed), *(by_turn + turned)]
            for name in self._shape.moving:
                by_number = moves[POSE.index(name)] if name in POSE else dr.grad(leaves[name])
                dr.accum_grad(rows[name], by_number)
            dr.enqueue(dr.ADMode.Backward, [rows[name] for name in self._shape.moving])
            dr.traverse(dr.ADMode.Backward)
        return self.to_world(by_o, s, active), self.to_world(by_d + length * by_o, s, active), dr.detach(gained)

    def media(self, p: mi.Vector3d, d: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        """
        Return the indices of the media on either side of surfaces s, for rays along d that meet them at p, mm.

        The medium on the side of incidence comes first. `p`, relative to the centre of the scene, and `d` are in the
        world.
        """
        numbers = self.numbers(s, mi.UInt32(0), active, still=True)
        _, gradient = self.implicit(self.local_point(self.vector(p), s, active), numbers)
        cosine = dr.dot(self.to_local(self.vector(d), s, active), gradient) * self._place(s, active).w
        word = dr.gather(mi.UInt32, self.table.optics.words, s, active)
        front, back = ((word >> place) & MEDIUM_MASK for place in (FRONT_MEDIUM_SHIFT, BACK_MEDIUM_SHIFT))
        return dr.select(cosine > 0, front, back), dr.select(cosine > 0, back, front)

    def numbers(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool, still: bool = False) -> dict[str, Any]:
        """Return shape parameters of surfaces s, such as curvature, 1/mm; derivatives by `batch`, none if `still`."""
        rows = self._still if still else self._shape
        return self._named(rows.read(s, batch, active), rows, s, active)

    def _named(self, columns: dict[str, Any], rows: NumberRows, s: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """Return shape parameters of the surfaces s with the further values that `implicit` needs, by name."""
        numbers = dict(columns)
        numbers["cone"] = self._place(s, active).w > 0
        numbers["families"] = [
            (here, family, dict(zip(family.numbers, (numbers[name] for name in OWN), strict=False)))
            for here, family in self.table.families.members(s, active)
        ]
        # Coefficients up to the last one that is used at any surface
        for key, some in (("coefficients", rows), ("still", self._still)):
            known = [order for order, name in enumerate(COEFFICIENTS, 1) if name in some.names]
            numbers[key] = [numbers[name] for name in COEFFICIENTS[: max(known, default=0)]]
        if numbers["coefficients"]:
            numbers["per_area"] = dr.gather(self.real, self._per_area, s, active)
        return numbers

    def implicit(self, q: mi.Vector3d, n: dict[str, Any]) -> tuple[mi.Float64, mi.Vector3d]:
        """
        Return the implicit function F, zero on the surface, and half its gradient, in the surface's own frame.

        A conic of curvature c and conic constant k has F = c (x² + y² + (1 + k) z²) - 2z. An asphere replaces z by z
        less the polynomial terms, which needs no root. A cone or tube of radius ρ(z) has F = x² + y² - ρ², any other
        surface the residual of its family.
        """
        c, k1, coefficients = n["curvature"], 1 + n["conic"], n["coefficients"]
        r2 = q.x * q.x + q.y * q.y
        z, bend = q.z, self.real(0)
        if coefficients:
            terms = r2, coefficients, n["still"], n["per_area"]
            z = z - dr.custom(AsphericTerms, *terms, False)
            bend = 2 * dr.custom(AsphericTerms, *terms, True)
        radius = n["r0"] + n["slope"] * q.z
        cone = n["cone"]
        along = c * k1 * z - 1
        across = c - along * bend
        value = dr.select(cone, r2 - radius * radius, c * (r2 + k1 * z * z) - 2 * z)
        gradient = self.vector(
            dr.select(cone, q.x, across * q.x),
            dr.select(cone, q.y, across * q.y),
            dr.select(cone, -n["slope"] * radius, along),
        )
        for here, family, own in n["families"]:
            value = dr.select(here, family.residual(*q, own), value)
            gradient = dr.select(here, 0.5 * self.vector(*family.gradient(*q, own)), gradient)
        return value, gradient

    def local_point(self, p: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return points, mm, relative to the centre of the scene, in the frames of the surfaces s, held fixed."""
        return self.to_local(p - self.vertex(s, active), s, active)

    def rims(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """Return radii, half sides and ends of the surfaces s, mm, by the names of `RIM_COLUMNS`; 0 for none."""
        return self._rims.read(s, batch, active)

    def rim_distances(self, q: mi.Vector3d, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> list[mi.Float64]:
        """
        Return distances of points q in the surfaces' frames from the rims, mm, as in `RIM_COLUMNS`; ≥ 0 inside.

        Distances from rims that a surface does not have mean nothing.
        """
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
        Return distances of points p, mm, from the unbounded surfaces s, mm, and the unit gradients of F in the world.

        The distance is F/|∇F|, positive on the side that the gradient points to. It is infinite next to the far half of
        a quadric, which is not part of the surface. Points are relative to the centre of the scene.
        """
        numbers = self.numbers(s, mi.UInt32(0), active, still=True)
        value, gradient = self.implicit(self.local_point(p, s, active), numbers)
        length = dr.norm(gradient)
        here = numbers["cone"] | (gradient.z < 0)
        return dr.select(here, 0.5 * value / length, dr.inf), self.to_world(gradient / length, s, active)

    def distance_from(self, p: mi.Vector3d, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """Return distances F/|∇F|, mm, of points p (see `sheet`) from nearby surfaces s, differentiable."""
        numbers = self.numbers(s, batch, active)
        q = self._at_rest(self.local_point(p, s, active), *self.pose(numbers))
        value, gradient = self.implicit(q, numbers)
        return value / dr.detach(2 * dr.norm(gradient))

    def pose(self, numbers: dict[str, Any]) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Return displacement, mm, and rotation vector, rad, of surface frames from their shape parameters."""
        shift, turn = (self.vector(*(numbers[prefix + axis] for axis in "xyz")) for prefix in ("", "tilt_"))
        return shift, turn

    @staticmethod
    def _at_rest(q: mi.Vector3d, shift: mi.Vector3d, turn: mi.Vector3d) -> mi.Vector3d:
        """Return points, mm, in frames displaced (mm) and slightly rotated (rad) from the given ones."""
        q = q - shift
        return q - dr.cross(turn, q)

    def move_start(self, rays: RecordedRays, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """
        Add the derivatives that come from moving ray starts; none if the start does not move.

        They are those with respect to parameters of the source, or to the pose of the surface that backward rays start
        from. `by_o` and `by_d` are the derivatives of the metric with respect to origins, per mm, and directions, in
        the world.
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
            shift, turn = self.pose(self.numbers(s, rays.batch, active))
            q, along = self.local_point(self.vector(rays.o), s, active), self.to_local(self.vector(rays.d), s, active)
            moved = self.to_world(shift + dr.cross(turn, q), s, active)
            turned = self.to_world(dr.cross(turn, along), s, active)
            value = dr.dot(by_o, moved) + dr.dot(by_d, turned)
            if dr.grad_enabled(value):
                dr.set_grad(value, dr.select(active, self.real(1), 0))
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
        """
        Return R and T of coatings (means of s and p), the cosine of refraction, and n_i/n_t.

        In total reflection T and the cosine are 0; an opaque surface has T = 0. `word` is that of the surface in
        `Optics.words`, `cos_i` the cosine of incidence, and `known_total` is True where total reflection was recorded.
        """
        front, back = self._sides(s, batch, active)
        n_i, n_t = dr.select(from_front, front, back), dr.select(from_front, back, front)
        # Refraction
        eta = n_i / n_t
        sin2_t = eta * eta * (1 - cos_i * cos_i)
        opaque = (word & OPAQUE) != 0
        total = known_total | ((dr.detach(sin2_t) >= 1) & ~opaque)
        cos_t = dr.select(total, 0, dr.sqrt(dr.maximum(dr.select(total, self.real(1), 1 - sin2_t), 1e-24)))
        # Coating: bare interface, ideal, or from the table of the run
        kind, kinds = word & 3, self.table.optics.kinds
        R, T = self.real(0), self.real(0)
        if FRESNEL in kinds:
            bare = reflectance(cos_i, cos_t, n_i, n_t)
            R, T = bare, 1 - bare
        if IDEAL in kinds:
            ideal = active & (kind == IDEAL)
            own = [dr.gather(self.real, self._ideal, 2 * s + k, ideal) for k in range(2)]
            if self._by_ideal is not None:
                row = batch * self._surfaces + s
                own = [derived(value, self._by_ideal, 2 * row + k, ideal) for k, value in enumerate(own)]
            R = dr.select(ideal, dr.select(total, own[0] + own[1], own[0]), R)
            T = dr.select(ideal, own[1], T)
        if TABLED in kinds:
            tabled = active & (kind == TABLED)
            places = dr.gather(mi.Vector4u, self.table.optics.places, s, tabled)
            w = total_variable(dr.select(total, sin2_t, 2), eta, cos_i)
            x = dr.select(total, w, dr.select(eta <= 1, cos_i, cos_t))
            start, last = dr.select(total, places.z, places.x), dr.select(total, places.w, places.y)
            x = x * self.real(last)
            node = dr.minimum(mi.UInt32(dr.detach(x)), last - 1)
            fraction = x - self.real(node)
            still = dr.detach(fraction)
            # Between the nodes the value is linear as in the kernel. Its slope has an error of first order in the
            # spacing; central differences, interpolated between the nodes, have one of second order
            ends = [self._row(start + node + k, tabled) for k in range(2)]

            def read(channel: mi.UInt32, values: Callable[[Any], Any]) -> Any:
                low, high = (values(end) for end, _ in ends)
                if self._by_row is not None:
                    index = batch * self._row_stride + TABLE_CHANNELS * (start + node) + channel
                    low = derived(low, self._by_row, index, tabled)
                    high = derived(high, self._by_row, index + TABLE_CHANNELS, tabled)
                slope = dr.lerp(*(values(slopes) for _, slopes in ends), still)
                return dr.lerp(low, high, still) + slope * (fraction - still)

            side = dr.select(from_front, mi.UInt32(REFLECTION_FRONT), mi.UInt32(REFLECTION_BACK))
            R = dr.select(tabled, read(side, lambda row: dr.select(from_front, row.x, row.y)), R)
            T = dr.select(tabled, read(mi.UInt32(TRANSMISSION), lambda row: row.z), T)
        return R, dr.select(total | opaque, 0, T), cos_t, eta

    def _row(self, row: mi.UInt32, active: mi.Bool) -> tuple[Any, Any]:
        """Return R from the front, R from the back and T at rows of coating tables, and the change of each per row."""
        four = mi.Vector4f if self.real is mi.Float else mi.Vector4d
        values, slopes = (dr.gather(four, self._rows, 2 * row + k, active) for k in range(2))
        return values, slopes

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
            found.geometry *= self._scales
        if self._by_index is not None:
            found.indices = np.array(dr.grad(self._by_index)).reshape(BATCHES, self.count, 2)
        if self._by_row is not None:
            found.rows = np.zeros((BATCHES, self.table.optics.rows, CHANNELS))
            found.rows[:, :, :TABLE_CHANNELS] = np.array(dr.grad(self._by_row)).reshape(BATCHES, -1, TABLE_CHANNELS)
            ideal = np.array(dr.grad(self._by_ideal)).reshape(BATCHES, self.count, 2)
            for s, place in enumerate(self.table.optics.host_places):
                if int(self.table.optics.host_words[s]) & 3 == IDEAL:
                    found.rows[:, place[0], [REFLECTION_FRONT, TRANSMISSION]] += ideal[:, s]
        return found

"""Jumps in contribution without a rim: silhouettes of curved surfaces, and the onset of total reflection.

A ray that just touches a curved surface either meets it or goes past. A real interface reflects everything at grazing
incidence, so that both have the same contribution. A wall, and an ideal coating whose R and T are the same at every
angle, make a jump. So does an ideal coating at the critical angle. Both are treated like rims (see
`mistray.gradients.edges`), with

    Δ = cos²θ / (2 κ)      depth of the ray below the surface that it cuts, mm
    Δ = cos²θ_t            margin from the critical angle

θ and θ_t are the angles of incidence and of refraction, κ is the curvature along the ray, 1/mm. The contribution of a
ray varies with cos θ, that is with √Δ, so the boundary kernel over 0 … ε is the one that is exact for it:
k = (9 - 12 √(Δ/ε))/ε,  ∫ k dΔ = 1,  ∫ k √Δ dΔ = 0.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.gradients.scatter_replay import ScatterEvent
from mistray.kernel.interaction import Interaction
from mistray.physics.geometry.sag import sag_derivative
from mistray.surfaces.gradient_columns import RIM_COLUMNS
from mistray.surfaces.optics import ASPHERIC, IDEAL, OPAQUE
from mistray.surfaces.surface import ENDS, RECTANGLE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

SILHOUETTE, CRITICAL = len(RIM_COLUMNS), len(RIM_COLUMNS) + 1  # numbers that follow those of rims
ZONE = 1.0  # zone in the square of the cosine, in units of the width of the zones at rims
NEARBY = 0.01  # step along the ray of an asphere, in units of its size
CLOSE_BY = 1e-3  # step along the ray of an implicit surface, in units of its size
FLAT = 1e-6  # curvature along the ray in units of that of the aperture, below which there is no silhouette


def grazing_kernel(delta: Any, width: Any) -> Any:
    """
    Return the one-sided boundary kernel at a distance Δ from a silhouette or critical angle.

    It is in the inverse of Δ's unit, and 0 beyond its width.
    """
    return dr.select(delta < width, (9 - 12 * dr.sqrt(delta / width)) / width, 0)


def jump_distance(at: ScatterEvent, kind: mi.UInt32, scale: mi.Float64) -> mi.Float64:
    """
    Return the distances Δ of hits from silhouettes, mm, or from the critical angle, dimensionless, as `kind` says.

    They are differentiable. The local radius of curvature `scale`, mm, is held fixed.
    """
    cosine2 = at.cos_i * at.cos_i
    margin = 1 - at.eta * at.eta * (1 - cosine2)
    return dr.select(kind == SILHOUETTE, 0.5 * scale * cosine2, margin)


class Grazing:
    """
    Search for hits close to silhouettes or to the critical angle, in the kernel.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    width : float
        Width of the zones at rims, in units of their radii.

    Attributes
    ----------
    zone : mi.Float
        Square of the cosine below which a hit is close to a jump: of the angle of incidence at silhouettes, of the
        angle of refraction at the critical angle.
    """

    def __init__(self, table: SurfaceTable, width: float) -> None:
        self._table = table
        self.zone = dr.opaque(mi.Float, ZONE * width)
        # Reach of each surface, its size, and the coordinate of the reach
        extents = np.zeros((table.count, 4))
        for piece in table.pieces:
            extents[piece.index] = *piece.reach, piece.size, piece.rim_coordinate
        self._rectangles = bool(np.any(extents[:, 3] == RECTANGLE))
        self._extents = upload(mi.Float, extents)

    def find(
        self, s: mi.UInt32, it: Interaction, d: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.UInt32, mi.Float, mi.Float, mi.Bool]:
        """
        Return the silhouette or critical angle that each hit is close to, if any, and its distance from it.

        Parameters
        ----------
        s : mi.UInt32
            Indices of the surfaces.
        it : Interaction
            Interaction at the hits.
        d : mi.Vector3f
            Direction of arrival.
        active : mi.Bool
            Lanes that take part.

        Returns
        -------
        kind : mi.UInt32
            `SILHOUETTE` or `CRITICAL`; like `delta` and `scale` valid where `near` only.
        delta : mi.Float
            Distance Δ from the jump, in mm or dimensionless.
        scale : mi.Float
            Radius of curvature along the ray (mm), or n_i/n_t.
        near : mi.Bool
            Whether Δ is within the zone.
        """
        # Silhouettes: curvature along the ray, to second order
        ideal, opaque = (it.word & 3) == IDEAL, (it.word & OPAQUE) != 0
        steep = active & (dr.square(it.cos_i) < self.zone) & (ideal | opaque)
        local = self._table.frame(s, steep).inward(d)
        extent = dr.gather(mi.Vector4f, self._extents, s, steep)
        along, bend, length = self._second_order(s, it.local, local, it.word, extent.z, steep)
        radius = length / dr.abs(bend)
        # The ray comes out again on the side of incidence, and the surface exists where the ray is deepest below it
        turning = -along / bend
        there = it.local + turning * local
        place = dr.select(extent.w == ENDS, there.z, dr.sqrt(dr.fma(there.x, there.x, there.y * there.y)))
        for here, family in self._table.families.members(s, steep):
            numbers = self._table.families.numbers(family, s, here)
            place = dr.select(here, family.coordinate(*there, numbers), place)
        inside = (place > extent.x) & (place < extent.y)
        if self._rectangles:
            half = dr.gather(mi.Vector2f, self._table.clip, s, steep)
            inside &= (extent.w != RECTANGLE) | ((dr.abs(there.x) < half.x) & (dr.abs(there.y) < half.y))
        grazes = steep & inside & (turning > 0) & (dr.abs(bend) * extent.z > FLAT * length)
        # Critical angle
        margin = 1 - dr.square(it.eta) * (1 - dr.square(it.cos_i))
        critical = active & ~grazes & ideal & ~opaque & ~it.tir & (it.eta > 1) & (margin < self.zone)
        return (
            dr.select(grazes, mi.UInt32(SILHOUETTE), CRITICAL),
            dr.select(grazes, 0.5 * dr.square(it.cos_i) * radius, margin),
            dr.select(grazes, radius, it.eta),
            grazes | critical,
        )

    def _second_order(
        self, s: mi.UInt32, q: mi.Vector3f, d: mi.Vector3f, word: mi.UInt32, outer: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """
        Expand the implicit function F along rays at their hits: F(q + t d) = 2 t along + t² bend, to second order.

        q is the hit, mm, and d the direction, both in the frame of the surface; `outer` is the size of the surface, mm.
        `word` holds the flags of its optics.

        Returns
        -------
        along, bend : mi.Float
            Coefficients of the expansion.
        length : mi.Float
            Length of ½∇F at q.
        """
        table = self._table
        # Quadrics: exact
        quadric = dr.gather(mi.Vector4f, table.quadric, s, active)
        a, b, e = quadric.x, quadric.y, quadric.z
        g = mi.Vector3f(a * q.x, a * q.y, dr.fma(b, q.z, 0.5 * e))
        along, bend = dr.dot(g, d), a * (d.x * d.x + d.y * d.y) + b * d.z * d.z
        length = dr.norm(g)
        # Aspheres, then implicit surfaces: differences of the gradient along the ray
        if table.coefficient_count:
            aspheric = active & ((word & ASPHERIC) != 0)
            shape = table.asphere_sag(s, aspheric)

            def slope(t: mi.Float) -> tuple[mi.Float, mi.Float]:
                x, y = dr.fma(t, d.x, q.x), dr.fma(t, d.y, q.y)
                steepness = 2 * sag_derivative(dr.fma(x, x, y * y), *shape)
                return steepness * (x * d.x + y * d.y) - d.z, steepness

            h = NEARBY * outer
            (before, _), (here, steepness), (after, _) = slope(-h), slope(mi.Float(0)), slope(h)
            usable = aspheric & dr.isfinite(before) & dr.isfinite(after)
            along = dr.select(aspheric, here, along)
            bend = dr.select(aspheric, dr.select(usable, (after - before) / (2 * h), 0), bend)
            size = dr.sqrt(dr.fma(dr.square(steepness), q.x * q.x + q.y * q.y, 1))
            length = dr.select(aspheric, size, length)
        for here, family in table.families.members(s, active):
            numbers, h = table.families.numbers(family, s, here), CLOSE_BY * outer
            before, at, after = (mi.Vector3f(*family.gradient(*(q + t * d), numbers)) for t in (-h, mi.Float(0), h))
            along = dr.select(here, 0.5 * dr.dot(at, d), along)
            bend = dr.select(here, 0.25 * dr.dot(after - before, d) / h, bend)
            length = dr.select(here, 0.5 * dr.norm(at), length)
        return along, bend, length

"""What happens to light at a point of a surface: normal, Snell's law, R and T."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mistray.physics.fresnel import reflectance
from mistray.physics.sag import sag, sag_derivative
from mistray.trace.surfaces import (
    ASPHERIC,
    BACK_MEDIUM_SHIFT,
    FRESNEL,
    FRONT_MEDIUM_SHIFT,
    MEDIUM_MASK,
    MIRROR,
    OPAQUE,
    POLYNOMIAL_VECTORS,
    TABLE_NODES,
    TABLED,
    SurfaceTable,
)


@dataclass
class Interaction:
    """
    Outcome at a node of the ray tree.

    Attributes
    ----------
    p : mi.Vector3f
        The point, moved onto the surface, mm.
    reflected, transmitted : mi.Vector3f
        Unit directions.
    R, T : mi.Float
        Specular shares of the flux; what is left is absorbed. Total internal reflection has T = 0.
    tir : mi.Bool
        Total internal reflection.
    word : mi.UInt32
        The surface's description (flags of `mistray.trace.surfaces`).
    medium_in, medium_out : mi.UInt32
        Numbers of the materials on the side of incidence and on the other; 0 where any will do.
    local : mi.Vector3f
        The point in the surface's own frame, mm.
    """

    p: mi.Vector3f
    reflected: mi.Vector3f
    transmitted: mi.Vector3f
    R: mi.Float
    T: mi.Float
    tir: mi.Bool
    word: mi.UInt32
    medium_in: mi.UInt32
    medium_out: mi.UInt32
    local: mi.Vector3f


def interact(
    table: SurfaceTable, p: mi.Vector3f, d: mi.Vector3f, s: mi.UInt32, stock_normal: mi.Vector3f | None, active: mi.Bool
) -> Interaction:
    """
    Evaluate the surfaces s at the points p for light that travels along d.

    Parameters
    ----------
    table : SurfaceTable
    p, d : mi.Vector3f
        Point close to the surface (mm) and unit direction of propagation.
    s : mi.UInt32
        Numbers of the surfaces.
    stock_normal : mi.Vector3f, optional
        Normal where the surface is a stock shape; needed if the scene has any.
    active : mi.Bool
        Lanes that matter.
    """
    quadric = dr.gather(mi.Vector4f, table.quadric, s, active)
    vertex = dr.gather(mi.Vector4f, table.vertex, s, active)
    optics = dr.gather(mi.Vector4f, table.optics, s, active)
    word = dr.gather(mi.UInt32, table.words, s, active)
    q = p - vertex.xyz
    dl = d
    if table.rotated:
        rows = [dr.gather(mi.Vector4f, table.rotation, 3 * s + k, active) for k in range(3)]
        q = mi.Vector3f(*(rows[0][k] * q.x + rows[1][k] * q.y + rows[2][k] * q.z for k in range(3)))
        dl = mi.Vector3f(*(rows[0][k] * d.x + rows[1][k] * d.y + rows[2][k] * d.z for k in range(3)))

    # Value and half gradient of F at q; the normal is along the gradient
    a, b, e, g = quadric
    r2 = dr.fma(q.x, q.x, q.y * q.y)
    value = dr.fma(a, r2, dr.fma(dr.fma(b, q.z, e), q.z, g))
    gx, gy, gz = a * q.x, a * q.y, dr.fma(b, q.z, 0.5 * e)
    if table.coefficient_count:
        aspheric = active & ((word & ASPHERIC) != 0)
        row = [
            dr.gather(mi.Vector4f, table.polynomial, POLYNOMIAL_VECTORS * s + k, aspheric)
            for k in range(POLYNOMIAL_VECTORS)
        ]
        c, k, *coefficients = (row[j // 4][j % 4] for j in range(2 + table.coefficient_count))
        slope = sag_derivative(r2, c, k, coefficients)
        # F = 2 (sag - z), to be of the same sign and scale as the quadric
        value = dr.select(aspheric, 2 * (sag(r2, c, k, coefficients) - q.z), value)
        gx, gy, gz = (
            dr.select(aspheric, 2 * slope * q.x, gx),
            dr.select(aspheric, 2 * slope * q.y, gy),
            dr.select(aspheric, -1, gz),
        )
    if table.stock_scene is not None:
        assert stock_normal is not None
        stock = s >= len(table.pieces)
        value = dr.select(stock, 0, value)
        gx, gy, gz = (dr.select(stock, n, v) for n, v in zip(stock_normal, (gx, gy, gz), strict=True))

    # One Newton step along the ray removes the rounding of a distant origin
    along = 2 * (gx * dl.x + gy * dl.y + gz * dl.z)
    step = -value / along
    step = dr.select(dr.isfinite(step) & (dr.abs(step) < 1e-3 * (1 + dr.sqrt(r2))), step, 0)
    p, q = dr.fma(step, d, p), dr.fma(step, dl, q)

    normal = mi.Vector3f(gx, gy, gz) * dr.mulsign(dr.rsqrt(gx * gx + gy * gy + gz * gz), vertex.w)
    if table.rotated:
        rotated = mi.Vector3f(*(rows[k].x * normal.x + rows[k].y * normal.y + rows[k].z * normal.z for k in range(3)))
        normal = rotated if table.stock_scene is None else dr.select(stock, normal, rotated)
    cosine = dr.dot(d, normal)
    from_front = cosine > 0  # the normal points from front to back
    along_d = dr.mulsign(normal, cosine)
    cos_i = dr.minimum(dr.abs(cosine), 1)
    n_i, n_t = dr.select(from_front, optics.x, optics.y), dr.select(from_front, optics.y, optics.x)
    eta = n_i / n_t
    sin2_t = eta * eta * (1 - cos_i * cos_i)
    opaque = (word & OPAQUE) != 0
    tir = (sin2_t >= 1) & ~opaque
    cos_t = dr.sqrt(dr.maximum(0, 1 - sin2_t))
    reflected = dr.normalize(d - 2 * cos_i * along_d)
    transmitted = dr.normalize(eta * d + (cos_t - eta * cos_i) * along_d)
    R, T = _reflectance_transmittance(table, s, word, optics, cos_i, cos_t, n_i, n_t, from_front, active)
    R, T = dr.select(tir, R + T, R), dr.select(tir | opaque, 0, T)
    front, back = (word >> FRONT_MEDIUM_SHIFT) & MEDIUM_MASK, (word >> BACK_MEDIUM_SHIFT) & MEDIUM_MASK
    return Interaction(
        p=p,
        reflected=reflected,
        transmitted=transmitted,
        R=R,
        T=T,
        tir=tir,
        word=word,
        medium_in=dr.select(from_front, front, back),
        medium_out=dr.select(from_front, back, front),
        local=q,
    )


def _reflectance_transmittance(
    table: SurfaceTable,
    s: mi.UInt32,
    word: mi.UInt32,
    optics: mi.Vector4f,
    cos_i: mi.Float,
    cos_t: mi.Float,
    n_i: mi.Float,
    n_t: mi.Float,
    from_front: mi.Bool,
    active: mi.Bool,
) -> tuple[mi.Float, mi.Float]:
    kind = word & 3
    R, T = optics.z, optics.w
    if FRESNEL in table.kinds:
        bare = reflectance(cos_i, cos_t, n_i, n_t)
        if len(table.kinds) == 1:
            return bare, 1 - bare
        fresnel = kind == FRESNEL
        R, T = dr.select(fresnel, bare, R), dr.select(fresnel, 1 - bare, T)
    if TABLED in table.kinds:
        tabled = active & (kind == TABLED)
        x = dr.minimum(cos_i, cos_t) * (TABLE_NODES - 1)
        node = dr.minimum(mi.UInt32(x), TABLE_NODES - 2)
        row = dr.gather(mi.UInt32, table.table_row, s, tabled) + node
        low, high = (dr.gather(mi.Vector4f, table.table, row + k, tabled) for k in range(2))
        values = dr.lerp(low, high, x - mi.Float(node))
        R = dr.select(tabled, dr.select(from_front, values.x, values.y), R)
        T = dr.select(tabled, values.z, T)
    return R, T


def counts_as_reflection(interaction: Interaction) -> mi.Bool:
    """Whether a reflection here uses up one of `max_reflections`: total and design reflections do not."""
    return ~interaction.tir & ((interaction.word & MIRROR) == 0)

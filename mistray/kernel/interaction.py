"""
Interaction of light with a surface at a point: normal, Snell's law, R and T, and the events that follow.

For the unit direction of propagation d, the unit normal a on the side that the light goes to, the refractive indices
n_i on the side of incidence and n_t on the other, cos θi = d · a and η = n_i/n_t

    reflected   = d - 2 cos θi a,
    transmitted = η d + (cos θt - η cos θi) a,   cos θt = √(1 - η² (1 - cos² θi)),

see M. Pharr et al., Physically based rendering, 4th edition, section 9.3, where directions point away from the surface.
The code calls a `axis`. Reflection is total where η² (1 - cos² θi) ≥ 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mistray.events import AIMED_TRANSMITTED, RANDOM_TRANSMITTED, REFLECTED, TOTAL, TRANSMITTED, event_of
from mistray.kernel.polarization import Mueller, from_plane, plane_of_incidence, to_plane
from mistray.physics.fresnel import amplitudes, reflectance, total_product, transmitted_product
from mistray.physics.geometry.sag import sag, sag_derivative
from mistray.surfaces.extrema import larger, smaller
from mistray.surfaces.optics import (
    ASPHERIC,
    BACK_MEDIUM_SHIFT,
    DIFFRACTS,
    FRESNEL,
    FRONT_MEDIUM_SHIFT,
    IDEAL,
    MEDIUM_MASK,
    MIRROR,
    OPAQUE,
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TABLED,
    TRANSMISSION,
    Optics,
    total_variable,
)
from mistray.surfaces.surface_rows import LaneRows, gathered_row
from mistray.surfaces.surfaces import SurfaceTable

# Channel of a gradient: an ideal coating reflects R + T beyond the critical angle
REFLECTION_AND_TRANSMISSION = 3


@dataclass
class Interaction:
    """
    Interaction of light with a surface at a node of the ray tree.

    Attributes
    ----------
    p : mi.Vector3f
        Point, moved onto the surface, mm, relative to the centre of the scene.
    reflected, transmitted : mi.Vector3f
        Unit directions; `transmitted` has no meaning in total reflection or at an opaque surface.
    R, T : mi.Float
        Shares of the flux that the coating reflects and transmits, for the polarisation of the branch, before scatter
        takes its part; the rest is absorbed. T is 0 in total internal reflection and at an opaque surface.
    tir : mi.Bool
        Whether the reflection is total.
    axis : mi.Vector3f
        Unit normal on the side that the light goes to without reflection.
    cos_i, cos_t : mi.Float
        Cosines of the angles of incidence and refraction; `cos_t` is 0 in total reflection.
    eta : mi.Float
        Refractive index on the side of incidence over that on the other side; without meaning at an opaque surface.
    word : mi.UInt32
        Kind, flags and media of the surface as bits, see `mistray.surfaces.optics`.
    medium_in, medium_out : mi.UInt32
        Positions in `Optics.media` of the materials on the side of incidence and on the other; 0: any material may be
        there, as next to an opaque surface.
    local : mi.Vector3f
        Point in the surface's own frame, mm.
    from_front : mi.Bool
        Whether the light comes from the front.
    place : Place
        Position of the angle of incidence in the coating's table.
    polarized : Polarized or None
        Stokes vector and Mueller matrices; None: unpolarised.
    """

    p: mi.Vector3f
    reflected: mi.Vector3f
    transmitted: mi.Vector3f
    R: mi.Float
    T: mi.Float
    tir: mi.Bool
    axis: mi.Vector3f
    cos_i: mi.Float
    cos_t: mi.Float
    eta: mi.Float
    word: mi.UInt32
    medium_in: mi.UInt32
    medium_out: mi.UInt32
    local: mi.Vector3f
    from_front: mi.Bool
    place: Place
    polarized: Polarized | None

    def channel(self, reflect: mi.Bool) -> mi.UInt32:
        """Return the index of the tabulated value that sets each child's flux: R from front or back, T, or R + T."""
        # An ideal coating has no entry of its own for total reflection: it reflects R + T then
        both = self.tir & ((self.word & 3) == IDEAL)
        reflection = dr.select(self.from_front, mi.UInt32(REFLECTION_FRONT), mi.UInt32(REFLECTION_BACK))
        reflection = dr.select(both, REFLECTION_AND_TRANSMISSION, reflection)
        return dr.select(reflect, reflection, mi.UInt32(TRANSMISSION))


@dataclass
class Place:
    """Position of an angle of incidence in a coating's table: row, and fraction of the way to the next row."""

    row: mi.UInt32
    fraction: mi.Float


@dataclass
class Polarized:
    """
    Polarisation of light at a surface: its Stokes vector, and the Mueller matrices of the coating.

    Attributes
    ----------
    stokes : mi.Vector3f
        Stokes vector (Q, U, V)/I of the incident light along d, with respect to the axes s and d × s.
    s : mi.Vector3f
        Unit vector along d × normal, across the plane of incidence; the normal is from front to back.
    reflection, transmission : Mueller
        Mueller matrices in that plane.
    """

    stokes: mi.Vector3f
    s: mi.Vector3f
    reflection: Mueller
    transmission: Mueller

    def after(self, reflect: mi.Bool, d: mi.Vector3f) -> mi.Vector3f:
        """Return (Q, U, V)/I of the reflected or transmitted child along d, in the polarisation axes of d."""
        chosen = dr.select(reflect, self.reflection.apply(self.stokes), self.transmission.apply(self.stokes))
        return from_plane(chosen, d, self.s)


def interact(
    table: SurfaceTable,
    p: mi.Vector3f,
    d: mi.Vector3f,
    s: mi.UInt32,
    mitsuba_normal: mi.Vector3f | None,
    stokes: mi.Vector3f | None,
    active: mi.Bool,
    rows: LaneRows | None = None,
) -> Interaction:
    """
    Return the interaction of light along d with surfaces s at points p: normal, directions, and R and T.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    p, d : mi.Vector3f
        Point close to the surface (mm, relative to the centre of the scene) and unit direction of propagation.
    s : mi.UInt32
        Indices of the surfaces.
    mitsuba_normal : mi.Vector3f, optional
        Unit normal, from front to back, where the surface is a Mitsuba shape; needed if the scene has any.
    stokes : mi.Vector3f, optional
        Stokes vector (Q, U, V)/I of the light, in the axes of `d`; None: unpolarised everywhere.
    active : mi.Bool
        Lanes that have a ray.
    rows : LaneRows, optional
        Copies of the table's rows; None: they are gathered here.
    """
    # Into the frame of the surface
    row = gathered_row(table, s, active) if rows is None else rows.row(s, active)
    vertex, optics, word = row.vertex, row.optics, row.word
    q = p - vertex.xyz
    frame = table.frame(s, active)
    q, dl = frame.inward(q), frame.inward(d)

    # Quadric F = a (x² + y²) + b z² + e z + g at q: value, and half the gradient, which is along the normal
    a, b, e, g = row.quadric
    r2 = dr.fma(q.x, q.x, q.y * q.y)
    value = dr.fma(a, r2, dr.fma(dr.fma(b, q.z, e), q.z, g))
    across, along_z = a, dr.fma(b, q.z, 0.5 * e)  # the gradient is (across x, across y, along_z)
    if table.coefficient_count:
        aspheric = active & ((word & ASPHERIC) != 0)
        shape = table.asphere_sag(s, aspheric)
        slope = sag_derivative(r2, *shape)
        # F = 2 (sag - z), to be of the same sign and scale as the quadric
        value = dr.select(aspheric, 2 * (sag(r2, *shape) - q.z), value)
        across, along_z = dr.select(aspheric, 2 * slope, across), dr.select(aspheric, -1, along_z)
    # Shapes that are neither have a residual and a gradient of their own
    families = [
        (here, family, table.families.numbers(family, s, here)) for here, family in table.families.members(s, active)
    ]
    for here, family, numbers in families:
        value = dr.select(here, family.residual(*q, numbers), value)
    if table.mitsuba_scene is not None:
        # Mitsuba's hits are on the surface already
        assert mitsuba_normal is not None
        of_mitsuba = s >= len(table.pieces)
        value = dr.select(of_mitsuba, 0, value)

    # One Newton step -F/(∇F · d) along the ray removes the rounding of a distant origin
    along = 2 * (across * dr.fma(q.x, dl.x, q.y * dl.y) + along_z * dl.z)
    for here, family, numbers in families:
        along = dr.select(here, dr.dot(mi.Vector3f(*family.gradient(*q, numbers)), dl), along)
    step = -value / along
    # A step of more than 1e-3 √(1 + r²) mm is not due to rounding: the point stays
    step = dr.select(step * step < 1e-6 * (1 + r2), step, 0)
    p, q = dr.fma(step, d, p), dr.fma(step, dl, q)

    # Normal at the new point: after a segment of 10 m the normal before the step may be off by 1e-6 rad
    along_z = dr.fma(dr.select(aspheric, 0, b) if table.coefficient_count else b, step * dl.z, along_z)
    gradient = mi.Vector3f(across * q.x, across * q.y, along_z)
    for here, family, numbers in families:
        gradient = dr.select(here, mi.Vector3f(*family.gradient(*q, numbers)), gradient)
    if table.mitsuba_scene is not None:
        gradient = dr.select(of_mitsuba, mitsuba_normal, gradient)
    # The sign in `vertex.w` turns it from front to back
    normal = gradient * dr.mulsign(dr.rsqrt(dr.squared_norm(gradient)), vertex.w)
    if table.rotated:
        # Back into the frame of the scene, where Mitsuba's normals are already
        rotated = frame.outward(normal)
        normal = rotated if table.mitsuba_scene is None else dr.select(of_mitsuba, normal, rotated)
    cosine = dr.dot(d, normal)

    # Reflected and refracted directions
    from_front = cosine > 0  # the normal points from front to back
    along_d = dr.mulsign(normal, cosine)
    cos_i = smaller(dr.abs(cosine), 1)
    at = _incidence(optics, word, from_front, cos_i)
    # Normalised, since the rounding of a direction would grow from node to node
    reflected = dr.normalize(d - 2 * cos_i * along_d)
    transmitted = dr.normalize(at.eta * d + (at.cos_t - at.eta * cos_i) * along_d)

    # R and T of the coating: the means of s and p, or by the Stokes vector of the branch
    place = _place(table, s, at, active)
    polarized = None
    if stokes is None:
        R, T = _unpolarized(table, optics, place, at, active)
    else:
        in_plane = plane_of_incidence(d, normal)
        # Mueller matrices hold in the frame of the plane of incidence, which turns from hit to hit
        turned = to_plane(stokes, d, in_plane)
        reflection, transmission = _mueller(table, optics, place, at, active)
        polarized = Polarized(turned, in_plane, reflection, transmission)
        R, T = reflection.share(turned), dr.select(at.tir | at.opaque, 0, transmission.share(turned))

    # Materials on either side, which the word of the surface holds
    front, back = (word >> FRONT_MEDIUM_SHIFT) & MEDIUM_MASK, (word >> BACK_MEDIUM_SHIFT) & MEDIUM_MASK
    return Interaction(
        p=p,
        reflected=reflected,
        transmitted=transmitted,
        R=R,
        T=T,
        tir=at.tir,
        axis=along_d,
        cos_i=cos_i,
        cos_t=at.cos_t,
        eta=at.eta,
        word=word,
        medium_in=dr.select(from_front, front, back),
        medium_out=dr.select(from_front, back, front),
        local=q,
        from_front=from_front,
        place=place,
        polarized=polarized,
    )


def shares_at(
    table: SurfaceTable,
    s: mi.UInt32,
    word: mi.UInt32,
    from_front: mi.Bool,
    cos_i: mi.Float,
    active: mi.Bool,
    optics: mi.Vector4f | None = None,
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """
    Return R, T and cos θt of surfaces s for unpolarised light that arrives at the cosine `cos_i`.

    `word` is that of each surface in `Optics.words`, and `from_front` says whether the light comes from its front.
    `optics` holds the refractive indices in front and behind, and R and T of an ideal coating; None: they are read from
    the table.
    """
    if optics is None:
        optics = dr.gather(mi.Vector4f, table.optics.indices, s, active)
    at = _incidence(optics, word, from_front, cos_i)
    return *_unpolarized(table, optics, _place(table, s, at, active), at, active), at.cos_t


@dataclass
class _Incidence:
    """
    Geometry of light that meets a surface: kind of coating, side of incidence, refractive indices and angles.

    Attributes
    ----------
    kind : mi.UInt32
        Kind of the coating, see `mistray.surfaces.optics`.
    opaque, from_front, tir : mi.Bool
        Whether the surface is opaque, the light comes from its front, and total reflection occurs.
    n_i, n_t, eta : mi.Float
        Real refractive indices on the side of the light and on the other side, and n_i/n_t; without meaning at an
        opaque surface.
    cos_i, cos_t, sin2_t : mi.Float
        Cosines of the angles of incidence and refraction, and sin² of the latter, which exceeds 1 in total reflection.
    """

    kind: mi.UInt32
    opaque: mi.Bool
    from_front: mi.Bool
    n_i: mi.Float
    n_t: mi.Float
    eta: mi.Float
    cos_i: mi.Float
    cos_t: mi.Float
    sin2_t: mi.Float
    tir: mi.Bool


def _incidence(optics: mi.Vector4f, word: mi.UInt32, from_front: mi.Bool, cos_i: mi.Float) -> _Incidence:
    """
    Return indices and angles of light at a surface by Snell's law n_i sin θi = n_t sin θt.

    Parameters are as in `shares_at`. At an opaque surface only the cosine of incidence has a meaning.
    """
    n_i, n_t = dr.select(from_front, optics.x, optics.y), dr.select(from_front, optics.y, optics.x)
    eta, opaque = n_i / n_t, (word & OPAQUE) != 0
    sin2_t = eta * eta * (1 - cos_i * cos_i)
    # Behind an opaque surface is no medium, and n_t stands for nothing
    tir = (sin2_t >= 1) & ~opaque
    # Not below 0, where the derivative of the root would be NaN
    cos_t = dr.sqrt(larger(1 - sin2_t, 0))
    return _Incidence(word & 3, opaque, from_front, n_i, n_t, eta, cos_i, cos_t, sin2_t, tir)


def _place(table: SurfaceTable, s: mi.UInt32, at: _Incidence, active: mi.Bool) -> Place:
    """
    Return the fractional row of the incidence angle in surfaces' coating tables, see `mistray.surfaces.optics`.

    For coatings without a table it is the first row of the surface, with the fraction 0.
    """
    places = dr.gather(mi.Vector4u, table.optics.places, s, active)
    # The smaller cosine is that in the rarer medium: in it R and T are smooth from either side
    x = dr.select(at.tir, total_variable(at.sin2_t, at.eta, at.cos_i), smaller(at.cos_i, at.cos_t))
    start, last = dr.select(at.tir, places.z, places.x), dr.select(at.tir, places.w, places.y)
    x = dr.select(at.kind == TABLED, x * mi.Float(last), 0)
    node = dr.minimum(mi.UInt32(x), last - 1)
    return Place(start + node, x - mi.Float(node))


def _unpolarized(
    table: SurfaceTable, optics: mi.Vector4f, place: Place, at: _Incidence, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """
    Return R and T for unpolarised light.

    T is 0 at opaque surfaces, and in total reflection, in which the T of an ideal coating is added to R. `optics` is as
    in `shares_at`.
    """
    kinds = table.optics.kinds
    # Ideal coatings have R and T of their own
    R, T = optics.z, optics.w
    # Bare surfaces. Kinds of coating that no surface has take no code in the kernel
    if FRESNEL in kinds:
        bare = reflectance(at.cos_i, at.cos_t, at.n_i, at.n_t)
        fresnel = at.kind == FRESNEL if len(kinds) > 1 else True
        R, T = dr.select(fresnel, bare, R), dr.select(fresnel, 1 - bare, T)
    if TABLED in kinds:
        # Coatings that are tabulated over the angle of incidence, linear between rows
        tabled = active & (at.kind == TABLED)
        low, high = (dr.gather(mi.Vector4f, table.optics.table, place.row + k, tabled) for k in range(2))
        values = dr.lerp(low, high, place.fraction)
        R = dr.select(tabled, dr.select(at.from_front, values.x, values.y), R)
        T = dr.select(tabled, values.z, T)
    return dr.select(at.tir, R + T, R), dr.select(at.tir | at.opaque, 0, T)


def _bare(at: _Incidence) -> tuple[mi.Vector4f, mi.Vector4f]:
    """Return the Mueller coefficients (S, P, Re j_s j_p*, Im j_s j_p*) of a bare surface, reflected and transmitted."""
    r_s, r_p = amplitudes(at.cos_i, at.cos_t, at.n_i, at.n_t)
    s, p = r_s * r_s, r_p * r_p
    # In total reflection |r_s| = |r_p| = 1, and s and p differ in phase
    re, im = total_product(at.cos_i, dr.sqrt(larger(at.sin2_t - 1, 0)), at.n_i, at.n_t)
    re, im = dr.select(at.tir, re, r_s * r_p), dr.select(at.tir, im, 0)
    through = transmitted_product(at.cos_i, at.cos_t, at.n_i, at.n_t)
    return mi.Vector4f(s, p, re, im), mi.Vector4f(1 - s, 1 - p, through, 0)


def _mueller(
    table: SurfaceTable, optics: mi.Vector4f, place: Place, at: _Incidence, active: mi.Bool
) -> tuple[Mueller, Mueller]:
    """
    Return the Mueller matrices of surfaces for reflection and transmission, in axes of the plane of incidence.

    That of transmission has no meaning in total reflection or at an opaque surface. `optics` is as in `shares_at`.
    """
    kinds = table.optics.kinds
    # An ideal coating acts on s and p alike, as a bare surface does at normal incidence
    R, T = dr.select(at.tir, optics.z + optics.w, optics.z), optics.w
    reflection, transmission = mi.Vector4f(R, R, -R, 0), mi.Vector4f(T, T, T, 0)
    # Fresnel's amplitudes
    if FRESNEL in kinds:
        fresnel = at.kind == FRESNEL
        bare = _bare(at)
        reflection, transmission = dr.select(fresnel, bare[0], reflection), dr.select(fresnel, bare[1], transmission)
    if TABLED in kinds:
        # Tabulated coefficients, four numbers for each channel and row
        tabled = active & (at.kind == TABLED)
        side = dr.select(at.from_front, mi.UInt32(REFLECTION_FRONT), mi.UInt32(REFLECTION_BACK))

        def row(channel: mi.UInt32) -> mi.Vector4f:
            low, high = (
                dr.gather(mi.Vector4f, table.optics.table, 3 * (place.row + k) + channel, tabled) for k in range(2)
            )
            return dr.lerp(low, high, place.fraction)

        reflection = dr.select(tabled, row(side), reflection)
        transmission = dr.select(tabled, row(mi.UInt32(TRANSMISSION)), transmission)
    return Mueller(reflection), Mueller(transmission)


def counts_as_reflection(interaction: Interaction) -> mi.Bool:
    """Return a mask of nodes whose reflection counts towards `max_reflections`: neither total nor at a mirror."""
    return ~interaction.tir & ((interaction.word & MIRROR) == 0)


def event_code(
    place: mi.UInt32, it: Interaction, reflect: mi.Bool, scattered: tuple[mi.Bool, mi.Bool, mi.Bool] | None
) -> mi.UInt32:
    """
    Return codes of events: index of the surface or medium, and how the ray leaves it; see `mistray.events`.

    Parameters
    ----------
    place : mi.UInt32
        Index of the surface; of a medium, its position after all surfaces.
    it : Interaction
        Interaction at the hits.
    reflect : mi.Bool
        Whether the ray leaves on the side that it came from.
    scattered : tuple of mi.Bool or None
        Whether the surface scattered the ray, whether the medium did, and whether it was aimed; None: nothing scatters.
    """
    # Specular events
    what = dr.select(reflect, dr.select(it.tir, mi.UInt32(TOTAL), mi.UInt32(REFLECTED)), mi.UInt32(TRANSMITTED))
    # Scattered: rays of different techniques are different events in the ledger
    if scattered is not None:
        surface, medium, aim = scattered
        technique = dr.select(aim, mi.UInt32(AIMED_TRANSMITTED), mi.UInt32(RANDOM_TRANSMITTED))
        what = dr.select(surface, technique + dr.select(reflect, mi.UInt32(1), 0), what)
        what = dr.select(medium, technique, what)
    return event_of(place, what)


def is_diffraction(optics: Optics, it: Interaction, scatter: mi.Bool, reflect: mi.Bool) -> mi.Bool:
    """Return a mask of scatter events that are diffraction at edges: transmitted, at a surface that diffracts."""
    if not optics.diffracts:
        return mi.Bool(False)
    return scatter & ~reflect & ((it.word & DIFFRACTS) != 0)

"""Where the rim of a surface of revolution touches another surface, and what a ray beside the rim meets there.

At a contact no gap opens when the rim alone moves: the edge that light sees is the line in which the two surfaces meet.
Whether a ray that just misses the rim meets the other surface at once is decided in the plane of the axis: with the
direction u in which the rim ends the surface, the direction v from the contact along the other surface and the ray's
direction d, the ray η u + t d meets the other surface at τ v for

    τ = η (u × d)/(v × d),   t = -η (u × v)/(d × v)

that is, if τ > 0; before it passes the rim (a concave corner) if t < 0, behind it (a convex one) if t > 0. The ray that
hits at the same distance within the rim has the opposite τ and t: where its τ > 0 and t < 0, it comes from the other
surface. Such rays say nothing about the edge, because their ways begin on one side of it only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mistray.surfaces.gradient_columns import HIGH, INNER, LOW, OUTER
from mistray.surfaces.surface import Surface
from mistray.surfaces.surfaces import SurfaceTable

TOUCH = 1e-4  # distance of surfaces that touch, in units of the rim's radius
PARALLEL = 1e-7  # by which the directions of axes may differ


@dataclass(frozen=True)
class Contact:
    """
    Half of another surface that begins at a rim.

    Attributes
    ----------
    surface : int
        Its number.
    along : (2,) float64
        Unit vector from the contact along it, in the plane of the axis: away from the axis and along it, in the frame
        of the surface that the rim belongs to.
    gradient : (2,) float64
        Unit vector along the gradient of its F, see `ReplaySurfaces`: away from the axis for cones and tubes, towards
        smaller z for all others.
    ends : bool
        Whether it ends here too; else its other half is another `Contact`.
    """

    surface: int
    along: np.ndarray
    gradient: np.ndarray
    ends: bool


@dataclass(frozen=True)
class RimCircle:
    """
    A rim that is a circle.

    Attributes
    ----------
    point : (2,) float64
        Its radius and its place along the axis from the vertex, mm.
    outward : (2,) float64
        Unit vector in which it ends the surface, away from the axis and along it.
    stretch : float
        Part of `outward` along the coordinate in which distances from the rim count.
    contacts : list of Contact
    """

    point: np.ndarray
    outward: np.ndarray
    stretch: float
    contacts: list[Contact]


def rim_circles(table: SurfaceTable) -> dict[tuple[int, int], RimCircle]:
    """Circular rims of all surfaces, by surface and place in `RIM_COLUMNS`, with what touches them."""
    found = {}
    extents = np.array([piece.z_range for piece in table.pieces])
    for piece in table.pieces:
        if not piece.circular_rims:
            continue
        beside, sign, place = _relative_axes(table, piece)
        for rim in piece.rim_sizes:
            if rim not in (OUTER, INNER, LOW, HIGH):
                continue
            point = piece.rim_point(rim)
            tolerance = TOUCH * point[0]
            along = sign * (point[1] - place)  # in the frames of the other surfaces
            near = (beside <= tolerance) & (along >= extents[:, 0] - tolerance) & (along <= extents[:, 1] + tolerance)
            near[piece.index] = False
            tangent = piece.tangent(point)
            outward = tangent if rim in (OUTER, HIGH) else -tangent
            contacts = [
                contact
                for k in np.flatnonzero(near)
                for contact in _contacts(table.pieces[k], np.array([point[0], along[k]]), float(sign[k]))
            ]
            found[piece.index, rim] = RimCircle(point, outward, piece.rim_stretch(point), contacts)
    return found


def _relative_axes(table: SurfaceTable, piece: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    The axes of all surfaces as one of them sees them.

    Returns
    -------
    beside : (n,) float64
        Distance from the axis of this one, mm; infinite for those that are not parallel to it.
    sign : (n,) float64
        -1 for those that point the other way.
    place : (n,) float64
        Of the vertices along the axis of this one, from its own, mm.
    """
    axes, vertices = (numbers[: len(table.pieces)] for numbers in (table.rotations[:, :, 2], table.vertices))
    axis, apart = axes[piece.index], vertices - vertices[piece.index]
    place = apart @ axis
    beside = np.linalg.norm(apart - place[:, None] * axis, axis=1)
    turned = np.linalg.norm(np.cross(axis, axes), axis=1)
    return np.where(turned > PARALLEL, np.inf, beside), np.sign(axes @ axis), place


def _contacts(other: Surface, here: np.ndarray, sign: float) -> list[Contact]:
    """The halves of another surface on the same axis that begin at a circle, given in the frame of that surface."""
    tolerance = TOUCH * here[0]
    place, low, high, off = other.on_profile(here)
    if not abs(off) <= tolerance or not low - tolerance <= place <= high + tolerance:
        return []
    tangent, gradient = other.tangent(here), other.profile_gradient(here)
    at_low, at_high = place < low + tolerance, place > high - tolerance
    turn = np.array([1.0, sign])
    ways = [tangent] if at_low else [-tangent] if at_high else [tangent, -tangent]
    return [Contact(other.index, turn * way, turn * gradient, at_low or at_high) for way in ways]

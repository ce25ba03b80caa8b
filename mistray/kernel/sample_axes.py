"""
Orientation of surfaces for anisotropic scatter: the x axis of the sample at each point.

An interface says where the axis comes from.

- "x" is the local x axis of its shape, rotated by `rotation_deg` about the local z axis, right-handed, and projected
  onto the tangent plane: a sample that was ground or brushed straight.
- "meridian" is the tangent in the plane through the local z axis, away from it on a plane, rotated by `rotation_deg`
  about the normal from front to back, right-handed: a sample that was turned on a lathe.

A row of four values holds either: x, y, z of a vector in the frame of the surface and 0, or cosine and sine of the
rotation, 0 and 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

AXES = ("x", "meridian")
ROW = 4
TINY = 1e-30  # squared length of a projection that has no direction
NO_TANGENT = 1e-12  # squared length of a tangential part: light at normal incidence has no plane of incidence


def axis_row(axis: str, rotation_deg: float) -> np.ndarray:
    """
    Return a surface's sample axis as a row, (4,): cosine and sine of its rotation, 0, and index of `axis` in `AXES`.

    The rotation is right-handed, for "x" about the local z axis, for "meridian" about the normal from front to back.
    """
    turn = np.radians(rotation_deg)
    return np.array([np.cos(turn), np.sin(turn), 0.0, float(AXES.index(axis))])


def tangent_axis(row: Any, normal: Any, q: Any, any_meridian: bool = True) -> Any:
    """
    Return the x axis of an anisotropic sample at a point of a surface, a unit vector normal to `normal`.

    Parameters
    ----------
    row : mi.Vector4f
        Row that encodes the sample axis, see `axis_row`.
    normal : mi.Vector3f or mi.Vector3d
        Unit normal, from front to back, in the frame of the surface.
    q : mi.Vector3f or mi.Vector3d
        Point in that frame, mm; only its direction from the z axis matters.
    any_meridian : bool
        Whether a row may request the meridian.
    """
    kind = type(normal)
    axis = kind(row.x, row.y, row.z)
    if any_meridian:
        # The tangent along the parallel, crossed with the normal
        meridian = dr.cross(kind(-q.y, q.x, 0), normal)
        meridian *= dr.rsqrt(dr.maximum(dr.squared_norm(meridian), TINY))
        turned = row.x * meridian + row.y * dr.cross(normal, meridian)
        axis = dr.select(row.w > 0.5, turned, axis)
    # Project onto the tangent plane
    axis = axis - dr.dot(axis, normal) * normal
    return axis * dr.rsqrt(dr.maximum(dr.squared_norm(axis), TINY))


class SurfaceFrames:
    """
    Axes of the samples (such as brushed metal) on all surfaces, which orient anisotropic scatter.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    turned : sequence of int
        Indices of the surfaces whose scatter is anisotropic.

    Raises
    ------
    MistrayError
        If one of the surfaces in `turned` has no sample axis.

    Attributes
    ----------
    rows : mi.Float
        (surfaces · 4,) values that encode the sample axes, see `axis_row`.
    """

    def __init__(self, table: SurfaceTable, turned: Sequence[int]) -> None:
        self._table = table
        rows = np.tile(axis_row("x", 0.0), (table.count, 1))
        for s in turned:
            rows[s] = _row(table, s)
        self._any_meridian = bool(np.any(rows[:, 3] > 0))
        self.rows = upload(mi.Float, rows)

    def local(self, s: mi.UInt32, normal: Any, q: Any, active: mi.Bool | bool = True) -> Any:
        """Return the sample's unit x axis at a point q, mm, in the frame of the surface; see `tangent_axis`."""
        row = dr.gather(mi.Vector4f, self.rows, s, active)
        return tangent_axis(row, normal, q, self._any_meridian)

    def at(self, s: mi.UInt32, normal: mi.Vector3f, q: mi.Vector3f, active: mi.Bool) -> mi.Vector3f:
        """
        Return the sample's unit x axis in the scene's frame, at a point q, mm, of the surface's frame.

        The unit `normal` is from front to back, in the scene's frame.
        """
        frame = self._table.frame(s, active)
        return frame.outward(self.local(s, frame.inward(normal), q, active))


def _row(table: SurfaceTable, s: int) -> np.ndarray:
    """
    Return the row, (4,), that encodes the sample axis of surface s; raise `MistrayError` if it has none.

    For an analytic surface it is that of `axis_row`; for a Mitsuba rectangle, a unit vector in the scene's frame and 0.
    """
    sample, name = table.optics.bsdfs[s].sample_axis, table.ids[s]
    if sample is None:
        raise MistrayError(f"surface '{name}': its scatter is anisotropic, but its plugin sets no sample_axis")
    row = axis_row(sample.axis, sample.rotation_deg)
    if s < len(table.pieces):
        if sample.axis == "x" and not table.pieces[s].one_side_up:
            raise MistrayError(
                f"surface '{name}' scatters by the x axis of a sample, which a tube has not everywhere; set "
                "sample_axis of its interface to 'meridian'"
            )
        return row
    shape = table.shapes[s]
    if not str(shape).startswith("Rectangle") or sample.axis != "x":
        raise MistrayError(
            f"surface '{name}' scatters by the x axis of a sample, and a {str(shape).partition('[')[0]} has none of "
            "its own; use 'asphere', 'frustum', 'rectangle' with sample_axis 'x', or anisotropy 'mean'"
        )
    # A rectangle of Mitsuba's own has no frame in the table: its axis goes to the frame of the scene
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
    return np.append(matrix / np.linalg.norm(matrix, axis=0) @ row[:3], 0.0)


def plane_of_sample(
    tangent: mi.Vector3f, lit: mi.Vector3f, x_axis: mi.Vector3f
) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
    """
    Return tangential axes along and across the plane of incidence, and the sample's azimuth from the first, in turns.

    Parameters
    ----------
    tangent : mi.Vector3f
        Tangential part of the direction of the light; where it is 0 the sample's x axis stands for it.
    lit : mi.Vector3f
        Unit normal on the side that the light comes from.
    x_axis : mi.Vector3f
        Unit vector of the sample's x axis.

    Returns
    -------
    tangent, beside : mi.Vector3f
        Axes of equal length; the second counterclockwise from the first as seen from the side of the light.
    rotation : mi.Float
        Azimuth of the sample's x axis from the first, in turns, -0.5 … 0.5.
    """
    # At normal incidence the azimuth is the sample's own
    tangent = dr.select(dr.squared_norm(tangent) > NO_TANGENT, tangent, x_axis)
    beside = dr.cross(lit, tangent)
    return tangent, beside, dr.atan2(dr.dot(x_axis, beside), dr.dot(x_axis, tangent)) * (0.5 / dr.pi)


def fraction_of(turns: mi.Float) -> mi.Float:
    """Return the part of an angle in turns that exceeds whole turns, 0 … 1, also for negative angles."""
    return turns - dr.floor(turns)

"""Orientation of an anisotropic scatter sample on a surface, for Mitsuba's own integrators."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.kernel.sample_axes import AXES, ROW, axis_row, tangent_axis
from mistray.param import fixed
from mistray.ranges import AZIMUTH_DEG, Words
from mistray.surfaces.upload import upload

SAMPLE = {
    "sample_axis": fixed(
        "string",
        Words(AXES),
        "x axis of an anisotropic sample: that of the shape, ``x``, or in the plane through the shape's z axis, "
        "``meridian``, as for marks of a lathe",
        "x",
    ),
    "rotation_deg": fixed(
        "deg",
        AZIMUTH_DEG,
        "right-handed rotation of the sample: for ``x`` about the shape's z axis, for ``meridian`` about its normal",
        0.0,
    ),
}
PLACE = 4  # vectors of each shape: its row, and the rows of its frame with the origin


class SampleAxis:
    """
    Direction of the x axis of a scatter sample (such as brushed metal), see `mistray.kernel.sample_axes`.

    Parameters
    ----------
    props : mi.Properties
        Properties of the plugin; those of `SAMPLE` are read.
    anisotropic : bool
        Whether the scatter depends on the axis.
    title : str
        Name of the plugin, for messages.

    Raises
    ------
    MistrayError
        If a property is out of range, or is given although nothing depends on it.
    """

    def __init__(self, props: mi.Properties, anisotropic: bool, title: str) -> None:
        given = [key for key in SAMPLE if key in props]
        if given and not anisotropic:
            raise MistrayError(f"{title}: {given[0]} is given, but its scatter is isotropic; leave it out")
        self.axis, self.rotation_deg = (param.of(props, name, title) for name, param in SAMPLE.items())
        self._shapes: list[weakref.ref[Any]] = []
        self._known: tuple[list[np.ndarray], mi.Float] | None = None

    def carried(self, by: Any) -> None:
        """Register a shape that carries the interface; the frame of the shape is its ``matrix``."""
        self._shapes.append(weakref.ref(by))

    def local(self, si: mi.SurfaceInteraction3f, turned: bool) -> mi.Vector3f:
        """
        Return the unit vector along the axis at a hit, in the local frame.

        For a shape without a frame of its own, "x" is the x axis of Mitsuba's shading frame, as on a ``rectangle``.
        `turned` is True if the normals of the mesh point to the front.
        """
        normal = -si.sh_frame.n if turned else si.sh_frame.n
        row = mi.Vector4f(*map(float, axis_row("x", self.rotation_deg)))
        # The rotation is right-handed about the normal from front to back, against which s and t may be left-handed
        x = mi.Vector2f(row.x, -row.y if turned else row.y)
        rows = self._rows()
        if rows is not None:
            number = dr.reinterpret_array(mi.UInt32, si.shape)
            known = number < dr.width(rows) // (ROW * PLACE)
            row, *axes = (dr.gather(mi.Vector4f, rows, PLACE * number + k, known) for k in range(PLACE))
            known &= dr.squared_norm(row.xyz) > 0
            away = si.p - mi.Vector3f(*(axis.w for axis in axes))
            # Columns of the frame are its axes
            to_local = [mi.Vector3f(*(axis[k] for axis in axes)) for k in range(3)]

            def inward(v: mi.Vector3f) -> mi.Vector3f:
                return mi.Vector3f(*(dr.dot(column, v) for column in to_local))

            own = tangent_axis(row, inward(normal), inward(away), self.axis == "meridian")
            world = mi.Vector3f(*(dr.dot(axis.xyz, own) for axis in axes))
            found = si.sh_frame.to_local(world).xy
            x = dr.select(known, found * dr.rsqrt(dr.maximum(dr.squared_norm(found), 1e-30)), x)
        return mi.Vector3f(x.x, x.y, 0)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SampleAxis) and self._key == other._key

    def __str__(self) -> str:
        return f"{self.axis} turned by {self.rotation_deg:g}°"

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[str, float]:
        return self.axis, self.rotation_deg % 360

    def _rows(self) -> mi.Float | None:
        """
        Return the encoded sample axes of the shapes that carry the interface, by index in Mitsuba's registry.

        The entries of other shapes are 0. The result is None if no shape carries the interface.
        """
        shapes = [shape for shape in (reference() for reference in self._shapes) if shape is not None]
        if not shapes:
            return None
        matrices = [shape.matrix for shape in shapes]
        known = self._known
        if known is None or len(known[0]) != len(matrices) or not all(map(np.array_equal, known[0], matrices)):
            numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in shapes]
            rows = np.zeros((max(numbers) + 1, PLACE, ROW))
            for number, matrix in zip(numbers, matrices, strict=True):
                rows[number] = np.vstack([axis_row(self.axis, self.rotation_deg), matrix[:3]])
            self._known = matrices, upload(mi.Float, rows)
            dr.eval(self._known[1])
        assert self._known is not None
        return self._known[1]


def common_axis(scatterers: Sequence[Any], title: str) -> SampleAxis | None:
    """
    Return the axis that a surface's anisotropic models share, None without such models.

    Raise `MistrayError` if their axes differ.
    """
    axes = {item.sample_axis for item in scatterers if item.sample_axis is not None}
    if len(axes) > 1:
        raise MistrayError(
            f"{title}: the sample axes of its models are {' and '.join(sorted(map(str, axes)))}; give all the same "
            "sample_axis and rotation_deg"
        )
    return axes.pop() if axes else None

"""Parameters of surfaces that the interaction with light needs, looked up by surface index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray._variant import on_gpu

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

MOST_ROWS = 14  # rows of the largest table copied to the lanes, 52 bytes for each row and lane


@dataclass
class SurfaceRow:
    """
    Shape, position and optical properties of the surface at which each lane's ray is.

    Attributes
    ----------
    quadric : mi.Vector4f
        Coefficients a, b, e, g of the surface's quadric F; zeros if the surface is none. For a sag F is in mm, so that
        a and b are in 1/mm. For a cone it is in mm², so that e is in mm and g in mm².
    vertex : mi.Vector4f
        Position relative to `SurfaceTable.centre`, mm, and a number whose sign turns the gradient of F into the normal.
    optics : mi.Vector4f
        Refractive indices in front and behind, 1 at an opaque surface, and R and T of an ideal coating, else 0.
    word : mi.UInt32
        Kind, flags and media as bits, see `mistray.surfaces.optics`.
    """

    quadric: mi.Vector4f
    vertex: mi.Vector4f
    optics: mi.Vector4f
    word: mi.UInt32


def gathered_row(table: SurfaceTable, s: mi.UInt32, active: mi.Bool | bool = True) -> SurfaceRow:
    """Return the shape, position and optics of the surfaces s, gathered from the table."""
    quadric, vertex, optics = (
        dr.gather(mi.Vector4f, vectors, s, active) for vectors in (table.quadric, table.vertex, table.optics.indices)
    )
    return SurfaceRow(quadric, vertex, optics, dr.gather(mi.UInt32, table.optics.words, s, active))


class LaneRows:
    """
    Copy of the shape, position and optics of all surfaces in the memory of each lane.

    The lanes of a packet are mostly at the same surface. One load then reads a number for all of them, where a gather
    takes one load for each.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    width : int
        Number of lanes.
    """

    def __init__(self, table: SurfaceTable, width: int) -> None:
        count = dr.opaque(mi.UInt32, table.count)

        def copy(k: mi.UInt32, numbers: tuple[Any, ...]) -> tuple[mi.UInt32, tuple[Any, ...]]:
            row = gathered_row(table, k)
            for memory, number in zip(numbers, (*row.quadric, *row.vertex, *row.optics, row.word), strict=True):
                memory.write(number, k)
            return k + 1, numbers

        types = (*(mi.Float,) * 12, mi.UInt32)
        _, self._numbers = dr.while_loop(
            (dr.zeros(mi.UInt32, width), tuple(dr.alloc_local(dtype, table.count) for dtype in types)),
            lambda k, numbers: k < count,
            copy,
            mode="symbolic",
            label="rows of the lanes",
        )

    @staticmethod
    def pay(table: SurfaceTable) -> bool:
        """True if a copy in each lane is faster than gathers: for few surfaces, on the CPU."""
        return table.count <= MOST_ROWS and not on_gpu()

    def row(self, s: mi.UInt32, active: mi.Bool) -> SurfaceRow:
        """Return the shape, position and optics of the surfaces s, read from the lane's copy."""
        *numbers, word = (memory.read(s, active) for memory in self._numbers)
        quadric, vertex, optics = (mi.Vector4f(*numbers[k : k + 4]) for k in (0, 4, 8))
        return SurfaceRow(quadric, vertex, optics, word)

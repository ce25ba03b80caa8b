"""
Radial tables of scatter lobes on the device, evaluated and sampled by the kernel and by the plugins.

A lobe of profile f has the density 2π r f(r) / total over the radius r, which is tabulated at nodes. The cells between
the nodes are chosen by the alias method (M. Pharr et al., Physically based rendering, 4th edition, section A.1). Within
a cell f ∝ r^m, so that the power m + 2 of r is uniform.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.scatter.radial import ALMOST_LOG, OCTAVES, PER_OCTAVE, RINGS, RadialTable
from mistray.surfaces.upload import upload

STRIDE = RINGS + 2  # floats of a table: values at the nodes, and one more so that every cell has a next node
CELLS = RINGS + 1
LAST_BIT = 2.0**-24  # last bit of a random number: a cell of no share is not kept even if the number is 0
LOG2_FIRST = 1.0 - OCTAVES  # log2 of the radius of the first node
FIRST_R2 = 4.0**LOG2_FIRST
TURNED = -0.3  # z component of a normal below which its tangents take the other branch


def from_local(local: mi.Vector3f, normal: mi.Vector3f) -> mi.Vector3f:
    """Return a vector that is given in the frame of `tangents` and a unit normal, which is its z axis."""
    first, second = tangents(normal)
    return local.x * first + local.y * second + local.z * normal


def tangents(normal: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f]:
    """
    Return unit vectors t1 and t2 such that t1, t2 and a unit normal, in this order, are a right-handed frame.

    Source: T. Duff et al., "Building an orthonormal basis, revisited", Journal of Computer Graphics Techniques 6
    (2017) 1. There the frame switches branch at z = 0, which is where all normals of a tube lie: a rounding of a
    position would turn the scattered rays. Here it does so at z = -0.3, away from normals of tubes and of planes across
    the axis.
    """
    mirrored = dr.select(normal.z < TURNED, mi.Float(-1), 1)
    a = -dr.rcp(mirrored + normal.z)
    b = normal.x * normal.y * a
    return (
        mi.Vector3f(dr.fma(mirrored * a, dr.square(normal.x), 1), mirrored * b, -mirrored * normal.x),
        mi.Vector3f(b, dr.fma(a, dr.square(normal.y), mirrored), -normal.y),
    )


class RadialSampler:
    """
    Radial profiles of scatter lobes in device memory: evaluation, and sampling of radii.

    Parameters
    ----------
    tables : sequence of RadialTable
        Tables, addressed by their indices.

    Attributes
    ----------
    total : mi.Float
        (tables,) integral of 2π r f(r) of each table over the radius, dimensionless.
    """

    def __init__(self, tables: Sequence[RadialTable]) -> None:
        logs = [stored_logs(table) for table in tables]
        cells = [np.column_stack([table.probability, table.alias]) for table in tables]
        self._logs = upload(mi.Float, np.concatenate(logs))
        self._cells = upload(mi.Float, np.concatenate(cells))
        self.total = upload(mi.Float, np.array([table.total for table in tables]))
        dr.eval(self._logs, self._cells, self.total)

    @property
    def arrays(self) -> list[mi.Float]:
        """Device arrays of all profiles: log2 of their values (1/sr), and the alias tables of their cells."""
        return [self._logs, self._cells]

    def value(self, table: mi.UInt32, r2: mi.Float, active: mi.Bool) -> mi.Float:
        """
        Return the profile f, 1/sr, of radial table `table` at the squared distance r2 from the lobe's centre.

        The distance, 0 … 2, is in direction cosines, or for a lobe by angle the chord between unit vectors.
        """
        place = radial_place(r2)
        node = mi.UInt32(place)
        low, high = self._pair(table, node, active)
        return dr.exp2(dr.lerp(low, high, place - mi.Float(node)))

    def sample(self, table: mi.UInt32, u: mi.Float, v: mi.Float, active: mi.Bool) -> mi.Float:
        """
        Return a radius sampled with the density 2π r f(r) / total of `table`, from two uniform random numbers u and v.

        The first gives the cell and the place in it, the second decides between the cell and its alias. A single number
        would have too few values: a float32 has few places in a cell, and many cells have a small share.
        """
        # Choose a cell by the alias table
        place = u * CELLS
        cell = dr.minimum(mi.UInt32(place), CELLS - 1)
        inner = place - mi.Float(cell)
        entry = dr.gather(mi.Vector2f, self._cells, table * CELLS + cell, active)
        cell = dr.select(v + LAST_BIT < entry.x, cell, mi.UInt32(entry.y))

        # Invert the integral within the cell: r^(m + 2) is uniform; where m + 2 is about 0, log r is
        ring = dr.maximum(cell, 1) - 1
        low, high = self._pair(table, ring, active)
        exponent = (high - low) * PER_OCTAVE + 2
        growth = dr.exp2(exponent * (1 / PER_OCTAVE)) - 1
        octaves = dr.select(
            dr.abs(exponent) < ALMOST_LOG, inner * (1 / PER_OCTAVE), dr.log2(dr.fma(inner, growth, 1)) / exponent
        )
        # Within the first node f is constant, so that r² is uniform
        octaves = dr.select(cell == 0, 0.5 * dr.log2(dr.maximum(inner, 1e-12)), octaves)
        return dr.exp2(LOG2_FIRST + mi.Float(ring) * (1 / PER_OCTAVE) + octaves)

    def _pair(self, table: mi.UInt32, node: mi.UInt32, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """Return log2 of a profile f (in 1/sr) at a node of a radial table and at the node after it."""
        at = table * STRIDE + node
        return dr.gather(mi.Float, self._logs, at, active), dr.gather(mi.Float, self._logs, at + 1, active)


def radial_place(r2: mi.Float) -> mi.Float:
    """Return the fractional index of a squared radius r2 among the nodes of a radial table, clipped to 0 … RINGS."""
    # Bounded below before the logarithm, whose derivative is then finite
    return dr.minimum((0.5 * dr.log2(dr.maximum(r2, FIRST_R2)) - LOG2_FIRST) * PER_OCTAVE, RINGS)


def stored_logs(table: RadialTable) -> np.ndarray:
    """Return log2 of a radial table's values at its nodes, (STRIDE,) float64, with the last value repeated."""
    return np.append(table.log2_values, table.log2_values[-1])


def multilinear(
    values: mi.Float, first: Any, sizes: Sequence[Any], places: Sequence[mi.Float], active: mi.Bool
) -> mi.Float:
    """
    Return values of a table of several axes, interpolated linearly along each axis.

    Parameters
    ----------
    values : mi.Float
        Tables, one after the other, the last axis running fastest.
    first : mi.UInt32 or int
        Index of the table's first value.
    sizes : sequence of mi.UInt32 or int
        Number of nodes of each axis, at least 2.
    places : sequence of mi.Float
        Position along each axis, 0 … 1.
    active : mi.Bool
        Lanes that take part.
    """
    low, fraction = [], []
    for place, size in zip(places, sizes, strict=True):
        place = place * mi.Float(size - 1)
        node = dr.minimum(mi.UInt32(place), size - 2)
        low.append(node)
        fraction.append(place - mi.Float(node))
    result = mi.Float(0)
    # Sum over the corners of the cell; the bits of `corner` say which end of each axis
    for corner in range(2 ** len(sizes)):
        weight, index = mi.Float(1), mi.UInt32(0)
        for axis in range(len(sizes)):
            step = corner >> axis & 1
            weight = weight * (fraction[axis] if step else 1 - fraction[axis])
            index = index * sizes[axis] + low[axis] + step
        result += weight * dr.gather(type(values), values, first + index, active)
    return result

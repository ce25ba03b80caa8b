"""Points of the unit cube along a space-filling curve: neighbouring lanes trace similar trees, errors fall faster."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.upload import upload

BITS = 32  # bits of a position on the curve


def stratified_points(group: mi.UInt32, rng: mi.PCG32) -> mi.Point2f:
    """
    Return random points of the unit square, stratified along a space-filling curve within each group of lanes.

    A group of n has one point in each of n equal parts of the curve. Neighbouring lanes trace similar trees, so that
    few of them idle. The points of a group lie more evenly than random
    ones. The error of a mean over n of them falls as n^-1 where the integrand is smooth, and as n^-3/4 where it has
    edges, such as those of a pupil. Groups are independent. The curve is Morton's with 2^32 cells. Three numbers of
    each generator are drawn.

    Parameters
    ----------
    group : mi.UInt32
        Group of each lane, ascending.
    rng : mi.PCG32
    """
    # First lane and size of each group, on the host
    groups = np.array(group)
    first = np.searchsorted(groups, np.arange(int(groups[-1]) + 2))
    begin, size = (dr.gather(mi.UInt32, upload(mi.UInt32, v), group) for v in (first[:-1], np.diff(first)))
    number = mi.Float64(dr.arange(mi.UInt32, len(groups)) - begin) + mi.Float64(rng.next_float32())
    return mi.Point2f(*curve_points(number / mi.Float64(size), 2, rng))


def curve_points(place: mi.Float64, dimensions: int, rng: mi.PCG32) -> list[mi.Float]:
    """
    Return points of the unit square or cube for positions along Morton's space-filling curve.

    Parameters
    ----------
    place : mi.Float64
        Position along the curve, 0 … 1; uniform positions give uniform points.
    dimensions : int
        Number of dimensions, 2 or 4.
    rng : mi.PCG32
        One generator per lane; each dimension draws one number, for the position within a cell.

    Returns
    -------
    list of mi.Float
        Coordinates, 0 … 1.
    """
    # A coordinate has every second, or every fourth, bit of the number of the cell
    cell = mi.UInt32(dr.minimum(place, 1 - 2.0 ** -(BITS + 1)) * 2.0**BITS)
    scale = 2.0 ** -(BITS // dimensions)
    return [
        (mi.Float(_every(mi.UInt32(cell >> k), dimensions)) + rng.next_float32()) * scale for k in range(dimensions)
    ]


def _every(v: mi.UInt32, stride: int) -> mi.UInt32:
    """Return the bits of a word at multiples of 2 or 4, side by side."""
    steps = {
        2: ((0, 0x55555555), (1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)),
        4: ((0, 0x11111111), (3, 0x03030303), (6, 0x000F000F), (12, 0x000000FF)),
    }[stride]
    for shift, mask in steps:
        v = (v | (v >> shift)) & mask if shift else v & mask
    return v

"""Points of the unit cube along a space-filling curve: neighbouring lanes walk similar trees, errors fall faster."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.upload import upload

BITS = 32  # of a place on the curve


def stratified_points(group: mi.UInt32, rng: mi.PCG32) -> mi.Point2f:
    """
    Uniform points of the unit square, those of each group one in each of as many equal parts of a space-filling curve.

    Neighbouring lanes walk similar trees, so that few of them idle. The points of a group lie more evenly than random
    ones: a mean over n of them has an error that falls as n^-1 where the integrand is smooth, and as n^-3/4 where it
    has edges, such as those of a pupil. Groups are independent. The curve is Morton's with 2^32 cells; three numbers of
    each generator are drawn.

    Parameters
    ----------
    group : mi.UInt32
        Ascending, one for each lane.
    rng : mi.PCG32
    """
    groups = np.array(group)
    first = np.searchsorted(groups, np.arange(int(groups[-1]) + 2))
    begin, size = (dr.gather(mi.UInt32, upload(mi.UInt32, v), group) for v in (first[:-1], np.diff(first)))
    number = mi.Float64(dr.arange(mi.UInt32, len(groups)) - begin) + mi.Float64(rng.next_float32())
    return mi.Point2f(*curve_points(number / mi.Float64(size), 2, rng))


def curve_points(place: mi.Float64, dimensions: int, rng: mi.PCG32) -> list[mi.Float]:
    """
    Points of the unit cube by their places on Morton's curve.

    Parameters
    ----------
    place : mi.Float64
        0 … 1 along the curve; uniform places give uniform points.
    dimensions : int
        2 or 4.
    rng : mi.PCG32
        One generator a lane; one number is drawn for each dimension, for the place within a cell.

    Returns
    -------
    list of mi.Float
        Coordinates, 0 … 1.
    """
    cell = mi.UInt32(dr.minimum(place, 1 - 2.0 ** -(BITS + 1)) * 2.0**BITS)
    scale = 2.0 ** -(BITS // dimensions)
    return [
        (mi.Float(_every(mi.UInt32(cell >> k), dimensions)) + rng.next_float32()) * scale for k in range(dimensions)
    ]


def _every(v: mi.UInt32, stride: int) -> mi.UInt32:
    """The bits of a word at multiples of 2 or 4, side by side."""
    steps = {
        2: ((0, 0x55555555), (1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)),
        4: ((0, 0x11111111), (3, 0x03030303), (6, 0x000F000F), (12, 0x000000FF)),
    }[stride]
    for shift, mask in steps:
        v = (v | (v >> shift)) & mask if shift else v & mask
    return v

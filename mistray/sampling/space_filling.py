"""Random points of the unit cube along a space-filling curve, so that neighbouring lanes walk similar trees."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.upload import upload

BITS = 32  # of a place on the curve


def sorted_places(batch: mi.UInt32, rng: mi.PCG32, closing: np.ndarray) -> mi.Float64:
    """
    Independent uniform numbers 0 … 1, those of each batch sorted.

    Sorted uniform numbers without a sort: partial sums of exponential variables over their total, which holds one more
    variable, `closing` (L. Devroye, Non-Uniform Random Variate Generation, 1986, section V.2.2).

    Parameters
    ----------
    batch : mi.UInt32
        Ascending, one for each lane.
    rng : mi.PCG32
        One number of each generator is drawn.
    closing : (batches,) float
        Independent exponential variables.
    """
    sums = dr.cumsum(mi.Float64(-dr.log(1 - rng.next_float32())))
    first = np.searchsorted(np.array(batch), np.arange(len(closing) + 1))
    totals = np.concatenate([[0.0], np.array(sums)])[first]
    start, length = upload(mi.Float64, totals[:-1]), upload(mi.Float64, np.diff(totals) + closing)
    return (sums - dr.gather(mi.Float64, start, batch)) / dr.gather(mi.Float64, length, batch)


def sorted_points(batch: mi.UInt32, rng: mi.PCG32, closing: np.ndarray) -> mi.Point2f:
    """
    Independent uniform points of the unit square, those of each batch in the order of a space-filling curve.

    Neighbouring lanes then walk similar trees, so that few of them idle, and the batches stay independent samples. The
    curve is Morton's with 2^32 cells; the place within a cell is random. The arguments are those of `sorted_places`;
    three numbers of each generator are drawn.
    """
    return mi.Point2f(*curve_points(sorted_places(batch, rng, closing), 2, rng))


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

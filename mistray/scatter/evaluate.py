"""BSDF of lobes at given directions, in float64: for plots, tables and files."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.scatter.lobe import Lobe
from mistray.scatter.total import factor_values

TINY = 1e-30  # cosine of a scattered direction in the plane of the surface


def bsdf(
    lobes: Sequence[Lobe], event: str, cos_i: float, directions: np.ndarray, n_in: float, n_out: float, share: float
) -> np.ndarray:
    """
    Sum of the lobes of one event, 1/sr.

    Parameters
    ----------
    lobes : sequence of Lobe
        For light of the side in question.
    event : {"reflection", "transmission"}
    cos_i : float
        Cosine of the angle of incidence.
    directions : (…, 3) float64
        Scattered unit vectors: x along the tangential part of the incident light, z ≥ 0 along the normal on the side
        that the scattered light is on.
    n_in, n_out : float
        Indices on the side of incidence and on the other.
    share : float
        R or T of the coating at this angle.

    Returns
    -------
    (…) float64
        BSDF: scattered radiance by incident irradiance. It is 0 in transmission beyond the critical angle, where there
        is no direction to count from, but for lobes about the normal.
    """
    sin_i = np.sqrt(max(0.0, 1 - cos_i * cos_i))
    sin_0 = sin_i if event == "reflection" else sin_i * n_in / n_out
    total = np.zeros(directions.shape[:-1])
    for lobe in lobes:
        if lobe.event != event or (sin_0 >= 1 and event == "transmission" and lobe.centre != "normal"):
            continue
        c0, c1, c2 = lobe.shares
        total = total + (c0 + c1 * share + c2 * share * share) * _shape(lobe, cos_i, sin_0, directions)
    return total


def _shape(lobe: Lobe, cos_i: float, sin_0: float, directions: np.ndarray) -> np.ndarray:
    """BSDF of a lobe per unit of its coefficient."""
    x, y, cos_s = np.moveaxis(directions, -1, 0)
    cos_0 = np.sqrt(max(0.0, 1 - sin_0 * sin_0))
    centre = {"specular": sin_0, "normal": 0.0, "retro": -sin_0}[lobe.centre]
    if lobe.measure == "angle":
        r = np.sqrt((x - centre) ** 2 + y**2 + (cos_s - cos_0) ** 2)
        oblique = lobe.oblique(np.array([cos_i]))[0]
        return np.asarray(oblique * lobe.profile(r.ravel()).reshape(r.shape) / np.maximum(cos_s, TINY))
    r = np.hypot(x - centre, y)
    values = lobe.profile(r.ravel()).reshape(r.shape) * factor_values(lobe, cos_i, cos_s)
    if lobe.ratio is not None and lobe.ratio.axes == "radial":
        values = values * lobe.ratio.at(np.asarray(cos_0), r, np.arctan2(np.abs(y), x - centre))
    elif lobe.ratio is not None:
        values = values * lobe.ratio.at(np.asarray(cos_0), cos_s, np.arctan2(np.abs(y), x))
    return np.asarray(values)

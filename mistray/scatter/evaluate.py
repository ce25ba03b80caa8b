"""BSDF of lobes at given directions, in float64, for plots, tables and files."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.scatter.lobe import Lobe, factor

TINY = 1e-30  # least cosine of a scattered direction with the normal


def bsdf(
    lobes: Sequence[Lobe],
    event: str,
    cos_i: float | np.ndarray,
    directions: np.ndarray,
    n_in: float,
    n_out: float,
    share: float | np.ndarray,
    rotation: float = 0.0,
) -> np.ndarray:
    """
    Return the BSDF of all lobes of one event, 1/sr.

    Parameters
    ----------
    lobes : sequence of Lobe
        Lobes for light from the side of incidence.
    event : {"reflection", "transmission"}
        Event whose lobes are evaluated.
    cos_i : float or (…) float64
        Cosine of the angle of incidence: one for all light, or one for each scattered direction.
    directions : (…, 3) float64
        Unit vectors of the scattered light. x points along the tangential part of the incident light. z ≥ 0 points
        along the normal on the side of the scattered light. x, y and the normal on the side of incidence are
        right-handed.
    n_in, n_out : float
        Refractive indices on the side of incidence and on the other side.
    share : float or (…) float64
        R or T of the coating at the angle of incidence.
    rotation : float
        Azimuth of the sample's x axis, rad, from x towards y.

    Returns
    -------
    (…) float64
        BSDF, scattered radiance divided by incident irradiance, 1/sr. Beyond the critical angle there is no transmitted
        direction, and only lobes about the normal count in transmission.
    """
    cos_i = np.asarray(cos_i, dtype=np.float64)
    sin_i = np.sqrt(np.maximum(0.0, 1 - cos_i * cos_i))
    sin_0 = sin_i if event == "reflection" else sin_i * n_in / n_out
    total = np.zeros(directions.shape[:-1])
    for lobe in lobes:
        no_centre = sin_0 >= 1 if event == "transmission" and lobe.centre != "normal" else np.zeros_like(sin_0, bool)
        if lobe.event != event or np.all(no_centre):
            continue
        c0, c1, c2 = lobe.shares
        values = (c0 + c1 * share + c2 * share * share) * _shape(lobe, cos_i, sin_0, directions, rotation)
        total = total + np.where(no_centre, 0.0, values)
    return total


def _shape(lobe: Lobe, cos_i: np.ndarray, sin_0: np.ndarray, directions: np.ndarray, rotation: float) -> np.ndarray:
    """
    Return the BSDF of a lobe, 1/sr, divided by its coefficient c, for scattered directions, unit vectors (…, 3).

    `sin_0` is the sine of the specular direction with the normal. For the others see `bsdf`.
    """
    x, y, cos_s = np.moveaxis(directions, -1, 0)
    cos_0 = np.sqrt(np.maximum(0.0, 1 - sin_0 * sin_0))
    centre = {"specular": sin_0, "normal": np.zeros_like(sin_0), "retro": -sin_0}[lobe.centre]
    if lobe.measure == "angle":
        r = np.sqrt((x - centre) ** 2 + y**2 + (cos_s - cos_0) ** 2)
        over_cos_s = 1.0 if lobe.factor == "cosine" else 1 / np.maximum(cos_s, TINY)
        return np.asarray(lobe.oblique(cos_i) * lobe.profile(r.ravel()).reshape(r.shape) * over_cos_s)
    r = np.hypot(x - centre, y)
    values = lobe.profile(r.ravel()).reshape(r.shape) * factor(lobe.factor, cos_i, cos_s, cos_0, r * r)
    if lobe.ratio is not None and lobe.ratio.axes != "cosines":
        values = values * lobe.ratio.at(cos_0, r, np.arctan2(y, x - centre), rotation)
    elif lobe.ratio is not None:
        values = values * lobe.ratio.at(cos_0, cos_s, np.arctan2(y, x), rotation)
    return np.asarray(values)

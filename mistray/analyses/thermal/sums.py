"""Sums over wavelengths of a detector's view, by batches of rays, with their standard errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mistray.analyses.thermal.spectrum import band_weights
from mistray.estimate import UNKNOWN, Estimate
from mistray.execute.seen import Seen

Key = tuple[str, str]  # kind and name of what emits


def emission(one: Seen, key: Key) -> np.ndarray:
    """
    Return the emission of a surface or medium, as the detector sees it, in each batch of a trace, (batches,).

    It is dimensionless, see `Seen`, and 0 for a surface or medium that the detector does not see.
    """
    kind, name = key
    nothing = np.zeros_like(one.escaped[2])
    if kind == "medium":
        return one.media[name][2] if name in one.media else nothing
    return next((row.emission_by_batch for row in one.rows if row.id == name), nothing)


def imaged_share(one: Seen) -> np.ndarray:
    """
    Return the share of the detector's view, times n², that is the imaged scene, in each batch of a trace, (batches,).

    Without a known image it is the share that escapes. n is the index before the detector, see `Seen`.
    """
    return (one.image or one.escaped)[2]


def weighted_sum(weights: np.ndarray, by_batch: Sequence[np.ndarray]) -> Estimate:
    """Return the weighted sum of independent traces, each the mean of its (batches,), with its standard error."""
    value = math.fsum(float(w * np.mean(batches)) for w, batches in zip(weights, by_batch, strict=True))
    errors = [float(w * np.std(b, ddof=1)) / math.sqrt(len(b)) for w, b in zip(weights, by_batch, strict=True)]
    return Estimate(value, math.hypot(*errors))


def total(by_wave: Sequence[np.ndarray]) -> Estimate:
    """Return the sum over wavelengths, each the mean of its batch values, (batches,), with its standard error."""
    return weighted_sum(np.ones(len(by_wave)), by_wave)


def ratio(top: Sequence[np.ndarray], bottom: Sequence[np.ndarray]) -> Estimate:
    """
    Return the ratio of two quantities, each summed over wavelengths, from the same rays, with its standard error.

    It is NaN unless the sum of `bottom` is above 0.
    """
    whole = total(bottom).value
    if whole <= 0:
        return UNKNOWN
    quotient = total(top).value / whole
    rest = total([(above - quotient * below) / whole for above, below in zip(top, bottom, strict=True)])
    return Estimate(quotient, rest.se)


def with_band_error(value: Estimate, bound: float) -> Estimate:
    """
    Return an estimate with the relative error of band sampling added, uniform within ±`bound`.

    A `bound` that is infinite or NaN adds nothing.
    """
    more = bound / math.sqrt(3) if math.isfinite(bound) else 0.0  # a note says if it is not known
    return Estimate(value.value, math.hypot(value.se, more * value.value))


def per_kelvin(
    image: Sequence[Seen],
    scene_K: float,
    band: tuple[float, float],
    waves: tuple[float, ...],
    photons: bool = False,
) -> list[np.ndarray]:
    """
    Return the derivative of the imaged scene's irradiance with respect to its temperature, W/(mm² K).

    There is an array over batches for each of the wavelengths `waves`, µm, at which `image` was traced. `band` holds
    the ends of the band, µm. With `photons` the unit is photons/(s mm² K).
    """
    weights = np.pi * band_weights(scene_K, band, waves, derivative=True, photons=photons)
    return [weight * imaged_share(one) for weight, one in zip(weights, image, strict=True)]

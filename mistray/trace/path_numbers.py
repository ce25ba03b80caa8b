"""Power, centroid and radius of paths, with standard errors, from the sums of the ledger."""

from __future__ import annotations

import numpy as np

from mistray.trace.energy import batch_error
from mistray.trace.ledger import SUMS

CHUNK = 1024  # paths that are worked out together


def path_numbers(sums: np.ndarray, started: np.ndarray, unit: float, branching: np.ndarray) -> dict[str, np.ndarray]:
    """
    Power, centroid and radius of paths from their sums by batch.

    The error of the power is that of a mean over the start rays. Where each of them takes the path at most once it is
    se² = Σa² - (Σa)²/N. Where a start ray branches, because a hit scatters several rays, it follows from the spread of
    the batches. Centroid and radius are ratios of sums; their errors come from leaving out one batch at a time
    (jackknife).

    Parameters
    ----------
    sums : (p, BATCHES, SUMS or STOKES_SUMS) float64
        See `mistray.trace.ledger`.
    started : (BATCHES,) float64
        Start rays of the batches.
    unit : float
        Flux of a start ray, W.
    branching : (p,) bool
        Paths that one start ray can take several times.

    Returns
    -------
    dict
        Columns of `PathRow` from ``rays`` to ``polarization_se`` but for the percentages, (p,) each.
    """
    parts = [
        _chunk(sums[first : first + CHUNK], started, unit, branching[first : first + CHUNK])
        for first in range(0, max(len(sums), 1), CHUNK)
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _chunk(sums: np.ndarray, started: np.ndarray, unit: float, branching: np.ndarray) -> dict[str, np.ndarray]:
    total, rays = sums.sum(axis=1), started.sum()
    count, incident, absorbed, squares = total[:, :4].T
    single = np.sqrt(np.maximum(squares - absorbed**2 / rays, 0.0))
    relative = np.where(branching, batch_error(sums[:, :, 2], started), single) / absorbed

    values = _shape(total, unit)
    # Without the batch, and the flux scaled to that of all batches
    without = total[:, None] - sums
    without[:, :, 2:] *= (rays / np.maximum(rays - started, 1))[:, None]
    left_out = _shape(without, unit)
    n = left_out.shape[2]
    known = np.isfinite(left_out).all(axis=2)  # not where a batch holds all rays, or all but one
    with np.errstate(invalid="ignore"):
        spread = np.sum(np.square(left_out - left_out.mean(axis=2, keepdims=True)), axis=2)
        se = np.where(known, np.sqrt((n - 1) / n * spread), np.inf)
    return {
        "rays": count.round().astype(np.int64),
        "power_W": unit * absorbed,
        "power_se_W": unit * absorbed * relative,
        "incident_W": unit * incident,
        "incident_se_W": unit * incident * relative,
        "x_mm": values[0],
        "x_se_mm": se[0],
        "y_mm": values[1],
        "y_se_mm": se[1],
        "rms_radius_mm": values[2],
        "rms_radius_se_mm": se[2],
        "rms_irradiance_W_mm2": values[3],
        "rms_irradiance_se_W_mm2": se[3],
        "polarization": values[4],
        "polarization_se": np.where(np.isfinite(values[4]), se[4], np.nan),
    }


def _shape(sums: np.ndarray, unit: float) -> np.ndarray:
    """(5, …): x, y, RMS radius, RMS irradiance and degree of polarisation of sums (…, SUMS or STOKES_SUMS)."""
    a = sums[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = sums[..., 4] / a, sums[..., 5] / a
        variance = np.maximum(sums[..., 6] / a - x * x - y * y, 0.0)
        polarised = sums.shape[-1] > SUMS
        degree = np.linalg.norm(sums[..., SUMS:], axis=-1) / a if polarised else np.full(a.shape, np.nan)
        return np.stack([x, y, np.sqrt(variance), a * unit / (np.pi * variance), degree])

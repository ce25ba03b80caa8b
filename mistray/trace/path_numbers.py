"""
Power, centroid and radius of paths, with standard errors, from the sums of the ledger.

Errors of ratios are those of a jackknife over n batches of start rays (B. Efron, The jackknife, the bootstrap and other
resampling plans, 1982): se² = (n - 1)/n Σ_k (θ_k - mean θ)², where θ_k is the result without batch k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mistray.recorders.ledger import SUMS
from mistray.recorders.sampled import Sampled, error_rays, few_rays

CHUNK = 1024  # number of paths that are evaluated together
# Columns of `HitSums.columns`; the last three are the sums of s1, s2, s3
RAYS, INCIDENT, ABSORBED, BY_X, BY_Y, BY_SQUARE, S1, S2, S3 = range(9)
# Results of `_shape`, and the ends of the names of their columns
SHAPE = {"x": "_mm", "y": "_mm", "rms_radius": "_mm", "rms_irradiance": "_W_mm2"} | dict.fromkeys(
    ("polarization", "s1", "s2", "s3"), ""
)
SQUARES, FOURTHS = 6, 7  # columns of the ledger: absorbed², absorbed⁴


class HitSums(NamedTuple):
    """
    Sums of flux and its moments over the detector hits of p paths of a run, by batch of start rays.

    Attributes
    ----------
    sums : (p, BATCHES, SUMS or STOKES_SUMS) float64
        Sums by batch, see `mistray.recorders.ledger`.
    started : (BATCHES,) float64
        Number of start rays of the batches.
    unit : float
        Flux of a start ray, W.
    """

    sums: np.ndarray
    started: np.ndarray
    unit: float

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Sums over all batches, (p, 9), and over all but each in turn, scaled to as many rays, (p, BATCHES, 9).

        Columns: number of rays, incident and absorbed flux, W, moments of the absorbed flux (flux times x and times y,
        W mm, flux times x² + y², W mm²), and its Stokes parameters, W, which are NaN if the trace was unpolarised.
        """
        total, rays = self.sums.sum(axis=1), self.started.sum()
        without = (total[:, None] - self.sums) * (rays / np.maximum(rays - self.started, 1))[:, None]
        return self._in_watt(total), self._in_watt(without)

    def _in_watt(self, sums: np.ndarray) -> np.ndarray:
        found = self.unit * sums[..., [0, 1, 2, 3, 4, 5, 5, 5, 5]]
        found[..., RAYS] = sums[..., 0]
        stokes = sums[..., SUMS:]
        found[..., S1:] = self.unit * stokes if stokes.shape[-1] else np.nan
        return found

    @property
    def weights(self) -> np.ndarray:
        """Number of hits of each path, and Σ Φᵏ over them for k = 1, 2, 4, in Wᵏ, of the absorbed flux Φ; (p, 4)."""
        powers = self.unit ** np.array([0.0, 1.0, 2.0, 4.0])
        return np.asarray(powers * self.sums[:, :, [RAYS, ABSORBED, SQUARES, FOURTHS]].sum(axis=1))


@dataclass(frozen=True, eq=False)
class PathNumbers:
    """
    Power, centroid, radius and polarisation of paths, with standard errors.

    Attributes
    ----------
    columns : dict
        Columns of `PathRow` from ``rays`` to ``s3_se``, (p,) each, but for the percentages and what `judged` adds.
    light, density : Sampled
        Power, W, and RMS irradiance, W/mm², with their correlation to other numbers of the same trace.
    weights : (p, 4) float64
        See `HitSums.weights`.
    """

    columns: dict[str, np.ndarray]
    light: Sampled
    density: Sampled
    weights: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> PathNumbers:
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return PathNumbers(columns, self.light[chosen], self.density[chosen], self.weights[chosen])

    def judged(self, kind: np.ndarray) -> dict[str, np.ndarray]:
        """
        Return `columns` with effective numbers of rays, and with NaN for standard errors that too few rays support.

        See `mistray.recorders.sampled.error_rays`.

        Parameters
        ----------
        kind : (p,) int
            Group of each path; paths of a group have rays of similar weights.

        Returns
        -------
        dict
            `columns` with ``effective_rays``, ``error_rays`` and ``few_rays`` of `PathRow`; standard errors of paths of
            few rays are NaN.
        """
        rays, light, squares, fourths = self.weights.T
        with np.errstate(divide="ignore", invalid="ignore"):
            effective = light**2 / squares
        found = error_rays(rays, light, squares, fourths, lambda values: np.bincount(kind, values)[kind])
        few = few_rays(found)
        # Columns of standard errors, as "x_se_mm" of "x_mm"
        errors = {name: np.where(few, np.nan, own) for name, own in self.columns.items() if "_se_" in f"{name}_"}
        return self.columns | errors | {
            "effective_rays": np.nan_to_num(effective, nan=0.0), "error_rays": found, "few_rays": few,
        }  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence[PathNumbers]) -> PathNumbers:
        """Return one object with the numbers of the paths of all parts, concatenated."""
        light, density = (
            Sampled(np.concatenate([one.value for one in each]), np.concatenate([one.apart for one in each]))
            for each in ([part.light for part in parts], [part.density for part in parts])
        )
        columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
        return cls(columns, light, density, np.concatenate([part.weights for part in parts]))


def path_numbers(runs: Sequence[HitSums]) -> PathNumbers:
    """
    Return power, centroid, radius and polarisation of paths, each path summed over runs, with standard errors.

    Centroid, radius and RMS irradiance are ratios of sums; their errors come from leaving out one batch at a time
    (jackknife).

    Parameters
    ----------
    runs : sequence of HitSums
        Sums of the runs, of as many paths each; light of several runs (wavelengths, sources) adds up.
    """
    count = len(runs[0].sums)
    parts = [
        _chunk([run._replace(sums=run.sums[k : k + CHUNK]) for run in runs]) for k in range(0, max(count, 1), CHUNK)
    ]
    return PathNumbers.joined(parts)


def _chunk(runs: Sequence[HitSums]) -> PathNumbers:
    each = [run.columns for run in runs]
    total, without = (np.sum([columns[k] for columns in each], axis=0) for k in (0, 1))
    # The error of the power follows from the spread of the batches, not from that of single rays: the rays of a batch
    # are stratified over the source, so that their sum has a smaller error than as many independent ones
    light = [Sampled.of(run.sums[:, :, ABSORBED], run.started).scaled(run.unit) for run in runs]
    variances = np.array([np.square(one.se) for one in light])
    power, incident = total[:, ABSORBED], total[:, INCIDENT]
    # Jackknife
    values, left_out = _shape(total), _shape(without)
    n = left_out.shape[2]
    known = np.isfinite(left_out).all(axis=2, keepdims=True)  # not where a batch holds all rays, or all but one
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.sqrt((n - 1) / n) * (left_out.mean(axis=2, keepdims=True) - left_out)
        apart = np.where(known, spread, np.inf)
        se = np.sqrt(np.sum(np.square(apart), axis=2))
        # The detector absorbs about the same share of all hits of a run: relative errors are equal
        shares = [np.where(here[:, ABSORBED] > 0, here[:, INCIDENT] / here[:, ABSORBED], 0) for here, _ in each]
    for numbers in (values[3], se[3], apart[3]):
        numbers[total[:, RAYS] < 2] = np.nan  # one ray lies in a point, and says nothing of an area
    columns = {
        "rays": total[:, RAYS].round().astype(np.int64),
        "power_W": power,
        "power_se_W": np.sqrt(variances.sum(axis=0)),
        "incident_W": incident,
        "incident_se_W": np.sqrt(np.sum(np.square(shares) * variances, axis=0)),
    }
    se[4:][~np.isfinite(values[4:])] = np.nan  # unpolarised light
    for (name, unit), value, error in zip(SHAPE.items(), values, se, strict=True):
        columns |= {f"{name}{unit}": value, f"{name}_se{unit}": error}
    weights = np.sum([run.weights for run in runs], axis=0)
    return PathNumbers(columns, sum(light[1:], start=light[0]), Sampled(values[3], apart[3]), weights)


def _shape(sums: np.ndarray) -> np.ndarray:
    """
    Return eight values derived from `sums` (…, 9), as an array (8, …); NaN without power.

    They are centroid x and y, mm, RMS radius, mm, RMS irradiance, W/mm², degree of polarisation, s1, s2 and s3.
    """
    power = sums[..., ABSORBED]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = sums[..., BY_X] / power, sums[..., BY_Y] / power
        variance = np.maximum(sums[..., BY_SQUARE] / power - x * x - y * y, 0.0)
        stokes = [sums[..., k] / power for k in (S1, S2, S3)]
        degree = np.linalg.norm(stokes, axis=0)
        return np.stack([x, y, np.sqrt(variance), power / (np.pi * variance), degree, *stokes])


def percents(light: Sampled, of: Sampled, few: np.ndarray) -> dict[str, np.ndarray]:
    """
    Return the columns ``percent`` and ``percent_se``, (p,): the powers `light`, W, as percentages of one power `of`, W.

    The error is NaN where `few`, (p,) bool, is True.
    """
    found = light.over(of[None]).scaled(100.0)
    return {"percent": found.value, "percent_se": np.where(few, np.nan, found.se)}


def alike(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return a group index for each path, (p,) int; paths equal in all given columns have the same index."""
    keys = [np.unique(column, return_inverse=True)[1] for column in columns]
    return np.asarray(np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)[1]).ravel()

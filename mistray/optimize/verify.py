"""Two designs compared on seeds that the search has not seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mistray.optimize.designs import CoatedScene, Design, spectrum
from mistray.optimize.study import MetricStudy

SEEDS = 8


@dataclass(frozen=True)
class Row:
    """
    One number before and after.

    Attributes
    ----------
    field_deg : float or None
        Field angle, degrees; None: mean over the fields (or the source's own field).
    wavelength_nm : float or None
        None: all wavelengths with their weights.
    before, before_se, after, after_se : float
        The metric of the start and of the result: mean over the seeds and its standard error.
    ratio, ratio_se : float
        before / after, for the same rays; NaN if nothing is left.
    """

    field_deg: float | None
    wavelength_nm: float | None
    before: float
    before_se: float
    after: float
    after_se: float
    ratio: float
    ratio_se: float


class Levels:
    """
    A metric by seed, field and wavelength.

    Parameters
    ----------
    numerator, denominator : (seeds, fields, wavelengths) float64
        Power of the paths, and what it is divided by, each over the launched power of its wavelength.
    weights : (wavelengths,) float64
        Shares of the launched power.
    """

    def __init__(self, numerator: np.ndarray, denominator: np.ndarray, weights: np.ndarray) -> None:
        self.numerator, self.denominator, self.weights = numerator, denominator, weights

    def __call__(self, field: int | None = None, wavelength: int | None = None) -> np.ndarray:
        """The metric by seed, (seeds,): mean over the fields, all wavelengths together, unless one is picked."""
        parts = []
        for values in (self.numerator, self.denominator):
            band = values @ self.weights if wavelength is None else values[:, :, wavelength]
            parts.append(band)
        ratio = parts[0] / parts[1]
        return np.asarray(ratio.mean(axis=1) if field is None else ratio[:, field])


@dataclass(frozen=True)
class Comparison:
    """
    Start and result on independent seeds.

    Attributes
    ----------
    seeds : tuple of int
    rows : tuple of Row
        The whole, each field, each wavelength, each field at each wavelength.
    """

    seeds: tuple[int, ...]
    rows: tuple[Row, ...]

    @property
    def total(self) -> Row:
        """The whole metric."""
        return self.rows[0]

    def marginals(self) -> Iterator[Row]:
        """The whole, each field and each wavelength."""
        return (row for row in self.rows if row.field_deg is None or row.wavelength_nm is None)


def levels(coated: CoatedScene, study: MetricStudy, design: Design, seeds: tuple[int, ...]) -> Levels:
    """Trace a design with several seeds."""
    coated.apply(design.thickness_nm)
    return scene_levels(coated.scene, study, seeds)

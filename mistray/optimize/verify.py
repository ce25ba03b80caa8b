"""Two designs compared on seeds that the search has not seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.optimize.designs import spectrum
from mistray.optimize.study import MetricStudy

SEEDS = 8


@dataclass(frozen=True)
class Levels:
    """
    A metric by seed, field and wavelength.

    Attributes
    ----------
    fields_deg : tuple of float or None
        Field angles, degrees; (None,): the source's own.
    wavelengths_nm : tuple of float or None
        (None,): all of the source's together.
    weights : (wavelengths,) float64
        Shares of the flux.
    seeds : tuple of int
    numerator, denominator : (seeds, fields, wavelengths) float64
        Power of the paths, and what it is divided by, each over the launched power of its wavelength.
    """

    fields_deg: tuple[float | None, ...]
    wavelengths_nm: tuple[float | None, ...]
    weights: np.ndarray
    seeds: tuple[int, ...]
    numerator: np.ndarray
    denominator: np.ndarray

    def at(self, field: int | None = None, wavelength: int | None = None) -> np.ndarray:
        """The metric by seed, (seeds,): mean over the fields and all wavelengths together unless one is picked."""

        def band(values: np.ndarray) -> np.ndarray:
            return np.asarray(values @ self.weights if wavelength is None else values[:, :, wavelength])

        ratio = band(self.numerator) / band(self.denominator)
        return np.asarray(ratio.mean(axis=1) if field is None else ratio[:, field])


@dataclass(frozen=True)
class Row:
    """
    One number before and after.

    Attributes
    ----------
    field_deg : float or None
        Field angle, degrees; None: mean over the fields, or the source's own.
    wavelength_nm : float or None
        None: all wavelengths with their weights.
    before, before_se, after, after_se : float
        The metric of the two designs, mean over the seeds, with standard errors.
    ratio, ratio_se : float
        before / after. Both trace the same rays, so its error is smaller than theirs.
    """

    field_deg: float | None
    wavelength_nm: float | None
    before: float
    before_se: float
    after: float
    after_se: float
    ratio: float
    ratio_se: float


@dataclass(frozen=True)
class Comparison:
    """
    Two designs on the same independent seeds.

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


def measure(scene: Any, study: MetricStudy, seeds: int = SEEDS) -> Levels:
    """
    The metric of a scene on seeds that the search does not use: those that follow the study's own.

    Parameters
    ----------
    scene : mi.Scene
    study : MetricStudy
    seeds : int
        Number of seeds, at least 2.
    """
    if seeds < 2:
        raise MistrayError(f"seeds is {seeds}; a standard error needs at least 2")
    numbers = tuple(study.seed + 1 + k for k in range(seeds))
    wavelengths, weights = spectrum(scene, study)
    lines: list[tuple[float | None, float]] = list(zip(wavelengths, weights, strict=True))
    if study.wavelength_nm is None:
        lines = [(None, 1.0)]
    power = np.zeros((2, seeds, len(study.fields_deg or (None,)), len(lines)))
    for k, (nm, share) in enumerate(lines):
        rays = max(1, round(share * study.rays))
        metric = study.metric(scene, wavelength_nm=nm, weights=None, rays=rays)
        for j, seed in enumerate(numbers):
            for i, observation in enumerate(metric.observe(seed=seed)):
                signal = 1.0 if study.kind == "path_power" else _share(observation, "direct")
                power[:, j, i, k] = _share(observation, study.paths), signal
    return Levels(
        study.fields_deg or (None,), tuple(nm for nm, _ in lines), np.array([w for _, w in lines]), numbers, *power
    )


def _share(observation: Any, paths: str) -> float:
    """Power of some paths over the launched power."""
    return float(np.array(observation.power(paths))[0]) / float(observation.launched_W)


def compare(before: Levels, after: Levels) -> Comparison:
    """The rows of two measurements with the same seeds, fields and wavelengths."""
    same = ("fields_deg", "wavelengths_nm", "seeds")
    for key in same:
        if getattr(before, key) != getattr(after, key):
            raise MistrayError(f"the two measurements differ in {key}; measure both scenes with the same study")
    fields: list[int | None] = list(range(len(before.fields_deg)))
    lines: list[int | None] = list(range(len(before.wavelengths_nm)))
    fields, lines = (fields if len(fields) > 1 else []), (lines if len(lines) > 1 else [])
    cells: list[tuple[int | None, int | None]] = [(None, None), *((i, None) for i in fields)]
    cells += [(None, k) for k in lines] + [(i, k) for i in fields for k in lines]
    rows = []
    for i, k in cells:
        b, a = before.at(i, k), after.at(i, k)
        root = np.sqrt(len(b))
        ratio, ratio_se = np.nan, np.nan
        if a.mean() > 0:
            ratio = b.mean() / a.mean()
            ratio_se = (b - ratio * a).std(ddof=1) / a.mean() / root  # of a ratio of means
        rows.append(
            Row(
                None if i is None else before.fields_deg[i],
                None if k is None else before.wavelengths_nm[k],
                float(b.mean()),
                float(b.std(ddof=1) / root),
                float(a.mean()),
                float(a.std(ddof=1) / root),
                float(ratio),
                float(ratio_se),
            )
        )
    return Comparison(before.seeds, tuple(rows))

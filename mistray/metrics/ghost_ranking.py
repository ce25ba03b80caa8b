"""Ranking of ghosts and other paths by power and by RMS irradiance, relative to the direct image on axis."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.estimate import UNKNOWN, Estimate
from mistray.recorders.path_events import DIRECT
from mistray.recorders.sampled import Sampled
from mistray.trace.paths import PathTable

SURE = 2.0  # standard errors from a value to its bounds, by which paths are ranked


@dataclass(frozen=True)
class DirectImage:
    """
    Direct image (unscattered, intended light) at one field angle: power, W, RMS radius, mm, and irradiance, W/mm².

    Attributes
    ----------
    power_W, rms_radius_mm, rms_irradiance_W_mm2 : Estimate
        Absorbed power, W, RMS radius about the centroid, mm, and ``P / (π r_rms²)``, W/mm². The last two are NaN, and
        the power is 0, where no direct light reaches the detector.
    paths : PathTable
        Paths of the trace that the image belongs to.
    path_ids : tuple of int
        Ids of the paths that form the direct image.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> image = report.nominal
    >>> print(f"{image.power_W.value:.0f} W within an RMS radius of {1000 * image.rms_radius_mm.value:.0f} µm")
    82 W within an RMS radius of 12 µm
    """

    power_W: Estimate
    rms_radius_mm: Estimate
    rms_irradiance_W_mm2: Estimate
    paths: PathTable = field(repr=False, compare=False)
    path_ids: tuple[int, ...] = field(repr=False, compare=False)

    def dividing(self, above: Sampled, what: Literal["light", "density"]) -> Sampled:
        """
        Return the power ("light") or RMS irradiance ("density") of paths, `above`, over that of the direct image.

        `above` is in W or W/mm². The ratio is NaN if there is no direct image.
        """
        if not self.path_ids:
            return Sampled(np.full_like(above.value, np.nan), np.full_like(above.apart, np.nan))
        own: Sampled = getattr(self.paths.numbers([self.path_ids]), what)
        return above.over(own if above.value.ndim else own[0])


def direct_image(paths: PathTable, wavelength_nm: float | None = None) -> DirectImage:
    """
    Return power, W, RMS radius, mm, and RMS irradiance, W/mm², of the direct image of a trace.

    Parameters
    ----------
    paths : PathTable
        Paths of the trace.
    wavelength_nm : float, optional
        Wavelength, nm, whose light alone counts; by default all light does. Without direct light the power is 0, and
        the others are NaN.
    """
    ids = tuple(paths.ids(True, wavelength_nm).tolist())
    if not ids:
        return DirectImage(Estimate(0.0, 0.0), UNKNOWN, UNKNOWN, paths, ids)
    numbers = paths.numbers([ids]).columns
    radius, density = (
        Estimate(float(numbers[f"{name}{unit}"][0]), float(numbers[f"{name}_se{unit}"][0]))
        for name, unit in (("rms_radius", "_mm"), ("rms_irradiance", "_W_mm2"))
    )
    return DirectImage(Estimate(*paths.power(ids)), radius, density, paths, ids)


def stray_to_direct(paths: PathTable, image: DirectImage, wavelength_nm: float | None = None) -> Estimate:
    """
    Return the power of the stray light of a trace over that of a direct image; NaN without one.

    Parameters
    ----------
    paths : PathTable
        Paths of the trace with the stray light.
    image : DirectImage
        Direct image of the same trace or of another one, by which the power is divided.
    wavelength_nm : float, optional
        Wavelength, nm, of the stray light that counts; by default all light does.
    """
    found = image.dividing(paths.light(paths.ids(False, wavelength_nm)), "light")
    return Estimate(float(found.value), float(found.se))


def ranked(table: pd.DataFrame, paths: PathTable, nominal: DirectImage) -> pd.DataFrame:
    """
    Return a path table with normalised RMS irradiance, percentages of the stray light, and ranks.

    Parameters
    ----------
    table : DataFrame
        Rows of ``paths.by_way()``, or of the table that `mistray.analyses.ghosts.combine.by_path` makes of them.
    paths : PathTable
        Paths to which the rows refer by their ids.
    nominal : DirectImage
        Direct image; the RMS irradiance of each row is divided by that of this image.

    Returns
    -------
    DataFrame
        Rows in the same order, with the added columns that `GhostReport.table` lists.
    """
    table = table.copy()
    numbers = paths.numbers(list(table.path_ids))
    normalised = nominal.dividing(numbers.density, "density")
    few, stray = table.few_rays.to_numpy(np.bool_), (table.kind != DIRECT).to_numpy()
    of_stray = numbers.light.over(numbers.light[stray].total()[None]).scaled(100.0)
    for name, found, known in (
        ("normalised_rms_irradiance", normalised, np.isfinite(table.rms_irradiance_W_mm2)),
        ("percent_of_stray", of_stray, stray),
    ):
        table[name], table[f"{name}_se"] = (
            np.where(known, found.value, np.nan),
            np.where(known & ~few, found.se, np.nan),
        )
    light, (low, high) = table.power_W.to_numpy(np.float64), bounds(table)
    table["rank_power"] = ranks(table, np.lexsort((-light,)))
    table["rank_rms_irradiance"] = ranks(table, np.lexsort((-light, -np.where(np.isfinite(low), low, -np.inf))))
    first = low[table.rank_rms_irradiance == 1]
    table["contested"] = stray & (table.rank_rms_irradiance > 1) & (high > (first[0] if len(first) else np.inf))
    return table


def bounds(table: pd.DataFrame) -> npt.NDArray[np.float64]:
    """
    Return bounds of RMS irradiances, `SURE` standard errors below and above, (2, n), W/mm².

    A bound is NaN if the irradiance or its error is unknown.
    """
    value, se = (table[f"rms_irradiance{name}_W_mm2"].to_numpy(np.float64) for name in ("", "_se"))
    with np.errstate(invalid="ignore"):
        return np.stack([value - SURE * se, value + SURE * se])


def ranks(table: pd.DataFrame, order: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """
    Return the ranks of the stray paths of a table.

    Parameters
    ----------
    table : DataFrame
        Path table with the column ``kind``.
    order : (n,) int
        Indices of the rows, the worst first.

    Returns
    -------
    (n,) int
        Rank of each row: 1 is the worst stray path; 0 for direct paths.
    """
    stray = (table.kind != DIRECT).to_numpy()
    rank = np.zeros(len(table), dtype=np.int64)
    rank[order[stray[order]]] = np.arange(1, stray.sum() + 1)
    return rank

"""Several rows of a path table as one: a path at all its wavelengths, or the paths of the direct image.

Rows of different sources or wavelengths come from independent runs: their errors add in quadrature. Rows of one run
share start rays, so that nothing smaller than the linear sum of their errors is safe.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analysis.estimate import Estimate

Numbers = npt.NDArray[np.float64]


def power(rows: pd.DataFrame) -> Estimate:
    """Power of some rows of a path table together, W."""
    return Estimate(float(rows.power_W.sum()), _error(rows, rows.power_se_W.to_numpy(np.float64)))


def pooled(rows: pd.DataFrame) -> dict[str, Any]:
    """
    Numbers of some rows of a path table together, as those of one path.

    Powers add; second moments about the common centroid add with the powers as weights. Errors are propagated with the
    power, centroid and radius of a row as independent of each other, which they are where all rays of a path carry the
    same flux; over a coated pupil that is so to first order.

    Parameters
    ----------
    rows : DataFrame
        Rows of ``Trace.paths.to_pandas()``, at least one.

    Returns
    -------
    dict
        Columns of ``Trace.paths`` and their values for all rows together. ``wavelength_nm`` and ``polarization`` are
        means with the powers as weights. An error is infinite where that of a row is, and NaN where the value is.
    """

    def column(name: str) -> Numbers:
        return rows[name].to_numpy(np.float64)

    p, p_se = column("power_W"), column("power_se_W")
    x, y, r = column("x_mm"), column("y_mm"), column("rms_radius_mm")
    degree = column("polarization")
    total = p.sum()
    w, dw = p / total, p_se / total
    dx, dy = x - w @ x, y - w @ y
    moment = r**2 + dx**2 + dy**2
    square = float(w @ moment)
    radius = math.sqrt(square)
    density = total / (math.pi * square) if square > 0 else math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        # Errors of ln r by those of the rows; the common centroid is where r is smallest, so its own shift drops out
        shape = [w * r * column("rms_radius_se_mm"), w * dx * column("x_se_mm"), w * dy * column("y_se_mm")]
        by_shape = [term / square for term in shape]
        excess = moment / square - 1
        parts: dict[tuple[str, str], tuple[float, list[Numbers]]] = {
            ("power", "_W"): (total, [p_se]),
            ("incident", "_W"): (column("incident_W").sum(), [column("incident_se_W")]),
            ("percent", ""): (column("percent").sum(), [column("percent_se")]),
            ("x", "_mm"): (w @ x, [w * column("x_se_mm"), dx * dw]),
            ("y", "_mm"): (w @ y, [w * column("y_se_mm"), dy * dw]),
            ("rms_radius", "_mm"): (radius, [radius * term for term in (*by_shape, excess / 2 * dw)]),
            ("rms_irradiance", "_W_mm2"): (
                density,
                [density * term for term in (*(2 * term for term in by_shape), (1 - excess) * dw)],
            ),
            ("polarization", ""): (w @ degree, [w * column("polarization_se"), (degree - w @ degree) * dw]),
        }
        numbers: dict[str, Any] = {"rays": int(rows.rays.sum()), "wavelength_nm": float(w @ column("wavelength_nm"))}
        for (name, unit), (value, terms) in parts.items():
            numbers[f"{name}{unit}"] = float(value)
            numbers[f"{name}_se{unit}"] = _error(rows, *terms) if math.isfinite(value) else math.nan
    return numbers


def by_path(table: pd.DataFrame) -> pd.DataFrame:
    """
    A path table with one row for each event list of a source, all its wavelengths together, strongest first.

    Parameters
    ----------
    table : DataFrame
        ``Trace.paths.to_pandas()``.

    Returns
    -------
    DataFrame
        The same columns and ``path_ids``, the `path_id` of all members; ``path_id`` is that of the strongest. A path of
        one wavelength keeps its numbers.
    """
    result = table.assign(path_ids=[(int(path_id),) for path_id in table.path_id])
    keys = ["source", "events"]
    repeated = table.duplicated(keys, keep=False)
    if not repeated.any():
        return result
    rows = []
    for _, members in table[repeated].groupby(keys, sort=False):
        strongest = members.iloc[0].to_dict()  # the table is sorted
        path_ids = tuple(int(path_id) for path_id in members.path_id)
        rows.append(strongest | pooled(members) | {"path_ids": path_ids})
    result = pd.concat([result[~repeated], pd.DataFrame(rows)[result.columns].astype(result.dtypes)])
    return result.sort_values("power_W", ascending=False, kind="stable", ignore_index=True)


def _error(rows: pd.DataFrame, *terms: Numbers) -> float:
    """Standard error of a number from what each row adds to it: linear within a run, in quadrature over the runs."""
    each = np.sqrt(np.sum(np.square(terms), axis=0))
    each[np.isnan(each)] = np.inf  # 0 · ∞: one ray has a radius of 0 with an unknown error
    runs = pd.Series(each, index=rows.index).groupby([rows.source, rows.wavelength_nm], sort=False).sum()
    return float(np.linalg.norm(runs.to_numpy()))

"""Several rows of a path table as one: a path at all its wavelengths, or the paths of the direct image.

Rows of different sources or wavelengths come from independent runs: their errors add in quadrature. Rows of one run
share start rays, so that nothing smaller than the linear sum of their errors is safe; where the number wanted is a
power, `mistray.trace.PathTable.power` has a better error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analysis.estimate import Estimate

Numbers = npt.NDArray[np.float64]
Groups = npt.NDArray[np.int64]


def power(rows: pd.DataFrame) -> Estimate:
    """Power of some rows of a path table together, W."""
    if rows.empty:
        return Estimate(0.0, 0.0)
    error = _error(rows, np.zeros(len(rows), dtype=np.int64), rows.power_se_W.to_numpy(np.float64))
    return Estimate(float(rows.power_W.sum()), float(error[0]))


def pooled(rows: pd.DataFrame) -> dict[str, Any]:
    """
    Numbers of some rows of a path table together, as those of one path; see `pooled_groups`.

    Parameters
    ----------
    rows : DataFrame
        Rows of a path table, at least one.
    """
    return {name: values[0].item() for name, values in pooled_groups(rows, np.zeros(len(rows), dtype=np.int64)).items()}


def pooled_groups(rows: pd.DataFrame, group: Groups) -> dict[str, npt.NDArray[Any]]:
    """
    Numbers of groups of rows of a path table, each group as one path.

    Powers add; second moments about the common centroid add with the powers as weights. Errors are propagated with the
    power, centroid and radius of a row as independent of each other, which they are where all rays of a path carry the
    same flux; over a coated pupil that is so to first order.

    Parameters
    ----------
    rows : DataFrame
        Rows of ``Trace.paths.by_way()``.
    group : (n,) int
        Number of the group of each row; every group from 0 to the last has at least one.

    Returns
    -------
    dict
        Columns of ``Trace.paths`` and their values for each group, (g,). ``wavelength_nm`` and ``polarization`` are
        means with the powers as weights. An error is infinite where that of a row is, and NaN where the value is.
    """

    def column(name: str) -> Numbers:
        return rows[name].to_numpy(np.float64)

    def total(values: Numbers) -> Numbers:
        return np.asarray(np.bincount(group, values), dtype=np.float64)

    def error(*terms: Numbers) -> Numbers:
        return _error(rows, group, *terms)

    p, p_se = column("power_W"), column("power_se_W")
    x, y, r = column("x_mm"), column("y_mm"), column("rms_radius_mm")
    degree = column("polarization")
    light = total(p)
    w, dw = p / light[group], p_se / light[group]
    dx, dy = x - total(w * x)[group], y - total(w * y)[group]
    moment = r**2 + dx**2 + dy**2
    square = total(w * moment)
    radius = np.sqrt(square)
    with np.errstate(divide="ignore", invalid="ignore"):
        density = np.where(square > 0, light / (np.pi * square), np.nan)
        # Errors of ln r by those of the rows; the common centroid is where r is smallest, so its own shift drops out
        shape = [w * r * column("rms_radius_se_mm"), w * dx * column("x_se_mm"), w * dy * column("y_se_mm")]
        by_shape = [term / square[group] for term in shape]
        excess = moment / square[group] - 1
        mean_degree = total(w * degree)
        parts: dict[tuple[str, str], tuple[Numbers, Numbers]] = {
            ("power", "_W"): (light, error(p_se)),
            ("incident", "_W"): (total(column("incident_W")), error(column("incident_se_W"))),
            ("percent", ""): (total(column("percent")), error(column("percent_se"))),
            ("x", "_mm"): (total(w * x), error(w * column("x_se_mm"), dx * dw)),
            ("y", "_mm"): (total(w * y), error(w * column("y_se_mm"), dy * dw)),
            ("rms_radius", "_mm"): (radius, radius * error(*by_shape, excess / 2 * dw)),
            ("rms_irradiance", "_W_mm2"): (
                density,
                density * error(*(2 * term for term in by_shape), (1 - excess) * dw),
            ),
            ("polarization", ""): (
                mean_degree,
                error(w * column("polarization_se"), (degree - mean_degree[group]) * dw),
            ),
        }
        numbers: dict[str, npt.NDArray[Any]] = {
            "rays": total(column("rays")).round().astype(np.int64),
            "wavelength_nm": total(w * column("wavelength_nm")),
        }
    for (name, unit), (values, se) in parts.items():
        numbers[f"{name}{unit}"] = values
        numbers[f"{name}_se{unit}"] = np.where(np.isfinite(values), np.where(np.isnan(se), np.inf, se), np.nan)
    return numbers


def by_path(table: pd.DataFrame) -> pd.DataFrame:
    """
    A path table with one row for each event list of a source, all its wavelengths together, strongest first.

    Parameters
    ----------
    table : DataFrame
        ``Trace.paths.by_way()``.

    Returns
    -------
    DataFrame
        The same columns; ``path_ids`` are those of all members, ``path_id`` is that of the strongest. A path of one
        wavelength keeps its numbers.
    """
    repeated = table.duplicated(["source", "events"], keep=False)
    if not repeated.any():
        return table
    rows = table[repeated]
    group = rows.groupby(["source", "events"], sort=False).ngroup().to_numpy(np.int64)
    order = np.argsort(group, kind="stable")
    _, starts = np.unique(group[order], return_index=True)
    heads = rows.iloc[order[starts]].assign(**pooled_groups(rows, group))  # the table is sorted: the strongest
    ids = rows.path_ids.to_numpy()[order]
    ends = [*starts[1:], len(order)]
    heads["path_ids"] = [sum(ids[start:end], ()) for start, end in zip(starts, ends, strict=True)]
    result = pd.concat([table[~repeated], heads.astype(table.dtypes)])
    return result.sort_values("power_W", ascending=False, kind="stable", ignore_index=True)


def _error(rows: pd.DataFrame, group: Groups, *terms: Numbers) -> Numbers:
    """
    Standard error of a number of each group from what each row adds to it, (g,).

    Linear within a run, in quadrature over the runs.
    """
    each = np.sqrt(np.sum(np.square(terms), axis=0))
    each[np.isnan(each)] = np.inf  # 0 · ∞: one ray has a radius of 0 with an unknown error
    run = rows.groupby([group, "source", "wavelength_nm"], sort=False).ngroup().to_numpy()
    group_of_run = np.empty(run.max() + 1, dtype=np.int64)
    group_of_run[run] = group
    return np.sqrt(np.bincount(group_of_run, np.bincount(run, each) ** 2))

"""Causes of the stray light of a PST: paths by angle, shares by cause, and breaks of the curve."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mistray.analyses.pst.result import Pst
from mistray.estimate import Estimate
from mistray.known_arguments import known_arguments
from mistray.recorders.path_events import DIRECT

GHOSTS = "ghosts"
STRAIGHT_SHOTS = "straight shots"
REFLECTS = " (reflects)"  # suffix of the name of structure
CAUSES_NAMED = 2  # causes that a break names on either side
LEAST_CHANGE = 0.05  # decades per degree: a change of the slope below that is no break
SURE = 4.0  # standard errors that a change of the slope must have
LARGEST_ERROR = 0.25  # relative: points of the curve with larger errors are not used for slopes
MOST_BREAKS = 8
# Columns that add up where rows are merged; those of errors are squared for it
SUMS = {"pst", "pst_se", "rays", "paths", "percent_of_first_level", "percent_of_stray"}


@known_arguments
def stray_paths(pst: Pst, field_deg: float, n: int | None = None) -> pd.DataFrame:
    """
    Return a table of the stray paths at a field angle, degrees, averaged over azimuths; the strongest is first.

    At most `n` paths are returned, all by default.

    Returns
    -------
    DataFrame
        Columns of `Pst.paths`. The errors of several azimuths are added in quadrature, as if their rays were
        independent.

    Raises
    ------
    MistrayError
        If the PST was computed without paths, or no cell contains the field angle.
    """
    azimuths, field_deg = pst.grid.azimuths_deg, abs(field_deg)  # each azimuth is that of a cell
    parts = [pst.paths(field_deg, azimuth) for azimuth in azimuths]
    rows = parts[0]
    if len(azimuths) > 1:
        i, _ = pst.grid.nearest(field_deg, azimuths[0])
        rows = _summed(pd.concat(parts, ignore_index=True), "events", rows.columns)
        rows["pst"] /= len(azimuths)
        rows["pst_se"] /= len(azimuths)
        rows["percent_of_stray"] = np.where(rows.kind != DIRECT, 100 * rows.pst / pst.stray[i], np.nan)
        rows["percent_of_all"] = 100 * rows.pst / pst.value[i]
    rows = rows[rows.percent_of_stray.notna()].reset_index(drop=True)
    return rows if n is None else rows.head(n)


def _summed(rows: pd.DataFrame, by: str, columns: Iterable[str] = ("pst", "pst_se")) -> pd.DataFrame:
    """Return path rows merged by column `by`, strongest first; columns in `SUMS` add up, others come from the first."""
    how = {name: "sum" if name in SUMS else "first" for name in columns}
    rows = rows.assign(pst_se=rows.pst_se**2).groupby(by, sort=False, as_index=False).agg(how)
    rows["pst_se"] = np.sqrt(rows.pst_se)
    return rows.sort_values("pst", ascending=False, kind="stable", ignore_index=True)


def _total(rows: pd.DataFrame) -> Estimate:
    """Return the PST that path rows add up to, with its standard error as if their rays were independent."""
    return Estimate(float(rows.pst.sum()), math.sqrt((rows.pst_se**2).sum()))


def with_cause(rows: pd.DataFrame) -> pd.DataFrame:
    """
    Return rows of `stray_paths` with the column ``cause``, the name of the cause of each path's stray light.

    The cause of scattered light is the surface that scatters it first. That of light which is only reflected is
    "ghosts" or, where structure alone reflects it, the name of the first surface that does so, with `REFLECTS`. Light
    that is neither scattered nor reflected has the cause "straight shots".
    """
    by_structure = (rows.structure_bounces > 0) & (rows.order == 0)
    reflected = np.where(by_structure, rows.ghost_1 + REFLECTS, GHOSTS)
    reflected = np.where(rows.order + rows.structure_bounces > 0, reflected, STRAIGHT_SHOTS)
    return rows.assign(cause=np.where(rows.scatters > 0, rows.scatter_1, reflected).astype(object))


def cause_frame(pst: Pst) -> pd.DataFrame:
    """
    Return the percentage of the stray light that is due to each cause at each field angle.

    Rows are field angles, degrees (index). Columns are causes, the one with the largest percentage at any angle first.
    There are no columns without a table of paths or without stray paths. Paths that the table lacks count nowhere, so
    that a row may add up to less than 100 %.
    """
    listed = pst.path_rows
    if listed is None or (listed.kind == DIRECT).all():
        return pd.DataFrame(index=pst.field_deg)
    rows = with_cause(listed[listed.kind != DIRECT])
    # Shares of the mean over the azimuths, which are the same in any convention
    stray = pst.to("normal").stray[rows.cell] * pst.grid.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = (100 * rows.pst_normal / stray).groupby([rows.cell, rows.cause]).sum()
    table = shares.unstack().reindex(range(len(pst.field_deg))).fillna(0.0).set_axis(pst.field_deg)
    return table[table.max().sort_values(ascending=False, kind="stable").index]


def first_level_scatter(pst: Pst) -> pd.DataFrame:
    """
    Return the PST of paths with one scatter event and no ghost or structure reflection, by field angle and surface.

    Columns are angle_deg, surface, paths, rays, pst, pst_se, percent_of_first_level and percent_of_stray. At each angle
    the surface that scatters most comes first. Errors of the paths of a surface are added in quadrature.
    """
    columns = ["angle_deg", "surface", "paths", "rays", "pst", "pst_se", "percent_of_first_level", "percent_of_stray"]
    parts = []
    for angle in pst.field_deg:
        rows = stray_paths(pst, angle)
        rows = rows[(rows.scatters == 1) & (rows.order == 0) & (rows.structure_bounces == 0)]
        rows = rows.assign(surface=rows.scatter_1, paths=1, percent_of_first_level=100 * rows.pst / rows.pst.sum())
        parts.append(_summed(rows, "surface", columns[2:]).assign(angle_deg=angle))
    filled = [part for part in parts if len(part)]
    return pd.concat(filled, ignore_index=True)[columns] if filled else pd.DataFrame(columns=columns)


@dataclass(frozen=True)
class Break:
    """
    Abrupt change of the slope of log10 PST over the field angle.

    Attributes
    ----------
    field_deg : float
        Field angle of the break, degrees.
    slope_before, slope_after : float
        Slopes between this angle and its neighbours, decades per degree.
    change_se : float
        Standard error of their difference, decades per degree.
    before, after : tuple of (str, float)
        Strongest causes at the neighbouring angles and their shares of the stray light there, %.
    """

    field_deg: float
    slope_before: float
    slope_after: float
    change_se: float
    before: tuple[tuple[str, float], ...]
    after: tuple[tuple[str, float], ...]

    @property
    def change(self) -> float:
        """Change of the slope at the break, after minus before, decades per degree."""
        return self.slope_after - self.slope_before


def breaks(pst: Pst, most: int = MOST_BREAKS, light: str = "stray") -> list[Break]:
    """
    Return the breaks of a PST, field angles at which the slope of log10 PST changes abruptly, in ascending order.

    A break is an angle at which the slope changes by at least `LEAST_CHANGE` and `SURE` standard errors, and by no less
    than at the angles next to it. Points with errors above `LARGEST_ERROR` are left out. The error of a change comes
    from the batches of start rays; where each cell has rays of its own, those of the three points are independent.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    most : int
        Largest number of breaks; those with the largest change of slope are kept.
    light : str
        "stray", or another group of `Pst.curve`.
    """
    angle = pst.field_deg
    value, se = pst.curve(light)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(se < LARGEST_ERROR * value, np.log10(value), np.nan)
    # Second differences, and their errors
    slope = np.diff(level) / np.diff(angle)
    change = np.concatenate([[np.nan], np.diff(slope), [np.nan]])
    change_se = _change_errors(pst, value, light)
    size = np.nan_to_num(np.abs(change))
    next_to = np.maximum(np.append(0.0, size[:-1]), np.append(size[1:], 0.0))
    with np.errstate(invalid="ignore"):
        sure = (size >= LEAST_CHANGE) & (size >= SURE * change_se) & (size >= next_to)
    # The largest of them, by angle
    found = np.flatnonzero(sure)
    found = np.sort(found[np.argsort(-size[found])][:most])
    return [
        Break(
            float(angle[i]),
            float(slope[i - 1]),
            float(slope[i]),
            float(change_se[i]),
            strongest(pst, float(angle[i - 1])),
            strongest(pst, float(angle[i + 1])),
        )
        for i in found
    ]


def _change_errors(pst: Pst, value: np.ndarray, light: str) -> np.ndarray:
    """Return standard errors of the slope change of log10 PST at each angle, decades/degree, (n,); NaN at both ends."""
    step = np.diff(pst.field_deg)
    # Coefficients of three neighbouring points: slope after less slope before
    factors = np.zeros((len(value), 3))
    factors[1:-1] = np.stack([1 / step[:-1], -1 / step[:-1] - 1 / step[1:], 1 / step[1:]], axis=1)
    samples, weight = pst.samples(light), pst.weight
    with np.errstate(divide="ignore", invalid="ignore"):
        if weight.ndim == 1:  # the angles share their start rays: the combination is formed batch by batch
            off = (samples.mean(axis=1) - value[:, None]) / (value[:, None] * math.log(10))
            off = np.pad(off, ((1, 1), (0, 0)))
            together = np.sum([factors[:, k, None] * off[k : k + len(value)] for k in range(3)], axis=0)
            errors = pst.estimate(together, weight)[1]
        else:
            single = np.pad(pst.curve(light)[1] / value / math.log(10), 1)
            errors = np.sqrt(sum((factors[:, k] * single[k : k + len(value)]) ** 2 for k in range(3)))
    errors[[0, -1]] = np.nan
    return np.asarray(errors)


@known_arguments
def strongest(pst: Pst, field_deg: float, n: int = CAUSES_NAMED) -> tuple[tuple[str, float], ...]:
    """
    Return the strongest causes of the stray light at a field angle, degrees, each with its percentage of that light.

    The result is empty without a table of paths. Ghosts are named by their strongest path, "ghosts such as detector →
    filter_rear".
    """
    if pst.path_rows is None:
        return ()
    rows = with_cause(stray_paths(pst, field_deg))
    shares = rows.percent_of_stray.groupby(rows.cause).sum().sort_values(ascending=False, kind="stable").head(n)
    names = {name: name for name in shares.index}
    if GHOSTS in names:
        names[GHOSTS] = f"{GHOSTS} such as {rows.label[rows.cause == GHOSTS].iloc[0]}"
    return tuple((names[name], float(share)) for name, share in shares.items() if share > 0)


@dataclass(frozen=True)
class MainCause:
    """
    Strongest cause of the stray light on the detector under a uniform sky, over the field angles of a PST.

    All numbers are those of the paths in the table of the PST.

    Attributes
    ----------
    cause : str
        Surface that scatters the light first, or another cause of `with_cause`.
    percent : Estimate
        Percentage of that stray light that it causes. The errors of its paths are added in quadrature, as if their
        rays were independent.
    field_deg : float
        Field angle from which this cause contributes most light under this sky, degrees.
    stray, left : Estimate
        PST, in its convention, of the stray paths at this angle, and of those with another cause.
    """

    cause: str
    percent: Estimate
    field_deg: float
    stray: Estimate
    left: Estimate


def main_cause(pst: Pst) -> MainCause | None:
    """Return the main cause of stray light under a uniform sky; None without stray light or paths."""
    if pst.path_rows is None:
        return None
    parts, normal = [], pst.to("normal")
    # Light of each cause from each angle: PST_normal times the solid angle of the ring of the sky
    for cell in np.unique(pst.path_rows.cell):
        angle, (first, last) = float(pst.field_deg[cell]), np.radians(pst.grid.edges_deg[cell])
        part = _summed(with_cause(stray_paths(normal, angle)), "cause")
        parts.append(part.assign(angle=angle, sky=2 * np.pi * (np.cos(first) - np.cos(last))))
    if not parts:
        return None
    every = pd.concat(parts, ignore_index=True)
    light = every.assign(pst=every.pst * every.sky, pst_se=every.pst_se * every.sky)
    causes = _summed(light, "cause")
    if causes.empty or not causes.pst[0] > 0:
        return None
    # Strongest cause, and the error of its share own/(own + rest)
    is_it = light.cause == causes.cause[0]
    own, rest = _total(light[is_it]), _total(light[~is_it])
    total = own.value + rest.value
    # Angle at which it is strongest
    at = float(light.angle[light.pst[is_it].idxmax()])
    here = with_cause(stray_paths(pst, at))
    return MainCause(
        cause=str(causes.cause[0]),
        percent=Estimate(
            100 * own.value / total, 100 * math.hypot(rest.value * own.se, own.value * rest.se) / total**2
        ),
        field_deg=at,
        stray=_total(here),
        left=_total(here[here.cause != causes.cause[0]]),
    )


def reigns(causes: pd.DataFrame) -> list[tuple[float, float, str, float, float]]:
    """
    Return the ranges of field angle over which one cause contributes more stray light than any other.

    Parameters
    ----------
    causes : DataFrame
        Result of `cause_frame`.

    Returns
    -------
    list of tuple
        First and last angle (degrees), cause, smallest and largest share of the stray light there (%).
    """
    found: list[tuple[float, float, str, float, float]] = []
    for angle, row in causes.iterrows():
        if row.empty or not row.max() > 0:
            continue
        name, share = str(row.idxmax()), float(row.max())
        if found and found[-1][2] == name and causes.index.get_loc(angle) == causes.index.get_loc(found[-1][1]) + 1:
            first, _, _, low, high = found[-1]
            found[-1] = (first, float(angle), name, min(low, share), max(high, share))
        else:
            found.append((float(angle), float(angle), name, share, share))
    return found


def field_edge(pst: Pst) -> float | None:
    """
    Return the field angle, degrees, at which the PST of direct light falls to half of that at the smallest angle.

    It is None if there is no direct light at the smallest angle, if that was not traced at all azimuths, or if the
    light never falls to half.
    """
    direct, angles = pst.curve("direct")[0], pst.field_deg
    if not direct[0] > 0:
        return None
    traced = np.isfinite(direct)
    direct, angles = direct[traced], angles[traced]
    below = np.flatnonzero(direct < direct[0] / 2)
    if not below.size:
        return None
    k = int(below[0])
    return float(np.interp(direct[0] / 2, direct[[k, k - 1]], angles[[k, k - 1]]))

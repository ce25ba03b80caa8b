"""Summary of one field angle of a ghost analysis: power, W, of direct and stray light, and the worst path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd

from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.ghost_ranking import DirectImage, direct_image, stray_to_direct
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.irradiance import MapStatistics, mirror_asymmetry, statistics
from mistray.toolkit.tables.frames import estimate_of
from mistray.trace import Trace


@dataclass(frozen=True, kw_only=True)
class FieldSummary:
    """
    Row of a ghost report's main table: one field angle, for all light or for one wavelength.

    Attributes
    ----------
    field_deg : float
        Field angle, degrees.
    wavelength_nm : float or None
        Wavelength, nm; None: all light.
    rays : int
        Start rays of the field.
    paths : int
        Paths that reach the detector, the direct ones included.
    paths_of_kind : dict of str to int
        Number of paths by kind.
    direct : DirectImage
        Direct image at this field.
    stray_W : Estimate
        Power that the detector absorbs of all light except the direct image, W.
    direct_incident_W, stray_incident_W : Estimate
        Power of the direct image and of all other light incident on the detector, W.
    stray_of_kind_W : dict of str to Estimate
        Power as in `stray_W`, W, by kind of path.
    ghost_to_signal : Estimate
        ``stray_W`` over the direct power at this field, dimensionless; NaN out of field.
    stray_to_nominal : Estimate
        ``stray_W`` over the direct power on axis, dimensionless.
    brightest : int or None
        ``path_id`` of the stray path that is ranked first by RMS irradiance; None without stray paths.
    brightest_normalised : Estimate
        RMS irradiance of that path over that of the direct image on axis, dimensionless; NaN without one.
    map : MapStatistics
        Statistics block of the whole irradiance map, W/mm² and W.
    asymmetry, asymmetry_expected : float
        See `mistray.toolkit.irradiance.mirror_asymmetry`; dimensionless.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> found = report.summary(10)
    >>> found.paths_of_kind["ghost"]
    15
    >>> mistray.report.with_error(found.ghost_to_signal)
    '0.017586 ± 0.000035'
    """

    field_deg: float
    wavelength_nm: float | None
    rays: int
    paths: int
    paths_of_kind: dict[str, int]
    direct: DirectImage
    stray_W: Estimate
    direct_incident_W: Estimate
    stray_incident_W: Estimate
    stray_of_kind_W: dict[str, Estimate]
    ghost_to_signal: Estimate
    stray_to_nominal: Estimate
    brightest: int | None
    brightest_normalised: Estimate
    map: MapStatistics
    asymmetry: float
    asymmetry_expected: float


def field_summary(
    t: Trace,
    rows: pd.DataFrame,
    table: pd.DataFrame,
    field_deg: float,
    wavelength_nm: float | None,
    nominal: DirectImage,
) -> FieldSummary:
    """
    Return the summary of one field of a ghost analysis.

    Parameters
    ----------
    t : Trace
        Finished trace.
    rows : DataFrame
        Paths of the trace, ``t.paths.by_way()``.
    table : DataFrame
        Ranked paths of the trace, see `mistray.analyses.ghosts.result.GhostReport.table`.
    field_deg : float
        Field angle, degrees.
    wavelength_nm : float or None
        Wavelength to which the summary is restricted, nm; None: all light.
    nominal : DirectImage
        Direct image on axis, at the same wavelengths.
    """
    irradiance = t.irradiance, t.irradiance_se
    if wavelength_nm is not None:
        irradiance = t.irradiance_at(wavelength_nm)
        rows, table = (part[part.wavelength_nm == wavelength_nm] for part in (rows, table))
    direct = direct_image(t.paths, wavelength_nm)
    worst = table[table.kind != DIRECT].sort_values("rank_rms_irradiance").head(1)
    asymmetry, expected = mirror_asymmetry(*irradiance)
    return FieldSummary(
        field_deg=field_deg,
        wavelength_nm=wavelength_nm,
        rays=int(t.settings["rays"]),
        paths=len(table),
        paths_of_kind={kind: int((table.kind == kind).sum()) for kind in (DIRECT, *STRAY_KINDS)},
        direct=direct,
        stray_W=power_of(t, rows.path_ids[rows.kind != DIRECT]),
        direct_incident_W=_incident(t, rows, rows.kind == DIRECT),
        stray_incident_W=_incident(t, rows, rows.kind != DIRECT),
        stray_of_kind_W={kind: power_of(t, rows.path_ids[rows.kind == kind]) for kind in STRAY_KINDS},
        ghost_to_signal=stray_to_direct(t.paths, direct, wavelength_nm),
        stray_to_nominal=stray_to_direct(t.paths, nominal, wavelength_nm),
        brightest=int(worst.path_id.iloc[0]) if len(worst) else None,
        brightest_normalised=estimate_of(worst.iloc[0], "normalised_rms_irradiance") if len(worst) else UNKNOWN,
        map=statistics(*irradiance, t.extent, int(table.rays.sum())),
        asymmetry=asymmetry,
        asymmetry_expected=expected,
    )


def power_of(t: Trace, path_ids: Iterable[Iterable[int]]) -> Estimate:
    """Return the total power of rows of a path table, W, given the path ids of each row."""
    return Estimate(*t.paths.power([i for members in path_ids for i in members]))


def _incident(t: Trace, rows: pd.DataFrame, chosen: pd.Series) -> Estimate:
    """Return the incident power of selected path rows, W, with the relative error of their absorbed power."""
    power, se = power_of(t, rows.path_ids[chosen])
    incident = float(rows.incident_W[chosen].sum())
    return Estimate(incident, se * incident / power if power > 0 else 0.0)

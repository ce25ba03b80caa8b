"""The key numbers of one field of a ghost analysis."""

from __future__ import annotations

from dataclasses import dataclass

from mistray.analysis.estimate import Estimate
from mistray.analysis.irradiance import MapStatistics
from mistray.analysis.ranking import DirectImage


@dataclass(frozen=True, kw_only=True)
class FieldSummary:
    """
    One row of the main table, of all light or of one wavelength.

    Attributes
    ----------
    field_deg : float
        Field angle, degrees.
    wavelength_nm : float or None
        None: all light.
    rays : int
        Start rays of the field.
    paths : int
        Paths that reach the detector, the direct ones included.
    paths_of_kind : dict
        Number of paths by kind.
    direct : DirectImage
        Direct image at this field.
    stray_W : Estimate
        Power of everything that is not the direct image, as the detector absorbs it.
    direct_incident_W, stray_incident_W : Estimate
        Power of the direct image and of all other light before the detector reflects its share.
    stray_of_kind_W : dict
        As `stray_W`, by kind.
    ghost_to_signal : Estimate
        ``stray_W`` over the direct power at this field; NaN out of field.
    stray_to_nominal : Estimate
        ``stray_W`` over the direct power on axis.
    brightest : int or None
        ``path_id`` of the stray path of the highest RMS irradiance.
    brightest_normalised : Estimate
        Its normalised RMS irradiance.
    map : MapStatistics
        Statistics block of the whole irradiance map.
    asymmetry, asymmetry_expected : float
        See `mistray.analysis.irradiance.mirror_asymmetry`.
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

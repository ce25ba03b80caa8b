"""Metrics of a point source transmittance, to be minimised: at one angle, in a band, over a mask, veiling glare."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.metrics.pst_observation import CONVENTION, QUANTITY, Light, PstObservation, named_classes
from mistray.analyses.pst.metrics.pst_view import PstView
from mistray.analyses.pst.run import pst
from mistray.errors import MistrayError
from mistray.metrics.metric import Metric, require_known
from mistray.metrics.observation import NORM, smooth_maximum
from mistray.metrics.views import TraceView
from mistray.ranges import POLAR_DEG, POSITIVE, PST_FIELD_DEG
from mistray.recorders.directions import CELL_DEG
from mistray.surfaces.upload import upload
from mistray.trace import Settings

LARGEST_DEG = 90.0
PST_FIELD = "pst_field_deg"  # field angles of the PST; `field_deg` is that of the metric
NO_SETTINGS = ("scene", "settings", "progress", "convention")  # of mistray.pst


@dataclass(frozen=True)
class PstMetric(Metric):
    """
    Metric computed from one point source transmittance (PST).

    Attributes
    ----------
    function : callable
        Takes a list of one `PstObservation` and returns a Dr.Jit scalar.
    settings : dict
        Arguments of `mistray.pst`: field_deg, rays, max_scatters, seed, …. `field_deg`, `wavelength_nm` and `weights`
        of `Metric` are not used.
    plans : dict
        Plans of pilots by their arguments, see `PstView`.
    """

    plans: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    def with_rays_times(self, times: float) -> PstMetric:
        """Return a copy of the metric that is computed with `times` the rays of its settings."""
        return replace(self, times=times, plans={})

    @property
    def views(self) -> list[TraceView]:
        """Computations that the metric needs: a list with one PST."""
        return [PstView(self.settings or {}, self.plans)]


def pst_bin(
    scene: Any,
    field_deg: float,
    light: Light = "stray",
    *,
    azimuth_deg: float | None = None,
    convention: str = "normal",
    **traced: Any,
) -> PstMetric:
    """
    Return the metric "PST of the cell that contains a field angle", dimensionless.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg : float
        Field angle, -90 … 90 degrees; a negative one is at the opposite azimuth.
    light : str or sequence of str
        Classes of light, see `PstObservation`.
    azimuth_deg : float, optional
        Azimuth, degrees; by default the mean over the azimuths.
    convention : {"normal", "projected"}
        E_det / E_⊥, or E_det / (E_⊥ cos θ).
    **traced
        Arguments of `mistray.pst`, with `pst_field_deg` for its field angles: by default `field_deg` alone, a cell 2°
        wide. Metrics with the same settings share one trace in `combine`.

    Examples
    --------
    >>> metric = mistray.optimize.pst_bin(mistray.load("lens_and_window"), 30, rays=20_000)
    >>> print(f"{metric.value():.1e}")
    3.9e-05
    """
    CONVENTION.check("convention", convention)
    settings = {PST_FIELD: (float(PST_FIELD_DEG.check("field_deg", field_deg)),), **traced}
    if azimuth_deg is not None:
        settings = {"azimuths_deg": (float(azimuth_deg),), **settings}
    return _metric(
        scene,
        lambda o: o.value_at(field_deg, light, azimuth_deg, convention),
        light,
        settings,
        "1",
        f"PST at {field_deg:g}°",
    )


def pst_band(
    scene: Any,
    low_deg: float,
    high_deg: float,
    light: Light = "stray",
    *,
    quantity: str = "mean",
    convention: str = "normal",
    interpolation: str = "cells",
    **traced: Any,
) -> PstMetric:
    """
    Return the metric "PST over a band of field angles": ∫ PST_normal dΩ / ∫ dΩ, or the integral alone, sr.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    low_deg, high_deg : float
        Ends of the band, 0 … 90 degrees.
    light : str or sequence of str
        Classes of light, see `PstObservation`.
    quantity : {"mean", "integral"}
        Mean over the solid angle (unit 1), or the irradiance on the detector from a sky of 1 W/(mm² sr) that fills the
        band, ∫ PST_normal dΩ = ∫ PST_projected cos θ dΩ (unit sr).
    convention : {"normal", "projected"}
        Convention of the mean; the mean of PST_projected has the weight cos θ dΩ.
    interpolation : {"cells", "linear", "log"}
        See `PstObservation.band`.
    **traced
        Keywords of `pst_bin`; without `pst_field_deg` cells of at most 2° fill the band.

    Raises
    ------
    MistrayError
        If the band is empty or not within 0 … 90 degrees, or a word is unknown.

    Examples
    --------
    >>> angles = [10, 20, 30, 40]
    >>> metric = mistray.optimize.pst_band(mistray.load("lens_and_window"), 10, 40, pst_field_deg=angles, rays=20_000)
    >>> print(f"{metric.value():.1e}")
    3.9e-05
    """
    QUANTITY.check("quantity", quantity)
    CONVENTION.check("convention", convention)
    return _metric(
        scene,
        lambda o: o.band(low_deg, high_deg, light, quantity, convention, interpolation),
        light,
        _filled(low_deg, high_deg, traced),
        "1" if quantity == "mean" else "sr",
        f"PST from {low_deg:g} to {high_deg:g}°",
    )


def pst_mask(
    scene: Any,
    field_deg: float | Sequence[float],
    limits: float | Sequence[float],
    light: Light = "stray",
    *,
    convention: str = "normal",
    norm: float = NORM,
    **traced: Any,
) -> PstMetric:
    """
    Return the metric "smooth maximum of PST / limit over field angles", dimensionless; with at most 1 the mask is met.

    The smooth maximum is at least the maximum, so that a mask that is just met may give more than 1.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg : float or sequence of float
        Field angles, degrees, ascending; the mean over the azimuths counts.
    limits : float or sequence of float
        Largest PST at each of these angles, greater than 0.
    light : str or sequence of str
        Classes of light, see `PstObservation`.
    convention : {"normal", "projected"}
        Convention of the limits.
    norm : float
        Exponent p ≥ 1 of the smooth maximum, see `smooth_maximum`.
    **traced
        Keywords of `pst_bin`.

    Raises
    ------
    MistrayError
        If angles and limits do not agree in number, or `pst_field_deg` is given.

    Examples
    --------
    >>> metric = mistray.optimize.pst_mask(mistray.load("lens_and_window"), [10, 30], [1e-4, 5e-5], rays=20_000)
    >>> print(f"{metric.value():.2f}: below 1, the mask is met")
    0.77: below 1, the mask is met
    """
    CONVENTION.check("convention", convention)
    if PST_FIELD in traced:
        raise MistrayError(f"a mask has a PST at its own field angles; leave out {PST_FIELD}")
    angles = tuple(POLAR_DEG.check_each("field_deg", field_deg))
    highest = np.array(POSITIVE.check_each("limits", limits))
    if len(highest) != len(angles):
        raise MistrayError(f"mask of {len(angles)} angles and {len(highest)} limits; give one limit for each angle")

    def number(o: PstObservation) -> Any:
        return smooth_maximum(o.curve(light, convention) / upload(mi.Float64, highest), norm)

    settings = {**traced, PST_FIELD: angles}
    return _metric(scene, number, light, settings, "1", "PST over its mask")


def veiling_glare(
    scene: Any,
    patch_deg: float,
    field_deg: float = 0.0,
    azimuth_deg: float = 0.0,
    *,
    source_deg: float = LARGEST_DEG,
    place: str = "mean",
    interpolation: str = "cells",
    **traced: Any,
) -> PstMetric:
    """
    Return the metric "veiling glare index" of a white source with a black patch, percent.

    It is 100 E_black / E_white (ISO 9358).

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    patch_deg, field_deg, azimuth_deg, source_deg, interpolation
        Arguments of `mistray.analyses.pst.glare.glare.veiling_glare_index`.
    place : {"mean", "point"}
        "mean": E_black is the mean of the stray light over the detector. "point": the detector lies within the image.
    **traced
        Keywords of `pst_bin`; without `pst_field_deg` cells of 2° fill the source.

    Examples
    --------
    >>> metric = mistray.optimize.veiling_glare(mistray.load("lens_and_window"), 2, source_deg=40, rays=20_000)
    >>> print(f"{metric.value():.2f} %")
    0.49 %
    """
    return _metric(
        scene,
        lambda o: o.veiling_glare_index(
            patch_deg, field_deg, azimuth_deg, source_deg=source_deg, place=place, interpolation=interpolation
        ),
        "total",
        _filled(0.0, source_deg, traced),
        "%",
        "veiling glare index",
    )


def _filled(low_deg: float, high_deg: float, traced: dict[str, Any]) -> dict[str, Any]:
    """
    Return PST settings whose cells, at most 2° wide, fill a band of field angles, unless angles are given.

    Raises
    ------
    MistrayError
        If the band is empty or not within 0 … 90 degrees, or a width of cells is given without angles.
    """
    if not 0 <= low_deg < high_deg <= LARGEST_DEG:
        raise MistrayError(f"band from {low_deg:g} to {high_deg:g}°; field angles must ascend within 0 … 90 degrees")
    if PST_FIELD in traced:
        return traced
    if "cell_deg" in traced:
        raise MistrayError("cell_deg is given without pst_field_deg; give the angles too")
    count = int(np.ceil((high_deg - low_deg) / CELL_DEG))
    width = (high_deg - low_deg) / count
    return {**traced, PST_FIELD: tuple((low_deg + width * (np.arange(count) + 0.5)).tolist()), "cell_deg": width}


def _metric(
    scene: Any,
    number: Callable[[PstObservation], Any],
    light: Light,
    settings: dict[str, Any],
    unit: str,
    name: str,
) -> PstMetric:
    named_classes(light)
    known = [
        PST_FIELD if key == "field_deg" else key for key in inspect.signature(pst).parameters if key not in NO_SETTINGS
    ]
    require_known(settings, [*known, *(f.name for f in fields(Settings) if f.name not in known)])
    settings = {"field_deg" if key == PST_FIELD else key: value for key, value in settings.items()}
    PstView(settings)  # what no such metric can have
    return PstMetric(scene, lambda observations: number(observations[0]), settings=settings, unit=unit, name=name)

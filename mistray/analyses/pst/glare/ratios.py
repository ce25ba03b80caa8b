"""Stray-light ratios from a point source transmittance (PST): rejection, stray over direct light, equivalent radiance.

`mistray.metrics.stray_metric.DEFINITIONS` defines each quantity in words, and every result carries its definition.
Extended sources and veiling glare have their own modules beside this one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mistray.analyses.pst.glare.extended_source import ExtendedSource, cover
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.sums import Light, quotient, require_traced, weighted_sum
from mistray.errors import MistrayError
from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.stray_metric import DEFINITIONS, MetricCurve, StrayMetric
from mistray.ranges import several

PLANES = {"normal": "on a plane normal to the light", "projected": "on the plane of the aperture, E_⊥ cos θ"}
ARCSEC2_SR = float(np.radians(1 / 3600) ** 2)
AB_W_M2_HZ = 3.631e-23
"""Spectral irradiance of a source of AB magnitude 0 (J. Oke and J. Gunn, Astrophys. J. 266, 713, 1983): 3631 Jy."""
LIGHT_M_S = 299_792_458.0


def rejection_ratio(
    pst: Pst, classes: Light = "total", reference_deg: float = 0.0, reference: Estimate | None = None
) -> MetricCurve:
    """
    Return the point source rejection ratio (PSRR): PST(θ) / PST(reference angle), both averaged over the azimuths.

    Parameters
    ----------
    pst : Pst
        The ratio is in the convention of this PST.
    classes : str or sequence of str
        Classes of light in numerator and denominator, see `Pst.samples`. With `reference` in the numerator only.
    reference_deg : float
        Field angle of the denominator, degrees.
    reference : Estimate, optional
        Denominator instead, such as the PST of another run.

    Raises
    ------
    MistrayError
        If no cell contains the reference angle, it was not traced, no light comes from there, or `reference` is 0.
    """
    if reference is None:
        row, _ = pst.grid.nearest(reference_deg, float(pst.grid.azimuths_deg[0]))
        below = _row(pst, row)
        ratios = [quotient(pst, (_row(pst, i), classes), (below, classes)) for i in range(pst.grid.shape[0])]
    else:
        ratios = [value.over(reference) for value in pst.estimates(classes)]
    if ratios[0] is UNKNOWN:
        raise MistrayError(
            f"no light of the classes {_named(classes)} comes from the reference angle {reference_deg:g}°; give "
            "another reference_deg, or reference"
        )
    at = reference_deg if reference is None else None
    facts = {"light": _named(classes), "reference_deg": at, "convention": pst.convention}
    return _curve(pst, "psrr", ratios, facts=facts)


def normalised_irradiance(pst: Pst, name: str = "ndi", plane: str = "normal", classes: Light = "total") -> MetricCurve:
    """
    Return irradiance on the detector over that at the entrance, dimensionless, by field angle.

    It is called NDI (as for Euclid) or PSNIT (NASA).

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    name : {"ndi", "psnit"}
        Ratio to compute.
    plane : {"normal", "projected"}
        Plane of the irradiance at the entrance; both are in use, and the definition in the result names it.
    classes : str or sequence of str
        Light that counts, see `Pst.samples`.

    Raises
    ------
    MistrayError
        If the name or the plane is another one.
    """
    if name not in ("ndi", "psnit"):
        raise MistrayError(f"name is '{name}'; use 'ndi' or 'psnit'")
    facts = {"light": _named(classes), "convention": plane}
    return _curve(pst, name, pst.to(plane).estimates(classes), {"plane": PLANES[plane]}, facts)


def image_throughput(pst: Pst) -> StrayMetric:
    """
    Return the irradiance of the direct image per radiance of a uniform scene, sr: ∫ PST_n dΩ of direct light.

    For an ideal system of transmittance T it is T π sin² u, with the half angle u of the cone of light on the detector.
    It is the mean over the detector, so that it includes vignetting.

    Raises
    ------
    MistrayError
        If a cell was not traced.
    """
    return StrayMetric.of("throughput", weighted_sum(pst.to("normal"), _solid_angles(pst), "direct"), "sr")


def ideal_throughput(f_number: float, transmittance: float = 1.0) -> float:
    """
    Return T π / (4 F² + 1), sr: on-axis irradiance per scene radiance of an ideal lens in air.

    T is the transmittance, 0 … 1. F is the F-number 1/(2 tan u), u being the half angle of the cone of light on the
    detector. Of a lens with the working F-number N = 1/(2 sin u), such as `FirstOrder.f_number` of a study, it is
    √(N² - 1/4); the result is then T π / (4 N²).

    Raises
    ------
    MistrayError
        If the F-number is not above 0, or the transmittance not in its range.
    """
    if not f_number > 0 or not 0 < transmittance <= 1:
        raise MistrayError(
            f"f_number is {f_number:g} and transmittance {transmittance:g}; the first must be positive and the second "
            "lie between 0 and 1"
        )
    return float(transmittance * np.pi / (4 * f_number**2 + 1))


def equivalent_stray_radiance(
    pst: Pst,
    source: ExtendedSource,
    *,
    f_number: float | None = None,
    transmittance: float = 1.0,
    interpolation: str = "cells",
) -> StrayMetric:
    """
    Return the equivalent stray radiance (ESR): radiance of a uniform scene whose direct image equals the stray light.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    source : ExtendedSource
        Source of the stray light, see `mistray.analyses.pst.glare.extended_source`.
    f_number, transmittance : float, optional
        With an F-number 1/(2 tan u), E_stray is divided by T π / (4 F² + 1), see `ideal_throughput`. Without one, it is
        divided by the integral of the direct PST_n over the cells (`image_throughput`), which must cover the field of
        view.
    interpolation : {"cells", "linear", "log"}
        Interpolation of the stray PST, see `mistray.analyses.pst.glare.extended_source.cover`.

    Returns
    -------
    StrayMetric
        Radiance, W/(mm² sr).

    Raises
    ------
    MistrayError
        If no direct light is in the cells and no F-number is given, no cell contains the source, or a cell that counts
        was not traced.
    """
    if f_number is None:
        words, facts = "the integral of the direct PST_n over solid angle", {}
    else:
        ideal = ideal_throughput(f_number, transmittance)
        words = f"T pi / (4 F^2 + 1) = {ideal:.6g} sr"
        facts = {"f_number": f_number, "transmittance": transmittance}

    def over(normal: Pst, stray: np.ndarray) -> Estimate:
        if f_number is None:
            return quotient(normal, (stray, "stray"), (_solid_angles(pst), "direct"))
        e = weighted_sum(normal, stray, "stray")
        return Estimate(e.value / ideal, e.se / ideal)

    return _of_source(pst, "stray_radiance", source, interpolation, over, "W/(mm2 sr)", {"throughput": words}, facts)


def stray_to_signal(
    pst: Pst, source: ExtendedSource, scene_radiance: float, *, interpolation: str = "cells"
) -> StrayMetric:
    """
    Return stray light over signal, dimensionless: irradiance from a stray source over that of the scene's image.

    The scene is uniform, with the radiance `scene_radiance`.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    source : ExtendedSource
        Source of the stray light.
    scene_radiance : float
        Radiance of the scene in the field of view, W/(mm² sr).
    interpolation : {"cells", "linear", "log"}
        Interpolation of the stray PST, see `mistray.analyses.pst.glare.extended_source.cover`.

    Raises
    ------
    MistrayError
        If the radiance is not above 0, no direct light is in the cells, no cell contains the source, or a cell that
        counts was not traced.
    """
    if not scene_radiance > 0:
        raise MistrayError(f"scene_radiance is {scene_radiance:g} W/(mm² sr); it must be positive")

    def over(normal: Pst, stray: np.ndarray) -> Estimate:
        return quotient(normal, (stray / scene_radiance, "stray"), (_solid_angles(pst), "direct"))

    facts = {"scene_radiance_W_mm2_sr": scene_radiance}
    return _of_source(pst, "stray_to_signal", source, interpolation, over, "1", {}, facts)


def normalised_stray_light(pst: Pst, diameter_deg: float) -> MetricCurve:
    """
    Return stray light of a disc-shaped source over the irradiance within its direct image, by field angle.

    A source of radiance L and diameter d gives E_⊥ = L π sin²(d/2). Its image is as bright as that of a uniform scene,
    L ∫ PST_direct dΩ. The ratio is dimensionless.

    Parameters
    ----------
    pst : Pst
        PST whose cells cover the field of view.
    diameter_deg : float
        Angular diameter of the source, degrees; the PST is taken as constant over it.

    Raises
    ------
    MistrayError
        If the diameter is not between 0 and 180 degrees, no direct light is in the cells, or one was not traced.
    """
    ratios, facts = _by_image(pst, diameter_deg)
    return _curve(pst, "normalised_stray_light", ratios, facts=facts)


def flare_attenuation(pst: Pst, diameter_deg: float, decibels: bool = False) -> MetricCurve:
    """
    Return the irradiance within the direct image of a disc-shaped source over its stray light, by field angle.

    It is the reciprocal of `normalised_stray_light`, infinite if no stray light arrives.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    diameter_deg : float
        Angular diameter of the source, degrees.
    decibels : bool
        Whether to return 10 log10 of it, dB.

    Raises
    ------
    MistrayError
        If the diameter is not between 0 and 180 degrees, no direct light is in the cells, or one was not traced.
    """
    ratios, facts = _by_image(pst, diameter_deg)
    values = [Estimate(1 / r.value, r.se / r.value**2) if r.value > 0 else Estimate(np.inf, np.nan) for r in ratios]
    if decibels:
        values = [Estimate(10 * np.log10(v.value), 10 / np.log(10) * v.se / v.value) for v in values]
    return _curve(pst, "flare_attenuation", values, facts=facts, unit="dB" if decibels else "1")


def contrast_factor(stray_to_signal_ratio: Estimate) -> StrayMetric:
    """
    Return the fraction of the image contrast that is left under evenly spread stray light: 1/(1 + E_stray/E_signal).

    Parameters
    ----------
    stray_to_signal_ratio : Estimate
        ``stray_to_signal(…).estimate``; the signal is the mean of bright and dark.
    """
    ratio, se = stray_to_signal_ratio
    return StrayMetric.of("contrast_factor", Estimate(1 / (1 + ratio), se / (1 + ratio) ** 2))


def ab_zero_point(wavelength_nm: float, bandwidth_nm: float) -> float:
    """
    Return the irradiance of a source of AB magnitude 0 in a narrow band, W/mm²: f_ν c Δλ / λ².

    f_ν is `AB_W_M2_HZ`, c the speed of light, λ the wavelength of the band and Δλ its width.

    Raises
    ------
    MistrayError
        If the wavelength is not above 0, or the bandwidth is not between 0 and the wavelength.
    """
    if not wavelength_nm > 0 or not 0 < bandwidth_nm < wavelength_nm:
        raise MistrayError(
            f"band of {bandwidth_nm:g} nm about {wavelength_nm:g} nm; both must be positive and the band narrower than "
            "its wavelength"
        )
    return AB_W_M2_HZ * LIGHT_M_S * bandwidth_nm * 1e-9 / (wavelength_nm * 1e-9) ** 2 * 1e-6


def surface_magnitude(radiance: Estimate, zero_point_W_mm2: float) -> StrayMetric:
    """
    Return the surface brightness of a radiance in magnitudes per square arcsecond: -2.5 log10(L · arcsec² / E_0).

    L is the radiance, and E_0 the irradiance of magnitude 0. Without radiance the magnitude is infinite.

    Parameters
    ----------
    radiance : Estimate
        Radiance, W/(mm² sr), for example ``equivalent_stray_radiance(…).estimate``.
    zero_point_W_mm2 : float
        Irradiance of a source of magnitude 0 in the same band, W/mm², see `ab_zero_point`.

    Raises
    ------
    MistrayError
        If the zero point is not above 0.
    """
    if not zero_point_W_mm2 > 0:
        raise MistrayError(f"zero_point_W_mm2 is {zero_point_W_mm2:g}; it must be positive")
    if not radiance.value > 0:
        estimate = Estimate(np.inf, np.nan)
    else:
        value = -2.5 * np.log10(radiance.value * ARCSEC2_SR / zero_point_W_mm2)
        estimate = Estimate(float(value), 2.5 / np.log(10) * radiance.se / radiance.value)
    return StrayMetric.of("magnitude", estimate, "mag/arcsec2", {"zero": zero_point_W_mm2})


def _of_source(
    pst: Pst,
    quantity: str,
    source: ExtendedSource,
    interpolation: str,
    over: Callable[[Pst, np.ndarray], Estimate],
    unit: str,
    words: dict[str, str],
    facts: Mapping[str, float],
) -> StrayMetric:
    """
    Return a stray-light metric of an extended source, in `unit`.

    `over` computes it from PST_normal and the factors of its cells, (n, m), see `Cover`. For `quantity`, `words` and
    `facts` see `StrayMetric.of`.

    Raises
    ------
    MistrayError
        If no direct light is in the cells, no cell contains the source, or a cell that counts was not traced.
    """
    normal = pst.to("normal")
    curve = normal.map("stray")[0] if interpolation == "log" else None
    seen = cover(pst.grid, source, interpolation, curve)
    require_traced(normal, seen.coefficients)
    estimate = over(normal, seen.coefficients)
    if estimate is UNKNOWN:
        raise MistrayError(
            "no direct light is in the cells of this PST; give angles that cover the field of view, or an f_number "
            "where that is possible"
        )
    return StrayMetric.of(
        quantity,
        estimate,
        unit,
        words,
        covered=seen.covered,
        interpolated=seen.interpolated,
        facts={"interpolation": interpolation, "source_W_mm2_sr": str(source), **facts},
    )


def _by_image(pst: Pst, diameter_deg: float) -> tuple[list[Estimate], dict[str, float]]:
    """
    Return stray over direct irradiance of a disc-shaped source, by field angle, and the facts of the result.

    Raises
    ------
    MistrayError
        If the diameter is not between 0 and 180 degrees, no direct light is in the cells, or one was not traced.
    """
    if not 0 < diameter_deg <= 180:
        raise MistrayError(f"diameter_deg is {diameter_deg:g}; it must lie between 0 and 180 degrees")
    normal = pst.to("normal")
    solid = float(np.pi * np.sin(np.radians(0.5 * diameter_deg)) ** 2)
    image = (_solid_angles(pst), "direct")
    ratios = [quotient(normal, (solid * _row(pst, i), "stray"), image) for i in range(pst.grid.shape[0])]
    if ratios[0] is UNKNOWN:
        raise MistrayError("no direct light is in the cells of this PST; give angles that cover the field of view")
    return ratios, {"diameter_deg": diameter_deg}


def _row(pst: Pst, i: int) -> np.ndarray:
    """Return cell weights, (n, m), that average over all azimuths at the field angle of index `i`."""
    rows = np.zeros(pst.grid.shape)
    rows[i] = 1 / pst.grid.shape[1]
    return rows


def _solid_angles(pst: Pst) -> np.ndarray:
    """Return the solid angle of each direction cell of a PST, (n, m), sr."""
    return np.broadcast_to(pst.grid.solid_angle[:, None], pst.grid.shape)


def _named(classes: Light) -> str:
    return "+".join(several(classes))


def _curve(
    pst: Pst,
    quantity: str,
    values: list[Estimate],
    words: dict[str, str] | None = None,
    facts: Mapping[str, object] | None = None,
    unit: str = "1",
) -> MetricCurve:
    value, se = np.array(values, dtype=np.float64).T
    definition = DEFINITIONS[quantity].format(**(words or {}))
    return MetricCurve(quantity, pst.field_deg, value, se, unit, definition, dict(facts or {}))

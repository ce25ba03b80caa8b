"""Veiling glare: stray light on a black patch, in the image of a point, and relative to the direct image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.analyses.pst.glare.extended_source import Cover, Disc, ExtendedSource, SkyRadiance, cover
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.sums import quotient, require_traced, times, weighted_sum
from mistray.errors import MistrayError
from mistray.estimate import UNKNOWN, Estimate
from mistray.known_arguments import known_arguments
from mistray.metrics.ghost_ranking import direct_image, stray_to_direct
from mistray.metrics.stray_metric import DEFINITIONS, StrayMetric
from mistray.toolkit.irradiance import brightest
from mistray.trace import Trace

PLACES = {
    "map": "the pixel of the detector where the middle of the patch is imaged",
    "point": "the detector, taken for a point within the image of the patch",
    "mean": "the detector, the mean of the stray light over its area",
}


@known_arguments
def veiling_glare_index(
    pst: Pst,
    patch_deg: float,
    field_deg: float = 0.0,
    azimuth_deg: float = 0.0,
    *,
    source_deg: float = 90.0,
    place: str | None = None,
    at_mm: tuple[float, float] | None = None,
    interpolation: str = "cells",
) -> StrayMetric:
    """
    Return the veiling glare index of a white source with a black patch, percent: 100 E_black / E_white (ISO 9358).

    Parameters
    ----------
    pst : Pst
        PST in either convention.
    patch_deg : float
        Angular half-width (radius) of the patch, degrees.
    field_deg, azimuth_deg : float
        Direction of its middle, degrees.
    source_deg : float
        Largest field angle of the white source, degrees; 90: a hemisphere.
    place : {"map", "point", "mean"}, optional
        "map": E at one pixel of the maps of the PST, by default if there are any. "point": the detector is so small
        that it lies within the image of the patch. "mean": the mean over the detector stands for the point; E_black is
        then of stray light alone, because direct light from beside the patch does not fall on its image.
    at_mm : (float, float), optional
        Pixel for "map" alone, mm in the detector's frame; by default the brightest for light from the middle of the
        patch.
    interpolation : {"cells", "linear", "log"}
        See `mistray.analyses.pst.glare.extended_source.cover`.

    Returns
    -------
    StrayMetric
        Unit "%"; `covered` is the fraction of the white source in cells of the PST. The maps of a PST have no batches,
        so that with "map" the errors of the cells are taken as independent.

    Raises
    ------
    MistrayError
        If the place is unknown, the patch is not within the source, no cell contains any of it, the PST has no maps for
        "map", or `at_mm` is off the detector or for another place. Also if the patch is off the axis while one cell
        covers all azimuths, except for "mean", if no light from its middle meets the detector, which would tell the
        pixel, or if a cell of the source was not traced.
    """
    place = place or ("mean" if pst.maps is None and at_mm is None else "map")
    if at_mm is not None and place != "map":
        raise MistrayError(f"at_mm is a pixel of place 'map', and place is '{place}'; leave one of them out")
    if place == "map" and pst.maps is None:
        raise MistrayError("this PST was computed without maps; ask for them with map_pixels=64, or use place='mean'")
    normal = pst.to("normal")
    black, seen, black_light = glare_cells(
        normal, patch_deg, field_deg, azimuth_deg, source_deg=source_deg, place=place, interpolation=interpolation
    )
    white = seen.coefficients
    facts: dict[str, Any] = {}
    if place == "map":
        glare, facts = _at_pixel(pst, black, white, field_deg, azimuth_deg, at_mm)
    else:
        glare = quotient(normal, (black, black_light), (white, "total"))
    facts |= {
        "patch_deg": patch_deg,
        "angle_deg": field_deg,
        "azimuth_deg": azimuth_deg,
        "source_deg": source_deg,
        "interpolation": interpolation,
    }
    return StrayMetric.of(
        "vgi",
        glare.times(100),
        "%",
        {"place": PLACES[place]},
        covered=seen.covered,
        interpolated=seen.interpolated,
        facts=facts,
    )


def glare_cells(
    normal: Pst,
    patch_deg: float,
    field_deg: float = 0.0,
    azimuth_deg: float = 0.0,
    *,
    source_deg: float = 90.0,
    place: str = "mean",
    interpolation: str = "cells",
) -> tuple[np.ndarray, Cover, str]:
    """
    Return the factors of the cells of a PST in E_black and E_white of the veiling glare index.

    Parameters
    ----------
    normal : Pst
        PST in the convention "normal".
    patch_deg, field_deg, azimuth_deg, source_deg, place, interpolation
        Arguments of `veiling_glare_index`.

    Returns
    -------
    black : (n, m) float64
        Factor of the PST of each cell in E_black, W/mm², for a source of radiance 1 W/(mm² sr).
    white : Cover
        Cover with the factors in E_white, of all light.
    light : str
        Light that counts in E_black.

    Raises
    ------
    MistrayError
        If the place is unknown, the patch is not within the source, no cell contains any of it, or it is off the axis
        while one cell covers all azimuths.
    """
    if place not in PLACES:
        raise MistrayError(f"place is '{place}'; use 'map', 'point' or 'mean'")
    if not 0 < patch_deg < source_deg or field_deg + patch_deg > source_deg:
        raise MistrayError(
            f"patch of half-width {patch_deg:g}° at {field_deg:g}°; it must lie within the source, which reaches to "
            f"{source_deg:g}°"
        )
    if field_deg > 0 and normal.grid.azimuth_cell_deg >= 360 and place != "mean":
        raise MistrayError(
            f"patch at {field_deg:g}°: one cell of the PST holds all azimuths, which says nothing about a point off "
            "the axis; compute the PST with azimuths_deg"
        )
    black_light = "stray" if place == "mean" else "total"

    def seen(source: ExtendedSource, light: str) -> Cover:
        return cover(normal.grid, source, interpolation, normal.map(light)[0] if interpolation == "log" else None)

    sky, patch = SkyRadiance(to_deg=source_deg), Disc(patch_deg, 1.0, field_deg, azimuth_deg, "patch")
    black = seen(sky, black_light).coefficients - seen(patch, black_light).coefficients
    return black, seen(sky, "total"), black_light


def _at_pixel(
    pst: Pst,
    black: np.ndarray,
    white: np.ndarray,
    field_deg: float,
    azimuth_deg: float,
    at_mm: tuple[float, float] | None,
) -> tuple[Estimate, dict[str, Any]]:
    """
    Return E_black / E_white at one detector pixel, and by name the position of that pixel, mm.

    `black` and `white`, (n, m), are factors of the PST's cells; for the others see `veiling_glare_index`. The ratio is
    NaN if no white light meets the pixel.

    Raises
    ------
    MistrayError
        If the pixel is off the detector, no light from the middle of the patch meets the detector, or a cell of the
        source was not traced.
    """
    assert pst.maps is not None
    require_traced(pst, white)
    height, width = pst.maps.shape[-2:]
    x0, x1, y0, y1 = pst.extent_mm
    if at_mm is None:
        i, j = pst.grid.nearest(field_deg, azimuth_deg)
        image = pst.maps[0, i, j]
        if not image.any():
            raise MistrayError(
                f"no light from the middle of the patch, {field_deg:g}°, meets the detector; choose the pixel by at_mm"
            )
        row, column = divmod(int(np.argmax(image)), width)
    else:
        if not (x0 <= at_mm[0] <= x1 and y0 <= at_mm[1] <= y1):
            raise MistrayError(
                f"at_mm is ({at_mm[0]:g}, {at_mm[1]:g}); the detector reaches from x {x0:g} to {x1:g} and y {y0:g} to "
                f"{y1:g} mm"
            )
        column, row = (
            min(int((at - low) / (high - low) * count), count - 1)
            for at, low, high, count in ((at_mm[0], x0, x1, width), (at_mm[1], y0, y1, height))
        )
    value, se = pst.maps[:, :, :, row, column]
    where = {
        "x_mm": float(x0 + (column + 0.5) * (x1 - x0) / width),
        "y_mm": float(y0 + (row + 0.5) * (y1 - y0) / height),
    }
    base = float(np.sum(times(white, value)))
    if not base > 0:
        return UNKNOWN, where
    glare = float(np.sum(times(black, value))) / base
    return Estimate(glare, float(np.sqrt(np.sum(np.square(times(black - glare * white, se))))) / base), where


@dataclass(frozen=True, eq=False)
class GlareSpread:
    """
    Glare spread function over the detector: irradiance over the flux of the direct image.

    The irradiance is that of stray light (of a trace) or of all light (of a PST), as `definition` says.

    Attributes
    ----------
    value, se : (h, w) float64
        Irradiance over the flux of the direct image, 1/mm², row 0 at the smallest y, and its standard error; of a trace
        NaN where only few rays arrive.
    extent_mm : tuple of float
        x0, x1, y0, y1 of the detector, mm.
    definition : str
        Definition in words.
    """

    value: np.ndarray
    se: np.ndarray
    extent_mm: tuple[float, float, float, float]
    definition: str


@known_arguments
def glare_spread(
    light: Pst | Trace, field_deg: float = 0.0, azimuth_deg: float = 0.0, *, reference_deg: float | None = None
) -> GlareSpread:
    """
    Return the glare spread function, 1/mm²: irradiance on the detector over the flux of the direct image (ISO 9358).

    Parameters
    ----------
    light : Pst or Trace
        PST with maps, which include the direct image; or a trace, of which stray light alone is mapped by
        tracing its rays again.
    field_deg, azimuth_deg : float
        Direction of the source, degrees; a trace has its own.
    reference_deg : float, optional
        For a PST: field angle of the direct image used as reference, degrees; by default that of the source. For a
        source out of the field give one within it.

    Raises
    ------
    MistrayError
        If the PST has no maps, or the direct image has no light or was not traced.
    """
    if isinstance(light, Trace):
        direct, stray = _direct_and_stray(light)
        flux = light.paths.light(direct)
        if not flux.value > 0:
            raise MistrayError("the trace has no direct image to compare with; trace a field angle within the field")
        (glare,) = light.each_map([stray], [True])
        found = glare.over(flux)
        spread, se = found.value, np.where(glare.few_rays, np.nan, found.se)
        extent, words = light.extent, "stray light alone"
    else:
        value, se = light.irradiance(field_deg, azimuth_deg)
        reference = field_deg if reference_deg is None else reference_deg
        i, j = light.grid.nearest(reference, azimuth_deg)
        cell = np.zeros(light.grid.shape)
        cell[i, j] = light.facts["detector_area_mm2"]
        image = weighted_sum(light.to("normal"), cell, "direct")
        if not image.value > 0:
            raise MistrayError(
                f"no direct light from {reference:g}° meets the detector; give a reference_deg within the field"
            )
        extent, words = light.extent_mm, f"all light, and the flux of the direct image at {reference:g}°"
        spread = value / image.value
        se = np.hypot(se, spread * image.se) / image.value
    return GlareSpread(spread, se, extent, DEFINITIONS["gsf"].format(light=words))


def ghost_to_signal(t: Trace, nominal: Trace | None = None) -> tuple[StrayMetric, StrayMetric]:
    """
    Return the ghost-to-signal ratio of a trace, all stray light over the direct image: of fluxes and of peaks.

    Parameters
    ----------
    t : Trace
        Trace with its path table; its rays are traced again for the peak.
    nominal : Trace, optional
        Trace of the same beam whose direct image is the signal; by default `t`. Give one on axis for a source
        out of the field.

    Returns
    -------
    integrated, peak : StrayMetric
        Φ_stray / Φ_direct of the absorbed flux, and the ratio of the brightest pixels. The brightest of
        noisy pixels is too bright by about its standard error.

    Raises
    ------
    MistrayError
        If there is no direct image.
    """
    own = nominal is None
    signal = t if nominal is None else nominal
    _, stray = _direct_and_stray(t)
    direct, _ = _direct_and_stray(signal)
    if not direct:
        raise MistrayError("no direct light meets the detector; give a nominal trace of a field angle within the field")
    integrated = stray_to_direct(t.paths, direct_image(signal.paths))
    if own:
        image, glare = t.each_map([direct, stray], [True, True])
    else:
        (image,), (glare,) = signal.each_map([direct], [True]), t.each_map([stray], [True])
    peak = brightest(glare).over(brightest(image))
    facts = {"field_deg": t.settings["field_deg"], "signal_field_deg": signal.settings["field_deg"]}
    return (
        StrayMetric.of("gsr", integrated, facts=facts),
        StrayMetric.of(
            "gsr_peak",
            Estimate(float(peak.value), float(peak.se)),
            facts=facts | {"pixels": f"{t.irradiance.shape[1]} x {t.irradiance.shape[0]}"},
        ),
    )


def _direct_and_stray(t: Trace) -> tuple[list[int], list[int]]:
    """Return two lists of path ids of a trace: those of the direct image, and all others."""
    return t.paths.ids(True).tolist(), t.paths.ids(False).tolist()

"""Pictures of image quality: MTF, point spread functions, wavefronts, spots, encircled energy, field curves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.colors import LogNorm

from mistray.analyses.image.line_image import Array
from mistray.analyses.image.result import ENERGY, FieldImage, ImageQuality
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from mistray.trace.history import spread

COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, "#555555")
SHOWN = 8  # fields in one picture, spread evenly over all
LEAST = 1e-5  # of the peak, what a logarithmic PSF shows
PIXELS = 160
AIRY_DISCS, RADII = 2.0, 2.5  # half size of the picture of a PSF: Airy diameters at least, radii of 80 % of the flux
RAYS = 3000  # of a spot diagram


def mtf_figure(found: ImageQuality, title: str = "") -> Figure:
    """Draw the MTF (T and S) of up to 8 fields against frequency, 1/mm, with the diffraction limit of the first."""
    images, of_all = _shown(found)
    return _mtf(images, max(map(_last_frequency, found)), title, of_all)


def field_mtf_figure(image: FieldImage, title: str = "") -> Figure:
    """Draw the tangential and sagittal MTF of one field against frequency, 1/mm, with the diffraction limit."""
    return _mtf([image], _last_frequency(image), title)


def pixel_edges(middles: Array) -> tuple[float, float]:
    """Return where the first of evenly spaced pixels begins and the last ends, from their middles, (n,), n > 1."""
    half = 0.5 * float(middles[1] - middles[0])
    return float(middles[0]) - half, float(middles[-1]) + half


def _shown(found: ImageQuality) -> tuple[list[FieldImage], str]:
    """Return the fields in one picture, spread evenly over all, and how many they are for its heading if not all."""
    if len(found) <= SHOWN:
        return [*found], ""
    return [found[int(k)] for k in spread(len(found), SHOWN)], f", {SHOWN} of {len(found)} fields"


def _last_frequency(image: FieldImage) -> float:
    return max(image.cut_off_per_mm("tangential"), image.cut_off_per_mm("sagittal"))


def _mtf(images: Sequence[FieldImage], last: float, title: str, of_all: str = "") -> Figure:
    made, axes = Figure.of_panels(8.0, 4.8)
    f = np.linspace(0, last, 201)
    axes.plot(f, images[0].diffraction_limit(f, "sagittal"), color="#888888", lw=1, ls=":", label="diffraction limit")
    for image, colour in zip(images, cycle(COLOURS), strict=False):
        axes.plot(f, image.mtf(f, "tangential"), color=colour, lw=1.4, label=image.name)
        axes.plot(f, image.mtf(f, "sagittal"), color=colour, lw=1.2, ls="--")
    axes.set(xlim=(0, last), ylim=(0, 1))
    plain_axes(axes, legend=True, xlabel="spatial frequency on the detector [1/mm]", ylabel="MTF")
    how = "solid: tangential, dashed: sagittal; dotted: the first field without aberration"
    return made.headed(title, f"modulation transfer function{of_all}", how)


def psf_figure(found: ImageQuality, title: str = "") -> Figure:
    """
    Draw the point spread functions of up to 8 fields over their peaks; axes in µm.

    They are linear above and logarithmic below.
    """
    images, of_all = _shown(found)
    made, panels = Figure.of_panels(1.2 + 2.6 * len(images), 5.6, 2, len(images), squeeze=False)
    for column, image in zip(panels.T, images, strict=True):
        psf = image.psf(PIXELS, 2 * _half(image) / PIXELS)
        peak = psf.values.max()
        values = psf.values / peak if peak > 0 else np.zeros_like(psf.values)  # NaN where nothing is resolved
        extent = 2 * pixel_edges(1e3 * psf.x_mm)
        for axes, norm in zip(column, (None, LogNorm(LEAST, 1)), strict=True):
            shown = np.maximum(values, LEAST) if norm is not None else values
            axes.imshow(shown, origin="lower", extent=extent, cmap="inferno", norm=norm)
            axes.tick_params(labelsize=7)
        column[0].set_title(f"{image.name}, Strehl {image.strehl:.3f}", fontsize=9)
        column[1].set_xlabel("x [µm]", fontsize=8)
    for axes, text in zip(panels[:, 0], ("linear", f"logarithmic, to {LEAST:g}"), strict=True):
        axes.set_ylabel(f"{text}\ny [µm]", fontsize=8)
    how = "x sagittal, y tangential, from the chief ray; each picture has its own scale"
    return made.headed(title, f"point spread function, relative to its peak{of_all}", how)


def opd_figure(found: ImageQuality, title: str = "") -> Figure:
    """
    Draw the wavefronts of up to 8 fields in waves over direction cosines.

    They are at the reference wavelength, after removal of tilt.
    """
    images, of_all = _shown(found)
    made, panels = Figure.of_panels(1.2 + 3.0 * len(images), 3.6, 1, len(images), squeeze=False)
    for axes, image in zip(panels[0], images, strict=True):
        pupil = image.main.pupil
        wave = np.where(pupil.lit, pupil.residual("tilt"), np.nan)
        extent = pixel_edges(pupil.alpha) + pixel_edges(pupil.beta)
        most = max(float(np.nanmax(np.abs(wave))), 1e-6)
        drawn = axes.imshow(wave, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
        bar = made.colorbar(drawn, ax=axes, shrink=0.75)
        bar.ax.tick_params(labelsize=7)
        bar.ax.set_title("waves", fontsize=7, pad=3)
        axes.set_title(f"{image.name}: {image.main.rms_waves():.3g} waves rms", fontsize=9)
        axes.tick_params(labelsize=7)
        axes.set_xlabel("direction cosine x", fontsize=8)
    return made.headed(title, f"wavefront at {found[0].main.wavelength_nm:g} nm without its tilt [waves]{of_all}")


def spot_figure(found: ImageQuality, title: str = "") -> Figure:
    """Draw the spot diagrams of up to 8 fields in µm, by wavelength, with the Airy disc."""
    images, of_all = _shown(found)
    shared = {"squeeze": False, "sharex": True, "sharey": True}
    made, (panels,) = Figure.of_panels(1.2 + 2.6 * len(images), 3.4, 1, len(images), **shared)
    turn = np.linspace(0, 2 * np.pi, 97)
    for axes, image in zip(panels, images, strict=True):
        for line, colour in zip(image.lines, cycle(COLOURS), strict=False):
            points = 1e3 * line.spot_mm[line.pupil.share > 0.5]
            points = points[:: max(1, len(points) // RAYS)]
            axes.plot(*points.T, ".", ms=1.2, color=colour, label=f"{line.wavelength_nm:g} nm")
        radius, middle = 500 * image.airy_diameter_mm(), 1e3 * image.centroid_mm
        axes.plot(middle[0] + radius * np.cos(turn), middle[1] + radius * np.sin(turn), color="#333333", lw=0.8)
        axes.set_title(f"{image.name}: {1e3 * image.rms_spot_mm():.3g} µm rms", fontsize=9)
        axes.set_aspect("equal", adjustable="box")
        axes.tick_params(labelsize=7)
        axes.set_xlabel("x [µm]", fontsize=8)
        plain_axes(axes)
    panels[0].set_ylabel("y [µm]", fontsize=8)
    if len(found.wavelengths_nm) > 1:
        panels[0].legend(fontsize=7, frameon=False, markerscale=5)
    how = "circle: Airy disc of diameter 2.44 λN about the centroid"
    return made.headed(title, f"spots about the chief ray{of_all}", how)


def energy_figure(found: ImageQuality, title: str = "") -> Figure:
    """Draw the encircled energy of up to 8 fields in percent against the radius in µm."""
    images, of_all = _shown(found)
    made, axes = Figure.of_panels(8.0, 4.4)
    most = min(max(2 * _half(image) for image in images), min(image.largest_radius_mm for image in found))
    radii = np.linspace(0, most, 101)
    for image, colour in zip(images, cycle(COLOURS), strict=False):
        axes.plot(1e3 * radii, 100 * image.encircled_energy(radii), color=colour, lw=1.4, label=image.name)
    axes.axhline(100 * ENERGY, color="#888888", lw=0.8, ls=":")
    axes.set(xlim=(0, 1e3 * most), ylim=(0, 100))
    plain_axes(axes, xlabel="radius about the centroid [µm]", ylabel="encircled energy [%]")
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return made.headed(title, f"encircled energy{of_all}")


def field_figure(found: ImageQuality, title: str = "") -> Figure:
    """
    Draw relative illumination (percent), distortion (percent) and foci (mm) against the field.

    The field is an angle, degrees, or the height of a near object, mm.
    """
    made, (light, bent, foci) = Figure.of_panels(10.0, 3.6, 1, 3)
    images = sorted(found, key=lambda image: image.field_mm if found.near else image.field_deg)
    x = [image.field_mm if found.near else image.field_deg for image in images]
    unit = "object height [mm]" if found.near else "field angle [deg]"
    light.plot(x, [100 * image.relative_illumination for image in images], "o-", color=BLUE, ms=3.5)
    light.set(ylabel="relative illumination [%]", ylim=(0, None))
    bent.plot(x, [image.distortion_percent for image in images], "o-", color=BLUE, ms=3.5, label="of the axis")
    bent.plot(
        x, [image.calibrated_distortion_percent for image in images], "s--", color=VERMILION, ms=3, label="calibrated"
    )
    bent.set(ylabel="distortion [%]")
    foci.plot(x, [image.tangential_focus_mm for image in images], "o-", color=BLUE, ms=3.5, label="tangential")
    foci.plot(x, [image.sagittal_focus_mm for image in images], "s--", color=VERMILION, ms=3, label="sagittal")
    foci.set(ylabel="focus from the detector [mm]")
    for axes in (light, bent, foci):
        plain_axes(axes, legend=axes is not light, xlabel=unit)
    return made.headed(title, "over the field")


def _half(image: FieldImage) -> float:
    """Return half the side, mm, of the square that the picture of a point spread function shows."""
    radius = image.encircled_radius_mm(ENERGY)
    around = float(np.linalg.norm(image.centroid_mm)) + RADII * (
        radius if np.isfinite(radius) else image.spot_radius_mm()
    )
    return min(max(AIRY_DISCS * image.airy_diameter_mm(), around), 0.999 * image.largest_radius_mm)

"""Pictures of an image with its stray light: transfer functions, irradiance about the image, encircled energy.

The public functions return Matplotlib figures that are not registered with pyplot.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from mistray.analyses.image.figures import pixel_edges
from mistray.analyses.transfer.result import AZIMUTHS, FieldTransfer, Transfer, TransferCurve
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION

Array = npt.NDArray[np.float64]

COLOURS = {"tangential": BLUE, "sagittal": VERMILION}
PARTS = {"direct": BLUE, "ghosts": VERMILION, "scatter": GREEN}
DECADES = 16  # of irradiance, below the peak
LEAST_MTF = 0.02  # of lens and detector, below which a loss of contrast is not shown
LEAST_OUTSIDE = 1e-7
SURE = 4.0  # standard errors
CORE = 128  # pixels of the picture of the image
WIDTHS = (1.5, 8.0)  # half of each picture, in Airy diameters or of the spot
IMAGE_DECADES = 6


def mtf_figure(found: FieldTransfer, title: str = "") -> Figure:
    """Draw the MTF with and without stray light, and the contrast lost to stray light, over frequency in 1/mm."""
    figure, (left, right) = Figure.of_panels(10.4, 4.4, 1, 2)
    nu = found.frequencies_per_mm
    for azimuth in AZIMUTHS:
        colour = COLOURS[azimuth]
        left.plot(nu, found.lens(azimuth), ls=(0, (2, 2)), lw=1.0, color=colour, label=f"lens alone, {azimuth}")
        _band(left, nu, found.composite(azimuth), colour, f"with stray light{_and(found)}, {azimuth}")
    if found.pixels is not None:
        left.plot(nu, np.abs(found.detector(AZIMUTHS[0])), lw=0.8, color=GREY, label=f"detector, {AZIMUTHS[0]}")
    left.set(ylim=(0, 1.03), xlim=(0, nu[-1] or 1.0), ylabel="modulation transfer")
    left.legend(fontsize=7.5, framealpha=0.9, edgecolor="none", loc="upper right")
    right.set_xscale("log")
    floor, azimuth = found.veiling_floor, AZIMUTHS[0]
    direct = found.without_stray(azimuth)
    seen = (nu > 0) & (direct > LEAST_MTF)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = TransferCurve(*(part / direct for part in found.composite(azimuth)))
    curves = ((found.stf(azimuth), GREEN, "scatter"), (found.ghosts(azimuth), ORANGE, "ghosts"), (whole, BLACK, "both"))
    for curve, colour, label in curves:
        _band(right, nu[seen], TransferCurve(100 * (1 - curve.value[seen]), 100 * curve.se[seen]), colour, label)
    lost = 100 * (1 - floor.value)
    right.axhline(lost, color=GREY, lw=0.8, ls=(0, (5, 3)), zorder=1)
    right.annotate(f"veiling floor: MTF times {floor.value:.4g}", (0, lost), xycoords=("axes fraction", "data"),
                   xytext=(4, 3), textcoords="offset points", fontsize=7.5, color="#555555")  # fmt: skip
    right.set(ylim=(0, max(1.15 * lost, 1e-3)), ylabel=f"contrast lost by stray light, {azimuth} [%]")
    right.legend(fontsize=7.5, framealpha=0.9, edgecolor="none", loc="lower right")
    for axes in (left, right):
        plain_axes(axes, below=True, xlabel="spatial frequency on the detector [1/mm]")
    how = "bands: ± one standard error; floor: direct light over all light on the detector"
    return figure.headed(title, f"field {found.name}: MTF with and without stray light", how, right=True)


def first_figure(found: Transfer, title: str = "") -> Figure:
    """Draw the transfer functions of the first field, see `mtf_figure`."""
    return mtf_figure(found[0], title)


def spread_figure(found: FieldTransfer, title: str = "") -> Figure:
    """Draw irradiance by class, 1/mm², encircled energy, and the share of light farther out, over distance, mm."""
    figure, (left, middle, right) = Figure.of_panels(12.6, 4.2, 1, 3)
    edges, area = found.edges_mm, np.pi * np.diff(found.edges_mm**2)
    total = sum(part.value for part in found.ring_shares.values()) / area
    left.plot(_middle(edges), np.where(total > 0, total, np.nan), color="#c9ced4", lw=5.0, label="all light")
    for name, part in found.ring_shares.items():
        if np.any(part.value > 0):
            _band(left, *_sure(edges, part), PARTS[name], name)
    peak = float(total.max())
    floor = max(float(total[total > 0].min()) / 30, peak * 10.0**-DECADES)
    left.set(ylim=(floor, 3 * peak), ylabel="irradiance for a flux of 1 [1/mm²]")
    for stray, colour, label in ((False, BLUE, "direct image alone"), (True, BLACK, "with stray light")):
        curve = found.encircled_energy(edges[1:], stray)
        _band(middle, edges[1:], curve, colour, label)
        _band(right, edges[1:], TransferCurve(1 - curve.value, curve.se), colour, label)
    middle.set(ylim=(0, 1.02), ylabel="encircled energy")
    lowest = float(1 - found.encircled_energy(edges[-2:-1], stray=False).value[0])
    right.set(ylim=(max(lowest / 3, LEAST_OUTSIDE), 1.3), ylabel="share of the light outside")
    for axes in (left, middle, right):
        axes.set(xscale="log", yscale=axes.get_yscale() if axes is middle else "log", xlim=(10 * edges[1], edges[-1]))
        plain_axes(axes, below=True, xlabel="distance from the direct image [mm]")
    left.legend(fontsize=7.5, framealpha=0.9, edgecolor="none", loc="upper right")
    middle.legend(fontsize=7.5, framealpha=0.9, edgecolor="none", loc="lower right")
    how = (
        "means over rings about the centroid of the direct image, over several where rays are few; where rings "
        "leave the detector they count as dark; bands: ± one standard error"
    )
    text = f"field {found.name}: point spread function with its stray light"
    return figure.headed(title, text, how, right=True)


def image_figure(found: FieldTransfer, title: str = "") -> Figure:
    """Draw the point spread function with stray light relative to its peak, linear and logarithmic; axes in µm."""
    image = found.image
    figure, panels = Figure.of_panels(9.2, 4.2, 1, 2)
    norms: tuple[dict[str, Any], ...] = ({"vmin": 0.0, "vmax": 1.0}, {"norm": LogNorm(10.0**-IMAGE_DECADES, 1.0)})
    size = max(image.airy_diameter_mm(), 2 * image.rms_spot_mm())
    aside = float(np.abs(image.centroid_mm).max())
    peak = 0.0
    for axes, how, name, width in zip(panels, norms, ("linear", "logarithmic"), WIDTHS, strict=True):
        half = min(width * size + aside, 0.999 * image.largest_radius_mm)
        whole, _ = found.psf(CORE, 2 * half / CORE)
        peak = peak or float(whole.values.max())
        values = np.maximum(whole.values / peak, 10.0**-IMAGE_DECADES)
        extent = 2 * pixel_edges(1e3 * whole.x_mm)
        shown = axes.imshow(values, origin="lower", extent=extent, cmap="inferno", interpolation="nearest", **how)
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("sagittal [µm]")
        figure.colorbar(shown, ax=axes, shrink=0.85).ax.set_title("of the peak", fontsize=7, pad=3)
    figure.axes[0].set_ylabel("tangential [µm]")
    return figure.headed(title, f"field {found.name}: image of a point with stray light, over its peak")


def _and(found: FieldTransfer) -> str:
    return " and detector" if found.pixels is not None else ""


def _middle(edges: Array) -> Array:
    """Return the radii at which ring values are drawn, mm: geometric means of the edges, at least half the outer."""
    return np.asarray(np.sqrt(np.maximum(edges[:-1], edges[1:] / 4) * edges[1:]))


def _sure(edges: Array, part: TransferCurve) -> tuple[Array, TransferCurve]:
    """
    Join rings outwards until each value exceeds `SURE` standard errors; return radii, mm, and irradiance, 1/mm².

    `edges` are the ring edges, mm, `part` the share of light in each ring. Outermost rings that never do are left out.
    """
    ends, value, square = [0], 0.0, 0.0
    values, errors = [], []
    for k in range(len(part.value)):
        value, square = value + part.value[k], square + part.se[k] ** 2
        if value > 0 and value >= SURE * np.sqrt(square):
            values.append(value)
            errors.append(np.sqrt(square))
            ends.append(k + 1)
            value, square = 0.0, 0.0
    joined = edges[ends]
    area = np.pi * np.diff(joined**2)
    return _middle(joined), TransferCurve(np.array(values) / area, np.array(errors) / area)


def _band(axes: Axes, x: Array, curve: TransferCurve, colour: str, label: str) -> None:
    """Draw a curve over `x` with a band of ± one standard error."""
    axes.plot(x, curve.value, color=colour, lw=1.4, label=label)
    axes.fill_between(x, curve.value - curve.se, curve.value + curve.se, color=colour, alpha=0.25, lw=0)

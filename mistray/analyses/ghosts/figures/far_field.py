"""Picture of a far field: radiant intensity in W/sr against the angle from its axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.recorders.flux_maps.far_field import FarField
from mistray.toolkit.figures.figure import Figure, legend_label, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
DECADES = 12


def far_field_figure(name: str, found: Sequence[tuple[float, FarField]]) -> Figure:
    """
    Draw radiant intensity (W/sr) against the angle from the axis: mean over azimuth with one standard error, by field.

    A dotted line shows the highest cell of each ring if there are several azimuths.

    Parameters
    ----------
    name : str
        Name of the far field, title of the legend.
    found : sequence of (float, FarField)
        Field angle, degrees, and recorded far field.
    """
    made, axes = Figure.of_panels(7.2, 4.0, dpi=110)
    highest = 0.0
    for (field, one), colour in zip(found, (COLOURS * (len(found) // len(COLOURS) + 1)), strict=False):
        flux, solid = one.flux_of_rings, one.solid_angle_sr * one.azimuths
        mean, se = flux.value / solid, flux.se / solid
        highest = max(highest, float(mean.max()))
        axes.stairs(np.where(mean > 0, mean, np.nan), one.edges_deg, color=colour, lw=1.4, label=f"field {field:g}°")
        low, high = (np.append(v, v[-1]) for v in (np.maximum(mean - se, 1e-3 * mean), mean + se))
        axes.fill_between(one.edges_deg, low, high, step="post", color=colour, alpha=0.25, lw=0)
        if one.azimuths > 1:
            top = one.intensity[0].max(axis=1)
            axes.stairs(np.where(top > 0, top, np.nan), one.edges_deg, color=colour, lw=0.9, ls=":")
    if highest > 0:
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], highest * 10.0**-DECADES))
    plain_axes(axes, xlabel="angle from the axis [deg]", ylabel="radiant intensity [W/sr]")
    axes.legend(fontsize=8, frameon=False, title=legend_label(name), title_fontsize=8)
    more = "; dotted: the highest cell around" if any(one.azimuths > 1 for _, one in found) else ""
    return made.small_print(f"mean over azimuth, with a band of one standard error{more}")

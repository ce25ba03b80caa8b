"""Picture of the irradiance on walls: unrolled maps, each on its own scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm

from mistray.recorders.flux_maps.surface_maps import SurfaceMap
from mistray.toolkit.figures.figure import Figure

DECADES = 4  # below the brightest cell, to which a scale reaches at most
COLUMNS = 3
LABELS = {"azimuth": "azimuth [deg]", "x": "x [mm]", "z": "z [mm]", "radius": "radius [mm]", "y": "y [mm]"}


@dataclass(frozen=True, eq=False)
class Panel:
    """Irradiance map to draw, W/mm², (rows, columns): axes are keys of `LABELS`, borders of cells in mm or degrees."""

    title: str
    irradiance: np.ndarray
    across: str
    along: str
    across_borders: np.ndarray
    along_borders: np.ndarray


def surface_maps_figure(maps: Sequence[SurfaceMap]) -> Figure:
    """
    Draw the irradiance on unrolled surfaces, W/mm², each on its own log10 scale.

    Parameters
    ----------
    maps : sequence of SurfaceMap
        At least one map.
    """
    panels = [
        Panel(one.surface, one.irradiance[0], one.across, one.along, one.across_borders, one.along_mm) for one in maps
    ]
    return panels_figure(panels, "irradiance of both sides; grey: less than the scale, or no ray")


def panels_figure(maps: Sequence[Panel], small_print: str) -> Figure:
    """
    Draw irradiance maps, W/mm², as panels, each on its own log10 scale.

    Parameters
    ----------
    maps : sequence of Panel
        At least one panel.
    small_print : str
        Note below the panels.
    """
    columns = min(COLUMNS, len(maps))
    rows = -(-len(maps) // columns)
    made, grid = Figure.of_panels(3.5 * columns + 0.3, 2.6 * rows + 0.3, rows, columns, dpi=110, squeeze=False)
    panels = grid.ravel()
    colours = colormaps["inferno"].with_extremes(bad="#bbbbbb", under="#bbbbbb")
    for axes, one in zip(panels, maps, strict=False):
        value = one.irradiance
        lit = value[value > 0]
        across, along = one.across_borders, one.along_borders
        axes.set_title(one.title, fontsize=8.5, loc="left")
        axes.set_xlabel(LABELS[one.across], fontsize=8)
        axes.set_ylabel(LABELS[one.along], fontsize=8)
        axes.tick_params(labelsize=7.5)
        if one.across == "azimuth":
            axes.set_xticks(np.arange(0, 361, 90))
        if not len(lit):
            axes.set(xlim=(across[0], across[-1]), ylim=(along[0], along[-1]), facecolor="#bbbbbb")
            continue
        top = float(lit.max())
        norm = LogNorm(min(max(float(lit.min()), top * 10.0**-DECADES), 0.5 * top), top)
        extent = (float(across[0]), float(across[-1]), float(along[0]), float(along[-1]))
        shown = axes.imshow(
            np.where(value > 0, value, np.nan), origin="lower", extent=extent, aspect="auto", cmap=colours, norm=norm,
            interpolation="nearest",
        )  # fmt: skip
        bar = made.colorbar(shown, ax=axes, pad=0.02)
        bar.ax.tick_params(labelsize=7, which="both")
        bar.set_label("W/mm²", fontsize=7.5)
    for axes in panels[len(maps) :]:
        axes.set_axis_off()
    return made.small_print(small_print)

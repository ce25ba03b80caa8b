"""Pictures of a point source transmittance: the curve, its causes, the map over angle and azimuth, the detector.

The public functions return Matplotlib figures that are not registered with pyplot.
"""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from mistray.analyses.pst.causes import cause_frame, field_edge
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.tables import largest_share, name_of
from mistray.errors import MistrayError
from mistray.known_arguments import known_arguments
from mistray.percent import percent_text
from mistray.toolkit.figures.figure import Figure, legend_label, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, YELLOW
from mistray.toolkit.figures.plots import HOW_TO_READ, Range, draw_map, image_colours
from mistray.toolkit.irradiance import log_range

if TYPE_CHECKING:
    from mistray.analyses.pst.first_level import FirstLevel

# class: colour, width of the line, marker
CURVES = {
    "stray": ("#c9ced4", 6.0, ""),
    "total": (BLACK, 1.6, "o"),
    "direct": (BLUE, 1.1, "s"),
    "straight_shot": (SKY, 1.1, "P"),
    "ghost": (VERMILION, 1.1, "^"),
    "single_scatter": (GREEN, 1.1, "v"),
    "multiple_scatter": (PURPLE, 1.1, "D"),
    "edge_diffraction": (ORANGE, 1.1, "X"),
}
LABELS = {"total": "all light", "stray": "stray light: all but direct", "direct": "direct image", "ghost": "ghosts",
          "straight_shot": "straight shots"}  # fmt: skip
SYMBOLS = {"normal": "PST = E_det / E_⊥", "projected": "PST = E_det / (E_⊥ cos θ)"}
MOST_DECADES = 14
BELOW = 2  # decades shown at most below the smallest PST of all light, for the classes
CAUSE_COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY, BROWN, BLACK, YELLOW)
MOST_TICKS = 17
ARC_DEG = 2.0  # a cell of the map is drawn by arcs of this length, which look round
IRRADIANCE_LABEL = "log₁₀ irradiance [W/mm² for 1 W/mm² across the beam]"


def pst_curve(pst: Pst, title: str = "") -> Figure:
    """
    Draw the PST against field angle with bands of one standard error, and below it the relative standard errors.

    Curves show all light, all stray light, and each class. Angles without any light are marked by an open triangle at
    the bottom.
    """
    figure, (above, below) = Figure.of_panels(10.4, 6.6, 2, sharex=True, height_ratios=(3.4, 1))
    angles = pst.field_deg
    limits = _pst_range(pst)
    above.set_yscale("log")
    if limits is None:
        text = "no light was seen" if pst.is_dark else "no angle with light was traced at all azimuths"
        above.text(0.5, 0.5, text, ha="center", va="center", transform=above.transAxes)
        above.set_ylim(1e-12, 1.0)
    else:
        above.set_ylim(*limits)
        for group in CURVES:
            _band(above, pst, group, limits[0])
        dark = pst.curve()[0] <= 0
        if dark.any():
            above.plot(angles[dark], np.full(dark.sum(), 1.6 * limits[0]), ls="", marker="v", mfc="none", color=BLACK,
                       ms=5, label="no light found", clip_on=False)  # fmt: skip
        above.legend(fontsize=8, framealpha=0.9, edgecolor="none", loc="upper right")
    _decades(above)
    above.set_ylabel(f"{SYMBOLS[pst.convention]}   [{pst.convention}]")
    around = "mean over all azimuths" if pst.grid.azimuth_cell_deg >= 360 else "mean over the azimuths"
    above.set_title(f"{title}{': ' if title else ''}point source transmittance, {pst.method}, {around}", fontsize=10)
    _errors(below, pst)
    below.set_xlabel("field angle θ [deg]")
    edge = field_edge(pst)
    for axes in (above, below):
        plain_axes(axes, below=True)
        if edge is not None:
            axes.axvline(edge, color=BLUE, lw=0.8, ls=(0, (5, 3)), zorder=1)
    if edge is not None:
        above.annotate(
            f"edge of the field, {edge:.1f}°", (edge, 0), xycoords=("data", "axes fraction"), xytext=(0, -5),
            textcoords="offset points", fontsize=7.5, color=BLUE, ha="center", va="top",
        )  # fmt: skip
    below.set_xlim(_ends(pst))
    below.xaxis.set_major_locator(MaxNLocator(nbins=MOST_TICKS, steps=[1, 2, 5, 10]))
    return figure.small_print(
        "bands: ± one standard error; edge of the field: half of the direct light at the smallest angle", right=True
    )


def level_curves(found: FirstLevel, title: str = "") -> Figure:
    """
    Draw the stray PST against field angle for each set of limits on scatter and reflections.

    Error bars are one standard error.
    """
    made, axes = Figure.of_panels(8.6, 4.2)
    lit = False
    for (name, pst), colour in zip(found.curves.items(), cycle(CAUSE_COLOURS), strict=False):
        value, se = pst.curve("stray")
        seen = value > 0
        lit |= bool(seen.any())
        axes.errorbar(
            pst.field_deg[seen], value[seen], np.minimum(se, 0.95 * value)[seen], label=legend_label(name),
            color=colour, marker="o", ms=3, lw=1.2, capsize=2,
        )  # fmt: skip
    if lit:
        axes.set_yscale("log")
    plain_axes(axes, below=True, legend=True, xlabel="field angle θ [deg]", ylabel="stray PST [1]")
    return made.headed(title, "levels of scatter and reflection", "error bars: one standard error")


def pst_causes(pst: Pst, title: str = "") -> Figure:
    """Draw the share of the stray light at each angle in percent by cause: scattering surface, ghosts, structure."""
    table = cause_frame(pst)
    figure, axes = Figure.of_panels(10.4, 4.2)
    widths = np.diff(pst.grid.edges_deg, axis=1)[:, 0]
    centres = pst.grid.edges_deg.mean(axis=1)
    named = list(table.columns[: len(CAUSE_COLOURS)])
    parts = [(name, table[name].to_numpy(), colour) for name, colour in zip(named, CAUSE_COLOURS, strict=False)]
    rest = table.columns[len(named) :]
    if len(rest):
        parts.append((f"{len(rest)} more", table[rest].sum(axis=1).to_numpy(), "#c9ced4"))
    base = np.zeros(len(centres))
    for name, share, colour in parts:
        axes.bar(centres, share, widths, bottom=base, color=colour, label=legend_label(name), lw=0.3, edgecolor="white")
        base += share
    axes.set(xlabel="field angle θ [deg]", ylabel="share of the stray light [%]", xlim=_ends(pst), ylim=(0, 100))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=MOST_TICKS, steps=[1, 2, 5, 10]))
    axes.set_title(f"{title}{': ' if title else ''}first surface that scatters, or ghosts", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    edge = field_edge(pst)
    if edge is not None:
        axes.axvline(edge, color="white", lw=1.6)
        axes.axvline(edge, color=BLACK, lw=0.8, ls=(0, (5, 3)), label="edge of the field")
    if parts:
        handles, labels = axes.get_legend_handles_labels()  # lines first, then bars from the bottom up
        figure.legend(handles[::-1], labels[::-1], loc="outside right upper", fontsize=8, frameon=False)
    return figure.small_print(
        "stray light: all but the direct image; left blank: paths that the table of paths does not hold", right=True
    )


def pst_map(pst: Pst, title: str = "") -> Figure:
    """
    Draw the PST over field angle (radius) and azimuth on a log10 scale: all light left, stray light right.

    A point of the map is the direction in which light travels, for a viewer looking at the source. At the top it
    travels towards +y, on the left towards -x.

    Raises
    ------
    MistrayError
        If the PST has a single azimuth.
    """
    if pst.grid.shape[1] < 2:
        raise MistrayError("a map of the PST needs two azimuths or more; give azimuths_deg")
    figure, panels = Figure.of_panels(11.8, 5.4, 1, 2, subplot_kw={"projection": "polar"})
    edge = field_edge(pst)
    for axes, group in zip(panels, ("total", "stray"), strict=True):
        _polar_map(axes, pst, pst.map(group)[0])
        axes.set_title(LABELS[group], fontsize=10, pad=12)
        if edge is not None:
            axes.plot(np.linspace(0, 2 * np.pi, 181), np.full(181, edge), color=SKY, lw=0.9, ls=(0, (5, 3)))
    figure.suptitle(f"{title}{': ' if title else ''}PST over field angle and azimuth, {pst.method}", fontsize=10)
    dashed = "; dashed: edge of the field" if edge is not None else ""
    return figure.small_print(
        "radius: field angle [deg]; azimuth of the beam: 0° towards +y, 90° towards -x; black: below the scale or no "
        f"light; grey: not computed{dashed}",
        right=True,
    )


@known_arguments
def pst_irradiance(pst: Pst, field_deg: float, azimuth_deg: float = 0.0) -> Figure:
    """
    Draw the irradiance on the detector, W/mm², from a distant source of 1 W/mm² on a log10 scale.

    Parameters
    ----------
    pst : Pst
        PST with maps, computed with ``map_pixels``.
    field_deg, azimuth_deg : float
        Field angle and azimuth, degrees; the map is that of the cell that contains them.
    """
    value, se = pst.irradiance(field_deg, azimuth_deg)
    x0, x1, y0, y1 = pst.extent_mm
    figure, axes = Figure.of_panels(5.6, 0.9 + 4.4 * max((y1 - y0) / (x1 - x0), 0.45))
    picture = draw_map(axes, value, pst.extent_mm, log_range([value]), np.isnan(se))
    at = "mean over all azimuths" if pst.grid.azimuth_cell_deg >= 360 else f"azimuth {azimuth_deg:g}°"
    axes.set_title(f"source at {field_deg:g}°, {at}", fontsize=10)
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    if picture is not None:
        bar = figure.colorbar(picture, ax=axes, shrink=0.95, pad=0.02, extend="min")
        bar.set_label(IRRADIANCE_LABEL, fontsize=8)
        known = np.isfinite(se) & (value > 0)
        error = (
            f"; relative error of the others {percent_text(float(np.median(se[known] / value[known])))} (median)"
            if known.any()
            else ""
        )
        figure.small_print(HOW_TO_READ + error, right=True)
    return figure


def _pst_range(pst: Pst) -> Range | None:
    """Return the lower and upper limit of the PST axis of the curve; None if the curve has no value above 0."""
    if not (pst.value > 0).any():
        return None
    lowest = {group: np.min(value[value > 0], initial=np.inf) for group in CURVES for value in (pst.curve(group)[0],)}
    top = np.ceil(np.log10(np.nanmax(pst.value)) + 0.1)
    least = np.log10(min(lowest["total"], lowest["stray"]))
    floor = max(np.floor(np.log10(min(lowest.values())) - 0.1), np.floor(least) - BELOW)
    return float(10.0 ** max(floor, top - MOST_DECADES)), float(10.0**top)


def _band(axes: Axes, pst: Pst, group: str, floor: float) -> None:
    """
    Draw the PST curve of light class `group` with its band of one standard error, with gaps where it has no light.

    Nothing is drawn if it has none at all. `floor` is the lower limit of the axis.
    """
    value, se = pst.curve(group)
    if not (value > 0).any():
        return
    colour, width, marker = CURVES[group]
    shown = np.where(value > 0, value, np.nan)
    axes.plot(
        pst.field_deg, shown, color=colour, lw=width, marker=marker, ms=3 if marker else 0,
        label=LABELS.get(group, legend_label(name_of(group))), solid_capstyle="butt",
        zorder=2 if group == "stray" else 3,
    )  # fmt: skip
    low = np.maximum(shown - se, floor / 10)
    axes.fill_between(pst.field_deg, low, shown + se, color=colour, alpha=0.25, lw=0, zorder=2.5)
    beside = np.pad(value > 0, 1)
    alone = (value > 0) & ~beside[:-2] & ~beside[2:]  # a band needs a neighbour
    axes.vlines(pst.field_deg[alone], low[alone], (shown + se)[alone], color=colour, lw=2.5, alpha=0.25)


def _errors(axes: Axes, pst: Pst) -> None:
    """Draw, in %, relative standard errors of the PST, the requested one, and the largest ray's share of scatter."""
    for group, style in (("total", "-"), ("stray", ":")):
        value, se = pst.curve(group)
        lit = value > 0
        percent = np.where(lit, 100 * se / np.where(lit, value, 1.0), np.nan)
        axes.plot(pst.field_deg, np.where(percent > 0, percent, np.nan), color=BLACK, ls=style, lw=1.1,
                  label=f"standard error, {LABELS[group].partition(':')[0]}")  # fmt: skip
    share = 100 * largest_share(pst)
    axes.plot(pst.field_deg, np.where(share > 0, share, np.nan), color=ORANGE, lw=1.1, label="largest ray of scatter")
    requested = pst.facts.get("relative_error")
    if requested:
        until = pst.facts.get("error_up_to_deg")
        axes.plot([pst.field_deg[0], pst.field_deg[-1] if until is None else until], [100 * requested] * 2, color=GREY,
                  lw=0.9, ls="--", label="requested error")  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylabel("[%]")
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize=7, framealpha=0.9, edgecolor="none", ncols=4, loc="upper left")
    low, high = axes.get_ylim()
    axes.set_ylim(low, 10 * high)  # room for the legend


def _decades(axes: Axes) -> None:
    """Put a tick at each of the up to `MOST_DECADES` decades of a PST axis, and remove the labels of minor ticks."""
    low, high = np.log10(axes.get_ylim())
    axes.yaxis.set_major_locator(LogLocator(base=10.0, numticks=int(high - low) + 3))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _ends(pst: Pst) -> tuple[float, float]:
    low, high = float(pst.grid.edges_deg.min()), float(pst.grid.edges_deg.max())
    margin = 0.01 * (high - low)
    return low - margin, high + margin


def _polar_map(axes: Any, pst: Pst, value: np.ndarray) -> None:
    """
    Draw one polar map of PST over field angle and azimuth with its colour bar, on its own log10 scale.

    Without light a text takes the place of the colour bar.
    """
    limits = log_range([value], MOST_DECADES)
    axes.set_theta_zero_location("N")
    axes.set_facecolor("#e6e6e6")
    azimuths, radii, shown = _polar_cells(pst, value)
    cells = np.ma.masked_invalid(np.log10(np.maximum(shown, np.finfo(float).tiny)))
    low, high = limits or (-1.0, 0.0)
    colours = image_colours().with_extremes(bad=(0, 0, 0, 0), under="black")
    picture = axes.pcolormesh(azimuths, radii, cells, cmap=colours, vmin=low, vmax=high, rasterized=True)
    axes.set_ylim(0, float(pst.grid.edges_deg.max()))
    axes.grid(color="white", lw=0.4, alpha=0.5)
    axes.tick_params(axis="y", labelsize=7)
    for text in axes.get_yticklabels():
        text.set_bbox({"facecolor": "white", "alpha": 0.6, "lw": 0, "pad": 0.6})
    axes.tick_params(axis="x", labelsize=8)
    axes.set_rlabel_position(202.5)
    if limits is None:
        axes.text(0.5, 0.5, "no light", color="white", ha="center", va="center", transform=axes.transAxes)
        return
    bar = axes.figure.colorbar(picture, ax=axes, shrink=0.8, pad=0.09, extend="min")
    bar.set_label(f"log₁₀ PST [{pst.convention}]", fontsize=8)
    bar.ax.tick_params(labelsize=8)


def _polar_cells(pst: Pst, value: np.ndarray) -> tuple[Any, Any, np.ndarray]:
    """Return cell edges in azimuth (rad) and field angle (degrees), and cell values with NaN between cells."""
    grid = pst.grid
    half = grid.azimuth_cell_deg / 2
    order = np.argsort(grid.azimuths_deg % 360)
    azimuths = (grid.azimuths_deg % 360)[order]
    around: list[float] = []
    column: list[int] = []  # of the value; -1: none
    for k, azimuth in enumerate(azimuths):
        arcs = np.linspace(azimuth - half, azimuth + half, int(np.ceil(2 * half / ARC_DEG)) + 1)
        if around:
            column.append(-1)  # from the last cell to this one; of no width where they touch
        around += arcs.tolist()
        column += [int(order[k])] * (len(arcs) - 1)
    radii = grid.edges_deg.ravel()
    shown = np.full((2 * len(grid.edges_deg) - 1, len(column)), np.nan)
    cells = np.array(column)
    shown[::2] = np.where(cells >= 0, value[:, cells], np.nan)
    return np.radians(around), radii, shown

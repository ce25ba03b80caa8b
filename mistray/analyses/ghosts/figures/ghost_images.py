"""Pictures of a ghost analysis: ghost images on a log10 scale, their montage, and ghost levels against field angle.

The public functions return Matplotlib figures that are not registered with pyplot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mistray.analyses.ghosts.result import GhostReport
from mistray.files.irradiance_files import Extent, Map
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import (
    BLACK,
    BLUE,
    BROWN,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    PURPLE,
    SKY,
    VERMILION,
    YELLOW,
)
from mistray.toolkit.figures.plots import DECADES, HOW_TO_READ, Range, scaled_map
from mistray.toolkit.irradiance import log_range, pixels_averaged

# kind of path: colour and marker
KINDS = {
    DIRECT: (BLUE, "o"),
    "ghost": (VERMILION, "s"),
    "structure": (GREEN, "^"),
    "structure+ghost": (PURPLE, "D"),
    "single scatter": (BLACK, "*"),
    "multiple scatter": (GREY, "X"),
    "ghost + scatter": (BROWN, "p"),
    "edge diffraction": (YELLOW, "<"),
    "diffraction + others": (PINK, ">"),
    "TIR": (SKY, "P"),
    "straight shot": (ORANGE, "v"),
}
IRRADIANCE_LABEL = "log₁₀ irradiance [W/mm²]"
CELLS, SMALL_CELLS = 512, 192  # along the longer side of a large map, and of one among many
FIELDS_AS_TICKS = 10


def common_range(report: GhostReport, stray: bool = False) -> Range | None:
    """
    Return one log10 range, as powers of ten of W/mm², for the maps of all fields; None if all are dark.

    The maps are of all light, or with `stray` of stray light alone.
    """
    maps = [report.stray_map(field)[0] if stray else report[field].irradiance for field in report]
    return log_range(maps, DECADES)


def ghost_image(report: GhostReport, field_deg: float, limits: Range | None = None) -> Figure:
    """
    Draw the irradiance of one field on log10 scales: all light on the left, stray light alone on the right.

    Without a direct image both would be the same, so only one is drawn.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    field_deg : float
        Field angle, degrees.
    limits : (float, float), optional
        Floor and top of the scale of both, powers of ten of W/mm², such as `common_range`. Default: each has its own.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> figure = mistray.report.ghost_image(report, 10)
    >>> figure.savefig("ghosts_10deg.png")
    """
    t = report[field_deg]
    stray = report.stray_light(field_deg)
    panels = [(stray, "stray light, without the direct image")]
    if report.summary(field_deg).direct.power_W.value > 0:
        panels.insert(0, (t.light, "all light"))
    width, height = 5.6, max(_aspect(t.extent), 0.45)
    how: dict[str, Any] = {"dpi": 110, "sharex": True, "sharey": True, "squeeze": False}
    figure, (grid,) = Figure.of_panels(width * len(panels), 0.9 + 4.3 * height, 1, len(panels), **how)
    for axes, (image, title) in zip(grid, panels, strict=True):
        scaled_map(axes, image, t.extent, limits, CELLS)
        axes.set_title(f"field {field_deg:g}°, {title}", fontsize=10)
        axes.set_xlabel("x [mm]")
    grid[0].set_ylabel("y [mm]")
    return figure.small_print(_how_to_read(t.irradiance, CELLS, limits is not None), right=True)


def montage(report: GhostReport, columns: int = 4, common: bool = False) -> Figure:
    """
    Draw the stray light of all fields side by side, without the direct images.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    columns : int
        Number of maps in a row.
    common : bool
        Draw all on one log10 scale; by default each has its own.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> figure = mistray.report.montage(report, columns=2, common=True)
    >>> figure.savefig("stray_light.png")
    """
    fields = list(report)
    limits = common_range(report, stray=True) if common else None
    columns = min(columns, len(fields))
    rows = -(-len(fields) // columns)
    aspect = _aspect(report[fields[0]].extent)
    figure = Figure(figsize=(0.8 + 3.0 * columns, 0.6 + (2.4 * max(aspect, 0.4) + 0.35) * rows), dpi=120)
    figure.set_layout_engine("constrained", h_pad=0.08)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, field in zip(grid.flat, fields, strict=False):
        scaled_map(axes, report.stray_light(field), report[field].extent, limits, SMALL_CELLS)
        axes.set_title(f"{field:g}°", fontsize=10, pad=3)
    for axes in grid.flat[len(fields) :]:
        axes.set_axis_off()
    for k, axes in enumerate(grid.flat[: len(fields)]):
        axes.locator_params(nbins=5, prune="both")
        if k + columns >= len(fields):
            axes.set_xlabel("x [mm]")
            axes.tick_params(labelbottom=True)
        if k % columns == 0:
            axes.set_ylabel("y [mm]")
    return figure.small_print(_how_to_read(report[fields[0]].irradiance, SMALL_CELLS, common), right=True)


def _how_to_read(image: Map, cells: int, common: bool) -> str:
    pixels = pixels_averaged(image, cells)
    mean = f"; means of {pixels} × {pixels} pixels" if pixels > 1 else ""
    scale = "one scale" if common else "each map on its own scale"
    return f"{IRRADIANCE_LABEL}, {scale}; {HOW_TO_READ}{mean}"


def levels_against_field(report: GhostReport, title: str = "") -> Figure:
    """
    Draw power (W) of the direct image and of each kind of stray light against field angle, on the left.

    On the right it draws the RMS irradiance of the ten worst paths over that of the direct image on axis.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> figure = mistray.report.levels_against_field(report, title="Cooke triplet")
    >>> figure.axes[0].get_ylabel()
    'power [W absorbed]'
    """
    fields = sorted(report)
    summaries = [report.summary(field) for field in fields]
    figure, (left, right) = Figure.of_panels(10.4, 4.0, 1, 2, dpi=110)
    series = {DIRECT: [s.direct.power_W for s in summaries]}
    series |= {kind: [s.stray_of_kind_W[kind] for s in summaries] for kind in STRAY_KINDS}
    for kind, estimates in series.items():
        values, errors = zip(*estimates, strict=True)
        _error_bars(left, fields, values, errors, kind, "direct image" if kind == DIRECT else kind)
    left.set_ylabel("power [W absorbed]")
    left.set_title("Power", fontsize=10)
    shown = set()
    for field in fields:
        top = report.listed(field, 10, "rms")
        top = top[~top.few_rays]
        for kind, rows in top.groupby("kind"):
            values, errors = rows.normalised_rms_irradiance, rows.normalised_rms_irradiance_se
            label = None if kind in shown else str(kind)
            _error_bars(right, [field] * len(rows), values, errors, str(kind), label, joined=False)
            shown.add(kind)
    worst = [s.brightest_normalised.value for s in summaries]
    right.plot(fields, worst, color="#888888", lw=0.8, zorder=1, label="worst path")
    right.set_ylabel("RMS irradiance / that of the on-axis image")
    right.set_title("Ten worst stray paths", fontsize=10)
    for axes in (left, right):
        plain_axes(axes, yscale="log", xlabel="field angle [deg]")
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8, framealpha=0.85, edgecolor="none")
        if len(fields) <= FIELDS_AS_TICKS:
            axes.set_xticks(fields)
    how = "error bars: one standard error"
    return figure.headed(title, small_print=how, right=True) if title else figure.small_print(how, right=True)


def _error_bars(
    axes: Axes,
    x: Sequence[float],
    values: Sequence[float],
    errors: Sequence[float],
    kind: str,
    label: str | None,
    joined: bool = True,
) -> None:
    """
    Draw points with error bars of one standard error on a logarithmic axis, in the colour of a kind of path.

    `label` is for the legend, None: no entry. Lines connect the points if `joined`. Values not above 0 are left out; if
    no other is left, nothing is drawn.
    """
    y = np.array(values, dtype=np.float64)
    good = np.isfinite(y) & (y > 0)
    if not good.any():
        return
    se = np.where(np.isfinite(errors), errors, 0.0)[good]
    below = np.minimum(se, 0.95 * y[good])
    axes.errorbar(
        np.array(x, dtype=np.float64)[good], y[good], yerr=[below, se], color=KINDS[kind][0],
        marker=KINDS[kind][1], ms=4.5, lw=1.1 if joined else 0, elinewidth=0.9, capsize=2, label=label, zorder=2,
    )  # fmt: skip


def _aspect(extent: Extent) -> float:
    return (extent[3] - extent[2]) / (extent[1] - extent[0])

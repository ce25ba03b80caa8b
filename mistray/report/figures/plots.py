"""Pictures of a ghost analysis: ghost images on a log10 scale, their montage, ghost levels against field angle.

Every function returns a Matplotlib `Figure` that belongs to no global state. Magnitudes are in "inferno", uniform in
lightness and safe for colour-blind readers.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap

from mistray.analysis.ghosts import GhostReport
from mistray.analysis.irradiance import log10_image, log_range
from mistray.errors import MistrayError
from mistray.files.irradiance_files import Extent, Map
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.replace_file import replace_file
from mistray.report.figures.figure import Figure, plain_axes
from mistray.report.figures.palette import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PINK, PURPLE, SKY, VERMILION, YELLOW

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
DECADES = 12.0
FIELDS_AS_TICKS = 10
Range = tuple[float, float]


def image_colours() -> Colormap:
    """Colour map of irradiance; pixels below the floor or without rays are black."""
    return colormaps["inferno"].with_extremes(bad="black", under="black")


def common_range(report: GhostReport) -> Range | None:
    """One log10 range for the maps of all fields; None if all are dark."""
    return log_range([report[field].irradiance for field in report], DECADES)


def ghost_image(report: GhostReport, field_deg: float, limits: Range | None = None) -> Figure:
    """
    Irradiance of one field on a log10 scale: all light on the left, stray light alone on the right.

    Parameters
    ----------
    report : GhostReport
    field_deg : float
        Field angle, degrees.
    limits : (float, float), optional
        Floor and top of the scale, powers of ten of W/mm². Default: `common_range`.
    """
    t = report[field_deg]
    limits = limits or common_range(report)
    aspect = _aspect(t.extent)
    figure = Figure(figsize=(10.4, 0.9 + 4.3 * max(aspect, 0.45)), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    picture = None
    stray, _ = report.stray_map(field_deg)
    for axes, image, title in ((left, t.irradiance, "all light"), (right, stray, "without the direct image")):
        picture = draw_map(axes, image, t.extent, limits) or picture
        axes.set_title(f"field {field_deg:g}°, {title}", fontsize=10)
        axes.set_xlabel("x [mm]")
    left.set_ylabel("y [mm]")
    if picture is not None and limits:
        bar = figure.colorbar(picture, ax=[left, right], shrink=0.95, pad=0.015, extend="min")
        bar.set_label(IRRADIANCE_LABEL)
        figure.small_print(f"floor 1e{limits[0]:g} W/mm²; black: below the floor or no ray", right=True)
    return figure


def montage(report: GhostReport, columns: int = 4) -> Figure:
    """Ghost images of all fields on one log10 scale."""
    fields = list(report)
    limits = common_range(report)
    columns = min(columns, len(fields))
    rows = -(-len(fields) // columns)
    aspect = _aspect(report[fields[0]].extent)
    figure = Figure(figsize=(1.1 + 2.75 * columns, 0.6 + (2.6 * max(aspect, 0.4) + 0.35) * rows), dpi=120)
    figure.set_layout_engine("constrained", h_pad=0.08)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    picture = None
    for axes, field in zip(grid.flat, fields, strict=False):
        picture = draw_map(axes, report[field].irradiance, report[field].extent, limits) or picture
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
    if picture is not None and limits:
        bar = figure.colorbar(picture, ax=grid, shrink=0.9, pad=0.01, aspect=30, extend="min")
        bar.set_label(IRRADIANCE_LABEL)
        figure.small_print(f"floor 1e{limits[0]:g} W/mm²; black: below the floor or no ray", right=True)
    return figure


def levels_against_field(report: GhostReport) -> Figure:
    """Power of the direct image and of each kind of stray light, and normalised RMS irradiance of the worst paths."""
    fields = sorted(report)
    summaries = [report.summary(field) for field in fields]
    figure = Figure(figsize=(10.4, 4.0), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    series = {DIRECT: [s.direct.power_W for s in summaries]}
    series |= {kind: [s.stray_of_kind_W[kind] for s in summaries] for kind in STRAY_KINDS}
    for kind, estimates in series.items():
        values, errors = zip(*estimates, strict=True)
        _error_bars(left, fields, values, errors, kind, "direct image" if kind == DIRECT else kind)
    left.set_ylabel("power on the detector [W]")
    left.set_title("Power", fontsize=10)
    shown = set()
    for field in fields:
        top = report.listed(field, 10, "rms")
        top = top[top.well_sampled]
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
        axes.set_yscale("log")
        axes.set_xlabel("field angle [deg]")
        plain_axes(axes)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8, framealpha=0.85, edgecolor="none")
        if len(fields) <= FIELDS_AS_TICKS:
            axes.set_xticks(fields)
    figure.small_print("error bars: one standard error", right=True)
    return figure


def draw_map(axes: Axes, image: Map, extent: Extent, limits: Range | None) -> Any:
    """Draw one map on a log10 scale; returns the image for a colour bar, None if there is nothing above the floor."""
    axes.set_facecolor("black")
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_aspect("equal")
    if limits is None:
        axes.text(0.5, 0.5, "no light", color="white", ha="center", va="center", transform=axes.transAxes)
        return None
    floor, top = limits
    if not floor < top:
        raise MistrayError(f"log10 scale from {floor:g} to {top:g}; the floor must lie below the top")
    return axes.imshow(
        log10_image(image, 10.0**floor),
        origin="lower",
        extent=extent,
        cmap=image_colours(),
        vmin=floor,
        vmax=top,
        interpolation="nearest",
        aspect="equal",
    )


def _error_bars(
    axes: Axes,
    x: Sequence[float],
    values: Sequence[float],
    errors: Sequence[float],
    kind: str,
    label: str | None,
    joined: bool = True,
) -> None:
    """Points with error bars on a logarithmic axis; values that are not positive are left out."""
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


def as_png(figure: Figure) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight", pad_inches=0.1)
    return buffer.getvalue()


def write_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure in the format that the ending says, complete or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix.lower().removeprefix("."), bbox_inches="tight", pad_inches=0.1)
    return replace_file(path, buffer.getvalue(), "picture")


def as_svg(figure: Figure) -> str:
    """A figure as an SVG element, to stand inside HTML; without metadata, which names addresses."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _aspect(extent: Extent) -> float:
    return (extent[3] - extent[2]) / (extent[1] - extent[0])

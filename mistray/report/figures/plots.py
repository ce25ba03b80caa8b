"""Pictures of a ghost analysis: ghost images on a log10 scale, their montage, ghost levels against field angle.

Every function returns a Matplotlib `Figure` that belongs to no global state. Magnitudes are in "inferno", uniform in
lightness and safe for colour-blind readers.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.image import imread
from matplotlib.ticker import MaxNLocator
from PIL import Image

from mistray.analysis.ghosts import GhostReport
from mistray.analysis.irradiance import averaged, log10_image, log_range, pixels_averaged
from mistray.errors import MistrayError
from mistray.files.irradiance_files import Extent, Map
from mistray.recorders.film import Pixels
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
HOW_TO_READ = "black: below the floor or no ray; hatched: few rays, error unknown"
DECADES = 12.0
OWN_DECADES = 8.0  # of a map on its own scale
CELLS, SMALL_CELLS = 512, 192  # along the longer side of a large map, and of one among many
HATCHED, HATCHES = 1024, 48  # pixels of a hatch along its longer side, and lines
GREYS = 32  # in the palette of a PNG of maps
FIELDS_AS_TICKS = 10
Range = tuple[float, float]
_TAG, _COMMENT = re.compile(r"<[^!?][^>]*>"), re.compile(r"<!--.*?-->", re.DOTALL)
_ID, _USED_ID = re.compile(r' id="([^"]*)"'), re.compile(r'(?:url\(|href=")#([^")]*)')
_LONG_NUMBER, _BLANKS = re.compile(r"-?\d+\.\d{3,}(?!\d*e)"), re.compile(r"\s+")


def image_colours() -> Colormap:
    """Colour map of irradiance; pixels below the floor or without rays are black."""
    return colormaps["inferno"].with_extremes(bad="black", under="black")


def common_range(report: GhostReport, stray: bool = False) -> Range | None:
    """One log10 range for the maps of all fields, on request without the direct images; None if all are dark."""
    maps = [report.stray_map(field)[0] if stray else report[field].irradiance for field in report]
    return log_range(maps, DECADES)


def ghost_image(report: GhostReport, field_deg: float, limits: Range | None = None) -> Figure:
    """
    Irradiance of one field on log10 scales: all light on the left, stray light alone on the right.

    Where no direct image arrives both are the same, and one is drawn.

    Parameters
    ----------
    report : GhostReport
    field_deg : float
        Field angle, degrees.
    limits : (float, float), optional
        Floor and top of the scale of both, powers of ten of W/mm², such as `common_range`. Default: each has its own.
    """
    t = report[field_deg]
    stray = report.stray_light(field_deg)
    panels = [(stray, "stray light, without the direct image")]
    if report.summary(field_deg).direct.power_W.value > 0:
        panels.insert(0, (t.light, "all light"))
    width, height = 5.6, max(_aspect(t.extent), 0.45)
    figure = Figure(figsize=(width * len(panels), 0.9 + 4.3 * height), dpi=110, layout="constrained")
    grid = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (image, title) in zip(grid, panels, strict=True):
        scaled_map(axes, image, t.extent, limits, CELLS)
        axes.set_title(f"field {field_deg:g}°, {title}", fontsize=10)
        axes.set_xlabel("x [mm]")
    grid[0].set_ylabel("y [mm]")
    figure.small_print(_how_to_read(t.irradiance, CELLS, limits is not None), right=True)
    return figure


def montage(report: GhostReport, columns: int = 4, common: bool = False) -> Figure:
    """
    Stray light of all fields, without the direct images.

    Parameters
    ----------
    report : GhostReport
    columns : int
        Maps side by side.
    common : bool
        Draw all on one log10 scale; by default each has its own.
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
    figure.small_print(_how_to_read(report[fields[0]].irradiance, SMALL_CELLS, common), right=True)
    return figure


def scaled_map(axes: Axes, image: Pixels, extent: Extent, limits: Range | None, cells: int) -> None:
    """
    Draw one map with a colour bar of its own.

    Parameters
    ----------
    axes : Axes
    image : Pixels
        W/mm².
    extent : (float, float, float, float)
        x0, x1, y0, y1 in mm.
    limits : (float, float) or None
        Floor and top, powers of ten of W/mm²; None: those of this map.
    cells : int
        Most cells along a side; pixels are averaged in squares until they are no more.
    """
    coarse, whole = averaged(image.value, extent, cells)
    few = image.few_in_squares(pixels_averaged(image.value, cells))
    own = limits or log_range([coarse], OWN_DECADES)
    if own is not None and not (coarse >= 10.0 ** own[0]).any():
        own = None
    picture = draw_map(axes, coarse, whole, own, few)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    if picture is not None and own is not None:
        bar = axes.figure.colorbar(picture, ax=axes, pad=0.02, fraction=0.05, extend="min")
        bar.ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))
        bar.ax.tick_params(labelsize=8)


def _how_to_read(image: Map, cells: int, common: bool) -> str:
    pixels = pixels_averaged(image, cells)
    mean = f"; means of {pixels} × {pixels} pixels" if pixels > 1 else ""
    scale = "one scale" if common else "each map on its own scale"
    return f"{IRRADIANCE_LABEL}, {scale}; {HOW_TO_READ}{mean}"


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
        axes.set_yscale("log")
        axes.set_xlabel("field angle [deg]")
        plain_axes(axes)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8, framealpha=0.85, edgecolor="none")
        if len(fields) <= FIELDS_AS_TICKS:
            axes.set_xticks(fields)
    figure.small_print("error bars: one standard error", right=True)
    return figure


def draw_map(
    axes: Axes, image: Map, extent: Extent, limits: Range | None, few: npt.NDArray[np.bool_] | None = None
) -> Any:
    """
    Draw one map on a log10 scale.

    Parameters
    ----------
    axes : Axes
    image : (H, W) float
    extent : (float, float, float, float)
        x0, x1, y0, y1 in mm.
    limits : (float, float) or None
        Floor and top, powers of ten; None: there is no light.
    few : (H, W) bool, optional
        Pixels that few rays meet; they are hatched where they are above the floor.

    Returns
    -------
    AxesImage or None
        For a colour bar; None if there is nothing above the floor.
    """
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
    how: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest", "aspect": "equal"}
    values = log10_image(image, 10.0**floor)
    picture = axes.imshow(values, cmap=image_colours(), vmin=floor, vmax=top, **how)
    if few is not None and (hatched := few & (image >= 10.0**floor)).any():
        axes.imshow(_hatch(hatched), **how)
    return picture


def _hatch(where: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Grey lines at 45° over some pixels, (h, w, 4) RGBA."""
    finer = max(round(HATCHED / max(where.shape)), 1)
    lines = np.kron(where, np.ones((finer, finer), dtype=bool))
    row, column = np.indices(lines.shape)
    lines &= (row - column) % (max(lines.shape) // HATCHES) < max(lines.shape) // (HATCHES * 5)
    return np.where(lines[..., None], [0.65, 0.65, 0.65, 1.0], 0.0)


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


def as_png(figure: Figure, of_maps: bool = False) -> bytes:
    """A figure as PNG; one with nothing but maps and black text has a palette, and a third of the size."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight", pad_inches=0.1)
    if not of_maps:
        return buffer.getvalue()
    smaller = io.BytesIO()
    buffer.seek(0)
    colours = np.rint(255 * imread(buffer, format="png")[..., :3]).astype(np.uint8)
    picture = Image.fromarray(colours).quantize(palette=_map_palette(), dither=Image.Dither.NONE)
    picture.save(smaller, "PNG", compress_level=9)
    return smaller.getvalue()


def _map_palette() -> Image.Image:
    """The colours of irradiance and grey levels for text, 256 in all."""
    shades = np.repeat(np.linspace(0, 255, GREYS)[:, None], 3, axis=1)
    colours = np.concatenate([255 * image_colours()(np.linspace(0, 1, 256 - GREYS))[:, :3], shades])
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.rint(colours).astype(np.uint8).tobytes())
    return palette


def write_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure in the format that the ending says, complete or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix.lower().removeprefix("."), bbox_inches="tight", pad_inches=0.1)
    return replace_file(path, buffer.getvalue(), "picture")


def as_svg(figure: Figure, text: str = "") -> str:
    """
    A figure as an SVG element, to stand inside HTML; without metadata, which names addresses.

    Text stays text, in the fonts of the reader. Coordinates have two decimals of a point.

    Parameters
    ----------
    figure : Figure
    text : str
        What it shows, for those who do not see it.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    svg = buffer.getvalue()
    svg = _COMMENT.sub("", svg[svg.index("<svg") :])
    used = set(_USED_ID.findall(svg))
    svg = _TAG.sub(lambda tag: _shorter(tag[0], used), svg)
    label = f' role="img" aria-label="{escape(text)}"' if text else ""
    return f"<svg{label}{svg.removeprefix('<svg')}"


def _shorter(tag: str, used: set[str]) -> str:
    """A tag of SVG with rounded coordinates and without an id that nothing refers to."""
    tag = _ID.sub(lambda found: found[0] if found[1] in used else "", tag)
    return _BLANKS.sub(" ", _LONG_NUMBER.sub(lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), tag))


def _aspect(extent: Extent) -> float:
    return (extent[3] - extent[2]) / (extent[1] - extent[0])

"""Maps drawn in figures, and figures written as PNG and SVG.

Magnitudes are in the colour map "inferno", uniform in lightness and safe for colour-blind readers.
"""

from __future__ import annotations

import io
import re
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.image import imread
from matplotlib.ticker import FuncFormatter, MaxNLocator
from PIL import Image

from mistray.errors import MistrayError
from mistray.files.irradiance_files import Extent, Map
from mistray.recorders.film import Pixels
from mistray.replace_file import replace_file
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.irradiance import averaged, log10_image, log_range, pixels_averaged
from mistray.toolkit.typeset import power_of_ten

HOW_TO_READ = "black: below the floor or no ray; hatched: few rays, error unknown"
DECADES = 12.0
OWN_DECADES = 8.0  # of a map on its own scale
HATCHED, HATCHES = 1024, 48  # pixels of a hatch along its longer side, and lines
MOST_ENLARGED, PIXELS_PER_INCH = 1.45, 96  # of figures on wide pages
GREYS = 32  # in the palette of a PNG of maps
Range = tuple[float, float]
_TAG, _COMMENT = re.compile(r"<[^!?][^>]*>"), re.compile(r"<!--.*?-->", re.DOTALL)
_ID, _USED_ID = re.compile(r' id="([^"]*)"'), re.compile(r'(?:url\(|href=")#([^")]*)')
_LONG_NUMBER, _BLANKS = re.compile(r"-?\d+\.\d{3,}(?!\d*e)"), re.compile(r"\s+")


def image_colours() -> Colormap:
    """Return the colour map of irradiance; pixels below the floor or without rays are black."""
    return colormaps["inferno"].with_extremes(bad="black", under="black")


def scaled_map(axes: Axes, image: Pixels, extent: Extent, limits: Range | None, cells: int) -> None:
    """
    Draw one map on a log10 scale with its own colour bar. If no pixel reaches the floor, "no light" is written instead.

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    image : Pixels
        Irradiance with its error, W/mm²; row 0 at the smallest y.
    extent : (float, float, float, float)
        Extent x0, x1, y0, y1, mm.
    limits : (float, float) or None
        Exponents of ten of floor and top, W/mm²; None: those of this map.
    cells : int
        Largest number of cells along a side; pixels are averaged in squares to stay within it.

    Raises
    ------
    MistrayError
        If a pixel reaches the floor, and the floor does not lie below the top.
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
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda exponent, _: power_of_ten(round(exponent))))
        bar.ax.set_title("W/mm²", fontsize=7, pad=3)


def draw_map(
    axes: Axes, image: Map, extent: Extent, limits: Range | None, few: npt.NDArray[np.bool_] | None = None
) -> Any:
    """
    Draw one map on a log10 scale, and return its image for a colour bar.

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    image : (H, W) float
        Irradiance, W/mm², or another quantity in its unit; row 0 at the smallest y.
    extent : (float, float, float, float)
        Extent x0, x1, y0, y1, mm.
    limits : (float, float) or None
        Exponents of ten of floor and top, in the unit of the map; None: there is no light.
    few : (H, W) bool, optional
        True for pixels that few rays reach; those at or above the floor are hatched. None: none is.

    Returns
    -------
    AxesImage or None
        Drawn image, for a colour bar; None if there is no light.

    Raises
    ------
    MistrayError
        If the floor does not lie below the top.
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
    """Return an RGBA image, (h, w, 4), 0 … 1, of grey lines at 45° over the pixels where `where` is true."""
    finer = max(round(HATCHED / max(where.shape)), 1)
    lines = np.kron(where, np.ones((finer, finer), dtype=bool))
    row, column = np.indices(lines.shape)
    lines &= (row - column) % (max(lines.shape) // HATCHES) < max(lines.shape) // (HATCHES * 5)
    return np.where(lines[..., None], [0.65, 0.65, 0.65, 1.0], 0.0)


def as_png(figure: Figure, of_maps: bool = False) -> bytes:
    """Return a figure as PNG; with `of_maps` it has the 256 colours of maps and greys, and is a third as large."""
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
    """Return an image whose palette of 256 colours holds those of irradiance maps and grey levels for text."""
    shades = np.repeat(np.linspace(0, 255, GREYS)[:, None], 3, axis=1)
    colours = np.concatenate([255 * image_colours()(np.linspace(0, 1, 256 - GREYS))[:, :3], shades])
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.rint(colours).astype(np.uint8).tobytes())
    return palette


def write_figure(figure: Figure, path: str | Path) -> Path:
    """
    Write a figure in the format of the file's ending, complete or not at all, and return the path.

    Raise `MistrayError` if the file cannot be written, and what Matplotlib raises for another ending.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix.lower().removeprefix("."), bbox_inches="tight", pad_inches=0.1)
    return replace_file(path, buffer.getvalue(), "picture")


def as_svg(figure: Figure, text: str = "") -> str:
    """
    Return a figure as an SVG element for HTML, without Matplotlib's metadata and its web addresses.

    Text remains text, in the fonts of the reader. Coordinates are rounded to 0.01 point.

    Parameters
    ----------
    figure : Figure
        Matplotlib figure.
    text : str
        Description of the figure for screen readers; empty: none.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    svg = buffer.getvalue()
    svg = _COMMENT.sub("", svg[svg.index("<svg") :])
    used = set(_USED_ID.findall(svg))
    svg = _TAG.sub(lambda tag: _shorter(tag[0], used), svg)
    label = f' role="img" aria-label="{escape(text)}"' if text else ""
    widest = MOST_ENLARGED * PIXELS_PER_INCH * figure.get_size_inches()[0]
    return f'<svg{label} style="max-width: {widest:.0f}px"{svg.removeprefix("<svg")}'


def _shorter(tag: str, used: set[str]) -> str:
    """Return an SVG tag with rounded coordinates, and without its id unless `used` holds that."""
    tag = _ID.sub(lambda found: found[0] if found[1] in used else "", tag)
    return _BLANKS.sub(" ", _LONG_NUMBER.sub(lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), tag))

"""
Embedding of numbers and pictures in an HTML file: maps with 16 bits per pixel, PNG files, and JSON for scripts.

A power P in W is stored as the whole number c of steps of 1/600 decade above 1e-100 W, c = round(600 (100 + log10 P)).
0 means no power. This covers 1e-100 … 1e9 W with an error of at most 0.2 %. The high bytes of all numbers of a page
come first, then the low ones, compressed (zlib) and as base64.
"""

from __future__ import annotations

import base64
import io
import json
import math
import zlib
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from PIL import Image

from mistray.toolkit.drawings.section_layout import bounds, glass_bodies, section

if TYPE_CHECKING:
    from mistray.analyses.ghosts.maps.path_maps import PathMap

STEPS_PER_DECADE, LOWEST_DECADE = 600, -100
MOST_CODE = 65535
COLOURS = 256
DIGITS = 4  # of the size of the system, that coordinates are rounded to


class MapStore:
    """Collector of power maps, W, which are compressed together for one page."""

    def __init__(self) -> None:
        self._codes: list[npt.NDArray[np.uint16]] = []
        self._count = 0

    def add(self, found: PathMap) -> list[int]:
        """
        Add a power map and return its position on the detector and in the store, for the page's script.

        Returns
        -------
        list of int
            Pixels along the side of a cell; indices of the first column and row, in cells; numbers of columns and rows;
            place of its first number in the store.
        """
        height, width = found.power_W.shape
        place = self._count
        self._codes.append(power_codes(found.power_W).ravel())
        self._count += width * height
        return [found.pixels, found.column, found.row, width, height, place]

    def text(self) -> str:
        """Return the codes of all stored maps, compressed, as base64 text."""
        codes = np.concatenate([np.zeros(0, dtype=np.uint16), *self._codes])
        planes = (codes >> 8).astype(np.uint8).tobytes() + (codes & 255).astype(np.uint8).tobytes()
        return _compressed(planes)


def packed(value: Any) -> str:
    """Return a JSON-serialisable value as compressed JSON in base64."""
    return _compressed(json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode())


def _compressed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def power_codes(power_W: npt.NDArray[np.float64]) -> npt.NDArray[np.uint16]:
    """
    Return powers, W, as uint16 codes of the same shape: steps of 1/600 decade above 1e-100 W; 0 for no power.

    Powers outside of 1e-100 … 1e9 W get the lowest or highest code.
    """
    codes = np.zeros(power_W.shape, dtype=np.uint16)
    lit = power_W > 0
    steps = np.rint(STEPS_PER_DECADE * (np.log10(power_W[lit]) - LOWEST_DECADE))
    codes[lit] = np.clip(steps, 1, MOST_CODE).astype(np.uint16)
    return codes


def decimals(low: npt.ArrayLike, high: npt.ArrayLike) -> int:
    """
    Return the number of decimals, ≥ 0, for coordinates in a box, such that its longest side has `DIGITS` digits.

    `low` and `high` are its smallest and largest coordinates, in one unit.
    """
    size = max(float(np.max(np.subtract(high, low))), 1e-9)
    return max(DIGITS - 1 - math.floor(math.log10(size)), 0)


def section_data(scene: Any) -> dict[str, Any]:
    """
    Return a system's section at x = 0, its bounds and the colours of maps as JSON-serialisable data for page scripts.

    Coordinates are z and y, mm, rounded to `DIGITS` digits of the system's size. The bounds are the smallest z and y,
    then the largest.
    """
    lines = section(scene)
    low, high = bounds(lines)
    digits = decimals(low, high)
    return {
        "colours": colour_text(),
        "digits": digits,
        "bounds": np.round([*low, *high], digits).tolist(),
        "glass": rounded(glass_bodies(scene), digits),
        "surfaces": [
            {"name": surface.name, "kind": surface.kind, "lines": rounded(surface.lines, digits)} for surface in lines
        ],
    }


def json_script(name: str, value: Any) -> str:
    """Return a <script> element of id `name` with JSON for the page; `<` is escaped, so that no text can end it."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{escape(name)}">{text}</script>'


def colour_table() -> npt.NDArray[np.uint8]:
    """Return the colour scale of irradiance maps from lowest to highest, (256, 3) uint8: red, green and blue."""
    return np.rint(255 * colormaps["inferno"](np.linspace(0, 1, COLOURS))[:, :3]).astype(np.uint8)


def colour_text() -> str:
    """Return the colour scale of `colour_table`, 768 bytes, as base64."""
    return base64.b64encode(colour_table().tobytes()).decode("ascii")


def palette_png(index: npt.NDArray[np.uint8], palette: npt.NDArray[np.uint8]) -> bytes:
    """
    Return a picture with at most 256 colours as PNG.

    Parameters
    ----------
    index : (H, W) uint8
        Index of the colour of each pixel, the top row first.
    palette : (n, 3) uint8
        Red, green and blue of each colour, 0 … 255.
    """
    picture, buffer = Image.fromarray(index), io.BytesIO()
    picture.putpalette(palette.astype(np.uint8).tobytes())
    picture.save(buffer, "PNG", compress_level=9)
    return buffer.getvalue()


def rounded(lines: Sequence[npt.NDArray[np.float64]], digits: int) -> list[list[float]]:
    """Return polylines, (n, 2) each, as flat lists of their pairs, each number rounded to `digits` decimals."""
    return [np.round(line, digits).ravel().tolist() for line in lines]

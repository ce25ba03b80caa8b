"""Thumbnails of single stray paths for the tables of a report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mistray.analyses.ghosts.maps.path_maps import PathMap
from mistray.files.irradiance_files import Extent
from mistray.toolkit.irradiance import log_range
from mistray.toolkit.pages.embedded import COLOURS, colour_table, palette_png

SIDE = 48  # pixels
DECADES = 4.0
RADII = 3.0  # RMS radii from the middle to the edge
FEWEST_PIXELS = 6  # of the detector from the middle to the edge


@dataclass(frozen=True)
class Thumbnail:
    """
    Square picture of a path about its centroid, on its own log10 scale.

    Attributes
    ----------
    png : bytes
        Picture as PNG.
    width_mm : float
        Width and height of the picture on the detector, mm.
    limits : (float, float) or None
        Floor and top of the scale, powers of ten of W/mm²; None for a dark map.
    """

    png: bytes
    width_mm: float
    limits: tuple[float, float] | None


def thumbnail(
    found: PathMap, extent: Extent, shape: tuple[int, int], centre: tuple[float, float], rms_radius_mm: float
) -> Thumbnail:
    """
    Return a thumbnail of the irradiance of a path about its centroid.

    Parameters
    ----------
    found : PathMap
        Power of the path, W.
    extent : (float, float, float, float)
        x0, x1, y0, y1 of the detector, mm.
    shape : (int, int)
        Numbers of rows and columns of detector pixels.
    centre : (float, float)
        Centroid of the path, mm.
    rms_radius_mm : float
        RMS radius of the path, mm. The picture is six radii wide, but at least twelve pixels of the detector.
    """
    pixel = (extent[1] - extent[0]) / shape[1], (extent[3] - extent[2]) / shape[0]
    half = max(RADII * rms_radius_mm if np.isfinite(rms_radius_mm) else 0.0, FEWEST_PIXELS * max(pixel))
    irradiance = found.power_W / (found.pixels**2 * pixel[0] * pixel[1])
    limits = log_range([irradiance], DECADES)
    index = np.zeros((SIDE, SIDE), dtype=np.uint8)
    if limits is not None:
        steps = half * (2 * (np.arange(SIDE) + 0.5) / SIDE - 1)
        column = np.floor((centre[0] + steps - extent[0]) / (found.pixels * pixel[0])).astype(np.int64) - found.column
        row = np.floor((centre[1] - steps - extent[2]) / (found.pixels * pixel[1])).astype(np.int64) - found.row
        height, width = irradiance.shape
        inside = ((row >= 0) & (row < height))[:, None] & ((column >= 0) & (column < width))
        value = irradiance[np.clip(row, 0, height - 1)[:, None], np.clip(column, 0, width - 1)]
        lit = inside & (value >= 10.0 ** limits[0])
        share = (np.log10(value[lit]) - limits[0]) / (limits[1] - limits[0])
        index[lit] = np.clip(np.rint(share * (COLOURS - 1)), 1, COLOURS - 1).astype(np.uint8)
    palette = colour_table()
    palette[0] = 0  # black: below the floor or no ray
    return Thumbnail(palette_png(index, palette), 2 * half, limits)

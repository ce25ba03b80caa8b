"""
Sky with a radiance that depends on direction, tabulated in cells of uniform radiance.

Cells are drawn by inverting the cumulative flux; within a cell, directions are uniform in solid angle.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.emission_laws import step_of
from mistray.surfaces.upload import upload

LEAST_ROWS, MOST_ROWS, MOST_PARTS = 64, 1024, 4  # cells in polar angle, and points of a cell along either side


class SkyMap:
    """
    Sky whose radiance is tabulated in cells of polar angle and azimuth, for sampling of directions.

    Parameters
    ----------
    radiance : callable
        Radiance (n,), W/mm²/sr, of directions (n, 3) in which the light travels: unit vectors in the frame of the axis.
    rows : int
        Number of cells in polar angle, clipped to `LEAST_ROWS` … `MOST_ROWS`; there are twice as many in azimuth. More
        rows are averaged, up to `MOST_PARTS` within each cell.

    Attributes
    ----------
    irradiance : float
        Integral of the radiance over all directions, ∫ L dΩ, W/mm².
    """

    def __init__(self, radiance: Callable[[np.ndarray], np.ndarray], rows: int) -> None:
        self._rows = count = int(np.clip(rows, LEAST_ROWS, MOST_ROWS))
        self._columns = 2 * count
        # Flux of each cell, from points as close as those of the requested rows: a star must not fall between them
        parts = min(-(-rows // count), MOST_PARTS)
        edges = np.cos(np.arange(count * parts + 1) / (count * parts) * np.pi)
        solid = (edges[:-1] - edges[1:]) * 2 * np.pi / (self._columns * parts)
        flux = np.zeros((count, self._columns))
        for a, b in np.ndindex(parts, parts):
            theta = (np.arange(count) + (a + 0.5) / parts) / count * np.pi
            phi = (np.arange(self._columns) + (b + 0.5) / parts) / self._columns * 2 * np.pi
            (s, c), (sp, cp) = (np.sin(theta), np.cos(theta)), (np.sin(phi), np.cos(phi))
            d = np.stack([np.outer(s, cp), np.outer(s, sp), np.outer(c, np.ones_like(phi))], axis=-1)
            found = np.maximum(radiance(d.reshape(-1, 3)).reshape(count, -1), 0.0)
            flux += found * solid[a::parts, None]
        # And its running sum
        self.irradiance = float(flux.sum())
        ends = np.cumsum(flux) / (self.irradiance or 1.0)
        ends[-1] = 1.0
        self._ends = upload(mi.Float64, np.concatenate([[0.0], ends]))
        self._edges = upload(mi.Float64, edges[::parts])

    def directions(self, sample: mi.Point2d) -> mi.Vector3d:
        """Return unit directions in which light travels, distributed as the radiance, for points of the unit square."""
        cell, part = step_of(self._ends, self._rows * self._columns + 1, sample.x)
        # Uniform in cos θ within the row; the part of the first random number that chose the cell is used again
        row = cell // self._columns
        first, second = (dr.gather(mi.Float64, self._edges, row + step) for step in (0, 1))
        z = dr.fma(part, second - first, first)
        s, c = dr.sincos((mi.Float64(cell % self._columns) + sample.y) * (2 * dr.pi / self._columns))
        across = dr.safe_sqrt(1 - z * z)
        return mi.Vector3d(across * c, across * s, z)


def environment(emitter: mi.Emitter) -> Callable[[np.ndarray], np.ndarray]:
    """
    Return the radiance of Mitsuba's ``envmap`` as a function: its luminance, (n,), W/mm²/sr.

    It takes unit vectors, (n, 3), in the world, along which the light travels.
    """

    def radiance(d: np.ndarray) -> np.ndarray:
        si = dr.zeros(mi.SurfaceInteraction3f, len(d))
        si.wi = mi.Vector3f(*(upload(mi.Float, column) for column in d.T))  # back to where the ray came from
        found = emitter.eval(si)
        return np.array(mi.luminance(found) if mi.is_rgb else found[0], dtype=np.float64).ravel()

    return radiance

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

LEAST_ROWS, MOST_ROWS = 64, 1024  # cells in polar angle
LEAST_PARTS, MOST_PARTS = 2, 4  # of a cell each way, over which its radiance is averaged


class SkyMap:
    """
    Sky whose radiance is tabulated in cells of polar angle and azimuth, for sampling of directions.

    Parameters
    ----------
    radiance : callable
        Radiance (n,), W/mm²/sr, of directions (n, 3) in which the light travels: unit vectors in the frame of the axis.
    rows : int
        Number of cells in polar angle, clipped to `LEAST_ROWS` … `MOST_ROWS`; there are twice as many in azimuth. The
        radiance of a cell is the mean over its parts. There are more of them if more rows are requested, up to
        `MOST_PARTS` each way.

    Attributes
    ----------
    irradiance : float
        Integral of the radiance over all directions, ∫ L dΩ, W/mm².
    """

    def __init__(self, radiance: Callable[[np.ndarray], np.ndarray], rows: int) -> None:
        self._rows = int(np.clip(rows, LEAST_ROWS, MOST_ROWS))
        self._columns = 2 * self._rows
        # Flux of each cell, from directions in parts of it that are small enough for the picture
        parts = min(max(-(-rows // self._rows), LEAST_PARTS), MOST_PARTS)
        fine = np.cos(np.arange(self._rows * parts + 1) / (self._rows * parts) * np.pi)
        solid = (fine[:-1] - fine[1:]) * 2 * np.pi / (self._columns * parts)
        flux = np.zeros((self._rows, self._columns))
        for k in range(parts):
            theta = (np.arange(self._rows) + (k + 0.5) / parts) / self._rows * np.pi
            for j in range(parts):
                phi = (np.arange(self._columns) + (j + 0.5) / parts) / self._columns * 2 * np.pi
                (s, c), (sp, cp) = (np.sin(theta), np.cos(theta)), (np.sin(phi), np.cos(phi))
                d = np.stack([np.outer(s, cp), np.outer(s, sp), np.outer(c, np.ones_like(phi))], axis=-1)
                flux += np.maximum(radiance(d.reshape(-1, 3)).reshape(flux.shape), 0.0) * solid[k::parts, None]
        self.irradiance = float(flux.sum())
        ends = np.cumsum(flux) / (self.irradiance or 1.0)
        ends[-1] = 1.0
        self._ends = upload(mi.Float64, np.concatenate([[0.0], ends]))
        self._edges = upload(mi.Float64, fine[::parts])

    def directions(self, sample: mi.Point2d) -> mi.Vector3d:
        """Return unit directions in which light travels, distributed as the radiance, for points of the unit square."""
        # Late digits of the other number go on where a random float32 ends: a sky beside a sun has few of its steps
        more = sample.y * 2.0**10
        u = dr.fma(more - dr.floor(more), 2.0**-23, sample.x)
        cell, part = step_of(self._ends, self._rows * self._columns + 1, u)
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

"""Effects of a detector on contrast: the aperture of its pixels, diffusion of charge, a measured table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.ranges import NOT_NEGATIVE, RADIUS_MM

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PixelResponse:
    """
    Transfer function of a detector: the product of what is given.

    Attributes
    ----------
    pixel_mm : float or (float, float)
        Sides of the area of a pixel that takes light, along x and y of the detector, mm:
        ``sinc(p_x ν_x) sinc(p_y ν_y)``, sinc t = sin πt/(πt). 0: points.
    diffusion_mm : float
        Standard deviation σ of the Gaussian that charge spreads over, mm: ``exp(-2π² σ² ν²)``.
    table : ((m,) 1/mm, (m,) float), optional
        Frequencies, ascending from 0, and a measured transfer function, the same in all directions, linear between
        them.

    Raises
    ------
    MistrayError
        For numbers out of range, or a table that does not ascend from 0, or that does not begin at 1.
    """

    pixel_mm: float | tuple[float, ...] = 0.0
    diffusion_mm: float = 0.0
    table: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        sides = np.atleast_1d(np.asarray(self.pixel_mm, dtype=np.float64))
        if sides.shape not in ((1,), (2,)):
            raise MistrayError(f"pixel_mm has {sides.size} numbers; give the side of a square pixel, or both sides")
        for side in sides:
            RADIUS_MM.check("pixel_mm", float(side), "detector")
        RADIUS_MM.check("diffusion_mm", self.diffusion_mm, "detector")
        if self.table is None:
            return
        f, values = (np.asarray(column, dtype=np.float64) for column in self.table)
        if f.ndim != 1 or f.shape != values.shape or len(f) < 2:
            raise MistrayError(
                f"detector table: {f.size} frequencies and {values.size} values; give two or more of each"
            )
        NOT_NEGATIVE.check_each("frequency of the table", f.tolist(), "detector")
        if f[0] != 0 or not np.all(np.diff(f) > 0) or not np.all(np.isfinite(values)):
            raise MistrayError("detector table: give finite values at frequencies that ascend from 0, in 1/mm")
        if abs(values[0] - 1) > 1e-3:
            raise MistrayError(f"detector table: it begins at {values[0]:g}; divide it by that, so that it begins at 1")

    def at(self, nu_x: npt.ArrayLike, nu_y: npt.ArrayLike) -> Array:
        """
        Its values at frequencies along x and y of the detector, 1/mm.

        Raises
        ------
        MistrayError
            Beyond the end of the table.
        """
        x, y = np.broadcast_arrays(np.asarray(nu_x, dtype=np.float64), np.asarray(nu_y, dtype=np.float64))
        width, height = np.broadcast_to(np.asarray(self.pixel_mm, dtype=np.float64), 2)
        square = x * x + y * y
        found = np.sinc(width * x) * np.sinc(height * y) * np.exp(-2 * np.pi**2 * self.diffusion_mm**2 * square)
        if self.table is None:
            return np.asarray(found)
        f, values = (np.asarray(column, dtype=np.float64) for column in self.table)
        nu = np.sqrt(square)
        if np.any(nu > f[-1] * (1 + 1e-9)):
            raise MistrayError(
                f"detector table: it ends at {f[-1]:g} per mm, and {nu.max():.4g} per mm is asked for; continue it, or "
                "give frequencies_per_mm"
            )
        return np.asarray(found * np.interp(nu, f, values))

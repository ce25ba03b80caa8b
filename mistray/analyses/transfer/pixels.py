"""Effects of a detector on contrast: pixel aperture, charge diffusion, measured transfer function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.ranges import NOT_NEGATIVE, POSITIVE, RADIUS_MM

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PixelResponse:
    """
    Transfer function of a detector: product of pixel aperture, charge diffusion and a measured table.

    Attributes
    ----------
    pixel_mm : float or (float, float)
        Sides of the light-sensitive area of a pixel, along x and y of the detector, mm:
        ``sinc(p_x ν_x) sinc(p_y ν_y)``, sinc t = sin πt/(πt). 0: points.
    diffusion_mm : float
        Standard deviation σ of the Gaussian that charge spreads over, mm: ``exp(-2π² σ² ν²)``.
    table : ((m,) 1/mm, (m,) float), optional
        Frequencies, ascending from 0, and a measured transfer function, equal in all directions, linear between
        them.

    Raises
    ------
    MistrayError
        If a value is out of range, or the table does not ascend from 0 or does not begin at 1.
    """

    pixel_mm: float | tuple[float, float] = 0.0
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
        Return the transfer function at frequencies along x and y of the detector, 1/mm, in their shape.

        Raises
        ------
        MistrayError
            If a frequency is beyond the end of the table.
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


def pixel_response(
    pixel_mm: float | tuple[float, float] | None, diffusion_mm: float | None, table: tuple | None
) -> PixelResponse | None:
    """Return the response of a detector from pixel and diffusion (mm) and table, or None if none is given."""
    if pixel_mm is None and diffusion_mm is None and table is None:
        return None
    if pixel_mm is not None:
        for side in np.atleast_1d(np.asarray(pixel_mm, dtype=np.float64)):
            POSITIVE.check("pixel_mm", float(side), "detector")
    sides = pixel_mm if pixel_mm is None or isinstance(pixel_mm, int | float) else tuple(float(v) for v in pixel_mm)
    columns = None if table is None else tuple(tuple(float(v) for v in column) for column in table)
    return PixelResponse(sides or 0.0, diffusion_mm or 0.0, columns)  # type: ignore[arg-type]

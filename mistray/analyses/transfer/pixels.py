"""Transfer function of a detector: pixel aperture, charge diffusion, and a measured curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.analyses.transfer.request import Curve
from mistray.errors import MistrayError
from mistray.ranges import RADIUS_MM, Each
from mistray.toolkit.fields import Request, field

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PixelResponse(Request):
    """
    Transfer function of a detector: product of pixel aperture, charge diffusion and, if given, a measured curve.

    `pixel_mm` and `diffusion_mm` are lengths, mm: 0 means pixels that are points, and no diffusion. The frequencies of
    `table` are in 1/mm.
    """

    pixel_mm: float | tuple[float, ...] = field(
        Each(RADIUS_MM),
        0.0,
        "sides of the area of a pixel that takes light, along x and y of the detector, mm: "
        "``sinc(p_x ν_x) sinc(p_y ν_y)``, sinc t = sin πt/(πt); 0: points",
    )
    diffusion_mm: float = field(
        RADIUS_MM, 0.0, "standard deviation σ of the Gaussian that charge spreads over, mm: ``exp(-2π² σ² ν²)``"
    )
    table: tuple[tuple[float, ...], tuple[float, ...]] | None = field(
        Curve(),
        None,
        "frequencies, 1/mm, ascending from 0, and a measured transfer function that begins at 1, the same in all "
        "directions, linear between them",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.size(self.pixel_mm) > 2:
            raise MistrayError(
                f"pixel_mm has {np.size(self.pixel_mm)} numbers; give the side of a square pixel, or both sides"
            )
        if self.table is None:
            return
        f, values = (np.asarray(column, dtype=np.float64) for column in self.table)
        if len(f) != len(values) or len(f) < 2:
            raise MistrayError(
                f"detector table: {f.size} frequencies and {values.size} values; give two or more of each"
            )
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

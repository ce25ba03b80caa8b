"""Arguments of a PST as one checked object, passed from the call to the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import PIXELS_OR_NONE, RELATIVE_ERROR
from mistray.recorders.directions import DirectionGrid
from mistray.settings import Settings

METHODS = ("joined", "adjoint", "forward")
RAYS = {
    "joined": 4_000_000,
    "adjoint": 4_000_000,
    "forward": 200_000,
}  # default; forward: at each angle
MOST_RAYS = 2_000_000_000  # limit of a call that requests an error and sets no limit of rays

Numbers = float | Sequence[float] | np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class PstRequest:
    """
    Checked arguments of a PST; `mistray.pst` documents each value.

    Attributes
    ----------
    settings : mapping
        Fields of `mistray.trace.Settings` that are given, except for the rays.

    Raises
    ------
    MistrayError
        For values that are out of range or do not go together.
    """

    field_deg: Numbers = range(0, 81, 2)
    method: str = "joined"
    convention: str = "normal"
    azimuths_deg: Numbers | None = None
    cell_deg: float | None = None
    azimuth_cell_deg: float | None = None
    wavelength_nm: float | Sequence[float] | None = None
    weights: Sequence[float] | None = None
    detector: str | None = None
    rays: int | None = None
    relative_error: float | None = None
    error_up_to_deg: float | None = None
    paths: bool = True
    map_pixels: int = 0
    state: str | Path | None = None
    resume: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, **arguments: Any) -> PstRequest:
        """Return a request with the arguments of `mistray.pst`; those that are no field of it are settings."""
        own = {f.name for f in fields(cls)} - {"settings"}
        settings = {key: value for key, value in arguments.items() if key not in own}
        return cls(settings=settings, **{key: value for key, value in arguments.items() if key in own})

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise MistrayError(f"method is '{self.method}'; use 'joined', 'adjoint' or 'forward'")
        if self.relative_error is not None:
            RELATIVE_ERROR.check("relative_error", self.relative_error)
            # The pilot needs both directions
            if self.method == "adjoint":
                raise MistrayError(
                    "relative_error is given with method 'adjoint', which has no pilot that says how many rays "
                    "it takes; use 'joined', or give rays"
                )
        PIXELS_OR_NONE.check("map_pixels", self.map_pixels)
        if self.resume and self.state is None:
            raise MistrayError("resume needs the file of the state; give state=…")
        # A state holds the sums of a trace from the detector
        if self.method == "forward" and self.state is not None:
            raise MistrayError("state is given with method 'forward'; only a run from the detector can be continued")
        if self.method == "forward" and self.error_up_to_deg is not None and self.relative_error is None:
            raise MistrayError(
                "error_up_to_deg is given without relative_error; give the relative error that is requested"
            )

    @property
    def light(self) -> Light:
        """Light of the PST: wavelengths, nm, their fractions of the flux, and the detector."""
        return Light(wavelength_nm=self.wavelength_nm, weights=self.weights, detector=self.detector)

    def grid(self, axes: np.ndarray) -> DirectionGrid:
        """Return the cells of field angle and azimuth, measured in a frame whose axes are the columns of `axes`."""
        grid = DirectionGrid.of(self.field_deg, self.azimuths_deg, self.cell_deg, self.azimuth_cell_deg, axes)
        if not cells_up_to(grid, self.error_up_to_deg).any():
            raise MistrayError(f"error_up_to_deg is {self.error_up_to_deg:g}; no angle is as small as that")
        return grid

    def settings_for(self, scene: mi.Scene) -> Settings:
        """Return the settings of the traces of a scene: number of start rays, limits of paths, thresholds and seed."""
        usual = RAYS[self.method] if self.relative_error is None else MOST_RAYS
        return Settings.without_sources(scene, "a PST", rays=usual if self.rays is None else self.rays, **self.settings)


def cells_up_to(grid: DirectionGrid, last_deg: float | None) -> np.ndarray:
    """Return a mask of the cells up to a field angle, degrees, (n, m) bool; None: all cells."""
    return np.broadcast_to(grid.field_deg[:, None] <= (90.0 if last_deg is None else last_deg), grid.shape)

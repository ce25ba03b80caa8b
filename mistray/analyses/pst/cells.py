"""Cells of field angle and azimuth over which a PST request averages, and those whose error counts."""

from __future__ import annotations

import numpy as np

from mistray.analyses.pst.request import PstRequest
from mistray.errors import MistrayError
from mistray.recorders.directions import DirectionGrid


def grid_of(request: PstRequest, axes: np.ndarray | None = None) -> DirectionGrid:
    """
    Return the cells of field angle and azimuth of a request; columns of `axes`, (3, 3), are the axes of their frame.

    Without `axes` they are those of the world.

    Raises
    ------
    MistrayError
        If no angle is within the limit up to which an error is requested.
    """
    grid = DirectionGrid.of(request.field_deg, request.azimuths_deg, request.cell_deg, request.azimuth_cell_deg, axes)
    if not cells_up_to(grid, request.error_up_to_deg).any():
        raise MistrayError(f"error_up_to_deg is {request.error_up_to_deg:g}; no angle is as small as that")
    return grid


def cells_up_to(grid: DirectionGrid, last_deg: float | None) -> np.ndarray:
    """Return a mask, (n, m) bool, of the cells up to a field angle, degrees; None marks all cells."""
    return np.broadcast_to(grid.field_deg[:, None] <= (90.0 if last_deg is None else last_deg), grid.shape)

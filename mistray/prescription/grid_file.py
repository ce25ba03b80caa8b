"""Sags on grids and the files that they lie in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mistray.errors import MistrayError
from mistray.files.sag_grid import SUFFIX, read_sag_grid, sag_grid_bytes
from mistray.physics.sags.grid import Grid
from mistray.replace_file import replace_file


def read_grid(path: str | Path) -> Grid:
    """
    Read a sag on a grid.

    Parameters
    ----------
    path : str or Path
        See `mistray.files.sag_grid.read_sag_grid`. Slopes and twists that are all 0, or left out, are those of splines.

    Returns
    -------
    Grid

    Raises
    ------
    MistrayError
        If it cannot be read, a number in it is none, or it has too few points.
    """
    return Grid.of_values(*read_sag_grid(path), str(path))


def save_grid(grid: Grid, path: str | Path) -> Grid:
    """
    Write a sag on a grid to a file ``.npz``.

    Parameters
    ----------
    grid : Grid
    path : str or Path

    Returns
    -------
    Grid
        The same, which knows its file, so that scene files can refer to it.

    Raises
    ------
    MistrayError
        If the name ends in something else, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise MistrayError(f"grid '{path}': grids are written as {SUFFIX}; name it so")
    replace_file(path, grid_bytes(grid), "grid")
    return replace(grid, path=str(path))


def grid_bytes(grid: Grid) -> bytes:
    """The content of the file of a grid."""
    return sag_grid_bytes(grid.corners, grid.step, grid.middle, grid.gone)

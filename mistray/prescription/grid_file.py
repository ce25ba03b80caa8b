"""Reading and writing of files with sags on grids."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mistray.errors import MistrayError
from mistray.files.sag_grid import SUFFIX, read_sag_grid, sag_grid_bytes
from mistray.physics.sags.grid import Grid
from mistray.replace_file import replace_file


def read_grid(path: str | Path) -> Grid:
    """
    Read a sag on a grid from a file.

    Parameters
    ----------
    path : str or Path
        File, see `mistray.files.sag_grid.read_sag_grid`. Slopes and twists that are missing or all 0 are computed from
        splines.

    Returns
    -------
    Grid
        Sags in mm.

    Raises
    ------
    MistrayError
        If the file cannot be read, holds an invalid value, or has too few points.

    Examples
    --------
    >>> heights = 1e-4 * np.add.outer(np.linspace(-5, 5, 11) ** 2, np.linspace(-5, 5, 11) ** 2)
    >>> _ = mistray.prescription.save_grid(mistray.prescription.Grid.of(heights, (1.0, 1.0)), "error.npz")
    >>> mistray.prescription.read_grid("error.npz").step
    (1.0, 1.0)
    """
    return Grid.of_values(*read_sag_grid(path), str(path))


def save_grid(grid: Grid, path: str | Path) -> Grid:
    """
    Write a sag on a grid to a ``.npz`` file.

    Parameters
    ----------
    grid : Grid
        Grid to write.
    path : str or Path
        File to write, ending in ``.npz``.

    Returns
    -------
    Grid
        Copy of the grid that stores its path, so that scene files can refer to it.

    Raises
    ------
    MistrayError
        If the name has another ending, or the file cannot be written.

    Examples
    --------
    >>> heights = 1e-4 * np.add.outer(np.linspace(-5, 5, 11) ** 2, np.linspace(-5, 5, 11) ** 2)
    >>> grid = mistray.prescription.save_grid(mistray.prescription.Grid.of(heights, (1.0, 1.0)), "error.npz")
    >>> mirror = mistray.Surface("mirror", radius=-200, semi_diameter=5, mirror=True, sag={"grid": grid})
    >>> mirror.sag["grid"].path
    'error.npz'
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise MistrayError(f"grid '{path}': grids are written as {SUFFIX}; name it so")
    replace_file(path, grid_bytes(grid), "grid")
    return replace(grid, path=str(path))


def grid_bytes(grid: Grid) -> bytes:
    """Return the content of the ``.npz`` file for a grid."""
    return sag_grid_bytes(grid.corners, grid.step, grid.middle, grid.gone)

"""Sag on a rectangular grid, such as a measured figure error, joined by bicubic patches.

In each cell the sag is the bicubic polynomial with the heights, slopes and twists (∂²z/∂x∂y) of its four corners
(Hermite's form; J. Ferguson, "Multivariable curve interpolation", J. ACM 11, 221 (1964)). So heights and slopes are
continuous. If a grid gives heights alone, slopes and twists are those of cubic splines through them (not-a-knot). Then
curvatures are continuous as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mistray.errors import MistrayError, errors_of
from mistray.ranges import PLACE_MM, SIZE_MM, Each

STEP_MM, MIDDLE_MM = Each(SIZE_MM, 2), Each(PLACE_MM, 2)
LEAST = 4  # points in each direction, for a cubic spline
MOST = 4096
BEYOND = 1.25  # factor by which slopes between the points may exceed those at the points


@dataclass(frozen=True, eq=False)
class Grid:
    """
    Sag given by its values at the points of a grid.

    Attributes
    ----------
    corners : (ny, nx, 4) float64
        Height, mm, slopes in x and y, and twist, 1/mm, at each point; rows by ascending y.
    step : (2,) float
        Spacing of the points in x and y, mm.
    middle : (2,) float
        Middle of the grid in its own frame, mm.
    missing : (ny, nx) bool, optional
        Points without a measured height; None: there are none. `of` gives them the height of the nearest other point.
    path : str
        Path of the file, to which a scene file refers; "" for none.

    Examples
    --------
    >>> heights = 1e-4 * np.add.outer(np.linspace(-5, 5, 11) ** 2, np.linspace(-5, 5, 11) ** 2)
    >>> figure_error = mistray.prescription.Grid.of(heights, (1.0, 1.0))
    >>> figure_error.half
    (5.0, 5.0)
    """

    corners: np.ndarray
    step: tuple[float, float]
    middle: tuple[float, float] = (0.0, 0.0)
    missing: np.ndarray | None = None
    path: str = ""

    @classmethod
    def of(
        cls, heights: Any, step: tuple[float, float], middle: tuple[float, float] = (0.0, 0.0), missing: Any = None
    ) -> Grid:
        """
        Return a sag grid from heights, joined by splines.

        Parameters
        ----------
        heights : (ny, nx) array_like
            Heights, mm; rows by ascending y, columns by ascending x.
        step : (2,) float
            Spacing of the points in x and y, mm.
        middle : (2,) float
            Middle of the grid, mm.
        missing : (ny, nx) array_like of bool, optional
            Points without a measured height.

        Raises
        ------
        MistrayError
            If a height is not finite, all are missing, there are fewer than 4 or more than 4096 points each way, or a
            step is not above 0.
        """
        from scipy.interpolate import CubicSpline

        dx, dy = STEP_MM.check("step", step)
        mx, my = MIDDLE_MM.check("middle", middle)
        z = np.array(heights, dtype=np.float64)
        gone = np.zeros(z.shape, dtype=bool) if missing is None else np.array(missing, dtype=bool)
        _check(z, (dx, dy), gone)
        z = _filled(z, gone)
        ny, nx = z.shape
        x, y = dx * np.arange(nx), dy * np.arange(ny)
        by_x = CubicSpline(x, z, axis=1)(x, 1)
        by_y = CubicSpline(y, z, axis=0)(y, 1)
        twist = CubicSpline(y, by_x, axis=0)(y, 1)
        return cls(np.stack([z, by_x, by_y, twist], axis=-1), (dx, dy), (mx, my), gone)

    @classmethod
    def of_values(
        cls, values: np.ndarray, step: tuple[float, float], middle: tuple[float, float], missing: np.ndarray, path: str
    ) -> Grid:
        """
        Return a sag grid from the values in its file.

        Parameters
        ----------
        values : (ny, nx, 1) or (ny, nx, 4) float64
            Heights, mm, which splines join; or all values of `corners`, which are used as they are.
        step, middle, missing, path
            Attributes of the class.

        Raises
        ------
        MistrayError
            For the reasons of `of`; the message names the file.
        """
        with errors_of(f"grid '{path}'"):
            if values.shape[2] == 1:
                return replace(cls.of(values[..., 0], step, middle, missing), path=path)
            _check(values, step, missing)
        return cls(values, step, middle, missing, path)

    # ---- facts

    @property
    def gone(self) -> np.ndarray:
        """Mask of the grid points without a measured height, (ny, nx) bool."""
        return np.zeros(self.corners.shape[:2], dtype=bool) if self.missing is None else self.missing

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height of the grid, mm."""
        ny, nx = self.corners.shape[:2]
        return 0.5 * (nx - 1) * self.step[0], 0.5 * (ny - 1) * self.step[1]

    @cached_property
    def steepest(self) -> float:
        """Estimated upper bound of the slope of the sag, mm/mm: 1.25 times the steepest at and between points."""
        dx, dy = self.step
        z = self.corners[..., 0]
        x, y = np.abs(self.corners[..., 1]), np.abs(self.corners[..., 2])
        across = max(float(x.max()), float(np.abs(np.diff(z, axis=1)).max()) / dx)
        along = max(float(y.max()), float(np.abs(np.diff(z, axis=0)).max()) / dy)
        return BEYOND * math.hypot(across, along)

    def half_turned(self) -> Grid:
        """Return the same grid as seen in a frame turned by 180° about y, which reverses x and z; it has no path."""
        turned = self.corners[:, ::-1] * (-1.0, 1.0, -1.0, 1.0)
        return Grid(turned, self.step, (-self.middle[0], self.middle[1]), self.gone[:, ::-1])

    def lacks(self, x: np.ndarray, y: np.ndarray) -> str:
        """Return the reason why the grid does not cover all points x, y, (n,), mm, of its frame; "" if it does."""
        (cx, cy), (hx, hy) = self.middle, self.half
        slack = 1 + 1e-9
        if np.any(np.abs(x - cx) > hx * slack) or np.any(np.abs(y - cy) > hy * slack):
            return f"it reaches {cx - hx:g} to {cx + hx:g} mm in x and {cy - hy:g} to {cy + hy:g} mm in y only"
        missing = self.gone
        if missing.any():
            _, _, i, j = self._cells(x, y)
            gone = missing[j, i] | missing[j, i + 1] | missing[j + 1, i] | missing[j + 1, i + 1]
            if np.any(gone):
                k = int(np.argmax(gone))
                return f"it has no height near x = {x[k]:.6g}, y = {y[k]:.6g} mm"
        return ""

    # ---- values

    def _cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """
        Return points x, y, mm, in steps from the grid's corner of least x and y, and column and row of their cell.

        All have the points' shape. The cell of a point outside the grid is the nearest.
        """
        ny, nx = self.corners.shape[:2]
        u = (x - self.middle[0] + self.half[0]) / self.step[0]
        v = (y - self.middle[1] + self.half[1]) / self.step[1]
        i, j = (np.clip(np.nan_to_num(np.floor(w)), 0, n - 2).astype(np.int64) for w, n in ((u, nx), (v, ny)))
        return u, v, i, j

    def evaluate(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """
        Return height, mm, and slopes in x and y at points of the grid's frame, mm, each in their shape.

        Outside the grid its outermost cells continue.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        u, v, i, j = self._cells(x, y)
        at = [[np.moveaxis(self.corners[j + b, i + a], -1, 0) for a in (0, 1)] for b in (0, 1)]
        return patch(u - i, v - j, at, self.step)


def patch(s: Any, t: Any, at: Any, step: tuple[float, float]) -> tuple[Any, Any, Any]:
    """
    Return the height, mm, and slopes in x and y of Hermite's bicubic patch, for arrays of NumPy or Dr.Jit.

    Parameters
    ----------
    s, t : array
        Position in a cell in x and y, 0 … 1.
    at : [[(4,), (4,)], [(4,), (4,)]] of arrays
        Values of `Grid.corners` at the cell's corners, indexed by y, then by x.
    step : (2,) float
        Spacing of the points in x and y, mm.
    """
    dx, dy = step
    (a0, a1, b0, b1), (da0, da1, db0, db1) = _hermite(s)
    (c0, c1, d0, d1), (dc0, dc1, dd0, dd1) = _hermite(t)

    def row(b: int, w0: Any, w1: Any, v0: Any, v1: Any) -> tuple[Any, Any]:
        """
        Return height, and slope in y times the step, both in mm, along one side (0 lower, 1 upper) of the cell.

        The weights are those of `_hermite` for values and slopes. With their derivatives the result is differentiated
        with respect to s.
        """
        (z0, x0, y0, xy0), (z1, x1, y1, xy1) = at[b]
        height = w0 * z0 + w1 * z1 + (v0 * x0 + v1 * x1) * dx
        slope = w0 * y0 + w1 * y1 + (v0 * xy0 + v1 * xy1) * dx
        return height, slope * dy

    low, low_y = row(0, a0, a1, b0, b1)
    high, high_y = row(1, a0, a1, b0, b1)
    low_x, low_xy = row(0, da0, da1, db0, db1)
    high_x, high_xy = row(1, da0, da1, db0, db1)
    z = c0 * low + c1 * high + d0 * low_y + d1 * high_y
    across = (c0 * low_x + c1 * high_x + d0 * low_xy + d1 * high_xy) / dx
    along = (dc0 * low + dc1 * high + dd0 * low_y + dd1 * high_y) / dy
    return z, across, along


def _hermite(s: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return Hermite's weights at s, 0 … 1, of values and slopes at both ends, and the derivatives of these weights."""
    s2 = s * s
    s3 = s2 * s
    high = 3 * s2 - 2 * s3
    steep = 6 * (s - s2)
    return (1 - high, high, s3 - 2 * s2 + s, s3 - s2), (-steep, steep, 3 * s2 - 4 * s + 1, 3 * s2 - 2 * s)


def _check(z: np.ndarray, step: tuple[float, float], missing: np.ndarray) -> None:
    """Raise `MistrayError` if heights or corners, as in `Grid`, steps, mm, and missing points make no valid grid."""
    if z.ndim < 2 or min(z.shape[:2]) < LEAST or max(z.shape[:2]) > MOST:
        shape = " by ".join(map(str, z.shape[1::-1]))
        raise MistrayError(f"{shape} points; it needs {LEAST} to {MOST} each way")
    if not (0 < step[0] < math.inf and 0 < step[1] < math.inf):
        raise MistrayError(f"steps of {step[0]:g} and {step[1]:g} mm; both must be greater than 0")
    bad = ~np.isfinite(z)
    bad = (bad.any(axis=-1) if z.ndim == 3 else bad) & ~missing
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise MistrayError(
            f"the number at column {column + 1}, row {row + 1} (by growing y) is not finite; mark the point as missing"
        )


def _filled(z: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """
    Return heights, (ny, nx) in mm, with missing ones replaced by those of the nearest points.

    Raise `MistrayError` if all are missing.
    """
    if not missing.any():
        return z
    if missing.all():
        raise MistrayError("it has no height at all; give some")
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(z[rows, columns])

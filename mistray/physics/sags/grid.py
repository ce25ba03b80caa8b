"""A sag on a rectangular grid, as a measured figure error, joined by bicubic patches.

In each cell the sag is the bicubic polynomial that has the heights, slopes and twists (∂²z/∂x∂y) of its four corners
(Hermite's form; J. Ferguson, "Multivariable curve interpolation", J. ACM 11, 221 (1964)), so that heights and slopes
are continuous. Where a grid gives heights alone, the rest is that of cubic splines through them (not-a-knot), with
which curvatures are continuous as well.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from mistray.errors import MistrayError
from mistray.read_file import read_file, require_file
from mistray.replace_file import replace_file

LEAST = 4  # points each way, of a cubic spline
MOST = 4096
UNITS_MM = (1.0, 10.0, 25.4, 1000.0)  # by the unit flag of a text file
BEYOND = 1.25  # by which slopes between the points may exceed those at them
SUFFIX = ".npz"


@dataclass(frozen=True, eq=False)
class Grid:
    """
    A sag by its values at the points of a grid.

    Attributes
    ----------
    corners : (ny, nx, 4) float64
        Height (mm), slopes in x and y, twist (1/mm) at each point; rows by growing y.
    step : (2,) float
        Between points in x and y, mm.
    middle : (2,) float
        Of the grid, mm.
    missing : (ny, nx) bool, optional
        Points without a height; the nearest one stands in for it.
    path : str
        File that it lies in; "" of none. A scene file refers to it.
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
        A grid of heights, joined by splines.

        Parameters
        ----------
        heights : (ny, nx) array_like
            mm; rows by growing y, columns by growing x.
        step : (2,) float
            Between points in x and y, mm.
        middle : (2,) float
            Of the grid, mm.
        missing : (ny, nx) array_like of bool, optional
            Points without a height.

        Raises
        ------
        MistrayError
            If heights are not finite, there are too few points, or a step is not above 0.
        """
        from scipy.interpolate import CubicSpline

        z = np.array(heights, dtype=np.float64)
        gone = np.zeros(z.shape, dtype=bool) if missing is None else np.array(missing, dtype=bool)
        _check(z, step, gone)
        z = _filled(z, gone)
        ny, nx = z.shape
        x, y = step[0] * np.arange(nx), step[1] * np.arange(ny)
        by_x = CubicSpline(x, z, axis=1)(x, 1)
        by_y = CubicSpline(y, z, axis=0)(y, 1)
        twist = CubicSpline(y, by_x, axis=0)(y, 1)
        return cls(np.stack([z, by_x, by_y, twist], axis=-1), (float(step[0]), float(step[1])), middle, gone)

    @classmethod
    def read(cls, path: str | Path) -> Grid:
        """
        Read a grid.

        Parameters
        ----------
        path : str or Path
            ``.npz`` as of `save`, or text as OpticStudio reads it for a Grid Sag surface: a line ``nx ny dx dy unit
            x y`` (unit 0 mm, 1 cm, 2 inch, 3 m), then for each point height, slopes in x and y, twist and 1 where there
            is no height, from the greatest y and the least x on, x growing first. Slopes and twists that are all 0, or
            left out, are those of splines.

        Raises
        ------
        MistrayError
            If it cannot be read or a number in it is none.
        """
        path = Path(path)
        require_file(path, "grid")
        try:
            found = cls._from_archive(path) if path.suffix == SUFFIX else cls._from_text(path)
        except MistrayError as error:
            raise MistrayError(f"grid '{path}': {error}") from None
        return replace(found, path=str(path))

    @classmethod
    def _from_archive(cls, path: Path) -> Grid:
        try:
            with np.load(path, allow_pickle=False) as data:
                corners, step, middle, missing = (data[key] for key in ("corners", "step", "middle", "missing"))
        except (OSError, ValueError, KeyError) as error:
            raise MistrayError(f"it is no grid that mistray wrote ({error}); make it again") from None
        if corners.ndim != 3 or corners.shape[2] != 4 or missing.shape != corners.shape[:2]:
            raise MistrayError("its arrays do not go together; make it again")
        _check(corners, (float(step[0]), float(step[1])), missing)
        return cls(corners, (float(step[0]), float(step[1])), (float(middle[0]), float(middle[1])), missing)

    @classmethod
    def _from_text(cls, path: Path) -> Grid:
        lines = [
            (k, line.split())
            for k, line in enumerate(read_file(path, "grid").decode("latin-1").splitlines(), 1)
            if line.strip() and line.lstrip()[0] != "!"
        ]
        if not lines:
            raise MistrayError("it is empty; give a first line 'nx ny dx dy unit x y'")
        head = _numbers(*lines[0])
        if len(head) < 4 or not all(value.is_integer() for value in (*head[:2], *head[4:5])):
            raise MistrayError(f"line {lines[0][0]} is no 'nx ny dx dy unit x y'")
        nx, ny = int(head[0]), int(head[1])
        unit = int(head[4]) if len(head) > 4 else 0
        if not 0 <= unit < len(UNITS_MM):
            raise MistrayError(f"unit {unit}; it is 0 (mm), 1 (cm), 2 (inch) or 3 (m)")
        if len(lines) - 1 != nx * ny:
            raise MistrayError(f"{len(lines) - 1} points for {nx} by {ny}; complete it")
        rows = np.zeros((nx * ny, 5))
        for place, (number, words) in enumerate(lines[1:]):
            values = _numbers(number, words)
            rows[place, : len(values[:5])] = values[:5]
        table = rows.reshape(ny, nx, 5)[::-1]
        mm = UNITS_MM[unit]
        step = abs(head[2]) * mm, abs(head[3]) * mm
        middle = (head[5] * mm if len(head) > 5 else 0.0, head[6] * mm if len(head) > 6 else 0.0)
        missing = table[..., 4] != 0
        if not table[..., 1:4].any():
            return cls.of(table[..., 0] * mm, step, middle, missing)
        corners = table[..., :4] * (mm, 1.0, 1.0, 1 / mm)
        _check(corners, step, missing)
        return cls(corners, step, middle, missing)

    def save(self, path: str | Path) -> Grid:
        """
        Write it to a file ``.npz``.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Grid
            The same, which knows its file.
        """
        path = Path(path)
        if path.suffix != SUFFIX:
            raise MistrayError(f"grid '{path}': grids are written as {SUFFIX}; name it so")
        replace_file(path, self.archive(), "grid")
        return replace(self, path=str(path))

    def archive(self) -> bytes:
        """The content of its file."""
        content = io.BytesIO()
        step, middle = np.array(self.step), np.array(self.middle)
        np.savez_compressed(content, corners=self.corners, step=step, middle=middle, missing=self._missing)
        return content.getvalue()

    # ---- facts

    @property
    def _missing(self) -> np.ndarray:
        return np.zeros(self.corners.shape[:2], dtype=bool) if self.missing is None else self.missing

    @property
    def half(self) -> tuple[float, float]:
        """Half sizes, mm."""
        ny, nx = self.corners.shape[:2]
        return 0.5 * (nx - 1) * self.step[0], 0.5 * (ny - 1) * self.step[1]

    @cached_property
    def steepest(self) -> float:
        """No part of it is steeper."""
        dx, dy = self.step
        z = self.corners[..., 0]
        x, y = np.abs(self.corners[..., 1]), np.abs(self.corners[..., 2])
        across = max(float(x.max()), float(np.abs(np.diff(z, axis=1)).max()) / dx)
        along = max(float(y.max()), float(np.abs(np.diff(z, axis=0)).max()) / dy)
        return BEYOND * math.hypot(across, along)

    def half_turned(self) -> Grid:
        """The same surface after half a turn of its frame about y, which reverses x and z."""
        turned = self.corners[:, ::-1] * (-1.0, 1.0, -1.0, 1.0)
        return Grid(turned, self.step, (-self.middle[0], self.middle[1]), self._missing[:, ::-1])

    def lacks(self, x: np.ndarray, y: np.ndarray) -> str:
        """Why it does not reach all of some points of its frame (mm); "" if it does."""
        (cx, cy), (hx, hy) = self.middle, self.half
        slack = 1 + 1e-9
        if np.any(np.abs(x - cx) > hx * slack) or np.any(np.abs(y - cy) > hy * slack):
            return f"it reaches {cx - hx:g} to {cx + hx:g} mm in x and {cy - hy:g} to {cy + hy:g} mm in y only"
        missing = self._missing
        if missing.any():
            _, _, i, j = self._cells(x, y)
            gone = missing[j, i] | missing[j, i + 1] | missing[j + 1, i] | missing[j + 1, i + 1]
            if np.any(gone):
                k = int(np.argmax(gone))
                return f"it has no height near x = {x[k]:.6g}, y = {y[k]:.6g} mm"
        return ""

    # ---- values

    def _cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Places in units of steps from the first point, and the numbers of their cells."""
        ny, nx = self.corners.shape[:2]
        u = (x - self.middle[0] + self.half[0]) / self.step[0]
        v = (y - self.middle[1] + self.half[1]) / self.step[1]
        i, j = (np.clip(np.nan_to_num(np.floor(w)), 0, n - 2).astype(np.int64) for w, n in ((u, nx), (v, ny)))
        return u, v, i, j

    def evaluate(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Height (mm) and slopes, of NumPy or Dr.Jit arrays; beyond its rim it goes on as in its outermost cells."""
        if isinstance(x, np.ndarray | np.generic | float):
            x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
            u, v, i, j = self._cells(x, y)
            s, t = u - i, v - j
            at = [[np.moveaxis(self.corners[j + b, i + a], -1, 0) for a in (0, 1)] for b in (0, 1)]
        else:
            kind = dr.detached_t(type(x))
            ny, nx = self.corners.shape[:2]
            u = (x - (self.middle[0] - self.half[0])) / self.step[0]
            v = (y - (self.middle[1] - self.half[1])) / self.step[1]
            whole = dr.int32_array_t(kind)
            number = dr.uint32_array_t(kind)
            i, j = (number(dr.clip(whole(dr.floor(dr.detach(w))), 0, n - 2)) for w, n in ((u, nx), (v, ny)))
            s, t = u - type(x)(kind(i)), v - type(x)(kind(j))
            buffer = self._buffer(kind)
            first = 4 * (j * nx + i)
            at = [
                [[type(x)(dr.gather(kind, buffer, first + (4 * (b * nx + a) + k))) for k in range(4)] for a in (0, 1)]
                for b in (0, 1)
            ]
        return _patch(s, t, at, self.step)

    def _buffer(self, kind: Any) -> Any:
        """All corners on the device, in the precision of a kernel."""
        known = self.__dict__.setdefault("_buffers", {})
        if kind not in known:
            known[kind] = kind(self.corners.ravel())
            dr.eval(known[kind])
        return known[kind]


def _patch(s: Any, t: Any, at: Any, step: tuple[float, float]) -> tuple[Any, Any, Any]:
    """Hermite's bicubic patch and its slopes at (s, t) in a cell."""
    dx, dy = step
    (a0, a1, b0, b1), (da0, da1, db0, db1) = _hermite(s)
    (c0, c1, d0, d1), (dc0, dc1, dd0, dd1) = _hermite(t)

    def row(b: int, w0: Any, w1: Any, v0: Any, v1: Any) -> tuple[Any, Any]:
        """Height and slope in y, scaled by the step, along the lower or the upper side."""
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
    """Weights of the values and the slopes at 0 and at 1, and their derivatives."""
    s2 = s * s
    s3 = s2 * s
    high = 3 * s2 - 2 * s3
    steep = 6 * (s - s2)
    return (1 - high, high, s3 - 2 * s2 + s, s3 - s2), (-steep, steep, 3 * s2 - 4 * s + 1, 3 * s2 - 2 * s)


def _numbers(line: int, words: list[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise MistrayError(f"line {line}: '{' '.join(words)[:60]}' are no numbers; correct it") from None


def _check(z: np.ndarray, step: tuple[float, float], missing: np.ndarray) -> None:
    """Raise if it cannot be a grid; z: heights, or all numbers of its corners."""
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
    """Heights, with those of the nearest points where there is none."""
    if not missing.any():
        return z
    if missing.all():
        raise MistrayError("it has no height at all; give some")
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(z[rows, columns])

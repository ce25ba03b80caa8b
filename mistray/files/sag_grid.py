"""Readers and a writer of sags on grids: NumPy archives, and text in the format of OpticStudio."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from mistray.errors import MistrayError, errors_of
from mistray.files.arrays import check_arrays
from mistray.read_file import read_file

MOST_POINTS = 1 << 24  # of a grid: 4096 by 4096
MOST_BYTES = 1 << 30  # that a file may have, or unpack to; the most points are 0.53 GiB
UNITS_MM = (1.0, 10.0, 25.4, 1000.0)  # by the unit flag of a text file
SUFFIX = ".npz"

Values = tuple[np.ndarray, tuple[float, float], tuple[float, float], np.ndarray]


def read_sag_grid(path: str | Path) -> Values:
    """
    Return the sag of a surface on a grid of points, from a file.

    Parameters
    ----------
    path : str or Path
        File ``.npz`` as of `sag_grid_bytes`, or text as for a Grid Sag surface of OpticStudio. A text file has a line
        ``nx ny dx dy unit x y`` (unit 0 mm, 1 cm, 2 inch, 3 m), then a line for each point. It holds height, slopes in
        x and y, twist, and 1 if there is no height. Points run from the largest y and the smallest x, x first.

    Returns
    -------
    values : (ny, nx, 1) or (ny, nx, 4) float64
        Heights, mm, rows by increasing y, then slopes in x and y, dimensionless, and twist, 1/mm. A text file in which
        all slopes and twists are 0 gives heights alone.
    step, middle : (2,) float
        Distances between points, and centre of the grid, in x and y, mm.
    missing : (ny, nx) bool
        True for points without a height.

    Raises
    ------
    MistrayError
        If the file cannot be read or holds an invalid value, or the grid is too large.
    """
    path = Path(path)
    content = read_file(path, "grid", most=MOST_BYTES)
    with errors_of(f"grid '{path}'"):
        return _from_archive(content) if path.suffix == SUFFIX else _from_text(content)


def sag_grid_bytes(
    corners: np.ndarray, step: tuple[float, float], middle: tuple[float, float], missing: np.ndarray
) -> bytes:
    """
    Return the ``.npz`` file of a sag on a grid as bytes.

    `corners` are the values that `read_sag_grid` returns, (ny, nx, 4), the others as there, in mm.
    """
    content = io.BytesIO()
    np.savez_compressed(content, corners=corners, step=np.array(step), middle=np.array(middle), missing=missing)
    return content.getvalue()


def _check_points(nx: int, ny: int) -> None:
    if nx * ny > MOST_POINTS:
        raise MistrayError(f"{nx} by {ny} points are more than {MOST_POINTS}; give it a coarser step")


def _from_archive(content: bytes) -> Values:
    try:
        with np.load(check_arrays(content, MOST_BYTES), allow_pickle=False) as data:
            corners, step, middle, missing = (data[key] for key in ("corners", "step", "middle", "missing"))
        if corners.ndim != 3 or corners.shape[2] != 4 or missing.shape != corners.shape[:2]:
            raise MistrayError("its arrays do not go together; make it again")
        _check_points(missing.shape[1], missing.shape[0])
        sizes = [(float(pair[0]), float(pair[1])) for pair in (step, middle)]
        return corners.astype(np.float64), sizes[0], sizes[1], missing.astype(bool)
    except MistrayError:
        raise
    except (OSError, ValueError, KeyError, IndexError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise MistrayError(f"it is not a grid that mistray wrote ({error}); make it again") from None


def _from_text(content: bytes) -> Values:
    lines = [
        (k, line.split())
        for k, line in enumerate(content.decode("latin-1").splitlines(), 1)
        if line.strip() and line.lstrip()[0] != "!"
    ]
    if not lines:
        raise MistrayError("it is empty; give a first line 'nx ny dx dy unit x y'")
    head = _numbers(*lines[0])
    if len(head) < 4 or not all(value.is_integer() for value in (*head[:2], *head[4:5])):
        raise MistrayError(f"line {lines[0][0]} is not 'nx ny dx dy unit x y'")
    nx, ny = int(head[0]), int(head[1])
    unit = int(head[4]) if len(head) > 4 else 0
    if not 0 <= unit < len(UNITS_MM):
        raise MistrayError(f"unit {unit}; it is 0 (mm), 1 (cm), 2 (inch) or 3 (m)")
    _check_points(nx, ny)
    if min(nx, ny) < 1 or len(lines) - 1 != nx * ny:
        raise MistrayError(f"{len(lines) - 1} points for {nx} by {ny}; complete it")
    rows = np.zeros((nx * ny, 5))
    for place, (number, words) in enumerate(lines[1:]):
        values = _numbers(number, words)[:5]
        rows[place, : len(values)] = values
    table = rows.reshape(ny, nx, 5)[::-1]
    mm = UNITS_MM[unit]
    whole = table[..., :4] * (mm, 1.0, 1.0, 1 / mm)
    middle = (head[5] * mm if len(head) > 5 else 0.0, head[6] * mm if len(head) > 6 else 0.0)
    heights_alone = not table[..., 1:4].any()
    step = abs(head[2]) * mm, abs(head[3]) * mm
    return whole[..., :1] if heights_alone else whole, step, middle, table[..., 4] != 0


def _numbers(line: int, words: list[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise MistrayError(f"line {line}: '{' '.join(words)[:60]}' are not numbers; correct it") from None

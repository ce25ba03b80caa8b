"""Table of n and k over wavelength from a user's CSV file.

The first row names the columns `wavelength_nm`, `n` and, optionally, `k`, in any order; rows that begin with ``#`` are
comments. n and k are interpolated linearly, so give close steps: the error for N-SF6 near 400 nm is 3.5e-4 with 20 nm
steps, 1e-4 with 10 nm and 1e-6 with 1 nm.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.files.number_rows import cells_of
from mistray.materials.curve import Curve, table
from mistray.named_values import number_of
from mistray.read_file import read_file

_COLUMNS = ("wavelength_nm", "n", "k")


def read_table(path: Path) -> tuple[Curve, Curve | None]:
    """
    Return the curves of n and k over wavelength, nm, in a CSV file; that of k is None if the file has no k.

    Raises
    ------
    MistrayError
        If the file cannot be read, a column is missing or a cell is not understood; the message names file and line.
    """
    header: list[str] | None = None
    rows: dict[float, list[float]] = {}
    text = read_file(path, "material table").decode("utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        cells = cells_of(line, f"material table '{path}' line {number}")
        if not any(cells) or cells[0].startswith("#"):
            continue
        if header is None:
            header = _header(path, number, cells)
            continue
        row = _row(path, number, cells, header)
        if row[0] in rows:
            raise _error(path, number, f"wavelength {row[0]:g} nm is there twice")
        rows[row[0]] = row
    if not rows:
        raise MistrayError(f"material table '{path}': no rows; it needs wavelength_nm,n[,k] and numbers below")
    data = np.array(list(rows.values()))
    return table(data[:, 0], data[:, 1]), table(data[:, 0], data[:, 2]) if data.shape[1] == 3 else None


def _error(path: Path, number: int, what: str) -> MistrayError:
    return MistrayError(f"material table '{path}' line {number}: {what}; correct the line")


def _header(path: Path, number: int, cells: list[str]) -> list[str]:
    missing = [name for name in _COLUMNS[:2] if name not in cells]
    if missing or len(set(cells)) < len(cells) or not set(cells) <= set(_COLUMNS):
        raise MistrayError(
            f"material table '{path}' line {number}: columns '{','.join(cells)}'; it needs wavelength_nm,n or "
            "wavelength_nm,n,k"
        )
    return cells


def _row(path: Path, number: int, cells: list[str], header: list[str]) -> list[float]:
    """Return the wavelength, nm, n and, if there is such a column, k of a row; raise `MistrayError` if one is bad."""
    if len(cells) != len(header):
        raise _error(path, number, f"{len(cells)} cells for {len(header)} columns")
    values = {}
    for name, cell in zip(header, cells, strict=True):
        value = number_of(cell)
        if value is None:
            raise _error(path, number, f"{name} = '{cell}' is not a number")
        values[name] = value
        lowest_is_right = values[name] >= 0 if name == "k" else values[name] > 0
        if not (lowest_is_right and values[name] < math.inf):
            bound = "at least 0 (n + ik, k > 0 absorbs)" if name == "k" else "greater than 0"
            raise _error(path, number, f"{name} = {values[name]:g}; it must be finite and {bound}")
    return [values[name] for name in _COLUMNS if name in values]

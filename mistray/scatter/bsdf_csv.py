"""BSDF tables as CSV files of angles."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.replace_file import replace_file
from mistray.scatter.samples import Samples, half_circle

COLUMNS = ("theta_i_deg", "theta_s_deg", "phi_deg", "bsdf")


def read_bsdf_csv(path: str | Path, anisotropy: str = "error") -> Samples:
    """
    Read a CSV file.

    Columns: theta_i_deg, the angle of the specular direction with the normal (of incidence too in reflection);
    theta_s_deg and phi_deg, the scattered direction: its angle with the normal and its azimuth, 0 on the side of the
    specular direction, over 0 … 180° or 0 … 360°; bsdf, 1/sr. Rows in any order, a full grid. Lines that start with
    # are comments.

    Parameters
    ----------
    path : str or Path
    anisotropy : {"error", "mean"}
        What becomes of sides of the plane of incidence that differ, see `half_circle`.

    Raises
    ------
    MistrayError
        If the file is missing, a column is missing or unknown, a cell is no number, or the rows are no full grid; with
        the number of the line where there is one.
    """
    what = f"BSDF table '{path}'"
    numbered = [(n, line) for n, line in read_lines(path) if line.strip() and not line.lstrip().startswith("#")]
    cells = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in numbered)]
    header = tuple(cells[0]) if cells else ()
    if sorted(header) != sorted(COLUMNS):
        raise MistrayError(f"{what}: its columns are {', '.join(header) or 'missing'}; give {', '.join(COLUMNS)}")
    rows = []
    for (number, _), row in zip(numbered[1:], cells[1:], strict=True):
        rows.append(numbers(row, len(header), f"{what}, line {number}"))
    data = dict(zip(header, np.array(rows, dtype=np.float64).reshape(len(rows), len(header)).T, strict=True))
    specular, polar, azimuth = (np.unique(data[key]) for key in COLUMNS[:3])
    if not rows or len(rows) != len(specular) * len(polar) * len(azimuth):
        raise MistrayError(
            f"{what}: {len(rows)} rows for {len(specular)} theta_i × {len(polar)} theta_s × {len(azimuth)} phi; give "
            "every combination once"
        )
    order = np.lexsort((data["theta_s_deg"], data["phi_deg"], data["theta_i_deg"]))
    if len(set(zip(*(data[key].tolist() for key in COLUMNS[:3]), strict=True))) != len(rows):
        raise MistrayError(f"{what}: a combination of angles is there twice; give every one once")
    values = data["bsdf"][order].reshape(len(specular), len(azimuth), len(polar))
    return Samples(str(path), "normal", specular, *_swap(half_circle(what, azimuth, values, anisotropy), polar))


def write_bsdf_csv(samples: Samples, path: str | Path, comment: str = "") -> None:
    """
    Write a table in the frame "normal" that `read_bsdf_csv` understands.

    Raises
    ------
    MistrayError
        If the table is in the other frame, or the file cannot be written.
    """
    if samples.frame != "normal":
        raise MistrayError(f"{samples.title}: a CSV table counts angles from the normal, this one from the specular")
    lines = [f"# {line}" for line in comment.splitlines()] + [",".join(COLUMNS)]
    for i, specular in enumerate(samples.specular_deg):
        for j, azimuth in enumerate(samples.azimuth_deg):
            for k, polar in enumerate(samples.polar_deg):
                lines.append(f"{specular:.10g},{polar:.10g},{azimuth:.10g},{samples.values[i, j, k]:.10g}")
    replace_file(path, "\n".join(lines) + "\n", "BSDF table")


def read_lines(path: str | Path, what: str = "BSDF table") -> list[tuple[int, str]]:
    """The lines of a text file with their numbers, from 1; the error message starts with `what`."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text file"
        raise MistrayError(f"{what} '{path}': {reason}; check the path, relative to the scene file") from None
    return list(enumerate(text.splitlines(), start=1))


def numbers(words: list[str], count: int, where: str) -> list[float]:
    """Finite numbers of a line."""
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise MistrayError(f"{where}: {error}; every value must be a number") from None
    if len(values) != count:
        raise MistrayError(f"{where}: {len(values)} values where {count} are needed")
    for value in values:
        if not math.isfinite(value):
            raise MistrayError(f"{where}: {value:g}; every value must be a finite number")
    return values


def _swap(half: tuple[np.ndarray, np.ndarray], polar: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth, polar angles and values in the order of `Samples`."""
    return half[0], polar, half[1]

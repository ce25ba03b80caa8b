"""Reader and writer of BSDF tables over angles in CSV files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.files.number_rows import numbers, read_cells
from mistray.replace_file import replace_file
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation
from mistray.scatter.measured.samples import BsdfSamples

COLUMNS = ("theta_i_deg", "theta_s_deg", "phi_deg", "bsdf")
ROTATION = "rotation_deg"


def read_bsdf_csv(path: str | Path, anisotropy: str = "error") -> BsdfSamples | RotatedSamples:
    """
    Return the BSDF table over angles of a CSV file.

    The columns theta_i_deg, theta_s_deg and phi_deg are angles in degrees; bsdf is in 1/sr. theta_i_deg is the angle of
    the specular direction with the normal, in reflection also that of incidence. theta_s_deg is the angle of the
    scattered direction with the normal. phi_deg is its azimuth over 0 … 180° or 0 … 360°, 0 on the side of the specular
    direction. An anisotropic sample has rotation_deg, the azimuth of its x axis, also 0 on that side. Azimuths run
    counterclockwise as seen from the side of incidence. The rows form a full grid in any order. Lines that start with #
    are comments.

    Parameters
    ----------
    path : str or Path
        CSV file of a BSDF table.
    anisotropy : {"error", "mean", "keep"}
        Whether differences between sample rotations or sides are refused, averaged or kept, see `by_rotation`.

    Raises
    ------
    MistrayError
        If the file or a column is missing, a column is unknown, a cell is not a number, or the rows are not a full
        grid. It is also raised for the reasons of `BsdfSamples` and `by_rotation`.
    """
    what = f"BSDF table '{path}'"
    (_, header), *below = read_cells(path, "BSDF table") or [(0, [])]
    columns = (ROTATION, *COLUMNS)
    if sorted(header) not in (sorted(COLUMNS), sorted(columns)):
        raise MistrayError(
            f"{what}: its columns are {', '.join(header) or 'missing'}; give {', '.join(COLUMNS)}, and {ROTATION} for "
            "an anisotropic sample"
        )
    rows = [numbers(row, len(header), f"{what}, line {number}") for number, row in below]
    data = dict(zip(header, np.array(rows, dtype=np.float64).reshape(len(rows), len(header)).T, strict=True))
    data.setdefault(ROTATION, np.zeros(len(rows)))
    rotation, specular, polar, azimuth = (np.unique(data[key]) for key in columns[:4])
    if not rows or len(rows) != len(rotation) * len(specular) * len(polar) * len(azimuth):
        turned = f"{len(rotation)} rotation × " if ROTATION in header else ""
        raise MistrayError(
            f"{what}: {len(rows)} rows for {turned}{len(specular)} theta_i × {len(polar)} theta_s × {len(azimuth)} phi;"
            " give every combination once"
        )
    order = np.lexsort((data["theta_s_deg"], data["phi_deg"], data["theta_i_deg"], data[ROTATION]))
    if len(set(zip(*(data[key].tolist() for key in columns[:4]), strict=True))) != len(rows):
        raise MistrayError(f"{what}: a combination of angles is there twice; give every one once")
    values = data["bsdf"][order].reshape(len(rotation), len(specular), len(azimuth), len(polar))

    def table_of(azimuth: np.ndarray, values: np.ndarray) -> BsdfSamples:
        return BsdfSamples(str(path), "normal", specular, azimuth, polar, values)

    return by_rotation(what, rotation, azimuth, values, anisotropy, table_of)


def write_bsdf_csv(samples: BsdfSamples | RotatedSamples, path: str | Path, comment: str = "") -> None:
    """
    Write a table in the frame "normal" as a CSV file that `read_bsdf_csv` reads.

    The lines of `comment` stand at its head.

    Raises
    ------
    MistrayError
        If the table is in the frame "specular", or the file cannot be written.
    """
    turned = isinstance(samples, RotatedSamples)
    prefixes = [f"{angle:.10g}," if turned else "" for angle in samples.rotation_deg]
    if samples.tables[0].frame != "normal":
        raise MistrayError(f"{samples.title}: a CSV table counts angles from the normal, this one from the specular")
    header = ",".join((ROTATION, *COLUMNS) if turned else COLUMNS)
    lines = [f"# {line}" for line in comment.splitlines()] + [header]
    for prefix, table in zip(prefixes, samples.tables, strict=True):
        for i, specular in enumerate(table.specular_deg):
            for j, azimuth in enumerate(table.azimuth_deg):
                for k, polar in enumerate(table.polar_deg):
                    value = table.values[i, j, k]
                    lines.append(f"{prefix}{specular:.10g},{polar:.10g},{azimuth:.10g},{value:.10g}")
    replace_file(path, "\n".join(lines) + "\n", "BSDF table")

"""Checks of pictures of a sky, which Mitsuba reads, and a reader of HEALPix maps."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError, foreign_errors
from mistray.files.packages import format_package
from mistray.read_file import read_file, require_file

FITS = (".fits", ".fit", ".fits.gz")


def is_healpix(file: str) -> bool:
    """True if a file name ends as that of a FITS file, which holds a HEALPix map."""
    return file.lower().endswith(FITS)


def check_picture(file: str, owner: str) -> None:
    """
    Check that a picture is a regular file, before Mitsuba opens it; `owner` names the source in messages.

    Raises
    ------
    MistrayError
        If the file is missing, or is a folder, a pipe or a device.
    """
    require_file(file, f"{owner}: filename")


def read_healpix(file: str, owner: str) -> tuple[np.ndarray, bool]:
    """
    Return the pixels of a HEALPix map: the first column of the first table of a FITS file.

    Parameters
    ----------
    file : str
        FITS file.
    owner : str
        Name of the source, for messages.

    Returns
    -------
    values : (n,) float64
        Values of the pixels, ≥ 0, in the unit of the file.
    nested : bool
        Whether the indices of pixels follow the nested scheme; else they count along rings.

    Raises
    ------
    MistrayError
        If astropy is not installed, the file cannot be read, or it holds no HEALPix map of finite values ≥ 0.
    """
    content = read_file(file, f"{owner}: filename")
    fits = format_package("fits")
    with (
        foreign_errors(f"{owner}: '{Path(file).name}'", "give a map in HEALPix"),
        fits.open(io.BytesIO(content)) as found,
    ):
        table = next((part for part in found if isinstance(part, fits.BinTableHDU)), None)
        if table is None:
            raise ValueError("it has no table")
        ordering = str(table.header.get("ORDERING", "")).strip().upper()
        values = np.asarray(table.data.field(0), dtype=np.float64).ravel()
    if ordering not in ("RING", "NESTED", "NEST"):
        raise MistrayError(f"{owner}: '{Path(file).name}': its ORDERING is '{ordering}'; it must be RING or NESTED")
    if not np.all(np.isfinite(values)) or np.any(values < 0) or np.any(values > 1e30):
        raise MistrayError(f"{owner}: '{Path(file).name}' has pixels without a radiance; give values from 0 to 1e30")
    return values, ordering != "RING"

"""Export of results in further file formats: Parquet, PDF, EXR, FITS, NPY and ray files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mistray.errors import MistrayError, nearest
from mistray.files.irradiance_files import FORMATS, IrradianceMap, write_irradiance
from mistray.files.packages import format_package
from mistray.files.parquet import write_parquet
from mistray.files.ray_sets import save_ray_set
from mistray.ranges import ANYTHING, TEXT, ByName, OfType, Several, several
from mistray.replace_file import replace_file
from mistray.toolkit.pages.model import Report

PDF = "pdf"
RAYS = "dat"  # needs no package
PARQUET = "parquet"
ALL = (PARQUET, PDF, *FORMATS, RAYS)


def require_formats(formats: str | Sequence[str]) -> None:
    """
    Raise `MistrayError` for formats that cannot be written, so that a long trace does not end in an error.

    Parameters
    ----------
    formats : str or sequence of str
        "parquet", "pdf", "exr", "fits", "npy" or "dat".

    Raises
    ------
    MistrayError
        If a format is unknown, or a package is missing; the message then names it and the extra to install.
    """
    for name in several(formats):
        if name not in ALL:
            raise MistrayError(f"format '{name}' is unknown; {nearest(str(name), ALL)}")
        format_package(name)


def pdf_name(page: str) -> str:
    """Return the file name of the PDF document for a page, such as report.pdf for report.html."""
    return f"{page.removesuffix('.html')}.{PDF}"


def write_formats(
    formats: str | Sequence[str],
    directory: str | Path,
    tables: Mapping[str, pd.DataFrame],
    maps: Mapping[str, IrradianceMap],
    facts: Mapping[str, Any] | None = None,
    report: Report | None = None,
) -> list[Path]:
    """
    Write tables as Parquet, irradiance maps as EXR, FITS or NPY, rays for Zemax, and the report as PDF.

    Parameters
    ----------
    formats : str or sequence of str
        "parquet" for the tables, "exr", "fits" and "npy" for the maps; "pdf" for the report, "dat" for its rays.
    directory : str or Path
        Existing folder.
    tables : mapping of str to DataFrame
        Tables by file name; an ending .csv is replaced.
    maps : mapping of str to IrradianceMap
        Irradiance maps, W/mm², by file name without ending.
    facts : mapping, optional
        Facts stored with the tables, see `write_parquet`.
    report : Report, optional
        Report for "pdf", under the name of its page, and for the rays of "dat"; None: neither is written.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    MistrayError
        If an argument is of a wrong type, a file cannot be written, or for the reasons of `require_formats`.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> maps = {"image": mistray.report.IrradianceMap(t.irradiance, t.irradiance_se, t.extent)}
    >>> files = mistray.report.write_formats(["parquet", "npy"], ".", {"paths.csv": t.paths.to_pandas()}, maps)
    >>> [file.name for file in files]
    ['paths.parquet', 'image.npy']
    """
    chosen = dict.fromkeys(Several(TEXT, least=0).check("formats", formats))
    require_formats(tuple(chosen))
    folder = Path(directory)
    written = []
    ByName(ANYTHING, "{'paths.csv': trace.paths.to_pandas()}").check_all("", tables=tables, facts=facts)
    ByName(OfType(IrradianceMap, "must be an IrradianceMap"), "{'image': IrradianceMap.of(trace)}").check("maps", maps)
    for name in chosen:
        if name in FORMATS:
            written += [write_irradiance(one, folder / f"{stem}.{name}") for stem, one in maps.items()]
        elif name == RAYS:
            rays = report.rays if report is not None else {}
            written += [save_ray_set(folder / f"{stem}.{RAYS}", one) for stem, one in rays.items()]
        elif name == PDF:
            if report is not None:
                from mistray.toolkit.pages.pdf import pdf_bytes  # needs what a trace needs

                written.append(replace_file(folder / pdf_name(report.page), pdf_bytes(report), "report"))
        else:
            written += [
                write_parquet(table, folder / f"{stem.removesuffix('.csv')}.{PARQUET}", facts)
                for stem, table in tables.items()
            ]
    return written

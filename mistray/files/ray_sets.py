"""Sets of rays in files: mistray's CSV and Parquet tables, Zemax source files (.DAT), and IES TM-25.

Zemax source files may be binary or text. The binary layout follows OpticStudio's help, "Binary Source File format": 208
bytes, then seven 32-bit floats for each ray (x, y, z, the direction cosines, the flux) or eight, with the wavelength in
µm.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mistray.errors import MistrayError
from mistray.files.parquet import read_parquet, write_parquet
from mistray.files.tm25 import read_tm25
from mistray.ranges import POSITIVE
from mistray.read_file import read_file, read_text
from mistray.replace_file import replace_file

if TYPE_CHECKING:
    import pandas as pd

PLACES, DIRECTIONS = ("x", "y", "z"), ("dx", "dy", "dz")
FLUX, WAVELENGTH = "flux_W", "wavelength_nm"
UNITS_MM = {"m": 1000.0, "in": 25.4, "cm": 10.0, "ft": 304.8, "mm": 1.0, "um": 1e-3}
UNITS = tuple(UNITS_MM)  # the first five by their numbers in a Zemax file
MICROMETRE_NM = 1000.0
LARGEST_MM, LARGEST_W, LARGEST_NM, LEAST_NM = 1e12, 1e30, 1e7, 10.0
FLUX_ONLY, SPECTRAL, WATTS = 0, 2, 0
HEADER = np.dtype(
    [
        ("identifier", "<i4"),
        ("rays", "<u4"),
        ("description", "S100"),
        ("source_flux", "<f4"),
        ("flux", "<f4"),
        ("wavelength_um", "<f4"),
        ("angles", "<f4", 4),
        ("unit", "<i4"),
        ("pose", "<f4", 9),
        ("unused", "<f4", 4),
        ("format", "<i4"),
        ("flux_type", "<i4"),
        ("reserved", "<i4", 2),
    ]
)
IDENTIFIER = 1010
LUMENS = "its flux is in lumens; give the power of all its rays, or export it in watts"


@dataclass(frozen=True, eq=False)
class RaySet:
    """
    Rays with their flux, as a source starts them.

    Attributes
    ----------
    origins : (n, 3) float64
        Start points, mm.
    directions : (n, 3) float64
        Unit vectors.
    flux_W : (n,) float64
        Flux of each ray, W, ≥ 0.
    wavelength_nm : (n,) float64
        Wavelength in vacuum, nm; NaN if it is unknown.

    Raises
    ------
    MistrayError
        If there is no ray, the lengths of the arrays differ, a value is out of range, or no ray carries flux.
    """

    origins: np.ndarray
    directions: np.ndarray
    flux_W: np.ndarray
    wavelength_nm: np.ndarray

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.flux_W))
        for key, shape in (
            ("origins", (count, 3)),
            ("directions", (count, 3)),
            ("flux_W", (count,)),
            ("wavelength_nm", (count,)),
        ):
            values = np.asarray(getattr(self, key), dtype=np.float64)
            if values.shape != shape:
                raise MistrayError(f"rays: {key} has the shape {values.shape}; it must be {shape}")
            object.__setattr__(self, key, values)
        if not count:
            raise MistrayError("rays: there is none; give one at least")
        length = np.linalg.norm(self.directions, axis=1)
        bad = ~(np.abs(self.origins) <= LARGEST_MM).all(axis=1)
        self._refuse(bad, "origins", f"give numbers of at most {LARGEST_MM:g} mm")
        self._refuse(~((length > 1e-3) & (length < 1e3)), "directions", "give direction cosines")
        self._refuse(~((self.flux_W >= 0) & (self.flux_W <= LARGEST_W)), "flux_W", f"give 0 to {LARGEST_W:g} W")
        known = ~np.isnan(self.wavelength_nm)
        outside = known & ~((self.wavelength_nm >= LEAST_NM) & (self.wavelength_nm <= LARGEST_NM))
        self._refuse(outside, "wavelength_nm", f"give {LEAST_NM:g} to {LARGEST_NM:g} nm")
        if not self.flux_W.sum() > 0:
            raise MistrayError("rays: they carry no flux; give one with more than 0 W")
        exact = np.abs(length - 1) <= 1e-15
        unit = np.where(exact[:, None], self.directions, self.directions / length[:, None])
        object.__setattr__(self, "directions", unit)

    def _refuse(self, bad: np.ndarray, key: str, remedy: str) -> None:
        """Raise `MistrayError` if some rays are `bad`; the message shows the first, counted from 1, and its `key`."""
        if bad.any():
            first = int(np.argmax(bad))
            value = ", ".join(f"{v:g}" for v in np.atleast_1d(getattr(self, key)[first]))
            others = f", and so for {int(bad.sum()) - 1} more" if bad.sum() > 1 else ""
            raise MistrayError(f"rays: {key} of ray {first + 1} is {value}{others}; {remedy}")

    def to_pandas(self) -> pd.DataFrame:
        """Return a DataFrame with a row for each ray: x_mm, y_mm, z_mm, dx, dy, dz, flux_W, wavelength_nm."""
        import pandas as pd

        columns = {f"{axis}_mm": self.origins[:, k] for k, axis in enumerate(PLACES)}
        columns |= {axis: self.directions[:, k] for k, axis in enumerate(DIRECTIONS)}
        return pd.DataFrame(columns | {FLUX: self.flux_W, WAVELENGTH: self.wavelength_nm})

    @staticmethod
    def of_table(table: pd.DataFrame) -> RaySet:
        """
        Return the rays in a table such as `mistray.trace.Trace.rays`; origins may also be in m, cm, um, in, ft.

        Raises
        ------
        MistrayError
            If a column or its unit is missing, a value is not a number, or the rays are not valid, see `RaySet`.
        """
        unit = next((unit for unit in UNITS if all(f"{axis}_{unit}" in table for axis in PLACES)), None)
        if unit is None:
            others = ", ".join(UNITS)
            raise MistrayError(f"rays: no columns x, y, z with a unit; name them x_mm, y_mm, z_mm, or by {others}")
        for key in (*DIRECTIONS, FLUX):
            if key not in table:
                raise MistrayError(f"rays: there is no column {key}; add it")
        try:
            places, directions = (
                table[list(keys)].to_numpy().astype(np.float64)
                for keys in ([f"{axis}_{unit}" for axis in PLACES], DIRECTIONS)
            )
            flux = table[FLUX].to_numpy().astype(np.float64)
            given = (
                table[WAVELENGTH].to_numpy().astype(np.float64) if WAVELENGTH in table else np.full(len(table), np.nan)
            )
        except (TypeError, ValueError):
            raise MistrayError("rays: a value is not a number; give numbers only") from None
        return RaySet(places * UNITS_MM[unit] if unit != "mm" else places, directions, flux, given)


Found = tuple[RaySet, bool]  # the rays, and whether their flux is in W


def read_ray_set(path: str | Path, unit: str | None = None, power_W: float | None = None) -> RaySet:
    """
    Return the set of rays in a file, with their flux.

    Parameters
    ----------
    path : str or Path
        File ``.csv`` or ``.parquet`` with the columns of `RaySet.to_pandas`, Zemax ``.dat`` or IES ``.tm25ray``.
    unit : str, optional
        Unit of the origins in a text ``.dat`` that states none: m, cm, mm, um, in or ft.
    power_W : float, optional
        Total flux of all rays, W, to which their fluxes are scaled; by default they stay. A file in lumens needs it.

    Raises
    ------
    MistrayError
        If the file is none of these or is cut off, a ray is invalid, or a file in lumens has no `power_W`; the message
        is one line that names the file.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise MistrayError(
            f"ray file '{path}': its name must end in {', '.join(READERS)}; write others as one of these"
        )
    if unit is not None and unit not in UNITS_MM:
        raise MistrayError(f"ray file '{path}': the unit '{unit}' is not one of {', '.join(UNITS)}")
    try:
        rays, in_watts = reader(path, unit)
        if power_W is not None:
            rays = replace(rays, flux_W=rays.flux_W * (POSITIVE.check("power_W", power_W) / rays.flux_W.sum()))
        elif not in_watts:
            raise MistrayError(LUMENS)
        return rays
    except MistrayError as error:
        text = str(error)
        raise MistrayError(text if str(path) in text else f"ray file '{path}': {text.removeprefix('rays: ')}") from None


def save_ray_set(path: str | Path, rays: RaySet) -> Path:
    """
    Write a set of rays as ``.csv``, ``.parquet`` (both read back bit by bit) or Zemax ``.dat`` (32-bit floats).

    Raises
    ------
    MistrayError
        If the path has another ending, the file cannot be written, or only some wavelengths are known for a ``.dat``
        file.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return replace_file(path, rays.to_pandas().to_csv(index=False, lineterminator="\n").encode(), "ray file")
    if suffix == ".parquet":
        return write_parquet(rays.to_pandas(), path)
    if suffix == ".dat":
        return replace_file(path, _zemax_bytes(rays), "ray file")
    raise MistrayError(f"ray file '{path}': its name must end in {', '.join(WRITTEN)}")


def _read_csv(path: Path, unit: str | None) -> Found:
    import pandas as pd

    text = read_text(path, "ray file")
    try:
        # As text: not every version of pandas reads numbers to the last bit
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False, comment="#", skipinitialspace=True)
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise MistrayError(f"{str(error).strip().splitlines()[0]}; give a table with a line of names first") from None
    table = table.rename(columns=lambda name: str(name).strip())
    if WAVELENGTH in table:
        table[WAVELENGTH] = table[WAVELENGTH].replace("", "nan")
    return RaySet.of_table(table), True


def _read_parquet(path: Path, unit: str | None) -> Found:
    return RaySet.of_table(read_parquet(path, "ray file")), True


def _read_tm25(path: Path, unit: str | None) -> Found:
    rays = read_tm25(read_file(path, "ray file"))
    return RaySet(rays.origins, rays.directions, rays.flux, rays.wavelength_nm), not rays.in_lumens


def _read_zemax(path: Path, unit: str | None) -> Found:
    content = read_file(path, "ray file")
    head = content[: HEADER.itemsize]
    if len(head) == HEADER.itemsize and not _is_text(head):
        return _read_binary(content)
    return _read_zemax_text(content.decode("utf-8", errors="replace"), unit), True


def _is_text(head: bytes) -> bool:
    return all(byte >= 32 or byte in b"\t\r\n" for byte in head)


def _read_binary(content: bytes) -> Found:
    header = np.frombuffer(content, HEADER, 1)[0]
    count, kind, unit = int(header["rays"]), int(header["format"]), int(header["unit"])
    if kind not in (FLUX_ONLY, SPECTRAL) or not 0 <= unit < 5:
        raise MistrayError(f"it has the format {kind} and the unit {unit}; 0 or 2, and 0 … 4 are known")
    width = 7 if kind == FLUX_ONLY else 8
    if len(content) < HEADER.itemsize + 4 * width * count:
        raise MistrayError(f"it ends before its {count} rays; copy it again")
    rows = np.frombuffer(content, "<f4", width * count, HEADER.itemsize).reshape(count, width).astype(np.float64)
    one = float(header["wavelength_um"]) * MICROMETRE_NM or np.nan
    wavelength = rows[:, 7] * MICROMETRE_NM if kind == SPECTRAL else np.full(count, one)
    rays = RaySet(rows[:, :3] * UNITS_MM[UNITS[unit]], rows[:, 3:6], rows[:, 6], wavelength)
    return rays, int(header["flux_type"]) == WATTS


def _read_zemax_text(text: str, unit: str | None) -> RaySet:
    """
    Return the rays of a text file.

    Its first line has their number and a number for the unit; each other line has seven or eight values. Without a
    number for the unit, `unit` is the unit. Raise `MistrayError` if the text has another form, or no unit is given.
    """
    lines = text.split("\n", 1)
    words = lines[0].split()
    if not words or not all(re.fullmatch(r"[+-]?\d+", word) for word in words[:2]):
        raise MistrayError("its first line is not a number of rays; give a Zemax source file")
    count = int(words[0])
    given = UNITS[int(words[1])] if len(words) > 1 and 0 <= int(words[1]) < 5 else unit
    if given is None:
        raise MistrayError("its first line has no unit; give unit=")
    try:
        numbers = np.array(lines[1].split() if len(lines) > 1 else [], dtype=np.float64)
    except ValueError:
        raise MistrayError("a value of it is not a number; give a Zemax source file") from None
    width = len(numbers) // count if count else 0
    if width not in (7, 8) or len(numbers) != width * count:
        raise MistrayError(f"it has {len(numbers)} numbers for {count} rays; seven or eight for each are needed")
    rows = numbers.reshape(count, width)
    wavelength = rows[:, 7] * MICROMETRE_NM if width == 8 else np.full(count, np.nan)
    return RaySet(rows[:, :3] * UNITS_MM[given], rows[:, 3:6], rows[:, 6], wavelength)


def _zemax_bytes(rays: RaySet) -> bytes:
    known, count = ~np.isnan(rays.wavelength_nm), len(rays.flux_W)
    one = bool(known.all()) and len(np.unique(rays.wavelength_nm)) == 1
    spectral = bool(known.any()) and not one
    if spectral and not known.all():
        raise MistrayError("rays: the wavelengths of some are known and of others not; a .dat file has all or none")
    header = np.zeros(1, HEADER)
    header["identifier"], header["rays"], header["description"] = IDENTIFIER, count, b"rays of mistray"
    header["source_flux"] = header["flux"] = rays.flux_W.sum()
    header["wavelength_um"] = rays.wavelength_nm[0] / MICROMETRE_NM if one else 0.0
    header["unit"], header["format"] = UNITS.index("mm"), SPECTRAL if spectral else FLUX_ONLY
    columns = [rays.origins, rays.directions, rays.flux_W[:, None]]
    if spectral:
        columns.append(rays.wavelength_nm[:, None] / MICROMETRE_NM)
    return header.tobytes() + np.concatenate(columns, axis=1).astype("<f4").tobytes()


WRITTEN = (".csv", ".parquet", ".dat")
READERS: dict[str, Callable[[Path, str | None], Found]] = {
    ".csv": _read_csv,
    ".parquet": _read_parquet,
    ".dat": _read_zemax,
    ".tm25ray": _read_tm25,
}

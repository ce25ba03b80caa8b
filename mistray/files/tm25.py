"""
Reader of IES TM-25-13, "Ray File Format for the Description of the Emission Property of Light Sources".

A file has these parts, with sections of the document: a header of 256 bytes (4.7.1), eight flags (4.7.2) that state the
columns of a ray, nine descriptions of 1000 letters in UTF-32 (4.7.3), tables of spectra (4.7.4), names of further
columns (4.7.5), and a text (4.7.6). The rays follow as 32-bit floats, in mm and nm. All numbers are little-endian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError

Array = npt.NDArray[np.float64]
MAGIC, VERSION = b"TM25", 2013
HEADER = np.dtype(
    [
        ("type", "S4"),
        ("version", "<i4"),
        ("creation", "<i4"),
        ("luminous_flux_lm", "<f4"),
        ("radiant_flux_W", "<f4"),
        ("rays", "<u8"),
        ("date", "S28"),
        ("start", "<i4"),
        ("spectrum", "<i4"),
        ("wavelength_nm", "<f4"),
        ("shortest_nm", "<f4"),
        ("longest_nm", "<f4"),
        ("tables", "<i4"),
        ("further", "<i4"),
        ("text_bytes", "<i4"),
        ("reserved", "S168"),
        ("flags", "<i4", 8),
        ("descriptions", "S4000", 9),
    ]
)
# Columns that each flag stands for, in their order in a ray
COLUMNS = (
    ("x", "y", "z"),
    ("dx", "dy", "dz"),
    ("W",),
    ("nm",),
    ("lm",),
    ("S1", "S2", "S3"),
    ("X", "Z"),
    ("table",),
)
NO_SPECTRUM, ONE_WAVELENGTH, WAVELENGTH_EACH, ONE_TABLE, TABLE_EACH = range(5)
NAME_BYTES, BLOCK_BYTES = 512, 32
GOLDEN = (np.sqrt(5) - 1) / 2  # its multiples fill 0 … 1 evenly, however many there are


@dataclass(frozen=True)
class Rays:
    """
    Rays of a light source as a TM-25 file describes them.

    Attributes
    ----------
    origins, directions : (n, 3) float64
        Start points, mm, and direction cosines.
    flux : (n,) float64
        Flux of each ray, W, or lm if `in_lumens`.
    wavelength_nm : (n,) float64
        Wavelength of each ray, nm; NaN if the file has no spectrum.
    in_lumens : bool
        Whether the file states no radiant flux.
    """

    origins: Array
    directions: Array
    flux: Array
    wavelength_nm: Array
    in_lumens: bool


def read_tm25(content: bytes) -> Rays:
    """
    Return the rays of a TM-25 file, given its content.

    If the header states a total, the flux of rays is scaled to it (4.7.1.4, 4.7.1.5). If rays have lumens and the
    header has both totals, each lumen is the same fraction of a watt. A ray with a spectrum table gets one wavelength
    of it, so that all rays together have the spectrum. Stokes parameters are ignored.

    Raises
    ------
    MistrayError
        If the content is not a TM-25 file, has another version, is invalid, or is cut off.
    """
    if not content.startswith(MAGIC) or len(content) < HEADER.itemsize:
        raise MistrayError("it does not begin with TM25 and a header; give an IES TM-25 ray file")
    header = np.frombuffer(content, HEADER, 1)[0]
    count, kind, flags = int(header["rays"]), int(header["spectrum"]), header["flags"].tolist()
    numbers = [int(header[key]) for key in ("tables", "further", "text_bytes")]
    if int(header["version"]) != VERSION:
        raise MistrayError(f"it is of version {int(header['version'])}; {VERSION} is read, export it as that")
    if set(flags) - {0, 1} or flags[:2] != [1, 1] or not (flags[2] or flags[4]) or min(numbers) < 0:
        raise MistrayError(f"its header has the flags {flags} and the sizes {numbers}; export it again")
    names = [name for flag, group in zip(flags, COLUMNS, strict=True) if flag for name in group]
    needed = {WAVELENGTH_EACH: "nm", TABLE_EACH: "table"}.get(kind)
    if not NO_SPECTRUM <= kind <= TABLE_EACH or (needed and needed not in names):
        raise MistrayError(f"its spectrum is of the kind {kind} without its column; 0 … 4 are known, export it again")
    tables, at = _tables(content, numbers[0])
    at += NAME_BYTES * numbers[1] + numbers[2]
    width = len(names) + numbers[1]
    if count > (len(content) - at) // (4 * width):
        raise MistrayError(f"it ends before its {count} rays; copy it again")
    rows = np.frombuffer(content, "<f4", count * width, at).reshape(count, width).astype(np.float64)
    column = {name: rows[:, k] for k, name in enumerate(names)}
    flux, in_lumens = _flux(header, column)
    if kind == ONE_WAVELENGTH:
        wavelength = np.full(count, float(header["wavelength_nm"]))
    elif kind == WAVELENGTH_EACH:
        wavelength = column["nm"]
    elif kind in (ONE_TABLE, TABLE_EACH):
        wavelength = _drawn(tables, column["table"] if kind == TABLE_EACH else np.ones(count))
    else:
        wavelength = np.full(count, np.nan)
    return Rays(rows[:, :3], rows[:, 3:6], flux, wavelength, in_lumens)


def _flux(header: np.void, column: dict[str, Array]) -> tuple[Array, bool]:
    """
    Return the flux of each ray, (n,), W or lm, and True if it is in lumens.

    It is scaled to the total of the header, if that is given.
    """
    watts, lumens = (float(header[key]) for key in ("radiant_flux_W", "luminous_flux_lm"))
    relative = column["W"] if "W" in column else column["lm"]
    in_lumens = "W" not in column and not watts > 0
    total, whole = lumens if in_lumens else watts, relative.sum()
    return relative * (total / whole) if total > 0 and whole > 0 else relative, in_lumens


def _tables(content: bytes, count: int) -> tuple[list[tuple[Array, Array]], int]:
    """
    Return wavelengths (nm) and relative weights of each spectrum, and the byte offset after them.

    Raise `MistrayError` if a spectrum is incomplete or not valid.
    """
    tables, at = [], HEADER.itemsize
    for number in range(1, count + 1):
        pairs = int.from_bytes(content[at : at + 4], "little", signed=True)
        if not 0 < pairs <= (len(content) - at - 4) // 8:
            raise MistrayError(f"spectrum {number} has {pairs} wavelengths, which it does not hold; export it again")
        values = np.frombuffer(content, "<f4", 2 * pairs, at + 4).reshape(pairs, 2).astype(np.float64)
        at += 4 + 8 * pairs
        nm, weight = values.T
        if not (np.all(np.diff(nm) > 0) and nm[0] > 0 and np.all(weight >= 0) and 0 < weight.sum() < np.inf):
            raise MistrayError(f"spectrum {number} must have rising wavelengths and weights from 0; export it again")
        tables.append((nm, weight))
    return tables, at + (HEADER.itemsize - at) % BLOCK_BYTES


def _drawn(tables: list[tuple[Array, Array]], number: Array) -> Array:
    """
    Return one wavelength, nm, for each ray, (n,), so that rays with a spectrum table together have its spectrum.

    `tables` are those of `_tables`, and `number`, (n,), is the index, from 1, of the table of each ray. Rays count
    alike, whatever their flux. Raise `MistrayError` for an index without a table.
    """
    wavelength = np.empty(len(number))
    for index in np.unique(number):
        if not 1 <= index <= len(tables) or index != int(index):
            raise MistrayError(f"a ray has spectrum {index:g} of {len(tables)}; export it again")
        nm, weight = tables[int(index) - 1]
        mine = np.flatnonzero(number == index)
        share = (0.5 + GOLDEN * np.arange(len(mine))) % 1.0
        wavelength[mine] = _inverse(nm, weight, share)
    return wavelength


def _inverse(nm: Array, weight: Array, share: Array) -> Array:
    """Return wavelengths, nm, (n,), below which a piecewise linear spectrum has the fractions `share` of its flux."""
    if len(nm) == 1:
        return np.full(len(share), nm[0])
    step = np.diff(nm)
    below = np.concatenate([[0.0], np.cumsum(step * (weight[1:] + weight[:-1]) / 2)])
    flux = share * below[-1]
    k = np.clip(np.searchsorted(below, flux, side="right") - 1, 0, len(step) - 1)
    rest, a, slope = flux - below[k], weight[k], (weight[k + 1] - weight[k]) / step[k]
    # a t + slope t²/2 = rest, in the form that does not cancel
    root = a + np.sqrt(np.maximum(a * a + 2 * slope * rest, 0.0))
    return nm[k] + np.minimum(np.divide(2 * rest, root, out=np.zeros_like(rest), where=root > 0), step[k])

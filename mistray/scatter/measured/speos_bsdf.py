"""Reader of anisotropic BSDF files of Ansys Speos (.anisotropicbsdf) in text form.

The layout follows Ansys' help, "Structure of Anisotropic BSDF Files". A file has a header, the mode, texts, the
anisotropy vector, flags for reflection and transmission, and the kind of the values. Then follow the angles of the
sample and of incidence, the incidence (θ0, φ0) at which the spectrum was measured, and the totals in % at some
wavelengths. A table of polar angles by azimuths follows for each incidence. Polar angles are counted from the normal;
azimuth 0 is that of the specular direction.

The values are proportional to the BSDF, or to BSDF times cos θs. Like Speos, the reader scales them so that the
integral

    ∫ f cos θs dΩ = total

has this value at θ0 and φ0, the rotation of the sample; between two of them it is interpolated.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.files.number_rows import numbers, read_lines
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation, whole_circle
from mistray.scatter.measured.samples import BsdfSamples

SUFFIX = ".anisotropicbsdf"

_HEADER = re.compile(r"OPTIS - Anisotropic BSDF surface file v[78]\.0")
_LONGEST = 10_000  # most angles in a row
_SAME_TOTAL = 1e-6  # relative difference of totals that count as equal at all wavelengths


class _Lines:
    """Reader of the text lines of a Speos BSDF file, one after the other, with their numbers for messages."""

    def __init__(self, path: str | Path) -> None:
        self.title = f"BSDF file '{path}'"
        self._lines = read_lines(path, "BSDF table")
        self._next = 0

    @property
    def where(self) -> str:
        """File name and number of the line read last, for error messages."""
        return f"{self.title}, line {self._next}"

    @property
    def length(self) -> int:
        """Number of characters of the line read last, spaces at its ends included."""
        return len(self._lines[self._next - 1][1])

    def text(self) -> str:
        """Return the next line, without spaces at its ends; raise `MistrayError` at the end of the file."""
        if self._next >= len(self._lines):
            raise MistrayError(f"{self.title}: it ends after {self._next} lines, before its data; copy it again")
        self._next += 1
        return self._lines[self._next - 1][1].strip()

    def values(self, count: int) -> list[float]:
        """Return the numbers of the next line; raise `MistrayError` unless there are `count` of them."""
        words = self.text().split()
        if len(words) != count:
            raise MistrayError(f"{self.where}: {len(words)} numbers; {count} are needed")
        return numbers(words, count, self.where)

    def counts(self, count: int, least: int = 0) -> list[int]:
        """Return the whole numbers ≥ `least` of the next line; raise `MistrayError` unless there are `count`."""
        values = self.values(count)
        if any(value != int(value) or not least <= value <= _LONGEST for value in values):
            raise MistrayError(f"{self.where}: {values}; whole numbers from {least} to {_LONGEST} are needed")
        return [int(value) for value in values]


def read_speos_bsdf(path: str | Path, anisotropy: str = "error") -> BsdfSamples | RotatedSamples:
    """
    Return the reflected scatter of an anisotropic BSDF file of Speos.

    Parameters
    ----------
    path : str or Path
        File in text mode, version 7.0 or 8.0.
    anisotropy : {"error", "mean", "keep"}
        Whether differences between sample rotations or sides are refused, averaged or kept, see `by_rotation`. A
        rotation is the azimuth of the file's anisotropy vector, which becomes the x axis of the sample.

    Raises
    ------
    MistrayError
        If the file is missing, binary, malformed or of another version. Also if it has transmission, totals that depend
        on the wavelength, no light at θ0, tables of different angles, or rotations with different incidences. Further
        reasons are those of `BsdfSamples` and `by_rotation`.
    """
    lines = _Lines(path)
    if not _HEADER.fullmatch(lines.text()):
        raise MistrayError(f"{lines.where}: not an 'OPTIS - Anisotropic BSDF surface file v8.0'; export it as such")
    if lines.text() != "0":
        raise MistrayError(f"{lines.where}: it is in binary mode; save it as text in Speos (mode 0)")
    lines.text()
    left = lines.counts(1)[0]
    while left > 0:  # the description, which may have several lines
        lines.text()
        left -= lines.length + 1
    lines.values(3)
    if lines.counts(2) != [1, 0]:
        raise MistrayError(f"{lines.where}: it holds transmission; only files with reflection alone are read")
    of_bsdf = lines.counts(1)[0] == 1
    rotation = np.array(lines.values(lines.counts(1, least=1)[0]))
    incidences = [lines.values(lines.counts(1, least=1)[0]) for _ in rotation]
    if any(angles != incidences[0] for angles in incidences):
        raise MistrayError(f"{lines.where}: the rotations have other incidences each; measure all at the same")
    specular = np.array(incidences[0])
    theta_0, phi_0 = lines.values(2)
    lines.text()
    totals = [lines.values(2)[1] for _ in range(lines.counts(1)[0])]
    if not totals or max(totals) - min(totals) > _SAME_TOTAL * max(totals):
        raise MistrayError(
            f"{lines.where}: totals of {totals} % at its wavelengths; a table has no wavelengths: keep one of them"
        )
    grid: tuple[np.ndarray, np.ndarray] | None = None
    blocks = []
    for _ in range(len(rotation) * len(specular)):
        polars, azimuths = lines.counts(2, least=1)
        azimuth = np.array(lines.values(azimuths))
        rows = np.array([lines.values(azimuths + 1) for _ in range(polars)])
        own = (rows[:, 0], azimuth)
        if grid is not None and not all(np.array_equal(a, b) for a, b in zip(grid, own, strict=True)):
            raise MistrayError(f"{lines.where}: the tables have other angles each; export them on one grid")
        grid = own
        blocks.append(rows[:, 1:].T)
    assert grid is not None
    polar, azimuth = grid
    values = np.array(blocks).reshape(len(rotation), len(specular), len(azimuth), len(polar))

    def table_of(azimuth: np.ndarray, values: np.ndarray, at: np.ndarray = specular) -> BsdfSamples:
        table = BsdfSamples(str(path), "normal", at, azimuth, polar, values, "reflection", stated)
        return table if of_bsdf else replace(table, values=table.held(table.bsdf(True), table.above(True)))

    stated = (totals[0] / 100, float(np.clip(theta_0, specular[0], specular[-1])), phi_0)
    plane = _between(phi_0, rotation, values, 360.0)
    plane = _between(stated[1], specular, plane)[None]
    (now,) = table_of(*whole_circle(lines.title, azimuth, plane), np.array([stated[1]])).totals()
    if not now > 0:
        raise MistrayError(f"{lines.title}: it scatters nothing at {theta_0:g}°, where its total is stated")
    return by_rotation(lines.title, rotation, azimuth, values * (stated[0] / now), anisotropy, table_of)


def _between(x: float, nodes: np.ndarray, values: np.ndarray, period: float | None = None) -> np.ndarray:
    """Return values (n, …) at ascending nodes, (n,), interpolated to x; held outside, unless there is a period."""
    weights = [np.interp(x, nodes, row, period=period) for row in np.eye(len(nodes))]
    return np.tensordot(weights, values, axes=1)

"""Tabular BSDF format of Zemax OpticStudio.

Source: R. Rykowski, "Zemax Tabular BSDF data file format" (knowledge base of Zemax, first "BSDF Data Interchange file
format", 2008). Angles are relative to the specular direction: ScatterRadial counts from there, ScatterAzimuth 0 points
from there to the normal, and the angle grows counterclockwise. AngleOfIncidence is the angle of the specular direction.
SampleRotation is the angle between the normal of the plane of incidence and the +x axis of the surface. Its sense is
not defined; it is taken counterclockwise here like the azimuth, as seen from the side of incidence. A line with the TIS
precedes the block of each angle of incidence. Its definition varied in older files, and it is not used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.files.number_rows import numbers, read_lines
from mistray.replace_file import replace_file
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation
from mistray.scatter.measured.samples import BsdfSamples

GRIDS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
EVENTS = {"brdf": "reflection", "btdf": "transmission"}
TYPES = {event: name.upper() for name, event in EVENTS.items()}
NORMAL_OF_INCIDENCE_DEG = 90.0  # azimuth of the axis from which SampleRotation counts


@dataclass
class _Lines:
    """
    Reader of a Zemax BSDF file, line by line.

    `lines` yields the number and the words of each line that is neither empty nor a comment. `number` is the number of
    the line read last.
    """

    path: str | Path
    lines: Iterator[tuple[int, list[str]]]
    number: int = 0

    @property
    def where(self) -> str:
        return f"BSDF file '{self.path}', line {self.number}"

    def next(self, expected: str) -> list[str]:
        try:
            self.number, words = next(self.lines)
        except StopIteration:
            raise MistrayError(f"BSDF file '{self.path}': it ends before {expected}; the file is incomplete") from None
        return words

    def choice(self, key: str, known: tuple[str, ...]) -> str:
        """
        Return the value in the next line, in lower case.

        The line must read `key value`, in capitals or not, with a value in `known`; otherwise raise `MistrayError`.
        """
        words = self.next(key)
        if words[0].lower() != key.lower() or len(words) != 2:
            raise MistrayError(f"{self.where}: '{' '.join(words)}'; expected {key} {'|'.join(known)}")
        if words[1].lower() not in (name.lower() for name in known):
            raise MistrayError(f"{self.where}: {key} is {words[1]}; use {' or '.join(known)}")
        return words[1].lower()

    def values(self, count: int, expected: str) -> list[float]:
        """
        Return the next `count` values, from one line or several; `expected` describes them in messages.

        Raise `MistrayError` if the last line has more values than that, or the file ends.
        """
        found: list[float] = []
        while len(found) < count:
            words = self.next(expected)
            found += numbers(words, len(words), self.where)
        if len(found) > count:
            raise MistrayError(f"{self.where}: {len(found)} values of {expected} where {count} are needed")
        return found


def read_zemax_bsdf(path: str | Path, anisotropy: str = "error") -> BsdfSamples | RotatedSamples:
    """
    Read the BSDF table in a monochrome BSDF file of Zemax.

    Parameters
    ----------
    path : str or Path
        BSDF file of Zemax.
    anisotropy : {"error", "mean", "keep"}
        Whether differences between sample rotations or sides are refused, averaged or kept, see `by_rotation`.

    Raises
    ------
    MistrayError
        If the file is missing, malformed or in colours, or for the reasons of `BsdfSamples` and `by_rotation`. The
        message names a malformed line by its number.
    """
    rows = (
        (n, line.split())
        for n, line in read_lines(path, "BSDF table")
        if line.strip() and not line.lstrip().startswith("#")
    )
    lines = _Lines(path, rows)
    lines.choice("Source", ("Measured",))
    lines.choice("Symmetry", ("PlaneSymmetrical", "Asymmetrical", "Asymmetrical4D"))
    if lines.choice("SpectralContent", ("Monochrome", "XYZ")) == "xyz":
        raise MistrayError(f"{lines.where}: XYZ are colours, not wavelengths; give a file with Monochrome")
    event = EVENTS[lines.choice("ScatterType", ("BRDF", "BTDF"))]
    grids: dict[str, np.ndarray] = {}
    for key in GRIDS:
        words = lines.next(key)
        if words[0].lower() != key.lower() or len(words) != 2 or not words[1].isdecimal() or int(words[1]) < 1:
            raise MistrayError(f"{lines.where}: '{' '.join(words)}'; expected {key} and how many angles there are")
        grids[key] = np.array(lines.values(int(words[1]), f"the angles of {key}"))
    for word in ("Monochrome", "DataBegin"):
        words = lines.next(word)
        if [word.lower()] != [part.lower() for part in words]:
            raise MistrayError(f"{lines.where}: '{' '.join(words)}'; expected {word}")
    rotation, specular, azimuth, radial = (grids[key] for key in GRIDS)
    values = [[_block(lines, len(azimuth), len(radial), angle) for angle in specular] for _ in rotation]
    words = lines.next("DataEnd")
    if words[0].lower() != "dataend":
        raise MistrayError(f"{lines.where}: '{' '.join(words[:5])}'; expected DataEnd, there are more data than angles")

    def table_of(azimuth: np.ndarray, values: np.ndarray) -> BsdfSamples:
        return BsdfSamples(str(path), "specular", specular, azimuth, radial, values, event)

    title = f"BSDF file '{path}'"
    return by_rotation(title, rotation, azimuth, np.array(values), anisotropy, table_of, NORMAL_OF_INCIDENCE_DEG)


def _block(lines: _Lines, azimuths: int, radials: int, angle: float) -> np.ndarray:
    """
    Return the BSDF, 1/sr, (azimuths, radials), at one angle of incidence, degrees, read from the next lines.

    Lines ``TIS`` before them are skipped. Raise `MistrayError` if the number of values is wrong, or a value is
    negative.
    """
    found: list[float] = []
    while len(found) < azimuths * radials:
        words = lines.next(f"the data at {angle:g}°")
        if words[0].lower() == "tis":
            if found:
                raise MistrayError(
                    f"{lines.where}: TIS after {len(found)} of {azimuths * radials} values at {angle:g}°; the block "
                    "before it is incomplete"
                )
            numbers(words[1:], 1, lines.where)
            continue
        if words[0].lower() == "dataend":
            raise MistrayError(
                f"{lines.where}: DataEnd after {len(found)} of {azimuths * radials} values at {angle:g}°; the file is "
                "incomplete"
            )
        row = numbers(words, len(words), lines.where)
        if min(row) < 0:
            raise MistrayError(f"{lines.where}: {min(row):g}; a BSDF is not negative")
        found += row
    if len(found) > azimuths * radials:
        raise MistrayError(f"{lines.where}: {len(found)} values at {angle:g}°, {azimuths * radials} are needed")
    return np.array(found).reshape(azimuths, radials)


def write_zemax_bsdf(samples: BsdfSamples | RotatedSamples, path: str | Path, comment: str = "") -> None:
    """
    Write a table in the frame "specular" as a BSDF file of Zemax.

    Parameters
    ----------
    samples : BsdfSamples or RotatedSamples
        Table in the frame "specular" that declares its event. Its values are BSDF, 1/sr, without a factor cos θs.
    path : str or Path
        File to write.
    comment : str
        Comment at the head of the file, in one or several lines.

    Raises
    ------
    MistrayError
        If the table is in the frame "normal" or declares no event, or the file cannot be written.
    """
    turned, one = isinstance(samples, RotatedSamples), samples.tables[0]
    if one.frame != "specular" or one.event is None:
        raise MistrayError(
            f"{samples.title}: a Zemax file counts angles from the specular direction and is BRDF or BTDF; give a "
            "table in the frame 'specular' with an event"
        )
    rotations = np.mod(samples.rotation_deg - (NORMAL_OF_INCIDENCE_DEG if turned else 0.0), 360)
    order = np.argsort(rotations)
    written = [*rotations[order]]
    if len(order) > 1 and written[0] == 0:  # the format goes from 0 to 360°
        order, written = np.append(order, order[0]), [*written, 360.0]
    grids = (np.array(written), one.specular_deg, one.azimuth_deg, one.polar_deg)
    lines = [f"# {line}" for line in comment.splitlines()]
    symmetry = "Asymmetrical4D" if turned else "Asymmetrical" if one.whole else "PlaneSymmetrical"
    lines += ["Source Measured", f"Symmetry {symmetry}", "SpectralContent Monochrome"]
    lines.append(f"ScatterType {TYPES[one.event]}")
    for key, grid in zip(GRIDS, grids, strict=True):
        lines += [f"{key} {len(grid)}", "\t".join(f"{angle:.10g}" for angle in grid)]
    lines += ["", "Monochrome", "DataBegin"]
    for number in order:
        table = samples.tables[number]
        for total, block in zip(table.totals(), table.values, strict=True):
            lines.append(f"TIS {total:.6g}")
            lines += ["\t".join(f"{value:.6e}" for value in row) for row in block]
    replace_file(path, "\n".join([*lines, "DataEnd"]) + "\n", "BSDF file")

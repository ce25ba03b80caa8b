"""
Reader of intensity distributions over direction: IES LM-63 and CSV.

LM-63 files follow ANSI/IES LM-63-19 and its earlier editions of 1986, 1991, 1995 and 2002. Only type C photometry is
read: planes of azimuth about the axis of the lamp.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.read_file import read_file, read_text

CANDELA, WATTS_PER_SR, RELATIVE = "cd", "W/sr", ""
COLUMNS = {"intensity_cd": CANDELA, "intensity_W_sr": WATTS_PER_SR, "intensity": RELATIVE}
ANGLES = ("theta_deg", "phi_deg")
LARGEST = 1e30
MOST_ANGLES = 4000  # of one kind: steps of 0.1° over the circle
TYPES = {1: "C", 2: "B", 3: "A"}
# First lines from 2002 on. Before, the second number of the line of the ballast is a factor of the candelas; files of
# 1986 begin with any text
WITHOUT_FACTOR = ("IESNA:LM-63-2002", "IES:LM-63-")
NUMBERS = 13  # before the angles


@dataclass(frozen=True, eq=False)
class Intensities:
    """
    Radiant or luminous intensity on a grid of directions, interpolated linearly in both angles.

    Attributes
    ----------
    theta_deg : (t,) float64
        Angles from the axis, degrees, rising within 0 … 180; the intensity is 0 outside the first and the last.
    phi_deg : (p,) float64
        Azimuths from x towards y, degrees, rising from 0 to 360.
    values : (t, p) float64
        Intensities in `unit`; the first and the last column are equal.
    unit : str
        Unit: "cd", "W/sr", or "" for relative values.

    Raises
    ------
    MistrayError
        If the angles do not rise or leave their range, a value is negative or not finite, or all values are 0.
    """

    theta_deg: np.ndarray
    phi_deg: np.ndarray
    values: np.ndarray
    unit: str = RELATIVE

    def __post_init__(self) -> None:
        for key, most in (("theta_deg", 180.0), ("phi_deg", 360.0)):
            angles = np.asarray(getattr(self, key), dtype=np.float64)
            object.__setattr__(self, key, angles)
            if angles.ndim != 1 or not 2 <= len(angles) <= MOST_ANGLES or not np.all(np.diff(angles) > 0):
                raise MistrayError(
                    f"{key} does not rise from angle to angle; give 2 to {MOST_ANGLES} angles, each once"
                )
            if not (angles[0] >= 0 and angles[-1] <= most):
                raise MistrayError(f"{key} goes from {angles[0]:g} to {angles[-1]:g}; keep it within 0 … {most:g}")
        values = np.asarray(self.values, dtype=np.float64)
        object.__setattr__(self, "values", values)
        if values.shape != (len(self.theta_deg), len(self.phi_deg)):
            raise MistrayError(
                f"there are {values.shape} values for {len(self.theta_deg)} × {len(self.phi_deg)} angles"
            )
        if not np.all((values >= 0) & (values < LARGEST)):
            raise MistrayError("an intensity is below 0 or none; give numbers from 0")
        if not np.any(values > 0):
            raise MistrayError("all intensities are 0; give one above 0")


def read_intensities(path: str | Path) -> Intensities:
    """
    Return the intensity distribution over directions in a file.

    Parameters
    ----------
    path : str or Path
        File ``.ies``, or ``.csv`` with the columns theta_deg, phi_deg and one of intensity_cd, intensity_W_sr and
        intensity.

    Raises
    ------
    MistrayError
        If the file is neither, or cannot be read; the message is one line that names the file.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise MistrayError(f"intensities '{path}': its name must end in {', '.join(READERS)}")
    try:
        return reader(path)
    except MistrayError as error:
        text = str(error)
        raise MistrayError(text if str(path) in text else f"intensities '{path}': {text}") from None


def whole_circle(phi_deg: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return azimuths, (p,) degrees, and values, (t, p), completed to the whole circle by symmetry.

    A single azimuth means rotational symmetry. Azimuths from 0 to 90 are mirrored at the planes x = 0 and y = 0, from 0
    to 180 at y = 0, and from 90 to 270 at x = 0. Azimuths from 0 to 360 are complete; equal steps that end one before
    360 close on the first.

    Raises
    ------
    MistrayError
        If the azimuths have another range, or the values at 0 and 360 differ.
    """
    first, last = float(phi_deg[0]), float(phi_deg[-1])
    if len(phi_deg) == 1:
        return np.array([0.0, 360.0]), np.repeat(values, 2, axis=1)
    if (first, last) == (90.0, 270.0):  # half a circle about 180
        around = np.unique(np.concatenate([[0.0, 360.0], phi_deg, (180.0 - phi_deg) % 360.0]))
        mirrored = np.where(np.abs(around - 180.0) > 90.0, (180.0 - around) % 360.0, around)
        return around, np.stack([np.interp(mirrored, phi_deg, row) for row in values])
    if first != 0:
        raise MistrayError(f"the azimuths begin at {first:g}; let them begin at 0")
    if last in (90.0, 180.0):
        both = np.concatenate([phi_deg, 2 * last - phi_deg[-2::-1]])
        mirrored = np.concatenate([values, values[:, -2::-1]], axis=1)
        return (both, mirrored) if last == 180.0 else whole_circle(both, mirrored)
    if not last <= 360.0:
        raise MistrayError(f"the azimuths end at {last:g}; let them end at 0, 90, 180 or 360")
    if last < 360.0:
        if last < 180.0 or not np.allclose(np.diff(np.append(phi_deg, 360.0)), phi_deg[1], atol=1e-6):
            raise MistrayError(f"the azimuths end at {last:g}; let them end at 0, 90, 180 or 360")
        phi_deg, values = np.append(phi_deg, 360.0), np.concatenate([values, values[:, :1]], axis=1)
    if not np.allclose(values[:, 0], values[:, -1], rtol=1e-3, atol=1e-3 * values.max()):
        raise MistrayError("the values at the azimuths 0 and 360 differ; they are the same direction")
    mean = 0.5 * (values[:, :1] + values[:, -1:])
    return phi_deg, np.concatenate([mean, values[:, 1:-1], mean], axis=1)


def _read_ies(path: Path) -> Intensities:
    text = read_file(path, "intensities").decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    tilts = [number for number, line in enumerate(lines) if line.strip().upper().startswith("TILT=")]
    if not tilts:
        raise MistrayError("it has no line TILT=; give an IES LM-63 file")
    tilt = lines[tilts[0]].strip().upper().removeprefix("TILT=").strip()
    if tilt != "NONE":
        raise MistrayError(
            f"it has TILT={tilt[:40]}, a lamp whose light depends on how it hangs; give one with TILT=NONE"
        )
    try:
        numbers = np.array(" ".join(lines[tilts[0] + 1 :]).replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        raise MistrayError("a value after TILT=NONE is not a number; give an IES LM-63 file") from None
    if len(numbers) < NUMBERS or not np.all(np.isfinite(numbers)):
        raise MistrayError(f"it has {len(numbers)} numbers after TILT=NONE; {NUMBERS} and then the angles are needed")
    multiplier, thetas, phis, kind = numbers[2], numbers[3], numbers[4], numbers[5]
    if kind != 1:
        raise MistrayError(f"its photometry is of type {TYPES.get(int(kind), f'{kind:g}')}; export it as type C")
    if not all(1 <= count <= MOST_ANGLES and count == int(count) for count in (thetas, phis)):
        raise MistrayError(f"it has {thetas:g} × {phis:g} angles; give 1 to {MOST_ANGLES} of each")
    t, p = int(thetas), int(phis)
    if len(numbers) != NUMBERS + t + p + t * p:
        raise MistrayError(f"it has {len(numbers)} numbers after TILT=NONE; {NUMBERS + t + p + t * p} are needed")
    theta, phi, candela = np.split(numbers[NUMBERS:], [t, t + p])
    factor = multiplier * numbers[10] * (1.0 if lines[0].strip().startswith(WITHOUT_FACTOR) else numbers[11])
    around, values = whole_circle(phi, factor * candela.reshape(p, t).T)
    # Azimuths of a lamp that hangs go counter-clockwise as seen from above, along its axis: from x towards -y
    return Intensities(theta, 360.0 - around[::-1], values[:, ::-1], CANDELA)


def _read_csv(path: Path) -> Intensities:
    rows: list[tuple[float, float, float]] = []
    unit = None
    for number, line in enumerate(read_text(path, "intensities").splitlines(), start=1):
        cells = [cell.strip() for cell in re.split(r"[,;\t]", line)]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if unit is None:
            if tuple(cells[:2]) != ANGLES or len(cells) != 3 or cells[2] not in COLUMNS:
                raise MistrayError(
                    f"line {number} is not a line of names; give {', '.join(ANGLES)}, {' or '.join(COLUMNS)}"
                )
            unit = COLUMNS[cells[2]]
            continue
        try:
            theta, phi, value = map(float, cells)
        except ValueError:
            raise MistrayError(f"line {number} is not three numbers; correct it") from None
        rows.append((theta, phi, value))
    if unit is None or not rows:
        raise MistrayError("it has no rows; give a line of names and numbers below")
    table = np.array(rows)
    if not np.all(np.isfinite(table)):
        raise MistrayError("a number is not finite; correct it")
    (thetas, row), (phis, column) = (np.unique(table[:, k], return_inverse=True) for k in range(2))
    if max(len(thetas), len(phis)) > MOST_ANGLES or len(rows) != len(thetas) * len(phis):
        raise MistrayError(
            f"it has {len(rows)} rows for {len(thetas)} × {len(phis)} angles; give each pair of them once"
        )
    values = np.full((len(thetas), len(phis)), np.nan)
    values[row, column] = table[:, 2]
    if np.isnan(values).any():
        raise MistrayError("a pair of angles is there twice, and another one is missing; give each once")
    return Intensities(thetas, *whole_circle(phis, values), unit)


READERS: dict[str, Callable[[Path], Intensities]] = {".ies": _read_ies, ".csv": _read_csv}

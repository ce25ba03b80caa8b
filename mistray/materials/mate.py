"""MATE sections of a Zemax coating file: n and k of coating materials over wavelength.

    MATE name
    wavelength n k

Wavelengths are in µm. OpticStudio writes its waves exp(+iωt), so k is negative for a material that absorbs; its sign is
changed here. A line that starts with ! is a comment. Source: OpticStudio user guide, "Defining Coatings".
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError, printable
from mistray.materials.agf import decode
from mistray.named_values import finite_of
from mistray.read_file import read_file

SHOWN = 60  # characters of a line that a message quotes
SECTIONS = ("MATE", "TAPR", "COAT", "IDEAL", "IDEAL2", "TABLE", "ENCRYPTED")
Table = tuple[np.ndarray, np.ndarray, np.ndarray]


def read_mate(path: str | Path) -> dict[str, Table]:
    """
    Read n and k of the materials in a Zemax coating file.

    Parameters
    ----------
    path : str or Path
        File to read.

    Returns
    -------
    dict
        Arrays (wavelength_nm, n, k) by the name in the file, each (w,) float64; wavelengths ascend, k > 0 absorbs.

    Raises
    ------
    MistrayError
        If the file is missing or not text, a line of a MATE section is malformed, or a material has no data or occurs
        twice. The message names the line, if there is one.
    """
    try:
        stamp = Path(path).stat().st_mtime_ns
    except OSError as error:
        raise MistrayError(f"coating file '{path}': {error.strerror}; check the path") from None
    return _read_mate(str(path), stamp)


@lru_cache(maxsize=16)
def _read_mate(path: str, stamp: int) -> dict[str, Table]:
    materials: dict[str, list[tuple[float, float, float]]] = {}
    heads: dict[str, int] = {}
    current: list[tuple[float, float, float]] | None = None
    for number, words in numbered_lines(path):
        where = f"coating file '{path}', line {number}"
        if words[0].upper() in SECTIONS:
            current = None
            if words[0].upper() == "MATE":
                if len(words) != 2:
                    raise MistrayError(f"{where}: '{shown(words)}'; write MATE and one name")
                if words[1].upper() in heads:
                    raise MistrayError(
                        f"{where}: material {words[1]} is there already, on line {heads[words[1].upper()]}; rename one"
                    )
                heads[words[1].upper()] = number
                current = materials.setdefault(words[1], [])
        elif current is not None:
            wavelength, n, k = numbers(words, 3, 3, where, "wavelength in µm, n, k")
            if not (wavelength > 0 and n > 0 and k <= 0):
                raise MistrayError(
                    f"{where}: wavelength {wavelength:g} µm, n = {n:g}, k = {k:g}; wavelength and n must be greater "
                    "than 0, k 0 or negative (a material that absorbs has k < 0 in these files)"
                )
            nm = round(wavelength * 1e3, 6)
            if current and nm <= current[-1][0]:
                raise MistrayError(f"{where}: wavelength {wavelength:g} µm does not follow the one before; sort them")
            current.append((nm, n, -k))
    for name, rows in materials.items():
        if not rows:
            raise MistrayError(
                f"coating file '{path}', line {heads[name.upper()]}: material {name} has no data; add lines"
            )
    return {name: _columns(rows) for name, rows in materials.items()}


def _columns(rows: list[tuple[float, float, float]]) -> Table:
    wavelength, n, k = np.array(rows, dtype=np.float64).T
    return wavelength, n, k


def numbered_lines(path: str | Path) -> list[tuple[int, list[str]]]:
    """
    Return the lines of a coating file that are neither empty nor comments, as line number from 1 and words.

    Raises
    ------
    MistrayError
        If the file cannot be read, or is not text.
    """
    lines = []
    for number, line in enumerate(decode(read_file(path, "coating file")).splitlines(), start=1):
        words = line.partition("!")[0].split()
        if not all(word.isprintable() for word in words):
            raise MistrayError(
                f"coating file '{path}', line {number}: '{shown(words)}' has characters of no text; save the file as "
                "UTF-8"
            )
        if words:
            lines.append((number, words))
    return lines


def shown(words: list[str]) -> str:
    """Return the words of a line for a message: the first `SHOWN` characters, with unprintable ones as codes."""
    text = " ".join(words)
    return printable(text[:SHOWN] + ("…" if len(text) > SHOWN else ""))


def numbers(words: list[str], least: int, most: int, where: str, what: str) -> list[float]:
    """
    Return the words of a line, from `least` to `most` of them, as numbers.

    `where` and `what` are the place and the expected content, for the message.

    Raises
    ------
    MistrayError
        If there are fewer than `least` or more than `most` words, or one is not a finite number.
    """
    values = [value for word in words if (value := finite_of(word)) is not None]
    if len(values) < len(words) or not least <= len(values) <= most:
        raise MistrayError(f"{where}: '{shown(words)}'; expected {what}")
    return values

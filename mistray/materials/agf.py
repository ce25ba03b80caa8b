"""Glasses of a Zemax AGF file ("ANSI glass format").

Lines that are read, with λ in µm and the thickness in mm:

====  ==============================================  ==================================================
NM    name, number of the formula, …                  begins a glass
CD    coefficients                                    of the formula, see `mistray.materials.formulas`;
                                                      lines that begin with a number go on with it
LD    least λ, greatest λ                             range of the formula
IT    λ, internal transmittance, thickness            k = -λ ln T/(4π thickness)
====  ==============================================  ==================================================

n is relative to air at the catalogue's own temperature and pressure; the thermal coefficients (TD) are not used. A
transmittance of exactly 1 is a rounded or missing value without information on k, and its line is left out. A
transmittance of exactly 0 means that the glass is opaque: k is unknown from the line before to the line after. If a
wavelength has two thicknesses, the line whose rounding changes k least (the largest T × thickness) is taken.
"""

from __future__ import annotations

import codecs
import difflib
import math
from dataclasses import dataclass, field
from pathlib import Path

from mistray.errors import MistrayError
from mistray.materials.curve import Curve, table
from mistray.materials.formulas import AGF_FORMULAS
from mistray.materials.pages import formula_curve
from mistray.named_values import finite_of
from mistray.read_file import read_file


@dataclass
class _Line:
    """Line of an AGF file: its words, and its number in the file for messages."""

    number: int
    words: list[str]


@dataclass
class _Block:
    """Lines that describe one glass in an AGF file, keyed by their first word."""

    head: _Line
    lines: dict[str, list[_Line]] = field(default_factory=lambda: {"CD": [], "LD": [], "IT": []})


def read_glass(path: Path, name: str) -> tuple[Curve, Curve | None]:
    """
    Return the n of a glass over wavelength, and its k; None for k if no internal transmittance in the file tells it.

    Parameters
    ----------
    path : Path
        AGF file in UTF-16, UTF-8 with or without byte order mark, or Latin-1.
    name : str
        Name of the glass; capitals do not matter.

    Raises
    ------
    MistrayError
        If the file cannot be read, the glass is not in it, or a line is not understood; the message names file and
        line.
    """
    blocks = _blocks(path)
    block = blocks.get(name.lower())
    if block is None:
        close = difflib.get_close_matches(name.lower(), blocks, n=3, cutoff=0.5)
        spelt = " or ".join(blocks[key].head.words[0] for key in close)
        remedy = f"did you mean {spelt}?" if close else f"it holds {len(blocks)} glasses; check the name"
        raise MistrayError(f"AGF file '{path}': no glass '{name}'; {remedy}")
    return _index(path, block), _extinction(path, block)


def glass_names(path: Path) -> list[str]:
    """
    Return the names of the glasses of an AGF file, as they are spelt there.

    Raises
    ------
    MistrayError
        If the file cannot be read or holds no glass, an NM line is not understood, or a glass occurs twice.
    """
    return [block.head.words[0] for block in _blocks(path).values()]


def _blocks(path: Path) -> dict[str, _Block]:
    """
    Return the lines of each glass of a file, keyed by the name of the glass in lower case.

    Raise `MistrayError` if a line NM is incomplete, a name occurs twice, or the file holds no glass.
    """
    blocks: dict[str, _Block] = {}
    current, last = None, ""
    for number, text in enumerate(decode(read_file(path, "glass catalogue")).splitlines(), 1):
        words = text.split()
        if not words:
            continue
        key = words[0].upper()
        if key == "NM":
            if len(words) < 3:
                raise _error(path, number, "NM needs a name and the number of a formula")
            current = _Block(_Line(number, words[1:]))
            if (double := blocks.get(words[1].lower())) is not None:
                raise _error(path, number, f"glass '{words[1]}' is there already, on line {double.head.number}")
            blocks[words[1].lower()] = current
        elif current is not None and key in current.lines:
            current.lines[key].append(_Line(number, words[1:]))
        elif current is not None and last == "CD" and key[0] in "+-.0123456789":
            current.lines["CD"].append(_Line(number, words))
            continue
        last = key
    if not blocks:
        raise MistrayError(f"AGF file '{path}': no line begins with NM, so that it holds no glass; give another file")
    return blocks


def decode(data: bytes) -> str:
    """Return the text of a file: UTF-16, UTF-8 with or without byte order mark, or else Latin-1."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:200]:
        return data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _error(path: Path, number: int, what: str) -> MistrayError:
    return MistrayError(f"AGF file '{path}' line {number}: {what}; correct the line")


def _numbers(path: Path, line: _Line, names: str = "") -> list[float]:
    """
    Return the words of a line as numbers; raise `MistrayError` if one is no number.

    `names` lists what the line must hold, and another count raises, too; without it any count is allowed.
    """
    values = []
    for word in line.words:
        value = finite_of(word)
        if value is None:
            raise _error(path, line.number, f"'{word}' is not a number")
        values.append(value)
    if names and len(values) != len(names.split(", ")):
        raise _error(path, line.number, f"{len(values)} numbers; it needs {names}")
    return values


def _index(path: Path, block: _Block) -> Curve:
    name, number = block.head.words[:2]
    formula = AGF_FORMULAS.get(int(number)) if number.isdecimal() else None
    if formula is None:
        raise _error(
            path, block.head.number, f"formula '{number}' of glass '{name}' is not one of 1 … {len(AGF_FORMULAS)}"
        )
    title, count, evaluate = formula
    for key in ("CD", "LD"):
        if not block.lines[key]:
            raise _error(path, block.head.number, f"glass '{name}' has no {key} line")
    c = [value for line in block.lines["CD"] for value in _numbers(path, line)]
    if len(c) < count:
        raise _error(
            path, block.lines["CD"][0].number, f"{len(c)} coefficients; formula {number} ({title}) has {count}"
        )
    line = block.lines["LD"][0]
    low, high = _numbers(path, line, "least λ, greatest λ")
    if not 0 < low < high:
        raise _error(path, line.number, f"{low:g} and {high:g} µm are not a range of wavelengths")
    return formula_curve(evaluate, c[:count], (round(low * 1e3, 6), round(high * 1e3, 6)))


def _extinction(path: Path, block: _Block) -> Curve | None:
    best: dict[float, tuple[float, float]] = {}  # λ in nm → (T × thickness, k)
    for line in block.lines["IT"]:
        um, transmittance, thickness = _numbers(path, line, "λ, internal transmittance, thickness")
        if not (um > 0 and thickness > 0):
            raise _error(path, line.number, f"λ = {um:g} µm and thickness = {thickness:g} mm must be greater than 0")
        if not 0 <= transmittance <= 1:
            raise _error(path, line.number, f"internal transmittance {transmittance:g} is not within 0 … 1")
        if transmittance == 1:
            continue
        k = -um * 1e-3 * math.log(transmittance) / (4 * math.pi * thickness) if transmittance > 0 else math.nan
        nm, weight = round(um * 1e3, 6), transmittance * thickness
        if nm not in best or weight > best[nm][0]:
            best[nm] = (weight, k)
    return table(list(best), [k for _, k in best.values()]) if best else None

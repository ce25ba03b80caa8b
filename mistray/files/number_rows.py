"""Readers of text files that hold tables of numbers: lines, cells of CSV files, and the numbers in them."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from mistray.errors import MistrayError
from mistray.read_file import read_text


def read_lines(path: str | Path, what: str) -> list[tuple[int, str]]:
    """
    Return the lines of a text file with their line numbers, from 1; `what` names the kind of file in messages.

    Raise `MistrayError` if the file cannot be read.
    """
    return list(enumerate(read_text(path, what, "check the path, relative to the scene file").splitlines(), start=1))


def read_cells(path: str | Path, what: str) -> list[tuple[int, list[str]]]:
    """
    Return the rows of cells of a CSV file with their line numbers, from 1, without empty lines and comments (#).

    `what` names the kind of file in messages. Raise `MistrayError` if the file or a line cannot be read.
    """
    return [
        (number, cells_of(line, f"{what} '{path}', line {number}"))
        for number, line in read_lines(path, what)
        if line.strip() and line.lstrip()[0] != "#"
    ]


def cells_of(line: str, where: str) -> list[str]:
    """
    Return the cells of a line of a CSV file; quotes may hold commas, but no line ends.

    Raise `MistrayError` if a quote has no end or a cell is too long; its message begins with `where`.
    """
    try:
        return [cell.strip() for cell in next(csv.reader([line], strict=True))]
    except csv.Error as error:
        raise MistrayError(f"{where}: {error}; correct the line") from None


def numbers(words: Sequence[str], count: int, where: str) -> list[float]:
    """
    Return the numbers in the words of a line.

    Raise `MistrayError` unless there are `count`, all finite; its message begins with `where`.
    """
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise MistrayError(f"{where}: {error}; every value must be a number") from None
    if len(values) != count:
        raise MistrayError(f"{where}: {len(values)} values where {count} are needed")
    for value in values:
        if not math.isfinite(value):
            raise MistrayError(f"{where}: {value:g}; every value must be a finite number")
    return values

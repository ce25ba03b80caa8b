"""What the commands share: the parser, and the types of their arguments."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from itertools import chain
from typing import Any, NoReturn

from mistray.errors import MistrayError

MOST_ANGLES = 10_000  # in one range
FIELD_ANGLES = [float(angle) for angle in range(0, 81, 2)]  # of a PST, degrees
INTERRUPTED = 130  # exit status after Ctrl-C, as of a shell
RAW = argparse.RawDescriptionHelpFormatter


class Parser(argparse.ArgumentParser):
    """Reports a wrong argument as any other bad input: in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and exiting."""
        raise MistrayError(f"{message}; see '{self.prog} --help'")


def finite(text: str) -> float:
    """A number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number")
    return value


def positive(text: str) -> float:
    """A number above 0."""
    value = finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} must be positive")
    return value


def field(text: str) -> float:
    """A field angle in degrees."""
    value = finite(text)
    if not -90 < value < 90:
        raise argparse.ArgumentTypeError(f"{text} must lie between -90 and 90 degrees")
    return value


def count(text: str) -> int:
    """A whole number that is not negative; "1e6" is one."""
    value = finite(text)
    if value < 0 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text} must be a whole number that is not negative, such as 1e6")
    return int(value)


def angles(text: str) -> list[float]:
    """Angles in degrees: one, or a range first:last:step with both ends."""
    parts = text.split(":")
    if len(parts) == 1:
        return [finite(text)]
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"'{text}' is not a range; write first:last:step, such as 0:80:2")
    first, last, step = (finite(part) for part in parts)
    if step <= 0 or last < first:
        raise argparse.ArgumentTypeError(f"'{text}' must go up: first:last:step, such as 0:80:2")
    steps = math.floor((last - first) / step * (1 + 1e-12) + 1e-9)
    if steps >= MOST_ANGLES:
        raise argparse.ArgumentTypeError(f"'{text}' is more than {MOST_ANGLES} angles; give a larger step")
    return [round(first + k * step, 9) for k in range(steps + 1)]


def incidence(text: str) -> list[float]:
    """The same between 0 and 90 degrees."""
    values = angles(text)
    wrong = [value for value in values if not 0 <= value <= 90]
    if wrong:
        raise argparse.ArgumentTypeError(f"{wrong[0]:g} must lie between 0 and 90 degrees")
    return values


class _Joined(argparse.Action):
    """The values of several arguments, each a list, as one list."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        setattr(namespace, self.dest, list(chain(*values)))


def add_angles(group: Any, name: str, text: str, kind: Callable[[str], list[float]] = incidence) -> None:
    """Declare an argument that takes numbers and ranges first:last:step, all in one list; `text` is its help."""
    group.add_argument(name, type=kind, nargs="+", action=_Joined, metavar="DEG", help=text)


def as_text(name: str) -> str:
    """A name as text: bytes that are none in the locale's encoding as UTF-8, or else as question marks."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")

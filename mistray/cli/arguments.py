"""What the commands share: the parser, and the types of their arguments."""

from __future__ import annotations

import argparse
import math
from typing import NoReturn

from mistray.errors import MistrayError

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

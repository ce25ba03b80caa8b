"""Argument parser that all commands share, and types of its arguments."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

from mistray.errors import MistrayError, nearest
from mistray.named_values import name_and_value
from mistray.ranges import FINITE, POLAR_DEG, Range

MOST_IN_RANGE = 20_000


class Parser(argparse.ArgumentParser):
    """Parser that raises `MistrayError` with one line for a wrong argument instead of exiting."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._later: list[Callable[[Parser], None]] = []

    def error(self, message: str) -> NoReturn:
        """Raise `MistrayError` with the message, instead of printing the usage and exiting."""
        see = f"see '{self.prog} --help'"
        raise MistrayError(f"{message} S{see[1:]}" if message.endswith("?") else f"{message}; {see}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise `ArgumentError` for a command or another word that is not among the choices; suggest the nearest."""
        if action.choices is not None and value not in action.choices:
            wrong = f"invalid choice: {value!r}; {nearest(str(value), map(str, action.choices))}"
            raise argparse.ArgumentError(action, wrong)

    def declare_when_used(self, declare: Callable[[Parser], None]) -> None:
        """Postpone a function that declares arguments until this parser is used."""
        self._later.append(declare)

    def declare_all(self) -> None:
        """Call the postponed functions that declare arguments."""
        while self._later:
            self._later.pop(0)(self)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """
        Return the values of an action; raise `ArgumentError` for --option=--.

        For that argparse of Python 3.11 leaves an empty list.
        """
        if action.option_strings and "--" in arg_strings:
            raise argparse.ArgumentError(action, "'--' is not a value; give one, or leave the option out")
        return super()._get_values(action, arg_strings)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """
        Return the namespace of parsed arguments, from `args` or the command line, and an empty list.

        Raise `MistrayError` for unrecognised arguments.
        """
        self.declare_all()
        found, others = super().parse_known_args(args, namespace)
        if others:  # here, where it is known whose arguments they are: a command's or the program's
            import difflib

            wrong = next((word for word in others if word.startswith("-")), "").split("=")[0]
            close = difflib.get_close_matches(wrong, self._option_string_actions, n=1)
            self.error(f"unrecognized arguments: {' '.join(others)}{f'; did you mean {close[0]}?' if close else ''}")
        return found, others


class Help(argparse.RawDescriptionHelpFormatter):
    """Help formatter that appends the allowed range of each number, and the notation first:last:step of angles."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        told = isinstance(action.type, Range | Angles) and action.type is not FINITE
        ranges = ", one by one or as first:last:step" if isinstance(action.type, Angles) else ""
        return f"{action.help}; {action.type}{ranges}" if told else action.help


@dataclass(frozen=True)
class Angles:
    """
    Argument type: one angle in degrees, or a range first:last:step, with `last` if a whole number of steps leads there.

    Attributes
    ----------
    within : Range
        Allowed range of the angles, degrees; with a range in nm the argument is a wavelength instead.
    """

    within: Range = POLAR_DEG

    def __str__(self) -> str:
        return str(self.within)

    @property
    def example(self) -> str:
        """Example of a range first:last:step within the limits, for messages."""
        return "0:80:2" if 0 in self.within else "400:700:5"

    def __call__(self, text: str) -> list[float]:
        """
        Return the values of one number or of a range first:last:step, ascending, in the unit of `within`.

        Anything else, and a range that falls or has too many values, raises `ArgumentTypeError`.
        """
        parts = text.split(":")
        if len(parts) == 1:
            return [self.within(text)]
        if len(parts) != 3:
            raise argparse.ArgumentTypeError(f"'{text}' is not a range; write first:last:step, such as {self.example}")
        first, last, step = (kind(part) for kind, part in zip((self.within, self.within, FINITE), parts, strict=True))
        if step <= 0 or last < first:
            raise argparse.ArgumentTypeError(f"'{text}' must go up: first:last:step, such as {self.example}")
        if (last - first) / step >= MOST_IN_RANGE:
            raise argparse.ArgumentTypeError(f"'{text}' is more than {MOST_IN_RANGE} numbers; give a larger step")
        steps = math.floor((last - first) / step * (1 + 1e-12) + 1e-9)
        return [round(first + k * step, 9) for k in range(steps + 1)]


class Joined(argparse.Action):
    """Argument action of a parser that joins the lists parsed from an option's values into one list."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        """Store the joined list as the value of the argument."""
        setattr(namespace, self.dest, list(chain(*values)))


class OrAlone(argparse.Action):
    """Argument action for an option that may stand without a value; it is then a list of one empty string."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        """Store the values of the option, or [""] if it was given without any."""
        setattr(namespace, self.dest, values or [""])


def place(text: str) -> Path:
    """
    Return the path of a file or folder that a string names.

    An empty string, which would mean the current folder, raises `ArgumentTypeError`.
    """
    if not text.strip():
        raise argparse.ArgumentTypeError(f"'{text}' names nothing; give a file or folder, . for the current folder")
    return Path(text)


def as_text(name: str) -> str:
    """Return a file name as printable text: undecodable bytes are read as UTF-8, else become replacement characters."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


@dataclass(frozen=True)
class Pairs:
    """
    Argument type: a pair NAME=VALUE, such as PATTERN=COATING; the first = ends the name.

    Attributes
    ----------
    wrong : str
        End of the message "'text' is …" for any other string: fault and remedy.
    kind : callable
        Function that converts the string of the value.
    repeats : bool
        Whether a name may have several values.
    """

    wrong: str
    kind: Callable[[str], Any] = str
    repeats: bool = False

    def __call__(self, text: str) -> tuple[str, Any]:
        """
        Return the name and the value of a word of the command line.

        Raise `ArgumentTypeError` if it has none, or the value is not allowed.
        """
        found = name_and_value(text)
        if found is None or not found[1]:
            raise argparse.ArgumentTypeError(f"'{text}' is {self.wrong}")
        return found[0], self.kind(found[1])


class InsteadOfArguments(argparse.Action):
    """Action of an option, such as --request, with which the positional arguments of its command may be left out."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        """Set the option, and require no argument of the parser any more."""
        setattr(namespace, self.dest, values)
        for action in parser._actions:
            action.required = False

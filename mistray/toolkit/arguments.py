"""Parser that the commands share, and the types of their arguments."""

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
    """Reports a wrong argument as any other bad input: in one line."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._later: list[Callable[[Parser], None]] = []

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and exiting."""
        see = f"see '{self.prog} --help'"
        raise MistrayError(f"{message} S{see[1:]}" if message.endswith("?") else f"{message}; {see}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a command or another word that is none of those to choose from."""
        if action.choices is not None and value not in action.choices:
            wrong = f"invalid choice: {value!r}; {nearest(str(value), map(str, action.choices))}"
            raise argparse.ArgumentError(action, wrong)

    def declare_when_used(self, declare: Callable[[Parser], None]) -> None:
        """Leave the declaration of arguments for when this parser is used, and not another one."""
        self._later.append(declare)

    def declare_all(self) -> None:
        """Declare what has been left for later."""
        while self._later:
            self._later.pop(0)(self)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Values of an action; argparse of 3.11 takes the two dashes of --option=-- away, and leaves an empty list."""
        if action.option_strings and "--" in arg_strings:
            raise argparse.ArgumentError(action, "'--' is no value; give one, or leave the option out")
        return super()._get_values(action, arg_strings)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the arguments that argparse finds; refuse those that are left over."""
        self.declare_all()
        found, others = super().parse_known_args(args, namespace)
        if others:  # here, where it is known whose arguments they are: a command's or the program's
            import difflib

            wrong = next((word for word in others if word.startswith("-")), "").split("=")[0]
            close = difflib.get_close_matches(wrong, self._option_string_actions, n=1)
            self.error(f"unrecognized arguments: {' '.join(others)}{f'; did you mean {close[0]}?' if close else ''}")
        return found, others


class Help(argparse.RawDescriptionHelpFormatter):
    """Says the range of every number behind its help, and how angles are written."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        told = isinstance(action.type, Range | Angles) and action.type is not FINITE
        ranges = ", one by one or as first:last:step" if isinstance(action.type, Angles) else ""
        return f"{action.help}; {action.type}{ranges}" if told else action.help


@dataclass(frozen=True)
class Angles:
    """
    The type of an argument that is one angle in degrees, or a range first:last:step with both ends.

    Attributes
    ----------
    within : Range
        Where they must lie; that of wavelengths makes it the type of these.
    """

    within: Range = POLAR_DEG

    def __str__(self) -> str:
        return str(self.within)

    @property
    def example(self) -> str:
        """A range of them."""
        return "0:80:2" if 0 in self.within else "400:700:5"

    def __call__(self, text: str) -> list[float]:
        """The angles that a text means."""
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
    """The values of several arguments, each a list, as one list."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        """Keep them."""
        setattr(namespace, self.dest, list(chain(*values)))


class OrAlone(argparse.Action):
    """The values of an option that may stand alone, which then is one empty text."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        """Keep them."""
        setattr(namespace, self.dest, values or [""])


def place(text: str) -> Path:
    """The type of an argument that names a file or a folder; an empty text would mean the current folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"'{text}' names nothing; give a file or folder, . for the current folder")
    return Path(text)


def as_text(name: str) -> str:
    """A name as text: bytes that are none in the locale's encoding as UTF-8, or else as question marks."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def pairs(wrong: str, kind: Callable[[str], Any] = str) -> Callable[[str], tuple[str, Any]]:
    """
    The type of an argument NAME=VALUE, such as PATTERN=COATING; the first = ends the name.

    Parameters
    ----------
    wrong : str
        What another text is, and what to write.
    kind : callable
        Type of the value.
    """

    def pair(text: str) -> tuple[str, Any]:
        found = name_and_value(text)
        if found is None or not found[1]:
            raise argparse.ArgumentTypeError(f"'{text}' is {wrong}")
        return found[0], kind(found[1])

    return pair

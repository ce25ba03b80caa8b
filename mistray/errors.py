"""The error class that users are meant to see, kinds of it, the warning, and what a wrong word may have meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

LONGEST_WORDS = (300, 100, 30)  # letters, as a path may have; fewer in a line that is
TOO_LONG = 500  # letters


class MistrayError(ValueError):
    """Bad input or a missing part; the message names the object, the value and the remedy in one line.

    The command line prints it without a traceback and exits with code 2.
    """


class UnknownKeyError(MistrayError, KeyError):
    """A mapping does not hold a key: ``in`` says no, and ``get`` gives its default, as of any mapping."""

    __str__ = Exception.__str__  # KeyError puts its message in quotes


class MistrayWarning(UserWarning):
    """
    Warning about a result or its input, in one line: a note, or an improbable number.

    Parameters
    ----------
    message : str
    code : str
        Code of a note of a result, such as "aimed", see docs/warnings.md; "" otherwise. The text ends with it in
        brackets: `warnings.filterwarnings` can choose by it.
    """

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(f"{message} [{code}]" if code else message)
        self.code = code


class Interrupted(KeyboardInterrupt):
    """
    Ctrl-C, after a part of the work was finished.

    Attributes
    ----------
    partial : object
        What was finished, as in `UnfinishedError`.
    """

    def __init__(self, message: str, partial: Any) -> None:
        super().__init__(message)
        self.partial = partial


class UnfinishedError(MistrayError):
    """
    Workers that took a part of the work are gone before all of it was done.

    Attributes
    ----------
    partial : object or None
        What was finished, in the form that the whole would have had (a trace of fewer rays, a report of fewer fields);
        None if that is not enough for a result.
    """

    def __init__(self, message: str, partial: Any = None) -> None:
        super().__init__(message)
        self.partial = partial


def in_words(error: Exception) -> str:
    """An error in one line; what is not of this package with its type."""
    text = " ".join(str(error).split())
    return text if isinstance(error, MistrayError) else f"{type(error).__name__}: {text}"


def printable(text: str) -> str:
    """A text with what cannot be printed, such as a control character of a file, as codes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def one_line(message: object) -> str:
    """A message as a line of a terminal, in which what a user or a file gave is cut where it is very long."""
    words, line = str(message).split(), ""
    for most in LONGEST_WORDS:
        line = " ".join(word if len(word) <= most else f"{word[:most]}…" for word in words)
        if len(line) <= TOO_LONG:
            break
    return printable(line)


def nearest(word: str, choices: Iterable[str]) -> str:
    """Suggest the meaning of a wrong word, or all that there is to choose from, for the end of a message."""
    words = list(choices)
    close = difflib.get_close_matches(word, words, n=1)
    return f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(words)}"

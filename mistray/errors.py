"""Error classes and warning class for users, and formatting of messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

LONGEST_WORDS = (300, 100, 30)  # letters, as a path may have; fewer in a line that is
TOO_LONG = 500  # letters


class MistrayError(ValueError):
    """Error for bad input or a missing part; its message names the object, the value and the remedy in one line.

    The command line prints it without a traceback and exits with code 2.

    Examples
    --------
    >>> try:
    ...     mistray.load("phone_camer")
    ... except mistray.MistrayError as error:
    ...     print(str(error).partition(";")[0])
    scene 'phone_camer': no such file
    """


class UnknownKeyError(MistrayError, KeyError):
    """Error for a missing key of a mapping; as it is also a KeyError, ``in`` gives False and ``get`` its default."""

    __str__ = Exception.__str__  # KeyError puts its message in quotes


class MistrayWarning(UserWarning):
    r"""
    Warning about a result or its input, one line of text: a note on the result, or an implausible number.

    Parameters
    ----------
    message : str
        Text of the warning, one line.
    code : str
        Code of a note of a result, such as "aimed", see docs/warnings.md; "" otherwise. The text ends with it in
        brackets, so that `warnings.filterwarnings` can select it.

    Examples
    --------
    >>> import warnings
    >>> str(mistray.MistrayWarning("3 rays reach the detector", "few-rays"))
    '3 rays reach the detector [few-rays]'
    >>> warnings.filterwarnings("ignore", r".*\[few-rays\]$", mistray.MistrayWarning)  # notes of this code alone
    """

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(f"{message} [{code}]" if code else message)
        self.code = code


class Interrupted(KeyboardInterrupt):
    """
    Exception for Ctrl-C or SIGTERM that came after a part of the work was finished.

    Attributes
    ----------
    partial : object
        Finished part of the result, as in `UnfinishedError`.
    """

    def __init__(self, message: str, partial: Any) -> None:
        super().__init__(message)
        self.partial = partial


class UnfinishedError(MistrayError):
    """
    Error for work that could not be completed: a cluster has lost all of its workers, or the time is up.

    Attributes
    ----------
    partial : object or None
        Finished part, in the form of a whole result (a trace of fewer rays, a report of fewer fields); None if it is
        too little for a result.

    Examples
    --------
    >>> error = mistray.UnfinishedError("all workers are lost", partial={0.0: "trace of the field 0"})
    >>> list(error.partial)
    [0.0]
    """

    def __init__(self, message: str, partial: Any = None) -> None:
        super().__init__(message)
        self.partial = partial


def refuse_unknown(given: Iterable[str], known: Iterable[str], owner: str = "") -> None:
    """
    Raise `MistrayError` for the first unknown keyword.

    The message begins with the owner and suggests a known keyword.
    """
    names = list(known)
    wrong = next((name for name in given if name not in names), None)
    if wrong is not None:
        raise MistrayError(f"{owner}there is no argument '{wrong}'; {nearest(str(wrong), names)}")


@contextmanager
def errors_of(owner: str) -> Iterator[None]:
    """Put `owner`, such as "lens 'L', line 3", in front of every `MistrayError` that is raised in a block."""
    try:
        yield
    except MistrayError as error:
        raise MistrayError(f"{owner}: {error}") from None


@contextmanager
def foreign_errors(owner: str, remedy: str) -> Iterator[None]:
    """
    Turn errors of another package in a block into a `MistrayError` of one line: owner, reason and remedy.

    A `MistrayError` passes unchanged.
    """
    try:
        yield
    except MistrayError:
        raise
    except Exception as error:  # packages raise all kinds
        key = error.args[0] if isinstance(error, KeyError) and len(error.args) == 1 else ""
        missing = " is missing" if isinstance(key, str) and key and " " not in key else ""
        reason = printable((str(error).strip() or type(error).__name__).splitlines()[0][:TOO_LONG]) + missing
        raise MistrayError(f"{owner}: {reason}; {remedy}") from None


def in_words(error: Exception) -> str:
    """Return the text of an error as one line; unless it is a `MistrayError`, it begins with the error's type."""
    text = " ".join(str(error).split())
    return text if isinstance(error, MistrayError) else f"{type(error).__name__}: {text}"


def printable(text: str) -> str:
    """Return a string with characters that cannot be printed, such as control characters, replaced by codes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def one_line(message: object) -> str:
    """
    Return a message as one line for a terminal.

    Words of more than 300 letters are cut. If the line is still longer than `TOO_LONG`, words of more than 100 letters
    are cut, and then those of more than 30.
    """
    words, line = str(message).split(), ""
    for most in LONGEST_WORDS:
        line = " ".join(word if len(word) <= most else f"{word[:most]}…" for word in words)
        if len(line) <= TOO_LONG:
            break
    return printable(line)


def nearest(word: str, choices: Iterable[str]) -> str:
    """Return the end of an error message: the choice most similar to `word` as a question, or else all choices."""
    import difflib

    words = list(choices)
    close = difflib.get_close_matches(word, words, n=1)
    return f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(words)}"


def nearest_parameters(key: str, keys: Iterable[str]) -> str:
    """Return the end of an error message on an unknown parameter of a scene: similar keys, or how to list all."""
    import difflib

    close = difflib.get_close_matches(key, list(keys))
    return f"did you mean {' or '.join(close)}?" if close else "list(mi.traverse(scene).keys()) shows them all"

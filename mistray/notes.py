"""Notes on a result: each has a code, and may be raised as a warning."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import StrEnum
from typing import Any, ParamSpec, TypeVar

from mistray.errors import MistrayWarning

P = ParamSpec("P")
T = TypeVar("T")


class Code(StrEnum):
    """Codes of notes on results and of the warnings made from them; docs/warnings.md explains each and its remedy."""

    CUT = "cut"
    MEDIUM = "medium"
    CLOSURE = "closure"
    COATING = "coating"
    THIN_GAP = "thin-gap"
    MATERIAL = "material"
    DESIGN_PATH = "design-path"
    NO_LIGHT = "no-light"
    UNFINISHED = "unfinished"
    WAVELENGTHS = "wavelengths"
    AIMED = "aimed"
    TARGET = "target"
    SILENT = "silent"
    SCATTERED_RAYS = "scattered-rays"
    ONE_RAY = "one-ray"
    FEW_RAYS = "few-rays"
    CONTESTED = "contested"
    ERROR = "error"
    POLARIZATION = "polarization"
    OUTSIDE_SEEN = "outside-seen"
    CLOSED_IN = "closed-in"
    BAND = "band"
    SEVERAL_PATHS = "several-paths"
    NO_PATH = "no-path"


class Note(str):
    """
    One line of text on the reliability or limits of a result, with a code.

    Parameters
    ----------
    text : str
        Text of the note.
    code : Code
        Code of its subject.
    warns : bool
        Whether public functions also raise it as a `MistrayWarning`; small losses appear only in the notes.
    """

    __slots__ = ("code", "warns")
    code: Code
    warns: bool

    def __new__(cls, text: str, code: Code, warns: bool = True) -> Note:
        """Create a note; see the class for the parameters."""
        note = super().__new__(cls, text)
        note.code, note.warns = code, warns
        return note

    def __getnewargs__(self) -> tuple[str, Code, bool]:  # type: ignore[override]
        """Return the constructor arguments for copying and pickling."""
        return str(self), self.code, self.warns

    def beside(self, words: str) -> Note:
        """Return a copy of the note that begins with `words` and a colon, such as the field angle that it concerns."""
        return Note(f"{words}: {self}", self.code, self.warns)


_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
_kept: ContextVar[list[Note] | None] = ContextVar("kept", default=None)


@contextmanager
def quiet(kept: list[Note] | None = None) -> Iterator[None]:
    """
    Suppress warnings for notes of results within a block, because the caller prints them or the step is internal.

    Parameters
    ----------
    kept : list of Note, optional
        List to which the suppressed notes are appended, so that the caller can show them; None: they are not kept.
    """
    before = _quiet.set(True), _kept.set(kept)
    try:
        yield
    finally:
        _quiet.reset(before[0])
        _kept.reset(before[1])


def warns(function: Callable[P, T]) -> Callable[P, T]:
    """
    Decorate a public function so that notes of its result with `Note.warns` become warnings at the caller's line.

    Within `quiet` they do not. Functions that it calls raise no such warnings themselves.
    """

    @functools.wraps(function)
    def warning(*args: P.args, **kwargs: P.kwargs) -> T:
        kept = _kept.get()
        if _quiet.get() and kept is None:
            return function(*args, **kwargs)
        with quiet():
            result: Any = function(*args, **kwargs)
        level = _level_of_caller()
        for note in getattr(result, "notes", ()):
            if isinstance(note, Note) and note.warns:
                if kept is not None:
                    kept.append(note)
                else:
                    warnings.warn(MistrayWarning(note, note.code), stacklevel=level)
        return result

    return warning


def _level_of_caller() -> int:
    """Return the ``stacklevel`` for `warnings.warn` that points to the line which called a decorated function."""
    level, frame = 2, sys._getframe(2)
    while frame.f_globals.get("__name__") == "mistray.known_arguments" and frame.f_back is not None:
        level, frame = level + 1, frame.f_back
    return level

"""A pack: numbers from one source, the function that computes mistray's, and the other program that gives theirs."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile, read_reference
from mistray.estimate import Estimate

Finder = Callable[[DeclaredRow], Estimate | None]
"""Returns the number of a row; None if there is no such light, an error of NaN if the rays are too few."""
Numbers = Callable[[ReferenceFile, int | None, int], Finder]
"""Makes a finder from a file, the start rays of each trace (None: those of the file) and the seed."""
Asked = Callable[[DeclaredRow, Finder], Estimate | None]
"""Returns the number of the other program for a row, from the row and the finder of ours; None as `Finder`."""


class PeerError(Exception):
    """Error that the code of another program raised while it computed a number."""


@contextmanager
def others() -> Iterator[None]:
    """Run a block of another program's code, and turn any exception that it raises into a `PeerError`."""
    try:
        yield
    except Exception as error:  # code of others
        raise PeerError(f"{type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class Peer:
    """
    Other program, installed as a Python module, that computes reference numbers which the file leaves out.

    Attributes
    ----------
    module : str
        Module that is imported.
    install : str
        Command that installs it.
    ask : callable
        Returns its number of a row. Calls of the program stand in blocks of `others`.
    """

    module: str
    install: str
    ask: Asked

    @property
    def installed(self) -> bool:
        """True if the program's Python module can be imported."""
        return importlib.util.find_spec(self.module) is not None


@dataclass(frozen=True)
class Pack:
    """
    Reference numbers from one source, and the functions that compute the numbers to compare.

    Attributes
    ----------
    name : str
        Name for `--only`, and of its file among the references.
    numbers : callable
        Makes the function that returns our number of a row.
    peer : Peer, optional
        Program that is asked for the numbers that the file has not.
    """

    name: str
    numbers: Numbers
    peer: Peer | None = None

    @cached_property
    def file(self) -> ReferenceFile:
        """Reference numbers and their conditions, read from the pack's TOML file."""
        return read_reference(Path(str(files("mistray.analyses.validate").joinpath("references", f"{self.name}.toml"))))

"""What the parts of the attack are, what they found before anything was mended, and what one of their cases is."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from fuzzing import LONGEST

COMMIT = "87e22f8"
# Part: tried and failed at that commit, and what failed. "entries": the rest was believed
BEFORE = {
    "options": (853, 11, "10 tracebacks of --option=--, image --grid 1000 above 60 s"),
    "xml": (780, 0, "some empty floats read as 0"),
    "numbers": (42, 4, "empty and blank floats, an empty translate, w = 0 in a matrix"),
    "files": (60, 1, "a lens of 5000 surfaces above 25 s"),
    "bombs": (16, 3, "includes, parameters, a grid"),
    "kills": (48, 0, "18 of 20 left drafts"),
    "renames": (3, 3, "folders of old and new files"),
    "interrupts": (68, 0, ""),
    "first_second": (20, 10, "tracebacks"),
    "surroundings": (45, 4, "stderr closed twice, a deleted folder, --out ''"),
    "entries": (37, 6, "tracebacks"),
    "requests": (217, 1, "a length of 5000 digits"),
    "limits": (6, 5, "161 fields at 10 s took 88 s"),
}

GUTS = re.compile(r"Traceback|\.cpp:|\.h:\d|jit_init|recursion depth|object is not|has no attribute|unexpected keyword")
NUMERIC = re.compile(r"RuntimeWarning|overflow encountered|invalid value encountered|divide by zero")


@dataclass(frozen=True)
class Case:
    """
    One try.

    Attributes
    ----------
    name : str
    run : callable
        Gives what failed, empty if nothing did.
    """

    name: str
    run: Callable[[], str]


@dataclass
class Answer:
    """
    What came of a command, a scene or a file in a worker.

    Attributes
    ----------
    code : int or None
        Exit code; None if the process ended, or was ended.
    out, err : str
    raised : str
        An exception that came out.
    seconds : float
        Of the processor, so that other processes do not count; of the clock if the process has ended.
    peak_MB : float
    """

    code: int | None
    out: str = ""
    err: str = ""
    raised: str = ""
    seconds: float = 0.0
    peak_MB: float = 0.0

    def failure(self, seconds: float = 60.0, megabytes: float = 6000.0) -> str:
        """What is wrong with it; the input is read, or refused in one clear line."""
        said = self.err.strip()
        if self.raised:
            return f"raised {self.raised}"
        if self.code is None:
            return f"the process ended, or took more than {seconds:g} s: {said[-300:]}"
        if self.code not in (0, 1, 2):
            return f"exit code {self.code}: {said[-300:]}"
        if GUTS.search(said) or NUMERIC.search(said):
            return f"the inside of a program: {said[-300:]}"
        if self.code == 2:
            lines = [line for line in said.splitlines() if line.startswith("mistray: error: ")]
            if len(lines) != 1 or not lines[0].isprintable() or len(lines[0]) > LONGEST:
                return f"no clear line: {said[:300]!r}"
        if self.peak_MB > megabytes:
            return f"took {self.peak_MB:.0f} MB"
        return f"took {self.seconds:.0f} s" if self.seconds > seconds else ""


def finite(text: str) -> str:
    """What is wrong with the JSON of a command."""
    try:
        json.loads(text, parse_constant=_refuse)
    except ValueError as error:
        return f"its JSON is none: {error}"
    return ""


def _refuse(name: str) -> Any:
    raise ValueError(name)


def some(cases: Iterator[Case] | list[Case], count: int, seed: int) -> list[Case]:
    """So many of the cases, by the seed, in their order."""
    found = list(cases)
    chosen = sorted(random.Random(seed).sample(range(len(found)), min(count, len(found))))
    return [found[k] for k in chosen]

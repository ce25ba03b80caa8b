"""Nasty numbers for every numeric option of every command, and for every number of every plugin.

Options come from the parsers, and parameters from the tables of the plugins' manual: what is new is tried by itself.
Tries run in a worker of their own, `python number_fuzz.py`, which answers one line of JSON for each line of arguments,
so that a hang or a crash ends the worker and not the tests.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import math
import os
import resource
import select
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzzing import unclear

NASTY = ("nan", "inf", "-inf", "0", "-0.0", "-1", "1e-308", "1e308", "1e-30", "1e30", "2147483648", "0.5", "abc")
NASTY_XML = ("nan", "inf", "-inf", "0", "-1", "1e-308", "1e308", "1e-30", "1e30", "2147483648", "0.5")
LIMIT_S = 10.0  # of processor time, which does not grow with the load of the machine
STOP_S = 2.0 * (os.cpu_count() or 1)  # of processor time, all cores at work: an interrupt ends a command in 2 s
STUCK_S = 120.0  # after which a worker is ended
MEMORY = 6 << 30  # bytes beyond those of the worker at its start

# Options without a type of their own that hold numbers
TEXTS = {"cut_below": "R={}", "cut_below_W": "R={}", "coefficients": "c000={}", "particle": "{}+0.002i",
         "space": "*={}", "front": "{}", "back": "{}"}  # fmt: skip
WORK = ("--rays",)  # what takes as long as is asked for, and is stopped as by Ctrl-C: 2³¹ rays are a wish, no slip

WAITING = (("app", "--seconds"),)  # what waits as long as is asked for


@dataclass(frozen=True)
class Try:
    """A command line with one nasty number, or a scene with one: then `argv` is its text."""

    command: str
    option: str
    value: str
    argv: tuple[str, ...]


def parsers() -> dict[str, argparse.ArgumentParser]:
    """The parsers of all commands."""
    from mistray.cli import program

    choices: dict[str, argparse.ArgumentParser] = program._parser()._subparsers._group_actions[0].choices  # type: ignore[assignment,union-attr]
    for parser in choices.values():
        parser.declare_all()  # type: ignore[attr-defined]
    return choices


def numeric(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The options of a command that take numbers."""
    return [
        action
        for action in parser._actions
        if action.option_strings
        and action.help != argparse.SUPPRESS
        and action.nargs != 0
        and action.choices is None
        and (action.dest in TEXTS or action.type not in (None, str, Path))
    ]


def words_of(action: argparse.Action, value: str) -> Iterator[tuple[str, ...]]:
    """The values of an option with a nasty number at each of its places."""
    label = action.metavar if isinstance(action.metavar, str) else ""
    text = TEXTS.get(action.dest) or ("x={}" if "=" in label else "{}")
    count = action.nargs if isinstance(action.nargs, int) else 1
    for place in range(count):
        yield tuple(text.format(value if place == k else "1") for k in range(count))


def tries(lines: Mapping[str, Iterable[str]], about: Mapping[tuple[str, str], Iterable[str]]) -> list[Try]:
    """
    Every numeric option of every command with every nasty value.

    Parameters
    ----------
    lines : mapping of str to iterable of str
        Command → arguments with which it does little; a command that is not here is not tried.
    about : mapping of (str, str) to iterable of str
        Command and option → what must stand beside the option; the command "*" holds for all.
    """
    found = []
    for command, parser in parsers().items():
        for action in numeric(parser) if command in lines else ():
            option = action.option_strings[-1]
            if (command, option) in WAITING:
                continue
            beside = about.get((command, option), about.get(("*", option), lines[command]))
            for value in NASTY:
                for words in words_of(action, value):
                    # "=" for numbers that look like options; argparse takes the words after it as well
                    given = (f"{option}={words[0]}",) if len(words) == 1 else (option, *words)
                    found.append(Try(command, option, value, (command, *beside, *given)))
    return found


def nothing(value: Any, path: str = "") -> Iterator[str]:
    """Places of a JSON document where null or something not finite stands; indices are left out."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from nothing(item, f"{path}.{key}")
    elif isinstance(value, list):
        for item in value:
            yield from nothing(item, f"{path}[]")
    elif value is None or (isinstance(value, float) and not math.isfinite(value)):
        yield path


def nothing_in_csv(path: Path) -> Iterator[str]:
    """Columns of a CSV file where nan or inf stands."""
    rows = list(csv.reader(line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")))
    for row in rows[1:]:
        for name, cell in zip(rows[0], row, strict=False):
            if cell.strip().lower() in ("nan", "inf", "-inf"):
                yield f"{path.name}:{name}"


def run_one(argv: list[str], out: Path | None, limit_s: float) -> dict[str, Any]:
    """One command line in this process: its exit code or exception, seconds, and where its output holds nothing."""
    from mistray.cli.program import main

    def late(number: int, frame: object) -> None:
        """As Ctrl-C, which a command answers by itself."""
        signal.raise_signal(signal.SIGINT)

    printed, complained = io.StringIO(), io.StringIO()
    error, code = "", None
    signal.signal(signal.SIGPROF, late)
    began = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(complained), warnings.catch_warnings():
            warnings.simplefilter("default")
            code = main(argv)
    except BaseException as caught:
        last = traceback.extract_tb(caught.__traceback__)[-1]
        error = f"{type(caught).__name__}: {str(caught)[:200]} ({Path(last.filename).name}:{last.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    seconds = time.process_time() - began
    if seconds > limit_s:
        error = f"late: {seconds:.1f} s"
    absent: list[str] = []
    if code == 0:
        with contextlib.suppress(ValueError):
            absent += nothing(json.loads(printed.getvalue()))
        for file in sorted(out.rglob("*.csv")) if out is not None else ():
            absent += nothing_in_csv(file)
    said = complained.getvalue()
    return {"code": code, "error": error, "seconds": seconds, "said": said, "absent": sorted(set(absent))}


class Worker:
    """A process that runs command lines one after the other; a new one after a hang or a crash."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: subprocess.Popen[str] | None = None

    def run(self, argv: Iterable[str], out: Path | None = None, limit_s: float = LIMIT_S) -> dict[str, Any]:
        """The answer of `run_one`; its error is "hang" or "crash" where there was none."""
        if self.process is None:
            environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parent)}
            self.process = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=self.folder, env=environment,
            )  # fmt: skip
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps([list(argv), None if out is None else str(out), limit_s]) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], STUCK_S)
        line = process.stdout.readline() if ready else ""
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        self.close()
        error = "hang" if not ready else f"crash: exit status {process.returncode}"
        return {"code": None, "error": error, "seconds": STUCK_S, "said": "", "absent": []}

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


def table(outcomes: Iterable[tuple[str, str]]) -> str:
    """Counts of (command, outcome), one line for each command."""
    counts: dict[str, Counter[str]] = {}
    for command, outcome in outcomes:
        counts.setdefault(command, Counter())[outcome] += 1
    heads = ("tries", "exit 0", "exit 2", "stopped", "exceptions", "hangs", "nothing")
    lines = [f"{'':16}" + "".join(f"{head:>12}" for head in heads)]
    whole = sum(counts.values(), Counter())
    for command, count in [*counts.items(), ("all", whole)]:
        numbers = (count.total(), *(count[head] for head in heads[1:]))
        lines.append(f"{command:16}" + "".join(f"{number:12d}" for number in numbers))
    return "\n".join(lines)


def outcome_of(answer: Mapping[str, Any], usual: Iterable[str], work: bool = False) -> tuple[str, str]:
    """
    Kind of outcome, and what is wrong; "" if nothing is.

    Parameters
    ----------
    answer : mapping
        Of `run_one`.
    usual : iterable of str
        Places where null may stand.
    work : bool
        Whether it may take long, if it ends soon after an interrupt.
    """
    stopped = work and answer["code"] == 130 and answer["seconds"] < LIMIT_S + STOP_S
    if answer["error"].startswith(("late", "hang")) and not stopped:
        return "hangs", answer["error"]
    if answer["error"] and not stopped:
        return "exceptions", answer["error"]
    absent = [place for place in answer["absent"] if place not in usual]
    if answer["code"] == 0 and absent:
        return "nothing", ", ".join(absent[:4])
    if stopped:
        return "stopped", ""
    said = answer["said"].strip().rpartition("\n")[2].removeprefix("mistray: error: ")
    wrong = "" if answer["code"] == 0 else unclear(said) if answer["code"] == 2 else said
    return f"exit {answer['code']}", wrong or ""


def serve() -> None:
    """Answer lines of stdin."""
    import mistray.trace
    from mistray import set_threads

    assert mistray.trace
    set_threads(1)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        argv, out, limit_s = json.loads(line)
        print(json.dumps(run_one(argv, None if out is None else Path(out), limit_s)), file=answers, flush=True)


if __name__ == "__main__":
    serve()

"""Nasty words for every option of every command and number of every plugin, and the process in which they are tried.

Options come from the parsers, and parameters from the tables of the plugins' manual: what is new is tried by itself.
The worker, `python number_fuzz.py`, answers one line of JSON for each line of arguments, so that a hang or a crash ends
the worker and not the tests.
"""

import argparse
import contextlib
import importlib
import io
import json
import math
import os
import re
import resource
import select
import signal
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

from fuzzing import unclear

from mistray.toolkit.arguments import place

NASTY = ("nan", "inf", "-inf", "0", "-0.0", "-1", "1e-308", "1e308", "1e-30", "1e30", "2147483648", "0.5", "abc")
NASTY_XML = ("nan", "inf", "-inf", "0", "-1", "1e-308", "1e308", "1e-30", "1e30", "2147483648", "0.5")
WORDS = ("", " ", "--", "9" * 20, "0x10", "1,5", "1:2", "½", "a" * 5000, "\x1b[2J", "../../etc/passwd")
LIMIT_S = 10.0  # of processor time, which does not grow with the load of the machine
STOP_S = 2.0 * (os.cpu_count() or 1)  # of processor time, all cores at work: an interrupt ends a command in 2 s
STUCK_S = 120.0  # after which a worker is ended
MEMORY = 6 << 30  # bytes beyond those of the worker at its start
GUTS = re.compile(r"Traceback|\.cpp:|\.h:\d|jit_init|recursion depth|object is not|has no attribute|unexpected keyword"
                  "|RuntimeWarning|overflow encountered|invalid value encountered|divide by zero")  # fmt: skip
CLOSURE = re.compile(r'"closure": ([-+.e\d]+)')

# Options without a type of their own that hold numbers
TEXTS = {"cut_below": "R={}", "cut_below_W": "R={}", "coefficients": "c000={}", "particle": "{}+0.002i",
         "space": "*={}", "front": "{}", "back": "{}"}  # fmt: skip
WORK = ("--rays",)  # what takes as long as is asked for, and is stopped as by Ctrl-C: 2³¹ rays are a wish, no slip
# What waits as long as is asked for or for other machines, or is of the machine
LEFT_OUT = (("app", "--seconds"), ("*", "--scheduler"), ("*", "--port"), ("*", "--variant"), ("*", "--state"))


@dataclass(frozen=True)
class Try:
    """A command line with one nasty word, or a scene with one: then `argv` is its text."""

    command: str
    option: str
    value: str
    argv: tuple[str, ...]


def parsers() -> dict[str, argparse.ArgumentParser]:
    from mistray.cli import program

    choices: dict[str, argparse.ArgumentParser] = program._parser()._subparsers._group_actions[0].choices  # type: ignore[assignment,union-attr]
    for parser in choices.values():
        parser.declare_all()  # type: ignore[attr-defined]
    return choices


def numeric(parser: argparse.ArgumentParser, numbers: bool = True) -> list[argparse.Action]:
    """The options of a command that take numbers, or those that take other words."""
    return [
        action
        for action in parser._actions
        if action.option_strings
        and action.help != argparse.SUPPRESS
        and action.nargs != 0
        and action.choices is None
        and (action.dest in TEXTS or action.type not in (None, str, Path, place)) is numbers
    ]


def words_of(action: argparse.Action, value: str) -> Iterator[tuple[str, ...]]:
    """The values of an option with a nasty word at each of its places."""
    label = action.metavar if isinstance(action.metavar, str) else ""
    text = TEXTS.get(action.dest) or ("x={}" if "=" in label else "{}")
    count = action.nargs if isinstance(action.nargs, int) else 1
    for at in range(count):
        yield tuple(text.format(value if at == k else "1") for k in range(count))


def tries(lines: Mapping[str, Iterable[str]], about: Mapping[tuple[str, str], Iterable[str]]) -> list[Try]:
    """Every numeric option of the commands of `lines` with every nasty number, every other one with every nasty word.

    `about` has for a command, or "*", and an option what must stand beside it instead of the line of the command.
    """
    found = []
    for command, parser in parsers().items():
        actions = [(action, NASTY) for action in numeric(parser)] + [(one, WORDS) for one in numeric(parser, False)]
        for action, values in actions if command in lines else ():
            option = action.option_strings[-1]
            if not {(command, option), ("*", option)}.isdisjoint(LEFT_OUT):
                continue
            beside = about.get((command, option), about.get(("*", option), lines[command]))
            for value in values:
                for words in words_of(action, value):
                    # "=" for numbers that look like options; argparse takes the words after it as well
                    given = (f"{option}={words[0]}",) if len(words) == 1 else (option, *words)
                    found.append(Try(command, option, value, (command, *beside, *given)))
    return found


def nothing(value: Any, path: str = "") -> Iterator[str]:
    """Places of a JSON document where null or something not finite stands; indices are left out."""
    if isinstance(value, dict | list):
        ends = [f".{key}" for key in value] if isinstance(value, dict) else ["[]"] * len(value)
        for end, item in zip(ends, value.values() if isinstance(value, dict) else value, strict=True):
            yield from nothing(item, path + end)
    elif value is None or (isinstance(value, float) and not math.isfinite(value)):
        yield path


# ---- what the worker does beside commands


def load_scene(path: Path) -> None:
    """All that comes before the first ray; a scene that gets so far has a place and a size."""
    import numpy as np

    from mistray.execute.tracer import prepare
    from mistray.scene import load
    from mistray.settings import Settings

    scene = load(path)
    prepare(scene, Settings.of(scene))
    box = scene.bbox()
    if not (np.isfinite(np.array(box.min)).all() and np.isfinite(np.array(box.max)).all()):
        raise ArithmeticError(f"the scene reaches from {box.min} to {box.max}")


def read_coatings(path: Path) -> None:
    """Evaluate every coating of a file; of those that cannot be, one that is not told clearly comes first."""
    from mistray.coatings import read_coating_file, spectrum
    from mistray.errors import MistrayError

    file = read_coating_file(path)
    wrong = None
    for name in file:
        try:
            spectrum(file[name], [550.0], [0.0, 45.0], "air", "N-BK7")
        except MistrayError as error:
            wrong = error if wrong is None or unclear(str(error)) else wrong
    if wrong is not None:
        raise wrong


def read_lamp(path: Path) -> None:
    importlib.import_module("mistray.files.intensities").read_intensities(path)


JOBS: dict[str, Callable[[Path], None]] = {"load": load_scene, "coatings": read_coatings, "lamp": read_lamp}


def _run(argv: list[str]) -> int:
    from mistray.cli.program import main
    from mistray.errors import MistrayError

    if argv[0] not in JOBS:
        return main(argv)
    try:
        JOBS[argv[0]](Path(argv[1]))
    except MistrayError as error:
        print(f"mistray: error: {error}", file=sys.stderr)
        return 2
    return 0


def run_one(argv: list[str], limit_s: float, strict: bool = False) -> dict[str, Any]:
    """One command line or job in this process: its code or exception, seconds, and where its output holds nothing."""

    def late(number: int, frame: object) -> None:
        """As Ctrl-C, which a command answers by itself."""
        signal.raise_signal(signal.SIGINT)

    printed, complained = io.StringIO(), io.StringIO()
    error, code = "", None
    signal.signal(signal.SIGPROF, late)
    began = process_time()
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(complained), warnings.catch_warnings():
            warnings.simplefilter("error" if strict else "default")
            code = _run(argv)
    except BaseException as caught:
        last = traceback.extract_tb(caught.__traceback__)[-1]
        error = f"{type(caught).__name__}: {str(caught)[:200]} ({Path(last.filename).name}:{last.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    seconds = process_time() - began
    if seconds > limit_s:
        error = f"late: {seconds:.1f} s"
    lost = max((abs(float(word)) for word in CLOSURE.findall(printed.getvalue())), default=0.0)
    if lost > 1e-3:
        error = f"energy is lost: {lost:.1e}"
    absent: set[str] = set()
    if code == 0:
        with contextlib.suppress(ValueError):
            absent |= set(nothing(json.loads(printed.getvalue())))
    return {"code": code, "error": error, "seconds": seconds, "said": complained.getvalue(), "absent": sorted(absent),
            "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000}  # fmt: skip


class Worker:
    """A process that runs command lines one after the other; a new one after a hang or a crash."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: subprocess.Popen[str] | None = None

    def run(self, argv: Iterable[str], limit_s: float = LIMIT_S, strict: bool = False) -> dict[str, Any]:
        """The answer of `run_one`, whose error is "hang" or "crash" where there was none, and what libraries print."""
        log = self.folder / "worker.log"
        if self.process is None:
            environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parent),
                                        "MISTRAY_CACHE": str(self.folder / "cache")}  # fmt: skip
            with log.open("w") as file:
                self.process = subprocess.Popen(
                    [sys.executable, __file__], text=True, cwd=self.folder, env=environment,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=file,
                )  # fmt: skip
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        before = log.stat().st_size
        process.stdin.write(json.dumps([list(argv), limit_s, strict]) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], STUCK_S)
        line = process.stdout.readline() if ready else ""
        chatter = log.read_bytes()[before:].decode(errors="replace")
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer | {"chatter": chatter}
        self.close()
        error = f"{'hang' if ready == [] else f'crash: exit status {process.returncode}'} {chatter[-300:]}"
        return {"code": None, "error": error, "seconds": STUCK_S, "said": "", "absent": [], "chatter": ""}

    def close(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


def complaint(answer: Mapping[str, Any], usual: Iterable[str] = (), work: bool = False) -> str:
    """What is wrong with an answer of `Worker.run`; "" if it is a result, or refused in one clear line.

    Null may stand at the places that are `usual`; what is `work` may take long, if it ends soon after an interrupt.
    """
    if work and answer["code"] == 130 and answer["seconds"] < LIMIT_S + STOP_S:
        return ""
    said = answer["said"].strip()
    if answer["error"] or GUTS.search(said):
        return answer["error"] or f"the inside of a program: {said[-300:]}"
    if answer["code"] == 0:
        return ", ".join([place for place in answer["absent"] if place not in usual][:4])
    if answer["code"] != 2:
        return f"exit code {answer['code']}: {said[-300:]}"
    last = said.splitlines()[-1] if said else ""
    if said.count("mistray: error: ") != 1 or not last.startswith("mistray: error: "):
        return f"not one line at the end: {said[:300]!r}"
    return unclear(last.removeprefix("mistray: error: ")) or ""


def serve() -> None:
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
        print(json.dumps(run_one(*json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    serve()

"""A process that runs commands, scenes and files one after another, and is started anew when one of them ends it."""

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import resource
import secrets
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from attack.parts import Answer

ROOM = 24 << 30  # bytes of address space
WAITING = 5.0  # times the limit of seconds, of which a job has less where other processes run


class Worker:
    """
    Runs jobs in a process of its own.

    Parameters
    ----------
    folder : Path
        In which it works.
    **surroundings
        Variables of the environment.
    """

    def __init__(self, folder: Path, **surroundings: str) -> None:
        self.folder, self._surroundings = folder, surroundings
        self._process: Any = None
        self._pipe: Any = None

    def ask(self, kind: str, *given: Any, seconds: float = 60.0, fresh: bool = False) -> Answer:
        """The answer to one job; `fresh` for one whose memory is measured."""
        if fresh:
            self.close()
        if self._process is None or not self._process.is_alive():
            self._start()
        began = time.monotonic()
        try:
            self._pipe.send((kind, given))
            if self._pipe.poll(WAITING * seconds + 60.0):  # the start takes some seconds as well
                answer: Answer = self._pipe.recv()
                return answer
        except (EOFError, OSError):
            pass
        self.close()
        return Answer(None, err=self._log()[-500:], seconds=time.monotonic() - began)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._file = str(self.folder / f"log_{secrets.token_hex(4)}")
        self._process = context.Process(
            target=_serve, args=(there, self.folder, self._file, self._surroundings), daemon=True
        )
        self._process.start()
        there.close()

    def _log(self) -> str:
        return Path(self._file).read_text(errors="replace") if os.path.exists(self._file) else ""


def _serve(pipe: Connection, folder: Path, log: str, surroundings: dict[str, str]) -> None:
    os.environ.update(surroundings)
    os.chdir(folder)
    for number, name in ((1, f"{log}.out"), (2, log)):
        os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
    resource.setrlimit(resource.RLIMIT_AS, (ROOM, resource.RLIM_INFINITY))
    jobs = {"command": _command, "scene": _scene, "reader": _reader}
    while True:
        kind, given = pipe.recv()
        for number in (1, 2):
            os.ftruncate(number, 0)
            os.lseek(number, 0, os.SEEK_SET)
        began, code, raised = time.process_time(), 0, ""
        try:
            code = jobs[kind](*given)
        except BaseException as error:
            raised = f"{type(error).__name__}: {str(error)[:300]}"
        out, err = (Path(name).read_text(errors="replace") for name in (f"{log}.out", log))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
        pipe.send(Answer(code, out, err[:4000], raised, time.process_time() - began, peak))


def _command(words: list[str]) -> int:
    from mistray.cli import main

    return main(words)


def _scene(text: str, name: str) -> int:
    """Load and trace a scene; 2 if it is refused, 0 if it is traced and all numbers are finite and close."""
    import mistray

    Path(name).write_text(text, encoding="utf-8")
    try:
        t = mistray.trace(mistray.load(name), rays=20, max_reflections=1, max_events=32)
    except mistray.MistrayError as error:
        print(f"mistray: error: {error}", file=sys.stderr, flush=True)
        return 2
    numbers = [t.energy.launched_W, t.energy.detected_W, t.energy.closure, t.energy.detected_se_W]
    if not all(math.isfinite(float(number)) for number in numbers):
        raise ArithmeticError(f"numbers that are none: {numbers}")
    if abs(float(t.energy.closure)) > 1e-3:
        raise ArithmeticError(f"energy is lost: closure {t.energy.closure}")
    print(float(t.energy.detected_W), flush=True)
    return 0


def _reader(where: str, name: str) -> int:
    """Read a file by a public function, such as "mistray.files.intensities:read_intensities"."""
    from mistray.errors import MistrayError

    module, _, function = where.partition(":")
    try:
        getattr(importlib.import_module(module), function)(name)
    except MistrayError as error:
        print(f"mistray: error: {error}", file=sys.stderr, flush=True)
        return 2
    return 0

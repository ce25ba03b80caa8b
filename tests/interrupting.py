"""A signal to a command: how the command ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

MISTRAY = [sys.executable, "-m", "mistray"]
LIMIT_S = 2.0  # from the signal to the end of the process


@dataclass(frozen=True)
class End:
    """
    How a command has ended.

    Attributes
    ----------
    number : Signals
        That it got.
    code : int or None
        Its exit code; None: it was killed after a minute.
    seconds : float
        From the signal on.
    err : str
        Its stderr.
    """

    number: signal.Signals
    code: int | None
    seconds: float
    err: str

    @property
    def problem(self) -> str:
        """What is wrong with it; empty if nothing is."""
        lines = [line for line in self.err.splitlines() if "interrupted" in line]
        if self.code != 128 + self.number:
            return f"exit code {self.code}: {self.err[-300:]}"
        if len(lines) != 1 or not lines[0].startswith("mistray: interrupted") or "Traceback" in self.err:
            return f"not one line: {self.err[-300:]}"
        return f"{self.seconds:.1f} s" if self.seconds > LIMIT_S else ""


def interrupted(
    command: Sequence[str],
    number: signal.Signals,
    wait: Callable[[subprocess.Popen[str]], object],
    folder: Path | None = None,
) -> End | None:
    """Send a signal to a command after a wait; None if it has ended before."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=folder)
    wait(process)
    if process.poll() is not None:
        process.communicate()
        return None
    process.send_signal(number)
    sent = time.monotonic()
    try:
        _, err = process.communicate(timeout=60)
        code: int | None = process.returncode
    except subprocess.TimeoutExpired:
        process.kill()
        _, err = process.communicate()
        code = None
    return End(number, code, time.monotonic() - sent, err)


def worker(process: subprocess.Popen[str]) -> int:
    """Id of the process that does the work of a command, once there is one."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None:
        if found := children.read_text().split():
            return int(found[0])
        time.sleep(0.001)
    return process.pid


def begun(process: subprocess.Popen[str]) -> None:
    """Wait until `mistray.__main__` runs."""
    worker(process)

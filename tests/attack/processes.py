"""Parts whose cases are processes of their own: interrupted, in strange surroundings, asked too much."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fuzz_scenes import LINES, SMALL
from number_fuzz import GUTS, Worker

MISTRAY = [sys.executable, "-m", "mistray"]
LIMIT_S = 2.0  # from the signal to the end of the process


@dataclass(frozen=True)
class End:
    """How a command has ended: its exit code, None where it was killed, seconds from the signal on, and stderr."""

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


_started = worker  # the cases have workers of their own
Cases = dict[str, Callable[[], str]]
LATEST_S = 8.0
# Command lines that run for long, where a command can: the last one of an option counts
LONG = {"image": ("--grid", "1000"), "app": ("--seconds", "1000")}
MANY = ("--rays", "4e9")
COMMANDS = {
    name: (name, *line, *LONG.get(name, MANY if line[-2:] == SMALL else ())) for name, line in LINES.items()
} | {
    "one thread": ("ghosts", "cooke_triplet", *MANY, "--threads", "1"),
    "scatter": ("pst", "phone_camera_scatter", *MANY),
    "forward": ("pst", "phone_camera_scatter", "--method", "forward", *MANY),
    "image of a lens": ("image", "double_gauss", "--grid", "1000"), "doctor": ("doctor",),
}  # fmt: skip


def interrupts(worker: Worker, seed: int) -> Cases:
    """Ctrl-C or SIGTERM at a random time, four times for each command, and 20 times in the first second of one."""
    rng = random.Random(seed)

    def run(name: str, number: signal.Signals, after_s: float) -> str:
        def wait(process: subprocess.Popen[str]) -> None:
            _started(process)
            time.sleep(after_s)

        end = interrupted([*MISTRAY, *COMMANDS[name]], number, wait, worker.folder)
        return "" if end is None else end.problem

    cases = [(name, rng.uniform(0.0, LATEST_S)) for name in COMMANDS for _ in range(4)]
    cases += [("one thread", 0.05 * k) for k in range(20)]
    return {
        f"{name} after {after_s:.2f} s": partial(run, name, (signal.SIGINT, signal.SIGTERM)[k % 2], after_s)
        for k, (name, after_s) in enumerate(cases)
    }


DELETED = "mkdir gone; cd gone; rmdir ../gone;"
RESULT = '"fields"'
# Line with {}, where the command stands; exit code, and what stands on stdout and on stderr
PLACES = {
    '{} --out ""': (2, "", "names nothing"), "{} 2>&-": (0, RESULT, ""), "{} >&-": (0, "", ""),
    "{} <&-": (0, RESULT, ""), "{} >&- 2>&-": (0, "", ""), "{} <&- >&- 2>&-": (0, "", ""),
    "{} > /dev/full": (2, "", "No space left"), "{} | head -c 1": (0, "{", ""), "{} 2> /dev/full": (0, RESULT, ""),
    "env -u HOME {}": (0, RESULT, ""), f"{DELETED} {{}}": (2, "", "working folder was deleted"),
    f"{DELETED} {{mistray}} pst plate": (2, "", "working folder was deleted"),
    f"{DELETED} {{mistray}} import lens.zmx": (2, "", "working folder was deleted"),
    f"{DELETED} {{mistray}} bsdf abg --A 0.01 --B 0.01 --g 2": (2, "", "working folder was deleted"),
    "{mistray} ghosts nothing 2>&-": (2, "", ""), "ulimit -n 20; {}": (None, "", ""),
    "ulimit -c 0; {}": (0, RESULT, ""), "ulimit -f 8; {} --out small": (None, "", ""),
    "mkdir -p r; chmod 555 r; cd r; {}": (0, RESULT, ""),
    "{} --force --out streams 2>&-": (0, RESULT, ""),
}  # fmt: skip
VALUES = {
    "COLUMNS": ("0", "-1", "x"), "PYTHONIOENCODING": ("ascii", "latin-1", "utf-16"),
    "MPLBACKEND": ("", "nonsense", "agg"),
}  # fmt: skip
VARIABLES = ("LC_ALL", "PYTHONIOENCODING", "TERM", "COLUMNS", "TZ", "MPLBACKEND", "MPLCONFIGDIR", "XDG_CACHE_HOME",
             "TMPDIR", "MISTRAY_CACHE")  # fmt: skip


def surroundings(worker: Worker, seed: int) -> Cases:
    """Locales, homes, streams, terminals, folders and limits."""
    folder, mistray = worker.folder, " ".join(MISTRAY)
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(line: str, code: int | None, printed: str, told: str) -> str:
        command = line.format(f"{mistray} ghosts plate --rays 50 --json", mistray=mistray)
        before = {path.name for path in folder.iterdir()}
        try:
            done = subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, timeout=300, env=env)
        except subprocess.TimeoutExpired:
            return "no end within 300 s"
        out, err = done.stdout.decode(errors="replace").replace("\0", ""), done.stderr.decode(errors="replace")
        new = {path.name for path in folder.iterdir()} - before - {"r", "small", "streams", "C"}
        if done.returncode not in ((0, 2) if code is None else (code,)):
            return f"exit code {done.returncode}: {err[-200:]}"
        if GUTS.search(err) or "Fatal" in err or (done.returncode == 2 and err.count("mistray: error") > 1):
            return f"the inside of a program: {err[-200:]}"
        if printed not in out or told not in err or "mistray: " in out:
            return f"{out[:100]!r} and {err[-200:]!r}"
        return f"it left {sorted(new)}" if new else ""

    lines = {
        f"{name}='{value}' {{}}": (0, RESULT, "")
        for name in VARIABLES
        for value in VALUES.get(name, ("", "C", "/proc/nobody"))
    }
    return {line: partial(run, line, *given) for line, given in (lines | PLACES).items()}

"""Ctrl-C and SIGTERM end a command within two seconds, with one line and 130 or 143, whatever it is at."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from interrupting import LIMIT_S, MISTRAY, begun, interrupted, main, worker

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the supervisor needs fork and sigtimedwait")

# A command that is in C code for good and holds the interpreter's lock, as Mitsuba's parser does for a time
DEAF = """
import itertools, sys
sys.argv = sys.orig_argv = ["mistray", "coat", "lens.xml", "-o", "coated.xml"]
from mistray.supervisor import supervise

def deaf():
    supervise()
    from mistray.cli import main, program
    def run(_):
        print("deaf", flush=True)
        all(itertools.repeat(True))
    program._command = run
    return main()

sys.exit(deaf())
"""
SLACK_S = 2.0  # other programs use the machine, too


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_hears_nothing_ends(number: signal.Signals) -> None:
    process = subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "deaf\n"
    time.sleep(0.3)
    process.send_signal(number)
    sent = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - sent < LIMIT_S + SLACK_S
    assert (process.returncode, err) == (128 + number, "mistray: interrupted\n")


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.03, 0.1, 0.3])
def test_a_signal_while_modules_are_imported(after_s: float) -> None:
    def wait(process: subprocess.Popen[str]) -> None:
        begun(process)
        time.sleep(after_s)

    end = interrupted([*MISTRAY, "ghosts", "plate", "--rays", "1e9"], signal.SIGINT, wait)
    assert end is not None
    assert end.problem == "" or end.seconds < LIMIT_S + SLACK_S, end
    assert end.code == 130, end
    assert end.err.count("\n") == 1, end


def test_an_ignored_interrupt_stays_ignored() -> None:
    """As of a job in the background of a script."""
    command = ["sh", "-c", f"trap '' INT; exec {sys.executable} -m mistray doctor --json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert "interrupted" not in err
    assert out.startswith("{")


def test_the_work_ends_with_a_process_that_is_killed() -> None:
    process = subprocess.Popen([*MISTRAY, "ghosts", "plate", "--rays", "4e9"], stderr=subprocess.DEVNULL)
    child = Path(f"/proc/{worker(process)}")  # type: ignore[arg-type]
    time.sleep(0.3)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    until = time.monotonic() + 5
    while child.exists() and child.joinpath("stat").read_text().rsplit(")", 1)[1].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_command_that_is_killed_says_so_by_its_status() -> None:
    """What the system does to the process that works, as where memory is short, is the end of the command as well."""
    process = subprocess.Popen([*MISTRAY, "ghosts", "plate", "--rays", "4e9"], stderr=subprocess.DEVNULL)
    subprocess.run(["kill", "-KILL", str(worker(process))], check=True)
    assert process.wait(timeout=10) == -signal.SIGKILL


SHADOW = """
import os, signal, sys
os.kill(os.getpid(), signal.SIGINT)
sys.path.remove(os.path.dirname(__file__))
del sys.modules["glob"]
import glob
"""


def test_while_the_package_is_imported(tmp_path: Path) -> None:
    """Python imports the package before `mistray.__main__`; the signal comes with a module that it needs."""
    (tmp_path / "glob.py").write_text(SHADOW)
    done = subprocess.run(
        [*MISTRAY, "ghosts", "plate", "--rays", "100"], env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "mistray: interrupted, nothing was written\n"


@pytest.mark.slow
def test_signals_at_random_moments() -> None:
    """Four for each command, and 20 in the first second."""
    assert main(4) == 0

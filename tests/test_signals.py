"""Ctrl-C and SIGTERM end a command within two seconds, with one line and 130 or 143, whatever it is at."""

import importlib
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from unittest.mock import Mock

import pytest
from attack.processes import LIMIT_S, MISTRAY, interrupted, worker
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import plates_text, scene_text, write

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
    process = Popen([sys.executable, "-c", DEAF], stdout=PIPE, stderr=PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "deaf\n"
    time.sleep(0.3)
    process.send_signal(number)
    sent = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - sent < LIMIT_S + SLACK_S
    assert (process.returncode, err) == (128 + number, "mistray: interrupted\n")


def test_an_ignored_interrupt_stays_ignored() -> None:
    """As of a job in the background of a script."""
    command = ["sh", "-c", f"trap '' INT; exec {sys.executable} -m mistray doctor --json"]
    process = Popen(command, stdout=PIPE, stderr=PIPE, text=True)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (out[:1], "interrupted" in err) == ("{", False)


def test_the_work_and_its_process_end_together() -> None:
    """What the system does to the process that works, as where memory is short, is the end of the command as well."""
    process, other = (Popen([*MISTRAY, "ghosts", "plate", "--rays", "4e9"], stderr=DEVNULL) for _ in range(2))
    os.kill(worker(other), signal.SIGKILL)
    assert other.wait(timeout=10) == -signal.SIGKILL
    child = Path(f"/proc/{worker(process)}")
    time.sleep(0.3)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    until = time.monotonic() + 5
    while child.exists() and child.joinpath("stat").read_text().rsplit(")", 1)[1].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.02)


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
    command, env = [*MISTRAY, "ghosts", "plate", "--rays", "100"], os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "mistray: interrupted, nothing was written\n"


@pytest.mark.parametrize("apart_s", [0.02, 0.2, 0.3, 0.4])
def test_a_second_signal_ends_at_once(apart_s: float, tmp_path: Path) -> None:
    """Also while libraries are imported, a kernel is compiled, or Python shuts down."""
    command = [*MISTRAY, "ghosts", str(write(tmp_path, plates_text(15))), "--rays", "1e9"]
    process = Popen(command, stdout=DEVNULL, stderr=PIPE, text=True)
    modules = Path(f"/proc/{worker(process)}/maps")
    while "mitsuba" not in modules.read_text() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    time.sleep(apart_s)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - sent < LIMIT_S + SLACK_S
    assert process.returncode == 130
    assert "Traceback" not in err


INTERRUPTED = """
import signal, sys
from mistray.cli import main, program
def run(_):
    exec('import signal; signal.raise_signal(signal.SIGINT)')
program._command = run
sys.exit(main())
"""


def test_an_interrupt_of_a_class_that_is_made_keeps_the_exit_code() -> None:
    """Python itself would end by SIGINT, since the method of a dataclass is compiled from text."""
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130, done


@pytest.mark.parametrize("name", ["mistray.cli", "mistray.cli.program"])
def test_commands_called_from_python_leave_its_handlers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    monkeypatch.setattr("mistray.cli.program._command", Mock(side_effect=KeyboardInterrupt))
    assert importlib.import_module(name).main(["doctor"]) == 130
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


# ---- traces that explode


def white_can() -> str:
    """A can, white inside, with a hole for the light, which then goes on and on."""
    wall = wall_xml(0.98)
    return scene_text(
        placed_xml("frustum", "can", wall, r0=10.0, z0=-5.0, r1=10.0, z1=30.0),
        placed_xml("asphere", "lid", wall, at=(0, 0, -5.0), semi_diameter=10.0, inner_semi_diameter=1.5),
        placed_xml("asphere", "detector", wall, at=(0, 0, 30.0), semi_diameter=10.0, pixels=8),
    )


# Text of the scene, arguments, and seconds after which a signal comes
EXPLOSIONS = {
    "plates": (plates_text(15), ("--max-reflections", "6"), 20.0),
    "cavity": (white_can(), ("--max-scatters", "60"), 5.0),
    "rays": (plates_text(1), ("--rays", "2e9"), 20.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", EXPLOSIONS)
def test_a_signal_ends_an_explosion(name: str, number: signal.Signals, tmp_path: Path) -> None:
    """Before it ends, a trace whose kernel is compiled says how long it takes."""
    text, arguments, after_s = EXPLOSIONS[name]
    command = [*MISTRAY, "ghosts", str(write(tmp_path, text)), *arguments, "--out", str(tmp_path / "out")]
    end = interrupted(command, number, lambda _: time.sleep(after_s))
    assert end is not None
    assert (end.code, end.seconds <= LIMIT_S + SLACK_S) == (128 + number, True), end
    last = end.err.splitlines()[-1]
    assert last.startswith("mistray: interrupted")
    assert ("nothing was written" in last) == (not list((tmp_path / "out").glob("*.csv")))
    assert "the trace takes" in end.err or name == "cavity"
    assert not list(tmp_path.rglob(".mistray-*"))


@pytest.mark.parametrize("room", [200_000, 500_000])
def test_a_full_disk_keeps_the_tables_that_fit(room: int, tmp_path: Path) -> None:
    def little_room() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    out = tmp_path / "out"
    command = [*MISTRAY, "ghosts", "double_gauss", "--field-deg", "0", "5", "--rays", "20000", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, preexec_fn=little_room)
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert str(out) in last
    written = {path.name for path in out.iterdir()}
    assert {"summary.csv", "paths.csv", "energy.csv"} <= written
    assert "report.html" not in written
    assert all(name in last for name in written)
    rows = (out / "paths.csv").read_text(encoding="utf-8").splitlines()
    assert len({row.count(",") for row in rows if '"' not in row}) == 1  # whole lines
    assert "field" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.slow
def test_more_paths_than_a_table_holds_end_a_run(tmp_path: Path) -> None:
    """Within half a minute on a free machine, and with what to lower."""
    command = [*MISTRAY, "ghosts", str(write(tmp_path, white_can())), "--max-scatters", "60"]
    done = subprocess.run([*command, "--out", str(tmp_path / "out")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "max_scatters" in done.stderr
    assert not (tmp_path / "out").exists()

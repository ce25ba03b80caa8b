"""Commands that would run for hours: they answer a signal, keep to a time budget and keep what they have traced."""

from __future__ import annotations

import importlib
import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from interrupting import worker
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import plates_text, scene_text, write

MISTRAY = [sys.executable, "-m", "mistray"]
PATIENCE = 4.0  # s; an answer takes 2 s on a machine that is free, and others may use it too


def white_can() -> str:
    """A can, white inside, with a hole for the light, which then goes on and on."""
    wall = wall_xml(0.98)
    return scene_text(
        placed_xml("frustum", "can", wall, r0=10.0, z0=-5.0, r1=10.0, z1=30.0),
        placed_xml("asphere", "lid", wall, at=(0, 0, -5.0), semi_diameter=10.0, inner_semi_diameter=1.5),
        placed_xml("asphere", "detector", wall, at=(0, 0, 30.0), semi_diameter=10.0, pixels=8),
    )


def plain_plates() -> str:
    """15 plates of glass without coatings: 30 surfaces."""
    return plates_text(15)


def bare_lens() -> str:
    """One plate: nothing explodes but the number of rays."""
    return plates_text(1)


def painted_walls() -> str:
    """A tube in 1000 rings."""
    walls = "".join(
        placed_xml("frustum", f"ring_{k}", wall_xml(0.05), r0=20.0, z0=0.1 * k, r1=20.0, z1=0.1 * (k + 1))
        for k in range(1000)
    )
    return scene_text(
        walls, placed_xml("asphere", "detector", wall_xml(0.01), at=(0, 0, 100.0), semi_diameter=20.0, pixels=8)
    )


EXPLOSIONS = {
    "plates": (plain_plates, ["--max-reflections", "6"]),
    "cavity": (white_can, ["--max-scatters", "60"]),
    "rays": (bare_lens, ["--rays", "2e9"]),
    "walls": (painted_walls, ["--rays", "1e8", "--field-deg", "0"]),
}


@pytest.fixture
def command(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[list[str]]:
    """`mistray ghosts` of one of the explosions, with --out."""
    text, arguments = EXPLOSIONS[request.param]
    yield [*MISTRAY, "ghosts", str(write(tmp_path, text())), *arguments, "--out", str(tmp_path / "out")]
    assert not list(tmp_path.rglob(".mistray-*"))


def interrupted(command: list[str], after_s: float, number: signal.Signals) -> tuple[int, float, str]:
    """Exit code, seconds from the signal to the end, and stderr of a command."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    time.sleep(after_s)
    assert process.poll() is None, process.communicate()
    process.send_signal(number)
    sent = time.monotonic()
    _, err = process.communicate(timeout=120)
    return process.returncode, time.monotonic() - sent, err


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("command", "after_s"),
    [("plates", 20), ("cavity", 5), ("rays", 20), ("walls", 2), ("walls", 20)],
    indirect=["command"],
)
def test_a_signal_ends_an_explosion(command: list[str], after_s: float, number: signal.Signals, tmp_path: Path) -> None:
    code, seconds, err = interrupted(command, after_s, number)
    assert (code, seconds <= PATIENCE) == (128 + number, True), (code, seconds, err)
    last = err.splitlines()[-1]
    assert last.startswith("mistray: interrupted")
    written = list((tmp_path / "out").glob("*.csv"))
    assert ("nothing was written" in last) == (not written)


@pytest.mark.long
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
@pytest.mark.parametrize("command", ["cavity"], indirect=True)
def test_more_paths_than_a_table_holds_end_a_run(command: list[str], tmp_path: Path) -> None:
    """Within half a minute on a free machine, and with what to lower."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "max_scatters" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["plates", "rays"], indirect=True)
def test_a_time_budget_is_kept_and_the_result_says_so(command: list[str], tmp_path: Path) -> None:
    """On a free machine the whole command ends in 12 s; what other programs take of it may be half as much again."""
    began = time.monotonic()
    done = subprocess.run([*command, "--seconds", "10"], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert time.monotonic() - began < 18
    assert "rays were traced" in done.stdout + done.stderr
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["plates", "rays"], indirect=True)
def test_an_estimate_comes_early(command: list[str]) -> None:
    """Two seconds after the first launch, whose kernel is compiled before."""
    code, _, err = interrupted(command, 20.0, signal.SIGINT)
    assert code == 130
    assert "the trace takes" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [["pst", "--field-deg", "0", "20"], ["objects"], ["study"], ["sweep", "--no-cache"]]
)
def test_every_command_of_many_rays_has_a_budget(arguments: list[str], tmp_path: Path) -> None:
    place = write(tmp_path, bare_lens())
    name, *more = arguments
    began = time.monotonic()
    asked = [*MISTRAY, name, str(place), *more, "--rays", "1e9", "--seconds", "10", "--json"]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert time.monotonic() - began < 20
    assert "rays" in json.dumps(json.loads(done.stdout))
    assert "rays were traced" in done.stdout + done.stderr or "fewer rays" in done.stdout + done.stderr


@pytest.mark.parametrize("apart_s", [0.02, 0.2, 0.3, 0.4])
def test_a_second_signal_ends_at_once(apart_s: float, tmp_path: Path) -> None:
    """Also while libraries are imported, a kernel is compiled, or Python shuts down."""
    place = write(tmp_path, plain_plates())
    command = [*MISTRAY, "ghosts", str(place), "--rays", "1e9"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    modules = Path(f"/proc/{worker(process)}/maps")
    while "mitsuba" not in modules.read_text() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    time.sleep(apart_s)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - sent < PATIENCE
    assert process.returncode == 130
    assert "Traceback" not in err


def test_an_interrupt_of_a_class_that_is_made_keeps_the_exit_code(tmp_path: Path) -> None:
    """Python itself would end by SIGINT, since the method of a dataclass is compiled from text."""
    (tmp_path / "interrupted.py").write_text(
        "import signal, sys\n"
        "from mistray.cli import main, program\n"
        "def run(_):\n"
        "    exec('import signal; signal.raise_signal(signal.SIGINT)')\n"
        "program._command = run\n"
        "sys.exit(main())\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130, done


@pytest.mark.parametrize("name", ["mistray.cli", "mistray.cli.program"])
def test_commands_called_from_python_leave_its_handlers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted_command(_: object) -> int:
        raise KeyboardInterrupt

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    monkeypatch.setattr("mistray.cli.program._command", interrupted_command)
    assert importlib.import_module(name).main(["doctor"]) == 130
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before

"""Commands that would run for hours answer a signal and keep what they have traced; test_time_limits has budgets."""

from __future__ import annotations

import resource
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from interrupting import MISTRAY, interrupted
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import plates_text, scene_text, write

PATIENCE = 4.0  # s; an answer takes 2 s on a machine that is free, and others may use it too


def white_can() -> str:
    """A can, white inside, with a hole for the light, which then goes on and on."""
    wall = wall_xml(0.98)
    return scene_text(
        placed_xml("frustum", "can", wall, r0=10.0, z0=-5.0, r1=10.0, z1=30.0),
        placed_xml("asphere", "lid", wall, at=(0, 0, -5.0), semi_diameter=10.0, inner_semi_diameter=1.5),
        placed_xml("asphere", "detector", wall, at=(0, 0, 30.0), semi_diameter=10.0, pixels=8),
    )


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
    "plates": (lambda: plates_text(15), ["--max-reflections", "6"]),
    "cavity": (white_can, ["--max-scatters", "60"]),
    "rays": (lambda: plates_text(1), ["--rays", "2e9"]),
    "walls": (painted_walls, ["--rays", "1e8", "--field-deg", "0"]),
}


@pytest.fixture
def command(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[list[str]]:
    """`mistray ghosts` of one of the explosions, with --out."""
    text, arguments = EXPLOSIONS[request.param]
    yield [*MISTRAY, "ghosts", str(write(tmp_path, text())), *arguments, "--out", str(tmp_path / "out")]
    assert not list(tmp_path.rglob(".mistray-*"))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("command", "after_s"),
    [("plates", 20), ("cavity", 5), ("rays", 20), ("walls", 2), ("walls", 20)],
    indirect=["command"],
)
def test_a_signal_ends_an_explosion(command: list[str], after_s: float, number: signal.Signals, tmp_path: Path) -> None:
    """Before it ends, a trace whose kernel is compiled says how long it takes."""
    end = interrupted(command, number, lambda _: time.sleep(after_s))
    assert end is not None
    assert (end.code, end.seconds <= PATIENCE) == (128 + number, True), end
    last = end.err.splitlines()[-1]
    assert last.startswith("mistray: interrupted")
    written = list((tmp_path / "out").glob("*.csv"))
    assert ("nothing was written" in last) == (not written)
    if {"6", "2e9"} & set(command):
        assert "the trace takes" in end.err


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

"""Hostile places: disks without room, closed folders, readers that leave, kills in mid-write, Ctrl-C."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from oracles.small_scenes import plates_text
from report.fake_scene import lens_scene
from report.fake_trace import trace_at

import mistray.scene
from mistray.analysis import GhostReport
from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.replace_file import replace_file
from mistray.report import ghosts_output, write_all
from mistray.report.output import writable_directory, write_files

MISTRAY = [sys.executable, "-m", "mistray"]
CONTENTS = [bytes([letter]) * 300_000 for letter in b"abcd"]


@contextlib.contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Files cannot grow beyond `room` bytes: what is written comes to an end in its midst, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def everything(folder: Path) -> dict[str, bytes]:
    """All files of a folder, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def small_report(monkeypatch: pytest.MonkeyPatch) -> GhostReport:
    """A report whose pictures, which take seconds, are not drawn."""
    monkeypatch.setattr(ghosts_output, "draw", lambda report, _: ({"overview.png": CONTENTS[0]}, report))
    monkeypatch.setattr(ghosts_output, "pages", lambda *_: {"report.html": CONTENTS[1]})
    return GhostReport(lens_scene(), {0.0: trace_at(0.0)}, trace_at(0.0), {})


# ---- files


def test_a_full_disk_leaves_the_old_report(tmp_path: Path, small_report: GhostReport) -> None:
    out = tmp_path / "out"
    write_all(small_report, out)
    before = everything(tmp_path)
    assert len(before) > 5
    with full_disk(1 << 12), pytest.raises(MistrayError, match="cannot be written"):
        write_all(small_report, out)
    with full_disk(1 << 12), pytest.raises(MistrayError, match="cannot be written"):
        writable_directory(out)  # before anything is traced
    assert everything(tmp_path) == before


def test_a_target_that_is_a_disk_of_its_own(
    tmp_path: Path, small_report: GhostReport, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a mounted volume: it cannot be exchanged, and nothing can be moved into it from beside it."""
    out = tmp_path / "volume"
    out.mkdir()
    (out / "notes.txt").write_bytes(b"mine")
    rename, replace = os.rename, os.replace

    def within(move: Callable[[Path, Path], None]) -> Callable[[Path, Path], None]:
        def moved(source: Path, target: Path) -> None:
            if (out in Path(source).parents) != (out in Path(target).parents) or out in (Path(source), Path(target)):
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), str(source))
            move(source, target)

        return moved

    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == out)
    monkeypatch.setattr(os, "rename", within(rename))
    monkeypatch.setattr(os, "replace", within(replace))
    inside = out.stat().st_ino
    files = write_all(small_report, out)
    assert {path.name for path in files} | {"notes.txt"} == set(everything(out))
    assert out.stat().st_ino == inside
    assert [path.name for path in tmp_path.iterdir()] == ["volume"]


def test_what_is_no_file_is_written_to(tmp_path: Path) -> None:
    """A pipe, or a device such as /dev/null, is not replaced by a file."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    replace_file(pipe, b"curve")
    reader.join(timeout=10)
    assert got == [b"curve"]
    assert pipe.is_fifo()


@pytest.mark.parametrize("place", ["file", "file/below", "loop", "a" * 300, "dev"])
def test_places_that_cannot_be_written(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "loop").symlink_to("loop")
    path = Path("/proc/nobody/out") if place == "dev" else tmp_path / place
    before = everything(tmp_path)
    for write in (writable_directory, lambda path: write_files({"a.csv": "1"}, path)):
        with pytest.raises((MistrayError, RuntimeError)) as caught:
            write(path)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(MistrayError, match=r"check the folder|is a folder"):
        replace_file(tmp_path if place == "file" else path / "a.csv", b"1")
    assert everything(tmp_path) == before


WRITER = """
import random
import sys
from pathlib import Path

out, rng = Path(sys.argv[1]), random.Random(int(sys.argv[2]))
sys.argv = sys.orig_argv = ["mistray"]  # as the command, which starts without Mitsuba
from mistray.report.output import write_files
contents = [bytes([letter]) * 300_000 for letter in b"abcd"]
print(flush=True)
while True:
    data = rng.choice(contents)
    write_files({"paths.csv": data, "report.html": data}, out)
"""


@contextlib.contextmanager
def writing(out: Path, seed: int) -> Iterator[subprocess.Popen[str]]:
    """A process that has begun to write the same again and again, and is killed in the end."""
    command = [sys.executable, "-c", WRITER, str(out), str(seed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield process
        finally:
            process.kill()


def test_two_processes_write_the_same_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with writing(out, 0) as one, writing(out, 1) as two:
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            for path in out.glob("*.*"):
                if path.suffix != ".part":
                    assert path.read_bytes() in CONTENTS
        assert one.poll() is two.poll() is None  # neither has met a draft of the other
    assert {"paths.csv", "report.html"} <= set(everything(out))


# ---- stdout


@pytest.mark.parametrize(
    ("command", "to", "code"),
    [
        ("--help", "| true", 0),
        ("ghosts --help", "| true", 0),
        ("completion bash", "| head -1", 0),
        ("--version", ">&-", 0),
        ("--version", "> /dev/full", 2),
    ],
)
def test_nobody_reads_the_output(command: str, to: str, code: int) -> None:
    line = f"set -o pipefail; {' '.join(MISTRAY)} {command} {to}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60)
    assert done.returncode == code
    if code:
        assert done.stderr == "mistray: error: No space left on device; " + done.stderr.partition("; ")[2]
        assert done.stderr.count("\n") == 1
    else:
        assert done.stderr == ""


# ---- Ctrl-C


def test_an_interrupt_within_another_error(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """As Dr.Jit has it, which makes a RuntimeError of what is raised while it records a loop."""

    def load(*given: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise RuntimeError("while_loop(): encountered an exception") from error

    monkeypatch.setattr(mistray.scene, "load", load)
    assert main(["ghosts", "lens.xml"]) == 130
    assert capsys.readouterr().err == "mistray: interrupted, nothing was written\n"


# ---- surroundings


@pytest.mark.long
def test_strange_surroundings(tmp_path: Path) -> None:
    """A scene whose name is no ASCII: no UTF-8, no home for the cache of kernels, no asserts and docstrings."""
    scene, out = tmp_path / "Höhe.xml", tmp_path / "out"
    scene.write_text(plates_text(1), encoding="utf-8")
    surroundings = {
        "LC_ALL": "C", "LANG": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": "",
        "HOME": "/proc/nobody", "XDG_CACHE_HOME": "/proc/nobody/cache", "MPLCONFIGDIR": str(tmp_path / "mpl"),
        "PYTHONOPTIMIZE": "2",
    }  # fmt: skip
    command = [*MISTRAY, "ghosts", str(scene), "--rays", "200", "--json", "--out", str(out)]
    done = subprocess.run(command, env={**os.environ, **surroundings}, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert b"the disk cache is disabled." in done.stderr  # of Dr.Jit
    assert json.loads(done.stdout)["fields"]
    assert "Höhe" in (out / "report.html").read_text(encoding="utf-8")

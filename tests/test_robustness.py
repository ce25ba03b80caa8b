"""Hostile places: disks without room, closed folders, readers that leave, kills in mid-write, Ctrl-C."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from interrupting import worker
from oracles.small_scenes import plates_text
from report.fake_scene import lens_scene
from report.fake_trace import trace_at

import mistray.scene
from mistray import cli
from mistray.analysis import GhostReport
from mistray.cli import program
from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.replace_file import replace_file
from mistray.report import ghosts_output, output, write_all
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


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    path = replace_file(tmp_path / "paths.csv", b"old")
    with full_disk(1 << 16), pytest.raises(MistrayError) as caught:
        replace_file(path, CONTENTS[0], "table")
    assert str(caught.value).startswith(f"table '{path}': File too large; free some space")
    assert everything(tmp_path) == {"paths.csv": b"old"}


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
{line}
contents = [bytes([letter]) * 300_000 for letter in b"abcd"]
print(flush=True)
while True:
    write(out, rng.choice(contents))
"""
A_FILE = "from mistray.replace_file import replace_file as write"
A_FOLDER = """
from mistray.report.output import write_files
write = lambda out, data: write_files({"paths.csv": data, "report.html": data}, out)
"""


@contextlib.contextmanager
def writing(line: str, out: Path, seed: int) -> Iterator[subprocess.Popen[str]]:
    """A process that has begun to write the same again and again, and is killed in the end."""
    command = [sys.executable, "-c", WRITER.replace("{line}", line), str(out), str(seed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield process
        finally:
            process.kill()


def test_killed_in_mid_write(tmp_path: Path) -> None:
    """Whenever a process is killed: the file is one of those that were written, whole."""
    path = replace_file(tmp_path / "report.html", CONTENTS[0])
    rng = random.Random(1)
    seen = set()
    for seed in range(20):
        with writing(A_FILE, path, seed):
            time.sleep(rng.uniform(0.0, 0.02))
        assert path.read_bytes() in CONTENTS
        seen.add(path.read_bytes()[:1])
    assert len(seen) > 1


def test_two_processes_write_the_same_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with writing(A_FOLDER, out, 0) as one, writing(A_FOLDER, out, 1) as two:
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


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0])
def test_an_interrupt_at_any_time(tmp_path: Path, delay_s: float) -> None:
    """While modules are imported, the scene is loaded, the kernel is recorded, compiled or runs."""
    command = [*MISTRAY, "ghosts", "cooke_triplet", "--rays", "4e9", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    modules = Path(f"/proc/{worker(process)}/maps")
    while "numpy" not in modules.read_text() and process.poll() is None:  # until the command itself has begun
        time.sleep(0.01)
    time.sleep(delay_s)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    # Where the interrupt met Python that C code had started, CPython ends itself by the signal: 130 in a shell as well
    code = 128 - process.returncode if process.returncode < 0 else process.returncode
    assert (code, out) == (130, "")
    last = err.splitlines()[-1]
    assert last.startswith("mistray: interrupted")
    # What was traced stands in tables; nothing is half-written
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} <= {".csv"}
    assert ("nothing was written" in last) == (files == [])
    assert list(tmp_path.rglob(".*")) == []


# ---- surroundings


def strange(tmp_path: Path, *arguments: str) -> str:
    """
    Stdout of a command on a scene whose name is no ASCII: no UTF-8, no home for the cache of kernels, no asserts and
    docstrings.
    """
    scene = tmp_path / "Höhe.xml"
    scene.write_text(plates_text(1), encoding="utf-8")
    surroundings = {
        "LC_ALL": "C", "LANG": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": "",
        "HOME": "/proc/nobody", "XDG_CACHE_HOME": "/proc/nobody/cache", "MPLCONFIGDIR": str(tmp_path / "mpl"),
        "PYTHONOPTIMIZE": "2",
    }  # fmt: skip
    command = [*MISTRAY, "ghosts", str(scene), "--rays", "200", *arguments]
    done = subprocess.run(command, env={**os.environ, **surroundings}, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (line,) = done.stderr.decode().splitlines()  # of Dr.Jit
    assert line.endswith("the disk cache is disabled.")
    return done.stdout.decode()


@pytest.mark.long
def test_strange_surroundings(tmp_path: Path) -> None:
    assert json.loads(strange(tmp_path, "--json"))["fields"]


@pytest.mark.slow
def test_a_report_in_strange_surroundings(tmp_path: Path) -> None:
    out = tmp_path / "out"
    strange(tmp_path, "--out", str(out))
    assert "Höhe" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_two_commands_write_the_same_folder(tmp_path: Path) -> None:
    command = [*MISTRAY, "ghosts", "plate", "--rays", "1e4", "--quiet", "--force", "--out", str(tmp_path / "out")]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE) for _ in range(2)]
    for process in processes:
        assert process.communicate(timeout=300)[1] == b""
        assert process.returncode == 0
    files = everything(tmp_path)
    assert all(name.startswith("out/") and not name.startswith("out/.") for name in files)
    assert files["out/report.html"].rstrip().endswith(b"</html>")
    assert all(data.endswith(b"IEND\xaeB`\x82") for name, data in files.items() if name.endswith(".png"))


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [2.0, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0])
def test_a_command_killed_at_any_time(tmp_path: Path, delay_s: float) -> None:
    """What has a name in the folder is whole; what is left over is hidden, and the next run is not in its way."""
    command = [*MISTRAY, "ghosts", "plate", "--rays", "1e4", "--quiet", "--force", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command)
    time.sleep(delay_s)
    process.kill()
    process.wait()
    for path in (tmp_path / "out").glob("[!.]*"):
        assert path.suffix != ".part"
        if path.suffix == ".html":
            assert path.read_bytes().rstrip().endswith(b"</html>")
        if path.suffix == ".png":
            assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
    assert subprocess.run(command).returncode == 0


def test_the_command_line_is_what_is_tested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "main", lambda argv: f"ran {argv}")
    assert cli.main(["ghosts"]) == "ran ['ghosts']"
    assert output.PROBE > 1 << 12

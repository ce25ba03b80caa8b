"""Files that belong together appear together: where one finds no room, or is in the way, all stay as they were."""

from __future__ import annotations

import errno
import importlib
import os
import resource
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import Patch
from test_every_command import STUDY

from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.replace_file import replace_file, replace_files
from mistray.toolkit.pages.output import writable_directory, write_files

OLD = "old\n"
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"
MODEL = ("bsdf", "abg", "--A", "0.01", "--B", "0.01", "--g", "2", "--json")


@pytest.fixture
def small_files() -> Iterator[Any]:
    """Sets the size beyond which files find no room, bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("large", ["a", "b", "c"])
def test_all_or_none(tmp_path: Path, small_files: Any, large: str) -> None:
    for name in "ac":
        (tmp_path / name).write_text(OLD)
    before = contents(tmp_path)
    small_files(100_000)
    with pytest.raises(MistrayError, match=rf"{large}'.*space"):
        write_files({name: "x" * (200_000 if name == large else 10) for name in "abc"}, tmp_path)
    small_files(1 << 12)  # less than is tried before anything is traced
    with pytest.raises(MistrayError, match="cannot be written"):
        writable_directory(tmp_path)
    assert contents(tmp_path) == before
    small_files(1 << 30)
    assert [path.name for path in write_files(dict.fromkeys("abc", "new"), tmp_path)] == list("abc")
    assert contents(tmp_path) == dict.fromkeys("abc", b"new")


def test_what_stops_the_second_file_leaves_no_drafts(tmp_path: Path, monkeypatch: Patch) -> None:
    """An interrupt, a read-only place, a folder in the way."""
    write, files = Path.write_bytes, {tmp_path / "a": "first", tmp_path / "b": "second"}
    (tmp_path / "a").write_text(OLD)
    for error, expected, words in (
        (KeyboardInterrupt("now"), KeyboardInterrupt, "now"),
        (OSError(errno.EROFS, os.strerror(errno.EROFS)), MistrayError, "permissions"),
    ):

        def stopped(path: Path, data: bytes, error: BaseException = error) -> int:
            if data == b"second":
                raise error
            return write(path, data)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", stopped)
            with pytest.raises(expected, match=words):
                replace_files(files)
        assert contents(tmp_path) == {"a": OLD.encode()}
    (tmp_path / "b").mkdir()
    with pytest.raises(MistrayError, match="b' is a folder"):
        replace_files(files)
    assert contents(tmp_path) == {"a": OLD.encode()}


def test_a_target_that_is_a_disk_of_its_own(tmp_path: Path, monkeypatch: Patch) -> None:
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
    files = write_files(dict.fromkeys(("a.csv", "report.html"), "new"), out)
    assert {path.name for path in files} | {"notes.txt"} == set(contents(out))
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
    before = contents(tmp_path)
    for write in (writable_directory, lambda path: write_files({"a.csv": "1"}, path)):
        with pytest.raises((MistrayError, RuntimeError)) as caught:
            write(path)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(MistrayError, match=r"check the folder|is a folder"):
        replace_file(tmp_path if place == "file" else path / "a.csv", b"1")
    assert contents(tmp_path) == before


# Commands, the size of their files and what they would write: a place for each that finds no room
COMMANDS = {
    "mechanics": (("import", "cube.obj", "-o", "out/c.xml"), 100),
    "view": (("view", "plate", "--rays", "20", "--out", "out/view.html"), 100_000),
    "curves": ((*MODEL, "--csv", "out/a.csv"), 100),
    "picture": ((*MODEL, "--plot", "out/a.png"), 100),
    "table": ((*MODEL, "--table", "out/a.csv"), 100),
    "export": (("export", "cooke_triplet", "-o", "out/a.zmx"), 100),
    **{name: ((name, "plate", "--rays", "200", "--out", "out"), 20_000) for name in ("thermal", "objects")},
    "sweep": (("sweep", "plate", "--rays", "200", "--field-deg", "0", "--no-cache", "--out", "out"), 20_000),
    "sensitivity": (("sensitivity", "plate", "--rays", "200", "--field-deg", "0", "--out", "out"), 20_000),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str], small_files: Any, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "cube.obj").write_text(CUBE)
    words, size = COMMANDS[command]
    monkeypatch.setattr("mistray.toolkit.pages.output.PROBE", 1)
    small_files(size)
    assert main(list(words)) == 2
    small_files(resource.RLIM_INFINITY)
    told = capsys.readouterr().err
    assert "space" in told.splitlines()[-1]
    assert "Traceback" not in told
    assert contents(tmp_path / "out") == {}


RUNS = {
    "study": (("study", "plate", "--quick", "--rays", "200", "--field-deg", "0"), "pst_state.npz"),
    "pst": (("pst", "plate", "--rays", "1000", "--paths", "0"), "pst_state.npz"),
    "optimize": (("optimize", "plate", "study.toml", "--steps", "1"), "checkpoint.json"),
}


@pytest.mark.long
@pytest.mark.parametrize("stop", [MistrayError("no room"), KeyboardInterrupt()], ids=["error", "interrupt"])
@pytest.mark.parametrize("command", RUNS)
def test_a_run_that_was_saved_is_named(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str], command: str, stop: BaseException
) -> None:
    """Also where the report is what fails."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY)
    words, saved = RUNS[command]

    def stopped(*_: Any) -> None:
        raise stop

    for page in ("design", "pst", "study"):  # one that is imported below would keep what stands in for a moment
        importlib.import_module(f"mistray.analyses.{page}.page")
    with monkeypatch.context() as patch:
        patch.setattr("mistray.toolkit.pages.output.write_report", stopped)
        code = main([*words, "--out", "out"])
    said = capsys.readouterr().err
    assert code == (2 if isinstance(stop, MistrayError) else 130)
    assert f"out/{saved}, go on with --resume" in said.splitlines()[-1]
    assert "nothing" not in said
    assert (tmp_path / "out" / saved).exists()
    if command == "pst":
        assert main([*words, "--out", "out", "--resume"]) == 0

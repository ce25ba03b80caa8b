"""Files that belong together appear together, and a folder of results is the old or the new one, however a run ends."""

import contextlib
import errno
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from command_line import Patch, run
from test_every_command import STUDY

from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.replace_file import INCOMPLETE, incomplete_notes, rename_drafts, replace_file, replace_files
from mistray.replace_folder import replacing_folder
from mistray.toolkit.pages.output import writable_directory, write_files

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked and killed")
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


@pytest.mark.parametrize("place", ["file", "file/below", "loop", "loop/below", "a" * 300, "dev"])
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


@pytest.mark.parametrize("stop", [MistrayError("no room"), KeyboardInterrupt()], ids=["error", "interrupt"])
@pytest.mark.parametrize("command", RUNS)
def test_a_run_that_was_saved_is_named(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str], command: str, stop: BaseException
) -> None:
    """Also where the report is what fails."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY)
    words, saved = RUNS[command]
    for page in ("optimize", "pst", "study"):  # one that is imported below would keep what stands in for a moment
        importlib.import_module(f"mistray.analyses.{page}.page")
    with monkeypatch.context() as patch:
        patch.setattr("mistray.toolkit.pages.output.write_report", Mock(side_effect=stop))
        code = main([*words, "--out", "out"])
    said = capsys.readouterr().err
    assert code == (2 if isinstance(stop, MistrayError) else 130)
    assert f"out/{saved}, go on with --resume" in said.splitlines()[-1]
    assert "nothing" not in said
    assert (tmp_path / "out" / saved).exists()
    if command == "pst":
        assert main([*words, "--out", "out", "--resume"]) == 0


OTHERS = {"notes.txt": b"mine", "pst_state.npz": b"a state"}
PAGE = b"<html>%s</html>"
FILES = ("summary.csv", "paths.csv", "ghosts_10deg.png")


def write_report(word: bytes, folder: Path, names: tuple[str, ...] = FILES) -> None:
    with replacing_folder(folder):
        replace_file(folder / names[0], word)
        with replacing_folder(folder):
            replace_files({folder / name: word for name in names[1:]} | {folder / "report.html": PAGE % word})


def results(folder: Path) -> dict[str, bytes]:
    """The files that are no drafts, and of the page what is no list."""
    found = {path.name: path.read_bytes() for path in folder.glob("[!.]*") if path.is_file()}
    return {name: data.partition(b"<!--")[0].removesuffix(b"</html>") for name, data in found.items()}


def whole(word: bytes, names: tuple[str, ...] = FILES) -> dict[str, bytes]:
    return OTHERS | dict.fromkeys(names, word) | {"report.html": b"<html>" + word}


def in_a_child(work: Callable[[], None], event: int, kill: bool) -> bool:
    """Whether a process meets its end, or an error of the disk, at a certain call of the system, told by a hook."""
    child = os.fork()
    if child == 0:
        count = 0

        def hook(name: str, _: object) -> None:
            nonlocal count
            if name == "open" or name.startswith(("os.", "shutil.")):
                count += 1
                if count == event and kill:
                    os.kill(os.getpid(), signal.SIGKILL)
                if count == event:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with contextlib.suppress(BaseException):
            sys.addaudithook(hook)
            work()
        os._exit(0 if count < event else 1)
    return os.waitpid(child, 0)[1] != 0


@pytest.fixture(
    params=[*(pytest.param(kind, marks=pytest.mark.long) for kind in ("exchanged", "folder within")), "current folder"]
)
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # the disk is not what is tested, and slow
    place = tmp_path / "out"
    place.mkdir()
    if request.param == "current folder":
        monkeypatch.chdir(place)
    if request.param == "folder within":
        (place / "pst").mkdir()
    for name, data in OTHERS.items():
        (place / name).write_bytes(data)
    return place


@pytest.mark.parametrize("kill", [True, False], ids=["killed", "no room"])
def test_at_every_call(folder: Path, kill: bool) -> None:
    """Whatever is in the folder afterwards, the next run mends it, and old drafts go."""
    mixed = events = 0
    write_report(b"old", folder)
    while in_a_child(lambda: write_report(b"new", folder), events + 1, kill):
        events += 1
        found, told = results(folder), incomplete_notes([folder])
        found.pop(INCOMPLETE, None)
        if found not in (whole(b"old"), whole(b"new")):
            mixed += 1
            assert told, (events, found)
            assert set(found) == set(whole(b"old"))
        write_report(b"old", folder)
        assert results(folder) == whole(b"old"), events
        assert incomplete_notes([folder]) == []
    assert events > 20
    assert results(folder) == whole(b"new")
    exchanged = Path.cwd() != folder and not (folder / "pst").exists()
    assert (mixed == 0) if exchanged else (mixed > 0 or not kill)


def test_what_an_earlier_run_listed_goes(folder: Path) -> None:
    write_report(b"old", folder, (*FILES, "scene.xml", "changed.csv"))
    (folder / "changed.csv").write_bytes(b"by hand")
    write_report(b"new", folder, FILES[:2])
    left = {"scene.xml": b"old", "changed.csv": b"by hand"}
    assert results(folder) == whole(b"new", FILES[:2]) | left
    write_report(b"newest", folder, FILES[1:])
    assert results(folder) == whole(b"newest", FILES[1:]) | left


def test_files_of_a_killed_run_that_the_next_one_does_not_write(tmp_path: Path, monkeypatch: Patch) -> None:
    """Killed between two renames; the next run has fewer files."""
    monkeypatch.chdir(tmp_path)
    write_report(b"old", tmp_path, FILES[:2])
    event = 1
    while in_a_child(lambda: write_report(b"new", tmp_path), event, True) and FILES[2] not in results(tmp_path):
        event += 1
    assert incomplete_notes([tmp_path])
    write_report(b"last", tmp_path, FILES[:2])
    assert set(results(tmp_path)) == {*FILES[:2], "report.html"}
    assert incomplete_notes([tmp_path]) == []


def test_another_process_writes_into_the_old_folder(tmp_path: Path, monkeypatch: Patch) -> None:
    """A link to the folder stays one, the folder keeps its mode, and files of others stay the same files."""
    out = tmp_path / "real"
    write_report(b"old", out)
    out.chmod(0o750)
    (tmp_path / "out").symlink_to("real")
    for name, data in OTHERS.items():
        (out / name).write_bytes(data)
    (out / "to nothing").symlink_to("nothing")
    before, link = (out / "pst_state.npz").stat().st_ino, os.link

    def late(source: str, target: Path, **how: bool) -> None:
        link(source, target, **how)
        (out / "late.txt").write_bytes(b"late")
        (out / "draft").write_bytes(b"renewed")
        os.replace(out / "draft", out / "notes.txt")

    monkeypatch.setattr(os, "link", late)
    write_report(b"new", tmp_path / "out")
    assert results(out) == whole(b"new") | {"late.txt": b"late", "notes.txt": b"renewed"}
    assert (out / "pst_state.npz").stat().st_ino == before
    assert os.readlink(out / "to nothing") == "nothing"
    assert out.stat().st_mode & 0o777 == 0o750
    assert (tmp_path / "out").is_symlink()
    assert {path.name for path in tmp_path.iterdir()} == {"out", "real"}


def test_drafts_of_dead_runs_go_when_they_are_old(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = {
        f".mistray-{dead.pid}-0123abcd": False, ".mistray-0123abc_": False, f".mistray-{os.getpid()}-0123abcd": True,
        f".mistray-{dead.pid}-0123abce": True, ".mistray-other": True,
    }  # fmt: skip
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.html").write_bytes(b"half")
        if not name.endswith("e"):
            os.utime(tmp_path / name, (0, time.time() - 4000))
    write_report(b"new", tmp_path / "out")
    assert {path.name for path in tmp_path.iterdir()} == {"out", *(name for name, stays in names.items() if stays)}


def test_commands_read_the_mark(tmp_path: Path, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder with a scene and a mark of a run that was killed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cube.obj").write_text(CUBE)
    remake = ("import", "cube.obj", "-o", "cube.xml", "--force")
    assert run(capsys, *remake)[0] == 0
    event = 1
    while in_a_child(lambda: main(remake), event, True) and not incomplete_notes([tmp_path]):
        event += 1
    names = json.loads((tmp_path / INCOMPLETE).read_text())["sets"]["cube.xml"]
    assert "cube.xml" in names
    assert len(names) > 1
    for words in (("export", "cube.xml", "-o", "out.step"), ("coat", tmp_path / "cube.xml", "*=R=0.1", "-o", "c.xml")):
        assert "is incomplete" in run(capsys, *words)[2]
    assert run(capsys, *remake)[0] == 0
    assert not (tmp_path / INCOMPLETE).exists()
    assert "is incomplete" not in run(capsys, "export", "cube.xml", "-o", "out.step", "--force")[2]


def test_a_file_of_others_with_the_name_of_the_mark(tmp_path: Path) -> None:
    (tmp_path / INCOMPLETE).write_text("my list")
    with pytest.raises(ValueError, match="rename it"):
        replace_files({tmp_path / "a": "1", tmp_path / "b": "2"})
    assert {path.name for path in tmp_path.iterdir()} == {INCOMPLETE}
    replace_file(tmp_path / "a", "1")  # one alone needs no mark
    assert (tmp_path / INCOMPLETE).read_text() == "my list"


def test_an_obsolete_file_that_cannot_be_removed(tmp_path: Path) -> None:
    """A folder has its name; the other files are new, and the mark remains."""
    (tmp_path / "b").mkdir()
    with pytest.raises(MistrayError, match=r"file '.*b': .*; check the folder and its permissions"):
        rename_drafts({tmp_path / "a": b"new"}, "file", [tmp_path / "b"])
    assert (tmp_path / "a").read_bytes() == b"new"
    assert incomplete_notes([tmp_path])


def test_a_mark_removes_only_files_of_its_folder(tmp_path: Path, monkeypatch: Patch) -> None:
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(out)  # so that the files are replaced one by one
    (tmp_path / "mine").write_text("1")
    (out / INCOMPLETE).write_text(json.dumps({"sets": {"report.html": ["../mine", "old.csv"]}}))
    (out / "old.csv").write_text("1")
    write_files(dict.fromkeys(("a.csv", "report.html"), "new"), out)
    assert set(contents(tmp_path)) == {"mine", "out/a.csv", "out/report.html"}

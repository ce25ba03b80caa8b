"""A folder of results is the old one or the new one whenever a run is ended or cannot write, or says that it is not."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import Patch, run

from mistray.cli.program import main
from mistray.replace_file import INCOMPLETE, incomplete_notes, replace_file, replace_files
from mistray.replace_folder import replacing_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked and killed")

OTHERS = {"notes.txt": b"mine", "pst_state.npz": b"a state"}
PAGE = b"<html>%s</html>"
FILES = ("summary.csv", "paths.csv", "ghosts_10deg.png")
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"


def report(word: bytes, folder: Path, names: tuple[str, ...] = FILES) -> None:
    with replacing_folder(folder):
        replace_file(folder / names[0], word)
        with replacing_folder(folder):
            replace_files({folder / name: word for name in names[1:]} | {folder / "report.html": PAGE % word})


def contents(folder: Path) -> dict[str, bytes]:
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
    status = os.waitpid(child, 0)[1]
    return status != 0


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
    report(b"old", folder)
    while in_a_child(lambda: report(b"new", folder), events + 1, kill):
        events += 1
        found, told = contents(folder), incomplete_notes([folder])
        found.pop(INCOMPLETE, None)
        if found not in (whole(b"old"), whole(b"new")):
            mixed += 1
            assert told, (events, found)
            assert set(found) == set(whole(b"old"))
        report(b"old", folder)
        assert contents(folder) == whole(b"old"), events
        assert incomplete_notes([folder]) == []
    assert events > 20
    assert contents(folder) == whole(b"new")
    exchanged = Path.cwd() != folder and not (folder / "pst").exists()
    assert (mixed == 0) if exchanged else (mixed > 0 or not kill)


def test_what_an_earlier_run_listed_goes(folder: Path) -> None:
    report(b"old", folder, (*FILES, "scene.xml", "changed.csv"))
    (folder / "changed.csv").write_bytes(b"by hand")
    report(b"new", folder, FILES[:2])
    left = {"scene.xml": b"old", "changed.csv": b"by hand"}
    assert contents(folder) == whole(b"new", FILES[:2]) | left
    report(b"newest", folder, FILES[1:])
    assert contents(folder) == whole(b"newest", FILES[1:]) | left


def test_files_of_a_killed_run_that_the_next_one_does_not_write(tmp_path: Path, monkeypatch: Patch) -> None:
    """Killed between two renames; the next run has fewer files."""
    monkeypatch.chdir(tmp_path)
    report(b"old", tmp_path, FILES[:2])
    event = 1
    while in_a_child(lambda: report(b"new", tmp_path), event, True) and FILES[2] not in contents(tmp_path):
        event += 1
    assert incomplete_notes([tmp_path])
    report(b"last", tmp_path, FILES[:2])
    assert set(contents(tmp_path)) == {*FILES[:2], "report.html"}
    assert incomplete_notes([tmp_path]) == []


def test_another_process_writes_into_the_old_folder(tmp_path: Path, monkeypatch: Patch) -> None:
    """A link to the folder stays one, the folder keeps its mode, and files of others stay the same files."""
    out = tmp_path / "real"
    report(b"old", out)
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
    report(b"new", tmp_path / "out")
    assert contents(out) == whole(b"new") | {"late.txt": b"late", "notes.txt": b"renewed"}
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
    report(b"new", tmp_path / "out")
    assert {path.name for path in tmp_path.iterdir()} == {"out", *(name for name, stays in names.items() if stays)}


@pytest.mark.long
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

"""Bad input: one line on stderr that names the object, the value and the remedy; exit code 2; nothing written."""

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import vectors
from command_line import Captured, Patch, fails
from test_every_command import INPUTS, STUDY

import mistray
from mistray import MistrayError, cli

SCENE = vectors.text("singlet.xml")
SOURCE_RADIUS = '<float name="radius" value="2"/>'
# Text of the scene, what stands there instead, and the words of the line that must come
CASES: list[tuple[str, str, tuple[str, ...]]] = [
    *((old, new, tuple(words)) for old, new, *words in vectors.toml("scene_refusals.toml")["refused"]),
    (SCENE, "", ("line 1", "broken XML, no document element found")),
]
AWAY = SOURCE_RADIUS, f'{SOURCE_RADIUS}<transform name="to_world"><translate z="-50"/></transform>'
GLASS = ('value="1.5"', 'value="N-BK7"')
# What the scene becomes, options of the command, and the words of the line that must come
OPTIONS = [
    (AWAY, ("--field-deg", "0", "45"),
     ("source 'source': no ray of its light along (0, 0.7071, 0.7071) hits", "check field_deg")),
    (GLASS, ("--wavelength-nm", "100"), ("material 'N-BK7': 100 nm is outside its 300 … 2500 nm",)),
    (("", ""), ("--rays", "0"), ("--rays: 0 must", "between 1 and 4294967295")),
    *(((old, new), (), words) for old, new, words in CASES[:4]),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory with an output directory that holds a file; fails if a command leaves anything behind."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("old")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")} - {"scene.xml"}
    assert left == {"out", "out/report.html"}
    assert (tmp_path / "out" / "report.html").read_text() == "old"


def write(old: str, new: str) -> None:
    assert old in SCENE
    Path("scene.xml").write_text(SCENE.replace(old, new, 2 if (old, new) == GLASS else 1))


def check_line(err: str, words: tuple[str, ...]) -> None:
    assert err.count("\n") == 1, err
    assert err.startswith("mistray: error: "), err
    for word in words:
        assert word in err, f"'{word}' is not in: {err}"
    for noise in ("Traceback", ".cpp", "MistrayError", "RuntimeError", "\x1b"):
        assert noise not in err, err
    assert len(err) < 330, err


@pytest.mark.parametrize(("old", "new", "words"), CASES)
def test_a_wrong_scene_is_one_line(folder: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    write(old, new)
    with pytest.raises(MistrayError) as caught:
        mistray.trace(mistray.load("scene.xml"), rays=200)
    assert isinstance(caught.value, ValueError)
    check_line(f"mistray: error: {caught.value}\n", words)


COMMAND = ("ghosts", "scene.xml", "--rays", "200", "--out", "out", "--force")


@pytest.mark.parametrize(("damage", "options", "words"), OPTIONS)
def test_the_command_writes_nothing(
    capfd: pytest.CaptureFixture[str], folder: Path, damage: tuple[str, str], options: tuple[str, ...],
    words: tuple[str, ...],
) -> None:  # fmt: skip
    write(*damage)
    assert cli.main([*COMMAND, *options]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    check_line(err, words)


def test_the_good_scene_and_the_command_as_a_process(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    old, new, words = CASES[0]
    write(old, new)
    done = subprocess.run([sys.executable, "-m", "mistray", *COMMAND], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (2, "")
    check_line(done.stderr, words)
    assert cli.main(["ghosts", "phone_camra"]) == 2
    check_line(capfd.readouterr().err, ("scene 'phone_camra': no such file", "phone_camera"))
    write("", "")
    assert cli.main(["ghosts", "scene.xml", "--rays", "200", "--json"]) == 0
    assert capfd.readouterr().err == ""


def test_a_stop_wider_than_its_plate(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    shipped = mistray.scene.find("phone_camera").with_name("prescription.json").read_text(encoding="utf-8")
    Path("scene.json").write_text(shipped.replace('"radius": 1.25171162', '"radius": 9'), encoding="utf-8")
    assert cli.main(["import", "scene.json", "-o", "made.xml"]) == 2
    Path("scene.json").unlink()
    check_line(capfd.readouterr().err, ("stop 'stop': radius is 9; it must lie between 0 and",))


REFUSED = vectors.toml("cli_refusals.toml")


@pytest.fixture
def working_folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in (("lens.xml", INPUTS["coated.xml"]), ("study.toml", STUDY), ("media.yaml", "")):
        Path(name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("command", REFUSED)
def test_one_line_and_nothing_is_written(command: str, working_folder: Path, capsys: Captured) -> None:
    before = sorted(working_folder.rglob("*"))
    for arguments, words in REFUSED[command]:
        assert words in fails(capsys, *([command] if command else []), *shlex.split(arguments)), arguments
    assert sorted(working_folder.rglob("*")) == before


@pytest.mark.usefixtures("working_folder")
def test_a_missing_package_is_told_before_the_trace(capsys: Captured, monkeypatch: Patch) -> None:
    monkeypatch.setattr("mistray.scene.load", None)
    for name in {"astropy", *(name for name in sys.modules if name.startswith("astropy."))}:  # other tests import it
        monkeypatch.setitem(sys.modules, name, None)
    assert "astropy" in fails(capsys, "ghosts", "x", "--out", "out", "--formats", "fits")
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    assert "pip install 'mistray[view]'" in fails(capsys, "view", "x", "--out", "v.html")
    assert not Path("out").exists()

"""No command replaces a file that it reads, nor, without --force, any other; it says so before it computes."""

import argparse
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import vectors
from command_line import Captured, Patch, fails, succeeds
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from test_every_command import BUDGET, INPUTS, STUDY, ZMX

from mistray.cli.claims import claim_files, claim_folder, guard_of
from mistray.cli.program import COMMANDS, _parser
from mistray.errors import MistrayError
from mistray.kernel.launches import Launches
from mistray.read_file import read_file
from mistray.replace_file import Guard, guarding, replace_file

CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"
TABLE = "wavelength_nm,angle_deg,R,T\n" + "".join(f"{nm},{deg},0.01,0.99\n" for nm in (400, 700) for deg in (0, 45))
GLASS = "NM OWN 1 0 1.5 60\nCD 2.25 0 0 0 0 0\nLD 0.3 2.5\nIT 0.3 0.9 10\nIT 2.5 0.9 10\n"
# Files of a system in one folder; the scene includes one, in which another is named
SYSTEM = {
    "whole.xml": scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", "glass.agf:OWN", table="table.csv"), semi_diameter=5.0),
        shape_xml("asphere", "detector", 9.0, sensor=True, half_width=5.0, half_height=5.0),
        '<include filename="part.xml"/>',
        spectrum="lines.csv",
    ),
    "part.xml": '<scene version="3.0.0"><shape type="ply"><string name="filename" value="mesh.ply"/>'
    f"{interface_xml(R=0.0)}</shape></scene>",
    "mesh.ply": vectors.text("triangle.ply"),
    "glass.agf": GLASS,
    "lines.csv": "nm value\n500 1\n600 1\n",
    "edits.toml": '[[configuration]]\nname = "bare"\ncoat = { front = "other.csv" }\n',
    "other.csv": TABLE,
}
NOTE = "written by hand\n"
OWN = vectors.text("own_power.toml")
# The arguments of every command with --out, and a file that it writes there
FOLDERS = {
    ("ghosts", "scene.xml", "--formats", "fits"): ("paths.csv", "ghosts_12.5deg.png", "irradiance_0deg.fits"),
    ("image", "scene.xml"): ("image_quality.csv", "psf.png"),
    ("sweep", "scene.xml"): ("sweep.csv", "configurations.csv"),
    ("objects", "scene.xml"): ("objects.html", "objects_critical.csv"),
    ("pst", "scene.xml"): ("pst_state.npz", "pst.json", "irradiance_20deg.png"),
    ("study", "scene.xml"): ("pst_state.npz", "3_objects.csv"),
    ("thermal", "scene.xml", "--formats", "parquet"): ("thermal.csv", "thermal.parquet"),
    ("sensitivity", "scene.xml"): ("sensitivity.json", "ranking.png"),
    ("budget", "scene.xml", "budget.toml"): ("scene.xml", "budget.csv"),
    ("optimize", "scene.xml", "study.toml"): ("scene.xml", "checkpoint.json", "terms.csv"),
    ("validate", "--own", "own.toml"): ("validation.csv", "packs.csv", "differences.png"),
}
# The arguments of every command that is given names of files to write, without them, and the options of these
FILES = {
    ("import", "lens.zmx"): ("-o",),
    ("import", "cube.obj"): ("-o",),
    ("coat", "scene.xml", "*=table.csv"): ("-o",),
    ("export", "scene.xml"): ("-o",),
    ("view", "scene.xml", "--rays", "50"): ("--out", "--layout", "--save-rays"),
    ("coating", "table.csv"): ("--plot", "--csv"),
    ("bsdf", "abg", "--A", "0.01", "--B", "0.01", "--g", "2"): ("--plot", "--csv", "--table"),
    ("pst", "scene.xml"): ("--state",),
}
ENDINGS = {"--plot": ".png", "--csv": ".csv", "--table": ".csv", "--layout": ".svg", "--save-rays": ".ply"}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    """The working folder, with a file of every kind that commands read."""
    monkeypatch.chdir(tmp_path)
    texts = {"scene.xml": INPUTS["bare.xml"], "lens.zmx": ZMX, "cube.obj": CUBE, "table.csv": TABLE}
    for name, text in {**texts, "study.toml": STUDY, "budget.toml": BUDGET, "own.toml": OWN}.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture
def traces(monkeypatch: Patch) -> list[Any]:
    calls: list[Any] = []
    monkeypatch.setattr(Launches, "time", lambda *given: calls.append(given))
    return calls


def parsed(*arguments: str) -> argparse.Namespace:
    options = _parser().parse_args(list(arguments))
    options.guard = guard_of(options)
    return options


@pytest.mark.quick
def test_every_command_that_writes_is_here() -> None:
    tried = {arguments[0] for arguments in (*FOLDERS, *FILES)}
    options = {module.COMMAND.name: list(module.COMMAND.options) for module in COMMANDS}
    known = {name: {option.dest for option in own} for name, own in options.items()}
    writing = {name for name, own in known.items() if own & {"out", "output", "plot", "csv", "state"}}
    claimed = {name for name, own in options.items() if any(option.writes is not None for option in own)}
    tried.add("app")  # it writes when its page says so: tests/analyses/explorer/test_server.py
    assert tried == writing == claimed
    assert all("force" in known[name] for name in tried)


@pytest.mark.parametrize("command", FOLDERS, ids=" ".join)
def test_a_folder_with_results(capsys: Captured, folder: Path, traces: list[Any], command: tuple[str, ...]) -> None:
    for name in ("report.html", *FOLDERS[command]):
        if name == "report.html" and command[0] == "objects":
            continue
        place = folder / "out" / name
        place.parent.mkdir(exist_ok=True)
        place.write_text(NOTE)
        (place.parent / "notes.txt").write_text(NOTE)  # in nobody's way
        assert name in fails(capsys, *command, "--out", "out")
        assert place.read_text() == NOTE
        claim_folder(parsed(*command, "--out", "out", "--force"))
        place.unlink()
        claim_folder(parsed(*command, "--out", "out"))
    assert not traces


@pytest.mark.parametrize("command", FOLDERS, ids=" ".join)
def test_a_folder_with_an_input(capsys: Captured, folder: Path, traces: list[Any], command: tuple[str, ...]) -> None:
    """Whatever the file is called that a command reads: here a scene with the name of a result, by a hard link."""
    name = FOLDERS[command][0]
    (folder / "out").mkdir()
    os.link(folder / "scene.xml", folder / "out" / name)
    before = (folder / "scene.xml").read_bytes()
    for force in ((), ("--force",)):
        assert name in fails(capsys, *command, "--out", "out", *force)
    assert (folder / "scene.xml").read_bytes() == before
    assert not traces


@pytest.mark.parametrize("command", FILES, ids=" ".join)
def test_files_by_name(capsys: Captured, folder: Path, command: tuple[str, ...]) -> None:
    last = None
    for option in FILES[command]:
        ending = {"import": ".xml", "export": ".zmx", "view": ".html"}.get(command[0], ".npz")
        name = f"result{ENDINGS.get(option, ending)}"
        Path(name).write_text(NOTE)
        assert name in fails(capsys, *command, option, name)
        assert Path(name).read_text() == NOTE
        if option == "--state":
            claim_files(parsed(*command, option, name, "--force"), Path(name))
            continue
        succeeds(capsys, *command, option, name, "--force")
        assert Path(name).read_bytes() != NOTE.encode()
        last = option, name
    read = "scene.xml" if command[0] == "bsdf" else command[1]  # bsdf abg reads none
    if command[0] != "bsdf" and last is not None:
        option, name = last
        shutil.copy(read, "copy")
        Path(name).unlink()
        Path(name).symlink_to(read)
        for force in ([], ["--force"]):
            assert name in fails(capsys, *command, option, name, *force)
        assert Path(read).read_bytes() == Path("copy").read_bytes()
        assert Path(name).is_symlink()


@pytest.mark.parametrize("read", [*SYSTEM, "table.csv", "study.toml", "budget.toml"])
def test_the_folder_of_the_scene(capsys: Captured, folder: Path, traces: list[Any], read: str) -> None:
    """Whatever a command has opened, or Mitsuba for it, stays, although --force is given and a link hides it."""
    for name, text in SYSTEM.items():
        Path(name).write_text(text)
    command, result = {
        "edits.toml": (("sweep", "whole.xml", "edits.toml"), "sweep.csv"),
        "other.csv": (("sweep", "whole.xml", "edits.toml", "--pst-field-deg", "20"), "pst_sweep.csv"),
        "study.toml": (("optimize", "whole.xml", "study.toml"), "terms.csv"),
        "budget.toml": (("budget", "whole.xml", "budget.toml"), "budget.csv"),
    }.get(read, (("pst", "whole.xml"), "pst.csv"))
    os.link(read, result)
    before = Path(read).read_bytes()
    assert f"'{result}' is a file that this command reads" in fails(capsys, *command, "--out", ".", "--force")
    assert Path(read).read_bytes() == before
    assert not traces
    Path(result).unlink()
    Path(result).write_text(NOTE)  # nobody reads this one
    claim_folder(parsed(*command, "--out", ".", "--force"))


@pytest.mark.parametrize(
    ("command", "read"),
    [
        ("import lens.zmx --glass-catalogue glass.agf -o", "glass.agf"),
        ("import lens.zmx -o", "lens.zmx"),
        ("coat scene.xml *=table.csv -o", "table.csv"),
        ("coating table.csv --csv", "table.csv"),
    ],
)
def test_a_file_that_was_read(capsys: Captured, folder: Path, command: str, read: str) -> None:
    Path("glass.agf").write_text(GLASS)
    before = Path(read).read_bytes()
    assert read in fails(capsys, *command.split(), read)
    assert f"'{read}' is a file that this command reads" in fails(capsys, *command.split(), read, "--force")
    assert Path(read).read_bytes() == before


def test_meshes_beside_a_scene_of_mechanics(capsys: Captured, folder: Path) -> None:
    """Also by the name that a scene has where none is given."""
    succeeds(capsys, "import", "cube.obj")
    (mesh,) = folder.glob("cube_*.ply")
    assert "cube.xml" in fails(capsys, "import", "cube.obj")
    Path("cube.xml").unlink()
    mesh.write_text(NOTE)
    assert mesh.name in fails(capsys, "import", "cube.obj")
    assert mesh.read_text() == NOTE
    assert not Path("cube.xml").exists()


def test_a_state_goes_on_with_resume_alone(capsys: Captured, traces: list[Any]) -> None:
    Path("out").mkdir()
    for name in ("pst_state.npz", "report.html"):
        Path("out", name).write_text(NOTE)
    assert "--resume" in fails(capsys, "pst", "scene.xml", "--out", "out")
    claim_folder(parsed("pst", "scene.xml", "--out", "out", "--resume"))
    assert not traces


@pytest.mark.parametrize("redirected", ["file", "pipe"])
def test_standard_output_is_written_on(folder: Path, redirected: str) -> None:
    """What comes before stays, the file that the shell has opened too; the name of the stream is not replaced."""
    words = (sys.executable, "-m", "mistray", "coating", "table.csv", "--csv")
    if redirected == "file":
        with Path("all.txt").open("wb") as file:
            file.write(b"before\n")
            file.flush()
            done = subprocess.run([*words, "/dev/stdout"], stdout=file, stderr=subprocess.PIPE)
        text = Path("all.txt").read_text()
        assert text.startswith("before\n")
    else:
        done = subprocess.run([*words, "/dev/fd/1"], capture_output=True)
        text = done.stdout.decode()
    assert (done.returncode, done.stderr) == (0, b"")
    subprocess.run([*words, "table of its own.csv"], check=True, capture_output=True)
    assert Path("table of its own.csv").read_text() in text
    assert "angle" in text.replace(Path("table of its own.csv").read_text(), "")  # what is printed is there as well
    assert os.path.islink("/dev/stdout")


@pytest.mark.parametrize("option", ["--csv", "--plot", "--table"])
def test_outputs_that_are_no_files(capsys: Captured, folder: Path, option: str) -> None:
    """A full disk, a folder and a socket are named; the null device takes everything."""
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")
    Path("folder").mkdir()
    model = ("bsdf", "abg", "--A", "0.01", "--B", "0.01", "--g", "2")
    ends = ENDINGS[option]
    for name, target in (("full", "/dev/full"), ("folder", "folder"), ("socket", "socket")):
        Path(f"{name}{ends}").symlink_to(target)
        assert f"{name}{ends}" in fails(capsys, *model, option, f"{name}{ends}", "--json")
    assert "twice" in fails(capsys, *model, "--csv", "a.csv", "--table", "./a.csv")
    Path(f"null{ends}").symlink_to("/dev/null")
    succeeds(capsys, *model, option, f"null{ends}", "--json")
    for output in (f"null{ends}", "/dev/stdout"):
        assert "beside" in fails(capsys, "import", "cube.obj", "-o", output)  # which gives several files


def test_a_guard(tmp_path: Path) -> None:
    """What the block itself wrote it may replace; a program that names a file means it."""
    source, link, other, dangling, own = (tmp_path / name for name in ("in", "link", "other", "dangling", "own"))
    source.write_text(NOTE)
    link.symlink_to(source)
    dangling.symlink_to(tmp_path / "nothing")
    for force, refused in ((False, (source, link, tmp_path / "." / "in", dangling)), (True, (source, link))):
        with guarding(Guard(force)):
            read_file(source)
            read_file(replace_file(own, ""), own=True)
            replace_file(own, "its own")
            for text in ("1", "2"):
                replace_file(other, text)
            for path in refused:
                with pytest.raises(MistrayError, match=path.name):
                    replace_file(path, "")
        other.unlink()
        own.unlink()
    assert source.read_text() == NOTE
    replace_file(source, "")
    assert source.read_text() == ""

"""Closed streams, places without UTF-8 or home, no time: a line says what to do, or what was not traced."""

import io
import json
import os
import re
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from attack.processes import MISTRAY
from command_line import Captured, Patch, fails
from oracles.small_scenes import plates_text, write

import mistray
from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables
from mistray.analyses.sweep import page as sweep_page
from mistray.cli.program import COMMANDS
from mistray.errors import MistrayWarning
from mistray.report import writable_directory, write_pst
from mistray.toolkit.figures.figure import Figure

CONTENTS = [bytes([letter]) * 300_000 for letter in b"abcd"]
# An option of every kind
KINDS = {
    (str(option.type), option.nargs): (module.COMMAND.name, word)
    for module in COMMANDS
    for option in module.COMMAND.options
    for word in option.name.split()
    if word.startswith("--") and option.type is not bool
}


@pytest.mark.quick
def test_arguments_that_are_none(capsys: Captured, tmp_path: Path, monkeypatch: Patch) -> None:
    """Two dashes, of which argparse of Python 3.11 makes an empty list; a name that is empty; a filter too deep."""
    monkeypatch.chdir(tmp_path)
    assert len(KINDS) > 30
    for command, option in KINDS.values():
        line = fails(capsys, command, f"{option}=--")
        assert option in line
        assert "'--' is not a value" in line or "expected" in line
    for words in (("ghosts", "plate", "--out", ""), ("import", "a.zmx", "-o", " "), ("view", "plate", "--layout=")):
        assert "names nothing" in fails(capsys, *words)
    with pytest.raises(ValueError, match="no name"):
        writable_directory("")
    for text in ("(" * 5000 + "H" + ")" * 5000, "!" * 20_000 + "H", "(" * 101 + "H" + ")" * 101):
        line = fails(capsys, "ghosts", "plate", "--filter", text)
        assert "filter '" in line
        assert "100 are the most" in line
        assert len(line) < 400
    assert not list(tmp_path.iterdir())


def test_letters_that_a_font_does_not_have() -> None:
    figure = Figure()
    figure.headed("L\N{COLLISION SYMBOL}_front", "\N{COLLISION SYMBOL}")
    with pytest.warns(MistrayWarning, match="COLLISION SYMBOL") as caught:
        figure.savefig(io.BytesIO(), format="png", bbox_inches="tight")
    assert len(caught) == 1


WRITER = """
import sys
sys.argv, out = ["mistray"], sys.argv[1]
from mistray.toolkit.pages.output import write_files
print(flush=True)
while True:
    for letter in b"abcd":
        data = bytes([letter]) * 300_000
        write_files({"paths.csv": data, "report.html": data}, out)
"""


def test_two_processes_write_the_same_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", WRITER, str(out)]
    with ExitStack() as stack:
        both = [stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)) for _ in range(2)]
        for process in both:
            stack.callback(process.kill)
        for process in both:
            assert process.stdout is not None
            process.stdout.readline()
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            # Drafts end in .part; the record of a set that is being replaced starts with a dot
            for name in ("paths.csv", "report.html"):
                assert not (out / name).exists() or (out / name).read_bytes() in CONTENTS
        ends = [process.poll() for process in both]
    assert ends == [None, None]  # neither has met a draft of the other
    assert {"paths.csv", "report.html"} <= {path.name for path in out.iterdir()}


def test_nobody_reads_the_output() -> None:
    full = "mistray: error: No space left on device; "
    for command, code, told in (
        ("--help | true", 0, ""), ("ghosts --help | true", 0, ""), ("completion bash | head -1", 0, ""),
        ("--version >&-", 0, ""), ("--version > /dev/full", 2, full),
    ):  # fmt: skip
        line = f"set -o pipefail; {' '.join(MISTRAY)} {command}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60)
        assert done.returncode == code
        assert done.stderr[: len(full)] == told
        assert done.stderr.count("\n") == bool(told)


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


FIELDS = [k / 10 for k in range(200)]


@pytest.fixture
def lens(tmp_path: Path) -> Path:
    return write(tmp_path, plates_text(1))


def test_fields_without_time_are_not_traced(lens: Path) -> None:
    scene = mistray.load(lens)
    mistray.trace(scene, rays=1000)  # compiles the kernel
    report = mistray.ghosts(scene, FIELDS, rays=1_000_000, seconds=1.5)
    missing = list(report.not_traced)
    assert 0.0 in report
    assert missing
    assert sorted([*report, *missing]) == FIELDS
    assert report.settings["not_traced_deg"] == missing
    table = csv_tables(report)["summary.csv"].set_index("field_deg")
    assert len(table) == len(FIELDS)
    assert table.loc[missing].isna().all(axis=None)
    assert table.loc[list(report), "stray_W"].notna().all()


def test_wavelengths_without_time_are_left_to_their_neighbours(lens: Path) -> None:
    """Weights that rise along the band keep their sum and, to the distance of those that are traced, their mean."""
    scene = mistray.load(lens)
    mistray.trace(scene, rays=1000)  # compiles the kernel
    nm, weights = np.linspace(450.0, 650.0, 2000), np.linspace(1.0, 3.0, 2000)
    light = {"rays": 1_000_000, "wavelength_nm": nm, "weights": weights}
    for found in (mistray.trace(scene, seconds=2.0, **light), mistray.ghosts(scene, [0.0, 5.0], seconds=2.0, **light)):
        settings = found.settings
        kept, missing = settings["wavelength_nm"], settings["not_traced_nm"]
        assert 2 < len(kept) < 1000
        assert sorted([*kept, *missing]) == pytest.approx(nm.tolist())
        assert {nm[0], nm[-1]} <= set(kept)
        assert sum(settings["weights"]) == pytest.approx(1.0)
        mean = np.average(nm, weights=weights)
        assert np.dot(kept, settings["weights"]) == pytest.approx(mean, abs=100 / len(kept))
        assert [note for note in found.notes if note.code == "wavelengths"]
    assert "not_traced_nm" not in mistray.trace(scene, seconds=60.0, rays=1000, wavelength_nm=nm[:4]).settings


def test_rows_of_a_sweep_without_time_are_not_traced(lens: Path) -> None:
    found = mistray.sweep(lens, FIELDS[:100], [500, 600], cache=False, rays=1_000_000, seconds=2.0)
    assert 0 < len(found) < 200
    table = found.to_pandas()
    assert len(table) == len(found) + len(found.not_traced) == 200
    assert int(table.stray_W.isna().sum()) == len(found.not_traced)
    assert any("not traced" in text and "of 200 rows" in text for text in found.warnings)
    assert len({tuple(row) for row in sweep_page.record(found)["rows"]}) == 1
    _, field_deg, wavelength_nm = found.not_traced[0]
    with pytest.raises(mistray.MistrayError, match="not finished"):
        found.estimate("stray_W", field_deg=field_deg, wavelength_nm=wavelength_nm)


def test_cells_of_a_pst_without_time_are_not_traced(lens: Path, tmp_path: Path) -> None:
    scene = mistray.load(lens)
    with pytest.warns(mistray.MistrayWarning, match="not traced, for the time was up: .* of 200 cells"):
        found = mistray.pst(scene, [k / 4 for k in range(200)], method="forward", rays=1_000_000, seconds=1.5)
    missing = [angle for angle, _ in found.facts["not_traced"]]
    assert 0 < len(missing) < 200
    assert found.field_deg[np.isnan(found.value)].tolist() == missing
    assert np.isnan(found.stray).sum() == len(missing)
    assert found.value[0] > 0
    write_pst(found, tmp_path / "out")
    assert int(pd.read_csv(tmp_path / "out" / "pst.csv").pst_total.isna().sum()) == len(missing)
    rows = json.loads((tmp_path / "out" / "pst.json").read_text())["curve"]
    assert sum(row["pst_total"] is None for row in rows) == len(missing)


def test_a_pass_that_cannot_end_early_is_not_cut_into_short_launches(lens: Path) -> None:
    """Launches of 0.1 s of which each takes about as long whatever its rays made a pass of 2 s one of 30."""
    scene = mistray.load(lens)
    mistray.pst(scene, [0, 20, 40], rays=1000)  # compiles the kernels
    began = time.monotonic()
    found = mistray.pst(scene, [0, 20, 40], rays=100_000_000, seconds=0.1)
    assert time.monotonic() - began < 5
    assert found.facts["rays"] < 100_000
    assert found.value[0] > 0


def test_the_time_of_the_compilation_is_said(tmp_path: Path) -> None:
    """With real kernels: in a new home there is no cache of them, and the second time there is."""
    command = [*MISTRAY, "ghosts", "phone_camera_scatter", "--max-scatters", "1", "--rays", "100", "--seconds", "20"]
    place = {**os.environ, "HOME": str(tmp_path)}  # where Dr.Jit keeps its kernels
    told = [subprocess.run(command, capture_output=True, text=True, check=True, env=place).stderr for _ in range(2)]
    (seconds,) = re.findall(r"mistray: ([\d.]+) s went into the compilation of kernels", told[0])
    assert float(seconds) >= 0.5
    assert "compilation" not in told[1]


STATES = "".join(f'[[configuration]]\nname = "c{k}"\nvalues = {{ "L1_rear.z" = {k / 1e3} }}\n' for k in range(50))
MANY = ("--rays", "1e9")
# Arguments, limit, and the most that the whole command may take beyond it where others use the machine, s
TIMED: dict[str, tuple[tuple[str, ...], float, float]] = {
    "11 fields": (("ghosts", "singlet_window_detector", "--field-deg=-20:20:4"), 20, 4),
    "161 fields": (("ghosts", "singlet_window_detector", "--field-deg=-20:20:0.25", "--out", "out"), 20, 4),
    "plates": (("ghosts", "plates.xml", "--max-reflections", "6", "--out", "out"), 10, 8),
    "rays": (("ghosts", "plate.xml", "--rays", "2e9", "--out", "out"), 10, 8),
    "pst of a camera": (("pst", "phone_camera_scatter"), 20, 4),
    "pst of a tube": (("pst", "baffle_tube", "--out", "out", "--force"), 20, 4),
    "forward pst": (("pst", "phone_camera_scatter", "--method", "forward", "--field-deg", "0:80:0.5"), 20, 4),
    "pst": (("pst", "plate.xml", "--field-deg", "0", "20", *MANY), 10, 10),
    "objects": (("objects", "plate.xml", *MANY), 10, 10),
    "study": (("study", "plate.xml", *MANY), 10, 10),
    "sweep": (("sweep", "plate.xml", "--no-cache", *MANY), 10, 10),
    "rows": (("sweep", "singlet_window_detector", "s.toml", "--no-cache", "--field-deg", "0:19.8:0.2"), 20, 4),
}
COUNTS = {"11 fields": ("fields", 11), "161 fields": ("fields", 161), "rows": ("rows", 5000)}


@pytest.mark.slow
@pytest.mark.parametrize("name", TIMED)
def test_commands_end_in_time(name: str, tmp_path: Path) -> None:
    """With a result that says what is missing, null where a row is not traced, and on disk the same rows."""
    for count in (1, 15):
        write(tmp_path, plates_text(count)).rename(tmp_path / ("plate.xml" if count == 1 else "plates.xml"))
    (tmp_path / "s.toml").write_text(STATES)
    arguments, limit_s, late_s = TIMED[name]
    rays = () if "--rays" in arguments else ("--rays", "1e6")
    command = [*MISTRAY, *arguments, *rays, "--json", "--seconds", f"{limit_s:g}"]
    for _ in range(2 if limit_s == 20 and arguments[0] == "pst" else 1):  # the first one compiles
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        late = time.monotonic() - began - limit_s
    assert late < late_s
    found = json.loads(done.stdout)
    if limit_s == 10:
        assert "rays were traced" in done.stdout + done.stderr or "fewer rays" in done.stdout + done.stderr
    if arguments[0] == "pst":
        assert any(row["pst_total"] for row in found["curve"])
    if name in COUNTS:
        key, count = COUNTS[name]
        values = [row["stray_W"] for row in found[key]]
        assert len(values) == count
        assert sum(value is not None for value in values) > 0
        assert None in values or name != "rows"
        if "--out" in arguments:
            table = pd.read_csv(tmp_path / "out" / "summary.csv")
            assert int(table.stray_W.notna().sum()) == sum(value is not None for value in values)

"""A time budget holds whatever there is to trace: what it leaves out is listed as not traced, and never 0."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from attack.processes import MISTRAY
from oracles.small_scenes import plates_text, write

import mistray
from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables
from mistray.analyses.pst.page import write_pst

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
        assert np.dot(kept, settings["weights"]) == pytest.approx(
            np.dot(nm, weights) / weights.sum(), abs=100 / len(kept)
        )
        assert [note for note in found.notes if note.code == "wavelengths"]
    assert "not_traced_nm" not in mistray.trace(scene, seconds=60.0, rays=1000, wavelength_nm=nm[:4]).settings


def test_rows_of_a_sweep_without_time_are_not_traced(lens: Path) -> None:
    found = mistray.sweep(lens, FIELDS[:100], [500, 600], cache=False, rays=1_000_000, seconds=2.0)
    assert 0 < len(found) < 200
    table = found.to_pandas()
    assert len(table) == len(found) + len(found.not_traced) == 200
    assert int(table.stray_W.isna().sum()) == len(found.not_traced)
    assert any("not traced" in text and "of 200 rows" in text for text in found.warnings)
    _, field_deg, wavelength_nm = found.not_traced[0]
    with pytest.raises(mistray.MistrayError, match="not finished"):
        found.estimate("stray_W", field_deg=field_deg, wavelength_nm=wavelength_nm)


@pytest.mark.long
def test_cells_of_a_pst_without_time_are_not_traced(lens: Path, tmp_path: Path) -> None:
    scene = mistray.load(lens)
    angles = [k / 4 for k in range(200)]
    with pytest.warns(mistray.MistrayWarning, match="not traced, for the time was up: .* of 200 cells"):
        found = mistray.pst(scene, angles, method="forward", rays=1_000_000, seconds=1.5)
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


@pytest.mark.long
def test_the_time_of_the_compilation_is_said(tmp_path: Path) -> None:
    """With real kernels: in a new home there is no cache of them, and the second time there is."""
    command = [*MISTRAY, "ghosts", "singlet_window_detector", "--rays", "100", "--seconds", "5"]
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

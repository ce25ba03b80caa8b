"""A time budget holds whatever there is to trace: what it leaves out is listed as not traced, and never 0."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.report.tables.ghosts_csv import csv_tables
from mistray.time_budget import coarse_first

MISTRAY = [sys.executable, "-m", "mistray"]
FIELDS = [k / 10 for k in range(200)]


@pytest.fixture
def lens(tmp_path: Path) -> Path:
    """One plate of glass."""
    return write(tmp_path, plates_text(1))


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 64, 100])
def test_every_beginning_of_an_order_is_spread(count: int) -> None:
    """Of n numbers the gaps are at most those of equal steps, rounded up to a power of two."""
    order = coarse_first(range(count))
    assert sorted(order) == list(range(count))
    for taken in range(2, count + 1):
        found = sorted(order[:taken])
        assert max(b - a for a, b in itertools.pairwise(found)) <= max(4 * (count - 1) / (taken - 1), 1)


def test_fields_without_time_are_not_traced(lens: Path) -> None:
    scene = mistray.load(lens)
    mistray.trace(scene, rays=1000)  # compiles the kernel
    report = mistray.ghosts(scene, FIELDS, rays=1_000_000, seconds=1.5)
    missing = report.not_traced
    assert 0.0 in report
    assert len(report) + len(missing) == len(FIELDS)
    assert len(missing) > 0
    assert not set(missing) & set(report)
    assert report.settings["not_traced_deg"] == list(missing)
    table = csv_tables(report)["summary.csv"].set_index("field_deg")
    assert len(table) == len(FIELDS)
    assert table.loc[list(missing)].isna().all(axis=None)
    assert table.loc[list(report), "stray_W"].notna().all()


def test_rows_of_a_sweep_without_time_are_not_traced(lens: Path) -> None:
    found = mistray.sweep(lens, FIELDS[:100], [500, 600], cache=False, rays=1_000_000, seconds=2.0)
    assert len(found) + len(found.not_traced) == 200
    assert 0 < len(found) < 200
    table = found.to_pandas()
    assert len(table) == 200
    assert int(table.stray_W.isna().sum()) == len(found.not_traced)
    assert any("not traced" in text and "of 200 rows" in text for text in found.warnings)
    _, field_deg, wavelength_nm = found.not_traced[0]
    with pytest.raises(mistray.MistrayError, match="not finished"):
        found.estimate("stray_W", field_deg=field_deg, wavelength_nm=wavelength_nm)


def test_without_a_budget_nothing_is_left_out(lens: Path) -> None:
    report = mistray.ghosts(mistray.load(lens), [0, 1, 2], rays=1000)
    assert (list(report), report.not_traced) == ([0, 1, 2], ())


def timed(arguments: list[str], limit_s: float) -> tuple[float, Any]:
    """Seconds beyond the limit, and the JSON, of a command that has it."""
    began = time.monotonic()
    done = subprocess.run(
        [*MISTRAY, *arguments, "--json", "--rays", "1e6", "--seconds", f"{limit_s:g}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return time.monotonic() - began - limit_s, json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("fields", [11, 161])
@pytest.mark.parametrize("out", [False, True])
def test_ghosts_end_in_time(fields: int, out: bool, tmp_path: Path) -> None:
    """On a machine that others use too: twice what is promised."""
    angles = [f"{40 * k / (fields - 1) - 20:g}" for k in range(fields)]
    more = ["--out", str(tmp_path / "out")] if out else []
    late, found = timed(["ghosts", "singlet_window_detector", "--field-deg", *angles, *more], 20.0)
    assert late < 4.0
    assert len(found["fields"]) == fields
    traced = [row for row in found["fields"] if row["stray_W"] is not None]
    assert traced
    if out:
        table = pd.read_csv(tmp_path / "out" / "summary.csv")
        assert int(table.stray_W.notna().sum()) == len(traced)


@pytest.mark.slow
def test_a_sweep_of_many_rows_ends_in_time(tmp_path: Path) -> None:
    states = "".join(f'[[configuration]]\nname = "c{k}"\nvalues = {{ "L1_rear.z" = {k / 1e3} }}\n' for k in range(50))
    (tmp_path / "states.toml").write_text(states)
    angles = [f"{k / 5:g}" for k in range(100)]
    arguments = ["sweep", "singlet_window_detector", str(tmp_path / "states.toml"), "--no-cache"]
    late, found = timed([*arguments, "--field-deg", *angles], 20.0)
    assert late < 4.0
    assert len(found["rows"]) == 5000
    values = [row["stray_W"] for row in found["rows"]]
    assert 0 < sum(value is not None for value in values) < 5000
    assert all(value is None or math.isfinite(value) for value in values)

"""`mistray sensitivity` and `mistray budget`: tables, files, JSON, bad input."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import json_units
import pandas as pd
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import plates_text, scene_text, shape_xml, write

from mistray import cli

FEW = ("--rays", "64", "--parameter", "p0_*.bsdf.[RT]")
BUDGET = """
[[require]]
metric = "path_power"
selection = "single scatter"
limit = {limit}

[[choose]]
surfaces = ["front", "rear"]
parameter = "rms_nm"
best = 0.5
worst = 8

[traced]
rays = 256
max_reflections = 0

[solver]
seeds = 2
iterations = 2
"""


@pytest.fixture
def plate(tmp_path: Path) -> str:
    return str(write(tmp_path, plates_text(1, R=0.1, T=0.8)))


@pytest.fixture
def rough(tmp_path: Path) -> str:
    polish = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.05, s=-2.0, event="transmission")
    faces = (("front", 0.0, "air", "1.5"), ("rear", 15.0, "1.5", "air"))
    return str(
        write(
            tmp_path,
            scene_text(
                *(
                    shape_xml("asphere", name, z, scattering_xml([polish], a, b, R=0.04, T=0.96), semi_diameter=20.0)
                    for name, z, a, b in faces
                ),
                shape_xml("asphere", "detector", 30.0, sensor=True, half_width=5.0, half_height=5.0),
            ),
        )
    )


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


class TestSensitivity:
    def test_table_and_files(self, capsys: Any, plate: str, tmp_path: Path) -> None:
        out = tmp_path / "new" / "out"
        code, printed, errors = run(
            capsys, "sensitivity", plate, *FEW, "--monte-carlo", "4", "--together", "p0_*.R", "--out", str(out),
            "--formats", "parquet",
        )  # fmt: skip
        assert (code, errors) == (0, "")
        assert printed.startswith("path power: 0.0064 ")
        assert "in a group" in printed
        assert "2 changes that lower it" in printed
        assert "together 'p0_*.R' (2 parameters): " in printed
        assert "4 perturbed systems" in printed
        assert "not in the derivatives: branches below flux_threshold" in printed
        names = {path.name for path in out.iterdir()}
        assert names == {"sensitivity.csv", "propagation.csv", "draws.csv", "sensitivity.json", "ranking.png",
                         "monte_carlo.png", "report.html", "sensitivity.parquet", "propagation.parquet",
                         "draws.parquet", "sensitivity_state.npz"}  # fmt: skip
        draws = pd.read_parquet(out / "draws.parquet")
        assert draws.ratio.tolist() == pytest.approx(pd.read_csv(out / "draws.csv").ratio.tolist(), rel=1e-8)
        table = pd.read_csv(out / "sensitivity.csv")
        assert list(table.change_percent.round(3)) == [20, 20, 5, 5]
        html = (out / "report.html").read_text(encoding="utf-8")
        assert html.count("data:image/png") == 2
        assert "mistray sensitivity" in html
        assert "p0_front.bsdf.R" in html

    def test_json(self, capsys: Any, plate: str) -> None:
        code, printed, _ = run(capsys, "sensitivity", plate, *FEW, "--no-check", "--tolerance", "*.R=0.01", "--json")
        assert code == 0
        record = json_units.read(printed)
        assert record["metric"]["value"] == pytest.approx(0.0064, rel=1e-5)
        first = record["parameters"][0]
        assert (first["tolerance"], first["change_percent"]) == (0.01, pytest.approx(10, rel=1e-4))
        assert record["monte_carlo"] is None
        assert record["together"]["traced"] is None
        assert record["files"] == []

    def test_a_time_and_a_saved_run(self, capsys: Any, plate: str, tmp_path: Path) -> None:
        """What had no time is told in text and JSON; the run goes on in its folder, and needs a state for that."""
        out = str(tmp_path / "out")
        command = ["sensitivity", plate, "--parameter", "p0_*.bsdf.[RT]", "--rays", "2e6", "--out", out, "--json"]
        code, printed, _ = run(capsys, *command, "--monte-carlo", "100000", "--seconds", "5")
        short = json.loads(printed)
        assert code == 0
        assert any("perturbed systems" in text for text in short["not_traced"])
        assert f"{out}/sensitivity.json" in short["files"]
        code, printed, _ = run(capsys, *command, "--monte-carlo", "3", "--seconds", "0.1", "--resume")
        assert code == 0
        assert json.loads(printed)["metric"] == short["metric"]
        assert "give --state FILE" in run(capsys, "sensitivity", plate, *FEW, "--resume")[2]
        assert "no saved run" in run(capsys, "sensitivity", plate, *FEW, "--resume", "--out", f"{out}2")[2]

    def test_a_kind(self, capsys: Any, plate: str) -> None:
        code, printed, _ = run(
            capsys, "sensitivity", plate, "--rays", "64", "--kind", "index", "--no-check", "--metric", "transmission"
        )
        assert code == 0
        assert "index of 1.5" in printed
        assert "no derivative is known well enough to propose a change" in printed

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("--parameter", "p0_front.bsdf.Q"), "or p0_front.bsdf.R or"),
            (("--kind", "scatter"), "the scene has no parameter of kind scatter"),
            (("--kind", "colour"), "invalid choice: 'colour'"),
            (("--metric", "pst_band"), "the metric pst_band needs --band-deg"),
            (("--band-deg", "20", "80"), "--band-deg is not about the metric path_power; it takes --paths"),
            (("--metric", "pst_band", "--band-deg", "80", "20"), "field angles must ascend"),
            (("--paths", "phantom"), "'phantom' is no kind of path"),
            (("--tolerance", "0.1"), "'0.1' is no tolerance; write KEY=VALUE"),
            (("--factor", "1"), "--factor: 1 must lie between 1 and 1e6, 1 excluded"),
            (("--rays", "0"), "--rays: 0 must"),
            (("--weights", "1"), "--weights without --wavelength-nm"),
            (("--edge-width", "2", "--parameter", "*.x"), "--edge-width: 2 must lie between"),
        ],
    )
    def test_bad_input_is_one_line(self, capsys: Any, plate: str, arguments: tuple[str, ...], words: str) -> None:
        code, printed, errors = run(capsys, "sensitivity", plate, "--rays", "64", *arguments)
        assert (code, printed, errors.count("\n")) == (2, "", 1)
        assert errors.startswith("mistray: error: ")
        assert words in errors

    def test_nothing_is_traced_when_the_output_cannot_be_written(
        self, capsys: Any, plate: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(importlib.import_module("mistray.optimize.tolerances.sensitivity"), "sensitivity", None)
        code, _, errors = run(capsys, "sensitivity", plate, "--out", plate)
        assert code == 2
        assert "is a file; name a directory" in errors

    def test_help(self, capsys: Any) -> None:
        assert cli.main(["sensitivity", "--help"]) == 0
        assert "mistray sensitivity baffle_tube --metric pst_band --band-deg 20 80" in capsys.readouterr().out


class TestBudget:
    def test_table_and_files(self, capsys: Any, rough: str, tmp_path: Path) -> None:
        study, out = tmp_path / "budget.toml", tmp_path / "out"
        study.write_text(BUDGET.format(limit=1e-4))
        more = ("--out", str(out), "--formats", "parquet")
        code, printed, errors = run(capsys, "budget", rough, str(study), *more)
        assert (code, errors) == (0, "")
        assert "met by" in printed
        assert "cost: 4 before" in printed
        names = {path.name for path in out.iterdir()}
        assert names == {"scene.xml", "budget.csv", "requirements.csv", "budget.json", "budget.png", "report.html",
                         "budget.parquet", "requirements.parquet"}  # fmt: skip
        record = json.loads((out / "budget.json").read_text())
        assert record["met"]
        table = pd.read_csv(out / "budget.csv")
        assert list(table.surfaces) == ["front", "rear"]
        assert f'name="rms_nm" value="{record["numbers"][0]["after"]!r}"' in (out / "scene.xml").read_text()
        assert "mistray budget" in (out / "report.html").read_text(encoding="utf-8")
        # The scene that was written is the one of the table
        code, printed, _ = run(capsys, "budget", str(out / "scene.xml"), str(study), "--json")
        assert code == 0
        assert [row["before"] for row in json_units.read(printed)["numbers"]] == pytest.approx(
            list(table.after), rel=1e-6
        )

    def test_a_limit_that_cannot_be_met(self, capsys: Any, rough: str, tmp_path: Path) -> None:
        study = tmp_path / "budget.toml"
        study.write_text(BUDGET.format(limit=1e-12))
        code, printed, errors = run(capsys, "budget", rough, str(study))
        assert (code, printed, errors.count("\n")) == (2, "", 1)
        assert "times the limit 1e-12" in errors

    def test_a_file_that_is_missing(self, capsys: Any, rough: str) -> None:
        code, _, errors = run(capsys, "budget", rough, "no.toml")
        assert code == 2
        assert "budget 'no.toml': No such file or directory; check the path" in errors

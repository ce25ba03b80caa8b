"""`--formats`: commands write the same results for other programs, and ask for what is missing before they trace."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from report.fake_pst import fake_pst
from report.fake_scene import lens_scene
from report.fake_trace import EXTENT, trace_at

import mistray.analysis
import mistray.scene
from mistray import cli
from mistray.cli import program
from mistray.report import formats, read_irradiance


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Replaces scene, tracer and PST; holds what was traced."""
    traced: list[Any] = []

    def trace(scene: Any, field_deg: float | None = None, progress: Any = None, **settings: Any) -> Any:
        traced.append(trace_at(field_deg or 0.0))
        return traced[-1]

    def pst(scene: Any, field_deg: Any, *, map_pixels: int = 0, **given: Any) -> Any:
        traced.append(fake_pst(field_deg=field_deg, map_pixels=map_pixels))
        return traced[-1]

    monkeypatch.setattr(importlib.import_module("mistray.analysis.field_traces"), "trace", trace)
    monkeypatch.setattr(importlib.import_module("mistray.analysis.pst.transmittance"), "pst", pst)
    monkeypatch.setattr(mistray.scene, "load", lambda *given: lens_scene())

    # Pictures take seconds, and are not asked for here
    ghosts_output = importlib.import_module("mistray.report.ghosts_output")
    monkeypatch.setattr(ghosts_output, "pages", lambda *_: {})
    monkeypatch.setattr(ghosts_output, "draw", lambda report, _: ({}, report))
    monkeypatch.setattr(importlib.import_module("mistray.report.pst_output"), "draw", lambda *_: {})
    return traced


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(arguments)
    out, err = capsys.readouterr()
    return code, out, err


def test_every_command_with_tables_has_formats() -> None:
    commands = [module.COMMAND for module in program.COMMANDS]
    with_tables = {
        command.name
        for command in commands
        if any(pattern.endswith((".csv", ".*")) for option in command.options for pattern in option.writes or ())
    }
    formats_of = {command.name for command in commands if "formats" in {option.dest for option in command.options}}
    assert formats_of == with_tables


def test_ghosts_in_all_formats(capsys: pytest.CaptureFixture[str], fake: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ("ghosts", "lens.xml", "--field-deg", "0", "--out", str(out), "--json")
    code, text, err = run(capsys, *command, "--formats", "parquet", "exr", "fits", "npy")
    assert (code, err) == (0, "")
    assert {Path(file).name for file in json.loads(text)["files"]} == {file.name for file in out.iterdir()}
    for ending in ("exr", "fits", "npy"):
        back = read_irradiance(out / f"irradiance_0deg.{ending}")
        wanted = fake[0].irradiance.astype(np.float32) if ending == "exr" else fake[0].irradiance
        assert np.array_equal(back.irradiance, wanted)
        assert back.extent == EXTENT
        assert back.facts["field_deg"] == 0
    for name in ("paths", "energy", "surfaces", "summary"):
        table = pd.read_csv(out / f"{name}.csv", dtype={"path_ids": str})
        pd.testing.assert_frame_equal(pd.read_parquet(out / f"{name}.parquet"), table, check_dtype=False, rtol=1e-12)


def test_pst_in_all_formats(capsys: pytest.CaptureFixture[str], fake: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ("pst", "lens.xml", "--field-deg", "0:40:20", "--map-field-deg", "20", "--out", str(out), "--quiet")
    assert run(capsys, *command, "--formats", "parquet", "fits") == (0, "", "")
    back = read_irradiance(out / "irradiance_20deg.fits")
    value, se = fake[0].irradiance(20.0)
    assert np.array_equal(back.irradiance, value)
    assert np.array_equal(back.irradiance_se, se, equal_nan=True)
    assert back.facts["source_W_mm2"] == 1.0
    assert len(pd.read_parquet(out / "pst.parquet")) == 3
    assert (out / "pst_paths.parquet").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("ghosts", "x", "--formats", "fits"), "--formats writes files; say with --out where they shall go"),
        (("objects", "x", "--formats", "parquet"), "--formats writes files; say with --out where they shall go"),
        (("thermal", "x", "--formats", "fits"), "argument --formats: invalid choice: 'fits'"),
        (
            ("pst", "x", "--out", "out", "--formats", "npy"),
            "--formats npy writes irradiance maps; say with --map-field-deg of which angles",
        ),
        (("ghosts", "x", "--out", "out", "--formats", "tiff"), "argument --formats: invalid choice: 'tiff'"),
    ],
)
def test_wrong_arguments(
    capsys: pytest.CaptureFixture[str], fake: list[Any], arguments: tuple[str, ...], message: str
) -> None:
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert not fake


def test_a_missing_package_is_told_before_the_trace(
    capsys: pytest.CaptureFixture[str], fake: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise mistray.MistrayError(f"{name} is not installed; run: pip install 'mistray[images]'")

    monkeypatch.setattr(formats, "require_format", missing)
    code, out, err = run(capsys, "ghosts", "x", "--out", str(tmp_path / "out"), "--formats", "fits")
    assert (code, out) == (2, "")
    assert err == "mistray: error: fits is not installed; run: pip install 'mistray[images]'\n"
    assert not fake
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("out", ["reports/one", "one"])
def test_the_last_line_names_the_page(
    out: str, capsys: pytest.CaptureFixture[str], fake: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, printed, _ = run(capsys, "ghosts", "scene.xml", "--out", out)
    assert code == 0
    assert printed.splitlines()[-1].endswith(f"open {Path(out) / 'report.html'}")

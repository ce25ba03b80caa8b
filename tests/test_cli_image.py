"""`mistray image`: what it prints and writes, one line for bad input."""

from __future__ import annotations

import json
from pathlib import Path

import json_units
import pandas as pd
import pytest

from mistray import cli

LENS = ("double_gauss", "--field-deg", "0", "10", "--grid", "32")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["image", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_text_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "image of a lens"
    code, text, err = run(capsys, *LENS, "--frequencies", "20", "40", "--out", str(out))
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in text.splitlines() if "°" in line] == ["0°", "10°"]
    pictures = {f"{name}.png" for name in ("mtf", "psf", "opd", "spots", "energy", "fields")}
    tables = {"image_quality.csv", "image_quality.json", "mtf.csv", "zernikes.csv", "report.html"}
    assert {file.name for file in out.iterdir()} == pictures | tables
    table = pd.read_csv(out / "image_quality.csv")
    assert list(table.field_deg) == [0, 10]
    assert table.mtf_tangential_20_per_mm.between(0, 1).all()
    curves = pd.read_csv(out / "mtf.csv")
    assert (curves.mtf_sagittal <= curves.diffraction_limit_sagittal + 0.02).all()
    assert "--frequencies 20 40" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, text, _ = run(capsys, *LENS, "--json", "--wavelength-nm", "486", "588", "--weights", "1", "3")
    assert code == 0
    record = json_units.read(text)
    assert record["facts"]["reference_wavelength_nm"] == 588
    assert record["stop"] == "stop_front"
    assert len(json.loads(text)["fields"][1]["zernikes_noll_waves"]) == 37


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("plate",), "afocal"),
        (("double_gauss", "--field-deg", "70"), "70°"),
        (("double_gauss", "--field-mm", "2"), "infinity"),
        (("double_gauss", "--stop", "nobody"), "'nobody'"),
        (("double_gauss", "--field-deg", "1", "--field-mm", "2"), "--field-mm"),
        (("double_gauss", "--grid", "8"), "8"),
    ],
)
def test_refused(arguments: tuple[str, ...], word: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code, out, err = run(capsys, *arguments)
    except SystemExit as error:  # what argparse refuses
        code, (out, err) = int(error.code or 0), capsys.readouterr()
    assert code != 0
    assert out == ""
    assert word in err
    assert "Traceback" not in err

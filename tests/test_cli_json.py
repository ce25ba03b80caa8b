"""`--json` of every command: strict JSON, one object, units in the names of the numbers."""

from __future__ import annotations

import json
import re
from pathlib import Path

import json_units
import numpy as np
import pytest
from report.fake_pst import fake_pst
from report.fake_scene import lens_scene
from report.fake_trace import scatter_trace_at, trace_in_colours

from mistray import cli
from mistray.analysis.ghosts import GhostReport
from mistray.cli import program
from mistray.cli.ghosts_json import as_json
from mistray.cli.options import print_json
from mistray.coatings import preset, spectrum
from mistray.report.tables.pst import pst_record

TESTS = Path(__file__).parent
# Commands without --json: what they print is for a shell to read
WITHOUT = {"completion"}
# Where the output of the others is given to json_units.read
CHECKED_IN = {
    "doctor": "test_cli.py",
    "import": "test_cli_import.py",
    "coat": "test_cli_json.py",
    "export": "test_cli_json.py",
    "view": "test_cli_view.py",
    "app": "test_cli_app.py",
    "ghosts": "test_cli.py",
    "image": "test_cli_image.py",
    "sweep": "test_cli_sweep.py",
    "objects": "test_cli_objects.py",
    "pst": "test_cli_pst.py",
    "study": "test_cli_study.py",
    "thermal": "test_cli_thermal.py",
    "coating": "test_cli_json.py",
    "bsdf": "test_cli_json.py",
    "sensitivity": "test_cli_sensitivity.py",
    "budget": "test_cli_sensitivity.py",
    "optimize": "test_cli_optimize.py",
    "cache": "test_cli_sweep.py",
}


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return json_units.read(out)


@pytest.mark.quick
def test_every_command_has_json_and_a_test() -> None:
    commands = [module.COMMAND for module in program.COMMANDS]
    having = {command.name for command in commands if "json" in {option.dest for option in command.options}}
    assert having == {command.name for command in commands} - WITHOUT
    assert set(CHECKED_IN) == having
    for name, file in CHECKED_IN.items():
        assert "json_units.read(" in (TESTS / file).read_text(encoding="utf-8"), (name, file)


def test_the_document_names_every_command() -> None:
    text = json_units.DOCUMENT.read_text(encoding="utf-8")
    named = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    assert set(CHECKED_IN) <= set(named)


@pytest.mark.parametrize(
    ("value", "keys"),
    [
        ({"height": 1.0}, {"height"}),
        ({"power_W": 1.0, "power_se_W": 0.1, "x_mm": None}, set()),
        ({"rows": [{"height": 1}, {"height_mm": 2}]}, {"rows.height"}),
        ({"absorbed_W": {"wall": {"value": 1.0, "se": 0.1}}}, set()),
        ({"absorbed": {"wall": {"value": 1.0, "se": 0.1}}}, {"absorbed.wall.value", "absorbed.wall.se"}),
        ({"value": 1.0, "se": 0.1, "unit": "mm"}, set()),
        ({"unit": "mm", "deeper": {"value": 1.0}}, {"deeper.value"}),
        ({"is_there": True, "rays": 1000, "share": 0.5, "share_se": 0.1}, set()),
        ({"window": 1.0, "_W": 1.0}, {"window"}),
    ],
)
def test_names_without_units_are_found(value: dict, keys: set[str]) -> None:
    assert json_units.wrong(value) == keys


@pytest.mark.parametrize("text", ['{"files": [], "x_mm": NaN}', '{"files": [], "x_mm": Infinity}', "[1]", '{"a": 1}'])
def test_other_output_is_found(text: str) -> None:
    with pytest.raises((AssertionError, KeyError)):
        json_units.read(text)


def test_numbers_that_are_not_finite_are_not_printed_as_such() -> None:
    with pytest.raises(ValueError, match="JSON"):
        print_json({"x_mm": float("nan")})


def test_ghosts() -> None:
    traces = {field: scatter_trace_at(field) for field in (0.0, 20.0)}
    assert not json_units.wrong(as_json(GhostReport(lens_scene(), traces, traces[0.0], {})))
    coloured = trace_in_colours(0.0)
    record = as_json(GhostReport(lens_scene(), {0.0: coloured}, coloured, {}), per_wavelength=True)
    assert not json_units.wrong(record)
    json.dumps(record, allow_nan=False)


@pytest.mark.parametrize("azimuths", [None, [0.0, 90.0]])
def test_pst(azimuths: list[float] | None) -> None:
    record = pst_record(fake_pst(azimuths_deg=azimuths))
    assert not json_units.wrong(record)
    json.dumps(record, allow_nan=False)


def test_export(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    coated = run(capsys, "coat", "plate", "*=bbar3", "-o", str(tmp_path / "coated.xml"), "--json")
    assert [change["surface"] for change in coated["changes"]] == ["plate_front", "plate_rear"]
    answer = run(capsys, "export", "plate", "-o", str(tmp_path / "plate.zmx"), "--json")
    assert answer["surfaces"] >= 2
    assert answer["files"] == [str(tmp_path / "plate.zmx")]


def test_coating(capsys: pytest.CaptureFixture[str]) -> None:
    """All numbers of the spectrum, those of `mistray.coatings.spectrum`."""
    answer = run(capsys, "coating", "bbar3", "--wavelength-nm", "500", "600", "--angles-deg", "0", "40", "--json")
    values = spectrum(preset("bbar3", 550.0), [500.0, 600.0], [0.0, 40.0], "air", "N-BK7")
    rows = {(row["wavelength_nm"], row["angle_deg"]): row for row in answer["spectrum"]}
    assert len(rows) == 4
    for i, wavelength in enumerate((500.0, 600.0)):
        for k, angle in enumerate((0.0, 40.0)):
            row = rows[wavelength, angle]
            assert [row["R_s"], row["R_p"]] == values.R[i, k].tolist()
            assert [row["T_s"], row["T_p"]] == values.T[i, k].tolist()
            assert row["R_s"] + row["T_s"] + row["A_s"] == pytest.approx(1)
    assert answer["band"][1]["R_mean"] == pytest.approx(values.mean()[:, 1].mean())
    assert answer["band"][1]["R_least"] == values.mean()[:, 1].min()
    assert len(answer["layers"]) == 3
    layer = answer["layers"][0]
    assert layer["waves"] == pytest.approx(layer["n"] * layer["thickness_nm"] / answer["design_nm"])


def test_coating_of_a_scene(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    picture = tmp_path / "surfaces.png"
    command = ("coating", "cooke_triplet", "--wavelength-nm", "550", "600", "--angles-deg", "0", "30", "--json")
    answer = run(capsys, *command, "--plot", str(picture))
    assert answer["files"] == [str(picture)]
    assert sum(len(surface["names"]) for surface in answer["surfaces"]) >= 6
    assert {row["angle_deg"] for surface in answer["surfaces"] for row in surface["angles"]} == {0.0, 30.0}


def test_bsdf(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    curves = tmp_path / "curves.csv"
    answer = run(capsys, "bsdf", "abg", "--A", "0.0025", "--B", "0.001", "--g", "1.8", "--csv", str(curves), "--json")
    one = answer["curves"][0]
    r = np.array(one["distance"])
    assert np.array(one["bsdf_1_sr"]) == pytest.approx(0.0025 / (0.001 + r**1.8), rel=1e-6)
    assert answer["totals"][0]["incidence_deg"] == 0
    assert answer["totals"][0]["peak_1_sr"] == pytest.approx(2.5, rel=1e-3)
    assert answer["from_roughness"] is None
    assert answer["files"] == [str(curves)]


def test_bsdf_from_a_roughness(capsys: pytest.CaptureFixture[str]) -> None:
    answer = run(capsys, "bsdf", "abg", "--rms-nm", "5", "--correlation-um", "100", "--wavelength-nm", "500", "--json")
    sheet = answer["from_roughness"]
    assert sheet["bsdf_0_1_sr"] == pytest.approx(sheet["bsdf_per_psd_per_um4"] * sheet["psd_amplitude_um4"])
    assert sheet["A_1_sr"] / sheet["B"] == pytest.approx(answer["totals"][0]["peak_1_sr"], rel=1e-2)


def test_total_reflection_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    command = ("bsdf", "abg", "--A", "0.0025", "--B", "0.001", "--g", "1.8", "--from-back", "--json")
    answer = run(capsys, *command, "--angles-deg", "0", "60")
    rows = [row for row in answer["totals"] if row["event"] == "transmission"]
    assert [row["scattered"] is None for row in rows] == [False, True]

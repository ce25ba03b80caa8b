"""`mistray study`: findings, one report, JSON, bad input."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import json_units
import pytest

from mistray import cli
from mistray.analysis.study.step import STEPS

FEW = ("--rays", "2000", "--pst-field-deg", "0:60:20", "--field-deg", "0", "20")


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["study", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.long
def test_findings_and_one_report(capsys: Any, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    code, printed, errors = run(capsys, "plate_and_wall", *FEW, "--out", str(out))
    assert (code, errors) == (0, "")
    assert printed.startswith("Stray-light study of 'plate_and_wall'")
    for number, (_, title) in enumerate(STEPS, start=1):
        assert f"\n{number} {title}\n" in printed
    assert re.search(r"Main cause by angle: .*screen", printed)
    assert f"{out / 'report.html'}" in printed
    names = {path.name for path in out.iterdir()}
    assert {"report.html", "1_optical_surfaces.csv", "5_common.csv", "8_pst.csv", "pst_state.npz"} <= names
    html = (out / "report.html").read_text(encoding="utf-8")
    assert html.count("<section ") == len(STEPS) + 3
    # The answer comes first: of all angles, of the ghosts, and the table of the worst
    order = ["Change <b>screen</b> first", "Ghosts, without scatter", 'id="worst"', 'id="findings"']
    assert sorted(map(html.index, order)) == [html.index(text) for text in order]
    assert printed.index("Change screen first") < printed.index(STEPS[0][1])
    assert "mistray study plate_and_wall --rays 2000" in html
    assert html.count("data:image/png") >= 6
    # Going on from the saved PST is the same PST
    before = (out / "8_pst.csv").read_text()
    code, _, errors = run(capsys, "plate_and_wall", *FEW, "--out", str(out), "--resume", "--quiet")
    assert (code, errors) == (0, "")
    assert (out / "8_pst.csv").read_text() == before


def test_json(capsys: Any) -> None:
    code, printed, _ = run(capsys, "plate_and_wall", *FEW, "--json")
    assert code == 0
    record = json_units.read(printed)
    assert [step["key"] for step in record["steps"]] == [key for key, _ in STEPS]
    curve = record["steps"][7]["tables"]["pst"]
    assert [row["angle_deg"] for row in curve] == [0, 20, 40, 60]
    assert curve[0]["pst_total"] > curve[-1]["pst_total"] > 0
    focal = next(fact for fact in record["steps"][0]["facts"] if fact["name"] == "focal length")
    assert focal["value"] is None  # a flat plate: infinite
    assert record["files"] == []
    verdict = record["verdict"]["pst"]
    assert verdict["main_cause"]["cause"] == "screen"
    assert 50 < verdict["main_cause"]["percent_of_stray"] < 100
    assert verdict["main_cause"]["pst_left"] < verdict["main_cause"]["pst_stray"]
    assert any("screen" in text for text in verdict["sentences"])
    assert record["verdict"]["ghosts"]["remedy"]["deed"] == "reflects"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("no_such_scene",), "scene 'no_such_scene': no such file"),
        (("plate", "--pst-field-deg", "0:95:5"), "must lie between -90 and 90"),
        (("plate", "--pst-field-deg", "10", "5"), "must ascend"),
        (("plate", "--field-deg", "91"), "must lie between -90 and 90"),
        (("plate", "--rays", "0"), "--rays: 0 must"),
        (("plate", "--resume"), "--resume needs the folder"),
        (("plate", "--weights", "1"), "--weights without --wavelength-nm"),
        (("plate", "--relative-error", "-1"), "must lie between 1e-5 and 1"),
        (("plate", "--wavelength-nm", "red"), "'red' is not a number"),
    ],
)
def test_bad_input_is_one_line(capsys: Any, arguments: tuple[str, ...], words: str) -> None:
    code, printed, errors = run(capsys, *arguments)
    assert code == 2
    assert printed == ""
    assert errors.startswith("mistray: error: ")
    assert errors.count("\n") == 1
    assert words in errors


def test_nothing_is_traced_when_the_output_cannot_be_written(
    capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.import_module("mistray.analysis.study.eight_steps"), "study", None)
    file = tmp_path / "file"
    file.write_text("")
    code, _, errors = run(capsys, "plate", "--out", str(file))
    assert code == 2
    assert "is a file; name a directory" in errors


def test_an_interrupt_says_where_to_go_on(capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def study(*_: Any, **given: Any) -> None:
        given["state"].write_bytes(b"saved")
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("mistray.analysis.study.eight_steps"), "study", study)
    code, _, errors = run(capsys, "plate", "--out", str(tmp_path))
    assert code == 130
    assert "go on with --resume" in errors


def test_an_interrupt_before_anything_is_saved_says_so(
    capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pst_state.npz").write_bytes(b"of another run")

    def study(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("mistray.analysis.study.eight_steps"), "study", study)
    code, _, errors = run(capsys, "plate", "--out", str(tmp_path), "--force")
    assert code == 130
    assert "nothing was written" in errors

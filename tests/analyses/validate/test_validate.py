"""Published numbers beside ours: the criterion, files of one's own, other programs, and the packs that come along."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import html_pages
import pytest
from command_line import Captured, Patch, fails, succeeds
from refusals import refused
from test_every_command import INPUTS

from mistray import cli
from mistray.analyses.validate import page, run
from mistray.analyses.validate.declared import UNITS, DeclaredRow, read_reference
from mistray.analyses.validate.packs.known import PACKS
from mistray.analyses.validate.request import ValidateRequest
from mistray.analyses.validate.result import AGREES, DIFFERS, KNOWN, NOT_ASKED, TOO_FEW, ComparedRow, Validation
from mistray.analyses.validate.run import judged, run_validation
from mistray.estimate import UNKNOWN, Estimate

TRACED = ("rubin_ghosts", "lsst", "hsc", "decam", "phone_camera", "veiling_glare")
CLOSED = tuple(pack.name for pack in PACKS if pack.name not in TRACED)
ROW = DeclaredRow("row", published=2.0, uncertainty=0.3, tolerance=0.1, relative=0.05)
# Two faces of R 0.1 and T 0.8 before a detector: image T², ghost T² R² of the beam
OWN = """
title = "Two faces"
source = "R² of the image"
scene = "coated.xml"

[[row]]
name = "ghost"
quantity = "share_percent"
path = ["p0_rear", "p0_front"]
published = 0.990099
tolerance = 1e-6

[[row]]
name = "image"
quantity = "share_percent"
published = 99.009901
tolerance = 1e-5
"""


def verdict(difference: float, se: float = 0.4, row: DeclaredRow = ROW) -> ComparedRow:
    return judged("pack", row, "mm", Estimate(2.0, 0.3), Estimate(2.0 + difference, se))


def test_criterion() -> None:
    """Four standard errors of both, 4 · 0.5, the tolerance of 0.1, and a twentieth of 2."""
    assert verdict(0.0).allowed == pytest.approx(2.2)
    assert [verdict(d).verdict for d in (2.19, -2.19, 2.21, -2.21)] == [AGREES, AGREES, DIFFERS, DIFFERS]
    known = replace(ROW, differs="another glass")
    assert (verdict(3.0, row=known).verdict, verdict(3.0, row=known).why) == (KNOWN, "another glass")
    assert (verdict(1.0, row=known).verdict, verdict(1.0, row=known).why) == (AGREES, "")
    assert verdict(0.0, math.nan).verdict == TOO_FEW
    lost = judged("pack", replace(known, path=("a", "b")), "", Estimate(2.0, 0.0), None)
    assert judged("pack", known, "", Estimate(2.0, 0.0), UNKNOWN).verdict == TOO_FEW
    assert lost.verdict == DIFFERS, "a reason for a difference is none for light that is not there"
    assert "a → b" in lost.why
    exact = judged("pack", DeclaredRow("n", published=3.0), "1", Estimate(3.0, 0.0), Estimate(3.0, 0.0))
    assert (exact.verdict, exact.of_allowed) == (AGREES, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("title", "titel", "'titel'|titel is unknown"),
        ("published = 0.990099", "published = 'x'", "published is 'x'"),
        ("tolerance = 1e-6", "tolerance = -1", "tolerance is -1"),
        ("tolerance = 1e-6", "tolerance = 1e308", "tolerance is 1e.308"),
        ('"ghost"', '""', "name is ''"),
        ('"ghost"', '"image"', "'image' is there twice"),
        ('quantity = "share_percent"\npath', "path", "row 'ghost' has no quantity; give one of power_W"),
        ("share_percent", "share", "quantity is 'share'; choose from power_W, share_percent"),
        ("published = 0.990099\n", "", "row 'ghost' has no published"),
        ('scene = "coated.xml"', "", "scene is missing; name a scene file or a shipped scene"),
        ('scene = "coated.xml"', 'scene = "coted.xml"', "coted.xml"),
        ("tolerance = 1e-6", 'set = { "p0_front.bsdf.Q" = 0.2 }', "no parameter 'p0_front.bsdf.Q'; did you mean"),
        ("tolerance = 1e-6", "given = { a = 1 }", "row 'ghost' has a table 'given'"),
        (OWN[OWN.index("[[row]]") :], "", "row is missing"),
    ],
)
def test_wrong_files_of_ones_own_are_one_line(folder: Path, old: str, new: str, words: str) -> None:
    text = OWN.replace(old, new, 1) if old != 'quantity = "share_percent"\npath' else OWN.replace(old, new)
    Path("own.toml").write_text(text, encoding="utf-8")
    with refused(words):
        run_validation(ValidateRequest(own=("own.toml",), rays=64))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coated.xml").write_text(INPUTS["coated.xml"], encoding="utf-8")
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    return tmp_path


@pytest.mark.core
def test_own_numbers(folder: Path, capsys: Captured) -> None:
    """From elsewhere, too: the scene lies beside the file. A wrong number gives the exit code 1, a known one 0."""
    found = json.loads(succeeds(capsys, "validate", "--own", "own.toml", "--rays", "2000", "--json"))
    assert found["holds"]
    assert [row["verdict"] for row in found["rows"]] == [AGREES, AGREES]
    (folder / "deeper").mkdir()
    (folder / "deeper" / "more.toml").write_text(
        OWN.replace("coated.xml", "../coated.xml").replace("0.990099", "0.98"), encoding="utf-8"
    )
    assert cli.main(["validate", "--own", "deeper/more.toml", "own.toml", "--rays", "2000", "--out", "out"]) == 1
    text = capsys.readouterr().out
    assert "ghost: no reason is known; please report it" in text
    assert "4 numbers beside ours: 3 agree, 1 differ and should agree." in text
    html_pages.check((folder / "out" / "report.html").read_text(encoding="utf-8"))
    why = 'tolerance = 1e-6\ndiffers = "typed wrong"'
    (folder / "own.toml").write_text(OWN.replace("0.990099", "0.98").replace("tolerance = 1e-6", why))
    assert "ghost: typed wrong" in succeeds(capsys, "validate", "--own", "own.toml", "--rays", "2000")


@pytest.mark.long
def test_every_quantity_of_a_scene(folder: Path) -> None:
    """Of the image: a disc of 5 mm beside its own closed forms, 2 r and r/√2, and E of a PST."""
    row = '\n[[row]]\nname = "{}"\nquantity = "{}"\npublished = {}\n'
    numbers = {"x_mm": 0, "y_mm": 0, "rms_radius_mm": 1, "rms_irradiance_W_mm2": 1, "power_W": 1, "pst": 1}
    numbers |= {"share_percent": 99, "diameter_x_mm": 1, "diameter_y_mm": 1}
    assert numbers.keys() == UNITS.keys()
    text = OWN[: OWN.index("[[row]]")] + "".join(row.format(key, key, value) for key, value in numbers.items())
    Path("own.toml").write_text(text, encoding="utf-8")
    rows = {one.name: one for one in run_validation(ValidateRequest(own=("own.toml",), rays=4000)).rows}
    radius = math.sqrt(2) * rows["rms_radius_mm"].ours.value
    assert rows["diameter_x_mm"].ours.value == pytest.approx(2 * radius, rel=0.02)
    assert rows["diameter_y_mm"].ours.value == pytest.approx(2 * radius, rel=0.02)
    power = math.pi * radius**2 / 2 * rows["rms_irradiance_W_mm2"].ours.value
    assert rows["power_W"].ours.value == pytest.approx(power, rel=1e-4)
    assert abs(rows["x_mm"].ours.value) < 5 * rows["x_mm"].ours.se + 1e-3
    assert rows["pst"].ours.value > 0


def test_only_some_rows(capsys: Captured) -> None:
    found = run_validation(ValidateRequest(only=("tracepro_abg/TIS*", "mie_*")))
    assert {row.pack for row in found.rows} == {"tracepro_abg", "mie_spheres"}
    assert [row.name for row in found.of("tracepro_abg")] == ["TIS of Bennett and Porteus", "TIS of its A, B and g"]
    assert "did you mean 'tracepro_abg'" in fails(capsys, "validate", "--only", "tracepro_agb")
    assert "argument --rays" in fails(capsys, "validate", "--rays", "0")
    assert "no.toml" in fails(capsys, "validate", "--own", "no.toml")


def test_a_missing_program_is_named_with_its_command_and_fails_nothing(monkeypatch: Patch) -> None:
    monkeypatch.setitem(sys.modules, "tmm", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    found = run_validation(ValidateRequest(only=("thin_films",)))
    left = [row for row in found.rows if row.verdict == NOT_ASKED]
    assert [row.why for row in left] == ["pip install 'mistray[validate]'"] * 2
    assert found.holds
    assert found.count(AGREES) == len(found.rows) - 2
    assert "pip install 'mistray[validate]'" in page.text(found)


def test_a_broken_program_is_no_difference(monkeypatch: Patch) -> None:
    def broken(*_: object) -> float:
        raise ValueError("no such thing")

    (pack,) = [one for one in PACKS if one.name == "thin_films"]
    assert pack.peer is not None
    for ask in (broken, lambda *_: broken):
        peer = SimpleNamespace(module="tmm", install="pip install x", installed=True, ask=ask)
        monkeypatch.setattr(run, "PACKS", (replace(pack, peer=peer),))  # type: ignore[arg-type]
        found = run_validation(ValidateRequest())
        assert found.holds
        (why,) = {row.why for row in found.rows if row.verdict == NOT_ASKED}
        assert why == "tmm cannot be asked: ValueError: no such thing; pip install x"


@pytest.mark.quick
def test_every_file_names_its_source_and_its_licence() -> None:
    folder = Path(run.__file__).with_name("references")
    assert {file.stem for file in folder.glob("*.toml")} == {pack.name for pack in PACKS}
    for pack in PACKS:
        file = read_reference(folder / f"{pack.name}.toml")
        assert file.source, pack.name
        assert file.licence, pack.name
        for row in file.rows:
            assert row.unit or row.quantity, (pack.name, row.name)
            assert row.published is not None or pack.peer, (pack.name, row.name)


def check(found: Validation) -> None:
    """No row differs without a reason, and a row with one differs indeed."""
    assert found.rows
    assert not [row for row in found.rows if row.verdict in (DIFFERS, TOO_FEW)]
    reasons = {(pack.name, row.name) for pack in PACKS for row in pack.file.rows if row.differs}
    known = {(row.pack, row.name) for row in found.rows if row.verdict == KNOWN}
    assert known == {one for one in reasons if one in {(row.pack, row.name) for row in found.rows}}


@pytest.mark.validation
def test_packs_without_rays() -> None:
    found = run_validation(ValidateRequest(only=CLOSED))
    check(found)
    assert len(found.rows) == 75


@pytest.mark.validation
@pytest.mark.long
@pytest.mark.parametrize("name", TRACED)
def test_packs_of_traces(name: str) -> None:
    check(run_validation(ValidateRequest(only=(name,))))


def test_page_and_result() -> None:
    found = run_validation(ValidateRequest(only=CLOSED))
    html_pages.check(page.text(found) and _html(found))
    assert repr(found).startswith("Validation(75 rows, agrees: ")
    assert set(found.tables()) == {"validation", "packs"}
    record = page.record(found)
    assert record["holds"] is True
    assert len(record["rows"]) == 75


def _html(found: Validation) -> str:
    from mistray.toolkit.pages.render import html_page

    return html_page(page.page(found, "mistray validate"))

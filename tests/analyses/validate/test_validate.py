"""Published numbers beside ours: the criterion, files of one's own, other programs, and the packs that come along."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import html_pages
import numpy as np
import pytest
import vectors
from command_line import Captured, Patch, fails, succeeds
from refusals import refused
from test_every_command import INPUTS

from mistray import cli
from mistray.analyses.validate import page, result, run
from mistray.analyses.validate.declared import UNITS, DeclaredRow, read_reference
from mistray.analyses.validate.figures import FARTHEST, differences_figure
from mistray.analyses.validate.pack import Asked, Finder, Pack, Peer, others
from mistray.analyses.validate.packs.known import PACKS
from mistray.analyses.validate.packs.telescopes import BothPrograms, Bundle
from mistray.analyses.validate.request import ValidateRequest
from mistray.analyses.validate.result import AGREES, DIFFERS, FAILED, KNOWN, NOT_ASKED, TOO_FEW
from mistray.analyses.validate.run import judged, run_validation
from mistray.analyses.validate.scene_numbers import FAINTEST, SceneNumbers, extent
from mistray.estimate import UNKNOWN, Estimate
from mistray.toolkit.pages.render import html_page

TELESCOPES = "rubin_ghosts", "lsst", "hsc", "decam"
TRACED = *TELESCOPES, "phone_camera", "phone_camera_pst", "phone_camera_objects", "veiling_glare"
CLOSED = tuple(pack.name for pack in PACKS if pack.name not in TRACED)
ROW = DeclaredRow("row", published=2.0, uncertainty=0.3, tolerance=0.1, relative=0.05)
ROW_SAYS = Estimate(2.0, 0.3)
# Two faces of R 0.1 and T 0.8 before a detector: image T², ghost T² R² of the beam
OWN = vectors.text("own_numbers.toml")


def verdict(difference: float, se: float = 0.4, row: DeclaredRow = ROW) -> result.ComparedRow:
    return judged("pack", row, "mm", Estimate(2.0, 0.3), Estimate(2.0 + difference, se))


def test_a_number_that_could_be_anything_has_no_verdict() -> None:
    """Four errors beyond the number, and beyond what the source leaves open; or both numbers of a known difference."""
    assert [verdict(0.0, se).verdict for se in (0.49, 0.51, 1e300)] == [AGREES, TOO_FEW, TOO_FEW]
    assert "4 standard errors are more than the number" in verdict(0.0, 0.51).why
    open_source = replace(ROW, published=1e-9, tolerance=1.0)
    assert judged("pack", open_source, "mm", Estimate(1e-9, 0.0), Estimate(0.3, 0.2)).verdict == AGREES
    known = replace(ROW, differs="another glass", expected=5.0)
    assert [verdict(1.4, se, known).verdict for se in (0.3, 0.45)] == [AGREES, TOO_FEW]
    assert "tell the number from the one that is known to differ" in verdict(1.4, 0.45, known).why
    assert verdict(0.3, 0.1, replace(known, expected=2.5)).verdict == AGREES, "no number of rays would tell these"


def test_what_is_not_judged_is_no_agreement(monkeypatch: Patch, capsys: Captured) -> None:
    """The line says so, nothing holds, and the exit code is 3; a difference outweighs it."""
    rows = {
        "good": judged("pack", ROW, "mm", ROW_SAYS, Estimate(2.0, 0.1)),
        "vague": judged("pack", ROW, "mm", ROW_SAYS, UNKNOWN),
        "wrong": judged("pack", ROW, "mm", ROW_SAYS, Estimate(9.0, 0.1)),
        "unasked": result.ComparedRow("pack", "row", "mm", UNKNOWN, UNKNOWN, math.nan, NOT_ASKED, "pip install x"),
    }
    summary = result.PackSummary("pack", "", 1, 1, 0, 0, 0, 0.0, "")
    for names, holds, code, words in (
        ("good", True, 0, "1 number beside ours: 1 agree"),
        ("good unasked", True, 0, "1 agree, 1 without a verdict (1 without the program that they ask)"),
        ("good vague", False, 3, "1 agree, 1 without a verdict (1 with too few rays)"),
        ("vague unasked", False, 3, "2 without a verdict (1 without the program that they ask, 1 with too few rays)"),
        ("unasked", False, 3, "1 number beside ours: 1 without a verdict"),
        ("good vague wrong", False, 1, "1 agree, 1 differ and should agree, 1 without a verdict"),
    ):
        found = result.Validation([rows[name] for name in names.split()], [summary])
        monkeypatch.setattr(run, "run_validation", lambda *_, found=found: found)
        assert found.holds == holds, names
        assert cli.main(["validate"]) == code, names
        assert words in capsys.readouterr().out


def test_criterion() -> None:
    """Four standard errors of both, 4 · 0.5, the tolerance of 0.1, and a twentieth of 2."""
    assert verdict(0.0).allowed == pytest.approx(2.2)
    assert [verdict(d).verdict for d in (2.19, -2.19, 2.21, -2.21)] == [AGREES, AGREES, DIFFERS, DIFFERS]
    known = replace(ROW, differs="another glass", expected=5.0)
    found = [verdict(difference, row=known) for difference in (3.0, 1.0, 4.94, 4.96, -3.0)]
    assert [row.verdict for row in found] == [KNOWN, AGREES, KNOWN, DIFFERS, DIFFERS], "the other way is another one"
    told = "ours was 5 when this reason was found: another glass"
    assert [row.why for row in found[:4]] == ["another glass", "", "another glass", told]
    assert verdict(0.0, math.nan).verdict == TOO_FEW
    lost = judged("pack", replace(known, path=("a", "b")), "", Estimate(2.0, 0.0), None)
    assert judged("pack", known, "", Estimate(2.0, 0.0), UNKNOWN).verdict == TOO_FEW
    assert lost.verdict == DIFFERS, "a reason for a difference is none for light that is not there"
    assert "a → b" in lost.why
    for side, published, ours, with_few in (
        ("in the other", None, ROW_SAYS, DIFFERS),
        ("in ours", ROW_SAYS, None, TOO_FEW),
        ("either", None, None, DIFFERS),
    ):
        missing = judged("pack", ROW, "", published, ours)
        assert (missing.verdict, side in missing.why) == (DIFFERS, True)
        assert judged("pack", ROW, "", published, ours, fewer=True).verdict == with_few
    no_number = judged("pack", ROW, "", ROW_SAYS, Estimate(math.nan, 0.0))
    assert no_number.verdict == DIFFERS, "an error of 0 is known, and so the rays are not too few"
    for ours, found in ((3.0, (AGREES, 0.0)), (2.0, (DIFFERS, -math.inf))):
        exact = judged("pack", DeclaredRow("n", published=3.0), "1", Estimate(3.0, 0.0), Estimate(ours, 0.0))
        assert (exact.verdict, exact.of_allowed) == found
    assert math.isnan(lost.of_allowed)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [*vectors.toml("refusals.toml")["numbers of one's own"], (OWN[OWN.index("[[row]]") :], "", "row is missing")],
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
    wrong, own = OWN.replace("0.990099", "0.98"), folder / "own.toml"
    (folder / "deeper" / "own.toml").write_text(wrong.replace("coated.xml", "../coated.xml"), encoding="utf-8")
    assert cli.main(["validate", "--own", "deeper/own.toml", "own.toml", "--rays", "2000", "--out", "out"]) == 1
    text = capsys.readouterr().out
    assert "ghost: no reason is known; please report it" in text
    assert "4 numbers beside ours: 3 agree, 1 differ and should agree." in text
    assert (text.count("agrees"), text.count("own_2: Two faces")) == (3, 1), "files of one name stay apart"
    html_pages.check((folder / "out" / "report.html").read_text(encoding="utf-8"))
    why = 'tolerance = 1e-6\ndiffers = "typed wrong"\nexpected = 0.990099'
    own.write_text(wrong.replace("tolerance = 1e-6", why))
    assert "ghost: typed wrong" in succeeds(capsys, "validate", "--own", "own.toml", "--rays", "2000")
    own.write_text(wrong.replace("tolerance = 1e-6", f"{why}1"))
    assert succeeds(capsys, "validate", "--own", "own.toml", "--rays", "2000")
    own.write_text(wrong.replace("tolerance = 1e-6", why.replace("0.990099", "0.9")))
    assert cli.main(["validate", "--own", "own.toml", "--rays", "2000"]) == 1
    assert "ghost: ours was 0.9 when this reason was found: typed wrong" in capsys.readouterr().out


@pytest.mark.long
def test_every_quantity_of_a_scene(folder: Path) -> None:
    """Of the image: a disc of 5 mm beside its own closed forms, 2 r and r/√2, and E of a PST."""
    row = '\n[[row]]\nname = "{}"\nquantity = "{}"\npublished = {}\n'
    numbers = {"x_mm": 0, "y_mm": 0, "rms_radius_mm": 1, "rms_irradiance_W_mm2": 1, "power_W": 1, "pst": 1}
    numbers |= {"share_percent": 99, "diameter_x_mm": 1, "diameter_y_mm": 1, "detected_W": 1, "scattered_W": 1}
    assert numbers.keys() == UNITS.keys()
    text = OWN[: OWN.index("[[row]]")] + "".join(row.format(key, key, value) for key, value in numbers.items())
    text = text.replace('quantity = "pst"', 'quantity = "pst"\nfield_deg = 1\nazimuth_deg = 90')
    text = text.replace('quantity = "scattered_W"', 'quantity = "scattered_W"\nscattered_by = "p0_rear"')
    Path("own.toml").write_text(text, encoding="utf-8")
    rows = {one.name: one for one in run_validation(ValidateRequest(own=("own.toml",), rays=4000)).rows}
    radius = math.sqrt(2) * rows["rms_radius_mm"].ours.value
    for key in ("diameter_x_mm", "diameter_y_mm"):
        diameter = rows[key].ours
        assert diameter.value == pytest.approx(2 * radius, abs=4 * diameter.se)
        assert 0.003 < diameter.se / radius < 0.03, "that of 4000 rays"
    power = math.pi * radius**2 / 2 * rows["rms_irradiance_W_mm2"].ours.value
    assert rows["power_W"].ours.value == pytest.approx(power, rel=1e-4)
    assert abs(rows["x_mm"].ours.value) < 5 * rows["x_mm"].ours.se + 1e-3
    assert rows["pst"].ours.value > 0


def test_a_beam_turns_about_the_pivot_of_the_file(folder: Path) -> None:
    """10 mm before the pivot of the scene, at 3°, its centroid moves by 10 tan 3°; a point of light has one, too."""
    text = OWN.split("[[row]]")[0] + '\n[[row]]\nname = "y"\nquantity = "y_mm"\npublished = 0\nfield_deg = 3\n'
    found = []
    for pivot in ("", "pivot_mm = [0, 0, 0]\n", "pivot_mm = [0, 0, -10]\n"):
        Path("own.toml").write_text(text.replace("\n[[row]]", f"{pivot}\n[[row]]"), encoding="utf-8")
        (row,) = run_validation(ValidateRequest(own=("own.toml",), rays=64)).rows
        found.append(row.ours.value)
    assert found[0] == found[1]
    assert found[2] - found[0] == pytest.approx(10 * math.tan(math.radians(3)), rel=1e-5)


@pytest.mark.long
def test_light_that_surfaces_scatter(folder: Path) -> None:
    """The image and the light of both faces of a plate are all light but for that with reflections."""
    (folder / "rough.xml").write_text(INPUTS["rough.xml"], encoding="utf-8")
    head = OWN.split("[[row]]")[0].replace("coated.xml", "rough.xml")
    scatter = {name: f'scattered_by = "{name}"\n' for name in ("front", "rear", "other")}
    kinds = {"all": "detected_W", "image": "power_W"} | dict.fromkeys(scatter, "scattered_W")
    row = '[[row]]\nname = "{}"\nquantity = "{}"\npublished = 1\n{}'
    rows = [row.format(name, kind, scatter.get(name, "")) for name, kind in kinds.items()]
    Path("own.toml").write_text(head + "\n".join(rows), encoding="utf-8")
    found = {row.name: row for row in run_validation(ValidateRequest(own=("own.toml",), rays=4000)).rows}
    power = {name: row.ours.value for name, row in found.items()}
    assert 0.3 < power["rear"] / power["front"] < 3
    assert power["front"] > 10 * found["front"].ours.se > 0
    parts = power["image"] + power["front"] + power["rear"]
    assert parts < power["all"] == pytest.approx(parts, rel=0.01)
    assert found["other"].verdict == TOO_FEW, "a hundred thousand rays were asked for"
    assert "none takes this way" in found["other"].why


def test_many_rows_with_one_reason_are_counted() -> None:
    rows = [result.ComparedRow("pack", f"r{k}", "", ROW_SAYS, ROW_SAYS, 1.0, KNOWN, "another glass") for k in range(6)]
    assert page.reasons(rows[:4]) == ["r0; r1; r2; r3: another glass"]
    assert page.reasons(rows) == ["6 numbers, such as r0; r1; r2: another glass"]


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
    assert (found.holds, found.count(AGREES)) == (True, len(found.rows) - 2)
    assert "pip install 'mistray[validate]'" in page.text(found)


def broken(*_: object, **__: object) -> None:
    raise ZeroDivisionError("broken")


def peer_of(name: str, ask: Asked) -> Pack:
    """A pack with another program in place of its own."""
    (pack,) = [one for one in PACKS if one.name == name]
    return replace(pack, peer=Peer("math", "pip install x", ask))


def test_a_failed_program_fails_its_row_alone(monkeypatch: Patch) -> None:
    """The other rows of the pack keep their numbers; the error is named, and the exit code is 1."""

    def ask(row: DeclaredRow, ours: Finder) -> Estimate | None:
        with others():
            if row.argument("share") == "R":
                raise ValueError("no such thing")
        return ours(row)

    monkeypatch.setattr(run, "PACKS", (peer_of("thin_films", ask),))
    found = run_validation(ValidateRequest())
    verdicts = {row.name: row.verdict for row in found.rows if row.name.endswith("asked")}
    assert sorted(verdicts.values()) == [AGREES, FAILED]
    (failed,) = [row for row in found.rows if row.verdict == FAILED]
    assert failed.why == "math failed: ValueError: no such thing; try another release, pip install x"
    assert (found.holds, found.packs[0].differ) == (False, 1)
    assert "1 whose program failed" in page.text(found)
    assert [f"thin_films, {failed.name}: the other program failed"] == page.page(found).warnings
    monkeypatch.setattr(run, "PACKS", (peer_of("thin_films", lambda *_: UNKNOWN),))
    whys = {row.why for row in run_validation(ValidateRequest()).rows if row.verdict == FAILED}
    assert whys == {"math gives nan; try another release, pip install x"}
    monkeypatch.setattr(run, "PACKS", (peer_of("thin_films", broken),))  # outside of `others`: it is our own code
    with pytest.raises(ZeroDivisionError, match="broken"):
        run_validation(ValidateRequest())


@pytest.mark.long
def test_an_error_in_a_traced_pack_is_of_the_program_that_raised_it(monkeypatch: Patch) -> None:
    batoid = pytest.importorskip("batoid")
    with monkeypatch.context() as inner:
        inner.setattr("mistray.analyses.validate.packs.telescopes.from_batoid", broken)
        with pytest.raises(ZeroDivisionError):
            run_validation(ValidateRequest(only=("lsst",)))
    monkeypatch.setattr(batoid.Optic, "fromYaml", broken)
    found = run_validation(ValidateRequest(only=("lsst",)))
    assert [row.verdict for row in found.rows] == [FAILED] * 4
    assert found.rows[0].why.startswith("batoid failed: ZeroDivisionError: broken; try another release")


def test_light_that_a_program_does_not_have_is_a_difference() -> None:
    """None and not NaN, which would read as too few rays: of the image, and of all ghosts that both should have."""
    image, ghost = Bundle(1.0, 0.01, 0), Bundle(1e-3, 2.0, 2)
    whole = {("a", "d"): image, ("a", "d", "a", "d"): ghost}
    quantities = ("ghosts", "ghost_permille", "smallest_mm", "spot_um")
    both = BothPrograms(whole, whole)
    assert [both.number(key, both.ours) for key in quantities] == [(1.0, 0.0), (1.0, 0.0), (2.0, 0.0), (10.0, 0.0)]
    no_ghosts = BothPrograms({("a", "d"): image}, whole)
    assert [no_ghosts.number(key, no_ghosts.ours) for key in quantities] == [None, None, None, (10.0, 0.0)]
    no_image = BothPrograms({("a", "d", "a", "d"): ghost}, whole)
    assert [no_image.number(key, no_image.ours) for key in quantities] == [None] * 4


@pytest.mark.parametrize("shape", [1.0, 1.5, 2.0])
def test_the_error_of_an_extent_bounds_what_it_lacks(shape: float) -> None:
    """Light that ends at its full density, as a disc, and with a corner; the true extent is 1."""
    generator = np.random.default_rng(3)
    found = [extent(generator.beta(shape, shape, 1000)) for _ in range(300)]
    lacking = np.array([1 - one.value for one in found])
    errors = np.array([one.se for one in found])
    assert (lacking < 4 * errors).all()
    assert 0.9 < errors.mean() / np.sqrt(np.mean(lacking**2)) < 6
    assert extent(generator.random(4000)).se < 0.5 * extent(generator.random(1000)).se
    assert math.isnan(extent(generator.random(255)).se)
    assert extent(np.full(256, 2.0)) == (0.0, 0.0)


def test_warnings_of_traces_are_shown(folder: Path) -> None:
    """Light that is not followed beyond two reflections, of faces that reflect half of it."""
    values = "".join(f"'p0_{side}.bsdf.{key}' = 0.5\n" for side in ("front", "rear") for key in "RT")
    Path("own.toml").write_text(OWN.replace("[[row]]", f"[set]\n{values}\n[[row]]", 1), encoding="utf-8")
    found = run_validation(ValidateRequest(own=("own.toml",), rays=2000))
    (note,) = found.notes
    assert (note.code, note[:11]) == ("cut", "own: up to ")
    assert f"warning: {note}" in page.text(found)
    assert str(note) in page.page(found).warnings
    assert page.record(found)["notes"] == [str(note)]


def test_a_pst_has_the_light_and_the_limits_of_its_row(folder: Path, monkeypatch: Patch) -> None:
    asked: dict[str, object] = {}

    def pst(_: object, angles: Sequence[float], **keywords: object) -> SimpleNamespace:
        asked.update(keywords, angles=angles)
        return SimpleNamespace(curve=lambda: ([2.0], [0.1]))

    monkeypatch.setattr("mistray.analyses.pst.run.pst", pst)
    row = DeclaredRow("pst", "pst", published=2.0, field_deg=5.0, azimuth_deg=30.0, wavelength_nm=600.0)
    assert SceneNumbers(replace(read_reference("own.toml"), rows=(row,)), 64, 3)(row) == (2.0, 0.1)
    light = {"angles": [5.0], "azimuths_deg": [30.0], "wavelength_nm": 600.0}
    assert asked == light | {"rays": 64, "seed": 3, "max_reflections": 2, "flux_threshold": FAINTEST}


def test_the_worst_rows_stand_at_the_ends_of_the_picture() -> None:
    """A difference where none is allowed, and light that one side does not have."""
    exact = DeclaredRow("exact", published=3.0)
    rows = [
        judged("pack", exact, "1", Estimate(3.0, 0.0), Estimate(4.0, 0.0)),
        judged("pack", exact, "1", Estimate(3.0, 0.0), None),
        judged("pack", exact, "1", None, Estimate(3.0, 0.0)),
    ]
    found = result.Validation(rows, [result.PackSummary("pack", "", 3, 0, 0, 3, 0, 0.0, "")])
    (line,) = differences_figure(found).axes[0].get_lines()
    assert list(line.get_xdata()) == [FARTHEST, -FARTHEST, FARTHEST]


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


def check(found: result.Validation) -> None:
    """No row differs without a reason, and a row with one differs indeed, if not by much."""
    assert found.rows
    assert not [row for row in found.rows if row.verdict in (DIFFERS, TOO_FEW)]
    reasons = {(pack.name, row.name): row for pack in PACKS for row in pack.file.rows if row.differs}
    for row in found.rows:
        reason = reasons.get((row.pack, row.name))
        assert (row.verdict == KNOWN) <= (reason is not None), row.name
        if reason is not None and row.verdict != KNOWN:  # a small difference, which some seeds tell from none
            assert abs(reason.expected - row.published.value) <= row.allowed, row.name


@pytest.mark.validation
def test_packs_without_rays() -> None:
    found = run_validation(ValidateRequest(only=CLOSED))
    check(found)
    assert len(found.rows) == len(page.rows_table(found).rows) == len(page.record(found)["rows"]) == 75
    assert page.record(found)["holds"] is True
    html_pages.check(html_page(page.page(found, "mistray validate")))
    assert repr(found).startswith("Validation(75 rows, agrees: ")
    assert found._repr_html_().count("<figure>") == 1


@pytest.mark.validation
@pytest.mark.long
@pytest.mark.parametrize("name", TRACED)
def test_packs_of_traces(name: str) -> None:
    check(run_validation(ValidateRequest(only=(name,))))


@pytest.mark.validation
@pytest.mark.long
def test_the_weights_of_scattered_rays_tell_what_the_phone_camera_study_knows(capsys: Captured) -> None:
    """Mean square over squared mean of the BSDF in a cone of 18°: polish of its Table 13, and dust, once forwards."""
    said = {"window_front": (93, 400, 0.1099), "window_rear": (31, 300, 0.1099)}
    said |= {"lens": (44, 300, 0.0738), "L4": (57, 300, 0.05465)}
    for name, (factor, level, b0) in said.items():
        found = json.loads(succeeds(capsys, "bsdf", "particulate", "--level", str(level), "--json"))
        curve = next(one for one in found["curves"] if one["incidence_deg"] == 0)
        angle, dust = np.radians(curve["theta_s_deg"]), np.array(curve["bsdf_1_sr"]) / 2  # reflected: forwards twice
        beta = np.linspace(1e-5, np.sin(np.radians(18)), 100_000)
        weight = np.interp(np.arcsin(beta), angle[angle >= 0], dust[angle >= 0])
        weight += b0 * (1 + (beta / 0.01) ** 2) ** -0.75
        means = [np.average(weight**power, weights=beta) for power in (1, 2)]
        assert means[1] / means[0] ** 2 == pytest.approx(factor, rel=0.03), name

"""Every command of mistray end to end: its exit code, the numbers of `--json`, the files it writes and what it says."""

import re
from dataclasses import dataclass, field
from functools import reduce
from math import pi
from pathlib import Path
from typing import Any

import html_pages
import json_units
import pytest
import singlet_files
import vectors
from command_line import Captured, Patch, succeeds
from oracles.object_scenes import open_tube_text
from oracles.rough_paraboloid import paraboloid_text
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

from mistray.cli.parsed_options import print_json
from mistray.physics.planck import band_radiance, cone_projected_solid_angle

WITHOUT_JSON = {"completion"}  # what it prints is for a shell to read
ELSEWHERE = {"app"}  # tests/test_cli_results.py
STATES = {"pst_state.npz", "sensitivity_state.npz", "checkpoint.json"}  # written while a command runs, to go on from

ZMX = singlet_files.ZMX.replace("XYZZY 1 2 3\n", "")
POWER_OF_LENS = (1.5168 - 1) * (0.04 - (1.5168 - 1) * 5 * 0.02**2 / 1.5168)  # of a thick lens
BUDGET = vectors.text("command_budget.toml")
STUDY = vectors.text("command_study.toml")
TIS = next(  # of the ABg model at normal incidence
    float(row["TIS_numeric"])
    for row in vectors.rows("abg_tis.csv")
    if row["case"] == "TracePro plot" and float(row["theta_i_deg"]) == 0
)
POLISH = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.01, s=-2.0, event="transmission")


def plate(*bsdfs: str, depth: float, detector: float) -> str:
    """A plate of two faces before a detector of a half width."""
    faces = [
        shape_xml("asphere", name, z, bsdf, semi_diameter=50.0)
        for name, z, bsdf in zip(("front", "rear"), (0.0, depth), bsdfs, strict=True)
    ]
    rear = shape_xml("asphere", "detector", 3 * depth, sensor=True, half_width=detector, half_height=detector)
    return scene_text(*faces, rear)


INPUTS = {
    "coated.xml": plates_text(1, R=0.1, T=0.8),
    "bare.xml": plates_text(1),
    "window.xml": plate(interface_xml("air", "1.5"), interface_xml("1.5", "air"), depth=1.0, detector=2.0),
    "rough.xml": plate(
        *(scattering_xml([POLISH], *sides, R=0.04, T=0.96) for sides in (("air", "1.5"), ("1.5", "air"))),
        depth=15.0,
        detector=5.0,
    ),
    "tube.xml": open_tube_text(3.0, 1.0, 0.7),
    "mirror.xml": paraboloid_text(),
    # An F/2 cone through a window of emissivity 0.05, in a black tube
    "warm.xml": scatter_scene(
        beam_xml(1.0, distance=3.0),
        placed_xml("asphere", "window", interface_xml(R=0.0, T=0.95), at=(0, 0, -10), semi_diameter=2.5),
        placed_xml("frustum", "tube", r0=2.5, z0=-10.0, r1=2.5, z1=0.5),
        placed_xml("asphere", "detector", pixels=4, half_width=0.01, half_height=0.01),
    ),
    "lens.zmx": ZMX,
    "budget.toml": BUDGET,
    "study.toml": STUDY,
}


@dataclass(frozen=True)
class Within:
    """A number that may be off by some of its standard errors, and by a share of itself."""

    value: float
    errors: float
    share: float = 0.0


@dataclass(frozen=True)
class Case:
    """Arguments of a command, where it writes, what it writes there, numbers of its JSON, and words of its text."""

    arguments: str
    output: str = ""
    files: str = ""
    numbers: dict[str, Any] = field(default_factory=dict)
    words: str = ""
    fewer: str = ""  # arguments of the run for the text


def close(value: float, **how: float) -> Any:
    return pytest.approx(value, **{"rel": 1e-5, **how})


CASES = {
    "doctor": Case("", numbers={"checks.0.name": "python", "missing": []}, words="ok        mitsuba"),
    "import": Case(
        "lens.zmx",
        "-o lens.xml",
        "lens.xml",
        {"efl_mm": close(1 / POWER_OF_LENS), "f_number": close(1 / POWER_OF_LENS / 8), "unread": []},
        "lens.xml: 10 surfaces; next: mistray ghosts lens.xml",
    ),
    "coat": Case(
        "bare.xml *=bbar3",
        "-o new.xml",
        "new.xml",
        {"changes.0.surface": "p0_front", "changes.1.coating": "bbar3", "left.0.surface": "detector"},
        "new.xml: 2 surfaces changed; next: mistray ghosts new.xml",
    ),
    "export": Case("plate", "-o plate.zmx", "plate.zmx", {"surfaces": 2}, "plate.zmx: 2 surfaces"),
    "view": Case(
        "coated.xml --rays 100",
        "--out view.html --layout layout.svg --save-rays rays.json",
        "view.html layout.svg rays.json",
        {"paths.0.power_W": close(0.64 * pi), "paths.1.power_W": close(0.0064 * pi), "paths.1.kind": "ghost"},
        "rays.json",
    ),
    "ghosts": Case(
        "coated.xml --rays 500",
        "--out out",
        "energy.csv ghosts.json ghosts_0deg.png layout_0deg.png levels.png overview.png overview_common.png "
        "path_sort_0deg.txt paths.csv report.html stray_levels.csv summary.csv surfaces.csv",
        {
            "fields.0.ghost_to_signal": close(0.01),
            "fields.0.energy.closure": close(0, abs=1e-6),
            "verdict.remedy.surface": "p0_front",
            "verdict.remedy.left.0.stray_W": 0,
        },
        "p0_rear → p0_front",
    ),
    # A paraboloid of F/20 at 632.8 nm has no aberration; its MTF is that of a circular pupil
    "image": Case(
        "mirror.xml --grid 32",
        "--out out",
        "energy.png image_quality.csv image_quality.json mtf.csv mtf.png opd.png psf.png report.html spots.png "
        "zernikes.csv",
        {
            "stop": "mirror",
            "image_scale_mm": close(200),
            "fields.0.strehl": close(1),
            "fields.0.mtf.1.tangential": close(0.6802, abs=3e-3),
        },
        "image quality of the direct light at 632.8 nm; stop: mirror",
    ),
    "sweep": Case(
        "coated.xml --set p0_*.bsdf.R=0.3 p0_*.bsdf.T=0.6 --rays 64",
        "--out out",
        "sweep.csv configurations.csv sweep.json sweep.png report.html",
        {
            "rows.0.ghost_to_signal": close(0.01),
            "rows.1.ghost_to_signal": close(0.09),
            "rows.1.configuration": "p0_*.bsdf.R = 0.3, p0_*.bsdf.T = 0.6",
            "rows_from_cache": 0,
            "configurations.1.values.0.key": "p0_front.bsdf.R",
        },
        "2 rows, 2 of them from the cache in",
    ),
    "cache": Case("info", numbers={"entries": 0, "limit_bytes": 1_000_000_000}, words="holds 0 results"),
    "objects": Case(
        "tube.xml --rays 2e3",
        "--out out",
        "objects.html objects.json objects.png objects_common.csv objects_critical.csv objects_estimates.csv "
        "objects_illuminated.csv objects_optics.csv objects_straight_shots.csv",
        {"critical.0.id": "wall", "common.0.id": "wall", "optics.0.id": "detector", "facts.rays": 2000},
        "Critical objects: 1, seen by the detector",
    ),
    # Both faces let (1 - R)² through, and the light that both reflect is R² of it. R is 0.04 to 0.1 % within 10° of the
    # axis. Six standard errors and 0.3 %: less than one false alarm in 1e8.
    "pst": Case(
        "window.xml --field-deg 5 --cell-deg 10 --convention projected --rays 2e5",
        "--out out",
        "pst.csv pst_paths.csv pst.png pst_causes.png pst.json pst_state.npz report.html",
        {
            "curve.0.angle_deg": 5,
            "curve.0.pst_direct": Within(0.96**2, 6, 0.003),
            "curve.0.pst_ghost": Within(0.96**2 * 0.04**2, 6, 0.003),
            "curve.0.pst_single_scatter": 0,
            "curve.0.paths.0.label": "rear → front",
            "curve.0.paths.0.percent_of_stray": close(100),
            "curve.0.causes.0.cause": "ghosts",
            "convention": "projected",
        },
        "PST = E_det/(E_⊥ cos θ)",
        "--rays 2000",
    ),
    "study": Case(
        "window.xml --rays 500 --pst-field-deg 0 20 --field-deg 0",
        "--out out",
        "1_optical_surfaces.csv 2_structure.csv 3_critical.csv 3_straight_shots.csv 4_illuminated.csv 5_apart.csv "
        "5_common.csv 5_optics.csv 5_product_estimate.csv 6_scatter_models.csv 6_surface_budget.csv 6_treatments.csv "
        "7_paraxial_targets.csv 7_targets.csv 8_first_level_scatter.csv 8_ghosts.csv 8_pst.csv 8_pst_breaks.csv "
        "8_pst_top_paths.csv 8_worst_ghosts.csv 8_zero_order_paths.csv pst_state.npz report.html",
        {
            "verdict.pst.main_cause.cause": "ghosts",
            "verdict.ghosts.remedy.surface": "front",
            "steps.7.tables.pst.1.angle_deg": 20,
        },
        "Stray-light study of 'window'",
    ),
    # Four standard errors: false alarm 6e-5 each
    "thermal": Case(
        "warm.xml --temperature-K 300 --band-um 3 5 --scene-K 310 --part tube=0 --rays 1e5 --seed 7",
        "--out out",
        "thermal.csv thermal.json thermal.png report.html",
        {
            "band_um": [3, 5],
            "wavelengths_um": [4],
            "total_W_mm2": Within(0.05 * cone_projected_solid_angle(2.0) * band_radiance(300.0, 3.0, 5.0), 4),
            "image_W_mm2": Within(0.95 * cone_projected_solid_angle(2.0) * band_radiance(310.0, 3.0, 5.0), 4),
        },
        "3 to 5 µm, 300 K where no other is given",
    ),
    "coating": Case(
        "bare --back 1.5 --wavelength-nm 500:600:50 --angles-deg 0 45",
        "--csv coating.csv --plot coating.png",
        "coating.csv coating.png",
        {"band.0.R_mean": close(0.04), "spectrum.0.T_s": close(0.96), "spectrum.5.wavelength_nm": 600, "layers": []},
        "bare: air | 1.5, light from air",
    ),
    "bsdf": Case(
        "abg --A 0.0025 --B 0.001 --g 1.8 --angles-deg 0",
        "--csv bsdf.csv --table bsdf.bsdf --plot bsdf.png",
        "bsdf.csv bsdf.bsdf bsdf.png",
        {"totals.0.peak_1_sr": close(2.5), "totals.0.scattered": close(TIS, rel=5e-4), "from_roughness": None},
        "abg A = 0.0025, B = 0.001, g = 1.8: air | N-BK7, 550 nm",
    ),
    "sensitivity": Case(
        "coated.xml --rays 64 --parameter p0_*.bsdf.[RT] --tolerance *.R=0.01 --no-check",
        "--out out",
        "sensitivity.csv propagation.csv sensitivity.json sensitivity_state.npz ranking.png report.html",
        {
            "metric.value": close(0.0064),
            "parameters.0.tolerance": 0.01,
            "parameters.0.change_percent": close(10, rel=1e-4),
            "monte_carlo": None,
        },
        "path power: 6.4e-03 ",
    ),
    "budget": Case(
        "rough.xml budget.toml",
        "--out out",
        "scene.xml budget.csv requirements.csv budget.json budget.png report.html",
        {"met": True, "requirements.0.limit": 1e-4, "numbers.0.cost_before": close(2)},
        "cost: 4 before",
    ),
    "optimize": Case(
        "bare.xml study.toml --verification-seeds 2",
        "--out out",
        "scene.xml terms.csv variables.csv history.csv search.png variables.png reflectance.png report.html "
        "checkpoint.json",
        {"holds": {"ghosts": True}, "variables.0.name": "AR.thickness_nm[0]", "variables.0.before": close(60)},
        "search from start 1: all steps used",
    ),
    "validate": Case(
        "--only tracepro_abg",
        "--out out",
        "validation.csv packs.csv validation.json differences.png report.html",
        {"holds": True, "rows.0.ours": close(pi / 2), "packs.0.agree": 11, "packs.0.known": 1},
        "12 numbers beside ours: 11 agree, 1 known to differ.",
    ),
    "completion": Case("bash", words="COMPREPLY"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    """The working folder, with all that the commands read and an empty cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path.parent / f"{tmp_path.name}_cache"))
    for name, text in INPUTS.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def at(record: Any, path: str) -> Any:
    return reduce(lambda found, key: found[int(key) if isinstance(found, list) else key], path.split("."), record)


def check(record: Any, path: str, expected: Any) -> None:
    found = at(record, path)
    if isinstance(expected, Within):
        allowed = expected.errors * at(record, f"{path}_se")
        assert allowed < 0.1 * expected.value, path
        assert abs(found - expected.value) <= allowed + expected.share * expected.value, path
    else:
        assert found == expected, path


@pytest.mark.parametrize("name", CASES)
def test_end_to_end(name: str, folder: Path, capsys: Captured) -> None:
    case = CASES[name]
    if name not in WITHOUT_JSON:
        arguments = (*case.arguments.split(), *case.output.split())
        record = json_units.read(succeeds(capsys, name, *arguments, "--json"), name)
        for path, expected in case.numbers.items():
            check(record, path, expected)
        written = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()} - set(INPUTS)
        place = "out/" if case.output == "--out out" else ""
        assert written == {f"{place}{file}" for file in case.files.split()}
        told = [str((folder / file).relative_to(folder)) for file in record["files"]]
        assert sorted(told) == sorted(file for file in written if Path(file).name not in STATES)
        for page in (file for file in written if file.endswith(".html")):
            text = (folder / page).read_text(encoding="utf-8")
            assert f"mistray {name} {case.arguments.split()[0]}" in text
            if name != "view":  # plotly's own, see analyses/view/test_view.py
                html_pages.check(text)
    folded = case.output.startswith("--out out")
    more = [] if folded else [*case.output.split(), *(["--force"] if case.output else [])]
    before = {file: file.stat().st_mtime_ns for file in folder.rglob("*")}
    assert case.words in succeeds(capsys, name, *case.arguments.split(), *case.fewer.split(), *more)
    if folded:  # a result that is printed alone writes nothing
        assert {file: file.stat().st_mtime_ns for file in folder.rglob("*")} == before


@pytest.mark.quick
def test_every_command_of_the_help_is_in_the_table_and_in_the_document_of_json(capsys: Captured) -> None:
    listed = re.findall(r"^ {4}([a-z]+)(?= |$)", succeeds(capsys, "--help"), re.MULTILINE)
    assert len(listed) > 15
    assert sorted(listed) == sorted({*CASES, *ELSEWHERE})
    named = re.findall(r"^\| `(\w+)` \|", json_units.DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(listed) - WITHOUT_JSON <= set(named)


def test_the_cache_is_told_and_cleared(folder: Path, capsys: Captured, monkeypatch: Patch) -> None:
    def ask(action: str) -> dict[str, Any]:
        return json_units.read(succeeds(capsys, "cache", action, "--json"))

    succeeds(capsys, "sweep", "coated.xml", "--wavelength-nm", "500", "600", "--rays", "64")
    cache = Path(ask("info")["folder"])
    (cache / "notes.txt").write_text("mine")
    held = ask("info")
    assert held["entries"] == 2
    assert 2_000 < held["size_bytes"] < 10_000
    cleared = ask("clear")
    assert (cleared["action"], cleared["entries"], cleared["size_bytes"]) == ("clear", 2, held["size_bytes"])
    assert ask("info")["entries"] == 0
    assert [path.name for path in cache.iterdir()] == ["notes.txt"]
    monkeypatch.setenv("MISTRAY_CACHE", "off")
    assert succeeds(capsys, "cache", "info") == "the cache is switched off by MISTRAY_CACHE\n"
    assert ask("clear")["folder"] is None


@pytest.mark.parametrize(
    ("value", "keys"),
    [
        ({"power_W": 1.0, "power_se_W": 0.1, "x_mm": None, "is_there": True, "rays": 1000, "share_se": 0.1}, set()),
        ({"rows": [{"height": 1}, {"height_mm": 2}], "window": 1.0, "_W": 1.0}, {"rows.height", "window"}),
        ({"absorbed_W": {"wall": {"value": 1.0, "se": 0.1}}}, set()),
        ({"absorbed": {"wall": {"value": 1.0, "se": 0.1}}}, {"absorbed.wall.value", "absorbed.wall.se"}),
        ({"unit": "mm", "value": 1.0, "deeper": {"value": 1.0}}, {"deeper.value"}),
    ],
)
def test_names_without_units_are_found(value: dict[str, Any], keys: set[str]) -> None:
    assert json_units.wrong(value) == keys


def test_other_output_is_found() -> None:
    for text in ('{"files": [], "x_mm": NaN}', "[1]", '{"a": 1}'):
        with pytest.raises((AssertionError, KeyError)):
            json_units.read(text)
    with pytest.raises(ValueError, match="JSON"):
        print_json({"x_mm": float("nan")})

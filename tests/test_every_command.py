"""Every command of mistray end to end: its exit code, the numbers of `--json`, the files it writes and what it says."""

import re
from dataclasses import dataclass
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
BY_ANGLE = {float(row["theta_i_deg"]): row for row in vectors.rows("abg_tis.csv") if row["case"] == "TracePro plot"}
TIS = float(BY_ANGLE[0]["TIS_numeric"])  # of the ABg model at normal incidence
POLISH = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.01, s=-2.0, event="transmission")
ROUGH = [scattering_xml([POLISH], *sides, R=0.04, T=0.96) for sides in (("air", "1.5"), ("1.5", "air"))]


def plate(*bsdfs: str, depth: float, detector: float) -> str:
    """A plate of two faces before a detector of a half width."""
    places = zip(("front", "rear"), (0.0, depth), bsdfs, strict=True)
    faces = [shape_xml("asphere", *place, semi_diameter=50.0) for place in places]
    rear = shape_xml("asphere", "detector", 3 * depth, sensor=True, half_width=detector, half_height=detector)
    return scene_text(*faces, rear)


INPUTS = {
    "coated.xml": plates_text(1, R=0.1, T=0.8),
    "bare.xml": plates_text(1),
    "window.xml": plate(interface_xml("air", "1.5"), interface_xml("1.5", "air"), depth=1.0, detector=2.0),
    "rough.xml": plate(*ROUGH, depth=15.0, detector=5.0),
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


def close(value: float, **how: float) -> Any:
    return pytest.approx(value, **{"rel": 1e-5, **how})


CASES: dict[str, dict[str, Any]] = vectors.toml("commands.toml")
# Numbers that follow from others, or have limits of their own
NUMBERS: dict[str, dict[str, Any]] = {
    "import": {"efl_mm": close(1 / POWER_OF_LENS), "f_number": close(1 / POWER_OF_LENS / 8)},
    "view": {"paths.0.power_W": close(0.64 * pi), "paths.1.power_W": close(0.0064 * pi)},
    "ghosts": {"fields.0.energy.closure": close(0, abs=1e-6)},
    # A paraboloid of F/20 at 632.8 nm has no aberration; its MTF is that of a circular pupil
    "image": {"fields.0.mtf.1.tangential": close(0.6802, abs=3e-3)},
    # Both faces let (1 - R)² through, and the light that both reflect is R² of it. R is 0.04 to 0.1 % within 10° of the
    # axis. Six standard errors and 0.3 %: less than one false alarm in 1e8.
    "pst": {"curve.0.pst_direct": Within(0.9216, 6, 0.003), "curve.0.pst_ghost": Within(0.9216 * 0.04**2, 6, 0.003)},
    # Four standard errors: false alarm 6e-5 each
    "thermal": {
        "total_W_mm2": Within(0.05 * cone_projected_solid_angle(2.0) * band_radiance(300.0, 3.0, 5.0), 4),
        "image_W_mm2": Within(0.95 * cone_projected_solid_angle(2.0) * band_radiance(310.0, 3.0, 5.0), 4),
    },
    "bsdf": {"totals.0.scattered": close(TIS, rel=5e-4), "from_roughness": None},
    "sensitivity": {"parameters.0.change_percent": close(10, rel=1e-4), "monte_carlo": None},
    "validate": {"rows.0.ours": close(pi / 2)},
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
    case = {"output": "", "files": "", "fewer": "", "exact": {}, "close": {}} | CASES[name]
    output = case["output"].split()
    if name not in WITHOUT_JSON:
        record = json_units.read(succeeds(capsys, name, *case["arguments"].split(), *output, "--json"), name)
        near = {path: close(value) for path, value in case["close"].items()}
        for path, expected in (case["exact"] | near | NUMBERS.get(name, {})).items():
            check(record, path, expected)
        written = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()} - set(INPUTS)
        place = "out/" if case["output"] == "--out out" else ""
        assert written == {f"{place}{file}" for file in case["files"].split()}
        told = [str((folder / file).relative_to(folder)) for file in record["files"]]
        assert sorted(told) == sorted(file for file in written if Path(file).name not in STATES)
        for page in (file for file in written if file.endswith(".html")):
            text = (folder / page).read_text(encoding="utf-8")
            assert f"mistray {name} {case['arguments'].split()[0]}" in text
            if name != "view":  # plotly's own, see analyses/view/test_view.py
                html_pages.check(text)
    folded = case["output"] == "--out out"
    more = [] if folded else [*output, *(["--force"] if output else [])]
    before = {file: file.stat().st_mtime_ns for file in folder.rglob("*")}
    assert case["words"] in succeeds(capsys, name, *case["arguments"].split(), *case["fewer"].split(), *more)
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


def test_names_without_units_and_other_output_are_found() -> None:
    for value, keys in (
        ({"power_W": 1.0, "power_se_W": 0.1, "x_mm": None, "is_there": True, "rays": 1000, "share_se": 0.1}, set()),
        ({"rows": [{"height": 1}, {"height_mm": 2}], "window": 1.0, "_W": 1.0}, {"rows.height", "window"}),
        ({"absorbed_W": {"wall": {"value": 1.0, "se": 0.1}}}, set()),
        ({"absorbed": {"wall": {"value": 1.0, "se": 0.1}}}, {"absorbed.wall.value", "absorbed.wall.se"}),
        ({"unit": "mm", "value": 1.0, "deeper": {"value": 1.0}}, {"deeper.value"}),
    ):
        assert json_units.wrong(value) == keys, value
    for text in ('{"files": [], "x_mm": NaN}', "[1]", '{"a": 1}'):
        with pytest.raises((AssertionError, KeyError)):
            json_units.read(text)
    with pytest.raises(ValueError, match="JSON"):
        print_json({"x_mm": float("nan")})

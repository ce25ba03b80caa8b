"""`mistray thermal`: what it prints, what it writes, one line for bad input."""

from __future__ import annotations

import json
import time
from pathlib import Path

import json_units
import pytest
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene
from oracles.small_scenes import interface_xml, write

from mistray import cli
from mistray.physics.planck import band_radiance, cone_projected_solid_angle


@pytest.fixture
def scene(tmp_path: Path) -> str:
    """An F/2 cone through a window of emissivity 0.05, in a black tube."""
    text = scatter_scene(
        beam_xml(1.0, distance=3.0),
        placed_xml("asphere", "window", interface_xml(R=0.0, T=0.95), at=(0, 0, -10), semi_diameter=2.5),
        placed_xml("frustum", "tube", r0=2.5, z0=-10.0, r1=2.5, z1=0.5),
        placed_xml("asphere", "detector", pixels=4, half_width=0.01, half_height=0.01),
    )
    return str(write(tmp_path, text))


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["thermal", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_text_and_files(scene: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    code, text, err = run(capsys, scene, "--part", "tube=150", "detector=77", "--rays", "2e4", "--out", str(out))
    assert (code, err) == (0, "")
    assert "293 K where no other is given, detector at 77 K" in text
    assert any(line.split()[:3] == ["tube", "tube", "150"] for line in text.splitlines())
    assert {file.name for file in out.iterdir()} == {"thermal.csv", "thermal.json", "thermal.png", "report.html"}
    assert "--part tube=150 detector=77" in (out / "report.html").read_text(encoding="utf-8")


def test_json(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The numbers of the options: temperature, band, scene. 4 standard errors: false alarm 6e-5 each."""
    code, text, _ = run(
        capsys, scene, "--temperature-K", "300", "--band-um", "3", "5", "--scene-K", "310", "--part", "tube=0",
        "--rays", "1e5", "--seed", "7", "--json",
    )  # fmt: skip
    assert code == 0
    record = json_units.read(text)
    assert record["band_um"] == [3, 5]
    assert record["wavelengths_um"] == [4]
    for key, expected in (
        ("total_W_mm2", 0.05 * cone_projected_solid_angle(2.0) * band_radiance(300.0, 3.0, 5.0)),
        ("image_W_mm2", 0.95 * cone_projected_solid_angle(2.0) * band_radiance(310.0, 3.0, 5.0)),
    ):
        assert abs(record[key] - expected) < 4 * record[f"{key}_se"] < 0.1 * expected


def test_quiet(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, scene, "--rays", "1000", "--quiet") == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--part", "tube"), "'tube' is no NAME=T, such as detector=77"),
        (("--part", "tube=-3"), "-3 must lie between 0 and 1e6 K"),
        (("--part", "tubes=3"), "no surface, part or material is called 'tubes'"),
        (("--temperature-K", "warm"), "'warm' is not a number"),
        (("--band-um", "12", "8"), "band_um is 12 to 8; give the shorter"),
        (("--wavelength-um", "9", "8"), "in ascending order"),
        (("--polarization", "stokes"), "backward rays know unpolarised light only"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], words: str, scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, scene, "--rays", "1000", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.long
def test_a_time_budget_is_kept_and_the_result_says_so(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    began = time.monotonic()
    code, text, _ = run(capsys, scene, "--rays", "1e9", "--seconds", "3", "--json")
    assert code == 0
    assert time.monotonic() - began < 15  # others may use the machine, too
    found = json.loads(text)
    assert any("rays were traced" in note for note in found["notes"])
    assert found["total_W_mm2"] > found["total_W_mm2_se"] > 0


def test_noise(scene: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """NETD in text, JSON and files; half a pixel is named with what is missing."""
    pixel, out = ["--pixel-um", "15", "--bandwidth-hz", "500"], tmp_path / "out"
    photons = ["--quantum-efficiency", "0.6"]
    code, text, _ = run(capsys, scene, *pixel, *photons, "--rays", "2e4", "--out", str(out))
    assert code == 0
    assert any(line.startswith("NETD by the noise of photons") for line in text.splitlines())
    assert "NETD by D*" not in text
    assert (out / "netd.csv").exists()
    assert "quantum efficiency 0.6" in (out / "report.html").read_text(encoding="utf-8")
    code, text, _ = run(capsys, scene, *pixel, *photons, "--detectivity", "1e11", "--rays", "2e4", "--json")
    record = json_units.read(text)["netd"]
    assert (code, record["pixel_um"], record["detectivity"]) == (0, 15, 1e11)
    assert 0 < record["by_photons_K_se"] < 0.05 * record["by_photons_K"]
    assert record["by_detectivity_K"] == pytest.approx(500**0.5 / 0.015 / 1e12 / record["per_kelvin_W_mm2"])
    for arguments, words in (
        (photons, "--pixel-um, --bandwidth-hz"),
        (pixel, "--detectivity or --quantum-efficiency"),
    ):
        code, _, err = run(capsys, scene, *arguments)
        assert code == 2
        assert words in err

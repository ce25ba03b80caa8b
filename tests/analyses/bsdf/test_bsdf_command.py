"""`mistray bsdf`: the numbers that it prints are those of the models."""

import json
import re
from pathlib import Path

import json_units
import numpy as np
import pytest
import vectors
from command_line import Captured, fails, succeeds
from oracles import brushed

from mistray.scatter.measured.tabulated import Tabulated

ABG = ("bsdf", "abg", "--A", "0.0025", "--B", "0.001", "--g", "1.8")


def rows(out: str) -> dict[float, list[float]]:
    """Lines of the table: angle of incidence → its other numbers."""
    table = (line.split() for line in out.splitlines() if re.fullmatch(r"[\s\d.e+-]*\d[\s\d.e+-]*", line))
    return {float(angle): [float(word) for word in values] for angle, *values in table}


class TestTotals:
    def test_abg_at_all_angles_and_beyond_the_critical_one(self, capsys: Captured) -> None:
        found = [row for row in vectors.rows("abg_tis.csv") if row["case"] == "TracePro plot"]
        out = succeeds(capsys, *ABG, "--angles-deg", *(f"{float(row['theta_i_deg']):g}" for row in found))
        for row in found:
            total = rows(out)[float(row["theta_i_deg"])][0]
            assert total == pytest.approx(100 * float(row["TIS_numeric"]), rel=5e-4)  # four digits are printed
        command = (*ABG, "--angles-deg", 0, 60, "--from-back")
        assert re.search(r"^ +60 .* – +– +–$", succeeds(capsys, *command), re.MULTILINE)
        found = json_units.read(succeeds(capsys, *command, "--json"))["totals"]
        assert [row["scattered"] is None for row in found if row["event"] == "transmission"] == [False, True]
        whole, part = (succeeds(capsys, *ABG, "--R", share, "--angles-deg", 0) for share in (1, 0.1))
        assert "\nnote: ABg: B 0.001 and g 1.8 are outside what is usual" in whole
        assert rows(part)[0][0] == pytest.approx(0.1 * rows(whole)[0][0], rel=5e-4)
        assert rows(part)[0][1] == rows(whole)[0][1]  # the loss is a share of the specular beam

    @pytest.mark.parametrize(
        "arguments",
        [
            "gaussian_lobe --total 0.01 --width 0.02",
            "phong --b0 0.1 --exponent 16",
            "polynomial --coefficients c000=0.5,c100=-0.4,l10=-0.7 --d 2e3",
            f"psd_table --file {vectors.DATA / 'psd_polish.csv'} --theory rayleigh_rice --event reflection",
            "k_correlation --rms-nm 2 --B-um 50 --slope 2.5 --theory rayleigh_rice --event reflection",
            "k_correlation --rms-nm 2 --B-um 50 --slope 2 --band-limited",
            "particulate --level 300",
            "particulate --coverage-percent 0.05 --particle 1.5+0.01i",
            "paint --reflectance 0.03 --b0 0.02 --l 0.1 --s -3 --n 1.5",
        ],
    )
    def test_every_model(self, capsys: Captured, arguments: str) -> None:
        found = rows(succeeds(capsys, "bsdf", *arguments.split(), "--angles-deg", 0, 45))
        assert set(found) == {0, 45}
        assert all(values[0] > 0 for values in found.values())

    @pytest.mark.parametrize(
        ("arguments", "percent"),
        [
            ("abg --A 0.0025 --B 0.001 --g 1e-308", 100 * np.pi * 0.0025 / 1.001),
            ("abg --A 1e-25 --B 0.001 --g 1e-308", 100 * np.pi * 1e-25 / 1.001),
            ("gaussian_lobe --total 0.1 --width 1e6", 10.0),
            ("gaussian_lobe --total 0.1 --width 1e-6", 10.0),
            ("paint --preset flat_black", 4.5),
        ],
    )
    def test_extreme_numbers_that_are_right(self, capsys: Captured, arguments: str, percent: float) -> None:
        out = succeeds(capsys, "bsdf", *arguments.split(), "--angles-deg", 0)
        assert rows(out)[0][0] == pytest.approx(percent, rel=6e-4)


def test_sheet_of_a_rough_surface(capsys: Captured) -> None:
    """TracePro's sheet "ABg from RMS", with its own integral; its steps: physics/test_lobe_formulas.py."""
    sheet = ("bsdf", "abg", "--rms-nm", 5, "--correlation-um", 100, "--wavelength-nm", 500)
    out = succeeds(capsys, *sheet, "--R", 0.95, "--raw-integral", "0.015552516", "--angles-deg", 0)
    for name, value in (("BSDF(0)", "3770.36324"), ("correction", "0.957013661"), ("B", "5.03930226e-10"), ("g", "3")):
        assert re.search(rf"^{re.escape(name)} +{re.escape(value)}\b", out, re.MULTILINE), name
    answer = json_units.read(succeeds(capsys, *sheet, "--json"))
    made = answer["from_roughness"]
    assert made["bsdf_0_1_sr"] == pytest.approx(made["bsdf_per_psd_per_um4"] * made["psd_amplitude_um4"])
    assert made["A_1_sr"] / made["B"] == pytest.approx(answer["totals"][0]["peak_1_sr"], rel=1e-2)


@pytest.mark.parametrize(("more", "step"), [((), 0.5), (("--delta-n", 0.2), 0.2)])
def test_roughness_in_transmission(capsys: Captured, more: tuple[str, float] | tuple[()], step: float) -> None:
    """Bennett and Porteus: T (1 - exp(-(2π Δn σ/λ)²)), whatever is reflected."""
    sheet = ("bsdf", "abg", "--rms-nm", 5, "--correlation-um", 100, "--wavelength-nm", 550, "--back", 1.5, *more)
    out = succeeds(capsys, *sheet, "--event", "transmission", "--T", 0.5, "--R", 0.1, "--angles-deg", 0, "--json")
    (row,) = json_units.read(out)["totals"]
    assert row["event"] == "transmission"
    assert row["scattered"] == pytest.approx(-0.5 * np.expm1(-((2 * np.pi * step * 5 / 550) ** 2)), rel=1e-4)


class TestFiles:
    def test_particles(self, capsys: Captured, tmp_path: Path) -> None:
        path = tmp_path / "particles.png"
        succeeds(capsys, "bsdf", "particulate", "--level", 300, "--plot-particles", path, "--angles-deg", 0)
        assert path.stat().st_size > 5000

    def test_curves(self, capsys: Captured, tmp_path: Path) -> None:
        path = tmp_path / "abg.csv"
        out = succeeds(capsys, *ABG, "--csv", path, "--angles-deg", 0, 30, "--json")
        table = vectors.frame(str(path))
        assert set(table.theta_i_deg) == {0, 30}
        np.testing.assert_allclose(table.bsdf, 0.0025 / (0.001 + table.distance**1.8), rtol=1e-6)
        one = json_units.read(out)["curves"][0]
        np.testing.assert_allclose(one["bsdf_1_sr"], 0.0025 / (0.001 + np.array(one["distance"]) ** 1.8), rtol=1e-6)

    @pytest.mark.parametrize("kind", ["bsdf", "csv"])
    def test_table_is_a_model_again(self, capsys: Captured, tmp_path: Path, kind: str) -> None:
        path, angles = tmp_path / f"abg.{kind}", ("--angles-deg", 0, 20, 40, 60)
        first = rows(succeeds(capsys, *ABG, *angles, "--table", path))
        again = rows(succeeds(capsys, "bsdf", path, *angles))
        for angle, values in first.items():
            assert again[angle][0] == pytest.approx(values[0], rel=0.01)
        assert Tabulated.read(path).samples.specular_deg.tolist() == [0, 20, 40, 60]


def test_rotations_of_a_brushed_sample(capsys: Captured, tmp_path: Path) -> None:
    """A table of a + b cos 2(φ - ρ): the peak, along x, is a + b cos 2ρ, the TIS π a; a table of it is that again."""
    table = brushed.write_two_fold(tmp_path / "brushed.csv", 0.1, 0.05, step=30.0)
    file, picture, copy = tmp_path / "curves.csv", tmp_path / "brushed.png", tmp_path / "copy.bsdf"
    more = ("--anisotropy", "keep", "--event", "reflection", "--angles-deg", 40, "--rotations-deg", 0, 30, 90)
    assert "0.125" in succeeds(capsys, "bsdf", table, *more, "--table", copy, "--csv", file, "--plot", picture)
    record, again = (json.loads(succeeds(capsys, "bsdf", name, *more, "--json")) for name in (table, copy))
    found = {row["rotation_deg"]: row for row in record["totals"]}
    assert [curve["rotation_deg"] for curve in record["curves"]] == list(found) == [0, 30, 90]
    for (rotation, row), other in zip(found.items(), again["totals"], strict=True):
        assert row["peak_1_sr"] == pytest.approx(0.1 + 0.05 * np.cos(2 * np.radians(rotation)), rel=2e-3)
        assert row["scattered"] == pytest.approx(0.1 * np.pi, rel=2e-3)
        assert other["peak_1_sr"] == pytest.approx(row["peak_1_sr"], rel=0.02)
        assert other["scattered"] == pytest.approx(row["scattered"], rel=0.01)
    assert file.read_text(encoding="utf-8").splitlines()[1].startswith("rotation_deg,theta_i_deg")
    assert picture.stat().st_size > 0


def test_a_brushed_sample_needs_an_anisotropy_and_its_mean_no_rotation(capsys: Captured, tmp_path: Path) -> None:
    table = brushed.write_two_fold(tmp_path / "brushed.csv", 0.1, 0.05, step=30.0)
    for more in ((), ("--anisotropy", "mean", "--rotations-deg", 0)):
        assert re.search("anisotropy|rotations-deg", fails(capsys, "bsdf", table, *more))

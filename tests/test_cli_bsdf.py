"""`mistray bsdf` and `mistray coating`: the numbers that they print are those of the models."""

from __future__ import annotations

import json
import re
from pathlib import Path

import json_units
import numpy as np
import pytest
import vectors
from command_line import Captured, fails, succeeds
from oracles import brushed

from mistray.coatings import CoatingTable, preset, spectrum
from mistray.scatter.measured.tabulated import Tabulated

ABG = ("bsdf", "abg", "--A", "0.0025", "--B", "0.001", "--g", "1.8")
SAMPLE = vectors.DATA / "coating_sample.dat"


def rows(out: str) -> dict[float, list[float]]:
    """Lines of the table: angle of incidence → its other numbers."""
    found = {}
    for line in out.splitlines():
        if re.fullmatch(r"[\s\d.e+-]+", line) and re.search(r"\d", line):
            angle, *values = (float(word) for word in line.split())
            found[angle] = values
    return found


def numbers(out: str, start: str) -> list[float]:
    (line,) = [line for line in out.splitlines() if re.match(rf"\s*{re.escape(start)}\s", line)]
    return [float(word) for word in re.findall(r"-?\d+\.\d+", line)]


class TestTotals:
    def test_abg_at_all_angles(self, capsys: Captured) -> None:
        found = [row for row in vectors.rows("abg_tis.csv") if row["case"] == "TracePro plot"]
        out = succeeds(capsys, *ABG, "--angles-deg", *(f"{float(row['theta_i_deg']):g}" for row in found))
        for row in found:
            total = rows(out)[float(row["theta_i_deg"])][0]
            assert total == pytest.approx(100 * float(row["TIS_numeric"]), rel=5e-4)  # four digits are printed

    def test_total_reflection_and_the_share_of_the_coating(self, capsys: Captured) -> None:
        command = (*ABG, "--angles-deg", 0, 60, "--from-back")
        assert re.search(r"^ +60 .* – +– +–$", succeeds(capsys, *command), re.MULTILINE)
        found = json_units.read(succeeds(capsys, *command, "--json"))["totals"]
        through = [row["scattered"] is None for row in found if row["event"] == "transmission"]
        assert through == [False, True]
        whole, part = (succeeds(capsys, *ABG, "--R", share, "--angles-deg", 0) for share in (1, 0.1))
        assert "\nnote: ABg: B 0.001 and g 1.8 are outside of what is usual" in whole
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
    """TracePro's sheet "ABg from RMS", with its own integral; its steps are in physics/test_abg.py."""
    sheet = ("bsdf", "abg", "--rms-nm", 5, "--correlation-um", 100, "--wavelength-nm", 500)
    out = succeeds(capsys, *sheet, "--R", 0.95, "--raw-integral", "0.015552516", "--angles-deg", 0)
    for name, value in (("BSDF(0)", "3770.36324"), ("correction", "0.957013661"), ("B", "5.03930226e-10"), ("g", "3")):
        assert re.search(rf"^{re.escape(name)} +{re.escape(value)}\b", out, re.MULTILINE), name
    answer = json_units.read(succeeds(capsys, *sheet, "--json"))
    made = answer["from_roughness"]
    assert made["bsdf_0_1_sr"] == pytest.approx(made["bsdf_per_psd_per_um4"] * made["psd_amplitude_um4"])
    assert made["A_1_sr"] / made["B"] == pytest.approx(answer["totals"][0]["peak_1_sr"], rel=1e-2)


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
        r = np.array(one["distance"])
        np.testing.assert_allclose(one["bsdf_1_sr"], 0.0025 / (0.001 + r**1.8), rtol=1e-6)

    @pytest.mark.parametrize("kind", ["bsdf", "csv"])
    def test_table_is_a_model_again(self, capsys: Captured, tmp_path: Path, kind: str) -> None:
        path, angles = tmp_path / f"abg.{kind}", ("--angles-deg", 0, 20, 40, 60)
        first = rows(succeeds(capsys, *ABG, *angles, "--table", path))
        again = rows(succeeds(capsys, "bsdf", path, *angles))
        for angle, values in first.items():
            assert again[angle][0] == pytest.approx(values[0], rel=0.01)
        assert Tabulated.read(path).samples.specular_deg.tolist() == [0, 20, 40, 60]


class TestBrushedSample:
    """A table of a + b cos 2(φ - ρ), an anisotropic sample."""

    def test_rotations(self, capsys: Captured, tmp_path: Path) -> None:
        """The peak, along x, is a + b cos 2ρ, the TIS π a; a table of the model is that again."""
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

    def test_refused(self, capsys: Captured, tmp_path: Path) -> None:
        table = brushed.write_two_fold(tmp_path / "brushed.csv", 0.1, 0.05, step=30.0)
        for more in ((), ("--anisotropy", "mean", "--rotations-deg", 0)):
            assert re.search("anisotropy|rotations-deg", fails(capsys, "bsdf", table, *more))


class TestCoating:
    def test_numbers_of_a_preset(self, capsys: Captured) -> None:
        command = ("coating", "bbar3", "--back", "1.5168", "--wavelength-nm", "450:650:50", "--angles-deg", 0, 45)
        out = succeeds(capsys, *command)
        values = spectrum(preset("bbar3"), [450, 500, 550, 600, 650], [0, 45], back="1.5168")
        r = 100 * values.mean()
        np.testing.assert_allclose(numbers(out, "550"), [r[2, 0], r[2, 1], *(100 * values.R[2, 1])], atol=6e-5)
        np.testing.assert_allclose(numbers(out, "45")[:3], [r[:, 1].mean(), 100 - r[:, 1].mean(), 0], atol=6e-5)
        assert "99.638" in out, "thickness of the first layer"
        answer = json_units.read(succeeds(capsys, *command, "--json"))
        found = {(row["wavelength_nm"], row["angle_deg"]): row for row in answer["spectrum"]}
        assert len(found) == 10
        for (wavelength, angle), row in found.items():
            place = int(wavelength - 450) // 50, int(angle) // 45
            assert [row["R_s"], row["R_p"]] == values.R[place].tolist()
            assert [row["T_s"], row["T_p"]] == values.T[place].tolist()
            assert row["R_s"] + row["T_s"] + row["A_s"] == pytest.approx(1)
        assert answer["band"][1]["R_mean"] == pytest.approx(values.mean()[:, 1].mean())
        assert answer["band"][1]["R_least"] == values.mean()[:, 1].min()
        layer, *others = answer["layers"]
        assert len(others) == 2
        assert layer["waves"] == pytest.approx(layer["n"] * layer["thickness_nm"] / answer["design_nm"])

    def test_absorption_light_from_behind_and_the_design(self, capsys: Captured) -> None:
        share = numbers(succeeds(capsys, "coating", "protected_al", "--wavelength-nm", 550, "--angles-deg", 0), "0")
        assert share[0] + share[2] == pytest.approx(100, abs=2e-4)
        assert share[1] == 0
        command = ("coating", "1.38 0.25w", "--angles-deg", 0, "--wavelength-nm", "500:600.1:100.1", "--back", 1.7)
        front, back = (succeeds(capsys, *command, *more) for more in ((), ("--from-back",)))
        assert "light from 1.7" in back
        assert numbers(front, "500") == numbers(back, "500")  # lossless, normal incidence
        beyond = succeeds(capsys, "coating", "bare", "--angles-deg", 60, "--wavelength-nm", 550, "--from-back")
        assert numbers(beyond, "60")[0] == 100.0
        for design in ("550", "1000"):
            more = ("--design-nm", design, "--wavelength-nm", design, "--angles-deg", 0, "--back", 1.5168)
            assert numbers(succeeds(capsys, "coating", "v_coat", *more), design)[0] == 0

    def test_files(self, capsys: Captured, tmp_path: Path) -> None:
        out = succeeds(capsys, "coating", f"{SAMPLE}:SPLIT", "--angles-deg", 0, "--wavelength-nm", 550)
        np.testing.assert_allclose(numbers(out, "0")[:3], [50, 40, 10])
        path = tmp_path / "ar.csv"
        more = ("--wavelength-nm", "500:600:25", "--angles-deg", 0, 30)
        assert f"wrote {path}" in succeeds(capsys, "coating", "bbar4", "--csv", path, *more)
        table = CoatingTable.read(path)
        np.testing.assert_allclose(spectrum(table, [525], [30]).R, spectrum(preset("bbar4"), [525], [30]).R, atol=1e-9)
        assert "500 … 600 nm" in fails(capsys, "coating", path, "--wavelength-nm", 400)

    def test_surfaces_of_a_scene(self, capsys: Captured, tmp_path: Path) -> None:
        path = tmp_path / "surfaces.svg"
        command = ("coating", "cooke_triplet", "--wavelength-nm", 500, 600, "--angles-deg", 0, 30)
        out = succeeds(capsys, *command)
        assert re.search(r"L1_front, L3_front +bare +air +N-LAK9 +6\.\d+", out)
        assert "detector" not in out
        answer = json_units.read(succeeds(capsys, *command, "--plot", path, "--json"))
        assert answer["files"] == [str(path)]
        assert path.stat().st_size > 5000
        assert sum(len(surface["names"]) for surface in answer["surfaces"]) >= 6
        assert {row["angle_deg"] for surface in answer["surfaces"] for row in surface["angles"]} == {0.0, 30.0}

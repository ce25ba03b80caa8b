"""`mistray coating`: the numbers that it prints are those of the coatings."""

import re
from pathlib import Path

import json_units
import numpy as np
import pytest
import vectors
from command_line import Captured, Patch, fails, succeeds
from oracles.small_scenes import plates_text, write

from mistray.coatings import CoatingTable, preset, spectrum

SAMPLE = vectors.DATA / "coating_sample.dat"


def numbers(out: str, start: str) -> list[float]:
    (line,) = [line for line in out.splitlines() if re.match(rf"\s*{re.escape(start)}\s", line)]
    return [float(word) for word in re.findall(r"-?\d+\.\d+", line)]


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
            assert [row[key] for key in ("R_s", "R_p", "T_s", "T_p")] == [*values.R[place], *values.T[place]]
            assert row["R_s"] + row["T_s"] + row["A_s"] == pytest.approx(1)
        assert answer["band"][1]["R_mean"] == pytest.approx(values.mean()[:, 1].mean())
        assert answer["band"][1]["R_least"] == values.mean()[:, 1].min()
        layer, *others = answer["layers"]
        assert len(others) == 2
        assert layer["waves"] == pytest.approx(layer["n"] * layer["thickness_nm"] / answer["design_nm"])

    def test_absorption_light_from_behind_and_the_design(self, capsys: Captured) -> None:
        out = succeeds(capsys, "coating", "protected_al", "--wavelength-nm", 550, "--angles-deg", 0)
        reflected, passed, absorbed, *_ = numbers(out, "0")
        assert (reflected + absorbed, passed) == (pytest.approx(100, abs=2e-4), 0)
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

    def test_a_scene_of_one_invisible_line(self, capsys: Captured, tmp_path: Path) -> None:
        line = '<float name="wavelength_nm" value="10000"/></emitter>'
        scene = write(tmp_path, plates_text(1, "Ge").replace("</emitter>", line))
        out = succeeds(capsys, "coating", scene, "--angles-deg", 0)
        assert re.search(r"p0_front +bare +air +Ge +36\.0384\n", out)

    def test_a_folder_whose_name_could_be_a_coating(self, capsys: Captured, tmp_path: Path, monkeypatch: Patch) -> None:
        """Blanks, as between layers, or the ending of a table; the name of a preset is that of the preset."""
        for name in ("1.38 0.25w", "ar.csv", "bbar3"):
            (tmp_path / name).mkdir()
            write(tmp_path / name, plates_text(1))
        monkeypatch.chdir(tmp_path)
        more = ("--wavelength-nm", 550, "--angles-deg", 0)
        for name in ("1.38 0.25w", "ar.csv"):
            assert "p0_front" in succeeds(capsys, "coating", name, *more)
        for name in ("bbar3", "1.38 0.25w, 2.1 0.5w"):
            assert "N-BK7" in succeeds(capsys, "coating", name, *more)

"""Files of BSDF tables: Zemax and CSV, written and read back, and what is wrong with a file in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.scatter.evaluate import bsdf
from mistray.scatter.measured.bsdf_csv import read_bsdf_csv, write_bsdf_csv
from mistray.scatter.measured.samples import Samples
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf, write_zemax_bsdf

LAMBERT = """# a comment
Source  Measured
Symmetry  PlaneSymmetrical
SpectralContent  Monochrome
ScatterType  BRDF
SampleRotation  1
0
AngleOfIncidence  2
0\t60
ScatterAzimuth 3
0 90 180
ScatterRadial 4
0 10 90
150

Monochrome
DataBegin
TIS 0.3
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
TIS 0.3
0.0954929658551372 0.0954929658551372 0.0954929658551372 0.0954929658551372
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0 0
DataEnd
"""
DENSE = np.concatenate([[0.0], np.geomspace(0.05, 150, 60)])


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def random_samples(frame: str, event: str | None) -> Samples:
    rng = np.random.default_rng(5)
    angles, azimuth = np.array([0.0, 20.0, 55.0]), np.linspace(0, 180, 7)
    polar = np.linspace(0, 90 if frame == "normal" else 150, 12)
    return Samples("random", frame, angles, azimuth, polar, rng.random((3, 7, 12)) * 0.1, event)


class TestZemax:
    def test_lambertian(self, tmp_path: Path) -> None:
        """What lies below the horizon in the file, here 0, does not matter."""
        model = Tabulated.read(write(tmp_path / "lambert.BSDF", LAMBERT))
        rng = np.random.default_rng(1)
        for theta_i, theta_s, phi in rng.random((200, 3)) * [1.5, 1.55, np.pi]:
            d = np.array([[np.sin(theta_s) * np.cos(phi), np.sin(theta_s) * np.sin(phi), np.cos(theta_s)]])
            value = bsdf(model.lobes(550, 1, 1.5, True), "reflection", np.cos(theta_i), d, 1, 1.5, 0.5)
            assert value[0] == pytest.approx(0.3 / np.pi, rel=1e-6)

    def test_azimuth_0_points_to_the_normal(self) -> None:
        """At 60° the direction 60° off the specular one at azimuth 0 is the normal; 30° off at 180° it is grazing."""
        grid = Samples("x", "specular", np.array([60.0]), np.array([0.0, 180.0]), np.array([0.0, 30.0, 60.0, 150.0]),
                       np.zeros((1, 2, 4)))  # fmt: skip
        d = grid.directions()[0]
        np.testing.assert_allclose(d[0, 2], [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(d[1, 1], [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(d[0, 0], [np.sin(np.pi / 3), 0, 0.5], atol=1e-12)
        polar, azimuth = grid.angles_of(60.0, grid.directions()[0, :, 1:3])
        np.testing.assert_allclose(polar, [[30, 60], [30, 60]], atol=1e-9)
        np.testing.assert_allclose(azimuth, [[0, 0], [180, 180]], atol=1e-9)

    @pytest.mark.parametrize("event", ["reflection", "transmission"])
    def test_round_trip(self, tmp_path: Path, event: str) -> None:
        samples = random_samples("specular", event)
        write_zemax_bsdf(samples, tmp_path / "a.bsdf", "made by a test\nof two lines")
        text = (tmp_path / "a.bsdf").read_text()
        assert text.startswith("# made by a test\n# of two lines\nSource Measured\n")
        read = read_zemax_bsdf(tmp_path / "a.bsdf")
        assert read.event == event
        for key in ("specular_deg", "azimuth_deg", "polar_deg"):
            np.testing.assert_allclose(getattr(read, key), getattr(samples, key), rtol=1e-9)
        np.testing.assert_allclose(read.values, samples.values, rtol=1e-6)

    def test_total_in_the_file(self, tmp_path: Path) -> None:
        shape = (2, 3, len(DENSE))
        level = Samples("x", "specular", np.array([0.0, 60.0]), np.array([0.0, 90.0, 180.0]), DENSE,
                        np.full(shape, 0.3 / np.pi), "reflection")  # fmt: skip
        write_zemax_bsdf(level, tmp_path / "a.bsdf")
        totals = [float(line.split()[1]) for line in (tmp_path / "a.bsdf").read_text().splitlines() if "TIS" in line]
        assert totals == pytest.approx([0.3, 0.3], rel=1e-3)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("SampleRotation  1\n0", "SampleRotation 2\n0 90", "DataEnd after 0 of"),
            ("PlaneSymmetrical", "Round", "line 3: Symmetry is Round; use PlaneSymmetrical or"),
            ("SpectralContent  Monochrome", "SpectralContent XYZ", "line 4: XYZ are colours"),
            ("ScatterType  BRDF", "ScatterType BSSRDF", "line 5: ScatterType is BSSRDF; use BRDF or BTDF"),
            ("AngleOfIncidence  2", "AngleOfIncidence two", "line 8: 'AngleOfIncidence two'; expected"),
            ("0 90 180", "0 ninety 180", "line 11: could not convert string to float: 'ninety'"),
            ("Monochrome\nDataBegin", "DataBegin", "line 16: 'DataBegin'; expected Monochrome"),
            ("0.0954929658551372 0\nTIS", "0.0954929658551372 -1\nTIS", "line 21: -1; a BSDF is not negative"),
            ("0.0954929658551372 0\nTIS", "0.0954929658551372\nTIS", "line 22: TIS after 11 of 12 values at 0°"),
            ("0 0\nDataEnd", "0\nDataEnd", "line 26: DataEnd after 11 of 12 values at 60°; the file is incomplete"),
            ("0 0\nDataEnd", "0 0\n", "it ends before DataEnd; the file is incomplete"),
            ("DataEnd", "1 1 1 1\nDataEnd", "line 26: '1 1 1 1'; expected DataEnd, there are more data than angles"),
            ("\n150\n", "\n90\n", "polar angles do not ascend"),
        ],
    )
    def test_malformed(self, tmp_path: Path, old: str, new: str, words: str) -> None:
        assert LAMBERT.count(old) >= 1
        with pytest.raises(MistrayError) as error:
            read_zemax_bsdf(write(tmp_path / "bad.bsdf", LAMBERT.replace(old, new, 1)))
        assert words in str(error.value)
        assert "bad.bsdf" in str(error.value)
        assert "\n" not in str(error.value)

    def test_only_its_own_frame(self, tmp_path: Path) -> None:
        with pytest.raises(MistrayError, match="give a table in the frame 'specular' with an event"):
            write_zemax_bsdf(random_samples("specular", None), tmp_path / "a.bsdf")
        with pytest.raises(MistrayError, match="counts angles from the normal"):
            write_bsdf_csv(random_samples("specular", None), tmp_path / "a.csv")


class TestCsv:
    def test_round_trip(self, tmp_path: Path) -> None:
        samples = random_samples("normal", None)
        write_bsdf_csv(samples, tmp_path / "a.csv", "made by a test")
        read = read_bsdf_csv(tmp_path / "a.csv")
        np.testing.assert_allclose(read.values, samples.values, rtol=1e-8)
        np.testing.assert_allclose(read.polar_deg, samples.polar_deg, rtol=1e-9)

    def test_rows_in_any_order(self, tmp_path: Path) -> None:
        samples = random_samples("normal", None)
        write_bsdf_csv(samples, tmp_path / "a.csv")
        head, *rows = (tmp_path / "a.csv").read_text().splitlines()
        np.random.default_rng(2).shuffle(rows)
        columns = [3, 1, 0, 2]
        shuffled = [",".join(line.split(",")[k] for k in columns) for line in (head, *rows)]
        write(tmp_path / "b.csv", "# a comment\n\n" + "\n".join(shuffled))
        np.testing.assert_allclose(read_bsdf_csv(tmp_path / "b.csv").values, samples.values, rtol=1e-8)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "its columns are missing; give theta_i_deg, theta_s_deg, phi_deg, bsdf"),
            ("theta_i_deg,theta_s_deg,bsdf\n0,0,1\n", "its columns are theta_i_deg, theta_s_deg, bsdf; give"),
            ("{head}0,0,0,x\n", "line 2: could not convert string to float: 'x'"),
            ("{head}0,0,0\n", "line 2: 3 values where 4 are needed"),
            ("{head}", "0 rows for 0 theta_i"),
            ("{head}0,0,0,1\n0,90,0,1\n0,0,180,1\n", "3 rows for 1 theta_i × 2 theta_s × 2 phi"),
            ("{head}0,0,0,1\n0,90,0,1\n0,0,180,1\n0,0,180,1\n", "a combination of angles is there twice"),
        ],
    )
    def test_malformed(self, tmp_path: Path, text: str, words: str) -> None:
        path = write(tmp_path / "bad.csv", text.format(head="theta_i_deg,theta_s_deg,phi_deg,bsdf\n"))
        with pytest.raises(MistrayError) as error:
            read_bsdf_csv(path)
        assert words in str(error.value)
        assert "bad.csv" in str(error.value)

    def test_no_text(self, tmp_path: Path) -> None:
        (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
        with pytest.raises(MistrayError, match="it is no text file"):
            read_bsdf_csv(tmp_path / "a.csv")

"""`mistray bsdf`: what it prints, what it writes, one line for bad input."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from oracles import brushed

from mistray import cli
from mistray.scatter.measured.tabulated import Tabulated

DATA = Path(__file__).parent / "data"
ABG = ("abg", "--A", "0.0025", "--B", "0.001", "--g", "1.8")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert cli.main(["bsdf", *arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert cli.main(["bsdf", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def rows(out: str) -> dict[float, list[float]]:
    """Lines of the table: angle of incidence → its other numbers."""
    found = {}
    for line in out.splitlines():
        if re.fullmatch(r"[\s\d.e+-]+", line) and re.search(r"\d", line):
            angle, *values = (float(word) for word in line.split())
            found[angle] = values
    return found


def test_help_has_examples(capsys) -> None:
    assert cli.main(["bsdf", "--help"]) == 0
    assert "examples:" in capsys.readouterr().out


class TestTotals:
    def test_abg_at_all_angles(self, capsys) -> None:
        with (DATA / "abg_tis.csv").open() as file:
            vectors = [row for row in csv.DictReader(line for line in file if not line.startswith("#"))]
        expected = {float(v["theta_i_deg"]): float(v["TIS_numeric"]) for v in vectors if v["case"] == "TracePro plot"}
        out = run(capsys, *ABG, "--angles-deg", *(f"{angle:g}" for angle in expected))
        for angle, tis in expected.items():
            assert rows(out)[angle][0] == pytest.approx(100 * tis, rel=5e-4)  # four digits are printed
        assert rows(out)[0][2] == 2.5  # A/B

    def test_harvey_shack_of_the_phone_camera(self, capsys) -> None:
        """40 Å: TIS of the four materials, transmitted, in percent."""
        with (DATA / "harvey_table13.csv").open() as file:
            vectors = [row for row in csv.DictReader(line for line in file if not line.startswith("#"))]
        assert len(vectors) == 4
        for row in vectors:
            n, tis = float(row["n"]), float(row["TIS_pct_calc"])
            out = run(capsys, "harvey_shack", "--rms-nm", "4", "--back", f"{n}", "--angles-deg", "0")
            assert rows(out)[0][3] == pytest.approx(tis, rel=5e-4)

    def test_flat_black(self, capsys) -> None:
        out = run(capsys, "paint", "--preset", "flat_black", "--angles-deg", "0", "80")
        assert rows(out) == {0: [4.5, 0, 0.01432], 80: [4.5, 0, 0.01432]}

    def test_total_reflection(self, capsys) -> None:
        out = run(capsys, *ABG, "--angles-deg", "0", "60", "--from-back")
        assert re.search(r"^ +60 .* – +– +–$", out, re.MULTILINE)

    def test_share_of_the_coating(self, capsys) -> None:
        whole, part = (rows(run(capsys, *ABG, "--R", share, "--angles-deg", "0"))[0] for share in ("1", "0.1"))
        assert part[0] == pytest.approx(0.1 * whole[0], rel=5e-4)
        assert part[1] == whole[1]  # the loss is a share of the specular beam

    @pytest.mark.parametrize(
        "arguments",
        [
            ("gaussian_lobe", "--total", "0.01", "--width", "0.02"),
            ("phong", "--b0", "0.1", "--exponent", "16"),
            ("polynomial", "--coefficients", "c000=0.5,c100=-0.4,l10=-0.7", "--d", "2e3"),
            ("psd_table", "--file", str(DATA / "psd_polish.csv"), "--theory", "rayleigh_rice", "--event", "reflection"),
            (
                "k_correlation",
                "--rms-nm",
                "2",
                "--B-um",
                "50",
                "--slope",
                "2.5",
                "--theory",
                "rayleigh_rice",
                "--event",
                "reflection",
            ),
            ("k_correlation", "--rms-nm", "2", "--B-um", "50", "--slope", "2", "--band-limited"),
            ("particulate", "--level", "300"),
            ("particulate", "--coverage-percent", "0.05", "--particle", "1.5+0.01i"),
            ("paint", "--reflectance", "0.03", "--b0", "0.02", "--l", "0.1", "--s", "-3", "--n", "1.5"),
        ],
    )
    def test_every_model(self, capsys, arguments: tuple[str, ...]) -> None:
        found = rows(run(capsys, *arguments, "--angles-deg", "0", "45"))
        assert set(found) == {0, 45}
        assert all(values[0] > 0 for values in found.values())


def test_sheet_of_a_rough_surface(capsys) -> None:
    """The steps of TracePro's sheet "ABg from RMS" and its result, with the sheet's own integral."""
    sheet = ("abg", "--rms-nm", "5", "--correlation-um", "100", "--wavelength-nm", "500", "--R", "0.95")
    out = run(capsys, *sheet, "--raw-integral", "0.015552516", "--angles-deg", "0")
    for name, value in (
        ("As", "1.57079633"), ("Bs", "628.318531"), ("D", "2400.28779"), ("BSDF(0)", "3770.36324"),
        ("Bennett and Porteus TIS", "0.0148839703"), ("correction", "0.957013661"), ("shortest wavelength", "250"),
        ("B", "5.03930226e-10"), ("g", "3"),
    ):  # fmt: skip
        assert re.search(rf"^{re.escape(name)} +{re.escape(value)}\b", out, re.MULTILINE), name
    a = re.search(r"^A +(\S+)", out, re.MULTILINE)
    assert a is not None
    assert f"{float(a[1]):.5e}" == "1.81832e-06"
    exact = run(capsys, *sheet, "--angles-deg", "0")
    assert rows(exact)[0][0] == pytest.approx(1.488397, rel=5e-4)  # scatters what it was normalised to
    assert "transmission" not in exact


class TestFiles:
    def test_picture(self, capsys, tmp_path: Path) -> None:
        for kind in ("png", "svg", "pdf"):
            path = tmp_path / f"abg.{kind}"
            assert f"wrote {path}" in run(capsys, *ABG, "--plot", str(path))
            assert path.stat().st_size > 5000

    def test_particles(self, capsys, tmp_path: Path) -> None:
        path = tmp_path / "particles.png"
        run(capsys, "particulate", "--level", "300", "--plot-particles", str(path), "--angles-deg", "0")
        assert path.stat().st_size > 5000

    def test_curves(self, capsys, tmp_path: Path) -> None:
        path = tmp_path / "abg.csv"
        run(capsys, *ABG, "--csv", str(path), "--angles-deg", "0", "30")
        with path.open() as file:
            assert file.readline().startswith("# mistray bsdf abg --A 0.0025")
            table = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
        assert {row["theta_i_deg"] for row in table} == {0, 30}
        for row in table:
            assert row["bsdf"] == pytest.approx(0.0025 / (0.001 + row["distance"] ** 1.8), rel=1e-6)

    @pytest.mark.parametrize("kind", ["bsdf", "csv"])
    def test_table_is_a_model_again(self, capsys, tmp_path: Path, kind: str) -> None:
        path = tmp_path / f"abg.{kind}"
        angles = ("--angles-deg", "0", "20", "40", "60")
        first = rows(run(capsys, *ABG, *angles, "--table", str(path)))
        again = rows(run(capsys, str(path), *angles))
        for angle, values in first.items():
            assert again[angle][0] == pytest.approx(values[0], rel=0.01)
        assert Tabulated.read(path).samples.specular_deg.tolist() == [0, 20, 40, 60]

    def test_nothing_is_printed_before_the_files_are_there(self, capsys, tmp_path: Path) -> None:
        for option, name in (("--plot", "a.png"), ("--csv", "a.csv"), ("--table", "a.bsdf")):
            assert "check the folder" in fails(capsys, *ABG, option, str(tmp_path / "none" / name))


def test_advice(capsys) -> None:
    assert "\nnote: ABg: B 0.001 and g 1.8 are outside of what is usual" in run(capsys, *ABG, "--angles-deg", "0")
    usual = run(capsys, "abg", "--A", "2e-5", "--B", "1e-6", "--g", "2", "--angles-deg", "0")
    assert "note:" not in usual


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("abc",), "scatter model 'abc' is unknown; use abg, "),
        (("abg", "--A", "1"), "B is missing; give A, B, g"),
        ((*ABG, "--level", "300"), "abg has no --level; its options are --A, --B, --g"),
        (("abg", "--A", "1", "--B", "0", "--g", "2"), "B is 0; give B > 1e-12"),
        (("abg", "--A", "1", "--B", "-1", "--g", "2"), "B is -1"),
        ((*ABG, "--rms-nm", "5"), "--rms-nm gives A, B and g; leave --A out"),
        ((*ABG, "--delta-n", "2"), "--delta-n is for parameters from a roughness"),
        (("abg", "--rms-nm", "5"), "abg from --rms-nm needs --correlation-um; --correlation-um is missing"),
        (("harvey_shack", "--b0", "1", "--s", "0.5"), "s is 0.5; it must lie"),
        (("harvey_shack",), "neither of b0 and rms_nm given"),
        (("harvey_shack", "--rms-nm", "400"), "is not smooth in reflection"),
        (("particulate", "--level", "0.5"), "level is 0.5"),
        (("paint", "--preset", "black"), "paint preset 'black' is unknown"),
        (("paint", "--preset", "flat_black", "--l", "1"), "paint: --l with a preset"),
        ((*ABG, "--angles-deg", "95"), "--angles-deg: 95 must lie between 0 and 90"),
        (
            (*ABG, "--angles-deg", "60", "--from-back", "--event", "transmission"),
            "is totally reflected, nothing is transmitted",
        ),
        (("abg", "--A", "0", "--B", "1", "--g", "0"), "abg scatters nothing"),
        ((*ABG, "--R", "1.5"), "--R: 1.5 must lie between 0 and 1"),
        ((*ABG, "--plot", "a.gif"), "picture 'a.gif': its name must end in .png, .svg or .pdf"),
        ((*ABG, "--table", "a.txt"), "table 'a.txt': its name must end in .bsdf (Zemax) or .csv"),
        ((*ABG, "--plot-particles", "a.png"), "abg has no particles; leave --plot-particles out"),
        ((*ABG, "--back", "N-BK8"), "material 'N-BK8' is unknown"),
        (("nowhere.bsdf",), "BSDF table 'nowhere.bsdf': No such file"),
        (("nowhere.csv", "--A", "1"), "nowhere.csv has no --A; its options are --cosine-corrected, --beyond"),
    ],
)
def test_bad_input(capsys, arguments: tuple[str, ...], words: str) -> None:
    assert words in fails(capsys, *arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        "phong --b0 1e308 --exponent 10",
        "phong --b0 1e-308 --exponent 10",
        "phong --b0 0.1 --exponent 1e308",
        "abg --A 1e308 --B 0.001 --g 1.8",
        "abg --A 0.0025 --B 0.001 --g 1e308",
        "abg --A 0.0025 --B 1e308 --g 1.8",
        "harvey_shack --b0 1e308 --l 0.01 --s=-1.5",
        "harvey_shack --b0 1 --l 1e308 --s=-1.5",
        "gaussian_lobe --total 1e-308 --width 0.1",
        "gaussian_lobe --total 0.1 --width 1e-308",
        "particulate --level 300 --slope 1e308",
        "particulate --level 300 --slope 1e-308",
        "particulate --level 1e308 --max-um 1000",
        "paint --reflectance 1e-308 --b0 1 --l 0.1 --s=-2",
        "polynomial --coefficients c000=0",
        "polynomial --coefficients c000=1e308",
    ],
)
def test_numbers_that_no_surface_has(capsys, arguments: str) -> None:
    """One line: totals are finite and at most 1, and the tables of a trace hold the values."""
    fails(capsys, *arguments.split())


@pytest.mark.parametrize(
    ("arguments", "percent"),
    [
        ("abg --A 0.0025 --B 0.001 --g 1e-308", 100 * 3.14159265 * 0.0025 / 1.001),
        ("abg --A 1e-25 --B 0.001 --g 1e-308", 100 * 3.14159265e-25 / 1.001),
        ("gaussian_lobe --total 0.1 --width 1e6", 10.0),
        ("gaussian_lobe --total 0.1 --width 1e-6", 10.0),
    ],
)
def test_extreme_numbers_that_are_right(capsys, arguments: str, percent: float) -> None:
    out = run(capsys, *arguments.split(), "--angles-deg", "0")
    assert rows(out)[0][0] == pytest.approx(percent, rel=6e-4)


class TestBrushedSample:
    """A table of a + b cos 2(φ - ρ), an anisotropic sample."""

    @pytest.fixture
    def table(self, tmp_path: Path) -> str:
        return str(brushed.write_two_fold(tmp_path / "brushed.csv", 0.1, 0.05, step=30.0))

    def test_rotations(self, capsys, table: str, tmp_path: Path) -> None:
        """The peak, along x, is a + b cos 2ρ, the TIS π a; the curves say which is which."""
        file, picture = tmp_path / "curves.csv", tmp_path / "brushed.png"
        arguments = (table, "--anisotropy", "keep", "--angles-deg", "40", "--rotations-deg", "0", "30", "90")
        record = json.loads(run(capsys, *arguments, "--json", "--csv", str(file), "--plot", str(picture)))
        rows = {row["rotation_deg"]: row for row in record["totals"]}
        assert [curve["rotation_deg"] for curve in record["curves"]] == list(rows) == [0, 30, 90]
        for rotation, row in rows.items():
            assert row["peak_1_sr"] == pytest.approx(0.1 + 0.05 * np.cos(2 * np.radians(rotation)), rel=2e-3)
            assert row["scattered"] == pytest.approx(0.1 * np.pi, rel=2e-3)
        assert file.read_text(encoding="utf-8").splitlines()[1].startswith("rotation_deg,theta_i_deg")
        assert picture.stat().st_size > 0
        text = run(capsys, *arguments)
        assert "rotation" in text
        assert "0.125" in text

    def test_table_is_a_model_again(self, capsys, table: str, tmp_path: Path) -> None:
        copy = tmp_path / "copy.bsdf"
        arguments = (
            "--anisotropy",
            "keep",
            "--event",
            "reflection",
            "--angles-deg",
            "40",
            "--rotations-deg",
            "0",
            "30",
        )
        run(capsys, table, *arguments, "--table", str(copy))
        one, other = (
            json.loads(run(capsys, name, *arguments, "--json"))["totals"] for name in (table, str(copy))
        )  # fmt: skip
        for row, again in zip(one, other, strict=True):
            assert again["peak_1_sr"] == pytest.approx(row["peak_1_sr"], rel=0.02)
            assert again["scattered"] == pytest.approx(row["scattered"], rel=0.01)

    def test_refused(self, capsys, table: str) -> None:
        for arguments in ((table,), (table, "--anisotropy", "mean", "--rotations-deg", "0")):
            assert re.search("anisotropy|rotations-deg", fails(capsys, *arguments))

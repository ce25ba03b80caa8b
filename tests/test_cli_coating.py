"""`mistray coating`: what it prints, what it writes, one line for bad input."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mistray import cli
from mistray.cli.commands.coating import wavelengths
from mistray.coatings import CoatingTable, preset, spectrum
from mistray.errors import MistrayError

SAMPLE = Path(__file__).parent / "data" / "coating_sample.dat"


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert cli.main(["coating", *arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert cli.main(["coating", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def numbers(out: str, start: str) -> list[float]:
    """Numbers of the line that starts with a text."""
    (line,) = [line for line in out.splitlines() if re.match(rf"\s*{re.escape(start)}\s", line)]
    return [float(word) for word in re.findall(r"-?\d+\.\d+", line)]


def test_help_has_examples(capsys) -> None:
    assert cli.main(["coating", "--help"]) == 0
    assert "examples:" in capsys.readouterr().out


class TestNumbers:
    def test_of_a_preset(self, capsys) -> None:
        out = run(capsys, "bbar3", "--back", "1.5168", "--wavelength-nm", "450:650:50", "--angles-deg", "0", "45")
        assert out.startswith("bbar3: air | 1.5168, light from air\n")
        values = spectrum(preset("bbar3"), [450, 500, 550, 600, 650], [0, 45], back="1.5168")
        r = 100 * values.mean()
        np.testing.assert_allclose(numbers(out, "550"), [r[2, 0], r[2, 1], *(100 * values.R[2, 1])], atol=6e-5)
        np.testing.assert_allclose(numbers(out, "0")[0], r[:, 0].mean(), atol=6e-5)
        np.testing.assert_allclose(numbers(out, "45")[:3], [r[:, 1].mean(), 100 - r[:, 1].mean(), 0], atol=6e-5)
        assert "99.638" in out, "thickness of the first layer"

    def test_mirrors_absorb(self, capsys) -> None:
        out = run(capsys, "protected_al", "--wavelength-nm", "550", "--angles-deg", "0")
        share = numbers(out, "0")
        assert share[0] + share[2] == pytest.approx(100, abs=2e-4)
        assert share[1] == 0

    def test_layers_from_behind(self, capsys) -> None:
        front = run(capsys, "1.38 0.25w", "--angles-deg", "0", "--wavelength-nm", "500", "600", "--back", "1.7")
        back = run(
            capsys, "1.38 0.25w", "--angles-deg", "0", "--wavelength-nm", "500", "600", "--back", "1.7", "--from-back"
        )
        assert "light from 1.7" in back
        assert numbers(front, "500") == numbers(back, "500")  # lossless, normal incidence
        beyond = run(capsys, "bare", "--angles-deg", "60", "--wavelength-nm", "550", "--from-back")
        assert numbers(beyond, "60")[0] == 100.0

    def test_design_wavelength(self, capsys) -> None:
        for design in ("550", "1000"):
            arguments = ("v_coat", "--design-nm", design, "--wavelength-nm", design, "--angles-deg", "0")
            assert numbers(run(capsys, *arguments, "--back", "1.5168"), design)[0] == 0

    def test_files(self, capsys) -> None:
        out = run(capsys, f"{SAMPLE}:SPLIT", "--angles-deg", "0", "--wavelength-nm", "550")
        np.testing.assert_allclose(numbers(out, "0")[:3], [50, 40, 10])


class TestFiles:
    def test_table(self, capsys, tmp_path: Path) -> None:
        path = tmp_path / "ar.csv"
        out = run(capsys, "bbar4", "--csv", str(path), "--wavelength-nm", "500:600:25", "--angles-deg", "0", "30")
        assert f"wrote {path}" in out
        table = CoatingTable.read(path)
        np.testing.assert_allclose(spectrum(table, [525], [30]).R, spectrum(preset("bbar4"), [525], [30]).R, atol=1e-9)
        assert "500 … 600 nm" in fails(capsys, str(path), "--wavelength-nm", "400")

    @pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
    def test_picture(self, capsys, tmp_path: Path, kind: str) -> None:
        path = tmp_path / f"ar.{kind}"
        run(capsys, "mgf2_quarter_wave", "--plot", str(path), "--wavelength-nm", "500:600:50")
        assert path.stat().st_size > 5000

    def test_nothing_is_printed_before_the_files_are_there(self, capsys, tmp_path: Path) -> None:
        assert "check the folder" in fails(capsys, "bbar3", "--plot", str(tmp_path / "none" / "a.png"))
        assert "check the folder" in fails(capsys, "bbar3", "--csv", str(tmp_path / "none" / "a.csv"))


class TestScenes:
    def test_surfaces(self, capsys, tmp_path: Path) -> None:
        path = tmp_path / "surfaces.png"
        out = run(capsys, "cooke_triplet", "--wavelength-nm", "500", "600", "--angles-deg", "0", "--plot", str(path))
        assert re.search(r"L1_front, L3_front +bare +air +N-LAK9 +6\.\d+", out)
        assert "detector" not in out
        assert path.stat().st_size > 5000

    def test_options_without_meaning(self, capsys) -> None:
        assert "--back has no meaning for a scene" in fails(capsys, "cooke_triplet", "--back", "N-BK7")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("bbar5",), "coating preset 'bbar5' is unknown; did you mean 'bbar4'?"),
        (("MgF 100",), "material 'MgF' is unknown"),
        (("bbar3", "--back", "N-BK8"), "material 'N-BK8' is unknown"),
        (("bbar3", "--wavelength-nm", "9000", "--back", "N-BK7"), "9000 nm is outside"),
        (("bbar3", "--wavelength-nm", "500:400:5"), "give first:last:step with the last not below the first"),
        (("bbar3", "--wavelength-nm", "400:500"), "--wavelength-nm 400:500: give first:last:step"),
        (("bbar3", "--wavelength-nm", "red"), "--wavelength-nm red: 'red' is not a number"),
        (("bbar3", "--wavelength-nm", "400:500:1e-3"), "100000 wavelengths; take a larger step"),
        (("bbar3", "--angles-deg", "95"), "must lie between 0 and 90 degrees"),
        (("bbar3", "--plot", "a.gif"), "picture 'a.gif': its name must end in .png, .svg or .pdf"),
        (("bbar3", "--plot", "a.png", "--wavelength-nm", "550"), "needs two or more wavelengths"),
        (("nowhere.csv",), "coating table 'nowhere.csv': No such file"),
        ((f"{SAMPLE}:AR9",), "no coating 'AR9'"),
        (("nowhere.xml",), "scene 'nowhere.xml': no such file"),
    ],
)
def test_bad_input(capsys, arguments: tuple[str, ...], words: str) -> None:
    assert words in fails(capsys, *arguments)


def test_wavelengths() -> None:
    assert wavelengths(["400:500:50"]) == [400.0, 450.0, 500.0]
    assert wavelengths(["600", "400:410:5", "405"]) == [400.0, 405.0, 410.0, 600.0]
    assert wavelengths(["10.4:10.7:0.1"]) == pytest.approx([10.4, 10.5, 10.6, 10.7])
    for wrong in ("-5", "0.4:0.7:0.1"):
        with pytest.raises(MistrayError):
            wavelengths([wrong])

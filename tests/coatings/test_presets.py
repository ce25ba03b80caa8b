"""Presets against independent vectors and the figures that they claim."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from mistray.coatings import PRESETS, Layer, Stack, preset, spectrum
from mistray.errors import MistrayError

DATA = Path(__file__).parents[1] / "data"
GLASS = "1.5168"
BAND = np.arange(450.0, 650.1, 2.5)


def vectors(design: str) -> list[dict[str, str]]:
    with (DATA / "thinfilm.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return [row for row in rows if row["design"] == design]


@pytest.mark.parametrize(
    ("name", "design"),
    [
        ("mgf2_quarter_wave", "MgF2_QW"),
        ("v_coat", "V_138_210"),
        ("bbar3", "QHQ_138_210_163"),
        ("bbar4", "BBAR4_LHLH"),
    ],
)
def test_against_vectors(name: str, design: str) -> None:
    """7 wavelengths, 4 angles, s and p; the vectors come from an independent program, checked with `tmm`."""
    rows = vectors(design)
    assert len(rows) == 56
    stack = preset(name)
    for row in rows:
        cosine = np.cos(np.radians([float(row["aoi_deg"])]))
        own = stack.response(float(row["lambda_nm"]), 1 + 0j, 1.5168 + 0j, cosine, True)
        pol = "sp".index(row["pol"])
        assert own.R[0, pol] == pytest.approx(float(row["R"]), abs=1e-12)
        assert own.T[0, pol] == pytest.approx(float(row["T"]), abs=1e-12)


def test_the_protected_mirror_has_the_overcoat_of_the_vectors() -> None:
    """Half a wave of 1.60 on aluminium of constant index: the preset's films over the metal of the vectors."""
    films = preset("protected_al").layers
    stack = Stack((films[0], Layer("0.958+6.69i", films[1].thickness_nm)), opaque=True)
    for row in vectors("Al_SiO_HW"):
        cosine = np.cos(np.radians([float(row["aoi_deg"])]))
        own = stack.response(float(row["lambda_nm"]), 1 + 0j, 1.5168 + 0j, cosine, True)
        # the vectors' aluminium has no end, the preset's 150 nm pass exp(-4πkd/λ) < 2e-8 of the light to and fro
        assert own.R[0, "sp".index(row["pol"])] == pytest.approx(float(row["R"]), abs=3e-8)


class TestFigures:
    """What the docstring says, at normal incidence on n = 1.5168."""

    def test_quarter_wave(self) -> None:
        assert spectrum(preset("mgf2_quarter_wave"), [550.0], [0.0], back=GLASS).mean()[0, 0] == pytest.approx(
            0.012835, abs=5e-7
        )

    def test_v_coat(self) -> None:
        r = spectrum(preset("v_coat"), [500.0, 550.0, 600.0], [0.0], back=GLASS).mean()[:, 0]
        assert r[1] < 1e-9
        assert min(r[0], r[2]) > 1e-3, "a V: narrow"

    def test_three_layers(self) -> None:
        assert spectrum(preset("bbar3"), BAND, [0.0], back=GLASS).mean().max() <= 0.0026

    def test_four_layers(self) -> None:
        every_10_nm = spectrum(preset("bbar4"), np.arange(420.0, 681.0, 10.0), [0.0], back=GLASS).mean().mean()
        assert every_10_nm == pytest.approx(9.36e-4, abs=5e-7)
        fine = spectrum(preset("bbar4"), np.linspace(420.0, 680.0, 2001), [0.0], back=GLASS).mean()
        assert fine.mean() == pytest.approx(8.5e-4, abs=1e-5)
        assert fine.max() <= 0.0033

    @pytest.mark.parametrize(("name", "low", "high"), [("protected_al", 0.90, 0.925), ("protected_ag", 0.965, 0.99)])
    def test_metals(self, name: str, low: float, high: float) -> None:
        """Freshly evaporated aluminium and silver in the green."""
        mirror = spectrum(preset(name), [550.0], [0.0, 45.0])
        assert low < mirror.mean()[0, 0] < high
        assert np.all(mirror.T == 0)
        assert preset(name).opaque

    @pytest.mark.parametrize("name", ["protected_al", "protected_ag"])
    def test_the_metal_is_thick_enough(self, name: str) -> None:
        """What is said to be opaque passes less than 1e-6 from 400 to 1000 nm."""
        stack = Stack(preset(name).layers)
        assert spectrum(stack, np.arange(400.0, 1001.0, 25.0), [0.0]).T.max() < 1e-6


def test_the_first_layer_is_the_outermost() -> None:
    for name, design in PRESETS.items():
        stack = preset(name)
        assert stack.first == "outside"
        assert stack.name == name
        assert stack.layers[0].material == design.films[0][0]


def test_design_wavelength() -> None:
    """The curves of a design without dispersion scale with the wavelength; a metal keeps its thickness."""
    short = spectrum(preset("bbar3", 550.0), [500.0, 550.0], [0.0, 30.0], back=GLASS)
    long = spectrum(preset("bbar3", 1100.0), [1000.0, 1100.0], [0.0, 30.0], back=GLASS)
    np.testing.assert_allclose(short.R, long.R, atol=1e-12)
    assert preset("protected_al", 1100.0).layers[1] == preset("protected_al").layers[1]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("bbar5", "coating preset 'bbar5' is unknown; did you mean 'bbar4'?"),
        (
            "xyz",
            f"choose one of {', '.join(PRESETS)}",
        ),
    ],
)
def test_unknown(name: str, words: str) -> None:
    with pytest.raises(MistrayError) as caught:
        preset(name)
    assert words in str(caught.value)


def test_bad_design_wavelength() -> None:
    with pytest.raises(MistrayError, match="coating preset 'bbar3': design_nm = -1"):
        preset("bbar3", -1.0)

"""Presets against independent vectors and the figures that they claim."""

from __future__ import annotations

import numpy as np
import pytest
import vectors
from refusals import refused

from mistray.coatings import PRESETS, Layer, Stack, preset, spectrum

GLASS = "1.5168"
BAND = np.arange(450.0, 650.1, 2.5)
# The vectors' aluminium has no end, the preset's 150 nm pass exp(-4πkd/λ) < 2e-8 of the light to and fro
FILM, METAL = preset("protected_al").layers
MIRROR = Stack((FILM, Layer("0.958+6.69i", METAL.thickness_nm)), opaque=True)


@pytest.mark.parametrize(
    ("stack", "design"),
    [
        (preset("mgf2_quarter_wave"), "MgF2_QW"),
        (preset("v_coat"), "V_138_210"),
        (preset("bbar3"), "QHQ_138_210_163"),
        (preset("bbar4"), "BBAR4_LHLH"),
        (MIRROR, "Al_SiO_HW"),
    ],
)
def test_against_vectors(stack: Stack, design: str) -> None:
    """7 wavelengths, 4 angles, s and p; the vectors come from an independent program, checked with `tmm`."""
    rows = [row for row in vectors.rows("thinfilm.csv") if row["design"] == design]
    assert len(rows) == 56
    for row in rows:
        cosine = np.cos(np.radians([float(row["aoi_deg"])]))
        own = stack.response(float(row["lambda_nm"]), 1 + 0j, 1.5168 + 0j, cosine, True)
        pol = "sp".index(row["pol"])
        assert own.R[0, pol] == pytest.approx(float(row["R"]), abs=3e-8 if stack is MIRROR else 1e-12)
        if stack is not MIRROR:
            assert own.T[0, pol] == pytest.approx(float(row["T"]), abs=1e-12)


def test_figures_of_the_antireflection_coatings() -> None:
    """What the docstring says, at normal incidence on n = 1.5168."""

    def reflectance(name: str, wavelengths_nm: np.ndarray | list[float]) -> np.ndarray:
        return spectrum(preset(name), wavelengths_nm, [0.0], back=GLASS).mean()[:, 0]

    assert reflectance("mgf2_quarter_wave", [550.0])[0] == pytest.approx(0.012835, abs=5e-7)
    below, at, above = reflectance("v_coat", [500.0, 550.0, 600.0])
    assert at < 1e-9
    assert min(below, above) > 1e-3, "a V: narrow"
    assert reflectance("bbar3", BAND).max() <= 0.0026
    assert reflectance("bbar4", np.arange(420.0, 681.0, 10.0)).mean() == pytest.approx(9.36e-4, abs=5e-7)
    fine = reflectance("bbar4", np.linspace(420.0, 680.0, 2001))
    assert fine.mean() == pytest.approx(8.5e-4, abs=1e-5)
    assert fine.max() <= 0.0033


@pytest.mark.parametrize(("name", "low", "high"), [("protected_al", 0.90, 0.925), ("protected_ag", 0.965, 0.99)])
def test_metals(name: str, low: float, high: float) -> None:
    """Freshly evaporated aluminium and silver in the green; so thick that less than 1e-6 passes from 400 nm on."""
    mirror = spectrum(preset(name), [550.0], [0.0, 45.0])
    assert low < mirror.mean()[0, 0] < high
    assert np.all(mirror.T == 0)
    assert preset(name).opaque
    assert spectrum(Stack(preset(name).layers), np.arange(400.0, 1001.0, 25.0), [0.0]).T.max() < 1e-6


def test_design_wavelength() -> None:
    """The curves of a design without dispersion scale with the wavelength; a metal keeps its thickness."""
    short = spectrum(preset("bbar3", 550.0), [500.0, 550.0], [0.0, 30.0], back=GLASS)
    long = spectrum(preset("bbar3", 1100.0), [1000.0, 1100.0], [0.0, 30.0], back=GLASS)
    np.testing.assert_allclose(short.R, long.R, atol=1e-12)
    assert preset("protected_al", 1100.0).layers[1] == METAL
    for name, design in PRESETS.items():
        stack = preset(name)
        assert (stack.first, stack.name, stack.layers[0].material) == ("outside", name, design.films[0][0])


def test_what_is_no_preset() -> None:
    for name, words in (("bbar5", "did you mean 'bbar4'?"), ("xyz", f"choose one of {', '.join(PRESETS)}")):
        with refused(f"coating preset '{name}' is unknown", words):
            preset(name)
    with refused("coating preset 'bbar3': design_nm = -1"):
        preset("bbar3", -1.0)

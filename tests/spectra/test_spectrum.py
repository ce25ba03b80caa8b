"""Spectra beside published numbers and integrals of their own; as a trace takes them from every kind of scene."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scene_dicts
import vectors
from oracles.small_scenes import scene_text, shape_xml, write
from refusals import each_refused

import mistray
from mistray.prescription import ObjectPoint, Source
from mistray.scenes.plate.prescription import build
from mistray.spectra.cie import observer
from mistray.spectra.spectrum import light_of, of_lines, read_table, spectrum

pytestmark = pytest.mark.quick

SCREEN = scene_dicts.detector(0.0, semi_diameter=5.0)


def planck(wavelength_nm: np.ndarray, kelvin: float) -> np.ndarray:
    """Relative radiance of a blackbody by wavelength, with the second radiation constant of CODATA 2018."""
    x = 1.438776877e7 / (wavelength_nm * kelvin)
    return wavelength_nm**-5.0 / np.expm1(x)


@pytest.mark.parametrize("kelvin", [300.0, 3000.0, 5772.0])
def test_bands_of_a_blackbody(kelvin: float) -> None:
    """Weights and mean wavelengths are those of Planck's law by the trapezoidal rule."""
    low, high = (8000.0, 12000.0) if kelvin < 1000 else (400.0, 700.0)
    light = light_of(f"blackbody:{kelvin}", (low, high), 4)
    whole = np.linspace(low, high, 80_001)
    for k in range(4):
        fine = whole[20_000 * k : 20_000 * (k + 1) + 1]
        values = planck(fine, kelvin)
        share = np.trapezoid(values, fine) / np.trapezoid(planck(whole, kelvin), whole)
        mean = np.trapezoid(values * fine, fine) / np.trapezoid(values, fine)
        assert light.weights[k] == pytest.approx(share, rel=1e-7)
        assert light.wavelengths_nm[k] == pytest.approx(mean, rel=1e-9)


def test_lamps_daylight_lines_and_lumens() -> None:
    """The candela until 1979 was that of platinum, 2042 K; parts of the sun by the trapezoidal rule; 133 klx."""
    assert spectrum("blackbody:2042").lumens == pytest.approx(0.6, rel=5e-3)
    sun = spectrum("am0")
    assert sun.energy(119.5, 1e6) == pytest.approx(1366.1e-6, rel=1e-5)
    for low, high, exact in ((400, 700, 530.114), (280, 4000, 1347.62), (200, 300, 14.647), (3000, 5000, 21.077)):
        assert sun.energy(low, high) == pytest.approx(1e-6 * exact, rel=1e-3 if low == 400 else 0.01)
    assert 1e6 * sun.lumens == pytest.approx(133.3e3, rel=5e-3)
    light = light_of("d65", (380, 780), 80)
    known, table = observer()
    xyz = np.array([light.weights @ np.interp(light.wavelengths_nm, known, row) for row in table.T])
    assert xyz[:2] / xyz.sum() == pytest.approx([0.31272, 0.32903], abs=2e-4)
    light = light_of("F, d C", weights=[1, 2, 1])
    assert light.wavelengths_nm == pytest.approx([486.1327, 587.5618, 656.2725])
    assert light.weights == pytest.approx([0.25, 0.5, 0.25])
    assert len(light_of("Hg").wavelengths_nm) == 6
    assert of_lines([555.0]).lumens_per_watt == pytest.approx(683.0, rel=1e-3)
    assert of_lines([1550.0]).lumens_per_watt == 0.0
    # A watt in a part of the visible light goes with all lumens of the lamp
    narrow, wide = light_of("blackbody:3000", (500, 600), 3), light_of("blackbody:3000")
    lamp = spectrum("blackbody:3000")
    ratio = lamp.energy(400, 700) / lamp.energy(500, 600)
    assert narrow.lumens_per_watt == pytest.approx(ratio * wide.lumens_per_watt, rel=1e-9)


def test_tables(tmp_path: Path) -> None:
    """A triangle from 400 to 500 nm: shares of its quarters 1, 3, 3, 1 of 8, mean 2/3 of the way up the first."""
    file = tmp_path / "a lamp.csv"
    file.write_text("# made up\nwavelength_nm, W\n400, 0\n450, 3\n500, 0\n")
    light = light_of(str(file), bands=4)
    assert light.weights == pytest.approx(np.array([1, 3, 3, 1]) / 8)
    assert light.wavelengths_nm[0] == pytest.approx(400 + 25 * 2 / 3)
    assert len(light_of(str(file), (400, 450), 2).weights) == 2
    for separator in (";", "\t", " "):
        file.write_text(f"400{separator}1\r\n500{separator}2\r\n")
        assert read_table(file)[1] == pytest.approx([1, 2])


FORM = {"spectrum": "d65", "band_nm": "450, 650", "bands": 3}
EXPECTED = light_of("d65", (450, 650), 3)


def scene_of(kind: str, tmp_path: Path) -> Any:
    """The same beam from a dict, a text, a file and a prescription."""
    beam = {"type": "collimated", "radius": 1.0, **FORM}
    if kind == "dict":
        return scene_dicts.load(screen=SCREEN, beam=beam)
    if kind == "text":
        return mistray.load("plate", "beam:radius=1,spectrum=d65,band_nm=450 650,bands=3")
    if kind == "xml":
        screen = shape_xml("asphere", "screen", sensor=True, semi_diameter=5.0)
        return mistray.load(write(tmp_path, scene_text(screen, **FORM)))
    spectral = FORM | {"band_nm": (450.0, 650.0)}
    source = Source(radius=1.0, **spectral) if kind == "prescription" else ObjectPoint(distance=500.0, **spectral)
    return replace(build(), source=replace(source, field_deg=1.0)).to_scene()


@pytest.mark.parametrize("kind", ["dict", "text", "xml", "prescription", "near prescription"])
def test_every_form_of_a_source_takes_it(kind: str, tmp_path: Path) -> None:
    scene = scene_of(kind, tmp_path)
    t = mistray.trace(scene, rays=1000)
    assert t.wavelengths_nm == pytest.approx(EXPECTED.wavelengths_nm)
    launched = [t.energy_at(nm).launched_W for nm in t.wavelengths_nm]
    assert np.array(launched) / sum(launched) == pytest.approx(EXPECTED.weights, rel=1e-5)
    lines = [500.0, 700.0, 600.0]
    called = mistray.trace(scene, rays=1000, wavelength_nm=lines, weights=[1, 0, 1])  # come first; of 0 no rays
    assert called.wavelengths_nm == [500.0, 600.0]
    assert called.energy.launched_W == pytest.approx(t.energy.launched_W, rel=1e-6)


def test_bands_add_up_to_the_spectrum(tmp_path: Path) -> None:
    """A black body behind a filter whose transmittance is a straight line: exact with one band and with many."""
    table = tmp_path / "filter.csv"
    rows = [f"{nm},0,0,{(nm - 400) / 300:.6f}" for nm in range(400, 701, 10)]
    table.write_text("wavelength_nm,angle_deg,R,T\n" + "\n".join(rows))
    sheet = {"type": "asphere", "semi_diameter": 3.0, "z": -1.0, "bsdf": {"type": "thinfilm", "table": str(table)}}
    fine = np.linspace(400, 700, 60_001)
    values = planck(fine, 3000.0)
    exact = np.trapezoid(values * (fine - 400) / 300, fine) / np.trapezoid(values, fine)
    for bands in (1, 4):
        beam = {"type": "collimated", "radius": 1.0, "spectrum": "blackbody:3000", "bands": bands}
        energy = mistray.trace(scene_dicts.load(screen=SCREEN, sheet=sheet, beam=beam), rays=500).energy
        assert energy.detected_W / energy.launched_W == pytest.approx(exact, rel=2e-5)


SPECTRA = ("X", "d C X", "", "blackbody", "blackbody:-1", "blackbody:nan", "blackbody:1e308", "blackbody:0", "d d",
           "blackbody:20", "nowhere.csv")  # fmt: skip
WRONG: tuple[dict[str, Any], ...] = vectors.toml("refusals.toml")["spectra"]


@pytest.mark.parametrize("wrong", [*({"spectrum": text} for text in SPECTRA), *WRONG], ids=str)
def test_bad_spectra(wrong: dict[str, Any]) -> None:
    own = dict(wrong)
    for key in {"band_nm", "weights", "wavelength_nm"} & own.keys():
        own[key] = tuple(float(word) for word in str(own[key]).split(","))
    scene = {"type": "scene", "lamp": {"type": "sky", **wrong}}
    each_refused((lambda: mistray.load(scene), "'lamp'"), (lambda: Source(radius=1.0, **own), "source"))

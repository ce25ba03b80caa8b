"""Presets on bodies that they were not made for, against `tmm` and a plain quarter wave."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vectors
from command_line import run, succeeds
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from singlet_files import plano_convex

import mistray
from mistray import MistrayError
from mistray.coatings import PRESETS, Stack, fitted_preset, layer_text, preset, spectrum
from mistray.materials import nearest_known_nm, refractive_index
from mistray.prescription import Coating, Detector, Prescription, Source, Surface

POINTS = 41


def by_tmm(stack: Stack, body: str, low_nm: float, high_nm: float) -> float:
    """Mean R over a band at normal incidence, by the program of S. J. Byrnes."""
    tmm = pytest.importorskip("tmm")
    thickness = [np.inf, *(layer.thickness_nm for layer in stack.layers), np.inf]
    found = []
    for nm in np.linspace(low_nm, high_nm, POINTS):
        n = refractive_index(body, nearest_known_nm(body, nm))
        found.append(tmm.coh_tmm("s", [1.0, *stack.indices(nm), n], thickness, 0.0, nm)["R"])
    return float(np.mean(found))


@pytest.mark.parametrize("name", ["v_coat", "bbar3", "bbar4"])
@pytest.mark.parametrize("body", ["1.45", "1.62", "1.7847", "N-SF6", "1.95"])
def test_on_flints(name: str, body: str) -> None:
    """What is said to be reached is what `tmm` computes, and no more than a quarter wave of MgF2 leaves."""
    found = fitted_preset(name, body)
    assert found.reached == pytest.approx(by_tmm(found.stack, body, found.low_nm, found.high_nm), rel=2e-3)
    assert found.designed == pytest.approx(by_tmm(preset(name), body, found.low_nm, found.high_nm), rel=2e-3)
    assert found.reached <= found.designed
    assert found.reached <= by_tmm(preset("mgf2_quarter_wave"), body, found.low_nm, found.high_nm) + 2e-6


@pytest.mark.parametrize(("name", "body", "most"), vectors.toml("infrared_presets.toml")["rows"])
def test_in_the_infrared(name: str, body: str, most: float) -> None:
    """Residual reflectance by `tmm`, in the mean over 3 to 5 or 8 to 12 µm; bare, these bodies have 17 to 36 %."""
    found = fitted_preset(name, body)
    band = (3000.0, 5000.0) if "mwir" in name else (8000.0, 12000.0)
    assert (found.low_nm, found.high_nm) == pytest.approx(band)
    reached = by_tmm(found.stack, body, *band)
    assert reached <= most
    # k of silicon changes R by less than this
    assert found.reached == pytest.approx(reached, rel=1e-2, abs=1e-6)


def test_a_body_like_that_of_the_design_keeps_it_and_others_are_refused() -> None:
    for name, design in PRESETS.items():
        if design.metal is None:
            found = fitted_preset(name, repr(design.substrate))
            assert not found.changed
            assert found.stack == preset(name)
    for name, body, words in (
        ("zns_lwir", "ZnSe", r"does not suit 'ZnSe': mean R = 1\d.* %"),
        ("bbar3", "Ge", "passes no light from 450 to 650 nm"),
    ):
        with pytest.raises(MistrayError, match=words):
            fitted_preset(name, body)


def test_coat_fits_each_glass_and_says_what_it_reached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene has explicit layers, one coating for each glass; as designed, R would be two to four times as large."""
    file = tmp_path / "coated.xml"
    printed = succeeds(capsys, "coat", "cooke_triplet", "L?_*=bbar3", "-o", file)
    found = {body: fitted_preset("bbar3", body) for body in ("N-LAK9", "N-SF5")}
    for body, one in found.items():
        assert f"note: bbar3 on {body}: {one}" in printed
        assert one.reached < 0.5 * one.designed
    shapes = {shape.id(): shape.bsdf() for shape in mistray.load(file).shapes()}
    for surface, body in (("L1_front", "N-LAK9"), ("L2_rear", "N-SF5")):
        own, wanted = shapes[surface].coating.layers, found[body].stack.layers
        assert [layer.material for layer in own] == [layer.material for layer in wanted]
        thickness = [layer.thickness_nm for layer in wanted]
        assert [layer.thickness_nm for layer in own] == pytest.approx(thickness, rel=1e-6)
    assert shapes["L1_front"].coating is shapes["L3_rear"].coating


def test_waves_are_those_of_invisible_light(tmp_path: Path) -> None:
    """A quarter wave of ZnS on a scene of 8 to 12 µm is one at 10 µm, as the file says."""
    front = shape_xml("asphere", "front", bsdf=interface_xml(back="Ge"), semi_diameter=5.0)
    scene = write(tmp_path, scene_text(front, radius=3.0, wavelength_nm="8000, 9000, 12000"))
    (layer,) = mistray.coat(scene, {"front": "ZnS 0.25w"}).shapes()[0].bsdf().coating.layers
    assert layer.thickness_nm == pytest.approx(2500.0 / refractive_index("ZnS", 10000.0), rel=1e-6)
    (layer,) = mistray.coat(scene, {"front": "ZnS 0.25w design_nm=9000"}).shapes()[0].bsdf().coating.layers
    assert layer.thickness_nm == pytest.approx(2250.0 / refractive_index("ZnS", 9000.0), rel=1e-6)
    zns = mistray.coat(scene, {"front": "zns_lwir"}).shapes()[0].bsdf().coating
    coated = spectrum(zns, [10000.0], [0.0], "air", "Ge")
    # R = ((n₀ nₛ - n²)/(n₀ nₛ + n²))² of a quarter wave
    n = refractive_index("Ge", 10000.0)
    assert coated.mean()[0, 0] == pytest.approx(((n - 4.84) / (n + 4.84)) ** 2, abs=1e-6)


def test_presets_as_designed_are_named_on_other_bodies() -> None:
    """A crown's preset that a scene has on a flint reflects twelve times as much as on a crown; the notes say so."""

    def notes(glass: str, **recipe: Any) -> list[str]:
        lens = Prescription(
            name="lens",
            surfaces=(
                Surface("front", semi_diameter=5.0, back=glass, coating=Coating(**recipe)),
                Surface("rear", z=4.0, semi_diameter=5.0, front=glass),
            ),
            detector=Detector(z=30.0, semi_diameter=9.0),
            source=Source(radius=3.0, wavelength_nm=(550.0,)),
        )
        return [note for note in mistray.trace(lens.to_scene(), rays=16).notes if "as designed" in note]

    (note,) = notes("N-SF6", preset="bbar3")
    assert "bbar3 as designed, for n = 1.517, leaves a mean R of 1.2 % on N-SF6 from 450 to 650 nm" in note
    assert f"{100 * fitted_preset('bbar3', 'N-SF6').designed:.2g} % on N-SF6" in note
    assert notes("N-BK7", preset="bbar3") == notes("N-SF6", preset="mgf2_quarter_wave") == []
    assert notes("N-SF6", layers=layer_text(fitted_preset("bbar3", "N-SF6").stack.layers)) == []
    assert notes("N-SF6", preset="bbar3", design_nm=600.0)[0].count("490.909 to 709.091 nm") == 1


def test_commands_with_a_coating_say_what_it_reached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An import prints it and keeps it in the file; other commands print it on stderr, unless they are to be quiet."""
    note = str(fitted_preset("bbar3", "N-SF6"))
    lens = tmp_path / "lens.zmx"
    lens.write_text(plano_convex("N-SF6 0 0 1.8 25", "SCHOTT", 0.55))
    scene = tmp_path / "lens.xml"
    assert succeeds(capsys, "import", lens, "--coating", "S1=bbar3", "-o", scene).count(note) == 1
    assert note in scene.read_text()
    command = ["ghosts", scene, "--coating", "S2=bbar3", "--rays", "200"]
    for more, times in (((), 1), (("--quiet",), 0)):
        code, _, err = run(capsys, *command, *more)
        assert (code, err.count(note)) == (0, times)

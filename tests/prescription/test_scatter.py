"""Scatter in a prescription: what it refuses, how shapes share it, and the models that a loaded scene has."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import pytest

import mistray
from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Surface, wall
from mistray.scatter.abg import ABg
from mistray.scatter.kinds import KINDS

POLISH = Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish")
ROUGHER = replace(POLISH, properties={"rms_nm": 5.0})
DIRT = Scatter("particulate", {"level": 300.0})
BLACK = Scatter("paint", {"preset": "flat_black"})
GLASS = Coating(R=0.02, T=0.98, name="ar")
LENS = Prescription(
    name="lens",
    surfaces=(
        Surface("L_front", semi_diameter=5.0, back="1.5", coating=GLASS),
        Surface("L_rear", z=2.0, semi_diameter=5.0, front="1.5", coating=GLASS),
    ),
    structures=wall("tube", [(5.0, 2.0), (5.0, 8.0), (4.0, 8.0)]),
    stop=Stop(2.0, 9.0, 9.1, 4.0, 4.0, coating=Coating(R=0.05)),
    detector=Detector(z=10.0, half_width=2.0, half_height=2.0),
    source=Source(radius=2.0),
)
SILVER = {"rms_nm": 2.0, "B_um": 100.0, "slope": 3.0, "substrate": "silver"}
EXAMPLES = {
    "abg": {"A": 1e-3, "B": 1e-3, "g": 2.0},
    "edge_diffraction": {"width_mm": 0.05, "law": "heisenberg"},
    "gaussian_lobe": {"total": 0.01, "width": 0.1},
    "harvey_shack": {"b0": 0.1},
    "k_correlation": SILVER | {"theory": "rayleigh_rice_vector", "substrate": "0.96+6.69i"},
    "paint": {"reflectance": 0.04},
    "particulate": {"coverage_percent": 0.1},
    "phong": {"b0": 0.1, "exponent": 16.0},
    "polynomial": {"c000": -1.0, "l10": -0.7},
    "psd_table": {"file": "polish.csv", "theory": "rayleigh_rice_vector", "substrate": "0.96+6.69i"},
    "tabulated": {"file": "black.bsdf", "beyond": "zero"},
}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("harvey",), "scatter 'harvey': there is no such model; use abg, "),
        (("harvey_shack", {"rms": 4.0}), "scatter 'harvey_shack': there is no 'rms'; did you mean 'rms_nm'"),
        (("abg", {"A": 1.0, "B": 1.0}), "ABg: g is missing"),
        (("abg", {"A": [1.0], "B": 1.0, "g": 2.0}), r"scatter 'abg': A = \[1.0\]; give a number, a text or a boolean"),
        (("k_correlation", SILVER), "scatter 'k_correlation': substrate is 'silver'"),
    ],
)
def test_bad_models(arguments: tuple, words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        Scatter(*arguments)
    with pytest.raises(MistrayError, match=r"shape 'a.b': a name must not"):
        Scatter("paint", {"preset": "flat_black"}, name="a.b")


def test_every_plugin_can_be_written() -> None:
    assert EXAMPLES.keys() == KINDS.keys()
    for kind, properties in EXAMPLES.items():
        model = Scatter(kind, properties).model()
        assert model is None if "file" in properties else isinstance(model, KINDS[kind])


def test_scatter_by_name() -> None:
    """Patterns add up, in their order, to what a shape has."""
    result = LENS.with_scatter({"L_*": (POLISH,), "L_rear": (DIRT,), "tube_?": (BLACK,)})
    found = {shape.name: shape.scatter for shape in result.with_scatter({"stop_*": (BLACK, DIRT)}).shapes()}
    stop = dict.fromkeys(("stop_front", "stop_wall", "stop_rear"), (BLACK, DIRT))
    tube = dict.fromkeys(("tube_1", "tube_2"), (BLACK,))
    assert found == {"L_front": (POLISH,), "L_rear": (POLISH, DIRT), **tube, **stop, "detector": ()}
    assert result.shared_scatter() == {"polish": POLISH}
    assert not any(shape.scatter for shape in LENS.shapes())


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        ({"M_*": (POLISH,)}, r"prescription 'lens': no shape is called 'M_\*'"),
        ({"stop_wall": (BLACK,)}, "matches some faces of stop 'stop'"),
        ({"L_front": (POLISH,), "L_rear": (ROUGHER,)}, "two different scatter models are called 'polish'"),
        ({"L_front": (replace(POLISH, name="L_rear"),)}, "a shape and a scatter model are called 'L_rear'"),
        ({"L_front": (replace(POLISH, name="ar"),)}, "a coating and a scatter model are called 'ar'"),
    ],
)
def test_names_that_do_not_fit(rules: dict[str, tuple[Scatter, ...]], words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        LENS.with_scatter(rules)


def test_the_scene_has_the_models(tmp_path) -> None:
    """From the dictionary and from the file; a named model is one object with one key."""
    abg = Scatter("abg", {"A": 0.0009765625, "B": 0.0078125, "g": 2.0, "side": "back"})  # exact in float32
    scattering = LENS.with_scatter({"L_*": (POLISH, DIRT), "L_rear": (abg,), "tube_*": (BLACK,)})
    scattering.to_xml(tmp_path / "scene.xml")
    for scene in (scattering.to_scene(), mistray.load(tmp_path / "scene.xml")):
        scatter = {shape.id(): shape.bsdf().scatter for shape in scene.shapes()}
        assert [type(model) for model in scatter["L_rear"]] == [KINDS[model.kind] for model in (POLISH, DIRT, abg)]
        assert replace(scatter["L_rear"][2], name="") == ABg(0.0009765625, 0.0078125, 2.0, side="back")
        assert scatter["L_front"][0] == scatter["L_rear"][0]
        assert [model.reflectance for model in scatter["tube_2"]] == pytest.approx([0.045])
        assert scatter["stop_wall"] == ()
        assert [key for key in dict(mi.traverse(scene)) if "rms_nm" in key] == ["polish.rms_nm"]

"""Scatter in a prescription: what it refuses, how shapes share it, and the models that a loaded scene has."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Surface, wall
from mistray.scatter.abg import ABg
from mistray.scatter.kinds import KINDS

POLISH = Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish")
DIRT = Scatter("particulate", {"level": 300.0})
BLACK = Scatter("paint", {"preset": "flat_black"})
GLASS = Coating(R=0.02, T=0.98)


@pytest.fixture
def lens() -> Prescription:
    return Prescription(
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("harvey",), "scatter 'harvey': there is no such model; use abg, "),
        (("harvey_shack",), "HarveyShack: neither of b0 and rms_nm given"),
        (("harvey_shack", {"rms": 4.0}), "scatter 'harvey_shack': there is no 'rms'; did you mean 'rms_nm'"),
        (("abg", {"A": 1.0, "B": 1.0}), "ABg: g is missing"),
        (("abg", {"A": 1.0, "B": 0.0, "g": 2.0}), "ABg: B is 0"),
        (("abg", {"A": [1.0], "B": 1.0, "g": 2.0}), r"scatter 'abg': A = \[1.0\]; give a number, a text or a boolean"),
        (("paint", {"preset": "flat_blak"}), "did you mean 'flat_black'?"),
        (
            ("k_correlation", {"rms_nm": 2.0, "B_um": 100.0, "slope": 3.0, "substrate": "silver"}),
            "scatter 'k_correlation': substrate is 'silver'",
        ),
        (("tabulated",), "Tabulated: file is missing"),
    ],
)
def test_bad_models(arguments: tuple, words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        Scatter(*arguments)


def test_a_name_must_fit_the_scene() -> None:
    with pytest.raises(MistrayError, match=r"shape 'a.b': a name must not"):
        Scatter("paint", {"preset": "flat_black"}, name="a.b")


def test_every_plugin_can_be_written() -> None:
    examples = {
        "abg": {"A": 1e-3, "B": 1e-3, "g": 2.0},
        "edge_diffraction": {"width_mm": 0.05, "law": "heisenberg"},
        "gaussian_lobe": {"total": 0.01, "width": 0.1},
        "harvey_shack": {"b0": 0.1},
        "k_correlation": {
            "rms_nm": 1.0,
            "B_um": 5.0,
            "slope": 3.0,
            "theory": "rayleigh_rice_vector",
            "substrate": "0.96+6.69i",
        },
        "paint": {"reflectance": 0.04},
        "particulate": {"coverage_percent": 0.1},
        "phong": {"b0": 0.1, "exponent": 16.0},
        "polynomial": {"c000": -1.0, "l10": -0.7},
        "psd_table": {"file": "polish.csv", "theory": "rayleigh_rice_vector", "substrate": "0.96+6.69i"},
        "tabulated": {"file": "black.bsdf", "beyond": "zero"},
    }
    assert examples.keys() == KINDS.keys()
    for kind, properties in examples.items():
        model = Scatter(kind, properties).model()
        assert model is None if "file" in properties else isinstance(model, KINDS[kind])


def test_scatter_by_name(lens: Prescription) -> None:
    """Patterns add up, in their order, to what a shape has."""
    result = lens.with_scatter({"L_*": (POLISH,), "L_rear": (DIRT,), "tube_?": (BLACK,)}).with_scatter(
        {"stop_*": (BLACK, DIRT)}
    )
    assert {shape.name: shape.scatter for shape in result.shapes()} == {
        "L_front": (POLISH,),
        "L_rear": (POLISH, DIRT),
        "tube_1": (BLACK,),
        "tube_2": (BLACK,),
        "stop_front": (BLACK, DIRT),
        "stop_wall": (BLACK, DIRT),
        "stop_rear": (BLACK, DIRT),
        "detector": (),
    }
    assert result.shared_scatter() == {"polish": POLISH}
    assert not any(shape.scatter for shape in lens.shapes())
    with pytest.raises(MistrayError, match=r"prescription 'lens': no shape is called 'M_\*'"):
        lens.with_scatter({"M_*": (POLISH,)})
    with pytest.raises(MistrayError, match="matches some faces of stop 'stop'"):
        lens.with_scatter({"stop_wall": (BLACK,)})


def test_shared_scatter_is_one(lens: Prescription) -> None:
    other = replace(POLISH, properties={"rms_nm": 5.0})
    with pytest.raises(MistrayError, match="two different scatter models are called 'polish', that of 'L_rear' is one"):
        lens.with_scatter({"L_front": (POLISH,), "L_rear": (other,)})
    with pytest.raises(MistrayError, match="a shape and a scatter model are called 'L_rear'"):
        lens.with_scatter({"L_front": (replace(POLISH, name="L_rear"),)})
    named = replace(lens, surfaces=tuple(replace(s, coating=replace(GLASS, name="ar")) for s in lens.surfaces))
    with pytest.raises(MistrayError, match="a coating and a scatter model are called 'ar'"):
        named.with_scatter({"L_front": (replace(POLISH, name="ar"),)})


def test_the_scene_has_the_models(lens: Prescription, tmp_path) -> None:
    """From the dictionary and from the file; a named model is one object with one key."""
    import mitsuba as mi

    import mistray

    abg = Scatter("abg", {"A": 0.0009765625, "B": 0.0078125, "g": 2.0, "side": "back"})  # exact in float32
    scattering = lens.with_scatter({"L_*": (POLISH, DIRT), "L_rear": (abg,), "tube_*": (BLACK,)})
    scattering.to_xml(tmp_path / "scene.xml")
    for scene in (scattering.to_scene(), mistray.load(tmp_path / "scene.xml")):
        bsdfs = {shape.id(): shape.bsdf() for shape in scene.shapes()}
        kinds = [type(model) for model in bsdfs["L_rear"].scatter]
        assert kinds == [KINDS[kind] for kind in ("harvey_shack", "particulate", "abg")]
        found = bsdfs["L_rear"].scatter[2]
        assert replace(found, name="") == ABg(0.0009765625, 0.0078125, 2.0, side="back")
        assert bsdfs["L_front"].scatter[0] == bsdfs["L_rear"].scatter[0]
        assert [model.reflectance for model in bsdfs["tube_2"].scatter] == pytest.approx([0.045])
        assert bsdfs["stop_wall"].scatter == ()
        assert [key for key in dict(mi.traverse(scene)) if "rms_nm" in key] == ["polish.rms_nm"]

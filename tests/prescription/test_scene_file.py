"""One tree of nodes, two forms: the dictionary and the XML file hold the same scene, with its models of scatter."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors

import mistray
from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Structure, Surface, wall
from mistray.scatter.abg import ABg
from mistray.scatter.kinds import OWN_KINDS


def assert_same(first: Any, second: Any) -> None:
    assert [shape.id() for shape in first.shapes()] == [shape.id() for shape in second.shapes()]
    a, b = mi.traverse(first), mi.traverse(second)
    assert list(a.keys()) == list(b.keys())
    for key in list(a.keys()):
        np.testing.assert_array_equal(np.array(a[key]), np.array(b[key]), err_msg=key)
    for one, other in zip(first.shapes(), second.shapes(), strict=True):
        assert str(one.bsdf()) == str(other.bsdf())
        assert [(one.part, one.space), str(one)] == [(other.part, other.space), str(other)]
    for one, other in zip(first.emitters(), second.emitters(), strict=True):
        assert str(one) == str(other)


SAMPLE = str(Path(__file__).parents[1] / "data" / "coating_sample.dat")
LAYERS = {"layers": "1.38 99.6, 2.1 0.5w", "design_nm": 1 / 2e-3, "n_shift": (0.01, 0.0), "k_shift": (0.0, 1e-3)}
AR = Coating(**LAYERS, name="ar")
ABG = Scatter("abg", {"A": 1e-5, "B": 1 / 3e5, "g": 2.0, "event": "reflection"})
POLISH = Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish")
BLACK = Scatter("paint", {"preset": "flat_black"})
DIRT = Scatter("particulate", {"level": 300.0}, name="dirt")
K_CORRELATION = Scatter("k_correlation", {"rms_nm": 1.0, "B_um": 10.0, "slope": 1.8, "band_limited": True})
SYSTEM = Prescription(
    name="all <parameters> -- & more",
    provenance="first line\nsecond -- line",
    surfaces=(
        Surface("L1_front", z=0.1, radius=1.679, conic=0.22669364, coefficients=(0.00980281, 0.0, -0.0239681),
                semi_diameter=1.2, inner_semi_diameter=0.1, back="nd=1.544 Vd=56.1 k=0",
                coating=Coating(R=0.02, T=0.98), part="L1", space=3),
        Surface("fold", x=1e-7, y=-2.0, z=1 / 3, tilt_deg=(45.0, 0.5, -90.0), half_width=1.0, half_height=2.0,
                coating=Coating(R=1.0), mirror=True),
        Surface("bare", z=2.0, semi_diameter=1.0, front="nd=1.544 Vd=56.1 k=0", back="1.7"),
        Surface("layered", z=3.5, semi_diameter=1.0, front="1.7", coating=Coating(**LAYERS, first="back")),
        Surface("preset", z=3.7, semi_diameter=1.0, coating=Coating(preset="protected_al"), mirror=True),
        Surface("shared_1", z=4.0, semi_diameter=1.0, back="1.5", coating=AR),
        Surface("shared_2", z=4.5, semi_diameter=1.0, front="1.5", coating=AR),
        Surface("zemax", z=4.8, semi_diameter=1.0, coating=Coating(table=f"{SAMPLE}:AR")),
        Surface("split", z=5.0, semi_diameter=1.0, coating=Coating(R=0.1, T=0.8, name="split_coating")),
        Surface("scattering", z=5.3, semi_diameter=1.0, coating=Coating(preset="bbar3"),
                scatter=(ABG, K_CORRELATION, POLISH, DIRT)),
    ),
    structures=(Structure("edge", 1.0, 2.0, 1.0, 3.0, front="1.7", y=0.5, tilt_deg=(90.0, 0.0, 0.0), space=0),),
    stop=Stop(0.5, -0.2, -0.1, 1.5, 1.6, coating=Coating(R=0.07), scatter=(BLACK,)),
    detector=Detector(z=5.7, half_width=2.0, half_height=1.5, coating=Coating(R=0.2), pixels=(40, 30)),
    source=Source(y=0.1, tilt_deg=(0.0, 180.0, 0.0), radius=1.252, inner_radius=0.3, field_deg=10.0, azimuth_deg=30.0,
                  plane="axis", distance=12.0, irradiance=2.0, wavelength_nm=(486.1, 587.6), weights=(1.0, 2.0),
                  pattern="grid"),
)  # fmt: skip


def test_dictionary_and_file_load_to_the_same_scene(tmp_path):
    SYSTEM.to_xml(tmp_path / "scene.xml")
    scenes = [SYSTEM.to_scene(), mistray.load(tmp_path / "scene.xml")]
    assert_same(*scenes)
    for scene in scenes:
        shapes = {shape.id(): shape for shape in scene.shapes()}
        coatings = {name: shape.bsdf().coating for name, shape in shapes.items()}
        assert coatings["shared_1"] is coatings["shared_2"]
        assert coatings["shared_1"].indices(500.0) == pytest.approx((1.39, 2.1 + 1e-3j), rel=1e-7)
        assert coatings["layered"].first == "back"
        assert (shapes["L1_front"].part, shapes["L1_front"].space) == ("L1", 3)
        kinds = [type(model).__name__ for model in shapes["scattering"].bsdf().scatter]
        assert kinds == ["ABg", "KCorrelation", "HarveyShack", "Particulate"]
        assert [name for name in shapes if name.startswith("stop")] == ["stop_front", "stop_wall", "stop_rear"]
        films = {key.rpartition(".")[0] for key in dict(mi.traverse(scene)) if key.endswith("thickness_nm")}
        assert films == {"ar", *(f"{name}.bsdf.coating" for name in ("layered", "preset", "scattering", "zemax"))}


def test_file_is_readable_and_the_same_each_time(tmp_path):
    """Numbers survive to the last bit; where nothing can be written no file is left."""
    path, wrong = tmp_path / "scene.xml", SYSTEM.with_source(field_deg=float("nan"))
    for system, target, words in ((SYSTEM, tmp_path / "missing" / "a.xml", "check the folder"), (wrong, path, "nan")):
        with pytest.raises(MistrayError, match=words):
            system.to_xml(target)
    assert not list(tmp_path.iterdir())
    SYSTEM.to_xml(path)
    first = path.read_bytes()
    SYSTEM.to_xml(path)
    assert path.read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["scene.xml"]
    root = ElementTree.fromstring(first)
    assert root.get("version") == "3.0.0"
    assert float(root.find("./shape[@id='fold']/transform/translate").get("z")) == 1 / 3
    for comment in ("second - - line", "<!-- Optical surfaces -->", "<!-- Structure -->", "<!-- Detector -->"):
        assert comment in first.decode()


ROUGHER = replace(POLISH, properties={"rms_nm": 5.0})
DUST = Scatter("particulate", {"level": 300.0})
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
EXAMPLES = vectors.toml("scatter_examples.toml")


def test_bad_models() -> None:
    for arguments, words in (
        (("harvey",), "scatter 'harvey': there is no such model; use abg, "),
        (("harvey_shack", {"rms": 4.0}), "scatter 'harvey_shack': there is no 'rms'; did you mean 'rms_nm'"),
        (("abg", {"A": 1.0, "B": 1.0}), "ABg: g is missing"),
        (("abg", {"A": [1.0], "B": 1.0, "g": 2.0}), r"scatter 'abg': A = \[1.0\]; give a number, a text or a boolean"),
        (("k_correlation", SILVER), "scatter 'k_correlation': substrate is 'silver'"),
    ):
        with pytest.raises(MistrayError, match=words):
            Scatter(*arguments)
    with pytest.raises(MistrayError, match=r"shape 'a.b': a name must not"):
        Scatter("paint", {"preset": "flat_black"}, name="a.b")
    for rules, words in (
        ({"M_*": (POLISH,)}, r"prescription 'lens': no shape is called 'M_\*'"),
        ({"stop_wall": (BLACK,)}, "matches some faces of stop 'stop'"),
        ({"L_front": (POLISH,), "L_rear": (ROUGHER,)}, "two different scatter models are called 'polish'"),
        ({"L_front": (replace(POLISH, name="L_rear"),)}, "a shape and a scatter model are called 'L_rear'"),
        ({"L_front": (replace(POLISH, name="ar"),)}, "a coating and a scatter model are called 'ar'"),
    ):
        with pytest.raises(MistrayError, match=words):
            LENS.with_scatter(rules)


def test_scatter_by_name() -> None:
    """Every plugin can be written; patterns add up, in their order, to what a shape has."""
    assert EXAMPLES.keys() == OWN_KINDS.keys()
    for kind, properties in EXAMPLES.items():
        model = Scatter(kind, properties).model()
        assert model is None if "file" in properties else isinstance(model, OWN_KINDS[kind])
    result = LENS.with_scatter({"L_*": (POLISH,), "L_rear": (DUST,), "tube_?": (BLACK,)})
    found = {shape.name: shape.scatter for shape in result.with_scatter({"stop_*": (BLACK, DUST)}).shapes()}
    stop = dict.fromkeys(("stop_front", "stop_wall", "stop_rear"), (BLACK, DUST))
    tube = dict.fromkeys(("tube_1", "tube_2"), (BLACK,))
    assert found == {"L_front": (POLISH,), "L_rear": (POLISH, DUST), **tube, **stop, "detector": ()}
    assert result.shared_scatter() == {"polish": POLISH}
    assert not any(shape.scatter for shape in LENS.shapes())


def test_the_scene_has_the_models(tmp_path) -> None:
    """From the dictionary and from the file; a named model is one object with one key."""
    abg = Scatter("abg", {"A": 0.0009765625, "B": 0.0078125, "g": 2.0, "side": "back"})  # exact in float32
    scattering = LENS.with_scatter({"L_*": (POLISH, DUST), "L_rear": (abg,), "tube_*": (BLACK,)})
    scattering.to_xml(tmp_path / "scene.xml")
    for scene in (scattering.to_scene(), mistray.load(tmp_path / "scene.xml")):
        scatter = {shape.id(): shape.bsdf().scatter for shape in scene.shapes()}
        assert [type(model) for model in scatter["L_rear"]] == [OWN_KINDS[model.kind] for model in (POLISH, DUST, abg)]
        assert replace(scatter["L_rear"][2], name="") == ABg(0.0009765625, 0.0078125, 2.0, side="back")
        assert scatter["L_front"][0] == scatter["L_rear"][0]
        assert [model.reflectance for model in scatter["tube_2"]] == pytest.approx([0.045])
        assert scatter["stop_wall"] == ()
        assert [key for key in dict(mi.traverse(scene)) if "rms_nm" in key] == ["polish.rms_nm"]

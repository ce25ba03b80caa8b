"""One tree of nodes, two forms: the dictionary and the XML file hold the same scene."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mitsuba as mi
import pytest
from same_scenes import assert_same

import mistray
from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Structure, Surface

SAMPLE = str(Path(__file__).parents[1] / "data" / "coating_sample.dat")
LAYERS = {"layers": "1.38 99.6, 2.1 0.5w", "design_nm": 1 / 2e-3, "n_shift": (0.01, 0.0), "k_shift": (0.0, 1e-3)}
AR = Coating(**LAYERS, name="ar")
ABG = Scatter("abg", {"A": 1e-5, "B": 1 / 3e5, "g": 2.0, "event": "reflection"})
POLISH = Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish")
BLACK = Scatter("paint", {"preset": "flat_black"})
DIRT = Scatter("particulate", {"level": 300.0}, name="dirt")
K_CORRELATION = Scatter("k_correlation", {"rms_nm": 1.0, "B_um": 10.0, "slope": 1.8, "band_limited": True})
# Every parameter of every part is set
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
    """A named coating is one object with one key."""
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
    """Numbers survive to the last bit."""
    path = tmp_path / "scene.xml"
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


def test_bad_targets(tmp_path):
    with pytest.raises(MistrayError, match="check the folder"):
        SYSTEM.to_xml(tmp_path / "missing" / "scene.xml")
    with pytest.raises(MistrayError, match="nan cannot be written"):
        SYSTEM.with_source(field_deg=float("nan")).to_xml(tmp_path / "scene.xml")
    assert not list(tmp_path.iterdir())

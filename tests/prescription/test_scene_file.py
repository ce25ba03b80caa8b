"""One tree of nodes, two forms: the dictionary and the XML file hold the same scene."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Structure, Surface
from mistray.prescription.scene_file import scene_dict, xml_text

READ = {"float": float, "integer": int, "string": str, "boolean": lambda text: text == "true"}


@pytest.fixture
def everything():
    """A prescription in which every parameter of every part is set."""
    return Prescription(
        name="all <parameters> -- & more",
        provenance="first line\nsecond -- line",
        surfaces=(
            Surface(
                "L1_front",
                z=0.1,
                radius=1.679,
                conic=0.22669364,
                coefficients=(0.00980281, 0.0, -0.0239681),
                semi_diameter=1.2,
                inner_semi_diameter=0.1,
                back="nd=1.544 Vd=56.1",
                coating=Coating(R=0.02, T=0.98),
                part="L1",
                space=3,
            ),
            Surface(
                "fold",
                x=1e-7,
                y=-2.0,
                z=1 / 3,
                tilt_deg=(45.0, 0.5, -90.0),
                half_width=1.0,
                half_height=2.0,
                coating=Coating(R=1.0),
                mirror=True,
            ),
            Surface("coated", z=2.0, semi_diameter=1.0, front="N-BK7", back="1.7", coating=Coating(table="ar.csv")),
            Surface("bare", z=3.0, semi_diameter=1.0, front="1.7"),
            Surface(
                "layered",
                z=3.5,
                semi_diameter=1.0,
                coating=Coating(
                    layers="1.38 99.6, 2.1 0.5w",
                    first="back",
                    design_nm=1 / 3e-3,
                    n_shift=(0.1, 0.0),
                    k_shift=(0.0, 1e-3),
                ),
            ),
            Surface("preset", z=3.7, semi_diameter=1.0, coating=Coating(preset="bbar3")),
            Surface("shared_1", z=4.0, semi_diameter=1.0, back="1.5", coating=Coating(preset="v_coat", name="ar")),
            Surface("shared_2", z=4.5, semi_diameter=1.0, front="1.5", coating=Coating(preset="v_coat", name="ar")),
            Surface("zemax", z=4.8, semi_diameter=1.0, coating=Coating(table="COATING.DAT:AR")),
            Surface("split", z=5.0, semi_diameter=1.0, coating=Coating(R=0.1, T=0.8, name="split_coating")),
            Surface(
                "scattering",
                z=5.3,
                semi_diameter=1.0,
                coating=Coating(preset="bbar3"),
                scatter=(
                    Scatter("abg", {"A": 1e-5, "B": 1 / 3e5, "g": 2.0, "event": "reflection"}),
                    Scatter("k_correlation", {"rms_nm": 1.0, "B_um": 10.0, "slope": 1.8, "band_limited": True}),
                    Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish"),
                    Scatter("particulate", {"level": 300.0}, name="dirt"),
                ),
            ),
        ),
        structures=(Structure("edge", 1.0, 2.0, 1.0, 3.0, front="1.7", y=0.5, tilt_deg=(90.0, 0.0, 0.0), space=0),),
        stop=Stop(
            0.5, -0.2, -0.1, 1.5, 1.6, coating=Coating(R=0.07), scatter=(Scatter("paint", {"preset": "flat_black"}),)
        ),
        detector=Detector(z=5.7, half_width=2.0, half_height=1.5, coating=Coating(R=0.2), pixels=(40, 30)),
        source=Source(
            y=0.1,
            tilt_deg=(0.0, 180.0, 0.0),
            radius=1.252,
            inner_radius=0.3,
            field_deg=10.0,
            azimuth_deg=30.0,
            plane="axis",
            distance=12.0,
            irradiance=2.0,
            wavelength_nm=(486.1, 587.6),
            weights=(1.0, 2.0),
            pattern="grid",
        ),
    )


def from_xml(element):
    """The dictionary form of an XML element, with to_world as a (4, 4) array."""
    if element.tag == "ref":
        return {"type": "ref", "id": element.get("id")}
    result = {"type": element.get("type")}
    for child in element:
        if child.tag in READ:
            result[child.get("name")] = READ[child.tag](child.get("value"))
        elif child.tag == "transform":
            matrix = np.eye(4)
            for step in child:
                matrix = transform(step) @ matrix
            result[child.get("name")] = matrix
        else:
            number = sum(key == child.tag or key.startswith(f"{child.tag}_") for key in result) + 1
            result[child.tag if number == 1 else f"{child.tag}_{number}"] = from_xml(child)
    return result


def transform(step):
    values = {axis: float(step.get(axis, 0)) for axis in "xyz"}
    matrix = np.eye(4)
    if step.tag == "translate":
        matrix[:3, 3] = [values[axis] for axis in "xyz"]
        return matrix
    from scipy.spatial.transform import Rotation

    (axis,) = (axis for axis in "xyz" if values[axis])
    matrix[:3, :3] = Rotation.from_euler(axis, float(step.get("angle")), degrees=True).as_matrix()
    return matrix


def same(a, b, path=""):
    assert a.keys() == b.keys(), path
    for key, value in a.items():
        here = f"{path}/{key}"
        if isinstance(value, dict):
            same(value, b[key], here)
        elif key == "to_world":
            np.testing.assert_allclose(matrix(value), matrix(b[key]), rtol=1e-14, atol=1e-15, err_msg=here)
        else:
            assert value == b[key], here
            assert type(value) is type(b[key]), here


def matrix(value):
    return value if isinstance(value, np.ndarray) else np.array(value.matrix, dtype=float).reshape(4, 4)


def test_dictionary_and_xml_hold_the_same(everything):
    root = ElementTree.fromstring(xml_text(everything))
    assert root.get("version") == "3.0.0"
    read = {"type": "scene"} | {child.get("id"): from_xml(child) for child in root}
    written = scene_dict(everything)
    assert list(read) == list(written)
    same(written, read)
    assert set(written["L1_front"]) == {
        "type", "radius", "conic", "a4", "a8", "semi_diameter", "inner_semi_diameter", "part", "space", "to_world",
        "bsdf",
    }  # fmt: skip
    assert written["detector"]["sensor"]["film"]["width"] == 40
    assert written["fold"]["bsdf"] == {"type": "interface", "R": 1.0, "mirror": True}
    assert written["layered"]["bsdf"]["bsdf"] == {
        "type": "thinfilm", "layers": "1.38 99.6, 2.1 0.5w", "first": "back", "design_nm": 1 / 3e-3,
        "n_shift": "0.1, 0.0", "k_shift": "0.0, 0.001",
    }  # fmt: skip
    assert written["preset"]["bsdf"]["bsdf"] == {"type": "thinfilm", "preset": "bbar3"}
    assert written["ar"] == {"type": "thinfilm", "preset": "v_coat"}
    assert written["split_coating"] == {"type": "thinfilm", "R": 0.1, "T": 0.8}
    for name in ("shared_1", "shared_2"):
        assert written[name]["bsdf"]["ref"] == {"type": "ref", "id": "ar"}
    assert written["zemax"]["bsdf"]["bsdf"] == {"type": "thinfilm", "table": "COATING.DAT:AR"}
    assert written["source"]["wavelength_nm"] == "486.1, 587.6"
    scattering = written["scattering"]["bsdf"]
    assert list(scattering) == ["type", "bsdf", "bsdf_2", "bsdf_3", "ref", "ref_2"]
    assert scattering["bsdf_2"] == {"type": "abg", "A": 1e-5, "B": 1 / 3e5, "g": 2.0, "event": "reflection"}
    assert scattering["bsdf_3"]["band_limited"] is True
    assert scattering["ref_2"] == {"type": "ref", "id": "dirt"}
    assert written["polish"] == {"type": "harvey_shack", "rms_nm": 4.0}
    assert written["dirt"] == {"type": "particulate", "level": 300.0}
    assert written["stop_wall"]["bsdf"]["bsdf"] == {"type": "paint", "preset": "flat_black"}
    assert [key for key in written if key.startswith("stop")] == ["stop_front", "stop_wall", "stop_rear"]


def test_numbers_survive_to_the_last_bit(everything):
    root = ElementTree.fromstring(xml_text(everything))
    z = root.find("./shape[@id='fold']/transform/translate").get("z")
    assert float(z) == 1 / 3


def test_file_is_readable_and_the_same_each_time(everything, tmp_path):
    path = tmp_path / "scene.xml"
    everything.to_xml(path)
    first = path.read_bytes()
    everything.to_xml(path)
    assert path.read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["scene.xml"]
    text = first.decode()
    for comment in ("second - - line", "<!-- Optical surfaces -->", "<!-- Structure -->", "<!-- Detector -->"):
        assert comment in text


def test_bad_targets(everything, tmp_path):
    with pytest.raises(MistrayError, match="check the folder"):
        everything.to_xml(tmp_path / "missing" / "scene.xml")
    infinite = Prescription(
        name="x",
        surfaces=(),
        detector=everything.detector,
        source=Source(radius=1.0, field_deg=float("nan")),
    )
    with pytest.raises(MistrayError, match="nan cannot be written"):
        infinite.to_xml(tmp_path / "scene.xml")
    assert not list(tmp_path.iterdir())


def test_both_forms_load_to_the_same_coatings(tmp_path):
    """Dictionary and file give the same coatings; a named one is one object with one key."""
    import mitsuba as mi

    import mistray

    ar = Coating(layers="1.38 99.6, 2.1 0.5w", design_nm=500.0, n_shift=(0.01, 0.0), name="ar")
    system = Prescription(
        name="coated",
        surfaces=(
            Surface("front", semi_diameter=2.0, back="1.5", coating=ar),
            Surface("rear", z=1.0, semi_diameter=2.0, front="1.5", coating=ar),
            Surface("mirror", z=3.0, semi_diameter=2.0, coating=Coating(preset="protected_al"), mirror=True),
        ),
        detector=Detector(z=5.0, half_width=2.0, half_height=2.0),
        source=Source(radius=1.0),
    )
    system.to_xml(tmp_path / "scene.xml")
    scenes = [system.to_scene(), mistray.load(tmp_path / "scene.xml")]
    coatings = [[shape.bsdf().coating for shape in scene.shapes()] for scene in scenes]
    assert coatings[0] == coatings[1]
    assert coatings[0][0] is coatings[0][1]
    assert coatings[0][0].indices(500.0) == pytest.approx((1.39, 2.1), rel=1e-7)
    for scene in scenes:
        keys = [key for key in mi.traverse(scene).keys() if key.endswith("thickness_nm")]  # noqa: SIM118
        assert keys == ["ar.thickness_nm", "mirror.bsdf.coating.thickness_nm"]

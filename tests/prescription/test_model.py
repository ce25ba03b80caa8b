"""Parts of a prescription: what they refuse, which coatings are opaque, and how shapes stand."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Source, Stop, Structure, Surface

pytestmark = pytest.mark.quick
DETECTOR = Detector(z=20.0, half_width=1.0, half_height=1.0)
SOURCE = Source(radius=1.0)
AR = Coating(preset="bbar3", name="ar")


def system(*surfaces, **more):
    return Prescription(name="test", surfaces=surfaces, **({"detector": DETECTOR, "source": SOURCE} | more))


def lens(z=0.0, radius=50.0, front=None, rear=None):
    return (
        Surface("L1_front", z=z, radius=radius, semi_diameter=5.0, back="1.5", coating=front),
        Surface("L1_rear", z=z + 2.0, radius=-radius, semi_diameter=5.0, front="1.5", coating=rear),
    )


def message(function, *arguments, **keywords):
    with pytest.raises(MistrayError) as caught:
        function(*arguments, **keywords)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_bad_parts():
    for part, values, wanted in (
        (Surface, {"semi_diameter": -5.0}, "surface 'x': semi_diameter is -5; it must lie between 1e-15 and 1e12 mm"),
        (Surface, {"half_width": 1.0}, "give either semi_diameter, both half sizes or an outline"),
        (
            Surface,
            {"semi_diameter": 1.0, "inner_semi_diameter": 1.0},
            "between 0 and 1 mm, 1 excluded",
        ),
        (Surface, {"semi_diameter": 1.0, "coefficients": (0.0,) * 10}, "at most 9"),
        (Surface, {"half_width": 1.5, "half_height": 1.5, "radius": 2.0}, "2.12132 mm; its conic ends at 2 mm"),
        (Coating, {}, "coating 'x': it has no recipe; give one of R (and T), table, layers and preset"),
        (Coating, {"R": 0.1, "table": "x.csv"}, "it has R = 0.1 and table = 'x.csv'; give one of"),
        (Coating, {"R": 0.6, "T": 0.5}, "coating 'x': R = 0.6 and T = 0.5; both must lie in 0 … 1 and R + T must"),
        (Coating, {"table": "x.csv", "T": 0.1}, "T = 0.1 beside table = 'x.csv', which already holds T"),
        (Coating, {"preset": "bbar9"}, "coating preset 'bbar9' is unknown; did you mean 'bbar4'?"),
        (Coating, {"layers": "1.38 10", "design_nm": 0.0}, "design_nm is 0; it must lie between 10 and 1e7 nm"),
        (Coating, {"layers": "1.38 10", "first": "top"}, "first is 'top'; choose from outside, front, back"),
        (Coating, {"R": 0.1, "first": "front"}, "coating 'x': first has no meaning beside R, which has no layers"),
        (Coating, {"R": 0.1, "name": "a.b"}, "must not be empty or hold a dot"),
        (Structure, {"r0": 1.0, "z0": 0.0, "r1": -1.0, "z1": 1.0}, "structure 'x': r1 is -1; it must lie between 0"),
        (Structure, {"r0": 1.0, "z0": 0.0, "r1": 1.0, "z1": 0.0}, "no area"),
        (Detector, {"half_width": 1.0, "half_height": 1.0, "pixels": (0, 5)}, "pixels is 0; it must be a whole number"),
        (Source, {}, "give either radius or both half sizes"),
        (Source, {"radius": -1.0}, "radius is -1"),
        (Source, {"radius": 1.0, "irradiance": 0.0}, "irradiance is 0"),
        (Source, {"radius": 1.0, "inner_radius": 1.0}, "inner_radius is 1"),
        (Source, {"radius": 1.0, "pupil_area": -1.0}, "pupil_area is -1"),
        (Source, {"radius": 1.0, "plane": "pupil"}, "choose from beam, axis"),
        (Source, {"radius": 1.0, "pattern": "hex"}, "choose from random, grid"),
        (Source, {"radius": 1.0, "wavelength_nm": ()}, "at least one"),
        (Source, {"radius": 1.0, "wavelength_nm": (500.0, 600.0), "weights": (1.0,)}, "1 weights for 2"),
        (Prescription, {"surfaces": (), "detector": ("detector", 50.0)}, "'x': detector is a tuple"),
        (Prescription, {"surfaces": (*lens(), *lens(z=10.0))}, "2 shapes are called 'L1_front'"),
        (Prescription, {"surfaces": (*lens(), Surface("s", z=2.0, radius=-50.0, semi_diameter=3.0))}, "coincide"),
        (Prescription, {"surfaces": (Surface("s", z=20.0, semi_diameter=3.0),), "detector": DETECTOR}, "coincide"),
        (Prescription, {"surfaces": lens(front=AR, rear=replace(AR, preset="bbar4"))}, "coatings are called 'ar'"),
        (Prescription, {"surfaces": lens(front=replace(AR, name="L1_rear"))}, "a shape and a coating are called"),
    ):
        assert wanted in message(part, **({} if part is Source else {"name": "x"}) | values)


def test_which_coatings_have_layers_and_are_opaque():
    kinds = [
        ({"R": 0.1}, False, True),
        ({"R": 0.1, "T": 0.1}, False, False),
        ({"table": "a.csv"}, False, False),
        ({"table": "COATING.DAT:AR"}, True, False),
        ({"preset": "bbar3"}, True, False),
        ({"preset": "protected_al"}, True, True),
        ({"layers": "1.38 10"}, True, False),
    ]
    for recipe, layered, opaque in kinds:
        assert (Coating(**recipe).layered, Coating(**recipe).opaque) == (layered, opaque), recipe
    assert system(*lens(front=AR, rear=AR)).shared_coatings() == {"ar": AR}


def test_surfaces_that_cross():
    """Two spheres whose sags add up to the thickness; rings of a telescope that share no radius may stand so."""
    front = Surface("front", radius=10.0, semi_diameter=6.0, back="1.5")
    rear = Surface("rear", z=2.0, radius=-10.0, semi_diameter=6.0, front="1.5")
    at = re.search(r"'front' and 'rear' cross at r = ([\d.]+) mm", message(system, front, rear))
    assert float(at[1]) == pytest.approx(math.sqrt(10**2 - 9**2), rel=0.003)  # to the spacing of the samples
    system(
        Surface("M1", semi_diameter=10.0, inner_semi_diameter=6.0, radius=100.0),
        Surface("M3", z=-0.1, semi_diameter=6.0, inner_semi_diameter=1.0, radius=20.0),
    )


def test_stops_and_names():
    assert "radius is 5;" in message(Stop, 5.0, 0.0, 0.1, 4.0, 6.0)
    assert "swap them" in message(Stop, 1.0, 0.2, 0.1, 4.0, 6.0)
    for name in ("", "a.b", " a", "=a", "a\nb"):
        assert ascii(name) in message(Surface, name, semi_diameter=1.0)
        assert ascii(name) in message(Structure, name, 1.0, 0.0, 1.0, 1.0)
    thick = [(f.name, f.r0, f.z0, f.r1, f.z1) for f in Stop(1.0, -0.1, 0.0, 2.0, 3.0).faces()]
    assert thick[:2] == [("stop_front", 2.0, -0.1, 1.0, -0.1), ("stop_wall", 1.0, -0.1, 1.0, 0.0)]
    assert thick[2:] == [("stop_rear", 1.0, 0.0, 3.0, 0.0)]
    (thin,) = Stop(1.0, 0.0, 0.0, 2.0, 2.0).faces()
    assert thin.z0 == thin.z1 == 0.0


@pytest.mark.parametrize("missing", ["detector", "source"])
def test_scene_needs_detector_and_source(missing, tmp_path):
    prescription = system(*lens(), **{missing: None})
    for write in (prescription.to_dict, prescription.to_scene, lambda: prescription.to_xml(tmp_path / "scene.xml")):
        text = message(write)
        assert f"has no {missing}" in text
        assert f"add {missing}=" in text
    assert not list(tmp_path.iterdir())
    assert "no source" in message(system(*lens(), source=None).with_source, field_deg=7.0)
    assert system(*lens()).with_source(field_deg=7.0).source.field_deg == 7.0


def test_paraxial_and_placement_about_x_then_y_then_z():
    thin = system(*lens(radius=100.0)).paraxial(550.0)
    assert thin.efl == pytest.approx(1 / (0.5 * (2 / 100 - 0.5 * 2 / (1.5 * 100**2))), rel=1e-12)
    mirror = Surface("m", semi_diameter=5.0, radius=-100.0, coating=Coating(R=1.0), mirror=True)
    assert "surface 'm'" in message(system(mirror).paraxial, 550.0)
    placed = Surface("s", semi_diameter=1.0, x=1.0, y=2.0, z=3.0, tilt_deg=(90.0, 90.0, 90.0))
    matrix = placed.to_world()
    np.testing.assert_allclose(matrix[:3, 3], (1, 2, 3))
    # x axis: stays, then -z, stays; z axis: -y, stays, then +x
    np.testing.assert_allclose(matrix[:3, :3] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-15)
    assert not placed.coaxial
    assert Surface("s", semi_diameter=1.0, z=3.0, tilt_deg=(0.0, 0.0, 45.0)).coaxial

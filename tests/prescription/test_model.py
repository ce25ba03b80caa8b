from __future__ import annotations

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


def system(*surfaces, **more):
    return Prescription(name="test", surfaces=surfaces, **({"detector": DETECTOR, "source": SOURCE} | more))


def lens(z=0.0, name="L1", radius=50.0, semi_diameter=5.0):
    return (
        Surface(f"{name}_front", z=z, radius=radius, semi_diameter=semi_diameter, back="1.5"),
        Surface(f"{name}_rear", z=z + 2.0, radius=-radius, semi_diameter=semi_diameter, front="1.5"),
    )


def message(function, *arguments, **keywords):
    with pytest.raises(MistrayError) as caught:
        function(*arguments, **keywords)
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("keywords", "wanted"),
    [
        ({"semi_diameter": -5.0}, "surface 'x': semi_diameter = -5 mm; it must be greater than 0"),
        ({"semi_diameter": math.nan}, "semi_diameter = nan"),
        ({}, "give either semi_diameter, both half sizes or an outline"),
        ({"half_width": 1.0}, "give either semi_diameter, both half sizes or an outline"),
        ({"semi_diameter": 1.0, "half_width": 1.0, "half_height": 1.0}, "give either"),
        ({"semi_diameter": 1.0, "inner_semi_diameter": 1.0}, "between 0 and the outer radius 1 mm"),
        ({"semi_diameter": 1.0, "coefficients": (0.0,) * 10}, "at most 9"),
        ({"semi_diameter": 3.0, "radius": 2.0}, "its conic ends at 2 mm"),
        ({"half_width": 1.5, "half_height": 1.5, "radius": 2.0}, "clear radius 2.12132 mm; its conic ends at 2 mm"),
    ],
)
def test_bad_surfaces(keywords, wanted):
    assert wanted in message(Surface, "x", **keywords)


@pytest.mark.parametrize("name", ["", "a.b", " a", "=a", "a\nb"])
def test_bad_names(name):
    assert ascii(name) in message(Surface, name, semi_diameter=1.0)
    assert ascii(name) in message(Structure, name, 1.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("build", "wanted"),
    [
        (lambda: Coating(), "coating: it has no recipe; give one of R (and T), table, layers and preset"),
        (lambda: Coating(R=0.1, table="x.csv"), "coating: it has R = 0.1 and table = 'x.csv'; give one of"),
        (lambda: Coating(layers="1.38 10", preset="bbar3"), "layers = '1.38 10' and preset = 'bbar3'; give one of"),
        (lambda: Coating(T=0.5), "give one of R (and T)"),
        (lambda: Coating(R=0.6, T=0.5), "coating: R = 0.6 and T = 0.5; both must lie in 0 … 1 and R + T must"),
        (lambda: Coating(R=-0.1), "R = -0.1"),
        (lambda: Coating(R=0.6, T=0.5, name="ar"), "coating 'ar': R = 0.6"),
        (lambda: Coating(table="x.csv", T=0.1), "T = 0.1 beside table = 'x.csv', which already holds T"),
        (lambda: Coating(layers="1.38 10", T=0.1), "already holds T"),
        (lambda: Coating(preset="bbar9"), "coating preset 'bbar9' is unknown; did you mean 'bbar4'?"),
        (lambda: Coating(layers="1.38 10", design_nm=0.0), "design_nm = 0; it must be greater than 0"),
        (lambda: Coating(layers="1.38 10", first="top"), "first = 'top'; it is outside, front or back"),
        (lambda: Coating(R=0.1, first="front"), "coating: first has no meaning beside R, which has no layers"),
        (lambda: Coating(table="x.csv", n_shift=(0.1,)), "n_shift has no meaning beside table"),
        (lambda: Coating(R=0.1, design_nm=600.0), "design_nm has no meaning beside R"),
        (lambda: Coating(R=0.1, name="a.b"), "must not be empty or hold a dot"),
        (lambda: Structure("s", 1.0, 0.0, -1.0, 1.0), "radii must be ≥ 0"),
        (lambda: Structure("s", 1.0, 0.0, 1.0, 0.0), "no area"),
        (lambda: Structure("s", 0.0, 0.0, 0.0, 1.0), "no area"),
        (lambda: Stop(5.0, 0.0, 0.1, 4.0, 6.0), "radius = 5 mm"),
        (lambda: Stop(1.0, 0.2, 0.1, 4.0, 6.0), "swap them"),
        (lambda: Detector(half_width=1.0, half_height=1.0, pixels=(0, 5)), "at least 1"),
        (lambda: Source(), "give either radius or both half sizes"),
        (lambda: Source(radius=-1.0), "radius = -1"),
        (lambda: Source(radius=1.0, irradiance=0.0), "irradiance = 0"),
        (lambda: Source(radius=1.0, inner_radius=1.0), "inner_radius = 1"),
        (lambda: Source(radius=1.0, plane="pupil"), "'beam' or 'axis'"),
        (lambda: Source(radius=1.0, pattern="hex"), "'random' or 'grid'"),
        (lambda: Source(radius=1.0, wavelength_nm=()), "at least one"),
        (lambda: Source(radius=1.0, wavelength_nm=(500.0, 600.0), weights=(1.0,)), "1 weights for 2"),
    ],
)  # fmt: skip
def test_bad_parts(build, wanted):
    assert wanted in message(build)


def test_which_coatings_have_layers():
    assert not Coating(R=0.1).layered
    assert not Coating(table="a.csv").layered
    assert Coating(table="COATING.DAT:AR").layered
    assert Coating(preset="bbar3").layered
    assert Coating(layers="1.38 10").layered


def test_which_coatings_are_opaque():
    assert Coating(R=0.1).opaque
    assert not Coating(R=0.1, T=0.1).opaque
    assert Coating(preset="protected_al").opaque
    assert not any(Coating(**kind).opaque for kind in ({"preset": "bbar3"}, {"layers": "1.4 10"}, {"table": "a.csv"}))


def test_named_coatings_are_one():
    ar, other = Coating(preset="bbar3", name="ar"), Coating(preset="bbar4", name="ar")
    front, rear = lens()
    both = system(replace(front, coating=ar), replace(rear, coating=ar))
    assert both.shared_coatings() == {"ar": ar}
    text = message(system, replace(front, coating=ar), replace(rear, coating=other))
    assert "two different coatings are called 'ar', that of 'L1_rear' is one; give each its own name" in text
    text = message(system, replace(front, coating=replace(ar, name="L1_rear")), rear)
    assert "a shape and a coating are called 'L1_rear'; rename one" in text


def test_duplicate_names():
    assert "2 shapes are called 'L1_front'" in message(system, *lens(), *lens(z=10.0))


def test_surfaces_that_cross():
    front = Surface("front", radius=10.0, semi_diameter=6.0, back="1.5")
    rear = Surface("rear", z=2.0, radius=-10.0, semi_diameter=6.0, front="1.5")
    text = message(system, front, rear)
    assert "'front' and 'rear' cross at r = " in text
    at = float(re.search(r"r = ([\d.]+) mm", text)[1])
    # two spheres whose sags add up to the thickness
    assert at == pytest.approx(math.sqrt(10**2 - 9**2), rel=0.01)


def test_surfaces_that_coincide():
    assert "coincide" in message(system, *lens(), Surface("window", z=2.0, radius=-50.0, semi_diameter=3.0))
    assert "coincide" in message(system, Surface("board", z=20.0, semi_diameter=3.0))


def test_surfaces_side_by_side_may_overlap_in_z():
    """Primary and tertiary of a telescope: the rings do not share any radius."""
    system(
        Surface("M1", semi_diameter=10.0, inner_semi_diameter=6.0, radius=100.0),
        Surface("M3", z=-0.1, semi_diameter=6.0, inner_semi_diameter=1.0, radius=20.0),
    )


@pytest.mark.parametrize(("missing", "remedy"), [("detector", "add detector="), ("source", "add source=")])
def test_scene_needs_detector_and_source(missing, remedy, tmp_path):
    prescription = system(*lens(), **{missing: None})
    for write in (prescription.to_dict, prescription.to_scene, lambda: prescription.to_xml(tmp_path / "scene.xml")):
        text = message(write)
        assert f"has no {missing}" in text
        assert remedy in text
    assert not list(tmp_path.iterdir())


def test_with_source():
    assert system(*lens()).with_source(field_deg=7.0).source.field_deg == 7.0
    assert "no source" in message(system(*lens(), source=None).with_source, field_deg=7.0)


def test_stop_has_three_faces_or_one():
    thick = Stop(1.0, -0.1, 0.0, 2.0, 3.0).faces()
    assert [(f.name, f.r0, f.z0, f.r1, f.z1) for f in thick] == [
        ("stop_front", 2.0, -0.1, 1.0, -0.1),
        ("stop_wall", 1.0, -0.1, 1.0, 0.0),
        ("stop_rear", 1.0, 0.0, 3.0, 0.0),
    ]
    (thin,) = Stop(1.0, 0.0, 0.0, 2.0, 2.0).faces()
    assert thin.z0 == thin.z1 == 0.0


def test_placement_turns_about_x_then_y_then_z():
    placed = Surface("s", semi_diameter=1.0, x=1.0, y=2.0, z=3.0, tilt_deg=(90.0, 90.0, 90.0))
    matrix = placed.to_world()
    np.testing.assert_allclose(matrix[:3, 3], (1, 2, 3))
    # x axis: stays, then -z, stays; z axis: -y, stays, then +x
    np.testing.assert_allclose(matrix[:3, :3] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-15)
    assert not placed.coaxial
    assert Surface("s", semi_diameter=1.0, z=3.0, tilt_deg=(0.0, 0.0, 45.0)).coaxial


def test_paraxial():
    thin = system(*lens(radius=100.0)).paraxial(550.0)
    assert thin.efl == pytest.approx(1 / (0.5 * (2 / 100 - 0.5 * 2 / (1.5 * 100**2))), rel=1e-12)
    mirror = Surface("m", semi_diameter=5.0, radius=-100.0, coating=Coating(R=1.0), mirror=True)
    assert "surface 'm'" in message(system(mirror).paraxial, 550.0)


def test_a_detector_that_is_none() -> None:
    with pytest.raises(MistrayError, match="'x': detector is a tuple"):
        Prescription(name="x", surfaces=(), detector=("detector", 50.0))  # type: ignore[arg-type]

"""Overlapping surfaces are found in any scene, and nothing else is."""

from __future__ import annotations

import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.errors import MistrayError
from mistray.scene.check import check_overlaps

SCENES = sorted(path.parent.name for path in Path(__file__).parents[2].glob("scenes/*/scene.xml"))


def asphere(z=0.0, front="air", back="air", turn=0.0, offset=(0.0, 0.0), **values):
    T = mi.ScalarTransform4f
    opaque = {"R": 0.0} if values.pop("opaque", False) else {}
    place = T().translate([*offset, z]) @ T().rotate([1, 0, 0], turn)
    values = {"semi_diameter": 5.0} | values if "half_width" not in values else values
    return {
        "type": "asphere", "to_world": place, "bsdf": {"type": "interface", "front": front, "back": back, **opaque},
        **values,
    }  # fmt: skip


def frustum(r0, z0, r1, z1, **bsdf):
    return {"type": "frustum", "r0": r0, "z0": z0, "r1": r1, "z1": z1, "bsdf": {"type": "interface", **bsdf}}


def lens(z=0.0, name="L1", thickness=3.0, **values):
    return {
        f"{name}_front": asphere(z, back="1.5", radius=20.0, **values),
        f"{name}_rear": asphere(z + thickness, front="1.5", radius=-20.0, **values),
    }


def check(shapes):
    mistray.load({"type": "scene", **shapes})


def fails(shapes):
    with pytest.raises(MistrayError) as caught:
        check(shapes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_pass_quickly(name):
    scene = mistray.load(name)
    started = time.process_time()
    for _ in range(5):
        check_overlaps(scene)
    assert (time.process_time() - started) / 5 < 0.02


def test_telescopes_pass():
    batoid = pytest.importorskip("batoid")
    for file in ("LSST_r.yaml", "ComCam_g.yaml", "HSC_no_obsc.yaml", "donsoptikz1.yaml"):
        mistray.prescription.from_batoid(batoid.Optic.fromYaml(file), wavelength_nm=620.0).to_scene()


def test_a_lens_too_thin_for_its_rim():
    check(lens(thickness=1.3))
    assert "'L1_front' and 'L1_rear' cross at r = 4.4" in fails(lens(thickness=1.0))


def test_lenses_that_cut_into_each_other():
    assert "'L2_front' and 'L1_rear' cross" in fails(
        {**lens(), "L2_front": asphere(2.9, back="1.6", radius=15.0), "L2_rear": asphere(6.0, front="1.6")}
    )


SENSOR = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 8, "height": 8}}


@pytest.mark.parametrize("detector", ["asphere", "rectangle"])
@pytest.mark.parametrize(("front", "rear"), [(0.0, -3.0), (5.0, 3.0), (20.0, 3.0), (1e9, 3.0)])
def test_a_rear_ahead_of_its_front(detector, front, rear):
    """Light would start in the glass; not where the detector is in it as well, nor for a gap of air in glass."""

    def shapes(around="air", **of_detector):
        image = asphere(10.0, opaque=True, **of_detector)
        if detector == "rectangle":
            image = {"type": "rectangle", "to_world": image["to_world"], "bsdf": image["bsdf"]}
        return {
            "front": asphere(front, front=around, back="1.5"), "rear": asphere(rear, front="1.5", back=around),
            "image": image | {"sensor": SENSOR},
        }  # fmt: skip

    line = fails(shapes())
    assert "'rear' at z = " in line
    assert "light starts in '1.5'" in line
    assert "stands in 'air'" in line
    check(shapes(front="1.5"))
    straight = shapes()
    straight["front"], straight["rear"] = asphere(rear, back="1.5"), asphere(min(front, 8.0), front="1.5")
    if rear < min(front, 8.0) < 10.0:
        check(straight)


def test_lenses_in_the_wrong_order():
    """No surface crosses another, but the second lens begins inside of the first."""
    shapes = {
        "a": asphere(0.0, back="1.5"),
        "b": asphere(4.0, front="1.5"),
        "c": asphere(3.0, back="1.6"),
        "d": asphere(7.0, front="1.6"),
    }
    message = fails(shapes)
    assert "'a' at z = 0 mm and 'c' at z = 3 mm: the material between them is '1.5' for one and 'air'" in message


def test_materials_are_compared_by_their_index():
    check({"a": asphere(0.0, back="1.50"), "b": asphere(2.0, front="1.5", back="vacuum"), "c": asphere(4.0)})


def test_twice_the_same_surface():
    assert "'a' and 'b' coincide; remove one" in fails({"a": asphere(radius=30.0), "b": asphere(radius=30.0)})


def test_touching_is_allowed():
    """At the vertex, at the rim, and structure in contact with a lens or drawn into it."""
    check({**lens(), "window": asphere(3.0, back="1.5"), "window_rear": asphere(4.0, front="1.5")})
    sag = 20 - np.sqrt(20**2 - 5**2)
    check(lens(thickness=2 * sag))
    check(
        {
            **lens(),
            "edge": frustum(5.0, sag, 5.0, 3.0 - sag, R=0.0),
            "flange": frustum(4.0, 3.0 - sag, 5.0, 3.0 - sag, R=0.0),
            "seat": frustum(4.0, 3.0 - sag, 6.0, 3.0 - sag, R=0.0),
            "tube": frustum(4.9, -5.0, 4.9, 8.0, R=0.0),
        }
    )


def test_rings_side_by_side_may_share_heights():
    check(
        {
            "M1": asphere(radius=100.0, semi_diameter=10.0, inner_semi_diameter=6.0, opaque=True),
            "M3": asphere(-0.1, radius=20.0, semi_diameter=6.0, inner_semi_diameter=1.0, opaque=True),
        }
    )


def test_other_axes_do_not_count():
    plate = {"front": asphere(0.0, back="1.5"), "rear": asphere(2.0, front="1.5")}
    check(
        {**plate, "fold": asphere(1.0, turn=45.0, opaque=True), "aside": asphere(1.0, offset=(20.0, 0.0), opaque=True)}
    )
    assert "'front' and 'beside' cross" in fails({"front": asphere(1.0, radius=20.0), "beside": asphere(1.2)})


def test_an_axis_that_is_no_world_axis():
    T = mi.ScalarTransform4f
    move = T().translate([7, -3, 2]) @ T().rotate([0.6, 0.0, 0.8], 40)
    for thickness, good in ((3.0, True), (1.0, False)):
        shapes = lens(thickness=thickness)
        for shape in shapes.values():
            shape["to_world"] = move @ shape["to_world"]
        if good:
            check(shapes)
        else:
            assert "cross at r = 4.4" in fails(shapes)


def test_a_surface_turned_round():
    """The same lens with its rear given in a frame that looks the other way."""
    turned = lens()["L1_front"]
    check({"L1_front": turned, "L1_rear": asphere(3.0, turn=180.0, back="1.5", radius=20.0)})
    assert "cross" in fails({"L1_front": turned, "L1_rear": asphere(1.0, turn=180.0, back="1.5", radius=20.0)})


def test_glass_of_other_shapes_may_lie_between():
    """What refracts on the axis besides aspheres is not followed, so nothing is said about materials there."""
    sphere = {"type": "sphere", "center": [0, 0, 10], "radius": 2.0, "bsdf": {"type": "interface", "front": "1.5"}}
    check({"inside": asphere(10.0, front="1.5", back="1.5"), "before": asphere(5.0), "ball": sphere})
    assert "'1.5'" in fails({"inside": asphere(10.0, front="1.5", back="1.5"), "before": asphere(5.0)})
    disc = frustum(0.0, 7.0, 5.0, 7.0, back="1.5")
    check({"inside": asphere(10.0, front="1.5", back="1.5"), "before": asphere(5.0), "disc": disc})


def test_rectangles_count_to_their_inscribed_circle():
    """Their corners reach farther, but the comparison keeps to radii that lie inside of both at every azimuth."""
    bowl = asphere(0.0, radius=20.0, semi_diameter=6.0, opaque=True)
    z = float(20 - np.sqrt(20**2 - 3**2))
    check({"bowl": bowl, "board": asphere(z + 0.01, half_width=3.0, half_height=4.0, opaque=True)})
    assert "cross" in fails({"bowl": bowl, "board": asphere(z - 0.1, half_width=3.0, half_height=4.0, opaque=True)})

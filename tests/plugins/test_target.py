"""The plugin `target`: parameters, invisibility under stock integrators, and scenes that hold it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray import MistrayError
from mistray.surfaces.surfaces import SurfaceTable

T = mi.ScalarTransform4f


def target(**values: Any) -> Any:
    return mi.load_dict({"type": "target", "surfaces": "lens", **values})


def test_parameters():
    bsdf = target(surfaces=" a_*,b ,", rays=10, scale=2, hole=0.5, reverse=True)
    assert bsdf.is_target
    assert (bsdf.surfaces, bsdf.rays, bsdf.scale, bsdf.hole, bsdf.reverse) == (("a_*", "b"), 10, 2, 0.5, True)
    plain = target()
    assert (plain.surfaces, plain.rays, plain.scale, plain.hole, plain.reverse) == (("lens",), 1, 1, 0, False)
    assert "lens" in str(bsdf) or "a_*" in str(bsdf)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"surfaces": " , "}, "surfaces is empty"),
        ({"rays": 0}, "rays is 0; it must be a whole number between 1 and 255"),
        ({"rays": 256}, "rays is 256"),
        ({"rays": 1.5}, "rays is 1.5"),
        ({"rays": "many"}, "rays is 'many'; it must be a whole number"),
        ({"scale": 0.0}, "scale is 0"),
        ({"scale": float("inf")}, "scale is inf"),
        ({"hole": 1.0}, "hole is 1"),
        ({"hole": -0.1}, "hole is -0.1"),
        ({"half_axes": "1, 2"}, "half_axes is '1, 2'; give three positive numbers"),
        ({"half_axes": "1, 2, -3"}, "half_axes is '1, 2, -3'"),
        ({"half_axes": "1, b, 3"}, "half_axes is '1, b, 3'"),
        ({"about": "axis", "cone_deg": 1.0}, "about is 'axis'; use direction, point or specular"),
        ({"about": "point"}, "about without cone_deg"),
        ({"cone_deg": 2.0}, "cone_deg without about"),
        ({"about": "point", "cone_deg": 181.0}, "cone_deg is 181"),
        ({"about": "point", "cone_deg": -1.0}, "cone_deg is -1"),
        ({"about": "point", "cone_deg": 1.0, "entity": "lens"}, "about and entity exclude each other"),
        ({"about": "point", "cone_deg": 1.0, "scale": 2.0}, "about and scale exclude each other"),
        ({"entity": "lens", "hole": 0.5}, "entity and hole exclude each other"),
    ],
)
def test_bad_parameters(values, words):
    with pytest.raises(MistrayError, match=words):
        mistray.load({"type": "scene", "t": {"type": "disk", "bsdf": {"type": "target", "surfaces": "lens", **values}}})


def test_surfaces_must_be_named():
    with pytest.raises(MistrayError, match="surfaces is missing"):
        mistray.load({"type": "scene", "t": {"type": "disk", "bsdf": {"type": "target"}}})


def scene(**more: Any) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "beam": {"type": "collimated", "radius": 1.0},
        "lens": {"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "interface", "R": 0.1, "T": 0.9}},
        "detector": {
            "type": "asphere",
            "half_width": 2.0,
            "half_height": 2.0,
            "to_world": T().translate([0, 0, 10]),
            "bsdf": {"type": "interface", "R": 0.0},
            "sensor": {"type": "irradiancemeter", "film": film},
        },
        **more,
    }


IN_THE_WAY = {
    "type": "asphere",
    "semi_diameter": 5.0,
    "to_world": T().translate([0, 0, 10]),
    "bsdf": {"type": "target", "surfaces": "lens"},
}


def test_a_target_is_no_surface_of_the_ray_tree():
    """Not even where it coincides with a surface: same surfaces, same light, to the last bit."""
    without, with_target = mistray.load(scene()), mistray.load(scene(screen=IN_THE_WAY))
    assert SurfaceTable(with_target, 550.0).ids == SurfaceTable(without, 550.0).ids
    a, b = (mistray.trace(loaded, rays=2000) for loaded in (without, with_target))
    assert a.energy.detected_W == b.energy.detected_W
    np.testing.assert_array_equal(a.irradiance, b.irradiance)


@pytest.mark.long
def test_stock_integrators_see_through_it():
    """A lamp behind a target is as bright as without it, seen along the view and through a null interaction."""
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}}
    camera = {
        "type": "perspective",
        "fov": 10,
        "to_world": T().look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }
    view: dict[str, Any] = {"type": "scene", "integrator": {"type": "path"}, "lamp": lamp, "camera": camera}
    veil = {"type": "disk", "to_world": T().translate([0, 0, 5]).scale(4), "bsdf": {"type": "target", "surfaces": "*"}}
    bare, veiled = (np.array(mi.render(mi.load_dict(d), spp=4)) for d in (view, view | {"veil": veil}))
    np.testing.assert_allclose(veiled, bare, rtol=1e-6)
    assert np.all(veiled == pytest.approx(3.0, rel=1e-6))


def test_protocol():
    """sample goes straight on with weight 1, eval and pdf are 0, and the flags say so."""
    bsdf = target()
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0.6, 0.0, 0.8)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5, 0.5))
    np.testing.assert_allclose(np.array(sample.wo).ravel(), [-0.6, 0.0, -0.8], atol=1e-7)
    np.testing.assert_array_equal(np.array(weight).ravel(), 1.0)
    wo = mi.Vector3f(0.0, 0.0, -1.0)
    assert float(bsdf.pdf(mi.BSDFContext(), si, wo)[0]) == 0
    np.testing.assert_array_equal(np.array(bsdf.eval(mi.BSDFContext(), si, wo)).ravel(), 0.0)
    np.testing.assert_array_equal(np.array(bsdf.eval_null_transmission(si)).ravel(), 1.0)

"""The plugin `target`: parameters, invisibility under stock integrators, and scenes that hold it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray import MistrayError
from mistray.surfaces.surfaces import SurfaceTable

T = mi.ScalarTransform4f


def target(**values: Any) -> Any:
    return mi.load_dict({"type": "target", "surfaces": "lens", **values})


def test_parameters() -> None:
    bsdf = target(surfaces=" a_*,b ,", rays=10, scale=2, hole=0.5, reverse=True)
    assert bsdf.is_target
    assert (bsdf.surfaces, bsdf.rays, bsdf.scale, bsdf.hole, bsdf.reverse) == (("a_*", "b"), 10, 2, 0.5, True)
    plain = target()
    assert (plain.surfaces, plain.rays, plain.scale, plain.hole, plain.reverse) == (("lens",), 1, 1, 0, False)


CONE = {"about": "point", "cone_deg": 1.0}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"surfaces": " , "}, "surfaces is empty"),
        ({"surfaces": None}, "surfaces is missing"),
        ({"rays": 256}, "rays is 256"),
        ({"rays": "many"}, "rays is 'many'"),
        ({"scale": 0.0}, "scale is 0"),
        ({"hole": 1.0}, "hole is 1"),
        ({"half_axes": "1, 2"}, "half_axes is '1, 2'; give three positive numbers"),
        ({"half_axes": "1, b, 3"}, "half_axes is '1, b, 3'"),
        (CONE | {"about": "axis"}, "about is 'axis'; use direction, point or specular"),
        ({"about": "point"}, "about without cone_deg"),
        ({"cone_deg": 2.0}, "cone_deg without about"),
        (CONE | {"entity": "lens"}, "about and entity exclude each other"),
        (CONE | {"scale": 2.0}, "about and scale exclude each other"),
        ({"entity": "lens", "hole": 0.5}, "entity and hole exclude each other"),
    ],
)
def test_bad_parameters(values: dict[str, Any], words: str) -> None:
    given = {key: value for key, value in ({"surfaces": "lens"} | values).items() if value is not None}
    with pytest.raises(MistrayError, match=words):
        scene_dicts.load(t={"type": "disk", "bsdf": {"type": "target", **given}})


def test_a_target_is_no_surface_of_the_ray_tree() -> None:
    """Not even where it coincides with a surface: same surfaces, same light, to the last bit."""
    screen = {"type": "asphere", "semi_diameter": 5.0, "to_world": scene_dicts.at(10)}
    without, with_target = (
        scene_dicts.load(
            beam={"type": "collimated", "radius": 1.0},
            lens={"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "interface", "R": 0.1, "T": 0.9}},
            detector=scene_dicts.detector(10, half_width=2.0, half_height=2.0),
            **more,
        )
        for more in ({}, {"screen": {**screen, "bsdf": {"type": "target", "surfaces": "lens"}}})
    )
    assert SurfaceTable(with_target, 550.0).ids == SurfaceTable(without, 550.0).ids
    a, b = (mistray.trace(loaded, rays=2000) for loaded in (without, with_target))
    assert a.energy.detected_W == b.energy.detected_W
    np.testing.assert_array_equal(a.irradiance, b.irradiance)


def test_stock_integrators_see_through_it() -> None:
    """A lamp behind a target is as bright as without it; samples go straight on with weight 1, and the flags say so."""
    bsdf, si, context = target(), mi.SurfaceInteraction3f(), mi.BSDFContext()
    view: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path"},
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}},
        "camera": {
            "type": "perspective",
            "fov": 10,
            "to_world": T().look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0]),
            "film": scene_dicts.film(4),
        },
        "veil": {
            "type": "disk",
            "to_world": T().translate([0, 0, 5]).scale(4),
            "bsdf": {"type": "target", "surfaces": "*"},
        },
    }
    assert np.array(mi.render(mi.load_dict(view), spp=4)) == pytest.approx(3.0, rel=1e-6)
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
    si.wi = mi.Vector3f(0.6, 0.0, 0.8)
    sample, weight = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5, 0.5))
    np.testing.assert_allclose(np.array(sample.wo).ravel(), [-0.6, 0.0, -0.8], atol=1e-7)
    np.testing.assert_array_equal(np.array(weight).ravel(), 1.0)
    wo = mi.Vector3f(0.0, 0.0, -1.0)
    assert float(bsdf.pdf(context, si, wo)[0]) == 0
    np.testing.assert_array_equal(np.array(bsdf.eval(context, si, wo)).ravel(), 0.0)
    np.testing.assert_array_equal(np.array(bsdf.eval_null_transmission(si)).ravel(), 1.0)

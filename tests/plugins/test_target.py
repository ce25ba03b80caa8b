"""The plugin `target`: parameters, invisibility under stock integrators, and scenes that hold it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
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


def test_a_target_is_no_surface_of_the_ray_tree() -> None:
    given = {
        "beam": {"type": "collimated", "radius": 1.0},
        "lens": {"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "interface", "R": 0.1, "T": 0.9}},
        "detector": scene_dicts.detector(10, half_width=2.0, half_height=2.0),
    }
    screen = {"type": "asphere", "semi_diameter": 5.0, "to_world": scene_dicts.at(10), "bsdf": target()}
    without, with_target = scene_dicts.load(**given), scene_dicts.load(**given, screen=screen)
    assert SurfaceTable(with_target, 550.0).ids == SurfaceTable(without, 550.0).ids
    a, b = (mistray.trace(loaded, rays=2000) for loaded in (without, with_target))
    assert a.energy.detected_W == b.energy.detected_W
    np.testing.assert_array_equal(a.irradiance, b.irradiance)


def test_stock_integrators_see_through_it() -> None:
    """A lamp behind a target is as bright as without it; samples go straight on with weight 1, and the flags say so."""
    bsdf, si, context = target(), mi.SurfaceInteraction3f(), mi.BSDFContext()
    eye = T().look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0])
    veil = {"type": "disk", "to_world": T().translate([0, 0, 5]).scale(4), "bsdf": {"type": "target", "surfaces": "*"}}
    view: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path"},
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}},
        "camera": {"type": "perspective", "fov": 10, "to_world": eye, "film": scene_dicts.film(4)},
        "veil": veil,
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

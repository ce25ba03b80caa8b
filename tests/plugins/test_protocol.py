"""The plugins keep Mitsuba's protocols: variants, render, traverse; and a target is invisible to stock integrators."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray import MistrayError
from mistray.surfaces.surfaces import SurfaceTable


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    face = {"type": "asphere", "semi_diameter": 10.0}
    return scene_dicts.load(
        integrator={"type": "straylight", "rays": 20000, "max_reflections": 2},
        beam={"type": "collimated", "radius": 5.0, "field_deg": 2.0},
        lens_front={**face, "radius": 30.0, "conic": -0.5, "a4": 1e-6, "bsdf": {"type": "interface", "back": "1.5"}},
        lens_rear={**face, "z": 4.0, "bsdf": {"type": "interface", "front": "1.5"}},
        lens_edge={"type": "frustum", "r0": 10.0, "z0": 1.64, "r1": 10.0, "z1": 4.0, "bsdf": scene_dicts.BLACK},
        detector=scene_dicts.detector(40, half_width=6.0, half_height=4.0, sensor=scene_dicts.meter(30, 20)),
    )


def test_render_is_the_irradiance_of_a_trace(scene: mi.Scene) -> None:
    """With the integrator's settings; `spp` counts samples per pixel, and seeds differ."""
    image = mi.render(scene, seed=0)
    t = mistray.trace(scene, ledger=False)
    assert (t.settings["rays"], t.settings["max_reflections"]) == (20000, 2)
    assert mistray.trace(scene, max_reflections=0, rays=100).settings["max_reflections"] == 0
    assert image.shape == (20, 30, 1)
    np.testing.assert_allclose(np.array(image)[:, :, 0], t.irradiance, rtol=1e-6)
    np.testing.assert_allclose(t.irradiance.sum() * 12 * 8 / 600, t.energy.detected_W, rtol=1e-9)
    first, second = (np.array(mi.render(scene, spp=8, seed=seed)) for seed in (1, 2))
    t = mistray.trace(scene, rays=8 * 600, seed=1)
    np.testing.assert_allclose(first[:, :, 0], t.irradiance, rtol=1e-6)
    assert np.any(first != second)


def test_vertices_have_no_derivative(scene: mi.Scene) -> None:
    params, key = mi.traverse(scene), "lens_front.vertex_positions"
    dr.enable_grad(params[key])
    params.update()
    try:
        with pytest.raises(MistrayError, match=r"no derivative by 'lens_front\.vertex_positions'"):
            dr.backward(dr.sum(mi.render(scene, params).array))
    finally:
        dr.disable_grad(params[key])


CODE = """
import mistray, mitsuba as mi
for variant in {variants!r}:
    mi.set_variant(variant)
    t = mistray.trace(mistray.load("plate"), rays=1000)
    print(mi.variant(), len(t.paths), round(t.energy.detected_W / t.energy.launched_W, 6))
"""


def run(*variants: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", CODE.format(variants=variants)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return re.findall(r"(?:llvm|cuda)_ad_\w+ \d+ [\d.]+", done.stdout)  # Mitsuba's own messages lie between


@pytest.mark.long
@pytest.mark.parametrize(
    "variant",
    ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_mono_polarized", "llvm_ad_spectral", "llvm_ad_spectral_polarized"],
)
def test_variant(variant):
    assert run(variant) == [f"{variant} 2 0.923075"]


def test_switches_in_one_process():
    order = ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono", "llvm_ad_rgb")
    assert run(*order) == [f"{variant} 2 0.923075" for variant in order]


@pytest.mark.gpu
def test_cuda():
    assert run("cuda_ad_rgb") == ["cuda_ad_rgb 2 0.923075"]


@pytest.mark.long
def test_the_kernel_is_made_for_no_backend() -> None:
    """The same source runs by LLVM and on a GPU; only `_variant` settles and asks for a backend."""
    root = Path(__file__).parents[2]
    marks = (r"\b(?:dr|mi)\.(?:llvm|cuda|thread_count)\b", "llvm_version|reorder_threads", r"\.Expand\b")
    own = re.compile("|".join((*marks, r"(?:from|import) (?:drjit|mitsuba)\.")))
    files = [file for folder in ("mistray", "plugins") for file in (root / folder).rglob("*.py")]
    assert {str(file.relative_to(root)) for file in files if own.search(file.read_text())} <= {"mistray/_variant.py"}


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

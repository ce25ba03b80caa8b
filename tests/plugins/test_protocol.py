"""The plugins keep Mitsuba's protocols: XML, dict, traverse, render, stock integrators, and errors that help."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray import MistrayError

T = mi.ScalarTransform4f
LENS = {
    "type": "asphere",
    "radius": 30.0,
    "conic": -0.5,
    "a4": 1e-6,
    "semi_diameter": 10.0,
    "bsdf": {"type": "interface", "back": "1.5"},
}
REAR = {
    "type": "asphere",
    "semi_diameter": 10.0,
    "to_world": T().translate([0, 0, 4]),
    "bsdf": {"type": "interface", "front": "1.5"},
}
EDGE = {"type": "frustum", "r0": 10.0, "z0": 1.64, "r1": 10.0, "z1": 4.0, "bsdf": {"type": "interface", "R": 0.1}}
DETECTOR = {
    "type": "asphere",
    "half_width": 6.0,
    "half_height": 4.0,
    "to_world": T().translate([0, 0, 40]),
    "bsdf": {"type": "interface", "R": 0.2},
    "sensor": {
        "type": "irradiancemeter",
        "film": {"type": "hdrfilm", "width": 30, "height": 20, "rfilter": {"type": "box"}},
    },
}
SCENE = {
    "type": "scene",
    "integrator": {"type": "straylight", "rays": 20000, "max_reflections": 2},
    "beam": {"type": "collimated", "radius": 5.0, "field_deg": 2.0},
    "lens_front": LENS,
    "lens_rear": REAR,
    "lens_edge": EDGE,
    "detector": DETECTOR,
}
XML = """<scene version="3.0.0">
  <integrator type="straylight">
    <integer name="rays" value="20000"/><integer name="max_reflections" value="2"/>
  </integrator>
  <emitter type="collimated" id="beam"><float name="radius" value="5"/><float name="field_deg" value="2"/></emitter>
  <shape type="asphere" id="lens_front">
    <float name="radius" value="30"/><float name="conic" value="-0.5"/><float name="a4" value="1e-6"/>
    <float name="semi_diameter" value="10"/>
    <bsdf type="interface"><string name="back" value="1.5"/></bsdf>
  </shape>
  <shape type="asphere" id="lens_rear">
    <float name="semi_diameter" value="10"/>
    <transform name="to_world"><translate z="4"/></transform>
    <bsdf type="interface"><string name="front" value="1.5"/></bsdf>
  </shape>
  <shape type="frustum" id="lens_edge">
    <float name="r0" value="10"/><float name="z0" value="1.64"/>
    <float name="r1" value="10"/><float name="z1" value="4"/>
    <bsdf type="interface"><float name="R" value="0.1"/></bsdf>
  </shape>
  <shape type="asphere" id="detector">
    <float name="half_width" value="6"/><float name="half_height" value="4"/>
    <transform name="to_world"><translate z="40"/></transform>
    <bsdf type="interface"><float name="R" value="0.2"/></bsdf>
    <sensor type="irradiancemeter"><film type="hdrfilm">
      <integer name="width" value="30"/><integer name="height" value="20"/><rfilter type="box"/>
    </film></sensor>
  </shape>
</scene>"""


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    return mistray.load(SCENE)


def fingerprint(scene: mi.Scene) -> list[tuple[str, int, float]]:
    return [(row.events, row.rays, row.power_W) for row in mistray.trace(scene).paths]


def test_string_file_and_dict_are_one_scene(scene, tmp_path):
    (tmp_path / "scene.xml").write_text(XML)
    expected = fingerprint(scene)
    assert len(expected) >= 3
    assert fingerprint(mistray.load(tmp_path / "scene.xml")) == expected
    assert fingerprint(mi.load_string(XML, optimize=False, parallel=False)) == expected


def test_settings_of_the_integrator_are_those_of_a_trace(scene):
    t = mistray.trace(scene)
    assert (t.settings["rays"], t.settings["max_reflections"]) == (20000, 2)
    assert mistray.trace(scene, max_reflections=0).settings["max_reflections"] == 0


def test_render_is_the_irradiance_of_a_trace(scene):
    image = mi.render(scene, seed=0)
    t = mistray.trace(scene, ledger=False)
    assert image.shape == (20, 30, 1)
    np.testing.assert_allclose(np.array(image)[:, :, 0], t.irradiance, rtol=1e-6)
    pixel = 12 * 8 / 600
    np.testing.assert_allclose(t.irradiance.sum() * pixel, t.energy.detected_W, rtol=1e-9)


def test_render_counts_samples_per_pixel_and_seeds(scene):
    first, second = (np.array(mi.render(scene, spp=8, seed=seed)) for seed in (1, 2))
    t = mistray.trace(scene, rays=8 * 600, seed=1)
    np.testing.assert_allclose(first[:, :, 0], t.irradiance, rtol=1e-6)
    assert np.any(first != second)


def test_gradients_raise(scene):
    params = mi.traverse(scene)
    key = "lens_front.vertex_positions"
    dr.enable_grad(params[key])
    params.update()
    try:
        with pytest.raises(MistrayError, match=r"no derivative by 'lens_front\.vertex_positions'"):
            dr.backward(dr.sum(mi.render(scene, params).array))
    finally:
        dr.disable_grad(params[key])


def test_traverse_changes_the_lens_and_its_mesh():
    scene = mistray.load(SCENE)
    before = mistray.trace(scene).paths[0]
    params = mi.traverse(scene)
    vertices = np.array(params["lens_front.vertex_positions"]).copy()
    params["lens_front.curvature"] = dr.opaque(mi.Float, 1 / 60.0)
    params.update()
    after = mistray.trace(scene).paths[0]
    assert after.rms_radius_mm > 1.5 * before.rms_radius_mm, "a weaker lens is further from focus"
    mesh = np.array(mi.traverse(scene)["lens_front.vertex_positions"]).reshape(-1, 3)
    assert np.any(mesh.ravel() != vertices)
    shape = next(shape for shape in scene.shapes() if shape.id() == "lens_front")
    np.testing.assert_allclose(mesh[:, 2], shape.sag(np.hypot(mesh[:, 0], mesh[:, 1])), atol=1e-5)


def test_an_impossible_update_is_refused_and_undone():
    scene = mistray.load(SCENE)
    before = fingerprint(scene)
    params = mi.traverse(scene)
    params["lens_front.semi_diameter"] = mi.Float(-1.0)
    with pytest.raises(MistrayError, match="shape 'lens_front': semi_diameter is -1"):
        params.update()
    assert fingerprint(scene) == before


def test_coating_update_is_traced():
    scene = mistray.load(SCENE)
    params = mi.traverse(scene)
    params["detector.bsdf.R"] = mi.Float(0.5)
    params.update()
    t = mistray.trace(scene, max_reflections=0)
    assert t.paths[0].power_W == pytest.approx(0.5 * t.paths[0].incident_W, rel=1e-6)


def test_normals_of_the_meshes_are_those_of_the_surfaces(scene):
    """Mitsuba's own ray meets the lens from -z and the edge from inside: the normals point along it."""
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(1, 1, -5), mi.Vector3f(0, 0, 1)))
    assert float(hit.n.z[0]) > 0.9
    inside = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 3), mi.Vector3f(1, 0, 0)))
    assert inside.shape[0].id() == "lens_edge"
    assert float(inside.n.x[0]) > 0.9


def test_stock_path_tracer_sees_constant_radiance_through_a_lossless_lens():
    """White furnace: with R + T = 1 everywhere the lens is invisible, whatever the path; noise is all that is left."""
    furnace = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 200, "rr_depth": 1000},
        "sky": {"type": "constant", "radiance": 1.0},
        "front": LENS,
        "rear": REAR,
        "camera": {
            "type": "perspective",
            "fov": 30.0,
            "to_world": T().look_at([0, 5, -30], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
        },
    }
    image = np.array(mi.render(mi.load_dict(furnace, optimize=False, parallel=False), spp=256))[:, :, 0]
    assert image.mean() == pytest.approx(1.0, abs=0.01)


def test_stock_particle_tracer_runs_with_the_beam(scene):
    image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "ptracer", "max_depth": 4}), spp=2))
    assert np.all(np.isfinite(image))


def test_text_forms_name_the_numbers(scene):
    text = str(scene)
    assert "Asphere[id = lens_front, curvature = 0.0333333" in text
    assert "Frustum[id = lens_edge" in text
    interfaces = {shape.id(): str(shape.bsdf()) for shape in scene.shapes()}
    assert interfaces["lens_front"] == "Interface[air | 1.5, Fresnel]"
    assert interfaces["lens_edge"] == "Interface[air | air, R = 0.1, T = 0]"
    assert "Collimated[field = 2 deg" in text
    assert "StrayLight[rays = 20000" in str(scene.integrator())


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("lens_front", {"curvature": 0.1}, "give radius or curvature, not both"),
        ("lens_front", {"half_width": 3.0}, "give either semi_diameter or both half_width and half_height"),
        ("lens_front", {"semi_diameter": 50.0}, "the conic ends at r ="),
        ("lens_front", {"inner_semi_diameter": 12.0}, "it must lie between 0 and semi_diameter = 10 mm"),
        ("lens_front", {"to_world": T().scale(2.0)}, "to_world scales"),
        ("lens_edge", {"r0": -1.0}, "r0 is -1; it must lie between 0 and 1e12 mm"),
        ("lens_edge", {"z1": 1.64}, "a frustum of no area"),
        ("beam", {"radius": 0.0}, "radius is 0; it must"),
        ("beam", {"inner_radius": 7.0}, "it must lie between 0 and radius = 5 mm"),
        ("beam", {"field_deg": 95.0}, "it must lie between -90 and 90 degrees"),
        ("beam", {"plane": "image"}, "use 'beam' or 'axis'"),
        ("beam", {"pattern": "hex"}, "use 'random' or 'grid'"),
        ("beam", {"weights": "1,2"}, "2 weights for 1 wavelengths"),
        ("beam", {"wavelength_nm": "green"}, "give one number or a list separated by commas"),
        ("integrator", {"rays": 0}, "rays is 0; it must"),
        ("integrator", {"max_events": 1001}, "it must be a whole number between 1 and"),
        ("integrator", {"splitting": "both"}, "splitting is 'both'"),
        ("integrator", {"below_threshold": "drop"}, "below_threshold is 'drop'"),
        ("integrator", {"flux_threshold": 2.0}, "must lie between 0 and 1"),
    ],
)
def test_bad_parameters_are_named(name, change, words):
    with pytest.raises(MistrayError) as caught:
        mistray.load(SCENE | {name: SCENE[name] | change})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("bsdf", "words"),
    [
        ({"R": 0.6, "T": 0.6}, "R + T must not exceed 1"),
        ({"T": 0.6}, "T is given without R"),
        ({"back": "unobtainium"}, "unobtainium"),
        ({"R": 0.1, "table": "a.csv"}, "give R and T or table, not both"),
        ({"table": "missing.csv"}, "missing.csv"),
        ({"reflectance": 0.1}, "reflectance"),
    ],
)
def test_bad_interfaces_are_named(bsdf, words):
    with pytest.raises(MistrayError) as caught:
        mistray.load(SCENE | {"lens_edge": EDGE | {"bsdf": {"type": "interface"} | bsdf}})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)

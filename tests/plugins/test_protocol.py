"""Plugins keep Mitsuba's protocols; probes, far fields, maps and splits as sensors of a scene or beside its file."""

import json
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
from command_line import Captured, fails, succeeds
from oracles.small_scenes import plates_text, write
from refusals import refused

import mistray
from mistray.recorders import FarField, Probe
from mistray.scene.other_sensors import sensor_dict
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


def test_vertices_and_flat_rings_have_no_derivative(scene: mi.Scene) -> None:
    params, key = mi.traverse(scene), "lens_front.vertex_positions"
    dr.enable_grad(params[key])
    params.update()
    try:
        with refused(r"no derivative with respect to 'lens_front\.vertex_positions'"):
            dr.backward(dr.sum(mi.render(scene, params).array))
    finally:
        dr.disable_grad(params[key])
    # Nor has the place of a flat ring along its cylinder
    here = scene_dicts.load(
        integrator={"type": "straylight", "rays": 16},
        beam={"type": "collimated", "radius": 4.0},
        ring={"type": "frustum", "r0": 2.0, "r1": 8.0, "z0": -5.0, "z1": -5.0, "bsdf": scene_dicts.BLACK},
        detector=scene_dicts.detector(10, semi_diameter=3.0),
    )
    params = mi.traverse(here)
    dr.enable_grad(params["ring.z0"])
    params.update()
    with refused(r"no derivative with respect to 'ring\.z0'"):
        dr.backward(dr.sum(mi.render(here, params).array))


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


@pytest.mark.parametrize("colours", ["rgb", "mono", "mono_polarized", "spectral", "spectral_polarized"])
def test_variant(colours):
    assert run(f"llvm_ad_{colours}") == [f"llvm_ad_{colours} 2 0.923075"]


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


def test_parameters_and_a_target_is_no_surface_of_the_ray_tree() -> None:
    bsdf = target(surfaces=" a_*,b ,", rays=10, scale=2, hole=0.5, reverse=True)
    assert bsdf.is_target
    assert (bsdf.surfaces, bsdf.rays, bsdf.scale, bsdf.hole, bsdf.reverse) == (("a_*", "b"), 10, 2, 0.5, True)
    plain = target()
    assert (plain.surfaces, plain.rays, plain.scale, plain.hole, plain.reverse) == (("lens",), 1, 1, 0, False)
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
    view: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path"},
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}},
        "camera": {"type": "perspective", "fov": 10, "to_world": eye, "film": scene_dicts.film(4)},
        "veil": {"type": "disk", "to_world": T().translate([0, 0, 5]).scale(4), "bsdf": target()},
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


PROBE = """
<sensor type="probe" id="ahead of it">
    <float name="half_width" value="0.5"/><float name="half_height" value="0.25"/><integer name="directions" value="4"/>
    <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="2"/></film>
    <transform name="to_world"><translate z="-1"/></transform>
</sensor>"""
SKY = """
<sensor type="far_field" id="sky">
    <string name="edges_deg" value="{}"/><integer name="azimuths" value="3"/>
</sensor>"""


def text_of(*sensors: str) -> str:
    text = plates_text(1, index="1.5").replace('name="radius"', 'name="distance" value="3"/><float name="radius"', 1)
    return text.replace("</scene>", "".join(sensors) + "</scene>")


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("sensors"), text_of(PROBE, SKY.format("90:180:45")))


@pytest.mark.quick
def test_a_scene_of_a_file(plate: Path, load_text) -> None:
    """A trace has what recorders of the same numbers have, of its own each time; a rendering is its irradiance."""
    scene = mistray.load(plate)
    found = mistray.trace(scene, rays=4000, max_reflections=1).recorders
    probe = Probe("p", (0, 0, -1), half_width=0.5, half_height=0.25, pixels=(4, 2), directions=4)
    sky = FarField("s", edges_deg=(90, 135, 180), azimuths=3)
    mistray.trace(load_text(text_of())[0], rays=4000, max_reflections=1, recorders=[probe, sky])
    assert list(found) == ["ahead of it", "sky"]
    for one, other in zip(found.values(), (probe, sky), strict=True):
        np.testing.assert_array_equal(one.flux.value, other.flux.value)
        np.testing.assert_array_equal(one.image[1], other.image[1])
    assert found["ahead of it"].radiance[0].shape == (2, 4, 4, 4)
    again = mistray.trace(scene, rays=1000, seed=1).recorders["ahead of it"]
    assert again.power[0] == pytest.approx(0.5, abs=5 * again.power[1])
    numbers = {sensor.id(): k for k, sensor in enumerate(scene.sensors())}
    irradiance = np.array(mi.render(scene, sensor=numbers["ahead of it"], spp=8000))
    assert irradiance.shape == (2, 4, 1)
    assert irradiance == pytest.approx(1.0, rel=0.05)  # 64,000 rays, 2600 in a pixel: 5 SE are 0.05
    assert np.array(mi.render(scene, sensor=numbers["sky"], spp=1)).shape == (2, 3, 1)


@pytest.mark.quick
@pytest.mark.core
def test_light_of_surfaces_and_a_probe_under_stock_integrators() -> None:
    """`surface_maps` and `flux_split` on a Lambertian wall across a beam of 1 W/mm²: shares and map in closed form."""
    scene = scene_dicts.load(
        beam={"type": "collimated", "half_width": 3.0, "half_height": 2.0},
        wall={"type": "asphere", "half_width": 3.0, "half_height": 2.0, "bsdf": {"type": "paint", "reflectance": 0.25}},
        detector=scene_dicts.detector(-90.0, semi_diameter=0.1, x=20.0),
        maps={"type": "surface_maps", "surfaces": "wall", "azimuths": 6, "lengths": 4},
        split={"type": "flux_split", "surfaces": "wall"},
    )
    found = mistray.trace(scene, rays=40_000, max_scatters=0).recorders
    (row,) = found["split"].rows
    assert row.incident[0] == pytest.approx(24.0, rel=1e-3)
    shares = np.array([row.absorbed[0], row.scattered_reflection[0]]) / row.incident[0]
    assert shares == pytest.approx([0.75, 0.25], rel=1e-6)
    value, se = found["maps"].maps["wall"].irradiance
    assert value.shape == (4, 6)
    assert np.all(np.abs(value - 1) < 6 * se)  # of 24 cells, from 32 batches: a false alarm in 3e-5 of runs
    # π L under a uniform sky, however it is turned
    scene = scene_dicts.load(
        probe={"type": "probe", "half_width": 2.0, "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 50)},
        sky={"type": "constant", "radiance": 2.0},
        integrator={"type": "path"},
    )
    assert np.array(mi.render(scene, spp=4)) == pytest.approx(2 * np.pi, rel=1e-5)


@pytest.mark.long
def test_spp_counts_the_pixels_of_each_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture by `spp` is that of a trace by so many rays for each of its pixels."""
    scene = scene_dicts.load(
        beam={"type": "collimated", "half_width": 3.0, "half_height": 2.0},
        detector=scene_dicts.detector(9.0, half_width=3.0, half_height=2.0),
        maps={"type": "surface_maps", "surfaces": "detector", "azimuths": 6, "lengths": 4},
        split={"type": "flux_split", "surfaces": "detector"},
        plane={"type": "probe", "directions": 2, "to_world": scene_dicts.at(-1)},
        integrator={"type": "straylight"},
    )
    pixels = {"maps": 24, "split": 6, "plane": 64 * 64}
    monkeypatch.setattr("mistray.plugins.integrators.straylight.prepare", None)  # only the trace itself prepares one
    for sensor in (sensor for sensor in scene.sensors() if sensor.id() in pixels):
        image = mistray.trace(scene, rays=10 * pixels[sensor.id()]).recorders[sensor.id()].image[0]
        np.testing.assert_allclose(np.array(mi.render(scene, sensor=sensor, spp=10))[:, :, 0], image, rtol=1e-6)


@pytest.mark.quick
def test_texts_beside_a_file(plate: Path) -> None:
    text = "probe:0.1,0,-2,half_width=0.2,half_height=0.1,normal=0 0 -1,up=1 0 0,pixels=8 4,id=back"
    scene = mistray.load(plate, "beam:radius=1,distance=9", [text, "far_field:edges_deg=0 90 180"])
    sensors = sorted(sensor.id() for sensor in scene.sensors() if sensor.get_shape() is None)
    assert sensors == ["ahead of it", "back", "far_field", "sky"]
    found = mistray.trace(scene, rays=20_000, max_reflections=1).recorders
    r, back = 0.04, found["back"]
    assert back.power[0] == pytest.approx(0.4 * 0.2 * (r + r * (1 - r) ** 2), abs=5 * back.power[1])
    assert (back.irradiance[0].shape, back.extent) == ((4, 8), (-0.2, 0.2, -0.1, 0.1))
    assert found["far_field"].power[0] > 0


@pytest.mark.quick
def test_the_frame_of_a_probe() -> None:
    frame = np.array(sensor_dict("probe:1,2,3,normal=0 3 4,up=0 0 1")["to_world"].matrix)
    np.testing.assert_allclose(frame[:3], [[-1, 0, 0, 1], [0, -0.8, 0.6, 2], [0, 0.6, 0.8, 3]], atol=1e-12)
    turned = np.array(sensor_dict("probe:0,0,0,normal=0 -1 0")["to_world"].matrix)
    np.testing.assert_allclose(turned[:3, 1:3], [[0, 0], [0, -1], [1, 0]], atol=1e-12)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((PROBE, PROBE), "ahead of it"),
        ((PROBE, SKY.format("90:80:5")), "far field 'sky': edges_deg is '90:80:5'"),
        ((SKY.format("0, x"),), "edges_deg is '0, x'"),
        ((PROBE.replace('translate z="-1"', 'scale value="2"'),), "to_world scales"),
        ((PROBE.replace("directions", "direction"),), "direction"),
        (["probe:0,0,1,id=a", "far_field:id=a"], "sensor 'a': two sensors have this id"),
        (["probe:0,0,1,id=sky"], "sensor 'sky': the scene has something else of that id"),
        (["probe:id=a"], "its place is missing"),
        (["far_field:0,0,1"], "it has no place"),
        (["probe:0,0"], "its place is 0,0"),
        (["probe:0,0,1,half_width=big"], "give a number"),
        (["probe:0,0,1,normal=0 0"], "normal is '0 0'"),
        (["probe:0,0,1,normal=0 1 0,up=0 2 0"], "not two directions"),
        (["probe:0,0,1,pixels=4.5"], "pixels is '4.5'"),
        (["lamp:0,0,1"], "'lamp' is none"),
        ([{"half_width": 1}], "type"),
    ],
)
def test_bad_ones(plate: Path, tmp_path: Path, given: Any, words: str) -> None:
    where = (write(tmp_path, text_of(*given)),) if isinstance(given, tuple) else (plate, None, given)
    with refused(words):
        mistray.load(*where)


SCENE = ["--field-deg", "0", "5", "--rays", "4000", "--quiet"]
BOTH = ["--probe", "0,0,-1,half_width=0.5,half_height=0.25,directions=4,id=ahead", "--far-field", "edges_deg=90:180:45"]


def test_json_of_the_command(tmp_path: Path, capsys: Captured) -> None:
    path = write(tmp_path, text_of())
    found = json.loads(succeeds(capsys, "ghosts", path, *SCENE, *BOTH, "--json"))["sections"]["probes"]
    first, second = found["probes"]
    assert (first["field_deg"], second["field_deg"]) == (0, 5)
    assert first["power_W"] == pytest.approx(0.5, abs=5 * first["power_se_W"])
    assert first["mean_irradiance_W_mm2"] == pytest.approx(2 * first["power_W"])
    assert first["highest_radiance_W_mm2_sr"] > 0
    assert [(row["from_deg"], row["to_deg"]) for row in found["far_fields"]] == 2 * [(90, 135), (135, 180)]
    assert "probes" not in json.loads(succeeds(capsys, "ghosts", path, *SCENE, "--json")).get("sections", {})
    assert "two sensors have this id" in fails(capsys, "ghosts", path, *SCENE, "--probe", "0,0,1,id=a", "0,0,2,id=a")

"""A derivative of each kind beside differences; the replay in float32: any size, turns, portions of rays."""

import math
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, square
from oracles.scatter_scenes import beam_xml, bsdf_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray import pst
from mistray.events import KINDS, event_of, stays
from mistray.gradients.recorded_rays import ROOM, Portions
from mistray.metrics.scene_values import changed
from mistray.optimize import Metric, parameters, path_power, rms_spot

ORDERS = range(4, 21, 2)
KEYS = [*(f"front.a{order}" for order in ORDERS), "front.curvature", "rear.z", "front.conic"]


def lens(size: float) -> str:
    """An asphere before a detector, all lengths times `size`, lit to its rim."""
    coefficients = {f"a{order}": 0.02 / order * size ** (1 - order) for order in ORDERS}
    front = shape_xml(
        "asphere", "front", size, interface_xml("air", "1.5", R=0.1, T=0.8), radius=3 * size, conic=-0.4,
        semi_diameter=1.1 * size, **coefficients,
    )  # fmt: skip
    rear = shape_xml("asphere", "rear", 1.6 * size, interface_xml("1.5", "air", R=0.1, T=0.8), semi_diameter=2 * size)
    end = shape_xml("asphere", "detector", 4 * size, sensor=True, half_width=2 * size, half_height=2 * size)
    return scene_text(front, rear, end, radius=size, field_deg=5.0)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_a_scaled_lens(load_scene, size: float) -> None:
    """Derivatives scale with the size as their parameters do, although r²⁰ and a₂₀ leave the range of float32."""
    found = []
    for scale in (1.0, size):
        scene, area = load_scene(lens(scale)), scale**2
        settings = {"rays": 200, "max_reflections": 0}
        metric = Metric(scene, lambda seen: seen[0].moments("all").variance / area, settings=settings)  # noqa: B023
        found.append(mistray.gradient(metric, mi.traverse(scene), KEYS, edges=False).gradient)
    powers = {"curvature": 1, "z": -1, "conic": 0} | {f"a{order}": order - 1 for order in ORDERS}
    for key in KEYS:
        expected = found[0][key] * size ** powers[key.rsplit(".", 1)[-1]]
        assert expected != 0
        np.testing.assert_allclose(found[1][key], expected, rtol=2e-4, err_msg=key)


def test_a_turn_about_the_own_axis(load_scene) -> None:
    """A surface of revolution turns into itself: exactly 0 for the lens, and not for the frame of the detector."""
    scene = load_scene(lens(1.0))
    # Not the variance: the whole picture turns with the frame
    metric = Metric(scene, lambda seen: sum(one.moments("all").x for one in seen), settings={"rays": 100})
    found = mistray.gradient(metric, mi.traverse(scene), ["*.tilt_z", "front.tilt_x", "front.tilt_y"], edges=False)
    assert found.gradient["front.tilt_z"] == found.gradient["rear.tilt_z"] == 0
    assert abs(found.gradient["detector.tilt_z"][0]) > 1e-3
    assert found.gradient["front.tilt_y"] != 0


@pytest.mark.parametrize(("records", "first"), [(4.0, 175), (0.5, 700), (1e6, 1)])
def test_the_first_portion(records: float, first: int) -> None:
    """It fills its share of the recorder, so that no trace is in vain."""
    traced: list[int] = []
    recorder = SimpleNamespace(capacity=1000, count=mi.UInt32(0), clear=lambda: None)

    def trace(start: Any, _: Any) -> None:
        traced.append(dr.width(start.lane))
        recorder.count = mi.UInt32(min(1000, int(records * traced[-1])))

    class Start(SimpleNamespace):
        def take(self, index: mi.UInt32) -> Any:
            return Start(lane=index)

    start = Start(lane=dr.arange(mi.UInt32, 1500))
    parts = [part for part, _ in Portions.filling(recorder, records, "{count} {capacity}").of(start, trace)]
    assert traced[0] == first == max(1, int(ROOM * 1000 / max(records, 1)))
    assert sum(dr.width(part.lane) for part in parts) == sum(traced) == 1500


def test_sides_of_incidence() -> None:
    """Reflected light stays there, totally reflected or scattered light too; as integers and as arrays."""
    expected = [kind.intercept in ("Absorbed", "SpecRefl", "TIR", "RandRefl", "ImpRefl") for kind in KINDS]
    events = [event_of(7, kind) for kind in range(len(KINDS))]
    assert [bool(stays(event)) for event in events] == expected
    assert stays(np.array(events)).tolist() == list(stays(mi.UInt32(events))) == expected


GLASS = "nd=1.6 Vd=50 k=0"
POLISH = bsdf_xml("abg", A=0.003, B=0.1, g=2.0)
SHAPES = (
    shape_xml("frustum", "stop", r0=4.0, z0=-1.0, r1=30.0, z1=-1.0),
    shape_xml("asphere", "front", 0.0, scattering_xml([bsdf_xml("thinfilm", layers="1.38 60")], "air", GLASS),
              radius=40.0, conic=-0.5, a4=1e-5, semi_diameter=10.0),
    shape_xml("asphere", "rear", 4.0, scattering_xml([POLISH], GLASS, "air", R=0.02, T=0.9),
              radius=-50.0, semi_diameter=10.0),
    shape_xml("asphere", "detector", 48.0, sensor=True, half_width=30.0, half_height=30.0),
)  # fmt: skip
BEAM = beam_xml(6.0, at=(0.0, 0.0, -20.0))
LAMP = """<emitter type="point_source" id="lamp"> <float name="z" value="-150"/>
        <float name="half_angle_deg" value="4"/> </emitter>"""
# A glass is on both sides of it: its index moves as one
TOGETHER = {"front.bsdf.n_back_shift": ("front.bsdf.n_back_shift", "rear.bsdf.n_front_shift")}
# Key → step of the central difference
OF_POWER = {"front.bsdf.coating.thickness_nm": 1.0, "rear.bsdf.T": 0.01, "rear.bsdf.abg.A": 1e-4}
OF_SPOT = {"front.curvature": 1e-4, "front.conic": 0.05, "rear.a4": 1e-6, "rear.z": 0.02}
OF_SPOT |= {"front.tilt_x": 0.1, "front.bsdf.n_back_shift": 1e-3}
AT_EDGES = ("stop.r0", "lamp.z")
SURE = 4.5  # standard errors: a false alarm in 1.5e5 runs for each number


def moved(metric: Any, params: Any, keys: tuple[str, ...], by: float) -> float:
    with changed(params, {key: np.array(params[key]) + by for key in keys}):
        return float(metric.value())


@pytest.mark.core
@pytest.mark.parametrize("of", ["power", "spot"])
def test_differences(load_scene, of: str) -> None:
    """Within 0.2 %: the rays are the same, and the metric is bent over the step."""
    lens = load_scene(scatter_scene(BEAM, *SHAPES))
    params, steps = mi.traverse(lens), OF_POWER if of == "power" else OF_SPOT
    light = {"rays": 1000, "field_deg": 2.0, "max_scatters": 1}
    metric = path_power(lens, "direct", **light) if of == "power" else rms_spot(lens, **light)
    numbers = {key: TOGETHER.get(key, (key,)) for key in steps}
    found = mistray.gradient(metric, params, keys=[key for keys in numbers.values() for key in keys], edges=False)
    for (key, step), keys in zip(steps.items(), numbers.values(), strict=True):
        difference = (moved(metric, params, keys, step) - moved(metric, params, keys, -step)) / (2 * step)
        assert sum(found.gradient[each][0] for each in keys) == pytest.approx(difference, rel=0.002), key


@pytest.mark.core
def test_rims_and_sources(load_scene) -> None:
    """Light of a lamp at a distance d through a hole of radius r goes with the solid angle 2π (1 - d/√(d² + r²))."""
    lens = load_scene(scatter_scene(LAMP, *SHAPES))
    found = mistray.gradient(path_power(lens, "direct", rays=4000, field_deg=0.0), mi.traverse(lens), keys=AT_EDGES)
    d, r = 149.0, 4.0
    slant = math.hypot(d, r)
    share = 1 - d / slant
    by_r, by_z = d * r / slant**3 / share, r**2 / slant**3 / share  # a lamp that moves by dz comes nearer
    for key, expected in zip(AT_EDGES, (by_r, by_z), strict=True):
        value, se = found.gradient[key][0], found.standard_error[key][0]
        assert abs(value - found.value * expected) < SURE * se, key
        assert 0 < se < abs(0.3 * found.value * expected), key


def test_no_kind_is_left_out(load_scene) -> None:
    known = parameters(load_scene(scatter_scene(LAMP, *SHAPES)))
    tested = {known[key].kind for key in (*OF_POWER, *OF_SPOT, *AT_EDGES)}
    assert tested == {each.kind for each in known.values()}
    assert len(tested) == 11


T = mi.ScalarTransform4f


def differentiable() -> mi.Scene:
    turned = T().translate([0, 14, -10]).rotate([1, 0, 0], 60)
    white = BLACK | {"scatter": {"type": "abg", "A": 0.2, "B": 1.0, "g": 0.0}}
    plate = {"type": "asphere", "half_width": 15.0, "half_height": 15.0, "to_world": turned, "bsdf": white}
    light = {"type": "area", "radiance": {"type": "spectrum", "value": 2.0}}
    place = T().translate([0, -6, -40]).scale([4, 7, 1])
    lamp = {"type": "rectangle", "to_world": place, "bsdf": BLACK, "emitter": light}
    return lit(lamp, plate=plate, detector=square(5.0, 2))


@pytest.mark.parametrize("name", ["plate.vertex_positions", "plate.z", "lamp.emitter.radiance.value"])
def test_a_trace_and_a_pst(name: str) -> None:
    plain, attached = differentiable(), differentiable()
    parameters = mi.traverse(attached)
    dr.enable_grad(parameters[name])
    parameters.update()
    settings = {"rays": 20_000, "max_scatters": 2, "seed": 3}
    one, other = (mistray.trace(s, **settings) for s in (plain, attached))
    assert one.energy.detected_W > 0
    assert np.array_equal(one.irradiance, other.irradiance)
    first, second = (pst(s, [0, 30], method="adjoint", **settings) for s in (plain, attached))
    assert first.to_pandas().pst_total.all()
    assert first.to_pandas().equals(second.to_pandas())

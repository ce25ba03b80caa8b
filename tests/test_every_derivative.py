"""A derivative of each kind, against differences of traces of the same rays and a closed form."""

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import shape_xml, write

import mistray
from mistray.optimize import parameters, path_power, rms_spot

GLASS = "nd=1.6 Vd=50 k=0"
FILM = bsdf_xml("thinfilm", layers="1.38 60")
POLISH = bsdf_xml("abg", A=0.003, B=0.1, g=2.0)
SHAPES = (
    shape_xml("frustum", "stop", r0=4.0, z0=-1.0, r1=30.0, z1=-1.0),
    shape_xml("asphere", "front", 0.0, scattering_xml([FILM], "air", GLASS),
              radius=40.0, conic=-0.5, a4=1e-5, semi_diameter=10.0),
    shape_xml("asphere", "rear", 4.0, scattering_xml([POLISH], GLASS, "air", R=0.02, T=0.9),
              radius=-50.0, semi_diameter=10.0),
    shape_xml("asphere", "detector", 48.0, sensor=True, half_width=30.0, half_height=30.0),
)  # fmt: skip
BEAM = """<emitter type="collimated" id="lamp"> <float name="radius" value="6"/>
        <transform name="to_world"> <translate z="-20"/> </transform> </emitter>"""
LAMP = """<emitter type="point_source" id="lamp"> <float name="z" value="-150"/>
        <float name="half_angle_deg" value="4"/> </emitter>"""
# A glass is on both sides of it: its index moves as one
TOGETHER = {"front.bsdf.n_back_shift": ("front.bsdf.n_back_shift", "rear.bsdf.n_front_shift")}
# Key → step of the central difference
OF_POWER = {"front.bsdf.coating.thickness_nm": 1.0, "rear.bsdf.T": 0.01, "rear.bsdf.abg.A": 1e-4}
OF_SPOT = {
    "front.curvature": 1e-4,
    "front.conic": 0.05,
    "rear.a4": 1e-6,
    "rear.z": 0.02,
    "front.tilt_x": 0.1,
    "front.bsdf.n_back_shift": 1e-3,
}
AT_EDGES = ("stop.r0", "lamp.z")
SURE = 4.5  # standard errors: a false alarm in 1.5e5 runs for each number


def scene(folder: Path, light: str) -> Any:
    text = f'<scene version="3.0.0"><integrator type="straylight"/>{light}{"".join(SHAPES)}</scene>'
    return mistray.load(write(folder, text))


def moved(metric: Any, params: Any, keys: tuple[str, ...], by: float) -> float:
    before = {key: mi.Float(params[key]) for key in keys}
    for key, value in before.items():
        params[key] = value + by
    params.update()
    found = float(metric.value())
    for key, value in before.items():
        params[key] = value
    params.update()
    return found


@pytest.mark.core
@pytest.mark.parametrize("of", ["power", "spot"])
def test_differences(tmp_path: Path, of: str) -> None:
    """Within 0.2 %: the rays are the same, and the metric is bent over the step."""
    lens = scene(tmp_path, BEAM)
    params, steps = mi.traverse(lens), OF_POWER if of == "power" else OF_SPOT
    light = {"rays": 1000, "field_deg": 2.0, "max_scatters": 1}
    metric = path_power(lens, "direct", **light) if of == "power" else rms_spot(lens, **light)
    numbers = {key: TOGETHER.get(key, (key,)) for key in steps}
    found = mistray.gradient(metric, params, keys=[key for keys in numbers.values() for key in keys], edges=False)
    for (key, step), keys in zip(steps.items(), numbers.values(), strict=True):
        difference = (moved(metric, params, keys, step) - moved(metric, params, keys, -step)) / (2 * step)
        assert sum(found.gradient[each][0] for each in keys) == pytest.approx(difference, rel=0.002), key


@pytest.mark.core
def test_rims_and_sources(tmp_path: Path) -> None:
    """Light of a lamp at a distance d through a hole of radius r goes with the solid angle 2π (1 - d/√(d² + r²))."""
    lens = scene(tmp_path, LAMP)
    metric = path_power(lens, "direct", rays=4000, field_deg=0.0)
    found = mistray.gradient(metric, mi.traverse(lens), keys=AT_EDGES)
    d, r = 149.0, 4.0
    slant = math.hypot(d, r)
    share = 1 - d / slant
    by_r, by_z = d * r / slant**3 / share, r**2 / slant**3 / share  # a lamp that moves by dz comes nearer
    for key, expected in zip(AT_EDGES, (by_r, by_z), strict=True):
        value, se = found.gradient[key][0], found.standard_error[key][0]
        assert abs(value - found.value * expected) < SURE * se, key
        assert 0 < se < abs(0.3 * found.value * expected), key


def test_no_kind_is_left_out(tmp_path: Path) -> None:
    known = parameters(scene(tmp_path, LAMP))
    tested = {known[key].kind for key in (*OF_POWER, *OF_SPOT, *AT_EDGES)}
    assert tested == {each.kind for each in known.values()}
    assert len(tested) == 11

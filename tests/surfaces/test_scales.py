"""One optic at scales 1e-4 … 1e4: lengths scale, shares of the light do not, derivatives scale by their dimensions.

The ray tree is in float32, which ends at 1e-38 and 3e38; coefficients of a lens of 300 mm or of 1 µm lie beyond. Scaled
by a power of two, all numbers of the trace keep their digits, so that hardly a rounding differs.
"""

from __future__ import annotations

import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.optimize.metrics import metric as metrics

SMALL, LARGE = 2.0**-13, 2.0**13
# Strong, mild and rectangular aspheres with all coefficients
STRONG = {f"a{order}": (-1) ** (order // 2) * 0.4 * 6.0 ** (1 - order) for order in range(4, 21, 2)}
MILD = {f"a{order}": 4e-4 * 6.0 ** (1 - order) for order in range(4, 21, 2)}


def optic(scale: float) -> mi.Scene:
    """Two lenses, a barrel and a detector, `scale` times as large."""

    def sized(z: float, terms: dict[str, float], bsdf: dict[str, Any], **lengths: float) -> dict[str, Any]:
        scaled = {key: value if key == "conic" else value * scale for key, value in lengths.items()}
        scaled |= {key: a * scale ** (1 - int(key[1:])) for key, a in terms.items()}
        return {"type": "asphere", **scaled, "bsdf": bsdf, "to_world": scene_dicts.at(z * scale)}

    glass, rear = {"type": "interface", "back": "1.5"}, {"type": "interface", "front": "1.5"}
    barrel = {"r0": 5.5 * scale, "z0": -1.0 * scale, "r1": 5.5 * scale, "z1": 12.0 * scale}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0 * scale, "to_world": scene_dicts.at(-2 * scale)},
        strong_front=sized(0, STRONG, glass, radius=20.0, semi_diameter=5.0),
        mild_rear=sized(3, MILD, rear, radius=-30.0, semi_diameter=5.0, conic=-0.4),
        clipped_front=sized(6, STRONG, glass, radius=25.0, half_width=4.0, half_height=3.0),
        flat_rear=sized(9, {}, rear, semi_diameter=5.0),
        barrel={"type": "frustum", **barrel, "bsdf": {"type": "interface", "R": 0.3}},
        detector=scene_dicts.detector(25 * scale, semi_diameter=8.0 * scale),
    )


def lens(scale: float, name: str, coefficient: float, semi_diameter: float) -> mi.Scene:
    """Plane-parallel beam, one refracting asphere, a detector in the glass."""
    inside = {"type": "interface", "front": "1.5", "R": 0.0}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 0.95 * semi_diameter * scale},
        lens={
            "type": "asphere",
            "radius": 1000.0 * scale,
            name: coefficient * scale ** (1 - int(name[1:])),
            "semi_diameter": semi_diameter * scale,
            "bsdf": {"type": "interface", "back": "1.5"},
        },
        detector=scene_dicts.detector(2000.0 * scale, semi_diameter=500.0 * scale, bsdf=inside),
    )


def order_of(name: str) -> int:
    """The power of a length, in which a derivative of a power by this parameter scales with its sign turned."""
    powers = {"curvature": -1, "conic": 0, "tilt_x": 0, "tilt_y": 0, "tilt_z": 0}
    return 1 - int(name[1:]) if re.fullmatch(r"a\d+", name) else powers.get(name, 1)


@pytest.mark.parametrize("scale", [SMALL, LARGE, 1e-4, 1e4])
def test_paths(scale: float) -> None:
    one, other = (mistray.trace(optic(f), rays=2000, max_reflections=2, seed=3) for f in (1.0, scale))
    exact = scale in (SMALL, LARGE)
    rows = [{row.events: row for row in t.paths} for t in (one, other)]
    assert len(rows[0]) > 5
    if exact:
        assert rows[0].keys() == rows[1].keys()
    for key in rows[0].keys() & rows[1].keys():
        a, b = rows[0][key], rows[1][key]
        if a.rays < 100:
            continue
        share = b.power_W / other.energy.launched_W
        assert share == pytest.approx(a.power_W / one.energy.launched_W, rel=1e-6 if exact else 5e-3)
        assert b.rms_radius_mm / scale == pytest.approx(a.rms_radius_mm, rel=1e-5 if exact else 5e-3)


@pytest.mark.parametrize("scale", [SMALL, LARGE])
def test_gradients(scale: float) -> None:
    found = []
    for f in (1.0, scale):
        scene = optic(f)
        metric = metrics.rms_spot(scene, rays=2000, max_reflections=0, seed=3)
        keys = ["strong_front.a*", "clipped_front.a*", "mild_rear.curvature", "mild_rear.a*", "flat_rear.z"]
        gradient = mistray.gradient(metric, mi.traverse(scene), keys)
        found.append({key: float(np.ravel(value)[0]) for key, value in gradient.gradient.items()})
    assert len(found[0]) == 29
    for key, value in found[0].items():
        power = 1 - order_of(key.rpartition(".")[2])  # of rms radius by the parameter
        assert found[1][key] / scale**power == pytest.approx(value, rel=1e-3), key


@pytest.mark.parametrize(
    ("scale", "name", "coefficient", "semi_diameter"),
    [(1.0, "a16", 2e-40, 300.0), (1e-2, "a16", 2e-40, 300.0), (1.0, "a12", 1e-30, 300.0), (1e-4, "a20", 0.02, 1.0)],
)
def test_beyond_single_precision(scale: float, name: str, coefficient: float, semi_diameter: float) -> None:
    """The path table, in float32, against the history of all its rays, in float64, and against the lens without."""
    scene = lens(scale, name, coefficient, semi_diameter)
    t = mistray.trace(scene, rays=2000, max_reflections=0, seed=1)
    (row,) = t.paths
    history = t.history(row.path_id, n=2000).to_pandas()
    hits = history[history.surface == "detector"]
    assert len(hits) == row.rays
    exact = float(np.sqrt(np.mean(hits.x_mm**2 + hits.y_mm**2)))
    about = float(np.hypot(row.x_mm, row.y_mm))
    assert np.hypot(row.rms_radius_mm, about) == pytest.approx(exact, rel=2e-5)
    plain = mistray.trace(lens(scale, name, 0.0, semi_diameter), rays=2000, max_reflections=0, seed=1)
    assert abs(plain.paths[0].rms_radius_mm / row.rms_radius_mm - 1) > 1e-2


def test_parameters_keep_their_values() -> None:
    scene = lens(1.0, "a16", 2e-40, 300.0)
    params = mi.traverse(scene)
    assert float(params["lens.a16"][0]) == 2e-40
    before = mistray.trace(scene, rays=2000, max_reflections=0, seed=1).paths[0].rms_radius_mm
    for value in (mi.Float64(0.0), dr.opaque(mi.Float64, 2e-40)):
        params["lens.a16"] = value
        params.update()
    assert mistray.trace(scene, rays=2000, max_reflections=0, seed=1).paths[0].rms_radius_mm == before


def test_gradients_through_render() -> None:
    """The reverse pass of the integrator, where the derivative by a20 of a lens of 1 µm is 1e-80."""
    found = []
    for f in (1.0, SMALL):
        scene = optic(f)
        params = mi.traverse(scene)
        key = "strong_front.a20"
        dr.enable_grad(params[key])
        params.update()
        integrator = mi.load_dict({"type": "straylight", "rays": 2000, "max_reflections": 0, "edges": False})
        image = mi.render(scene, params, integrator=integrator)
        weight = mi.Float(np.arange(64.0))
        dr.backward(dr.sum(image.array * weight))
        found.append(float(dr.grad(params[key])[0]))
    assert found[0] != 0
    assert found[1] / SMALL**19 == pytest.approx(found[0], rel=1e-3)

"""Beams that just fill a rim: the derivatives on both sides against closed forms, and who refuses to add them."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, meter

import mistray
from mistray.errors import MistrayError
from mistray.gradients.full.full_rims import FullRims
from mistray.metrics.gradient import chosen_parameters, gradient_request, gradient_seen
from mistray.optimize import path_power, sensitivity

RADIUS, RAYS = 8.0, 20_000
ERRORS = 4.0  # of the traces: they are passed once in 1.6e4 sides; seeds are fixed


def detector(**size: float):
    return {"type": "asphere", "z": 40.0, **(size or {"semi_diameter": 60.0}), "bsdf": BLACK, "sensor": meter(16)}


def plate(radius: float = RADIUS, z: float = 10.0):
    return {"type": "frustum", "r0": 50.0, "z0": z, "r1": radius, "z1": z, "bsdf": BLACK}


def beam(**size: float):
    return {"type": "collimated", **(size or {"radius": RADIUS})}


def all_light(scene, **settings):
    return path_power(scene, "all", **settings)


def built(source, **parts):
    return lit(source, **{"detector": detector(), **parts})


def derived(keys, source, **parts):
    scene = built(source, **parts)
    return mistray.gradient(all_light(scene, rays=RAYS), mi.traverse(scene), keys)


def agrees(side, expected: float) -> bool:
    return side.se > 0 and abs(side.value - expected) < ERRORS * side.se


def agree(sides, below: float, above: float) -> bool:
    return agrees(sides[0], below) and agrees(sides[1], above)


def has(found, key: str, expected: float) -> bool:
    """A derivative without sides."""
    return abs(found.gradient[key][0] - expected) < ERRORS * found.standard_error[key][0]


def test_a_stop_that_its_beam_just_fills_has_a_derivative_on_each_side():
    """T = (r/R)² as the stop closes, 1 as it opens; shifted by x it loses 2 x/(πR) of the light, whichever way."""
    found = derived(["stop.r1", "stop.x", "stop.z"], beam(), stop=plate())
    assert set(found.full) == {"stop.r1", "stop.x"}  # along the beam nothing changes
    assert agree(found.one_sided["stop.r1"], 2 / RADIUS, 0.0)
    assert agree(found.one_sided["stop.x"], 2 / (math.pi * RADIUS), -2 / (math.pi * RADIUS))
    # Never a number that could be added to others
    assert np.all(np.isnan(found.gradient["stop.r1"]))
    assert np.all(np.isnan(found.standard_error["stop.x"]))
    (said,) = [text for text in found.left_out if "inner rim of 'stop'" in text]
    assert "widen the source" in said
    assert "below" in str(found)
    scene = built(beam(), stop=plate())  # with visibility held nothing is looked for
    found = mistray.gradient(all_light(scene, rays=640), mi.traverse(scene), ["stop.r1"], edges=False)
    assert not found.full
    assert not found.one_sided
    mistray.gradient(all_light(scene, rays=640), mi.traverse(scene), ["stop.r1"])
    assert float(mi.traverse(scene)["stop.r1"][0]) == RADIUS  # the scene stays


@pytest.mark.parametrize("wider", [-0.02, 0.001, 0.01, 0.03])
def test_a_beam_that_is_a_little_wider_has_an_honest_derivative(wider):
    """T = (r/R)² on both sides: the zone ends before the edge of the beam. Within 0.5 % the rim counts as filled."""
    radius = RADIUS * (1 + wider)
    found = derived(["stop.r1"], beam(radius=radius), stop=plate())
    expected = 2 * RADIUS / radius**2
    if 0 < wider < 0.005:
        assert agrees(found.one_sided["stop.r1"].below, expected)
        return
    assert not found.full
    if wider < 0:  # it does not meet the stop
        assert found.gradient["stop.r1"][0] == 0.0
        return
    assert has(found, "stop.r1", expected)


def test_a_rectangular_beam_fills_two_sides_of_a_rectangle():
    """The detector is 3 × 4, the beam 3 × 5: T = w h/15, on one side only in w; the other two sides are overfilled."""
    keys = ["detector.half_width", "detector.half_height", "detector.x"]
    found = derived(keys, beam(half_width=3.0, half_height=5.0), detector=detector(half_width=3.0, half_height=4.0))
    assert set(found.full) == {"detector.half_width", "detector.x"}
    assert agree(found.one_sided["detector.half_width"], 4 / 15, 0.0)
    assert has(found, "detector.half_height", 3 / 15)


def test_the_cone_of_a_near_source_fills_a_stop():
    """Of a cone of half angle α the stop takes (1 - cos θ)/(1 - cos α) with tan θ = r/L."""
    distance, alpha = 30.0, math.atan(RADIUS / 40.0)
    source = {"type": "point_source", "z": -distance, "half_angle_deg": math.degrees(alpha)}
    found = derived(["stop.r1", "lamp.z", "lamp.half_angle_deg"], source, stop=plate())
    by_angle = math.sin(alpha) / (1 - math.cos(alpha))
    assert agree(found.one_sided["stop.r1"], by_angle * math.cos(alpha) ** 2 / 40.0, 0.0)
    # farther away the stop takes less
    assert agree(found.one_sided["lamp.z"], by_angle * math.sin(alpha) * math.cos(alpha) / 40.0, 0.0)


def test_an_annular_beam_fills_an_obscuration():
    """A disc in the dark centre of the beam: as it grows it takes 2 b/(a² - b²) of the light."""
    a, b = 10.0, 4.0
    disc = {"type": "frustum", "r0": b, "z0": 10.0, "r1": 0.0, "z1": 10.0, "bsdf": BLACK}
    found = derived(["disc.r0"], beam(radius=a, inner_radius=b), disc=disc)
    assert agree(found.one_sided["disc.r0"], 0.0, -2 * b / (a * a - b * b))


def test_the_rim_of_an_optical_surface_and_keys_that_do_not_move_it():
    """A sheet that passes half of the light, of the size of the beam: as it gets smaller, more light goes past it."""
    half = {"type": "interface", "front": "air", "back": "air", "coating": {"type": "thinfilm", "R": 0.3, "T": 0.5}}
    sheet = {"type": "asphere", "semi_diameter": RADIUS, "z": 20.0, "bsdf": half}
    keys = ["sheet.bsdf.coating.T", "sheet.semi_diameter", "stop.r1"]
    found = derived(keys, beam(), stop=plate(RADIUS + 0.5), sheet=sheet)
    assert set(found.full) == {"sheet.semi_diameter"}
    assert found.gradient["sheet.bsdf.coating.T"][0] == pytest.approx(1.0, rel=1e-5)
    assert found.gradient["stop.r1"][0] == 0.0  # the beam does not come there
    assert agree(found.one_sided["sheet.semi_diameter"], -2 / RADIUS * (1 - 0.5), 0.0)


def test_an_edge_that_crosses_a_rim_is_no_full_rim():
    """A square beam about a round stop crosses it at eight points, at 37°: d T/d r is that of the arcs within it."""
    half = 0.9 * RADIUS
    found = derived(["stop.r1"], beam(half_width=half, half_height=half), stop=plate())
    assert not found.full
    lit = 2 * math.pi - 8 * math.acos(half / RADIUS)
    expected = lit * RADIUS / (4 * half * half)
    assert has(found, "stop.r1", expected)


@pytest.mark.parametrize(
    "source",
    [
        {"type": "point_source", "z": -30.0},
        {"type": "point_source", "z": -30.0, "profile": "0:1, 11.3:0"},
        {"type": "surface_source", "radius": RADIUS, "z": -30.0},
        {"type": "gaussian_beam", "waist_x": RADIUS, "waist_y": RADIUS, "z": -30.0},
        {"type": "sky"},
    ],
)
def test_light_without_an_edge_fills_nothing(source):
    """Rays that a source aims at a lens end there, its light does not."""
    run = mistray.trace(built(source, stop=plate()), rays=640).runs[0]
    assert not FullRims(run.source, run.table, 0.05).full


def test_what_adds_derivatives_refuses_them():
    scene = built(beam(), stop=plate())
    metric = all_light(scene, rays=2000)
    chosen = chosen_parameters(scene, mi.traverse(scene), ["stop.r1"])
    with pytest.raises(MistrayError, match=r"'stop\.r1'.*inner rim of 'stop'.*widen the source"):
        gradient_seen(metric, metric.observe(), chosen, gradient_request(chosen.values()))
    with pytest.raises(MistrayError, match=r"'stop\.r1'.*widen the source"):
        sensitivity(metric, keys=["stop.r1", "stop.z"], check=False)
    # By itself it takes what has a derivative, and says what has none
    table = sensitivity(metric, check=False)
    assert all("stop.r1" not in row.line.keys for row in table.rows)
    assert any("stop.r1" in text and "widen the source" in text for text in table.left_out)

"""Derivatives of metrics by ideal coatings: closed forms, seeds, `mi.render`, and what must raise."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

import mistray
from mistray.optimize import ghost_to_signal, gradient, image_metric, parameters, path_power

SIDE = 20.0  # mm, where the face of the prism sends the light
FRONT_R, FRONT_T, REAR_R, REAR_T = (f"p0_{face}.bsdf.{what}" for face in ("front", "rear") for what in "RT")

R, T = 0.1, 0.8
GHOST = {FRONT_R: T * R * T, REAR_R: T * R * T, FRONT_T: R * R * T, REAR_T: R * R * T}


@pytest.fixture(scope="module")
def plate(load_scene) -> Any:
    return load_scene(plates_text(1, R=R, T=T))


@pytest.fixture(scope="module")
def before_mirror(load_scene) -> Any:
    """The plate before a detector that reflects a fifth."""
    black = '<float name="R" value="{}"/></bsdf><sensor'
    return load_scene(plates_text(1, R=R, T=T).replace(black.format(0.0), black.format(0.2)))


class TestClosedForms:
    """Plate with R, T on either face: direct T1 T2, ghost T1 R2 R1 T2."""

    def test_ghost(self, plate) -> None:
        """Of the ghost, of the direct path, to which the others must not leak, and of their ratio, R1 R2 whatever T."""
        traced, params = {"rays": 256, "max_reflections": 2}, mi.traverse(plate)
        g = gradient(path_power(plate, "ghost", **traced), params)
        assert g.value == pytest.approx(T * R * R * T, rel=1e-6)
        for key, value in GHOST.items():
            assert g.gradient[key] == pytest.approx([value], rel=2e-6), key
            assert g.standard_error[key] == pytest.approx([0.0], abs=1e-6), key
        g = gradient(path_power(plate, "direct", **traced), params)
        assert g.gradient[FRONT_T] == pytest.approx([0.8], rel=2e-6)
        assert g.gradient[FRONT_R] == pytest.approx([0.0], abs=1e-12)
        g = gradient(ghost_to_signal(plate, **traced), params)
        assert g.value == pytest.approx(0.01, rel=1e-6)
        assert g.gradient[FRONT_R] == pytest.approx([0.1], rel=3e-6)
        assert g.gradient[FRONT_T] == pytest.approx([0.0], abs=1e-7)

    def test_all_orders(self, plate) -> None:
        """T1 T2/(1 - R1 R2), followed to order 20."""
        traced = {"rays": 64, "max_reflections": 20, "flux_threshold": 0.0}
        g = gradient(path_power(plate, "all", **traced), mi.traverse(plate))
        assert g.value == pytest.approx(T * T / (1 - R * R), rel=1e-6)
        assert g.gradient[FRONT_R] == pytest.approx([T * T * R / (1 - R * R) ** 2], rel=3e-6)
        assert g.gradient[REAR_T] == pytest.approx([T / (1 - R * R)], rel=3e-6)

    def test_reflecting_detector(self, before_mirror) -> None:
        """The detector absorbs 1 - R_d; its own reflection feeds the next order of the ghosts."""
        traced = {"rays": 64, "max_reflections": 2, "flux_threshold": 0.0}
        g = gradient(path_power(before_mirror, lambda row: row.order <= 0, **traced), mi.traverse(before_mirror))
        assert g.gradient["detector.bsdf.R"] == pytest.approx([-(0.8**2)], rel=2e-6)
        assert "detector.bsdf.T" not in g.gradient, "an opaque surface has no T"

    def test_image(self, plate) -> None:
        """Mean irradiance is the detected power over the area."""
        traced = {"rays": 256, "max_reflections": 2}
        image = gradient(image_metric(plate, lambda e: dr.mean(e) * 100.0**2, **traced), mi.traverse(plate))
        power = gradient(path_power(plate, "all", **traced), mi.traverse(plate))
        for key in (FRONT_R, REAR_T):
            assert image.gradient[key] == pytest.approx(np.pi * power.gradient[key], rel=1e-5)

    def test_total_reflection(self, load_scene) -> None:
        """Beyond the critical angle an ideal coating reflects R + T: both derivatives are the same."""

        def turned(shape: str, angle: int, y: float = 0.0) -> str:
            return shape.replace("<translate", f'<rotate x="1" angle="{angle}"/><translate y="{y}"')

        wide = {"half_width": 20.0, "half_height": 20.0}
        inside = interface_xml("1.7", "air", R=0.1, T=0.6)
        scene = load_scene(
            scene_text(
                shape_xml("asphere", "entrance", 0.0, interface_xml("air", "1.7", R=0.0, T=1.0), semi_diameter=20.0),
                turned(shape_xml("asphere", "face", 20.0, inside, half_width=30.0, half_height=30.0), 45),
                turned(shape_xml("asphere", "detector", 20.0, sensor=True, **wide), 90, SIDE),
                turned(shape_xml("asphere", "other", 20.0, **wide), 90, -SIDE),
            )
        )
        g = gradient(path_power(scene, "all", rays=64), mi.traverse(scene))
        assert g.value == pytest.approx(0.7, rel=1e-6)
        for name in "RT":
            assert g.gradient[f"face.bsdf.{name}"] == pytest.approx([1.0], rel=1e-6)


class TestStatistics:
    def test_sampled_trees(self, plate) -> None:
        """One child at random and Russian roulette keep it unbiased: 8 comparisons at 4.5 σ, false alarm 6e-5."""
        for how in ({"splitting": "one"}, {"below_threshold": "roulette", "flux_threshold": 0.05}):
            g = gradient(path_power(plate, "ghost", rays=200_000, max_reflections=2, **how), mi.traverse(plate))
            for key, value in GHOST.items():
                assert g.standard_error[key][0] > 0
                assert abs(g.gradient[key][0] - value) < 4.5 * g.standard_error[key][0], (how, key)

    @pytest.mark.long
    def test_standard_errors(self) -> None:
        """Over 40 seeds the spread is the error: χ² with 39 degrees of freedom, false-alarm probability 1e-6 each."""
        scene = mistray.load("phone_camera")
        params = mi.traverse(scene)
        keys = ["window_rear.bsdf.R", "detector.bsdf.R"]
        runs = [
            gradient(path_power(scene, "ghost", rays=500, field_deg=10.0, seed=seed, flux_threshold=1e-5), params, keys)
            for seed in range(40)
        ]
        values = np.array([[g.value, *(g.gradient[key][0] for key in keys)] for g in runs])
        errors = np.array([[g.value_se, *(g.standard_error[key][0] for key in keys)] for g in runs])
        ratio = values.var(axis=0, ddof=1) / np.mean(errors**2, axis=0)
        assert np.all(ratio < 2.7), ratio
        assert np.all(ratio > 0.24), ratio


def test_backward_and_chain_rule_before_the_scene(plate) -> None:
    """`dr.backward` through `mi.render`; a number computed from another one passes its derivative on."""
    params = mi.traverse(plate)
    before = {key: mi.Float(params[key]) for key in (FRONT_R, REAR_T)}
    half, t = mi.Float(R / 2), mi.Float(T)
    dr.enable_grad(half, t)
    params[FRONT_R], params[REAR_T] = 2 * half, t
    params.update()
    image = mi.render(plate, params, integrator=mi.load_dict({"type": "straylight", "rays": 256}))
    dr.backward(dr.sum(image.array))
    area = (100.0 / 64) ** 2 / np.pi
    for key, value in before.items():
        params[key] = value
    params.update()
    assert np.array(dr.grad(half))[0] * area == pytest.approx(2 * T * R * T, rel=1e-5)
    assert np.array(dr.grad(t))[0] * area == pytest.approx(T + R * R * T, rel=1e-5)


def test_walk_in_reverse_and_replay(before_mirror) -> None:
    """Coatings alone take the walk in reverse, with anything else the replay: both give the same derivatives."""
    metric, params = path_power(before_mirror, "ghost", rays=256, max_reflections=4), mi.traverse(before_mirror)
    coatings = [key for key, p in parameters(before_mirror).items() if p.kind == "share"]
    alone = gradient(metric, params, coatings)
    together = gradient(metric, params, [*coatings, "p0_front.curvature"], edges=False)
    assert len(coatings) > 3
    for key in coatings:
        assert together.gradient[key] == pytest.approx(alone.gradient[key], rel=1e-5), key
        assert together.standard_error[key] == pytest.approx(alone.standard_error[key], rel=1e-3, abs=1e-9), key


def test_what_has_no_derivative(plate) -> None:
    params, metric = mi.traverse(plate), path_power(plate, "ghost", rays=16)
    stokes = path_power(plate, "ghost", rays=16, polarization="stokes")
    for refused, key, more, message in (
        (metric, "p0_front.curvatur", {}, r"no parameter 'p0_front\.curvatur' .*p0_front\.curvature"),
        (metric, "p0_front.silhouette_sampling_weight", {}, r"no parameter 'p0_front\.silhouette_sampling"),
        (metric, "p0_front.curvature", {"edge_width": 0.0}, "edge_width is 0"),
        (stokes, "p0_front.bsdf.R", {}, "polarization='unpolarized'"),
        (stokes, "p0_front.curvature", {}, "polarization='unpolarized'"),
    ):
        with pytest.raises(mistray.MistrayError, match=message):
            gradient(refused, params, [key], **more)
    dr.enable_grad(params["p0_front.vertex_positions"])
    image = mi.render(plate, params, integrator=mi.load_dict({"type": "straylight", "rays": 16}))
    with pytest.raises(mistray.MistrayError, match=r"no derivative by 'p0_front\.vertex_positions'"):
        dr.backward(dr.sum(image.array))
    dr.disable_grad(params["p0_front.vertex_positions"])
    params.keep(["p0_front.silhouette_sampling_weight"])
    with pytest.raises(mistray.MistrayError, match="no parameter to differentiate by"):
        gradient(metric, params)


def test_parameters_that_no_ray_depends_on_are_named_in_one_line(plate) -> None:
    result = gradient(path_power(plate, "direct", rays=16), mi.traverse(plate), [FRONT_R, REAR_R, FRONT_T])
    assert result.untouched == [FRONT_R, REAR_R]
    lines = str(result).splitlines()
    assert lines[1].startswith(f"d/d {FRONT_T}[0]")
    assert all(key in lines[2] for key in result.untouched)

"""Derivatives of metrics by ideal coatings: closed forms, seeds, `mi.render`, and what must raise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

import mistray
from mistray.optimize import ghost_to_signal, gradient, image_metric, parameters, path_power
from mistray.recorders import adjoint

FRONT_R, FRONT_T, REAR_R, REAR_T = (f"p0_{face}.bsdf.{what}" for face in ("front", "rear") for what in "RT")


def coated_plate(detector_r: float = 0.0) -> str:
    text = plates_text(1, R=0.1, T=0.8)
    return text.replace(
        '<float name="R" value="0.0"/></bsdf><sensor', f'<float name="R" value="{detector_r}"/></bsdf><sensor'
    )


class TestClosedForms:
    """Plate with R, T on either face: direct T1 T2, ghost T1 R2 R1 T2."""

    def test_ghost(self, load_scene) -> None:
        scene = load_scene(coated_plate())
        g = gradient(path_power(scene, "ghost", rays=256, max_reflections=2), mi.traverse(scene))
        R, T = 0.1, 0.8
        assert g.value == pytest.approx(T * R * R * T, rel=1e-6)
        expected = {FRONT_R: T * R * T, REAR_R: T * R * T, FRONT_T: R * R * T, REAR_T: R * R * T}
        for key, value in expected.items():
            assert g.gradient[key] == pytest.approx([value], rel=2e-6), key
            assert g.standard_error[key] == pytest.approx([0.0], abs=1e-6), key

    def test_direct_path_alone(self, load_scene) -> None:
        """The other paths must not leak into the gradient of one."""
        scene = load_scene(coated_plate())
        g = gradient(path_power(scene, "direct", rays=256, max_reflections=2), mi.traverse(scene))
        assert g.gradient[FRONT_T] == pytest.approx([0.8], rel=2e-6)
        assert g.gradient[FRONT_R] == pytest.approx([0.0], abs=1e-12)

    def test_all_orders(self, load_scene) -> None:
        """T1 T2/(1 - R1 R2), followed to order 20."""
        scene = load_scene(coated_plate())
        traced = {"rays": 64, "max_reflections": 20, "flux_threshold": 0.0}
        g = gradient(path_power(scene, "all", **traced), mi.traverse(scene))
        R, T = 0.1, 0.8
        assert g.value == pytest.approx(T * T / (1 - R * R), rel=1e-6)
        assert g.gradient[FRONT_R] == pytest.approx([T * T * R / (1 - R * R) ** 2], rel=3e-6)
        assert g.gradient[REAR_T] == pytest.approx([T / (1 - R * R)], rel=3e-6)

    def test_reflecting_detector(self, load_scene) -> None:
        """The detector absorbs 1 - R_d; its own reflection feeds the next order of the ghosts."""
        scene = load_scene(coated_plate(0.2))
        traced = {"rays": 64, "max_reflections": 2, "flux_threshold": 0.0}
        g = gradient(path_power(scene, lambda row: row.order <= 0, **traced), mi.traverse(scene))
        assert g.gradient["detector.bsdf.R"] == pytest.approx([-(0.8**2)], rel=2e-6)
        # An opaque surface has no T
        assert "detector.bsdf.T" not in g.gradient

    def test_ratio(self, load_scene) -> None:
        """Ghost over signal is R1 R2, whatever T."""
        scene = load_scene(coated_plate())
        g = gradient(ghost_to_signal(scene, rays=256, max_reflections=2), mi.traverse(scene))
        assert g.value == pytest.approx(0.01, rel=1e-6)
        assert g.gradient[FRONT_R] == pytest.approx([0.1], rel=3e-6)
        assert g.gradient[FRONT_T] == pytest.approx([0.0], abs=1e-7)

    def test_image(self, load_scene) -> None:
        """Mean irradiance is the detected power over the area."""
        scene = load_scene(coated_plate())
        traced = {"rays": 256, "max_reflections": 2}
        area = 100.0**2
        image = gradient(image_metric(scene, lambda e: dr.mean(e) * area, **traced), mi.traverse(scene))
        power = gradient(path_power(scene, "all", **traced), mi.traverse(scene))
        for key in (FRONT_R, REAR_T):
            assert image.gradient[key] == pytest.approx(np.pi * power.gradient[key], rel=1e-5)

    def test_total_reflection(self, load_scene) -> None:
        """Beyond the critical angle an ideal coating reflects R + T: both derivatives are the same."""
        prism = [
            shape_xml("asphere", "entrance", 0.0, interface_xml("air", "1.7", R=0.0, T=1.0), semi_diameter=20.0),
            shape_xml("asphere", "face", 20.0, interface_xml("1.7", "air", R=0.1, T=0.6), half_width=30.0,
                      half_height=30.0).replace("<translate", '<rotate x="1" angle="45"/><translate'),
            shape_xml("asphere", "detector", 20.0, sensor=True, half_width=20.0, half_height=20.0).replace(
                '<translate z="20.0"/>', '<rotate x="1" angle="90"/><translate y="20" z="20"/>'),
            shape_xml("asphere", "other", 20.0, sensor=False, half_width=20.0, half_height=20.0).replace(
                '<translate z="20.0"/>', '<rotate x="1" angle="90"/><translate y="-20" z="20"/>'),
        ]  # fmt: skip
        scene = load_scene(scene_text(*prism))
        params = mi.traverse(scene)
        metric = path_power(scene, "all", rays=64)
        if metric.value() == 0:  # the face reflects towards the other side
            scene = load_scene(scene_text(*(text.replace('y="20"', 'y="swap"').replace('y="-20"', 'y="20"').replace(
                'y="swap"', 'y="-20"') for text in prism)))  # fmt: skip
            params = mi.traverse(scene)
            metric = path_power(scene, "all", rays=64)
        g = gradient(metric, params)
        assert g.value == pytest.approx(0.7, rel=1e-6)
        assert g.gradient["face.bsdf.R"] == pytest.approx([1.0], rel=1e-6)
        assert g.gradient["face.bsdf.T"] == pytest.approx([1.0], rel=1e-6)


class TestStatistics:
    def test_sampled_trees(self, load_scene) -> None:
        """One child at random and Russian roulette keep the gradient unbiased: within 4.5 standard errors.

        False-alarm probability: 8 comparisons at 4.5 σ, 6e-5.
        """
        scene = load_scene(coated_plate())
        R, T = 0.1, 0.8
        expected = {FRONT_R: T * R * T, REAR_R: T * R * T, FRONT_T: R * R * T, REAR_T: R * R * T}
        for how in ({"splitting": "one"}, {"below_threshold": "roulette", "flux_threshold": 0.05}):
            g = gradient(path_power(scene, "ghost", rays=200_000, max_reflections=2, **how), mi.traverse(scene))
            for key, value in expected.items():
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


class TestRender:
    def test_backward_equals_gradient(self, load_scene) -> None:
        """`dr.backward` through `mi.render` and `mistray.gradient` of the same sum."""
        scene = load_scene(coated_plate())
        params = mi.traverse(scene)
        params.keep([FRONT_R, REAR_T])
        for key in list(params.keys()):
            dr.enable_grad(params[key])
        params.update()
        image = mi.render(scene, params, integrator=mi.load_dict({"type": "straylight", "rays": 256}))
        dr.backward(dr.sum(image.array))
        area = (100.0 / 64) ** 2
        R, T = 0.1, 0.8
        by_r = np.array(dr.grad(params[FRONT_R]))[0] * area / np.pi
        by_t = np.array(dr.grad(params[REAR_T]))[0] * area / np.pi
        assert by_r == pytest.approx(T * R * T, rel=1e-5)
        assert by_t == pytest.approx(T + R * R * T, rel=1e-5)

    def test_chain_rule_before_the_scene(self, load_scene) -> None:
        """A parameter computed from another one passes its gradient on."""
        scene = load_scene(coated_plate())
        params = mi.traverse(scene)
        x = mi.Float(0.05)
        dr.enable_grad(x)
        params[FRONT_R] = 2 * x
        params.update()
        image = mi.render(scene, params, integrator=mi.load_dict({"type": "straylight", "rays": 256}))
        dr.backward(dr.sum(image.array))
        assert np.array(dr.grad(x))[0] * (100.0 / 64) ** 2 / np.pi == pytest.approx(2 * 0.8 * 0.1 * 0.8, rel=1e-5)

    def test_a_wrong_adjoint_is_seen(self, load_scene, monkeypatch: pytest.MonkeyPatch) -> None:
        """The comparisons above can fail: they do when only the last event of a finished branch is closed."""
        scene = load_scene(coated_plate())
        back = adjoint.Adjoint.back

        def wrong(self: Any, one: Any, memory: Any) -> None:
            last = dr.maximum(one.last, one.depth - 1)
            back(self, replace(one, last=last, active=one.active & (one.depth > 0)), memory)

        monkeypatch.setattr(adjoint.Adjoint, "back", wrong)
        g = gradient(path_power(scene, "ghost", rays=256), mi.traverse(scene), [FRONT_T])
        assert abs(g.gradient[FRONT_T][0] / 0.008 - 1) > 0.01


class TestTwoWays:
    def test_walk_in_reverse_and_replay(self, load_scene) -> None:
        """Coatings alone take the walk in reverse, with anything else the replay: both give the same derivatives."""
        scene = load_scene(coated_plate(0.2))
        metric, params = path_power(scene, "ghost", rays=256, max_reflections=4), mi.traverse(scene)
        coatings = [key for key, p in parameters(scene).items() if p.kind == "share"]
        alone = gradient(metric, params, coatings)
        together = gradient(metric, params, [*coatings, "p0_front.curvature"], edges=False)
        assert len(coatings) > 3
        for key in coatings:
            assert together.gradient[key] == pytest.approx(alone.gradient[key], rel=1e-5), key
            assert together.standard_error[key] == pytest.approx(alone.standard_error[key], rel=1e-3, abs=1e-9), key


class TestRefusals:
    def test_what_has_no_derivative(self, load_scene) -> None:
        scene = load_scene(coated_plate())
        params = mi.traverse(scene)
        metric = path_power(scene, "ghost", rays=16)
        with pytest.raises(mistray.MistrayError, match=r"no parameter 'p0_front\.curvatur' .*p0_front\.curvature"):
            gradient(metric, params, ["p0_front.curvatur"])
        with pytest.raises(mistray.MistrayError, match=r"no parameter 'p0_front\.silhouette_sampling_weight'"):
            gradient(metric, params, ["p0_front.silhouette_sampling_weight"])
        with pytest.raises(mistray.MistrayError, match="edge_width is 0"):
            gradient(metric, params, ["p0_front.curvature"], edge_width=0.0)
        for keys in (["p0_front.bsdf.R"], ["p0_front.curvature"]):
            with pytest.raises(mistray.MistrayError, match="polarization='unpolarized'"):
                gradient(path_power(scene, "ghost", rays=16, polarization="stokes"), params, keys)
        with pytest.raises(mistray.MistrayError, match="'phantom' is no kind of path"):
            path_power(scene, "phantom", rays=16).value()
        dr.enable_grad(params["p0_front.vertex_positions"])
        image = mi.render(scene, params, integrator=mi.load_dict({"type": "straylight", "rays": 16}))
        with pytest.raises(mistray.MistrayError, match=r"no derivative by 'p0_front\.vertex_positions'"):
            dr.backward(dr.sum(image.array))

    def test_scene_without_parameters(self, load_scene) -> None:
        scene = load_scene(plates_text(1))
        params = mi.traverse(scene)
        params.keep(["p0_front.silhouette_sampling_weight"])
        with pytest.raises(mistray.MistrayError, match="no parameter to differentiate by"):
            gradient(path_power(scene, "ghost", rays=16), params)

    def test_functions_of_several_numbers(self, load_scene) -> None:
        metric = image_metric(load_scene(coated_plate()), lambda e: e, rays=16)
        with pytest.raises(mistray.MistrayError, match="returned 4096 values"):
            metric.value()


def test_parameters_that_no_ray_depends_on_are_named_in_one_line() -> None:
    from mistray.optimize.gradient import Gradient

    zero, one = np.zeros((32, 2)), np.ones((32, 1)) / 32
    keys = {"rim.r0": zero, "wall.z": zero, "L1.R": one}
    result = Gradient(1.0, 0.1, np.zeros(32), keys, None, 0, {}, {}, {}, [], (0.0, 0.0))
    assert result.untouched == ["rim.r0", "wall.z"]
    lines = str(result).splitlines()
    assert len(lines) == 3
    assert lines[1].startswith("d/d L1.R[0]")
    assert all(key in lines[2] for key in result.untouched)

"""Limits of a path in closed form: hits in a row and in all, levels of ancestry, operations, absorption."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import pytest
from oracles.scatter_scenes import (
    beam_xml,
    bsdf_xml,
    placed_xml,
    scatter_scene,
    scattering_xml,
    sphere_text,
)
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z

import mistray
from mistray import MistrayError
from mistray.optimize import gradient, path_power
from mistray.trace import Settings

R, T = 0.1, 0.9
CLOSURE = 1e-7  # R and T are numbers of 24 bits in the kernel


def energy(scene: Any, rays: int = 1000, **settings: Any) -> Any:
    """Energy of a trace that closes, as shares of what was launched."""
    found = mistray.trace(scene, rays=rays, **({"flux_threshold": 0.0} | settings)).energy
    assert abs(found.closure) < CLOSURE
    return found


def cut(found: Any, reason: str) -> float:
    return float(found.cut[reason] / found.launched_W)


def plate(load_scene: Any) -> Any:
    """Two surfaces that reflect 10 %, and a black detector behind them."""
    return load_scene(plates_text(1, "air", R=R, T=T))


def rod(load_scene: Any, half_angle_deg: float = 40.0) -> Any:
    """A glass rod between two planes, with a beam that goes in aslant and zigzags by total reflection at its side."""
    return load_scene(
        scatter_scene(
            beam_xml(0.4, field_deg=half_angle_deg),
            placed_xml("asphere", "front", interface_xml("air", "1.5", R=0.0, T=1.0), semi_diameter=1.0),
            placed_xml("frustum", "side", interface_xml("1.5", "air", R=0.0, T=1.0), r0=1.0, z0=0.0, r1=1.0, z1=200.0),
            placed_xml("asphere", "detector", at=(0.0, 0.0, 200.0), pixels=8, semi_diameter=1.0),
        )
    )


class TestHitsInARow:
    @pytest.mark.parametrize("most", [1, 2, 7])
    def test_mirror_tube(self, load_scene, most: int) -> None:
        """A ray that zigzags in a long tube of reflectance ρ leaves ρ^k after k hits of its wall."""
        rho, tube = 0.8, {"r0": 1.0, "z0": 0.0, "r1": 1.0, "z1": 200.0}
        front = interface_xml(R=0.0)
        scene = load_scene(
            scatter_scene(
                beam_xml(0.4, field_deg=40.0),
                placed_xml("frustum", "wall", interface_xml(R=rho, mirror=True), **tube),
                placed_xml("asphere", "detector", front, at=(0.0, 0.0, 200.0), pixels=8, semi_diameter=1.0),
            )
        )
        found = energy(scene, max_consecutive=most)
        assert cut(found, "max_consecutive") == pytest.approx(rho**most, rel=1e-5)
        assert found.absorbed["wall"][0] / found.launched_W == pytest.approx(1 - rho**most, rel=1e-5)

    def test_light_guide(self, load_scene) -> None:
        """Total reflections count as well, and the plane before them does not."""
        scene = rod(load_scene)
        for most in (1, 5):
            found = energy(scene, max_consecutive=most)
            assert cut(found, "max_consecutive") == pytest.approx(1.0, rel=1e-6)
            t = mistray.trace(scene, rays=500, max_consecutive=most)
            assert t.segments == 500 * (2 + most)
        assert energy(scene, max_events=1000).detected_W == pytest.approx(found.launched_W, rel=1e-6)

    @pytest.mark.parametrize("splitting", ["split", "one"])
    def test_integrating_sphere(self, load_scene, splitting: str) -> None:
        """False alarm 3e-7: of the light that a wall sends on, 1 - f meets it again, k times at most; within 5 SE."""
        rho, port, most = 0.9, 0.2, 3
        scene = load_scene(sphere_text(rho, port))
        found = energy(
            scene, rays=20_000, max_consecutive=most, max_scatters=60, aim="none", scatter_threshold=0.0,
            splitting=splitting,
        )  # fmt: skip
        q = rho * (1 - port)
        wall, se = found.absorbed["wall"]
        assert_z("wall", wall / found.launched_W, (1 - rho) * (1 - q**most) / (1 - q), se / found.launched_W, k=5.0)
        detected = rho * port * (1 - q**most) / (1 - q)
        assert_z("port", found.detected_W / found.launched_W, detected, found.detected_se_W / found.launched_W, k=5.0)
        assert cut(found, "max_consecutive") == pytest.approx(q**most, rel=0.03)

    def test_surfaces_in_turn_are_no_run(self, load_scene) -> None:
        scene = plate(load_scene)
        free, limited = (energy(scene, max_reflections=8, max_consecutive=k) for k in (1000, 1))
        assert limited.cut["max_consecutive"] == 0
        assert limited.detected_W == pytest.approx(free.detected_W, rel=1e-14)  # threads add in any order

    def test_a_branch_that_comes_later_knows_its_run(self, load_scene) -> None:
        """In a glass tube whose wall sends R inwards and T outwards, all that stays inside ends at the same hit."""
        side = interface_xml("air", "air", R=0.6, T=0.4)
        scene = load_scene(
            scatter_scene(
                beam_xml(0.4, field_deg=40.0),
                placed_xml("frustum", "wall", side, r0=1.0, z0=0.0, r1=1.0, z1=200.0),
                placed_xml("asphere", "detector", at=(0.0, 0.0, 300.0), pixels=8, semi_diameter=1.0),
            )
        )
        found = energy(scene, max_consecutive=4, max_reflections=30)
        assert cut(found, "max_consecutive") == pytest.approx(0.6**4, rel=1e-5)
        assert found.escaped_W / found.launched_W == pytest.approx(1 - 0.6**4, rel=1e-5)


class TestLongPaths:
    def test_a_resonator_of_a_thousand_events(self, load_scene) -> None:
        """Two surfaces of R = 0.99: orders of the geometric series up to the event that is allowed."""
        r, t = 0.99, 0.01
        scene = load_scene(plates_text(1, "air", R=r, T=t))
        found = energy(scene, rays=64, max_events=1000, max_reflections=1000)
        # The orders n = 0, 2, … meet n + 2 surfaces and then the detector; n + 3 ≤ 1000
        orders = range(0, 998, 2)
        assert found.detected_W / found.launched_W == pytest.approx(sum(t * t * r**n for n in orders), rel=1e-4)
        assert len(mistray.trace(scene, rays=64, max_events=1000, max_reflections=1000, flux_threshold=0).paths) == 499
        default = energy(scene, rays=64, max_reflections=1000)
        assert default.cut["max_events"] > found.cut["max_events"] > 0

    @pytest.mark.long
    def test_more_nodes_wait_than_a_word_has_bits(self, load_scene) -> None:
        """35 plates: at each of 70 surfaces a reflected child waits, and those of the last ones are 140 events long."""
        r, t = 2**-10, 1 - 2**-10  # exact in the kernel
        scene = load_scene(plates_text(35, "air", R=r, T=t))
        found = energy(scene, rays=64, max_events=200, max_reflections=1)
        assert found.detected_W / found.launched_W == pytest.approx(t**70, rel=1e-5)
        assert found.escaped_W / found.launched_W == pytest.approx(sum(r * t ** (2 * j) for j in range(70)), rel=1e-5)
        assert found.cut["max_events"] == 0

    def test_scatter_events_are_counted_beyond_255(self, load_scene) -> None:
        """A closed white sphere in which 300 events are allowed, and happen to all but the few rays that graze it."""
        scene = load_scene(sphere_text(1.0, 1e-6))
        settings = {"max_events": 1000, "scatter_threshold": 0.0, "aim": "none", "max_reflections": 0}
        t = mistray.trace(scene, rays=64, max_scatters=300, ledger=False, **settings)
        assert 64 * 270 < t.segments <= 64 * 301
        assert cut(t.energy, "max_scatters") == pytest.approx(1.0, rel=0.05)
        assert t.energy.cut["max_events"] == 0


def test_reflections_and_scatters_together(load_scene) -> None:
    """With one in all, the second reflection of a plate is refused under a name of its own."""
    found = energy(plate(load_scene), max_reflections=5, max_generations=1)
    assert cut(found, "max_generations") == pytest.approx(T * R * R, rel=1e-5)
    assert found.cut["max_reflections"] == 0
    assert found.escaped_W / found.launched_W == pytest.approx(R + T * R * T, rel=1e-5)


class TestOperations:
    """Each letter that is left out, in closed form."""

    @pytest.mark.parametrize(
        ("left_out", "refused", "detected"),
        [("T", T, 0.0), ("R", R + T * R, T * T), ("A", T * T, 0.0), ("I", 0.0, T * T), ("M", 0.0, T * T)],
    )
    def test_plate(self, load_scene, left_out: str, refused: float, detected: float) -> None:
        allowed = "TRIMtrA".replace(left_out, "")
        found = energy(plate(load_scene), ray_control=allowed, max_reflections=1 if left_out in "RA" else 0)
        if left_out in "IM":
            assert found.cut["ray_control"] == 0
        else:
            assert cut(found, "ray_control") == pytest.approx(refused, rel=1e-5)
        assert found.detected_W / found.launched_W == pytest.approx(detected, rel=1e-5)

    def test_total_reflection(self, load_scene) -> None:
        scene = rod(load_scene)
        found = energy(scene, ray_control="TRMtrA", max_events=1000)
        assert cut(found, "ray_control") == pytest.approx(1.0, rel=1e-6)
        assert energy(scene, ray_control="TIA", max_events=1000).detected_W == pytest.approx(found.launched_W, rel=1e-6)

    @pytest.mark.parametrize("splitting", ["split", "one"])
    @pytest.mark.parametrize(("left_out", "event"), [("r", "reflection"), ("t", "transmission")])
    def test_scatter_to_one_side(self, load_scene, splitting: str, left_out: str, event: str) -> None:
        """A sheet scatters a quarter of the light to either side; what is refused is one of them, 6 SE of 4e4 rays."""
        models = [
            bsdf_xml("paint", reflectance=0.5, event=e, relative_to="specular") for e in ("reflection", "transmission")
        ]
        scene = load_scene(
            scatter_scene(
                beam_xml(1.0),
                placed_xml("asphere", "sheet", scattering_xml(models, R=0.5, T=0.5), semi_diameter=20.0),
                placed_xml("asphere", "detector", at=(0.0, 0.0, 1.0), pixels=8, semi_diameter=20.0),
            )
        )
        settings = {"aim": "none", "splitting": splitting, "rays": 40_000, "max_reflections": 1}
        found = energy(scene, ray_control="TRIMtrA".replace(left_out, ""), **settings)
        free = energy(scene, **settings)
        assert free.cut["ray_control"] == 0
        assert cut(found, "ray_control") == pytest.approx(0.25, abs=6 * 0.43 / 200)
        if left_out == "r":
            assert found.detected_W == pytest.approx(free.detected_W, rel=0.03)
        else:
            assert found.detected_W / found.launched_W == pytest.approx(0.25, abs=6 * 0.43 / 200)

    def test_letters_are_names(self) -> None:
        assert Settings(ray_control="A, M, I, T").ray_control == "transmit_specular"
        assert Settings(ray_control="rtTRIMA").ray_control == "allow_all"
        assert Settings(ray_control="ATI").ray_control == "TIA"
        with pytest.raises(MistrayError, match="ray_control is 'TX'"):
            Settings(ray_control="TX")


class TestAbsorption:
    def test_weak_hits_of_the_detector_count_nowhere(self, load_scene) -> None:
        """Orders of a plate: T² is kept, the ghosts T² R^2k below it are cut."""
        scene = plate(load_scene)
        trace = mistray.trace(scene, rays=500, max_reflections=6, flux_threshold=0.0, cut_below="A=0.01")
        ghosts = T * T * sum(R ** (2 * k) for k in (1, 2, 3))
        assert cut(trace.energy, "absorption_below") == pytest.approx(ghosts, rel=1e-5)
        assert trace.energy.detected_W / trace.energy.launched_W == pytest.approx(T * T, rel=1e-5)
        assert len(trace.paths) == 1
        assert trace.irradiance.sum() == pytest.approx(
            mistray.trace(scene, rays=500, max_reflections=0).irradiance.sum(), rel=1e-5
        )

    def test_surfaces_and_watts(self, load_scene) -> None:
        """Surfaces that absorb 10 %: 0.1 at the front, 0.08 at the rear; the next is 0.1·0.8·0.1 at the front."""
        scene = load_scene(plates_text(1, "air", R=0.1, T=0.8))
        launched = energy(scene).launched_W
        for limit in ({"cut_below": {"A": 0.05}}, {"cut_below_W": {"A": 0.05 * launched / 1000}}):
            found = energy(scene, max_reflections=1, **limit)
            assert found.absorbed["p0_front"][0] / launched == pytest.approx(0.1, rel=1e-5)
            assert found.absorbed["p0_rear"][0] / launched == pytest.approx(0.08, rel=1e-5)
            assert cut(found, "absorption_below") == pytest.approx(0.8 * 0.1 * 0.1, rel=1e-4)

    def test_gradients_obey(self, load_scene) -> None:
        """Of the flux T_front T_rear alone, as without ghosts."""
        scene = plate(load_scene)
        settings = {"rays": 256, "flux_threshold": 0.0}
        found = gradient(
            path_power(scene, "all", max_reflections=6, cut_below="A=0.01", **settings), mi.traverse(scene)
        )
        alone = gradient(path_power(scene, "all", max_reflections=0, **settings), mi.traverse(scene))
        assert found.value == pytest.approx(alone.value, rel=1e-6)
        for key, values in alone.gradient.items():
            assert found.gradient[key] == pytest.approx(values, rel=1e-5, abs=1e-9)


# What FRED begins with: thresholds 0, absolute and relative for five kinds of light, 1000 intersections of which 10
# consecutive, ancestry levels 2 specular and 1 scatter; the sum has no limit of its own, everything is allowed
FRED = {
    "cut_below": (0.0,) * 5,
    "cut_below_W": (0.0,) * 5,
    "max_events": 1000,
    "max_consecutive": 10,
    "max_reflections": 2,
    "max_scatters": 1,
    "max_generations": 3,
    "ray_control": "TRIMtrA",
}
SIXTEEN = {
    "cut_below": "R=1e-6, T=2e-6, r=3e-9, t=4e-9, A=5e-12",
    "cut_below_W": "R=1e-7, T=2e-7, r=3e-10, t=4e-10, A=5e-13",
    "max_events": 900,
    "max_consecutive": 9,
    "max_reflections": 3,
    "max_scatters": 2,
    "max_generations": 4,
    "ray_control": "TRItA",
}


class TestSixteenNumbers:
    def test_one_call(self, load_scene) -> None:
        t = mistray.trace(plate(load_scene), rays=100, **SIXTEEN)
        expected = vars(Settings(**SIXTEEN))
        assert {key: t.settings[key] for key in SIXTEEN} == {key: expected[key] for key in SIXTEEN}
        assert t.settings["cut_below"] == (1e-6, 2e-6, 3e-9, 4e-9, 5e-12)
        assert t.settings["cut_below_W"] == (1e-7, 2e-7, 3e-10, 4e-10, 5e-13)
        assert abs(t.energy.closure) < CLOSURE

    def test_one_file(self, load_scene) -> None:
        kinds = {str: "string", int: "integer"}
        inside = "".join(f'<{kinds[type(v)]} name="{k}" value="{v}"/>' for k, v in SIXTEEN.items())
        text = scene_text(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "air", R=R, T=T), semi_diameter=30.0),
            shape_xml("asphere", "detector", 10.0, sensor=True, semi_diameter=30.0),
        ).replace('<integrator type="straylight"/>', f'<integrator type="straylight">{inside}</integrator>')
        assert load_scene(text).integrator().settings == Settings(**SIXTEEN)

    def test_what_fred_begins_with(self, load_scene) -> None:
        """The defaults differ in the limits of hits alone, which a plate never meets."""
        scene = plate(load_scene)
        assert energy(scene, **FRED).detected_W == pytest.approx(energy(scene).detected_W, rel=1e-12)

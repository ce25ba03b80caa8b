"""Limits of paths in closed form: thresholds by kind of branch, hits, ancestry, operations; what is cut is booked."""

from typing import Any

import mitsuba as mi
import pytest
from lit_detector import TUBE, lit
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml, sphere_text
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z, mean_and_error
from refusals import each_refused

import mistray
from mistray import MistrayError
from mistray.optimize import gradient, path_power
from mistray.trace import Settings

R, T = 0.1, 0.9
CLOSURE = 1e-7  # R and T are numbers of 24 bits in the kernel


def energy(scene: Any, rays: int = 1000, **settings: Any) -> Any:
    found = mistray.trace(scene, rays=rays, **({"flux_threshold": 0.0} | settings)).energy
    assert abs(found.closure) < CLOSURE
    return found


def cut(found: Any, reason: str) -> float:
    return float(found.cut[reason] / found.launched_W)


@pytest.fixture(scope="module")
def plate(load_scene) -> Any:
    return load_scene(plates_text(1, "air", R=R, T=T))


def without(letter: str) -> str:
    return "TRIMtrA".replace(letter, "")


ORDERS = [T * T * R ** (2 * k) for k in range(4)]  # of the plate, on the detector
# Settings, what cuts, and the shares that are cut and detected; up to six reflections
PLATE: list[tuple[dict[str, Any], str, float, float]] = [
    ({}, "flux_threshold", 0.0, sum(ORDERS)),
    ({"max_reflections": 0}, "max_reflections", R + T * R, ORDERS[0]),
    ({"max_reflections": 1}, "max_reflections", T * R * R, ORDERS[0]),
    ({"max_reflections": 2}, "max_reflections", T * R**3, sum(ORDERS[:2])),
    ({"max_generations": 1}, "max_generations", T * R * R, ORDERS[0]),
    ({"max_consecutive": 1}, "max_consecutive", 0.0, sum(ORDERS)),  # surfaces in turn are no run
    ({"max_events": 2}, "max_events", T, 0.0),
    ({"max_events": 3}, "max_events", T * R, ORDERS[0]),
    ({"max_events": 5}, "max_events", T * R**3, sum(ORDERS[:2])),
    ({"flux_threshold": 0.02}, "flux_threshold", T * R * R, ORDERS[0]),
    ({"flux_threshold": 0.0085}, "flux_threshold", T * R * R * T + T * R**3, ORDERS[0]),
    # Reflected branches: R from the front is 0.1, TR from the rear 0.09
    ({"cut_below": {"R": 0.095}}, "specular_reflection_below", T * R, ORDERS[0]),
    # Transmitted: T = 0.9, TT = 0.81 directly; the reflected beam leaves by TRT = 0.081, the ghost by TRRT = 0.0081
    ({"cut_below": "T=0.01"}, "specular_transmission_below", sum(T * R**k * T for k in range(2, 7)), ORDERS[0]),
    ({"cut_below": (0.0, 0.0, 0.5, 0.5, 0.0)}, "specular_transmission_below", 0.0, sum(ORDERS)),
    ({"cut_below": "A=0.01"}, "absorption_below", sum(ORDERS[1:]), ORDERS[0]),
    ({"cut_below_W": "T=1e30"}, "specular_transmission_below", T, 0.0),
    ({"ray_control": without("T")}, "ray_control", T, 0.0),
    ({"ray_control": without("R")}, "ray_control", R + T * R, ORDERS[0]),
    ({"ray_control": without("A")}, "ray_control", sum(ORDERS), 0.0),
    ({"ray_control": without("I")}, "ray_control", 0.0, sum(ORDERS)),
    ({"ray_control": without("M")}, "ray_control", 0.0, sum(ORDERS)),
    ({"ray_control": "transmit_specular"}, "ray_control", R + T * R, ORDERS[0]),
    ({"ray_control": "reflect_specular"}, "ray_control", T, 0.0),
    ({"ray_control": "reflect_specular", "max_reflections": 0}, "ray_control", T, 0.0),
    ({"ray_control": "halt_all"}, "ray_control", 1.0, 0.0),
]


@pytest.mark.parametrize(("settings", "reason", "refused", "detected"), PLATE)
def test_plate(plate, settings: dict[str, Any], reason: str, refused: float, detected: float) -> None:
    found = energy(plate, **{"max_reflections": 6} | settings)
    assert cut(found, reason) == pytest.approx(refused, rel=1e-5)
    assert found.detected_W / found.launched_W == pytest.approx(detected, rel=1e-5)
    if reason != "max_reflections" and "max_reflections" not in settings:
        assert cut(found, "max_reflections") < 1e-6


def test_watts_are_those_of_a_start_ray(load_scene, plate) -> None:
    """2000 start rays of P/2000 each: 0.095 of one, in W, cuts what 0.095 does; the stronger of both holds."""
    launched = energy(plate).launched_W
    for limits in ({"cut_below_W": {"R": 0.095 * launched / 2000}},
                   {"cut_below_W": {"R": 0.095 * launched / 2000}, "cut_below": "R=1e-4"},
                   {"cut_below_W": {"R": 1e-4 * launched / 2000}, "cut_below": "R=0.095"}):  # fmt: skip
        assert cut(energy(plate, rays=2000, **limits), "specular_reflection_below") == pytest.approx(T * R, rel=1e-5)
    # Surfaces that absorb 10 %: 0.1 at the front, 0.08 at the rear; the next is 0.1·0.8·0.1 at the front
    scene = load_scene(plates_text(1, "air", R=0.1, T=0.8))
    for limit in ({"cut_below": {"A": 0.05}}, {"cut_below_W": {"A": 0.05 * launched / 1000}}):
        found = energy(scene, max_reflections=1, **limit)
        assert found.absorbed["p0_front"][0] / launched == pytest.approx(0.1, rel=1e-5)
        assert found.absorbed["p0_rear"][0] / launched == pytest.approx(0.08, rel=1e-5)
        assert cut(found, "absorption_below") == pytest.approx(0.8 * 0.1 * 0.1, rel=1e-4)
    # A share of the start ray itself, whatever the weight by which that is aimed; watts are those of the light
    sky = lit({"type": "sky", "half_angle_deg": 20.0}, tube=TUBE)
    whole, own, watts = (energy(sky, **limit) for limit in ({}, {"cut_below": "A=0.5"}, {"cut_below_W": "A=1e30"}))
    assert own.detected_W == whole.detected_W > watts.detected_W == 0
    with pytest.raises(MistrayError, match="cut_below_W is in watts of a source"):
        mistray.pst(plate, field_deg=[5.0], rays=1000, method="adjoint", cut_below_W="R=1e-3")


def test_weak_hits_of_the_detector_count_nowhere(plate) -> None:
    settings = {"rays": 256, "flux_threshold": 0.0}
    weak, none = {"max_reflections": 6, "cut_below": "A=0.01", **settings}, {"max_reflections": 0, **settings}
    strong, alone = (mistray.trace(plate, **given) for given in (weak, none))
    assert (len(strong.paths), strong.irradiance.sum()) == (1, pytest.approx(alone.irradiance.sum(), rel=1e-5))
    found, expected = (gradient(path_power(plate, "all", **given), mi.traverse(plate)) for given in (weak, none))
    assert found.value == pytest.approx(expected.value, rel=1e-6)
    for key, values in expected.gradient.items():
        assert found.gradient[key] == pytest.approx(values, rel=1e-5, abs=1e-9)


def zigzag(*shapes: str) -> str:
    return scatter_scene(beam_xml(0.4, field_deg=40.0), *shapes)


def tube_wall(*media: str, **coating: Any) -> str:
    return placed_xml("frustum", "wall", interface_xml(*media, **coating), r0=1.0, z0=0.0, r1=1.0, z1=200.0)


def end(z: float) -> str:
    return placed_xml("asphere", "detector", at=(0, 0, z), pixels=8, semi_diameter=1.0)


class TestHitsInARow:
    @pytest.mark.parametrize("most", [1, 2, 7])
    def test_mirror_tube(self, load_scene, most: int) -> None:
        """A ray that zigzags in a long tube of reflectance ρ leaves ρ^k after k hits of its wall."""
        scene = load_scene(zigzag(tube_wall(R=0.8, mirror=True), end(200)))
        found = energy(scene, max_consecutive=most)
        assert cut(found, "max_consecutive") == pytest.approx(0.8**most, rel=1e-5)
        assert found.absorbed["wall"][0] / found.launched_W == pytest.approx(1 - 0.8**most, rel=1e-5)
        # In a glass tube whose wall sends R inwards and T outwards, all that stays inside ends at the same hit
        scene = load_scene(zigzag(tube_wall(R=0.6, T=0.4), end(300)))
        found = energy(scene, max_consecutive=most, max_reflections=30)
        assert cut(found, "max_consecutive") == pytest.approx(0.6**most, rel=1e-5)
        assert found.escaped_W / found.launched_W == pytest.approx(1 - 0.6**most, rel=1e-5)

    def test_light_guide(self, load_scene) -> None:
        """Total reflections count as well, and the plane before them does not; they may be forbidden."""
        clear = {"R": 0.0, "T": 1.0}
        front = placed_xml("asphere", "front", interface_xml("air", "1.5", **clear), semi_diameter=1.0)
        scene = load_scene(zigzag(front, tube_wall("1.5", "air", **clear), end(200)))
        for most in (1, 5):
            assert cut(energy(scene, max_consecutive=most), "max_consecutive") == pytest.approx(1.0, rel=1e-6)
            assert mistray.trace(scene, rays=500, max_consecutive=most).segments == 500 * (2 + most)
        refused = energy(scene, ray_control=without("I"), max_events=1000)
        assert cut(refused, "ray_control") == pytest.approx(1.0, rel=1e-6)
        for control in ("TIA", "allow_all"):
            found = energy(scene, ray_control=control, max_events=1000)
            assert found.detected_W == pytest.approx(found.launched_W, rel=1e-6)

    @pytest.mark.parametrize("splitting", ["split", "one"])
    def test_integrating_sphere(self, load_scene, splitting: str) -> None:
        """False alarm 3e-7: of the light that a wall sends on, 1 - f meets it again, k times at most; within 5 SE."""
        rho, port, most = 0.9, 0.2, 3
        limits = {"max_consecutive": most, "max_scatters": 60, "scatter_threshold": 0.0}
        found = energy(load_scene(sphere_text(rho, port)), rays=20_000, aim="none", splitting=splitting, **limits)
        q = rho * (1 - port)
        wall, se = found.absorbed["wall"]
        assert_z("wall", wall / found.launched_W, (1 - rho) * (1 - q**most) / (1 - q), se / found.launched_W, k=5.0)
        detected = rho * port * (1 - q**most) / (1 - q)
        assert_z("port", found.detected_W / found.launched_W, detected, found.detected_se_W / found.launched_W, k=5.0)
        assert cut(found, "max_consecutive") == pytest.approx(q**most, rel=0.03)


class TestLongPaths:
    def test_a_resonator_of_a_thousand_events(self, load_scene) -> None:
        """Two surfaces of R = 0.99: orders of the geometric series up to the event that is allowed."""
        r, t = 0.99, 0.01
        scene = load_scene(plates_text(1, "air", R=r, T=t))
        found = mistray.trace(scene, rays=64, max_events=1000, max_reflections=1000, flux_threshold=0)
        # The orders n = 0, 2, … meet n + 2 surfaces and then the detector; n + 3 ≤ 1000
        expected = sum(t * t * r**n for n in range(0, 998, 2))
        assert found.energy.detected_W / found.energy.launched_W == pytest.approx(expected, rel=1e-4)
        assert len(found.paths) == 499
        assert energy(scene, rays=64, max_reflections=1000).cut["max_events"] > found.energy.cut["max_events"] > 0

    def test_more_nodes_wait_than_a_word_has_bits(self, load_scene) -> None:
        """35 plates: at each of 70 surfaces a reflected child waits, and those of the last ones are 140 events long."""
        r, t = 2**-10, 1 - 2**-10  # exact in the kernel
        found = energy(load_scene(plates_text(35, "air", R=r, T=t)), rays=64, max_events=200, max_reflections=1)
        assert found.detected_W / found.launched_W == pytest.approx(t**70, rel=1e-5)
        assert found.escaped_W / found.launched_W == pytest.approx(sum(r * t ** (2 * j) for j in range(70)), rel=1e-5)
        assert found.cut["max_events"] == 0

    def test_scatter_events_are_counted_beyond_255(self, load_scene) -> None:
        """A closed white sphere in which 300 events are allowed, and happen to all but the few rays that graze it."""
        settings = {"max_events": 1000, "scatter_threshold": 0.0, "aim": "none", "max_reflections": 0}
        t = mistray.trace(load_scene(sphere_text(1.0, 1e-6)), rays=64, max_scatters=300, ledger=False, **settings)
        assert 64 * 270 < t.segments <= 64 * 301
        assert (cut(t.energy, "max_scatters"), t.energy.cut["max_events"]) == (pytest.approx(1.0, rel=0.05), 0)


class TestScatter:
    @pytest.mark.parametrize("splitting", ["split", "one"])
    @pytest.mark.parametrize(("letter", "event"), [("r", "reflection"), ("t", "transmission")])
    def test_to_one_side(self, load_scene, splitting: str, letter: str, event: str) -> None:
        """A sheet scatters a quarter of the light to either side; what is refused is one of them, 6 SE of 4e4 rays."""
        events = ("reflection", "transmission")
        models = [bsdf_xml("paint", reflectance=0.5, event=each, relative_to="specular") for each in events]
        sheet = placed_xml("asphere", "sheet", scattering_xml(models, R=0.5, T=0.5), semi_diameter=20.0)
        detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 1.0), pixels=8, semi_diameter=20.0)
        scene = load_scene(scatter_scene(beam_xml(1.0), sheet, detector))
        settings = {"aim": "none", "splitting": splitting, "rays": 40_000, "max_reflections": 1}
        found, free = (energy(scene, ray_control=control, **settings) for control in (without(letter), "allow_all"))
        assert free.cut["ray_control"] == 0
        assert cut(found, "ray_control") == pytest.approx(0.25, abs=6 * 0.43 / 200)
        if letter == "r":
            assert found.detected_W == pytest.approx(free.detected_W, rel=0.03)
        else:
            assert found.detected_W / found.launched_W == pytest.approx(0.25, abs=6 * 0.43 / 200)
        reason = f"scattered_{event}_below"
        weak, strong = (energy(scene, cut_below={letter: limit}, **settings) for limit in (1.0, 1e-9))
        assert strong.cut[reason] == 0
        if splitting == "split":
            assert cut(weak, reason) == pytest.approx(0.25, rel=2e-3)  # but for grazing rays

    def test_what_a_medium_scatters_is_transmitted(self, load_scene) -> None:
        haze, clear = "1.0 scatter=0.1", {"R": 0.0, "T": 1.0}
        text = scene_text(
            shape_xml("asphere", "front", 0.0, interface_xml("air", haze, **clear), semi_diameter=300.0),
            shape_xml("asphere", "rear", 10.0, interface_xml(haze, "air", **clear), semi_diameter=300.0),
            shape_xml("frustum", "edge", r0=300.0, r1=300.0, z0=0.0, z1=10.0),
            shape_xml("asphere", "detector", 10.1, sensor=True, semi_diameter=310.0),
        )
        found = energy(load_scene(text), rays=2000, aim="none", cut_below="t=0.99")
        assert cut(found, "scattered_transmission_below") == pytest.approx(0.6321, rel=1e-3)


def test_forms_of_the_settings(load_scene) -> None:
    expected = (1e-6, 0.0, 0.0, 1e-9, 0.0)
    for given in ("R=1e-6, t=1e-9", "t=1e-9 R=1e-6", {"R": 1e-6, "t": 1e-9}, expected, list(expected)):
        assert Settings(cut_below=given).cut_below == expected
    for letters, name in (("A, M, I, T", "transmit_specular"), ("rtTRIMA", "allow_all"), ("ATI", "TIA")):
        assert Settings(ray_control=letters).ray_control == name
    inside = '<string name="cut_below" value="R=1e-6, t=1e-9"/><string name="ray_control" value="ATI"/>'
    text = plates_text(1, "air", R=R, T=T).replace('"straylight"/>', f'"straylight">{inside}</integrator>')
    assert load_scene(text).integrator().settings == Settings(cut_below=expected, ray_control="TIA")


def test_impossible_settings() -> None:
    each_refused(
        ({"cut_below": "x=1"}, "cut_below has 'x'; its branches are R, T, r, t, A"),
        ({"cut_below": "R=1e-6, R=1e-7"}, "cut_below: R is given twice"),
        ({"cut_below": "R"}, "cut_below: 'R' has no name; write R=1e-6"),
        ({"cut_below": 1e-6}, "cut_below is 1e-06; give a number for R, T, r, t, A"),
        ({"cut_below": (1e-6,)}, "cut_below has 1 numbers"),
        ({"cut_below": "r=-1"}, "cut_below of r is -1"),
        ({"cut_below_W": "T=nan"}, "cut_below_W of T is nan"),
        *(({"ray_control": value}, f"ray_control is {value!r}; use 'all") for value in ("TX", "", 3, "Halt_all")),
        by=lambda values: Settings(**values),
    )


@pytest.mark.core
@pytest.mark.parametrize("below", ["cut", "roulette"])
def test_roulette_is_booked_and_zero_on_average(below: str) -> None:
    """False alarm 6e-5: the mean of 40 seeds within 4 standard errors."""
    scene, limits = mistray.load("cooke_triplet"), {"flux_threshold": 0.02, "below_threshold": below}
    found = [mistray.trace(scene, rays=500, seed=seed, **limits).energy for seed in range(40)]
    assert max(abs(one.closure) for one in found) < 1e-5
    booked = [one.cut["roulette"] for one in found]
    if below == "cut":
        assert set(booked) == {0.0}
    else:
        assert min(booked) < 0 < max(booked)
        mean, error = mean_and_error(booked)
        assert_z("flux removed by roulette", mean, 0.0, error, k=4.0)


def two_media(outside: str, first: str, second: str, tilt_deg: float = 0.0) -> str:
    rear = shape_xml("asphere", "rear", 1.0, interface_xml(second, outside), semi_diameter=2.0)
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml(outside, first), semi_diameter=2.0),
        rear.replace("<translate", f'<rotate x="1" angle="{tilt_deg}"/><translate'),
        shape_xml("asphere", "detector", 2.0, interface_xml(outside, R=0.0), True, semi_diameter=2.0),
    )


def test_media_that_do_not_fit(load_scene) -> None:
    """A ray that meets glass 1.6 from glass 1.5 is lost to the books; tilted, as loading looks along common axes."""
    t = mistray.trace(load_scene(two_media("air", "1.5", "1.6", 3.0)), rays=100)
    assert (cut(t.energy, "medium"), len(t.paths)) == (pytest.approx(0.96, rel=1e-6), 0)
    assert abs(t.energy.closure) < 1e-6
    for outside, *names in (("1.5", "air", "vacuum"), ("air", "1.5", "1.50"), ("air", "N-BK7", "n-bk7")):
        same = mistray.trace(load_scene(two_media(outside, *names)), rays=100).energy
        assert same.cut["medium"] == 0
        assert same.detected_W > 0.9 * same.launched_W

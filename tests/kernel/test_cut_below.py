"""Thresholds by kind of branch: closed forms of what a plate loses to each, the books, units, forms of the setting."""

from __future__ import annotations

from typing import Any

import pytest
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray import MistrayError
from mistray.trace import Settings

R, T = 0.1, 0.9


def plate(load_scene: Any) -> Any:
    """Two surfaces that reflect 10 %, and a black detector behind them."""
    window = {"R": R, "T": T}
    return load_scene(
        scene_text(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "air", **window), semi_diameter=30.0),
            shape_xml("asphere", "rear", 5.0, interface_xml("air", "air", **window), semi_diameter=30.0),
            shape_xml("asphere", "detector", 10.0, sensor=True, semi_diameter=30.0),
        )
    )


def test_each_kind_cuts_its_own_branches(load_scene) -> None:
    """Powers of the orders of a plate; between those of two orders a threshold cuts just the weaker ones."""
    scene = plate(load_scene)

    def energy(**limits: Any) -> Any:
        found = mistray.trace(scene, rays=1000, max_reflections=6, flux_threshold=0.0, **limits).energy
        assert abs(found.closure) < 1e-6
        return found

    # Reflected branches: R, TR, TRR, …; R from the front is 0.1, TR from the rear 0.09
    found = energy(cut_below={"R": 0.095})
    assert found.cut["specular_reflection_below"] / found.launched_W == pytest.approx(T * R, rel=1e-5)
    assert found.detected_W / found.launched_W == pytest.approx(T * T, rel=1e-5)
    # Transmitted: T = 0.9, TT = 0.81 directly; the reflected beam leaves by TRT = 0.081, the ghost by TRRT = 0.0081
    found = energy(cut_below="T=0.01")
    assert found.cut["specular_transmission_below"] / found.launched_W == pytest.approx(
        sum(T * R ** (1 + k) * T for k in range(1, 6)), rel=1e-5
    )
    assert found.detected_W / found.launched_W == pytest.approx(T * T, rel=1e-5)
    found = energy(cut_below=(0.0, 0.0, 0.5, 0.5, 0.0))
    assert found.detected_W / found.launched_W == pytest.approx(T * T * (1 + R**2 + R**4 + R**6), rel=1e-5)
    assert not any(value for reason, value in found.cut.items() if reason.endswith("_below"))


def test_watts_are_those_of_a_start_ray(load_scene) -> None:
    """2000 start rays of P/2000 each: 0.095 of one, in W, cuts what 0.095 does; the stronger of both holds."""
    scene = plate(load_scene)
    launched = mistray.trace(scene, rays=2000).energy.launched_W
    for limits in ({"cut_below_W": {"R": 0.095 * launched / 2000}},
                   {"cut_below_W": {"R": 0.095 * launched / 2000}, "cut_below": "R=1e-4"},
                   {"cut_below_W": {"R": 1e-4 * launched / 2000}, "cut_below": "R=0.095"}):  # fmt: skip
        energy = mistray.trace(scene, rays=2000, **limits).energy
        assert energy.cut["specular_reflection_below"] / launched == pytest.approx(T * R, rel=1e-5)
    none = mistray.trace(scene, rays=2000, cut_below_W={"T": 1e30}).energy
    assert none.detected_W == 0
    assert abs(none.closure) < 1e-6


@pytest.mark.parametrize("splitting", ["split", "one"])
@pytest.mark.parametrize(("event", "letter"), [("transmission", "t"), ("reflection", "r")])
def test_scattered_branches(load_scene, splitting: str, event: str, letter: str) -> None:
    """A sheet that scatters half of the light: one random ray of weight ½ is cut above that, and kept below."""
    diffuser = bsdf_xml("paint", reflectance=0.5, event=event, relative_to="specular")
    coating = {"R": 0.0, "T": 1.0} if event == "transmission" else {"R": 0.5, "T": 0.0}
    sheet = scattering_xml([diffuser], **coating)
    scene = load_scene(
        scatter_scene(
            beam_xml(1.0),
            placed_xml("asphere", "sheet", sheet, semi_diameter=20.0),
            placed_xml("asphere", "detector", at=(0.0, 0.0, 1.0), pixels=8, semi_diameter=20.0),
        )
    )
    name = {"t": "scattered_transmission_below", "r": "scattered_reflection_below"}[letter]
    share = 0.5 if event == "transmission" else 0.25
    scattered = mistray.trace(scene, rays=4000, aim="none", splitting=splitting, cut_below={letter: 1.0}).energy
    kept = mistray.trace(scene, rays=4000, aim="none", splitting=splitting, cut_below={letter: 1e-9}).energy
    assert kept.cut[name] == 0
    if splitting == "split":
        assert scattered.cut[name] / scattered.launched_W == pytest.approx(share, rel=2e-3)  # but for grazing rays
    for energy in (scattered, kept):
        assert abs(energy.closure) < 1e-6


def test_what_a_medium_scatters_is_transmitted(load_scene) -> None:
    hazy = {"R": 0.0, "T": 1.0}
    scene = load_scene(
        scene_text(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "1.0 scatter=0.1", **hazy), semi_diameter=300.0),
            shape_xml("asphere", "rear", 10.0, interface_xml("1.0 scatter=0.1", "air", **hazy), semi_diameter=300.0),
            shape_xml("frustum", "edge", r0=300.0, r1=300.0, z0=0.0, z1=10.0),
            shape_xml("asphere", "detector", 10.1, sensor=True, semi_diameter=310.0),
        )
    )
    energy = mistray.trace(scene, rays=2000, aim="none", cut_below="t=0.99").energy
    assert energy.cut["scattered_transmission_below"] / energy.launched_W == pytest.approx(0.6321, rel=1e-3)


def test_forms_of_the_setting() -> None:
    expected = (1e-6, 0.0, 0.0, 1e-9, 0.0)
    for given in ("R=1e-6, t=1e-9", "t=1e-9 R=1e-6", {"R": 1e-6, "t": 1e-9}, expected, list(expected)):
        assert Settings(cut_below=given).cut_below == expected
    assert Settings().cut_below == Settings(cut_below="").cut_below == (0.0,) * 5


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"cut_below": "x=1"}, "cut_below has 'x'; its branches are R, T, r, t, A"),
        ({"cut_below": "R=1e-6, R=1e-7"}, "cut_below names a branch twice"),
        ({"cut_below": "R"}, "cut_below is"),
        ({"cut_below": 1e-6}, "cut_below is 1e-06; give a number for R, T, r, t, A"),
        ({"cut_below": (1e-6,)}, "cut_below has 1 numbers"),
        ({"cut_below": "r=-1"}, "cut_below of r is -1"),
        ({"cut_below_W": "T=nan"}, "cut_below_W of T is nan"),
        ({"cut_below_W": "T=inf"}, "cut_below_W of T is inf"),
    ],
)
def test_impossible_settings(values: dict[str, Any], words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        Settings(**values)


def test_watts_mean_nothing_backwards(load_scene) -> None:
    with pytest.raises(MistrayError, match="cut_below_W is in watts of a source"):
        mistray.pst(plate(load_scene), field_deg=[5.0], rays=1000, method="adjoint", cut_below_W="R=1e-3")

"""Ray control: what surfaces send on, in a trace with the light."""

from __future__ import annotations

from typing import Any

import pytest
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml

import mistray
from mistray import MistrayError
from mistray.settings import RAY_CONTROLS

R = 0.04  # of a surface of the plate, n = 1.5
SCENES = ["plate", "cooke_triplet", "plate_and_wall"]


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest) -> Any:
    return mistray.load(request.param)


@pytest.mark.parametrize("control", RAY_CONTROLS)
def test_closure(scene, control: str) -> None:
    e = mistray.trace(scene, rays=2000, field_deg=2.0, max_scatters=1, ray_control=control).energy
    assert abs(e.closure) < 1e-5
    if control == "allow_all":
        assert e.cut["ray_control"] == 0
    else:
        assert e.cut["ray_control"] > 1e-3 * e.launched_W


def test_transmit_specular_is_light_without_reflections_and_scatter(scene) -> None:
    controlled = mistray.trace(scene, rays=2000, ray_control="transmit_specular")
    limited = mistray.trace(scene, rays=2000, max_reflections=0, max_scatters=0)
    assert controlled.energy.detected_W == pytest.approx(limited.energy.detected_W, rel=1e-6)
    assert [row.order for row in controlled.paths] == [0] == [row.order for row in limited.paths]


def shares(scene: Any, **settings: Any) -> tuple[float, float, float]:
    """Detected, escaped and held back, of the launched."""
    e = mistray.trace(scene, rays=1000, **settings).energy
    return e.detected_W / e.launched_W, e.escaped_W / e.launched_W, e.cut["ray_control"] / e.launched_W


class TestPlate:
    """Each mode in closed form."""

    def test_transmit_specular(self) -> None:
        detected, escaped, kept = shares(mistray.load("plate"), ray_control="transmit_specular")
        assert detected == pytest.approx((1 - R) ** 2, rel=1e-6)
        assert escaped == 0
        assert kept == pytest.approx(R + (1 - R) * R, rel=1e-6)

    def test_reflect_specular(self) -> None:
        detected, escaped, kept = shares(mistray.load("plate"), ray_control="reflect_specular")
        assert detected == 0
        assert escaped == pytest.approx(R, rel=1e-6)
        assert kept == pytest.approx(1 - R, rel=1e-6)

    def test_reflect_specular_keeps_to_the_limit_of_reflections(self) -> None:
        detected, escaped, kept = shares(mistray.load("plate"), ray_control="reflect_specular", max_reflections=0)
        assert (detected, escaped) == (0, 0)
        assert kept == pytest.approx(1 - R, rel=1e-6)

    def test_halt_all(self) -> None:
        t = mistray.trace(mistray.load("plate"), rays=1000, ray_control="halt_all")
        assert t.energy.cut["ray_control"] == pytest.approx(t.energy.launched_W, rel=1e-6)
        assert {row.id: row.hits for row in t.surfaces if row.hits} == {"plate_front": 1000}
        assert len(t.paths) == 0


def test_halt_all_hits_first_surfaces_only() -> None:
    """Every ray ends where it hits first: one hit for each of them that hits anything."""
    t = mistray.trace(mistray.load("newtonian"), rays=2000, ray_control="halt_all", field_deg=3.0)
    hit = {row.id: row.hits for row in t.surfaces if row.hits}
    assert 0 < sum(hit.values()) <= 2000
    e = t.energy
    assert sum(row.incident_W for row in t.surfaces) + e.escaped_W == pytest.approx(e.launched_W, rel=1e-5)


def test_mirrors_reflect_in_transmit_specular() -> None:
    """The image of a Newtonian is there in both modes that let mirrors reflect."""
    scene = mistray.load("newtonian")
    powers = {
        control: mistray.trace(scene, rays=2000, max_scatters=0, ray_control=control).energy.detected_W
        for control in RAY_CONTROLS
    }
    assert powers["transmit_specular"] > 0
    assert powers["transmit_specular"] == pytest.approx(powers["allow_all"], rel=1e-6)
    assert powers["reflect_specular"] == pytest.approx(powers["allow_all"], rel=1e-6)
    assert powers["halt_all"] == 0


def test_scattered_light_is_held_back(load_scene) -> None:
    """A sheet that passes 60 % and scatters 30 %, 3 % of that into the detector: only the direct light is left."""
    model = bsdf_xml("paint", reflectance=0.3, event="transmission")
    scene = load_scene(
        scatter_scene(
            beam_xml(1.0),
            placed_xml("asphere", "sheet", scattering_xml([model], R=0.0, T=0.6), semi_diameter=2.0),
            placed_xml("asphere", "detector", at=(0.0, 0.0, 10.0), pixels=8, semi_diameter=2.0),
        )
    )
    free, kept = (
        mistray.trace(scene, rays=2000, max_scatters=1, ray_control=control).energy
        for control in ("allow_all", "transmit_specular")
    )
    assert kept.detected_W == pytest.approx(0.6 * kept.launched_W, rel=1e-6)
    assert free.detected_W > 1.005 * kept.detected_W
    assert kept.cut["ray_control"] == pytest.approx(0.3 * kept.launched_W, rel=1e-3)
    assert kept.cut["scatter_sampling"] == 0


@pytest.mark.parametrize("value", ["all", "", 3, "Halt_all"])
def test_bad_value_is_one_line(value: Any) -> None:
    words = "ray_control is .*; use 'allow_all', 'transmit_specular', 'reflect_specular', 'halt_all', or letters"
    with pytest.raises(MistrayError, match=words) as caught:
        mistray.trace(mistray.load("plate"), rays=10, ray_control=value)
    assert "\n" not in str(caught.value)
    assert repr(value) in str(caught.value)

"""The oracles' closed forms and tracers checked against tabulated vectors, analytic cases and each other."""

from __future__ import annotations

import numpy as np
import pytest
import vectors
from oracles import beams, closed_forms, nonsequential, scene_xml
from oracles.replay import OUTCOMES, replay
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

ALONG = np.array([[0.0, 0.0, 1.0]])


def scene_of(*shapes: str, radius: float = 1.0) -> scene_xml.SceneModel:
    return scene_xml.parse_scene(scene_text(*shapes, radius=radius))


def traced(model: scene_xml.SceneModel, rays: int, **limits: float) -> nonsequential.Ledger:
    """From a beam along the axis that starts 5 mm before the origin; without a threshold unless it is given."""
    beam = beams.collimated(model.emitters[0], rays, 5.0, 0.0)
    limits = {"flux_threshold": 0.0, **limits}
    return nonsequential.trace(model, beam.origin, beam.direction, beam.power, 550.0, **limits)


def test_plates_in_closed_form() -> None:
    found = {}
    for n in ("1.5", "1.5168", "1.7715", "4"):
        r = closed_forms.normal_reflectance(1, float(n))
        transmitted, returned = closed_forms.plate(r)
        orders = closed_forms.plate_orders(r, 60)
        assert orders.sum() == pytest.approx(transmitted, rel=1e-13)
        found[f"plate_lossless n={n}"] = [transmitted, returned, orders[1] / orders[0], orders[0]]
    found["plate_coated R1=.02 R2=.05 tau=.9"] = [*closed_forms.coated_plate(0.02, 0.05, 0.9)]
    found |= {f"N plates n=1.5 N={number}": [closed_forms.plates(0.04, number)] for number in (2, 3, 5, 10)}
    found["plate 45deg n=1.5"] = [*closed_forms.tilted_plate(1.5, 45.0)]
    table = vectors.rows("analytic_cases.csv")
    for case, values in found.items():
        expected = [float(row["closed_form"]) for row in table if row["case"] == case]
        assert values == pytest.approx(expected, rel=1e-13), case


def test_ghost_counts() -> None:
    for row in vectors.rows("ghost_counts.csv"):
        n = int(row["n_surfaces"])
        for bounces in (2, 4, 6, 8):
            if int(row[f"{bounces}_bounce"]) < 2**62:
                assert closed_forms.ghost_count(n, bounces) == int(row[f"{bounces}_bounce"]), (n, bounces)


def test_real_rays_near_the_axis_follow_the_paraxial_ghosts() -> None:
    """A lens, a window and a detector: the ten ghosts of the table, by both tracers."""
    n, height = 1.5168, 1e-4
    r = closed_forms.normal_reflectance(1, n)
    rows = [(0.0, 0.01, 1.0, n), (5.0, -0.01, n, 1.0), (85.0, 0.0, 1.0, n), (87.0, 0.0, n, 1.0)]
    surfaces = [closed_forms.ParaxialSurface(*row, r, 1 - r) for row in rows]
    assert closed_forms.back_focus(surfaces[:2]) == pytest.approx((97.58040934528817, 95.91804266709576), rel=1e-13)
    focus = 87.0 + closed_forms.back_focus(surfaces)[1]
    ids = ["lens_front", "lens_rear", "window_front", "window_rear"]
    shapes = [
        shape_xml(
            "asphere", shape_id, s.z, interface_xml(str(s.n_before), str(s.n_after)), curvature=s.curvature,
            semi_diameter=40.0,
        )
        for shape_id, s in zip(ids, surfaces, strict=True)
    ]  # fmt: skip
    meter = interface_xml(R=0.2)
    model = scene_of(*shapes, shape_xml("asphere", "detector", focus, meter, True, half_width=80.0, half_height=80.0))
    start = np.array([[height, 0.0, -20.0]])
    ledger = nonsequential.trace(model, start, ALONG, np.array([1.0]), 550.0, flux_threshold=0.0)
    assert abs(ledger.closure) < 1e-14
    assert not ledger.leaks_W
    paths = {path.events: path for path in ledger.paths if path.order == 2}
    table = vectors.frame("ghost_lens_window_det.csv").set_index(
        ["second_reflecting_surface", "first_reflecting_surface"]
    )
    ghosts = closed_forms.paraxial_ghosts(surfaces, focus, 0.2, height)
    assert len(ghosts) == len(paths) == len(table) == 10
    for ghost in ghosts:
        expected = table.loc[(ghost.second, ghost.first)]
        assert abs(ghost.height) * 10.0 / height == pytest.approx(expected["spot_radius_mm"], rel=1e-11)
        assert ghost.power == pytest.approx(expected["incident_power_per_W"], rel=1e-12)
        events = closed_forms.ghost_events(ids, (ghost.first - 1, ghost.second - 1), "detector")
        followed = replay(model, start, ALONG, events, 550.0)
        assert followed.valid[0], followed.summary()
        assert followed.end[0, 0] == pytest.approx(ghost.height, rel=1e-7)
        assert followed.flux[0] == pytest.approx(0.8 * ghost.power, rel=1e-9)
        path = paths[tuple(events)]
        assert path.power_W == pytest.approx(followed.flux[0], rel=1e-14)
        assert path.x_mm == pytest.approx(followed.end[0, 0], rel=1e-13)


class TestTracers:
    def test_replay_says_why_a_ray_failed(self) -> None:
        model = scene_of(
            shape_xml("asphere", "a", 0.0, interface_xml("1.5", "air"), semi_diameter=1.0),
            shape_xml("asphere", "b", 1.0, interface_xml(R=0.0), semi_diameter=0.2),
            shape_xml("asphere", "detector", 2.0, sensor=True, half_width=1.0, half_height=1.0),
        )
        origin = np.array([[0.0, 0, -1], [0.5, 0, -1], [3.0, 0, -1], [-0.5, 0, -1]])
        direction = np.array([[0.0, 0, 1], [0.0, 0, 1], [0.0, 0, 1], [1.0, 0, 1]])
        events = [("a", "SpecTran"), ("detector", "Absorbed")]
        found = replay(model, origin, direction, events, 550.0, start_material="1.5")
        said = ("blocked by another surface", "reached the end", "missed the surface", "total internal reflection")
        assert tuple(OUTCOMES[i] for i in found.outcome) == said
        assert found.flux[1] == pytest.approx(0.96)
        assert found.opl_mm[1] == pytest.approx(1.5 + 2.0)
        assert found.failed_at.tolist() == [1, -1, 0, 0]

    def test_limits_and_leaks_between_media_are_booked(self) -> None:
        for limit, value in (("max_reflections", 1), ("max_events", 5), ("flux_threshold", 1e-2)):
            ledger = traced(scene_xml.parse_scene(plates_text(2)), 2, **{limit: value})
            assert ledger.cut_W[limit] > 0
            assert abs(ledger.closure) < 1e-14
        model = scene_of(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5"), semi_diameter=2.0),
            shape_xml("asphere", "rear", 1.0, interface_xml("1.6", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 2.0, sensor=True, half_width=2.0, half_height=2.0),
        )
        ledger = traced(model, 4, max_reflections=0)
        assert ledger.leaks_W["front", "rear", "1.5"] == pytest.approx(0.96 * np.pi)
        assert ("rear", "detector", "air") not in ledger.leaks_W

    @pytest.mark.parametrize("values", [{"radius": 2.0, "inner_radius": 1.0}, {"half_width": 1.0, "half_height": 3.0}])
    def test_beam_power_and_moments(self, values: dict[str, float]) -> None:
        emitter = scene_xml.Emitter(np.eye(4), {**values, "irradiance": 2.0, "field_deg": 30.0, "azimuth_deg": 90.0})
        beam = beams.collimated(emitter, 4000, 10.0)
        area = np.pi * 3 if "radius" in values else 12.0
        assert beam.power.sum() == pytest.approx(2 * area)
        np.testing.assert_allclose(beam.direction[0], [-0.5, 0.0, np.sqrt(0.75)], atol=1e-15)
        np.testing.assert_allclose(beam.origin.mean(axis=0), -10 * beam.direction[0], atol=5e-3)
        np.testing.assert_allclose((beam.origin + 10 * beam.direction) @ beam.direction[0], 0.0, atol=1e-12)
        second = (2**4 - 1) / 4 / 3 if "radius" in values else 1 / 3
        assert np.mean((beam.origin[:, 1] - beam.origin[:, 1].mean()) ** 2) == pytest.approx(second, rel=5e-3)
        tilted = beams.collimated(scene_xml.Emitter(np.eye(4), {**emitter.values, "plane": "axis"}), 10, 0.0)
        assert tilted.power.sum() == pytest.approx(2 * area * np.sqrt(0.75))
        assert np.all(tilted.origin[:, 2] == 0)

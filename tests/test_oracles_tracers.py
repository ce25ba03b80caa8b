"""The oracles' closed forms and tracers against vectors, analytic cases, each other, and the shipped scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles import beams, closed_forms, nonsequential, scatter, scene_xml
from oracles import scatter_integrals as integrals
from oracles.replay import OUTCOMES, replay
from oracles.scatter_scenes import bsdf_xml, lenses_text, tube_text
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z

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


def scattered(text: str, rays: int, **limits: float) -> scatter.Books:
    model = scene_xml.parse_scene(text)
    beam = beams.collimated(model.emitters[0], rays, beams.start_distance(model, model.emitters[0]))
    models = scatter.scatter_models(text)
    return scatter.trace(model, models, beam.origin, beam.direction, beam.power, 550.0, **limits)


def test_a_lambertian() -> None:
    """ρ sin² h cos(axis) into a cone above the horizon; ρ in all, whatever the angle."""
    flux = integrals.cone_flux(integrals.lambertian(0.3), 20.0, 40.0, 77.0, 13.0)
    assert flux == pytest.approx(0.3 * np.sin(np.radians(13)) ** 2 * np.cos(np.radians(40)), rel=1e-12)
    for sine in (0.0, 0.3, 0.7, 0.999, 1.0):
        assert integrals.total_scatter(integrals.lambertian(0.05), sine) == pytest.approx(0.05, rel=1e-12)


class TestTracer:
    """The Monte Carlo against the integrals: each number within 4 standard errors, false alarm 6e-5."""

    @pytest.mark.parametrize("rho", [0.5, 1.0])
    def test_tube(self, rho: float) -> None:
        bounces = 5
        books = scattered(tube_text(2.0, rho), 20_000, max_scatters=bounces + 1)
        orders = integrals.tube_orders(2.0, rho, bounces)
        path = "entrance:t wall:r wall:r detector:A"
        for what, (power, se), expected in (
            ("tube", books.detected, orders.sum()),
            ("two bounces", books.power(path), orders[2]),
        ):
            assert_z(what, power / np.pi, expected, se / np.pi, k=4.0)
        assert books.detected[1] < 0.03 * books.detected[0]

    def test_energy(self) -> None:
        text = lenses_text(bsdf_xml("abg", A=0.02, B=0.05, g=2.0))
        books = scattered(text, 3_200, max_scatters=2, max_reflections=4, flux_threshold=1e-5)
        parts = [books.detected, *(scatter.mean_and_se(v) for v in books.absorbed.values())]
        parts += [scatter.mean_and_se(books.escaped), scatter.mean_and_se(books.cut)]
        total, error = np.array(parts).T
        assert_z("energy", total.sum(), books.launched_W, np.hypot.reduce(error), k=4.0)
        assert min(total) >= 0


SCENES = sorted((Path(__file__).parents[1] / "scenes").glob("*/scene.xml"))
D_LINE_NM = 587.5618


@pytest.mark.long
@pytest.mark.parametrize("path", SCENES, ids=[path.parent.name for path in SCENES])
@pytest.mark.parametrize("field_deg", [0.0, 0.4, 9.0])
def test_energy_closes_and_media_fit(path: Path, field_deg: float) -> None:
    """Every ray meets each surface in the medium that the surface expects, and none ends inside of glass."""
    model = scene_xml.read_scene(path)
    rays = 40 if path.parent.name == "rubin" else 400  # its figure errors take the oracle long
    beam = beams.start(model, rays, field_deg)
    ledger = nonsequential.trace(
        model, beam.origin, beam.direction, beam.power, D_LINE_NM, max_reflections=1, max_events=64, flux_threshold=1e-6
    )
    assert abs(ledger.closure) < 1e-13
    open_plate = path.parent.name in ("plate", "lens_and_reflector")  # no edge: light leaves sideways
    leaks = {key: power for key, power in ledger.leaks_W.items() if not (open_plate and key[1] == "escape")}
    assert not leaks
    if field_deg == 0:
        assert ledger.detected_W > 0
        assert all(kind in ("SpecTran", "SpecRefl", "Absorbed") for _, kind in ledger.paths[0].events)

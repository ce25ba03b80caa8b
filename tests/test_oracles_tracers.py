"""The oracles' closed forms and tracers checked against tabulated vectors, analytic cases and each other."""

from __future__ import annotations

import numpy as np
import pytest
import vectors
from oracles import beams, closed_forms, nonsequential, scene_xml
from oracles.geometry import Asphere
from oracles.replay import OUTCOMES, parse_events, replay
from oracles.small_scenes import STEEP_REAR, interface_xml, plates_text, scene_text, shape_xml


def scene_of(*shapes: str, radius: float = 1.0) -> scene_xml.SceneModel:
    return scene_xml.parse_scene(scene_text(*shapes, radius=radius))


def plates_scene(number: int, index: str = "1.5", **coating: float) -> scene_xml.SceneModel:
    return scene_xml.parse_scene(plates_text(number, index, **coating))


def bundle(model: scene_xml.SceneModel, rays: int = 50, field_deg: float = 0.0, distance: float = 5.0) -> beams.Beam:
    return beams.collimated(model.emitters[0], rays, distance, field_deg)


@pytest.fixture(scope="module")
def expected() -> dict[tuple[str, str], float]:
    return {(row["case"], row["quantity"]): float(row["closed_form"]) for row in vectors.rows("analytic_cases.csv")}


@pytest.fixture(scope="module")
def singlet_window() -> tuple[list[closed_forms.ParaxialSurface], float]:
    n = 1.5168
    r = closed_forms.normal_reflectance(1, n)
    rows = [(0.0, 0.01, 1.0, n), (5.0, -0.01, n, 1.0), (85.0, 0.0, 1.0, n), (87.0, 0.0, n, 1.0)]
    surfaces = [closed_forms.ParaxialSurface(*row, r, 1 - r) for row in rows]
    return surfaces, 87.0 + closed_forms.back_focus(surfaces)[1]


class TestClosedForms:
    @pytest.mark.parametrize("n", ["1.5", "1.5168", "1.7715", "4"])
    def test_plate(self, n: str, expected: dict[tuple[str, str], float]) -> None:
        r = closed_forms.normal_reflectance(1, float(n))
        case = f"plate_lossless n={n}"
        t, back = closed_forms.plate(r)
        orders = closed_forms.plate_orders(r, 60)
        assert t == pytest.approx(expected[case, "T_total=(1-R)/(1+R)"], rel=1e-14)
        assert back == pytest.approx(expected[case, "R_total=2R/(1+R)"], rel=1e-14)
        assert orders[1] / orders[0] == pytest.approx(expected[case, "ghost1/direct=R^2"], rel=1e-13)
        assert orders[0] == pytest.approx(expected[case, "T_direct=(1-R)^2"], rel=1e-14)
        assert orders.sum() == pytest.approx(t, rel=1e-13)

    def test_plates_coated_and_tilted(self, expected: dict[tuple[str, str], float]) -> None:
        case = "plate_coated R1=.02 R2=.05 tau=.9"
        values = [value for (name, _), value in expected.items() if name == case]
        assert closed_forms.coated_plate(0.02, 0.05, 0.9) == pytest.approx(values, rel=1e-14)
        for number in (2, 3, 5, 10):
            t = closed_forms.plates(0.04, number)
            assert t == pytest.approx(expected[f"N plates n=1.5 N={number}", "T=(1-R)/(1+(2N-1)R)"], rel=1e-13)
        tilted = [value for (name, _), value in expected.items() if name == "plate 45deg n=1.5"]
        assert closed_forms.tilted_plate(1.5, 45.0) == pytest.approx(tilted, rel=1e-13)

    def test_retro_ghost(self, expected: dict[tuple[str, str], float]) -> None:
        case = "retro ghost F/2.2 gap=0.1363 t=0.21 n=1.5168"
        near, far = (
            closed_forms.retro_ghost_radius(2.2, 0.1363),
            closed_forms.retro_ghost_radius(2.2, 0.1363, 0.21, 1.5168),
        )
        assert near == pytest.approx(expected[case, "spot radius paraxial near"], rel=1e-13)
        assert far == pytest.approx(expected[case, "spot radius paraxial far"], rel=1e-13)

    def test_ghost_counts(self) -> None:
        for row in vectors.rows("ghost_counts.csv"):
            n = int(row["n_surfaces"])
            for bounces in (2, 4, 6, 8):
                if int(row[f"{bounces}_bounce"]) < 2**62:
                    assert closed_forms.ghost_count(n, bounces) == int(row[f"{bounces}_bounce"]), (n, bounces)
            assert closed_forms.ghost_count(n, 2) == n * (n - 1) // 2

    def test_ghost_sequences_are_what_is_counted(self) -> None:
        for n, bounces in ((2, 8), (5, 4), (10, 4), (6, 6)):
            found = list(closed_forms.ghost_sequences(n, bounces))
            assert len(found) == len(set(found)) == closed_forms.ghost_count(n, bounces)

    def test_ghost_route(self) -> None:
        assert closed_forms.ghost_route(2, (1, 0)) == [(0, "T"), (1, "R"), (0, "R"), (1, "T")]
        events = closed_forms.ghost_events(["a", "b"], (2, 0), "det")
        text = " ".join(f"{i}:{e}" for i, e in events)
        assert text == "a:SpecTran b:SpecTran det:SpecRefl b:SpecTran a:SpecRefl b:SpecTran det:Absorbed"
        assert parse_events(text) == events

    def test_ghosts_of_singlet_window_detector(self, singlet_window) -> None:
        surfaces, focus = singlet_window
        assert closed_forms.back_focus(surfaces[:2]) == pytest.approx((97.58040934528817, 95.91804266709576), rel=1e-13)
        ghosts = {(g.second, g.first): g for g in closed_forms.paraxial_ghosts(surfaces, focus, 0.2, 10.0)}
        rows = vectors.rows("ghost_lens_window_det.csv")
        assert len(ghosts) == len(rows) == 10
        for row in rows:
            ghost = ghosts[int(row["second_reflecting_surface"]), int(row["first_reflecting_surface"])]
            assert abs(ghost.height) == pytest.approx(float(row["spot_radius_mm"]), rel=1e-11)
            assert ghost.power == pytest.approx(float(row["incident_power_per_W"]), rel=1e-12)
            irradiance = ghost.power * 100 / ghost.height**2
            assert irradiance == pytest.approx(float(row["irradiance_on_detector_per_entrance_irradiance"]), rel=1e-10)

    def test_real_rays_near_the_axis_follow_the_paraxial_ghosts(self, singlet_window) -> None:
        surfaces, focus = singlet_window
        ids = ["lens_front", "lens_rear", "window_front", "window_rear"]
        shapes = []
        for shape_id, s in zip(ids, surfaces, strict=True):
            bsdf = interface_xml(str(s.n_before), str(s.n_after))
            shapes.append(shape_xml("asphere", shape_id, s.z, bsdf, curvature=s.curvature, semi_diameter=40.0))
        meter = interface_xml(R=0.2)
        shapes.append(shape_xml("asphere", "detector", focus, meter, sensor=True, half_width=80.0, half_height=80.0))
        model = scene_of(*shapes)
        height = 1e-4
        start = np.array([[height, 0.0, -20.0]])
        ledger = nonsequential.trace(model, start, np.array([[0.0, 0, 1]]), np.array([1.0]), 550.0, flux_threshold=0.0)
        assert abs(ledger.closure) < 1e-14
        assert not ledger.leaks_W
        doubles = [path for path in ledger.paths if path.order == 2]
        assert len(doubles) == 10
        for ghost in closed_forms.paraxial_ghosts(surfaces, focus, 0.2, height):
            events = closed_forms.ghost_events(ids, (ghost.first - 1, ghost.second - 1), "detector")
            traced = replay(model, start, np.array([[0.0, 0, 1]]), events, 550.0)
            assert traced.valid[0], traced.summary()
            assert traced.end[0, 0] == pytest.approx(ghost.height, rel=1e-7)
            assert traced.flux[0] == pytest.approx(0.8 * ghost.power, rel=1e-9)
            path = ledger.find(*(f"{i}:{ {'SpecTran': 'T', 'SpecRefl': 'R', 'Absorbed': 'A'}[e] }" for i, e in events))
            assert path.power_W == pytest.approx(traced.flux[0], rel=1e-14)
            assert path.x_mm == pytest.approx(traced.end[0, 0], rel=1e-13)


class TestTracers:
    def test_plate_orders_and_energy(self) -> None:
        model, r = plates_scene(1), 0.04
        beam = bundle(model, 20)
        ledger = nonsequential.trace(
            model, beam.origin, beam.direction, beam.power, 550.0, max_reflections=12, flux_threshold=0.0
        )
        power = np.array([path.power_W for path in ledger.paths]) / ledger.launched_W
        np.testing.assert_allclose(power, closed_forms.plate_orders(r, 7), rtol=1e-13)
        assert ledger.launched_W == pytest.approx(np.pi, rel=1e-14)
        assert ledger.escaped_W / ledger.launched_W == pytest.approx(closed_forms.plate(r)[1], rel=1e-12)
        assert abs(ledger.closure) < 1e-14
        assert set(ledger.cut_W) == {"max_reflections"}

    @pytest.mark.parametrize("number", [2, 3])
    def test_plates(self, number: int) -> None:
        model = plates_scene(number)
        beam = bundle(model, 1)
        ledger = nonsequential.trace(
            model, beam.origin, beam.direction, beam.power, 550.0, max_reflections=8, flux_threshold=0.0, max_events=200
        )
        left = sum(ledger.cut_W.values()) / ledger.launched_W
        assert ledger.detected_W / ledger.launched_W == pytest.approx(closed_forms.plates(0.04, number), abs=left)
        assert left < 1e-7 * 40**number

    def test_coated_plate(self) -> None:
        model = plates_scene(1, R=0.05, T=0.9)
        beam = bundle(model, 3)
        ledger = nonsequential.trace(
            model, beam.origin, beam.direction, beam.power, 550.0, max_reflections=14, flux_threshold=0.0
        )
        t, r = closed_forms.coated_plate(0.05, 0.05, t1=0.9, t2=0.9)
        assert ledger.detected_W / ledger.launched_W == pytest.approx(t, rel=1e-12)
        assert ledger.escaped_W / ledger.launched_W == pytest.approx(r, rel=1e-12)
        assert sum(ledger.absorbed_W.values()) / ledger.launched_W == pytest.approx(1 - t - r, rel=1e-12)

    @pytest.mark.parametrize(("surfaces", "bounces"), [(4, 2), (6, 2), (4, 4), (6, 4)])
    def test_ledger_lists_every_ghost_and_no_other(self, surfaces: int, bounces: int) -> None:
        model = plates_scene(surfaces // 2)
        ids = [shape.shape_id for shape in model.shapes[:-1]]
        beam = bundle(model, 1)
        ledger = nonsequential.trace(
            model,
            beam.origin,
            beam.direction,
            beam.power,
            550.0,
            max_reflections=bounces,
            flux_threshold=0.0,
            max_events=64,
        )
        found = {path.events for path in ledger.paths if path.order == bounces}
        wanted = {
            tuple(closed_forms.ghost_events(ids, s, "detector"))
            for s in closed_forms.ghost_sequences(surfaces, bounces)
        }
        assert len(wanted) == closed_forms.ghost_count(surfaces, bounces)
        assert found == wanted

    def test_every_path_of_a_steep_lens_replays_to_the_same_hits(self) -> None:
        """A thick lens with the steep rear, an edge, a reflecting tube and a detector: TIR and wall bounces occur."""
        floats = dict(zip(("a4", "a6", "a8", "a10", "a12"), (v for _, v in STEEP_REAR.coefficients), strict=True))
        front_rim = float(Asphere(-1 / 15.649, outer=1.3).sag(np.array(1.3**2)))
        rim = float(STEEP_REAR.sag(np.array(1.06**2)))
        model = scene_of(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "1.632"), radius=-15.649, semi_diameter=1.3),
            shape_xml(
                "asphere",
                "rear",
                0.6,
                interface_xml("1.632", "air"),
                radius=3.482,
                conic=8.701,
                semi_diameter=1.06,
                **floats,
            ),
            shape_xml(
                "frustum", "flange", 0.0, interface_xml("1.632", "air"), r0=1.06, z0=0.6 + rim, r1=1.3, z1=0.6 + rim
            ),
            shape_xml(
                "frustum", "edge", 0.0, interface_xml("1.632", "air"), r0=1.3, z0=front_rim, r1=1.3, z1=0.6 + rim
            ),
            shape_xml("frustum", "tube", 0.0, interface_xml(R=0.07), r0=1.6, z0=-3.0, r1=1.6, z1=3.0),
            shape_xml("asphere", "detector", 3.0, interface_xml(R=0.2), sensor=True, half_width=2.0, half_height=2.0),
            radius=1.2,
        )
        beam = bundle(model, 120, field_deg=12.0, distance=2.0)
        ledger = nonsequential.trace(
            model, beam.origin, beam.direction, beam.power, 587.5618, max_events=12, flux_threshold=1e-6
        )
        assert abs(ledger.closure) < 1e-13
        assert not ledger.leaks_W
        texts = " ".join(path.text for path in ledger.paths)
        assert "TIR" in texts
        assert "tube:R" in texts
        assert len(ledger.paths) > 40
        for path in ledger.paths:
            i = path.start_rays
            traced = replay(model, beam.origin[i], beam.direction[i], path.events, 587.5618)
            assert traced.valid.all(), f"{path.text}: {traced.summary()}"
            np.testing.assert_allclose(traced.end[:, :2], path.hits, rtol=0, atol=1e-9)
            np.testing.assert_allclose(traced.flux * beam.power[i], path.weights, rtol=1e-9)

    def test_replay_says_why_a_ray_failed(self) -> None:
        model = scene_of(
            shape_xml("asphere", "a", 0.0, interface_xml("1.5", "air"), semi_diameter=1.0),
            shape_xml("asphere", "b", 1.0, interface_xml(R=0.0), semi_diameter=0.2),
            shape_xml("asphere", "detector", 2.0, sensor=True, half_width=1.0, half_height=1.0),
        )
        origin = np.array([[0.0, 0, -1], [0.5, 0, -1], [3.0, 0, -1], [-0.5, 0, -1]])
        direction = np.array([[0.0, 0, 1], [0.0, 0, 1], [0.0, 0, 1], [1.0, 0, 1]])
        events = [("a", "SpecTran"), ("detector", "Absorbed")]
        traced = replay(model, origin, direction, events, 550.0, start_material="1.5")
        reasons = [OUTCOMES[i] for i in traced.outcome]
        assert reasons == [
            "blocked by another surface",
            "reached the end",
            "missed the surface",
            "total internal reflection",
        ]
        assert traced.flux[1] == pytest.approx(0.96)
        assert traced.opl_mm[1] == pytest.approx(1.5 + 2.0)
        assert traced.failed_at.tolist() == [1, -1, 0, 0]
        assert replay(model, origin, direction, events, 550.0, first_hit=False).valid.tolist() == [
            True,
            True,
            False,
            False,
        ]
        forced = replay(model, origin, direction, [("a", "TIR")], 550.0)
        assert [OUTCOMES[i] for i in forced.outcome][1] == "no TIR here"

    def test_parabola_focuses_with_equal_paths(self) -> None:
        """f = 200: collimated light meets the focus, optical paths are equal, the mirror is no ghost bounce."""
        model = scene_of(
            shape_xml(
                "asphere",
                "mirror",
                200.0,
                interface_xml(R=0.9, mirror=True),
                radius=-400.0,
                conic=-1.0,
                semi_diameter=60.0,
            ),
            shape_xml("asphere", "detector", 0.0, sensor=True, half_width=1.0, half_height=1.0),
            radius=50.0,
        )
        beam = bundle(model, 64, distance=0.0)
        origin = beam.origin + np.array([3.0, 3.0, -10.0])
        traced = replay(model, origin, beam.direction, [("mirror", "SpecRefl"), ("detector", "Absorbed")], 550.0)
        seen = np.hypot(origin[:, 0], origin[:, 1]) > 1.5
        assert traced.valid[seen].all()
        assert np.abs(traced.end[seen, :2]).max() < 1e-12
        assert np.ptp(traced.opl_mm[seen]) < 1e-12
        ledger = nonsequential.trace(model, origin, beam.direction, beam.power, 550.0, max_reflections=0)
        assert ledger.find("mirror:R", "detector:A").order == 0
        assert not ledger.cut_W

    def test_limits_are_booked(self) -> None:
        model = plates_scene(2)
        beam = bundle(model, 2)
        for limits, reason in (
            ({"max_reflections": 1}, "max_reflections"),
            ({"max_events": 5}, "max_events"),
            ({"flux_threshold": 1e-2}, "flux_threshold"),
        ):
            ledger = nonsequential.trace(model, beam.origin, beam.direction, beam.power, 550.0, **limits)
            assert ledger.cut_W[reason] > 0
            assert abs(ledger.closure) < 1e-14
        assert len(nonsequential.trace(model, beam.origin, beam.direction, beam.power, 550.0, max_events=5).paths) == 1

    def test_leak_between_media_is_found(self) -> None:
        model = scene_of(
            shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5"), semi_diameter=2.0),
            shape_xml("asphere", "rear", 1.0, interface_xml("1.6", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 2.0, sensor=True, half_width=2.0, half_height=2.0),
        )
        beam = bundle(model, 4)
        ledger = nonsequential.trace(model, beam.origin, beam.direction, beam.power, 550.0, max_reflections=0)
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

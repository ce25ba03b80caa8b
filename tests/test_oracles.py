"""The oracles against vectors, analytic cases, each other, and the shipped scenes."""

import ast
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles import beams, closed_forms, nonsequential, scatter, scene_xml, statistics
from oracles import scatter_integrals as integrals
from oracles.frozen_paths import Bundle, FrozenPaths, follow, mean_position, power, rms_radius
from oracles.frozen_scene import FrozenScene, read_frozen
from oracles.geometry import Frustum, Plane
from oracles.layers import stack_powers
from oracles.replay import OUTCOMES, replay
from oracles.scatter_scenes import bsdf_xml, lenses_text, tube_text
from oracles.scene_xml import parse_scene
from oracles.small_scenes import STEEP_REAR, interface_xml, plates_text, scene_text, shape_xml
from oracles.stacks import Stack, by_tmm
from oracles.statistics import assert_z


def test_no_oracle_imports_the_program_under_test() -> None:
    files = sorted((Path(__file__).parent / "oracles").glob("*.py"))
    assert len(files) >= 9
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            bad = {n.split(".")[0] for n in names} & {"mistray", "mitsuba", "drjit", "plugins"}
            assert not bad, f"{path.name} imports {bad}"


class TestGeometry:
    @pytest.mark.parametrize(
        ("frustum", "origin", "leaving", "length"),
        [
            (Frustum(3, -9, 3, 9), (0, 0, 0), False, 5.0),
            (Frustum(1, 4, 5, 4), (0, 0, 0), False, 5.0),
            (Frustum(3.01, 4, 5, 4), (0, 0, 0), False, np.inf),
            # cone r = z: 0.6 t = 0.8 t + 1 from (0, 0, 1) has no solution ahead, from (0, 0, -1) t = 5
            (Frustum(0, 0, 9, 9), (0, 0, -1), False, 5.0),
            (Frustum(0, 0, 9, 9), (0, 0, 1), False, np.inf),
            # a chord inside a cylinder meets it again, outside it does not
            (Frustum(3, -9, 3, 9), (-3, 0, 0), True, 10.0),
            (Frustum(3, -9, 3, 9), (3, 0, 0), True, np.inf),
        ],
    )
    def test_frustum_special_cases(self, frustum: Frustum, origin: tuple, leaving: bool, length: float) -> None:
        found = frustum.first_hit(np.array([origin], dtype=float), np.array([[0.6, 0.0, 0.8]]), np.array([leaving]))
        assert found[0] == pytest.approx(length, abs=1e-14)

    def test_frustum_normals_point_away_from_the_axis(self) -> None:
        s = np.sqrt(0.5)
        for frustum, point, normal in (
            (Frustum(2, 0, 2, 1), [2, 0, 0.5], [1, 0, 0]),
            (Frustum(1, 0, 2, 1), [0, 1.5, 0.5], [0, s, -s]),
            (Frustum(2, 1, 1, 0), [0, 1.5, 0.5], [0, s, -s]),
            (Frustum(2, 0, 1, 1), [0, 1.5, 0.5], [0, s, s]),
            (Frustum(2, 1, 1, 1), [0, 1.5, 1], [0, 0, 1]),
        ):
            np.testing.assert_allclose(frustum.normal(np.array([point], dtype=float))[0], normal, atol=1e-15)

    def test_normals_are_gradients(self) -> None:
        x, y, h = np.array([0.3, -0.9, 0.0]), np.array([0.2, 0.4, 0.0]), 1e-6

        def sag(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return STEEP_REAR.sag(x * x + y * y)

        slopes = (sag(x + h, y) - sag(x - h, y)) / (2 * h), (sag(x, y + h) - sag(x, y - h)) / (2 * h)
        expected = np.stack([-slopes[0], -slopes[1], np.ones(3)], axis=1)
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(STEEP_REAR.normal(np.stack([x, y, sag(x, y)], axis=1)), expected, atol=1e-9)
        rim_slope = 2 * STEEP_REAR.outer * STEEP_REAR.slope_u(np.array(STEEP_REAR.outer**2))
        assert rim_slope == pytest.approx(2.07, abs=0.005)


class TestSceneXml:
    def test_transforms_act_in_xml_order(self) -> None:
        a, b, c, d, e = scene_xml.parse_scene(vectors.text("transforms.xml")).shapes
        assert isinstance(a.surface, Plane)
        assert (a.surface.half_width, a.surface.half_height) == pytest.approx((2, 3))
        np.testing.assert_allclose(a.normal(np.array([[5.0, 0, 0]]))[0], [1, 0, 0], atol=1e-15)
        for shape, place in ((a, [5, 0, 0]), (b, [1, 2, 3]), (c, [0, -1, 0])):
            np.testing.assert_allclose(shape.to_world[:3, 3], place, atol=1e-15)
        np.testing.assert_allclose(b.to_world[:3, 0], [1, 0, 0])
        np.testing.assert_allclose(b.to_world[:3, 2], [0, 0, 1])
        np.testing.assert_allclose(d.to_world @ [1, 0, 0, 1], [7, 9, 9, 1])
        assert e.first_hit(np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]]), np.array([False]))[0] == pytest.approx(2.0)

    @pytest.mark.parametrize(("text", "message"), vectors.toml("refusals.toml")["scenes of the oracles"])
    def test_nothing_is_half_read(self, text: str, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            scene_xml.parse_scene(f"<scene>{text}</scene>")


class TestStatistics:
    def test_limit_is_sidak_and_what_fails(self) -> None:
        assert statistics.z_limit(1, 0.0027) == pytest.approx(3.0, abs=1e-3)
        assert statistics.z_limit(20, 0.05) == pytest.approx(3.0161, abs=1e-3)
        rng = np.random.default_rng(11)
        alarms = (np.abs(rng.normal(size=(4000, 50))).max(axis=1) > statistics.z_limit(50, 0.05)).mean()
        statistics.assert_z("false alarms", alarms, 0.05, np.sqrt(0.05 * 0.95 / 4000))
        # Beyond the limit, one of several, without an error, beyond the relative limit; a value that is no number
        for message, wrong in (
            ("off by 5.00 standard errors", ("plate T", 1.1, 1.0, 0.02)), ("inf", ("count", 5, 4, 0)),
            (r"\[1\].*1 of 3", ("T", [1, 2, 3], [1, 1, 3], 0.1)),
        ):  # fmt: skip
            with pytest.raises(AssertionError, match=message):
                statistics.assert_z(*wrong)
        with pytest.raises(AssertionError, match="relative"):
            statistics.assert_within("plate T", 1.01, 1.0, 0.01)
        statistics.assert_z("count", 5, 5, 0)
        with pytest.raises(ValueError, match="finite"):
            statistics.assert_z("power", np.nan, 1.0, 0.1)


NAMES = {"T": "SpecTran", "R": "SpecRefl", "A": "Absorbed"}


def bundle_of(scene: FrozenScene, text: str, origin: np.ndarray, direction: np.ndarray) -> Bundle:
    """Rays from closed forms or at random as a bundle; the hits of the sequential oracle stand for recorded ones."""
    events = [(name, NAMES[letter]) for name, letter in (item.split(":") for item in text.split())]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    n = len(origin)
    traced = replay(scene.model, origin, direction, events, scene.wavelength_nm, first_hit=False)
    assert traced.valid.all(), traced.summary()
    leaving = np.zeros((len(events), n, 3))
    return Bundle(tuple(events), origin, direction, traced.points[1:], leaving, np.ones(n), np.ones(n), np.arange(n))


def assert_slopes(scene: FrozenScene, text: str, origin, direction, expected: list[tuple], rel: float) -> None:
    """Derivatives of x, y (0, 1) or flux (2) at the screen by the sum of some numbers."""
    paths = FrozenPaths(scene, [bundle_of(scene, text, np.atleast_2d(origin), np.atleast_2d(direction))])
    metrics = [lambda hits: hits[0].x.sum(), lambda hits: hits[0].y.sum(), power]
    for keys, metric, slope in expected:
        found = sum(paths.derivatives(metrics, key, 1e-5)[metric] for key in keys.split())
        assert found == pytest.approx(slope, rel=rel, abs=1e-9 if slope == 0 else 0), (keys, metric)


AXIAL = np.array([0.0, 0.0, 1.0])
HEIGHT = 1e-4  # paraxial, mm


def before_screen(shapes: str, z: float) -> FrozenScene:
    screen = shape_xml("asphere", "screen", z, sensor=True, half_width=50.0, half_height=50.0)
    return read_frozen(scene_text(shapes, screen))


def lens(thickness: float, c1: float, c2: float, n: str, screen: float) -> FrozenScene:
    front = shape_xml("asphere", "front", 0.0, interface_xml("air", n), curvature=c1, semi_diameter=5.0)
    rear = shape_xml("asphere", "rear", thickness, interface_xml(n, "air"), curvature=c2, semi_diameter=5.0)
    return before_screen(front + rear, screen)


THROUGH, INDEX = "front:T rear:T screen:A", "front.bsdf.n_back_shift rear.bsdf.n_front_shift"


class TestClosedForms:
    def test_thin_lens_parallel_plate_and_tilted_mirror(self) -> None:
        """x = h (1 - D φ) + δ D φ with φ = (n - 1)(c1 - c2), to 1e-6 of thickness over focal length."""
        n, c1, c2, D = 1.5, 0.01, -0.012, 70.0
        faces = 2 * 4 * n / (n + 1) ** 2 * 4 * (1 - n) / (1 + n) ** 3  # two of T = 4 n/(n + 1)²
        expected = [("front.curvature", 0, -HEIGHT * D * (n - 1)), ("rear.curvature", 0, HEIGHT * D * (n - 1))]
        expected += [("front.x rear.x", 0, D * (n - 1) * (c1 - c2)), (INDEX, 2, faces)]
        expected += [(INDEX, 0, -HEIGHT * D * (c1 - c2))]
        assert_slopes(lens(1e-5, c1, c2, str(n), D), THROUGH, [HEIGHT, 0.0, -10.0], AXIAL, expected, 1e-6)
        # An oblique ray: y at the screen moves by tan θ' - tan θ per mm of glass, by t d(tan θ')/dn per index
        n, theta, t = 1.5, np.radians(35.0), 4.0
        sine, tangent = np.sin(theta) / n, np.tan(theta)
        inside = sine / np.sqrt(1 - sine**2)
        expected = [("rear.z", 1, inside - tangent), ("screen.z", 1, tangent), ("screen.y", 1, -1.0)]
        scene, ray = lens(t, 0.0, 0.0, str(n), 20.0), ([0.0, -1.0, -1.0], [0.0, np.sin(theta), np.cos(theta)])
        assert_slopes(scene, THROUGH, *ray, expected, 1e-9)
        assert_slopes(scene, THROUGH, *ray, [(INDEX, 1, -t * sine / n / (1 - sine**2) ** 1.5)], 1e-8)
        # A mirror that turns by a sends the light off by 2 a: at the distance D d(tan 2a)/da = 2 D
        bsdf = interface_xml(R=0.9, mirror=True)
        scene = before_screen(shape_xml("asphere", "mirror", 30.0, bsdf, semi_diameter=5.0), -20.0)
        turned = 2 * 50.0 * np.pi / 180
        expected = [("mirror.tilt_x", 1, turned), ("mirror.tilt_x", 0, 0), ("mirror.tilt_x", 2, 0)]
        expected += [("mirror.tilt_y", 0, -turned)]
        assert_slopes(scene, "mirror:R screen:A", np.zeros(3), AXIAL, expected, 1e-8)
        assert_slopes(scene, "mirror:R screen:A", np.zeros(3), AXIAL, [("mirror.bsdf.R", 2, 1.0)], 1e-9)

    def test_tube_and_cone(self) -> None:
        """Reflection at a wall at r: x = 2 r - x0 - z tan θ; a wall that opens at one end turns the ray, too."""
        wall = interface_xml(R=0.5)
        scene = before_screen(shape_xml("frustum", "wall", 0.0, wall, r0=5.0, z0=0.0, r1=5.0, z1=40.0), 40.0)
        theta = np.radians(20.0)
        z = 5.0 / np.tan(theta)
        # slope m: hit at r = 5 + m z, reflected by 2 m; to first order in m, with r1 = 5 + 40 m
        turned = 2 * z + (40 - z) * 2 / np.cos(theta) ** 2
        ray = np.zeros(3), [np.sin(theta), 0.0, np.cos(theta)]
        assert_slopes(scene, "wall:R screen:A", *ray, [("wall.r0 wall.r1", 0, 2.0), ("wall.bsdf.R", 2, 1.0)], 1e-9)
        assert_slopes(scene, "wall:R screen:A", *ray, [("wall.r1", 0, turned / 40)], 1e-8)

    def test_layers(self) -> None:
        """Characteristic matrices against `tmm`, absorbing layers and total reflection included."""
        rng = np.random.default_rng(3)
        for _ in range(40):
            n = rng.uniform(1.3, 2.5, 3) + 1j * rng.uniform(0, 0.3, 3) * (rng.random(3) < 0.5)
            stack = Stack(rng.choice([1.0, 1.7]), tuple(map(complex, n)), tuple(rng.uniform(20, 300, 3)), 1.3)
            cosine = rng.uniform(0.05, 1.0, 3)
            R, T = stack_powers(stack.n_incident, n, np.array(stack.d_nm), 1.3, 550.0, cosine)
            for k in range(3):
                assert (R[k], T[k]) == pytest.approx(by_tmm(stack, 550.0, cosine[k]).real.mean(axis=1)[:2], abs=1e-12)


def asphere_text(c: float = 0.02, conic: float = -0.5, a6: float = 1e-6, z: float = 6.0, place: str = "") -> str:
    """An aspheric lens off the axis of a beam; `place` goes before the rear face's own translation."""
    rear = shape_xml("asphere", "rear", z, interface_xml("1.6"), curvature=-c, conic=conic, a6=a6, semi_diameter=9.0)
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", "1.6"), curvature=0.03, semi_diameter=9.0),
        rear.replace("<translate", place + "<translate"),
        shape_xml("asphere", "screen", 40.0, sensor=True, half_width=50.0, half_height=50.0),
    )


GHOST = "front:T rear:R front:R rear:T screen:A"


class TestSequentialOracle:
    """A number that is moved and a scene that is written with the other number lead rays to the same points."""

    @pytest.mark.parametrize(
        ("key", "step", "text"),
        [
            ("rear.curvature", -1e-3, asphere_text(c=0.021)),
            ("rear.conic", 0.1, asphere_text(conic=-0.4)),
            ("rear.a6", 1e-7, asphere_text(a6=1.1e-6)),
            ("rear.z", 0.1, asphere_text(z=6.1)),
            ("rear.x", 0.2, asphere_text(place='<translate x="0.2"/>')),
            ("rear.tilt_x", 0.5, asphere_text(place='<rotate x="1" angle="0.5"/>')),
            ("rear.tilt_y", 0.5, asphere_text(place='<rotate y="1" angle="0.5"/>')),
        ],
    )
    def test_moved_scene(self, key: str, step: float, text: str) -> None:
        scene = read_frozen(asphere_text())
        rng = np.random.default_rng(1)
        rays = np.column_stack([rng.uniform(-4, 4, (30, 2)), np.full(30, -5.0)]), np.tile([0.05, -0.03, 1.0], (30, 1))
        moved, still = (follow(one, bundle_of(scene, GHOST, *rays)) for one in (scene.moved(key, step), scene))
        events = bundle_of(read_frozen(text), GHOST, *rays).events
        traced = replay(parse_scene(text), *rays, events, 550.0, first_hit=False)
        np.testing.assert_allclose(moved.points, traced.points[1:], rtol=0, atol=1e-10)
        np.testing.assert_allclose(moved.flux, traced.flux, rtol=1e-10)
        assert np.max(np.abs(still.points[-1] - traced.points[-1])) > 1e-4

    def test_decentre_before_the_tilts_and_numbers_that_move_together(self) -> None:
        """to_world · translate · Rx · Ry · Rz, written as Rz, Ry, Rx, translate."""
        place = '<rotate z="1" angle="30"/><rotate y="1" angle="0.7"/><rotate x="1" angle="-0.4"/><translate y="0.3"/>'
        text = asphere_text(place=place)
        scene = read_frozen(asphere_text())
        for name, step in (("tilt_z", 30.0), ("tilt_x", -0.4), ("y", 0.3), ("tilt_y", 0.7)):
            scene = scene.moved(f"rear.{name}", step)
        for one, other in zip(scene.pose("rear"), read_frozen(text).pose("rear"), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)
        # A derivative along a direction is the sum of those by the numbers; paths start where they begin to differ
        scene = read_frozen(asphere_text())
        origin = np.column_stack([np.linspace(-4, 4, 9), np.full(9, 1.0), np.full(9, -5.0)])
        heading = np.tile([0.0, 0.0, 1.0], (9, 1))
        paths = FrozenPaths(scene, [bundle_of(scene, events, origin, heading) for events in (THROUGH, GHOST)])
        direction = {"rear.curvature": 2e-6, "screen.x": 3e-4, "rear.tilt_x": 2e-3, "rear.bsdf.n_back_shift": 1e-5}
        metrics = [power, rms_radius, lambda hits: mean_position(hits)[0]]
        together = paths.along(metrics, {key: np.array([value]) for key, value in direction.items()})
        apart = sum(value * paths.derivatives(metrics, key, value) for key, value in direction.items())
        np.testing.assert_allclose(together, apart, rtol=1e-8)


ALONG = np.array([[0.0, 0.0, 1.0]])


def scene_of(*shapes: str, radius: float = 1.0) -> scene_xml.SceneModel:
    return scene_xml.parse_scene(scene_text(*shapes, radius=radius))


def traced(model: scene_xml.SceneModel, rays: int, **limits: float) -> nonsequential.Ledger:
    """From a beam along the axis that starts 5 mm before the origin; without a threshold unless it is given."""
    beam = beams.collimated(model.emitters[0], rays, 5.0, 0.0)
    limits = {"flux_threshold": 0.0, **limits}
    return nonsequential.trace(model, beam.origin, beam.direction, beam.power, 550.0, **limits)


def test_plates_in_closed_form_and_ghost_counts() -> None:
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
    pair = ["second_reflecting_surface", "first_reflecting_surface"]
    table = vectors.frame("ghost_lens_window_det.csv").set_index(pair)
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
        said = ("blocked by another", "reached the end", "missed the surface", "total internal reflection")
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
    return scatter.trace(model, scatter.scatter_models(text), beam.origin, beam.direction, beam.power, 550.0, **limits)


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
        for what, (flux, se), expected in (
            ("tube", books.detected, orders.sum()),
            ("two bounces", books.power("entrance:t wall:r wall:r detector:A"), orders[2]),
        ):
            assert_z(what, flux / np.pi, expected, se / np.pi, k=4.0)
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
    assert not {key: power for key, power in ledger.leaks_W.items() if not (open_plate and key[1] == "escape")}
    if field_deg == 0:
        assert ledger.detected_W > 0
        assert all(kind in ("SpecTran", "SpecRefl", "Absorbed") for _, kind in ledger.paths[0].events)

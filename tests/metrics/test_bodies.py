"""Bodies that are moved as a whole, as if built there, and the gaps that changes open, by plain geometry."""

import math
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.scatter_integrals import disc_to_disc
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.analyses.import_lens.entrances import Entrances, entrances
from mistray.analyses.optimize.study.variables import Variables, find_variables
from mistray.analyses.sweep.configurations import Configuration, resolve
from mistray.errors import MistrayError
from mistray.gradients.geometry_gradient import column_derivatives
from mistray.metrics.changes.first_surfaces import Entering, FirstLight, spoils, together
from mistray.metrics.changes.gaps import Contacts, Gap
from mistray.metrics.changes.outlines import outlines
from mistray.metrics.scene_values import changed
from mistray.optimize import Body, bodies, parameters, path_power, read_study
from mistray.physics.geometry.pose import moved
from mistray.prescription import Detector, Prescription, Source, Structure, Surface, moved_as_one, prism
from mistray.surfaces.gradient_columns import GEOMETRY, POSE


def scene() -> Any:
    """A prism, whose faces point to different sides, and a lens that is turned as a whole, with its edge."""
    front = Surface("front", radius=30.0, semi_diameter=5.0, back="1.5", part="L")
    rear = Surface("rear", radius=-30.0, semi_diameter=5.0, z=4.0, front="1.5", part="L")
    edge = Structure("edge", 5.0, 0.5, 5.0, 3.5, front="1.5", part="L")
    *lens, rim = moved_as_one((front, rear, edge), z=30.0, tilt_deg=(0.0, 20.0, 0.0))
    faces = prism("P", [(0, 0), (10, 10), (-10, 10)], 20.0, material="1.5")
    detector, light = Detector(z=60.0, half_width=9.0, half_height=9.0), Source(radius=5.0)
    parts: dict[str, Any] = {"surfaces": (*faces, *lens), "structures": (rim,), "source": light, "detector": detector}
    return Prescription(name="bodies", **parts).to_scene()


@pytest.fixture(scope="module")
def here() -> Any:
    return scene()


@pytest.fixture(scope="module")
def known(here: Any) -> dict[str, Body]:
    return bodies(parameters(here))


def frames(here: Any) -> dict[str, np.ndarray]:
    return {shape.id(): np.array(shape.matrix) for shape in here.shapes()}


class TestBody:
    def test_what_is_one(self, known: dict[str, Body]) -> None:
        assert (list(known), len(known["P"].frames)) == (["P", "L"], 5)
        np.testing.assert_allclose(known["P"].axes, np.eye(3))
        np.testing.assert_allclose(known["P"].pivot, (0.0, 0.0, 7.5), atol=1e-9)
        own = known["L"].axes
        np.testing.assert_allclose(own[:, 2], (np.sin(np.radians(20)), 0.0, np.cos(np.radians(20))), atol=1e-6)
        # The edge begins 0.5 mm behind the vertex of the front: the vertices of the faces are the outermost
        np.testing.assert_allclose(known["L"].pivot, np.array([0.0, 0.0, 30.0]) + 2 * own[:, 2], atol=1e-5)

    @pytest.mark.parametrize("part", ["P", "L"])
    def test_it_is_rigid(self, here: Any, known: dict[str, Body], part: str) -> None:
        """Large tilts and displacements at once: every frame moves as if it were fixed to the others."""
        body = known[part].about((1.0, -2.0, 3.0))
        amounts = {"x": 0.3, "y": -0.2, "z": 0.7, "tilt_x": 11.0, "tilt_y": -23.0, "tilt_z": 40.0}
        before = frames(here)
        with changed(mi.traverse(here), {key: np.array([change]) for key, change in body.moved(amounts).items()}):
            after = frames(here)
        turn, to_axes = moved(np.eye(4), 0, 0, 0, 11.0, -23.0, 40.0), np.eye(4)
        to_axes[:3, :3], to_axes[:3, 3] = body.axes, body.pivot
        motion = to_axes @ turn @ np.linalg.inv(to_axes)
        motion[:3, 3] += body.axes @ (0.3, -0.2, 0.7)
        for surface in body.frames:
            np.testing.assert_allclose(after[surface], motion @ before[surface], atol=2e-5)  # in single precision
            np.testing.assert_allclose(frames(here)[surface], before[surface], atol=1e-12)

    def test_on_top_of_what_a_surface_has(self, here: Any) -> None:
        """A lens whose front is decentred and a wedge already."""
        params = mi.traverse(here)
        with changed(params, {"front.x": np.array([0.1]), "front.tilt_y": np.array([3.0])}):
            before = frames(here)
            changes = bodies(parameters(here))["L"].tilted((5.0, 0.0, -7.0))
            with changed(params, {key: np.array([change + float(params[key][0])]) for key, change in changes.items()}):
                after = frames(here)
        relative = [np.linalg.inv(place["front"]) @ place["rear"] for place in (before, after)]
        np.testing.assert_allclose(relative[1], relative[0], atol=2e-5)

    @pytest.mark.parametrize("tilt_y", [0.0, 120.0, 180.0])
    def test_slopes_lead_to_columns(self, here: Any, known: dict[str, Body], tilt_y: float) -> None:
        """A tilt by one degree: each vertex moves by the angle times its arm, and its frame turns by the angle."""
        shapes, turned = {shape.id(): shape for shape in here.shapes()}, f"{next(iter(known['P'].frames))}.tilt_y"
        axis = np.radians(1.0) * np.array([1.0, 0.0, 0.0])
        with changed(mi.traverse(here), {turned: np.array([tilt_y])}):
            body = bodies(parameters(here))["P"]
            slopes = body.slopes("tilt_x")
            for surface in body.frames:
                shape = shapes[surface]
                moves = sum(slopes.get(f"{surface}.{name}", 0.0) * column_derivatives(shape, name) for name in POSE)
                frame = np.asarray(shape.vertex_frame(shape.values, shape.matrix))
                to_local = frame[:3, :3].T
                expected = [*to_local @ np.cross(axis, frame[:3, 3] - body.pivot), *to_local @ axis]
                np.testing.assert_allclose(moves[[GEOMETRY.index(name) for name in POSE]], expected, atol=1e-8)


class TestStudy:
    def variables(self, here: Any, *sections: dict[str, Any]) -> Variables:
        bounded = [{"low": -9, "high": 9} | section for section in sections]
        content = {"term": [{"kind": "path_power", "goal": "minimise"}], "variable": bounded}
        params = mi.traverse(here)
        return find_variables(read_study(content), params, parameters(here, params), {})

    def test_tilts_and_displacements_of_one_body(self, here: Any, known: dict[str, Body]) -> None:
        found = self.variables(
            here,
            {"parameters": "L.tilt_x"},
            {"parameters": [{"key": "L.tilt_y", "factor": -2.0}]},
            {"parameters": "L.z", "low": -1, "high": 1},
            {"name": "roll", "parameters": [{"key": "P.tilt_z", "pivot": [0, 1, 0]}], "low": -1, "high": 1},
        )
        assert found.names == ("L.tilt_x", "L.tilt_y", "front.z", "roll")
        assert [variable.unit for variable in found.variables] == ["deg", "deg", "mm", "deg"]
        np.testing.assert_allclose(found.start, 0.0)
        values = found.parameters([3.0, 2.0, 0.5, 0.25])
        expected = known["L"].moved({"tilt_x": 3.0, "tilt_y": -4.0, "z": 0.5})
        expected |= known["P"].about((0, 1, 0)).moved({"tilt_z": 0.25})
        assert set(values) == set(expected)
        for key, change in expected.items():
            assert values[key] == pytest.approx([change], abs=1e-9), key

    def test_chain_rule_and_refusals(self, here: Any) -> None:
        """Against central differences of all numbers of the surfaces, far from the start."""
        found = self.variables(here, *({"parameters": key} for key in (["L.tilt_x", "P.tilt_x"], "P.y", "L.tilt_z")))
        rng, x, h = np.random.default_rng(0), np.array([4.0, -1.0, 6.0]), 1e-4
        gradient = {key: rng.normal(size=1) for key in found.keys}
        slope = found.slope(gradient, x)
        for k, step in enumerate(h * np.eye(3)):
            more, less = found.parameters(x + step), found.parameters(x - step)
            expected = sum(float(gradient[key][0] * (more[key] - less[key])[0]) for key in gradient) / (2 * h)
            assert slope[k] == pytest.approx(expected, rel=1e-6)
        # What is named twice moves once
        (once, twice) = (self.variables(here, {"parameters": ["L.tilt_x"] * k}).parameters([3.0]) for k in (1, 2))
        assert once == twice
        one, two = {"parameters": "L.tilt_x", "low": 1, "high": 2}, {"parameters": "L.tilt_x"}
        for sections, message in (
            ([one], "L.tilt_x starts with 0"),
            ([one | {"scale": "log"}], "L.tilt_x starts with 0"),
            ([{"parameters": [{"key": "L.tilt_x", "pivot": [1, 2]}]}], r"pivot has 2 numbers; give 3"),
            ([{"parameters": [{"key": "front.radius", "pivot": [1, 2, 3]}]}], "it has no pivot"),
            ([{"parameters": ["L.tilt_x", "L.z"]}], "units deg, mm"),
            ([{"parameters": ["L.tilt_x", {"key": "L.tilt_x", "factor": 2}]}], r"L\.tilt_x is moved twice"),
            ([{"parameters": ["L.tilt_x", {"key": "L.tilt_x", "pivot": [1, 2, 3]}]}], r"L\.tilt_x is moved twice"),
            ([two | {"name": name} for name in "ab"], r"'a' and 'b' both move L\.tilt_x"),
        ):
            with pytest.raises(MistrayError, match=message):
                self.variables(here, *sections)


def test_configuration_and_derivative_by_several_numbers(here: Any, known: dict[str, Body]) -> None:
    """A tilt, and a displacement, which is a value of the surfaces' own."""
    (found,) = resolve(here, mi.traverse(here), [Configuration("bent", {"L.tilt_x": 2.0, "L.z": 0.5, "P.y": 1.0})])
    expected = known["L"].moved({"tilt_x": 2.0, "z": 0.5}) | known["P"].moved({"y": 1.0})
    assert {key: float(value[0]) for key, value in found.values.items()} == pytest.approx(expected, abs=1e-5)
    # Its error comes from the batches of the sum; what the gradient lacks is refused
    slopes = known["L"].slopes("tilt_x")
    found = mistray.gradient(path_power(here, "all", rays=2000), mi.traverse(here), keys=slopes)
    along = found.along(slopes)
    parts = sum(slope * found.batches[key][:, 0] for key, slope in slopes.items())
    assert along.value == pytest.approx(float(np.sum(parts)))
    assert along.se == pytest.approx(float(np.std(parts, ddof=1) * np.sqrt(32)))
    with pytest.raises(MistrayError, match=r"the gradient has no 'front\.curvature'"):
        found.along({**slopes, "front.curvature": 1.0})
    with pytest.raises(MistrayError, match="body 'L': there is no argument 'tilt'"):
        known["L"].slopes("tilt")


def tube(name: str, r0: float, z0: float, r1: float, z1: float) -> str:
    return shape_xml("frustum", name, r0=r0, z0=z0, r1=r1, z1=z1)


def opened(scene: mi.Scene, **values: float) -> tuple[Gap, ...]:
    """Gaps after values of parameters; a double underscore stands for a point."""
    keys = {key.replace("__", "."): np.array([value]) for key, value in values.items()}
    contacts = Contacts(scene)
    with changed(mi.traverse(scene), keys):
        found = contacts.opened(scene)
        assert contacts.opened(scene, {key.partition(".")[0] for key in keys}) == found
    assert contacts.opened(scene) == ()
    return found


def only(found: tuple[Gap, ...], *surfaces: str) -> float:
    (gap,) = found
    assert set(gap.surfaces) == set(surfaces)
    return gap.gap_mm


def test_tubes_and_the_edge_of_a_lens(load_scene: Callable[[str], mi.Scene]) -> None:
    detector = shape_xml("asphere", "detector", 60.0, sensor=True, half_width=3.0, half_height=3.0)

    def load(*shapes: str) -> mi.Scene:
        return load_scene(scene_text(*shapes, detector))

    scene = load(tube("front", 5, 0, 5, 10), tube("rear", 5, 10, 6, 20), tube("vane", 3, 10, 5, 10))
    # The vane stays with the front tube, and the gap is between it and the rear one, wherever the rim is
    assert only(opened(scene, rear__z=0.3), "rear", "front") == pytest.approx(0.3, abs=1e-6)
    assert (opened(scene, front__z=0.2), opened(scene, rear__z=5e-4)) == ((), ())
    # Circles in one plane whose centres are 0.1 mm apart are 0.1 mm apart where they are farthest
    assert only(opened(scene, rear__x=0.1), "rear", "front") == pytest.approx(0.1, rel=1e-3)
    apart = load(tube("front", 5, 0, 5, 10), tube("rear", 5, 10.01, 5, 20))
    assert opened(apart, rear__z=1.0) == ()  # what did not meet has no gap
    walls = (tube("front", 5, 0, 5, 10), tube("middle", 5, 10, 5, 20), tube("rear", 5, 20, 5, 30))
    scene = load(*walls, tube("vane", 3, 10, 5, 10))
    assert opened(scene, vane__z=12.0) == opened(scene, vane__z=-3.0) == ()
    (gap,) = opened(scene, vane__r1=4.5)
    assert set(gap.surfaces) in ({"vane", "front"}, {"vane", "middle"})
    assert gap.gap_mm == pytest.approx(0.5, abs=1e-6)
    # A wall may slide on a flange; a cone narrower than the hole leaves a gap, and one that is lifted too
    scene = load(tube("cone", 5, 0, 4, 8), tube("flange", 3.5, 8, 9, 8))
    assert opened(scene, cone__r1=3.6) == ()
    assert only(opened(scene, cone__r1=3.0), "cone", "flange") == pytest.approx(0.5, abs=1e-6)
    assert only(opened(scene, flange__z=0.25), "cone", "flange") == pytest.approx(0.25, abs=1e-6)
    assert opened(scene, flange__z=-0.25) == ()
    # The rim of a sphere lies at its sag, R - √(R² - r²)
    sag = 50 - math.sqrt(50**2 - 8**2)
    scene = load(
        shape_xml("asphere", "face", 0.0, interface_xml("air", "1.5"), radius=50.0, semi_diameter=8.0),
        shape_xml("asphere", "back", 6.0, interface_xml("1.5", "air"), semi_diameter=8.0),
        tube("edge", 8, sag, 8, 6),
        tube("barrel", 8, 6, 8, 30),
    )
    assert opened(scene, face__curvature=1 / 40) == ()  # the rim has moved along the edge
    steeper = sag - (100 - math.sqrt(100**2 - 8**2))
    assert (40 - math.sqrt(40**2 - 8**2)) > sag
    assert only(opened(scene, face__curvature=1 / 100), "face", "edge") == pytest.approx(steeper, rel=1e-5)
    assert opened(scene, back__z=0.4) == ()  # the lens has moved along the barrel
    assert only(opened(scene, barrel__z=0.4), "barrel", "edge") == pytest.approx(0.4, abs=1e-6)


def test_straight_rims_of_a_prism() -> None:
    body = prism("body", [(-5.0, 0.0), (5.0, 0.0), (5.0, 10.0), (-5.0, 10.0)], 8.0, material="1.5", ends=None)
    detector, source = Detector(z=30.0, semi_diameter=4.0), Source(radius=1.0)
    scene = Prescription(name="prism", surfaces=body, detector=detector, source=source).to_scene()
    contacts = Contacts(scene)
    assert {"body_1", "body_2", "body_3", "body_4", "body_left", "body_right"} <= contacts.surfaces
    with changed(mi.traverse(scene), {"body_3.z": np.array([0.2])}):
        found = contacts.opened(scene)
    assert found
    assert all("body_3" in gap.surfaces and gap.gap_mm == pytest.approx(0.2, abs=1e-5) for gap in found)


def mesh(name: str, vertices: list[tuple[float, float, float]], faces: list[tuple[int, ...]]) -> mi.Mesh:
    """A black mesh; its last face has two corners at one place, as those of CAD programs may."""
    found = mi.Mesh(name, len(vertices), len(faces) + 1)
    params = mi.traverse(found)
    params["vertex_positions"] = np.ravel(vertices)
    params["faces"] = np.ravel([*faces, (faces[0][0], faces[0][0], faces[0][1])])
    params.update()
    found.set_bsdf(mi.load_dict({"type": "interface", "R": 0.0}))
    return found


def test_round_rims_of_meshes() -> None:
    """A polygon of 64 sides closes a tube with the same corners, and the tube is drawn away from it by 0.3 mm."""
    ring = [(10.0 * math.cos(angle), 10.0 * math.sin(angle)) for angle in 2 * np.pi * np.arange(64) / 64]
    pairs = [(k, (k + 1) % 64) for k in range(64)]

    def scene(lift: float) -> mi.Scene:
        disc = mesh("disc", [(x, y, 0.0) for x, y in [*ring, (0.0, 0.0)]], [(j, k, 64) for j, k in pairs])
        sides = [face for j, k in pairs for face in ((j, k, j + 64), (k, k + 64, j + 64))]
        tube = mesh("tube", [(x, y, z + lift) for z in (0.0, 8.0) for x, y in ring], sides)
        beam = {"type": "collimated", "radius": 1.0}
        return scene_dicts.load(beam=beam, disc=disc, tube=tube, detector=scene_dicts.detector(20, semi_diameter=2.0))

    contacts = Contacts(scene(0.0))
    assert (contacts.surfaces, contacts.opened(scene(0.0))) == ({"disc", "tube"}, ())
    assert only(contacts.opened(scene(0.3)), "disc", "tube") == pytest.approx(0.3, abs=1e-5)


def test_a_triangle_without_area_has_no_inside() -> None:
    """It lies on the border of two faces, or beside them; a point over them is as far as their plane."""
    corners = np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0), (10.0, 10.0, 0.0), (5.0, 5.0, 0.0)])
    faces = [(0, 1, 2), (1, 3, 2)]
    for more in ((1, 1, 2), (1, 4, 2)):
        (found,) = outlines(scene_dicts.load(wall=mesh("wall", corners.tolist(), [*faces, more])), ["wall"])
        assert found.distance(np.array([(2.0, 2.0, 0.0), (2.0, 2.0, 3.0)])) == pytest.approx([0.0, 3.0], abs=1e-9)


def light(unseen: float = 0.0, direct: float = 0.0, **power: float) -> FirstLight:
    """Light of one path by each surface, known to 1 %; `direct` of it by the surface `front` is the image."""
    variance = {name: (0.01 * value) ** 2 for name, value in power.items()}
    return FirstLight(power, variance, {name: direct * (name == "front") for name in power}, power, unseen)


BEFORE = light(front=8.0, hood=0.02)
BRIGHT = {"front": 4.0, "L3": 1.0}
LOUD = FirstLight(BRIGHT, {"front": 0.0, "L3": 0.16}, {"front": 0.0, "L3": 0.0}, BRIGHT)


def test_what_is_new_and_its_share_of_the_stray_light() -> None:
    for after, before, new in (
        (BEFORE, BEFORE, []),
        (light(front=0.001, hood=0.02), BEFORE, []),  # the old light has gone, none is new
        (light(), BEFORE, []),
        (BEFORE, light(), []),
        (light(front=4.0, hood=4.0), BEFORE, ["hood"]),
        (light(front=4.0, hood=1.9), BEFORE, []),  # a trace of it before counts for none
        (light(front=4.0, L3=1.0), light(front=8.0, unseen=2.0), []),  # the list before may have left it out
        (light(front=4.0, L3=1.0), light(front=8.0, unseen=0.5), ["L3"]),
        (light(front=4.0, L3=0.003), BEFORE, []),  # less than 0.1 %
        (LOUD, BEFORE, []),  # less than three standard errors
    ):
        assert [one.surface for one in after.since(before)] == new
    (one,) = light(front=4.0, L3=1.0).since(BEFORE)
    assert one == Entering("L3", pytest.approx(0.2), pytest.approx(0.002), pytest.approx(1 / 8.02))
    # The image does not count: 3 of the light by the front
    (one,) = light(front=4.0, L3=1.0, direct=3.0).since(light(front=4.0, direct=3.0))
    assert (one.share, one.of_before) == pytest.approx((0.5, 1.0))
    both = light(front=1.0, L3=2.0).plus(light(front=3.0))  # independent traces add up
    assert (both.power, both.variance["front"]) == ({"front": 4.0, "L3": 2.0}, pytest.approx(0.01**2 * (1 + 9)))
    assert both.strongest == {"front": 3.0, "L3": 2.0}
    # There is no gain above a percent; but little light left of much is one, all that is left being new
    assert not spoils(())
    assert not spoils((Entering("a", 0.009, 0.001, 0.5),))
    two = Entering("a", 0.009, 0.003, 0.008), Entering("b", 0.002, 0.004, 0.003)
    assert spoils(two)
    assert together(two) == pytest.approx((0.011, 0.005))
    (one,) = light(front=1e-6, vane=8e-3).since(BEFORE)
    assert (one.share, one.of_before) == pytest.approx((1.0, 8e-3 / 8.02), rel=1e-3)
    assert not spoils([one])
    assert spoils(light(front=1e-6, vane=0.2).since(BEFORE))


RADIUS, SHEET, DISTANCE = 3.0, 5.0, 4.0
SHEET_XML = shape_xml("asphere", "sheet", 0.0, interface_xml(R=0.0, T=1.0), semi_diameter=SHEET)
DISC = shape_xml("asphere", "detector", DISTANCE, sensor=True, semi_diameter=RADIUS)


def test_around_a_sheet(load_scene) -> None:
    """What does not come through the sheet comes straight; χ² of 20 seeds between its quantiles 1e-5 and 1 - 1e-5."""
    scene = load_scene(scene_text(SHEET_XML, DISC))
    seeds = [entrances(scene, seed=seed) for seed in range(20)]
    assert {(found.first, *found.others) for found in seeds} == {("sheet", "detector")}
    exact = 1 - disc_to_disc(RADIUS, SHEET, DISTANCE)
    assert 3.0 < sum(((one.share - exact) / one.share_se) ** 2 for one in seeds) < 60.0
    assert all(0.005 < one.share_se < 0.03 for one in seeds)
    tube = shape_xml("frustum", "tube", r0=SHEET, z0=0.0, r1=SHEET, z1=DISTANCE + 1)
    found = entrances(load_scene(scene_text(SHEET_XML, tube, DISC)))
    assert (found.share, found.others) == (0.0, {})
    assert found.rays >= 100
    found = entrances(load_scene(scene_text(DISC)))
    assert (found.first, found.rays) == ("", 0)
    assert "below 95 %" in str(Entrances("sheet", 1, 0.0, 0.0, {}))  # one ray alone

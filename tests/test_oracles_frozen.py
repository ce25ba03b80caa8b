"""The oracle of frozen paths against closed forms, and against the sequential oracle on scenes written anew."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.frozen_paths import Bundle, FrozenPaths, follow, mean_position, power, rms_radius
from oracles.frozen_scene import FrozenScene, read_frozen
from oracles.layers import stack_powers
from oracles.replay import replay
from oracles.scene_xml import parse_scene
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.stacks import Stack, by_tmm

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


def derivative(scene: FrozenScene, text: str, key: str, origin, direction, step: float = 1e-5):
    paths = FrozenPaths(scene, [bundle_of(scene, text, np.atleast_2d(origin), np.atleast_2d(direction))])
    metrics = [lambda hits: hits[0].x.sum(), lambda hits: hits[0].y.sum(), power]
    return paths.derivatives(metrics, key, step)


AXIAL = np.array([0.0, 0.0, 1.0])
HEIGHT = 1e-4  # paraxial, mm


def before_screen(shapes: str, z: float) -> FrozenScene:
    screen = shape_xml("asphere", "screen", z, sensor=True, half_width=50.0, half_height=50.0)
    return read_frozen(scene_text(shapes, screen))


def lens(thickness: float, c1: float, c2: float, n: str, screen: float) -> FrozenScene:
    front = shape_xml("asphere", "front", 0.0, interface_xml("air", n), curvature=c1, semi_diameter=5.0)
    rear = shape_xml("asphere", "rear", thickness, interface_xml(n, "air"), curvature=c2, semi_diameter=5.0)
    return before_screen(front + rear, screen)


THROUGH = "front:T rear:T screen:A"


class TestClosedForms:
    def test_thin_lens(self) -> None:
        """x = h (1 - D φ) + δ D φ with φ = (n - 1)(c1 - c2), to 1e-6 of thickness over focal length."""
        n, c1, c2, D = 1.5, 0.01, -0.012, 70.0
        scene = lens(1e-5, c1, c2, str(n), D)
        start = np.array([HEIGHT, 0.0, -10.0])
        x = derivative(scene, THROUGH, "front.curvature", start, AXIAL)[0]
        assert x == pytest.approx(-HEIGHT * D * (n - 1), rel=1e-6)
        x = derivative(scene, THROUGH, "rear.curvature", start, AXIAL)[0]
        assert x == pytest.approx(HEIGHT * D * (n - 1), rel=1e-6)
        moved = sum(derivative(scene, THROUGH, f"{face}.x", start, AXIAL)[0] for face in ("front", "rear"))
        assert moved == pytest.approx(D * (n - 1) * (c1 - c2), rel=1e-6)
        index = derivative(scene, THROUGH, "front.bsdf.n_back_shift", start, AXIAL)
        index = index + derivative(scene, THROUGH, "rear.bsdf.n_front_shift", start, AXIAL)
        assert index[0] == pytest.approx(-HEIGHT * D * (c1 - c2), rel=1e-6)
        # Two faces of T = 4 n/(n + 1)²
        assert index[2] == pytest.approx(2 * 4 * n / (n + 1) ** 2 * 4 * (1 - n) / (1 + n) ** 3, rel=1e-6)

    def test_parallel_plate(self) -> None:
        """An oblique ray: y at the screen moves by tan θ' - tan θ per mm of glass, by t d(tan θ')/dn per index."""
        n, theta, t = 1.5, np.radians(35.0), 4.0
        scene = lens(t, 0.0, 0.0, str(n), 20.0)
        start, d = np.array([0.0, -1.0, -1.0]), np.array([0.0, np.sin(theta), np.cos(theta)])
        sine = np.sin(theta) / n
        inside = sine / np.sqrt(1 - sine**2)
        assert derivative(scene, THROUGH, "rear.z", start, d)[1] == pytest.approx(inside - np.tan(theta), rel=1e-9)
        assert derivative(scene, THROUGH, "screen.z", start, d)[1] == pytest.approx(np.tan(theta), rel=1e-9)
        assert derivative(scene, THROUGH, "screen.y", start, d)[1] == pytest.approx(-1.0, rel=1e-9)
        keys = ("front.bsdf.n_back_shift", "rear.bsdf.n_front_shift")
        by_n = sum(derivative(scene, THROUGH, key, start, d)[1] for key in keys)
        assert by_n == pytest.approx(-t * sine / n / (1 - sine**2) ** 1.5, rel=1e-8)

    def test_tilted_mirror(self) -> None:
        """A mirror that turns by a sends the light off by 2 a: at the distance D d(tan 2a)/da = 2 D."""
        bsdf = interface_xml(R=0.9, mirror=True)
        scene = before_screen(shape_xml("asphere", "mirror", 30.0, bsdf, semi_diameter=5.0), -20.0)
        start = np.array([0.0, 0.0, 0.0])
        found = derivative(scene, "mirror:R screen:A", "mirror.tilt_x", start, AXIAL)
        assert found[1] == pytest.approx(2 * 50.0 * np.pi / 180, rel=1e-8)
        assert found[[0, 2]] == pytest.approx(0, abs=1e-9)
        found = derivative(scene, "mirror:R screen:A", "mirror.tilt_y", start, AXIAL)
        assert found[0] == pytest.approx(-2 * 50.0 * np.pi / 180, rel=1e-8)
        assert derivative(scene, "mirror:R screen:A", "mirror.bsdf.R", start, AXIAL)[2] == pytest.approx(1, rel=1e-9)

    def test_tube_and_cone(self) -> None:
        """Reflection at a wall at r: x = 2 r - x0 - z tan θ; a wall that opens at one end turns the ray, too."""
        wall = interface_xml(R=0.5)
        scene = before_screen(shape_xml("frustum", "wall", 0.0, wall, r0=5.0, z0=0.0, r1=5.0, z1=40.0), 40.0)
        start, theta = np.array([0.0, 0.0, 0.0]), np.radians(20.0)
        d = np.array([np.sin(theta), 0.0, np.cos(theta)])
        found = sum(derivative(scene, "wall:R screen:A", f"wall.{rim}", start, d)[0] for rim in ("r0", "r1"))
        assert found == pytest.approx(2.0, rel=1e-9)
        z = 5.0 / np.tan(theta)
        # slope m: hit at r = 5 + m z, reflected by 2 m; to first order in m, with r1 = 5 + 40 m
        turned = 2 * z + (40 - z) * 2 / np.cos(theta) ** 2
        assert derivative(scene, "wall:R screen:A", "wall.r1", start, d)[0] == pytest.approx(turned / 40, rel=1e-8)
        assert derivative(scene, "wall:R screen:A", "wall.bsdf.R", start, d)[2] == pytest.approx(1.0, rel=1e-9)

    def test_layers(self) -> None:
        """Characteristic matrices against `tmm`, absorbing layers and total reflection included."""
        rng = np.random.default_rng(3)
        for _ in range(40):
            n = rng.uniform(1.3, 2.5, 3) + 1j * rng.uniform(0, 0.3, 3) * (rng.random(3) < 0.5)
            stack = Stack(rng.choice([1.0, 1.7]), tuple(map(complex, n)), tuple(rng.uniform(20, 300, 3)), 1.3)
            cosine = rng.uniform(0.05, 1.0, 3)
            R, T = stack_powers(stack.n_incident, n, np.array(stack.d_nm), 1.3, 550.0, cosine)
            for k in range(3):
                expected = by_tmm(stack, 550.0, cosine[k]).real.mean(axis=1)
                assert (R[k], T[k]) == pytest.approx(expected[:2], abs=1e-12)


def asphere_text(c: float = 0.02, conic: float = -0.5, a6: float = 1e-6, z: float = 6.0, place: str = "") -> str:
    """An aspheric lens off the axis of a beam; `place` goes before the rear face's own translation."""
    rear = shape_xml(
        "asphere", "rear", z, interface_xml("1.6", "air"), curvature=-c, conic=conic, a6=a6, semi_diameter=9.0
    )
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

    def test_decentre_comes_before_the_tilts(self) -> None:
        """to_world · translate · Rx · Ry · Rz, written as Rz, Ry, Rx, translate."""
        place = '<rotate z="1" angle="30"/><rotate y="1" angle="0.7"/><rotate x="1" angle="-0.4"/><translate y="0.3"/>'
        text = asphere_text(place=place)
        scene = read_frozen(asphere_text())
        for name, step in (("tilt_z", 30.0), ("tilt_x", -0.4), ("y", 0.3), ("tilt_y", 0.7)):
            scene = scene.moved(f"rear.{name}", step)
        pose = read_frozen(text).pose("rear")
        for one, other in zip(scene.pose("rear"), pose, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)

    def test_numbers_move_together(self) -> None:
        """A derivative along a direction is the sum of those by the numbers; paths start where they begin to differ."""
        scene = read_frozen(asphere_text())
        origin = np.column_stack([np.linspace(-4, 4, 9), np.full(9, 1.0), np.full(9, -5.0)])
        heading = np.tile([0.0, 0.0, 1.0], (9, 1))
        paths = FrozenPaths(scene, [bundle_of(scene, events, origin, heading) for events in (THROUGH, GHOST)])
        direction = {"rear.curvature": 2e-6, "screen.x": 3e-4, "rear.tilt_x": 2e-3, "rear.bsdf.n_back_shift": 1e-5}
        metrics = [power, rms_radius, lambda hits: mean_position(hits)[0]]
        together = paths.along(metrics, {key: np.array([value]) for key, value in direction.items()})
        apart = sum(value * paths.derivatives(metrics, key, value) for key, value in direction.items())
        np.testing.assert_allclose(together, apart, rtol=1e-8)

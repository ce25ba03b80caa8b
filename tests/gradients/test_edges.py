"""What a metric gains where rims move, by zones of two widths; each comparison fails by chance once in 1000 times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from oracles.frozen_paths import Bundle, follow
from oracles.frozen_scene import FrozenScene, read_frozen
from oracles.rim_distances import edge_derivative
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import assert_z
from recorded_edges import backward_edges, traced_edges

from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import CLASS_COUNT, MULTIPLE, SINGLE
from mistray.recorders.directions import DirectionGrid
from mistray.settings import Settings

WRONG = 1.3
STEP = 1e-5  # mm or degrees, of the central differences of distances
Load = Callable[[str], Any]


def sums(by_batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum over the 32 batches and its standard error."""
    return by_batch.sum(-1), by_batch.std(-1, ddof=1) * np.sqrt(by_batch.shape[-1])


def check(what: str, found: np.ndarray, expected: float, expected_se: float = 0.0) -> None:
    """Derivatives (2, 32) of two widths against a known one, which a wrong sign and a wrong factor must not pass."""
    value, se = sums(found)
    names = [what, f"{what}, half the width"]
    assert_z(what, value, expected, np.hypot(se, expected_se), names=names)
    for factor in (-1.0, WRONG):
        with pytest.raises(AssertionError):
            assert_z(what, factor * value, expected, np.hypot(abs(factor) * se, expected_se))


def traced(load: Load, text: str, keys: list[str], **arguments: Any) -> dict[str, np.ndarray]:
    """Derivatives of the detected power, W, by some numbers of a scene."""
    _, groups = traced_edges(load(text), **{"width": 0.04, "rays": 400_000} | arguments)
    frozen = read_frozen(text)
    return {key: edge_derivative(frozen, groups, key, STEP) for key in keys}


def detector(z: float, half: float = 30.0) -> str:
    """A large black detector."""
    return shape_xml("asphere", "detector", z, sensor=True, half_width=half, half_height=half)


class TestClosedForms:
    def test_hole_in_a_stop(self, load_scene) -> None:
        stop = shape_xml("frustum", "stop", 5.0, r0=3.0, z0=0.0, r1=8.0, z1=0.0)
        found = traced(load_scene, scene_text(stop, detector(10.0), radius=5.0), ["stop.r0", "stop.x", "stop.z"])
        check("hole", found["stop.r0"], 2 * np.pi * 3.0)
        value, se = sums(found["stop.x"])
        assert_z("decentre of a hole that is lit all over", value, 0.0, se)
        assert np.all(np.abs(found["stop.z"]) < 1e-9)  # collimated light along the axis

    def test_decentred_hole(self, load_scene) -> None:
        """A hole of radius 3 mm, 4 mm off the axis of a beam of radius 5 mm: the circles cross 3 mm off their line."""
        stop = placed_xml("frustum", "stop", at=(4.0, 0.0, 5.0), r0=3.0, z0=0.0, r1=12.0, z1=0.0)
        found = traced(load_scene, scene_text(stop, detector(10.0), radius=5.0), ["stop.x"])
        check("decentre", found["stop.x"], -6.0)

    def test_tilted_stop(self, load_scene) -> None:
        sine, cosine = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
        facing = (0.0, -sine, cosine)
        stop = placed_xml("frustum", "stop", at=(0.0, 0.0, 8.0), facing=facing, r0=3.0, z0=0.0, r1=8.0, z1=0.0)
        found = traced(load_scene, scene_text(stop, detector(20.0), radius=5.0), ["stop.tilt_x", "stop.r0"])
        check("tilt", found["stop.tilt_x"], -np.pi * 9.0 * sine * np.pi / 180)
        check("hole", found["stop.r0"], 6 * np.pi * cosine)

    def test_rim_of_a_surface_that_passes_half(self, load_scene) -> None:
        """Light that misses the filter is detected whole."""
        half = interface_xml(R=0.0, T=0.5)
        plate = shape_xml("asphere", "plate", 5.0, half, semi_diameter=3.0, inner_semi_diameter=1.0)
        keys = ["plate.semi_diameter", "plate.inner_semi_diameter"]
        found = traced(load_scene, scene_text(plate, detector(10.0), radius=5.0), keys, rays=1_000_000)
        check("outer", found["plate.semi_diameter"], -0.5 * 2 * np.pi * 3.0)
        check("inner", found["plate.inner_semi_diameter"], 0.5 * 2 * np.pi * 1.0)

    def test_rectangle(self, load_scene) -> None:
        plate = shape_xml("asphere", "detector", 5.0, sensor=True, half_width=3.0, half_height=1.0, curvature=0.02)
        keys = ["detector.half_width", "detector.half_height"]
        found = traced(load_scene, scene_text(plate, radius=5.0), keys, rays=1_000_000)
        check("sides", found["detector.half_width"], 4.0)
        check("top and bottom", found["detector.half_height"], 12.0)

    def test_funnel(self, load_scene) -> None:
        """A cone that ends in a hole: where it begins and how long it is does not matter."""
        cone = shape_xml("frustum", "funnel", 5.0, r0=6.0, z0=0.0, r1=2.0, z1=7.0)
        keys = ["funnel.r1", "funnel.r0", "funnel.z1"]
        found = traced(load_scene, scene_text(cone, detector(20.0), radius=5.0), keys, rays=1_000_000)
        check("hole", found["funnel.r1"], 4 * np.pi)
        for key in keys[1:]:
            value, se = sums(found[key])
            assert_z(key, value, 0.0, se)

    def test_stop_behind_a_lens(self, load_scene) -> None:
        """The beam converges: how much of it passes depends on the lens."""
        bare = {"R": 0.0, "T": 1.0}
        text = scene_text(
            shape_xml("asphere", "front", 5.0, interface_xml("air", "1.7", **bare), curvature=0.05, semi_diameter=7.0),
            shape_xml("asphere", "rear", 9.0, interface_xml("1.7", "air", **bare), curvature=-0.02, semi_diameter=7.0),
            shape_xml("frustum", "stop", 15.0, r0=2.0, z0=0.0, r1=8.0, z1=0.0),
            detector(25.0),
            radius=4.0,
        )
        keys = ["stop.r0", "stop.z", "front.curvature", "front.z"]
        _, groups = traced_edges(load_scene(text), 0.04, rays=1_000_000)
        frozen = read_frozen(text)
        height = _height_that_meets(frozen, 2.0)
        slope = (_radius_at_stop(frozen, height + 1e-4) - _radius_at_stop(frozen, height - 1e-4)) / 2e-4
        for key in keys:
            change = 1.0
            if key != "stop.r0":
                moved = [_radius_at_stop(frozen.moved(key, sign * STEP), height) for sign in (1, -1)]
                change = -(moved[0] - moved[1]) / (2 * STEP)
            check(key, edge_derivative(frozen, groups, key, STEP), 2 * np.pi * height * change / slope)


def _radius_at_stop(frozen: FrozenScene, height: float) -> float:
    """Distance from the axis at the stop of a ray that starts parallel to it at a height, mm."""
    events = (("front", "SpecTran"), ("rear", "SpecTran"), ("stop", "Absorbed"))
    start, one = np.array([[height, 0.0, 0.0]]), np.ones(1)
    near = np.array([[[height, 0.0, z]] for z in (5.0, 9.0, 15.0)])
    ray = Bundle(events, start, np.array([[0.0, 0.0, 1.0]]), near, np.zeros((3, 1, 3)), one, one, np.zeros(1, int))
    return float(np.hypot(*follow(frozen, ray).points[-1][0, :2]))


def _height_that_meets(frozen: FrozenScene, radius: float) -> float:
    low, high = 0.0, 3.9
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius_at_stop(frozen, middle) < radius else (low, middle)
    return low


class TestCorners:
    """Light that comes in at 20°; the holes of a thick stop and of a tube are then two circles that overlap."""

    RADIUS, LENGTH, FIELD = 3.0, 2.0, np.radians(20.0)

    def test_thick_stop(self, load_scene) -> None:
        """A convex edge counts once: the land, a half mirror, meets of π r² cos θ what the two circles do not share."""
        r, length = self.RADIUS, self.LENGTH
        land = shape_xml("frustum", "land", 5.0, interface_xml(R=0.5), r0=r, z0=0.0, r1=r, z1=length)
        front, rear = (
            shape_xml("frustum", name, z, r0=r, z0=0.0, r1=12.0, z1=0.0)
            for name, z in (("front", 5.0), ("rear", 5.0 + length))
        )
        keys = ["front.r0", "rear.r0", "land.r0", "land.r1"]
        text = scene_text(front, land, rear, detector(12.0), radius=8.0)
        found = traced(load_scene, text, keys, field_deg=20.0, rays=1_000_000)
        apart = length * np.tan(self.FIELD)
        shared = 4 * r * np.arccos(apart / (2 * r))  # derivative of the area that the circles share
        check("radius", sum(found.values()), np.cos(self.FIELD) * (0.5 * 2 * np.pi * r + 0.5 * shared))
        assert np.all(found["rear.r0"] == 0)  # no light meets it close to its rim from the front
        assert all(abs(sums(found[key])[0][0]) > 5 * sums(found[key])[1][0] for key in ("front.r0", "land.r0"))

    def test_vane_in_a_tube(self, load_scene) -> None:
        """The vane is the detector, lit where its circle and the mouth's overlap; its outer radius is nothing."""
        r, depth = 5.0, 6.0
        text = scene_text(
            shape_xml("frustum", "mouth", 5.0, r0=r, z0=0.0, r1=15.0, z1=0.0),
            shape_xml("frustum", "tube", 5.0, r0=r, z0=0.0, r1=r, z1=10.0),
            shape_xml("frustum", "vane", 5.0 + depth, sensor=True, r0=1.0, z0=0.0, r1=r, z1=0.0),
            radius=12.0,
        )
        keys = ["vane.r1", "vane.r0", "vane.z", "tube.r0", "tube.r1", "mouth.r0"]
        found = traced(load_scene, text, keys, field_deg=20.0, rays=1_000_000)
        assert np.all(found["vane.r1"] == 0)
        apart = depth * np.tan(self.FIELD)
        check("vane.z", found["vane.z"], -np.sin(self.FIELD) * np.sqrt(4 * r * r - apart**2))
        tied = found["tube.r0"] + found["tube.r1"] + found["mouth.r0"] + found["vane.r1"]
        check("radius", tied, np.cos(self.FIELD) * 4 * r * np.arccos(apart / (2 * r)))
        check("vane.r0", found["vane.r0"], -np.cos(self.FIELD) * 2 * np.pi * 1.0)


TUBE, HOLE, VANE, LENGTH, HALF, ALBEDO = 15.0, 6.0, 20.0, 40.0, 5.0, 0.6


def baffle_text(hole: float = HOLE, vane: float = VANE, paint: float = 0.0) -> str:
    """A Lambertian tube with a vane, and a detector of radius `HALF` in its black rear end; light comes in at z = 0."""
    surface = wall_xml(paint) if paint else None
    return scene_text(
        shape_xml("frustum", "tube", 0.0, wall_xml(ALBEDO), r0=TUBE, z0=0.0, r1=TUBE, z1=LENGTH),
        shape_xml("frustum", "vane", vane, surface, r0=hole, z0=0.0, r1=TUBE, z1=0.0),
        shape_xml("frustum", "detector", LENGTH, sensor=True, r0=0.0, z0=0.0, r1=HALF, z1=0.0),
        shape_xml("frustum", "end", LENGTH, r0=HALF, z0=0.0, r1=TUBE, z1=0.0),
    )


def scattered(load: Load, text: str, rays: int, scatters: int, seed: int) -> tuple[BackwardTrace, np.ndarray]:
    """A backward trace and what scattered light leaves, by batch, as a share of all start rays."""
    settings = Settings(max_scatters=scatters, seed=seed)
    trace = BackwardTrace(load(text), DirectionGrid.of([45.0], cell_deg=90.0), settings, both_sides=False)
    trace.advance(rays)
    return trace, trace.sums.cells[[SINGLE, MULTIPLE]].sum(axis=(0, 1, 2)) / rays


def scatter_derivative(rays: int) -> np.ndarray:
    """Derivative of what `scattered` gives, by the sums of the classes."""
    derivative = np.zeros((CLASS_COUNT, 1, 1))
    derivative[[SINGLE, MULTIPLE]] = 1 / rays
    return derivative


class TestAgainstTheLight:
    @pytest.mark.long
    def test_central_differences(self, load_scene) -> None:
        """Vane that scatters, up to three events; the step of 0.4 mm shows no curvature beyond the error."""
        rays, step = 400_000, 0.4
        trace, _ = scattered(load_scene, baffle_text(paint=0.5), rays, 3, 0)
        ends = [scattered(load_scene, baffle_text(HOLE + s * step, paint=0.5), rays, 3, 1)[1] for s in (1, -1)]
        expected, se = sums((ends[0] - ends[1]) / (2 * step))
        groups = backward_edges(trace, scatter_derivative(rays), 0.2)
        found = edge_derivative(read_frozen(baffle_text(paint=0.5)), groups, "vane.r0", STEP)
        check("radius of the hole", found, expected, se)

    @pytest.mark.long
    def test_direct_edge_sampling(self, load_scene) -> None:
        """Black vane, one scatter event, against the integral along its rim; the corner with the tube gains nothing."""
        rays = 1_000_000
        trace, _ = scattered(load_scene, baffle_text(), rays, 1, 0)
        groups = backward_edges(trace, scatter_derivative(rays), 0.2)
        assert all(hits.joined is None for hits in groups)
        frozen = read_frozen(baffle_text())
        radius, move = integral_along_the_rim(2_000_000)
        check("radius of the hole", edge_derivative(frozen, groups, "vane.r0", STEP), *radius)
        value, se = sums(edge_derivative(frozen, groups, "vane.z", STEP))
        assert_z("move along the axis", value, move[0], np.hypot(se, move[1]))
        with pytest.raises(AssertionError):
            assert_z("move along the axis", -value, move[0], np.hypot(se, move[1]))

    def test_corner_on_the_detector(self, load_scene) -> None:
        """
        A black tube stands on the detector, and only what it surrounds sees the sky.

        Rays start on either side of it. What leaves is the view factor of two equal discs (J. R. Howell, A Catalog of
        Radiation Heat Transfer Configuration Factors, C-40) times the share of the detector that the tube surrounds.
        """
        radius, length, detector_radius, rays = 6.0, 10.0, 9.0, 1_000_000
        text = scene_text(
            shape_xml("frustum", "tube", 20.0, r0=radius, z0=0.0, r1=radius, z1=length),
            shape_xml("frustum", "lid", 20.0, r0=radius, z0=0.0, r1=12.0, z1=0.0),
            shape_xml("frustum", "box", 20.0, r0=12.0, z0=0.0, r1=12.0, z1=length),
            shape_xml("frustum", "detector", 30.0, sensor=True, r0=0.0, z0=0.0, r1=detector_radius, z1=0.0),
        )

        def share(r: float) -> float:
            x = 1 + (1 + (r / length) ** 2) / (r / length) ** 2
            return 0.5 * (x - np.sqrt(x * x - 4)) * (r / detector_radius) ** 2

        grid = DirectionGrid.of([45.0], cell_deg=90.0)
        trace = BackwardTrace(load_scene(text), grid, Settings(max_scatters=0), both_sides=False)
        trace.advance(rays)
        leaves, se = sums(trace.sums.cells.sum(axis=(0, 1, 2)) / rays)
        assert_z("share that leaves", leaves, share(radius), se)
        groups = backward_edges(trace, np.full((CLASS_COUNT, 1, 1), 1 / rays), 0.1)
        assert {hits.joined for hits in groups} == {None, "detector"}
        frozen = read_frozen(text)
        corner = edge_derivative(frozen, [hits for hits in groups if hits.joined], "tube.r1", STEP)
        assert abs(sums(corner)[0][0]) > 10 * sums(corner)[1][0]
        found = [edge_derivative(frozen, groups, key, STEP) for key in ("tube.r0", "tube.r1", "lid.r0")]
        check("radius", sum(found), (share(radius + STEP) - share(radius - STEP)) / (2 * STEP))


def integral_along_the_rim(samples: int) -> list[tuple[float, float]]:
    """
    Derivatives of what leaves after one scatter event by the radius of the hole and its place, in float64 NumPy.

    At a point of the rim, which is the same all along it, the radiance that comes from the detector's side is either
    the detector's own, 1/(π A), and the light is scattered by the tube beyond the vane; or the tube's behind the vane,
    and the light leaves at once. A larger hole passes L cos θ dω ds dr of it; the vane is black. When it moves by dz,
    light meets it further out by dz d_ρ/d_z.
    """
    rng = np.random.default_rng(7)
    point, own = np.array([HOLE, 0.0, VANE]), 1 / (np.pi * np.pi * HALF**2)

    def on_detector() -> np.ndarray:
        rho, turn = HALF * np.sqrt(rng.random(samples)), 2 * np.pi * rng.random(samples)
        return np.column_stack([rho * np.cos(turn), rho * np.sin(turn), np.full(samples, LENGTH)])

    def to_tube(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        a, b = (d[:, :2] ** 2).sum(1), (o[:, :2] * d[:, :2]).sum(1)
        return o + ((-b + np.sqrt(b * b + a * (TUBE**2 - (o[:, :2] ** 2).sum(1)))) / a)[:, None] * d

    def cosine_directions(normal: np.ndarray) -> np.ndarray:
        v = rng.standard_normal((samples, 3))
        d = normal + v / np.linalg.norm(v, axis=1, keepdims=True)
        return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))

    # From the detector past the rim to the tube in front of the vane, and out of its mouth
    apart = point - on_detector()
    distance = np.linalg.norm(apart, axis=1)
    d = apart / distance[:, None]
    passed = own * d[:, 2] ** 2 / distance**2 * np.pi * HALF**2  # L cos θ at the rim, per area of the detector
    wall = to_tube(np.broadcast_to(point, d.shape), d)
    inward = -wall * np.array([1.0, 1.0, 0.0]) / TUBE
    out = cosine_directions(inward)
    leaves = (out[:, 2] < 0) & (to_tube(wall, out)[:, 2] < 0)
    first = passed * ALBEDO * ((wall[:, 2] > 0) & leaves)
    parts = [(first, -d[:, 0] / d[:, 2])]
    # From the tube behind the vane past the rim and out of the mouth
    d = cosine_directions(np.array([0.0, 0.0, -1.0]))
    wall = to_tube(np.broadcast_to(point, d.shape), -d)
    apart = wall - on_detector()
    distance2 = (apart**2).sum(1)
    inward = -wall * np.array([1.0, 1.0, 0.0]) / TUBE
    cosines = -apart[:, 2] * np.maximum(-(apart * inward).sum(1), 0) / distance2
    lit = ALBEDO / np.pi * own * cosines / distance2 * np.pi * HALF**2
    leaves = to_tube(np.broadcast_to(point, d.shape), d)[:, 2] < 0
    second = np.pi * lit * ((wall[:, 2] < LENGTH) & leaves)
    parts.append((second, -d[:, 0] / d[:, 2]))
    results = []
    for values in (sum(part for part, _ in parts), sum(part * outward for part, outward in parts)):
        whole = 2 * np.pi * HOLE * values
        results.append((float(whole.mean()), float(whole.std() / np.sqrt(samples))))
    return results

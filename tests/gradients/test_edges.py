"""What a metric gains where rims and silhouettes move, and at the onset of total reflection; 1 of 1000 runs fails."""

from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from oracles.frozen_paths import Bundle, follow
from oracles.frozen_scene import FrozenScene, read_frozen
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import assert_z
from scipy.optimize import brentq

import mistray
from mistray.errors import MistrayError
from mistray.gradients import edges
from mistray.metrics.scene_values import changed
from mistray.optimize import Metric, path_power, pst_bin

WRONG = 1.3
Parts = dict[str, np.ndarray]


def parts_of(metric: Metric, keys: Sequence[str], edge_width: float | None = None) -> Parts:
    """Key → derivative by batch (2, 32), with zones of the width and of half of it."""
    found = mistray.gradient(metric, mi.traverse(metric.scene), keys, edge_width=edge_width)
    parts = {}
    for key in keys:
        wide = found.batches[key][:, 0]
        widths = found.edge_batches.get(key)
        more = 0.0 if widths is None else np.subtract(*widths[[found.edge_number + 1, found.edge_number], :, 0])
        parts[key] = np.stack([wide, wide + more])
    return parts


def power_parts(
    scene: mi.Scene, keys: Sequence[str], edge_width: float | None = None, field_deg: float = 0.0, **settings: int
) -> Parts:
    """Of the detected power, W."""
    settings = {"rays": 400_000, "max_scatters": 0} | settings
    metric = Metric(scene, lambda seen: seen[0].power("all"), field_deg=field_deg, settings=settings)
    return parts_of(metric, keys, edge_width)


def sums(by_batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum over the 32 batches and its standard error."""
    return by_batch.sum(-1), by_batch.std(-1, ddof=1) * np.sqrt(by_batch.shape[-1])


def check(what: str, found: np.ndarray, expected: float, expected_se: float = 0.0) -> None:
    """Derivatives (2, 32) of two widths, none of which may pass with another sign, as 0, or if it is too large."""
    value, se = sums(found)
    assert_z(what, value, expected, np.hypot(se, expected_se), names=[what, f"{what}, half the width"])
    for factor in (-1.0, 0.0, WRONG):
        with pytest.raises(AssertionError):
            assert_z(what, factor * value, expected, np.hypot(abs(factor) * se, expected_se))


STEP = 1e-5  # mm or 1/mm, of central differences of the oracle


def traced(load: Callable[[str], Any], text: str, keys: list[str], **arguments: Any) -> Parts:
    """Derivatives of the detected power, W, by some numbers of a scene."""
    return power_parts(load(text), keys, edge_width=0.04, **arguments)


def detector(z: float, half: float = 30.0) -> str:
    """A large black detector."""
    return shape_xml("asphere", "detector", z, sensor=True, half_width=half, half_height=half)


SINE, COSINE = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
HALF_PASSES = interface_xml(R=0.0, T=0.5)
# Shapes, and derivatives of the detected power in a beam of radius 5 mm and 1 W/mm²
STOPS: dict[str, tuple[list[str], dict[str, float]]] = {
    "hole": ([shape_xml("frustum", "stop", 5.0, r0=3.0, z0=0.0, r1=8.0, z1=0.0), detector(10.0)],
             {"stop.r0": 6 * np.pi, "stop.x": 0.0, "stop.z": 0.0}),
    # 4 mm off the axis: the circles cross 3 mm off their line
    "decentred": ([placed_xml("frustum", "stop", at=(4.0, 0.0, 5.0), r0=3.0, z0=0.0, r1=12.0, z1=0.0), detector(10.0)],
                  {"stop.x": -6.0}),
    "tilted": (
        [placed_xml("frustum", "stop", at=(0.0, 0.0, 8.0), facing=(0.0, -SINE, COSINE), r0=3.0, z0=0.0, r1=8.0, z1=0.0),
         detector(20.0)], {"stop.tilt_x": -np.pi * 9.0 * SINE * np.pi / 180, "stop.r0": 6 * np.pi * COSINE}),
    # Light that misses the filter is detected whole
    "passes half": (
        [shape_xml("asphere", "plate", 5.0, HALF_PASSES, semi_diameter=3.0, inner_semi_diameter=1.0), detector(10.0)],
        {"plate.semi_diameter": -3 * np.pi, "plate.inner_semi_diameter": np.pi}),
    "rectangle": ([shape_xml("asphere", "detector", 5.0, sensor=True, half_width=3.0, half_height=1.0, curvature=0.02)],
                  {"detector.half_width": 4.0, "detector.half_height": 12.0}),
    # A cone that ends in a hole: where it begins and how long it is does not matter
    "funnel": ([shape_xml("frustum", "funnel", 5.0, r0=6.0, z0=0.0, r1=2.0, z1=7.0), detector(20.0)],
               {"funnel.r1": 4 * np.pi, "funnel.r0": 0.0, "funnel.z1": 0.0}),
}  # fmt: skip


class TestClosedForms:
    @pytest.mark.parametrize("name", STOPS)
    def test_stop_in_a_beam(self, load_scene, name: str) -> None:
        shapes, expected = STOPS[name]
        found = traced(load_scene, scene_text(*shapes, radius=5.0), list(expected), rays=1_000_000)
        for key, derivative in expected.items():
            value, se = sums(found[key])
            if derivative:
                check(key, found[key], derivative)
            else:
                assert_z(key, value, 0.0, se, floor=1e-9)

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
        found, frozen = traced(load_scene, text, keys, rays=1_000_000), read_frozen(text)
        height = brentq(lambda h: _radius_at_stop(frozen, h) - 2.0, 0.0, 3.9)
        slope = (_radius_at_stop(frozen, height + 1e-4) - _radius_at_stop(frozen, height - 1e-4)) / 2e-4
        for key in keys:
            change = 1.0
            if key != "stop.r0":
                moved = [_radius_at_stop(frozen.moved(key, sign * STEP), height) for sign in (1, -1)]
                change = -(moved[0] - moved[1]) / (2 * STEP)
            check(key, found[key], 2 * np.pi * height * change / slope)


def _radius_at_stop(frozen: FrozenScene, height: float) -> float:
    """Distance from the axis at the stop of a ray that starts parallel to it at a height, mm."""
    events = (("front", "SpecTran"), ("rear", "SpecTran"), ("stop", "Absorbed"))
    start, one = np.array([[height, 0.0, 0.0]]), np.ones(1)
    near = np.array([[[height, 0.0, z]] for z in (5.0, 9.0, 15.0)])
    ray = Bundle(events, start, np.array([[0.0, 0.0, 1.0]]), near, np.zeros((3, 1, 3)), one, one, np.zeros(1, int))
    return float(np.hypot(*follow(frozen, ray).points[-1][0, :2]))


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

    @pytest.mark.long
    def test_a_rectangle_off_the_axis(self, load_scene) -> None:
        """The last bits of its coordinates are 0 and do not choose the side that a hit near a corner counts for."""
        square: dict[str, Any] = {"at": (-20.0, 0.0, 5.0), "half_width": 3.0, "half_height": 3.0}
        other = placed_xml("asphere", "other", at=(20.0, 0.0, 5.0), semi_diameter=1.0)
        text = scene_text(placed_xml("asphere", "detector", pixels=8, **square), other, radius=25.0)
        found = power_parts(load_scene(text), ["detector.half_width", "detector.half_height"], 0.5, rays=150_000)
        for key, parts in found.items():  # by those bits 6 and 18; false alarm 5e-5
            value, se = sums(parts)
            assert_z(key, value, 12.0, se, k=5.0)

    def test_part_of_a_side_and_a_touching_circle(self, load_scene) -> None:
        """A half mirror stands on a part of a black square's side; both move, and only the square's width counts."""
        large = shape_xml("asphere", "large", 5.0, half_width=4.0, half_height=4.0)
        size: dict[str, Any] = {"half_width": 2.0, "half_height": 2.0}
        small = placed_xml("asphere", "small", HALF_PASSES, at=(0.5, -4.0, 7.0), facing=(0.0, -1.0, 0.0), **size)
        text = scene_text(large, small, detector(12.0), radius=9.0)
        found = traced(load_scene, text, ["large.half_height", "small.z"], field_deg=20.0, rays=1_000_000)
        check("sides", sum(found.values()), -np.cos(self.FIELD) * 16.0)
        assert abs(sums(found["small.z"])[0][0]) > 5 * sums(found["small.z"])[1][0]
        disc = placed_xml("frustum", "disc", at=(5.0, 0.0, 5.0), r0=1.0, z0=0.0, r1=5.0, z1=0.0)
        tube = shape_xml("frustum", "tube", 0.0, r0=10.0, z0=0.0, r1=10.0, z1=20.0)
        found = traced(load_scene, scene_text(disc, tube, detector(25.0), radius=11.0), ["disc.r1"])
        check("outer", found["disc.r1"], -10 * np.pi)


def test_the_rim_of_a_hemisphere(load_scene) -> None:
    """It stands upright there, so that no distance across grows along it: 4 standard errors, false alarm 4e-4."""
    dome = shape_xml("asphere", "dome", 5.0, HALF_PASSES, curvature=0.2, semi_diameter=5.0)
    scene = load_scene(scene_text(dome, detector(30.0), radius=9.0))
    found = mistray.gradient(path_power(scene, "all", rays=30_000), mi.traverse(scene), keys=["dome.semi_diameter"])
    value, error = (float(v["dome.semi_diameter"][0]) for v in (found.gradient, found.standard_error))
    assert error < 0.01
    assert abs(value + 0.5 * 2 * 5 / 81) < 4 * error


@pytest.mark.long
class TestPortions:
    def test_of_any_size_they_find_the_same(self, load_scene, monkeypatch) -> None:
        """Random numbers go with the hit, whatever the order."""
        walls = [
            shape_xml("frustum", "stop", 5.0, wall_xml(0.5), r0=3.0, z0=0.0, r1=8.0, z1=0.0),
            shape_xml("frustum", "tube", 5.0, wall_xml(0.5), r0=8.0, z0=0.0, r1=8.0, z1=20.0),
            shape_xml("asphere", "detector", 25.0, sensor=True, semi_diameter=6.0),
        ]
        scene, keys = load_scene(scene_text(*walls, radius=5.0)), ["stop.r0", "stop.x"]
        found = []
        for capacity, lanes in ((edges.CAPACITY, edges.FIRST_LANES), (edges.CAPACITY, edges.FIRST_LANES), (200, 3000)):
            monkeypatch.setattr(edges, "CAPACITY", capacity)
            monkeypatch.setattr(edges, "FIRST_LANES", lanes)
            metric = pst_bin(scene, 20.0, rays=20_000, max_scatters=3, method="adjoint", cell_deg=20.0)
            light = power_parts(scene, keys, 0.1, rays=30_000, max_scatters=2)
            found.append(parts_of(metric, keys, 0.1) | {"light": light["stop.r0"]})
        for key, part in found[0].items():
            assert abs(part).max() > 0
            for other in found[1:]:
                np.testing.assert_allclose(other[key], part, rtol=1e-6, atol=1e-9 * abs(part).max())

    def test_a_ray_with_more_hits_than_can_be_kept(self, load_scene, monkeypatch) -> None:
        plates = [shape_xml("asphere", f"plate_{z}", float(z), HALF_PASSES, semi_diameter=1.0) for z in (3, 4)]
        text = scene_text(*plates, shape_xml("asphere", "detector", 5.0, sensor=True, semi_diameter=1.0), radius=1.1)
        monkeypatch.setattr(edges, "CAPACITY", 2)
        with pytest.raises(MistrayError, match="a single start ray hits 3 times close to a rim, more than 2"):
            power_parts(load_scene(text), ["plate_3.semi_diameter"], 0.5, rays=32)


TUBE, HOLE, VANE, LENGTH, HALF, ALBEDO = 15.0, 6.0, 20.0, 40.0, 5.0, 0.6


def leaving(
    scene: Any, keys: list[str], scatters: int, light: str, seed: int = 0
) -> tuple[Parts, np.ndarray, np.ndarray]:
    """Of the light that goes out from the detector, the share that gets to the sky: derivatives, value and error."""
    traced = {"rays": 1_000_000, "max_scatters": scatters, "method": "adjoint", "cell_deg": 90.0, "seed": seed}
    metric = pst_bin(scene, 45.0, light, **traced)
    value, se = metric.observe()[0].pst.curve(light)
    return {key: 2 * part for key, part in parts_of(metric, keys, 0.2).items()}, 2 * value, 2 * se


class TestAgainstTheLight:
    """2π sr of sky lie before a detector; π times its share is the integral of the PST over them."""

    def test_direct_edge_sampling(self, load_scene) -> None:
        """Black vane in a Lambertian tube with a black end, one scatter event, against the integral along its rim."""
        text = scene_text(
            shape_xml("frustum", "tube", 0.0, wall_xml(ALBEDO), r0=TUBE, z0=0.0, r1=TUBE, z1=LENGTH),
            shape_xml("frustum", "vane", VANE, r0=HOLE, z0=0.0, r1=TUBE, z1=0.0),
            shape_xml("frustum", "detector", LENGTH, sensor=True, r0=0.0, z0=0.0, r1=HALF, z1=0.0),
            shape_xml("frustum", "end", LENGTH, r0=HALF, z0=0.0, r1=TUBE, z1=0.0),
        )
        found, *_ = leaving(load_scene(text), ["vane.r0", "vane.z"], 1, "single_scatter", seed=1)
        radius, move = integral_along_the_rim(2_000_000)
        check("radius of the hole", found["vane.r0"], *radius)
        value, se = sums(found["vane.z"])
        assert_z("move along the axis", value, move[0], np.hypot(se, move[1]))
        with pytest.raises(AssertionError):
            assert_z("move along the axis", -value, move[0], np.hypot(se, move[1]))

    def test_corner_on_the_detector(self, load_scene) -> None:
        """Within a black tube that stands on it: the view factor of two equal discs (J. R. Howell, C-40)."""
        radius, length, detector_radius = 6.0, 10.0, 9.0
        text = scene_text(
            shape_xml("frustum", "tube", 20.0, r0=radius, z0=0.0, r1=radius, z1=length),
            shape_xml("frustum", "lid", 20.0, r0=radius, z0=0.0, r1=12.0, z1=0.0),
            shape_xml("frustum", "box", 20.0, r0=12.0, z0=0.0, r1=12.0, z1=length),
            shape_xml("frustum", "detector", 30.0, sensor=True, r0=0.0, z0=0.0, r1=detector_radius, z1=0.0),
        )

        def share(r: float) -> float:
            x = 1 + (1 + (r / length) ** 2) / (r / length) ** 2
            return 0.5 * (x - np.sqrt(x * x - 4)) * (r / detector_radius) ** 2

        found, leaves, se = leaving(load_scene(text), ["tube.r0", "tube.r1", "lid.r0"], 0, "total")
        assert_z("share that leaves", leaves, share(radius), se)
        assert abs(sums(found["tube.r1"])[0][0]) > 10 * sums(found["tube.r1"])[1][0]
        check("radius", sum(found.values()), (share(radius + STEP) - share(radius - STEP)) / (2 * STEP))


def integral_along_the_rim(samples: int) -> list[tuple[float, float]]:
    """Derivatives of what leaves after one scatter event by the radius of the hole and its place, in float64 NumPy.

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


BEAM = 5.0  # mm


@pytest.mark.quick
def test_rod_across_a_beam(load_scene) -> None:
    """A black rod of radius 2 mm, 2.5 mm off the middle of the beam, takes a strip out of it."""
    rod = placed_xml("frustum", "rod", at=(2.5, -10.0, 10.0), facing=(0.0, 1.0, 0.0), r0=2.0, r1=2.0, z0=0.0, z1=20.0)
    scene = load_scene(scene_text(rod, detector(20.0, 40.0), radius=BEAM))
    found = power_parts(scene, ["rod.r0", "rod.r1", "rod.x", "rod.y"], rays=2_000_000)
    inner, outer = (2 * np.sqrt(BEAM**2 - x**2) for x in (0.5, 4.5))
    check("radius", found["rod.r0"] + found["rod.r1"], -(inner + outer))
    check("displacement", found["rod.y"], inner - outer)  # the y of the rod is the x of the world


@pytest.mark.long
def test_grazing_light_on_a_strip(load_scene) -> None:
    """Rays at 8° come out again beyond its sides, within its diagonal: no silhouette. It was 0.48; false alarm 5e-5."""
    size: dict[str, Any] = {"half_width": 1.0, "half_height": 4.0, "curvature": 0.05}
    angle = np.radians(8.0)
    strip = placed_xml("asphere", "strip", at=(0.0, 0.0, 20.0), facing=(0.0, -np.cos(angle), np.sin(angle)), **size)
    scene = load_scene(scene_text(strip, detector(60.0), radius=5.0))
    value, se = sums(power_parts(scene, ["strip.tilt_y"], 0.05, rays=1_000_000)["strip.tilt_y"])
    assert_z("tilt", value, 16.0 * np.cos(angle) * np.pi / 180, se, k=5.0)


@pytest.mark.quick
@pytest.mark.parametrize("coefficient", [0.0, 2e-3])
def test_profile_of_a_shell(load_scene, coefficient: float) -> None:
    """A thin black shell seen from its side hides what lies inside of its profile."""
    c, k, rim = 0.25, -0.4, 2.5
    more = {"a4": coefficient} if coefficient else {}
    shell = placed_xml(
        "asphere", "shell", at=(0.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), curvature=c, conic=k, semi_diameter=rim, **more
    )
    scene = load_scene(scene_text(shell, detector(20.0, 40.0), radius=BEAM))

    def area(c: float, k: float, a: float) -> float:
        r, weights = np.polynomial.legendre.leggauss(60)
        r, weights = 0.5 * rim * (r + 1), 0.5 * rim * weights
        root = np.sqrt(1 - (1 + k) * c**2 * r**2)
        return float(np.sum(weights * 2 * r * (c * r / root + 4 * a * r**3)))

    h = 1e-6
    slope = (area(c + h, k, coefficient) - area(c - h, k, coefficient)) / (2 * h)
    check("curvature", power_parts(scene, ["shell.curvature"], rays=1_000_000, seed=3)["shell.curvature"], -slope)


@pytest.mark.quick
def test_outline_of_a_filter(load_scene) -> None:
    """A bowl with an ideal coating, oblique to the beam: rays inside of its outline pass it twice, each time with T."""
    tilt = np.radians(75.0)
    bowl = placed_xml(
        "asphere", "bowl", interface_xml(R=0.1, T=0.7), at=(0.0, 0.0, 10.0), facing=(np.sin(tilt), 0.0, np.cos(tilt)),
        curvature=0.3, semi_diameter=3.0,
    )  # fmt: skip
    scene = load_scene(scene_text(bowl, detector(20.0, 40.0), radius=BEAM))
    found = power_parts(scene, ["bowl.curvature"], rays=1_000_000, max_reflections=0)
    slope, se = difference(scene, "bowl.curvature", 0.3, 0.01)
    check("curvature", found["bowl.curvature"], slope, se)


def difference(scene: Any, key: str, value: float, step: float) -> tuple[float, float]:
    """Central difference of the detected power, W, from traces with rays of their own, and its standard error."""
    powers = []
    for number, sign in enumerate((1, -1)):
        with changed(mi.traverse(scene), {key: np.array([value + sign * step])}):
            energy = mistray.trace(scene, rays=1_000_000, max_scatters=0, max_reflections=0, seed=7 + number).energy
            powers.append((energy.detected_W, energy.detected_se_W))
    return (powers[0][0] - powers[1][0]) / (2 * step), np.hypot(powers[0][1], powers[1][1]) / (2 * step)


@pytest.mark.quick
def test_onset_of_total_reflection(load_scene) -> None:
    """A converging beam in glass meets a tilted face about the critical angle, up to which its coating passes 0.9."""
    glass = interface_xml("air", "1.5", R=0.0, T=1.0)
    face = interface_xml("1.5", "air", R=0.1, T=0.9)
    tilt = np.radians(41.0)
    front = shape_xml("asphere", "front", 0.0, glass, curvature=0.05, semi_diameter=8.0)
    rear = placed_xml(
        "asphere", "rear", face, at=(0.0, 0.0, 14.0), facing=(0.0, -np.sin(tilt), np.cos(tilt)), semi_diameter=14.0
    )
    scene = load_scene(scene_text(front, rear, detector(40.0, 40.0), radius=BEAM))
    found = power_parts(scene, ["rear.tilt_x"], max_reflections=0)
    check("tilt", found["rear.tilt_x"], *difference(scene, "rear.tilt_x", 0.0, 0.4))

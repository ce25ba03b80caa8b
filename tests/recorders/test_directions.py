"""Cells of directions against float64; probes and far fields of light that passes or leaves, by closed forms."""

import itertools
import json
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import plates_text, scene_text, shape_xml
from refusals import each_refused
from scene_dicts import at, detector, load

import mistray
from mistray.physics.geometry.healpix import pixel, sides
from mistray.recorders import Departure, FarField, Probe
from mistray.recorders.design_sequences import DesignKeys, DesignSequences
from mistray.recorders.direction_recorder import DirectionRecorder
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.sources import scene_sources

pytestmark = pytest.mark.quick


def random_rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def test_cells_and_their_solid_angles() -> None:
    for angles, given, edges in (
        ([0.0, 20.0, 90.0], None, [[0, 1], [19, 21], [89, 90]]),  # 2°, clipped at the ends
        ([10.0, 10.5, 12.0], None, [[9.75, 10.25], [10.25, 10.75], [11.75, 12.25]]),  # the least distance
        ([10.0, 20.0], 4.0, [[8, 12], [18, 22]]),
        (np.arange(0.1, 0.35, 0.1), 0.1, [[0.05, 0.15], [0.15, 0.25], [0.25, 0.35]]),  # touch but for rounding
        (30.0, None, [[29, 31]]),
    ):
        grid = DirectionGrid.of(angles, cell_deg=given)
        np.testing.assert_allclose(grid.edges_deg, edges, rtol=1e-12)
        assert (grid.shape, grid.azimuth_cell_deg, grid.azimuths_deg.tolist()) == ((len(edges), 1), 360.0, [0.0])
    for azimuths, given, span in (
        ([0.0], None, 10.0),
        ([0.0, 90.0, 180.0], None, 90.0),
        ([10.0, 355.0], None, 15.0),  # across 0
        ([-5.0, 2.0], None, 7.0),
        ([0.0, 90.0], 3.0, 3.0),
        ([40.0], 360.0, 360.0),
    ):
        grid = DirectionGrid.of([5.0], azimuths, azimuth_cell_deg=given)
        assert (grid.azimuth_cell_deg, grid.shape) == (pytest.approx(span, rel=1e-12), (1, len(azimuths)))
    # Opposite angles and azimuths that differ by rounding are the same
    turned = DirectionGrid.of(np.linspace(-1, 1, 21), np.arange(50) * 7.2)
    assert turned.shape == (11, 50)
    assert (turned.azimuth_cell_deg, np.ptp(turned.edges_deg[1])) == pytest.approx((7.2, 0.1))
    each_refused(
        ({"field_deg": np.array([[1.0, 2.0], [3.0, 4.0]])}, "field_deg is .*; it must lie"),
        ({"azimuths_deg": [-179.9, 180.1]}, "holds an azimuth twice"),
        ({"field_deg": [2.0, 2.0]}, "field_deg must ascend"),
        ({"azimuths_deg": [0.0, 30.0], "azimuth_cell_deg": 31.0}, "is 31; .* two azimuths, 30 degrees"),
        by=lambda arguments: DirectionGrid.of(**{"field_deg": [1.0]} | arguments),
    )
    # By the midpoint rule in θ with 20 000 nodes; those of the hemisphere add up
    grid = DirectionGrid.of([0.0, 0.3, 17.0, 60.0, 89.9], [0.0, 40.0], cell_deg=0.3, azimuth_cell_deg=25.0)
    low, high = np.radians(grid.edges_deg).T
    theta = low + (high - low) * (np.arange(20_000)[:, None] + 0.5) / 20_000
    solid = np.radians(25.0) * (high - low) * np.mean(np.sin(theta), axis=0)
    np.testing.assert_allclose(grid.solid_angle, solid, rtol=1e-7)
    whole = np.radians(25.0) * (high - low) * np.mean(np.cos(theta) * np.sin(theta), axis=0)
    np.testing.assert_allclose(grid.mean_cosine, whole / solid, rtol=1e-7)
    whole = DirectionGrid.of(np.arange(0, 91, 2))
    assert whole.solid_angle.sum() == pytest.approx(2 * np.pi, rel=1e-14)
    parts = DirectionGrid.of(np.arange(0, 91, 2), np.arange(0, 360, 30))
    assert 12 * parts.solid_angle.sum() == pytest.approx(2 * np.pi, rel=1e-14)
    assert np.sum(whole.solid_angle * whole.mean_cosine) == pytest.approx(np.pi, rel=1e-14)
    grid = DirectionGrid.of([0.0, 10.0, 20.0], [0.0, 120.0, -100.0], cell_deg=4.0, azimuth_cell_deg=20.0)
    for direction, cell in (
        ((0.0,), (0, 0)),
        ((2.0, 10.0), (0, 0)),  # on the edges
        ((8.0, -10.0), (1, 0)),
        ((21.9, 125.0), (2, 1)),
        ((19.0, 255.0), (2, 2)),  # -105
        ((10.0, -590.0), (1, 1)),  # 130
        ((-19.0, -60.0), (2, 1)),  # 19° at 120°
        ((-19.0, 300.0), (2, 1)),
    ):
        assert grid.nearest(*direction) == cell
    each_refused(
        ((2.1,), "angle 2.1° .*that of 0°.*0 … 2°"),
        ((22.5, 120.0), "angle 22.5° .*that of 20°.*18 … 22°"),
        ((10.0, 60.1), "azimuth 60.1° .*120°"),
        ((10.0, 10.1), "azimuth 10.1° .*0°"),
        by=lambda direction: grid.nearest(*direction),
    )


def device_cells(grid: DirectionGrid, d: np.ndarray) -> np.ndarray:
    """Cells of rays along d by the kernel; -1: none."""
    sky = DirectionRecorder(grid, DesignKeys(DesignSequences(), 0))
    cell, inside = sky.cell(mi.Vector3f(*np.ascontiguousarray(d.T, dtype=np.float32)))
    return np.where(np.array(inside), np.array(cell).astype(np.int64), -1)


def host_cells(grid: DirectionGrid, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same in float64, by angles in degrees, and how far (degrees) each direction is from an edge of a cell."""
    x, y, z = (-d.astype(np.float64) @ grid.rotation).T
    sine = np.hypot(x, y)
    theta, phi = np.degrees(np.arctan2(sine, z)), np.degrees(np.arctan2(-x, y))
    cells, least = np.full(len(d), -1), np.abs(theta - 90)
    for i, (low, high) in enumerate(grid.edges_deg):
        for edge in (low, high):
            if 0 < edge < 90:
                least = np.minimum(least, np.abs(theta - edge))
        for j, azimuth in enumerate(grid.azimuths_deg):
            apart = np.abs((phi - azimuth + 180) % 360 - 180)
            inside = (theta >= low) & (theta <= high)
            if grid.azimuth_cell_deg < 360:
                inside &= apart <= grid.azimuth_cell_deg / 2
                least = np.minimum(least, np.abs(apart - grid.azimuth_cell_deg / 2) * np.maximum(sine, 1e-9))
            cells[inside] = i * len(grid.azimuths_deg) + j
    return cells, least


@pytest.mark.parametrize("rotation", [None, random_rotation(1), random_rotation(2)])
@pytest.mark.parametrize(
    ("angles", "cell_deg", "azimuths", "azimuth_cell_deg"),
    [
        (np.arange(0, 91, 2), None, None, None),  # all of the hemisphere
        ([0.0, 5.0, 33.0, 70.0], 3.0, None, None),  # gaps
        ([45.0], 90.0, [0.0, 90.0, 180.0, 270.0], None),  # all of it in quarters
        ([0.0, 20.0, 80.0], 10.0, [-170.0, -20.0, 33.0, 175.0], 12.0),
        ([60.0], 20.0, [100.0], 40.0),
    ],
)
def test_cells_of_random_directions(angles, cell_deg, azimuths, azimuth_cell_deg, rotation) -> None:
    """1e5 directions; only those within 0.002° of an edge, under 2 %, may fall to either side."""
    grid = DirectionGrid.of(angles, azimuths, cell_deg, azimuth_cell_deg, rotation)
    d = np.random.default_rng(7).normal(size=(100_000, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    found = device_cells(grid, d)
    expected, least = host_cells(grid, d)
    clear = least > 2e-3
    assert np.mean(clear) > 0.98
    np.testing.assert_array_equal(found[clear], expected[clear])
    assert set(found) - {-1} == set(range(int(np.prod(grid.shape))))
    share = np.mean(found >= 0)
    solid = grid.solid_angle.sum() * grid.shape[1] / (4 * np.pi)
    assert abs(share - solid) < 4 * np.sqrt(solid / len(d))  # false alarm 6e-5


def test_edges_at_0_and_90_degrees_belong_to_their_cells(load_scene) -> None:
    """Light along the axis, light that grazes, and light that comes from just behind."""
    grid = DirectionGrid.of([0.0, 30.0, 90.0])
    light = np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0], [0.6, 0.8, 0], [1, 0, -1e-6], [0, 0, -1]], dtype=np.float64)
    np.testing.assert_array_equal(device_cells(grid, -light), [0, 2, 2, 2, -1, -1])
    np.testing.assert_array_equal(device_cells(DirectionGrid.of([10.0, 80.0]), -light), [-1] * len(light))
    # The beam of a turned source at field angle 20°, azimuth 130° goes into that cell, in the source's frame
    beam = beam_xml(1.0, along=(1.0, 2.0, 3.0), field_deg=20.0, azimuth_deg=130.0)
    scene = load_scene(scatter_scene(beam, placed_xml("asphere", "detector", at=(0, 0, 9), pixels=4, semi_diameter=1)))
    (one,) = scene_sources(scene)
    rotation = np.asarray(one.emitter.matrix[:3, :3], dtype=np.float64)
    grid = DirectionGrid.of([0.0, 20.0, 40.0], np.arange(0, 360, 10), rotation=rotation, cell_deg=1.0)
    (cell,) = device_cells(grid, -one.direction[None])
    assert divmod(int(cell), 36) == grid.nearest(20.0, 130.0) == (1, 13)
    grid = DirectionGrid.of([20.0], cell_deg=20.0)
    sky = DirectionRecorder(grid, DesignKeys(DesignSequences(), 0))
    theta = np.radians([15.0, 25.0, 50.0])
    d = mi.Vector3f(*(-np.stack([np.sin(theta), 0 * theta, np.cos(theta)])).astype(np.float32))
    zero, yes = dr.zeros(mi.UInt32, 3), dr.full(mi.Bool, True, 3)
    start: Any = type("Start", (), {"batch": mi.UInt32([0, 5, 6]), "pixel": None})()
    key, weight = dr.zeros(mi.UInt64, 3), mi.Float([1.0, 2.0, 4.0])
    scatters = mi.UInt32([0, 1, 1])
    end = Departure(start, d, weight, zero, scatters, key, zero, lambda k, _: k, yes, (), (*d, *d, weight))
    sky.depart(end, {})
    found = sky.read()
    assert found["cells"].sum() == 3.0
    assert found["elsewhere"][6] == found["elsewhere"].sum() == 4.0
    assert found["cells"][:, 0, 0, [0, 5]].max(axis=0).tolist() == [1.0, 2.0]
    assert found["largest"].tolist() == [[2.0]]  # of the scattered ones


def test_negative_field_angles_are_at_the_opposite_azimuth() -> None:
    """As those of a beam: (0, sin -θ, cos θ) is θ at 180°. Every direction asked for lies in the middle of a cell."""
    for field_deg, azimuths_deg, angles, azimuths, width in (
        ([-20.0], None, [20.0], [0.0], 360.0),
        ([-20.0, 0.0, 20.0], None, [0.0, 20.0], [0.0], 360.0),
        ([-20.0], [0.0], [20.0], [180.0], 10.0),
        ([-20.0, 0.0], [30.0, 60.0], [0.0, 20.0], [30.0, 60.0, -150.0, -120.0], 30.0),
        ([-20.0, 0.0, 10.0, 20.0], [90.0], [0.0, 10.0, 20.0], [90.0, -90.0], 10.0),
        ([-5.0, 5.0], [0.0, 180.0], [5.0], [0.0, 180.0], 180.0),
        ([-5.0, 5.0], [0.0, 170.0], [5.0], [0.0, 170.0, 180.0, -10.0], 10.0),
    ):
        grid = DirectionGrid.of(field_deg, azimuths_deg)
        assert (grid.field_deg.tolist(), grid.azimuths_deg.tolist()) == (angles, azimuths)
        assert grid.azimuth_cell_deg == width
        for angle, azimuth in itertools.product(field_deg, azimuths_deg or [0.0]):
            i, j = grid.nearest(angle, azimuth)
            assert grid.field_deg[i] == abs(angle)
            if azimuths_deg and angle:
                assert (grid.azimuths_deg[j] - azimuth - (180 if angle < 0 else 0)) % 360 == 0
    # Facts come back through JSON, bit by bit
    grid = DirectionGrid.of([0.1, 7.7], [1 / 3, 100.0], 0.7, 3.3, random_rotation(5))
    again = DirectionGrid.from_facts(json.loads(json.dumps(grid.facts())))
    for key in ("field_deg", "edges_deg", "azimuths_deg", "rotation"):
        np.testing.assert_array_equal(getattr(again, key), getattr(grid, key))
    assert (again.azimuth_cell_deg, again.facts()) == (grid.azimuth_cell_deg, grid.facts())


def screen_text(f: float, radius: float) -> str:
    lambertian = scattering_xml([bsdf_xml("abg", A=2 * f, B=1.0, g=0.0)], R=1.0, T=0.0)
    screen = shape_xml("asphere", "screen", 0.0, lambertian, semi_diameter=4.0)
    detector = shape_xml("asphere", "detector", 5.0, sensor=True, semi_diameter=0.1)
    return scene_text(screen, detector, radius=radius, distance=2.0)


class TestProbe:
    def test_a_beam(self, load_text) -> None:
        """1 W/mm² within the beam, and 0 beyond; what is beyond the rectangle is not there."""
        probe = Probe("ahead", (0.0, 0.0, -1.0), half_width=0.5, half_height=0.25, pixels=(4, 2))
        wide = Probe("wide", (0.3, 0.0, -0.5), half_width=2.0, half_height=2.0, pixels=(1, 1))
        back = Probe("back", (0.0, 0.0, -1.0), normal=(0.0, 0.0, -1.0), half_width=2.0, half_height=2.0)
        text = plates_text(1).replace('name="radius"', 'name="distance" value="3"/><float name="radius"', 1)
        t = mistray.trace(load_text(text)[0], rays=40_000, recorders=[probe, wide, back], max_reflections=1)
        irradiance, se = probe.irradiance
        assert irradiance.shape == (2, 4) == se.shape
        assert np.all(np.abs(irradiance - 1) < 5 * se)  # 8 pixels: 1 in 200,000
        assert probe.power[0] == pytest.approx(0.5, abs=5 * probe.power[1])
        assert wide.power == pytest.approx((np.pi, 0.0), rel=1e-6, abs=1e-9)
        r = 0.04
        assert back.power[0] == pytest.approx(np.pi * (r + r * (1 - r) ** 2), rel=1e-5)  # of both faces
        assert set(t.recorders) == {"ahead", "wide", "back"}
        assert abs(t.energy.closure) < 1e-6
        # A beam of 1 W/mm² brings cos 60° on a rectangle that is tilted so far
        probe = Probe("tilted", (0, 0, -2), normal=(0, math.sqrt(3), 1), half_width=0.3, half_height=0.4, pixels=(1, 1))
        text = plates_text(1).replace('name="radius"', 'name="distance" value="6"/><float name="radius"', 1)
        mistray.trace(load_text(text)[0], rays=50_000, recorders=[probe], max_reflections=0)
        (value,), (se,) = (column.ravel() for column in probe.irradiance)
        assert abs(value - 0.5) < 4 * se  # 1 in 16,000

    def test_on_a_surface(self) -> None:
        """Oblique light that passes a sheet and meets the detector counts once at each, in spite of rounding."""
        clear = {"type": "interface", "R": 0.0, "T": 1.0, "front": "air", "back": "air"}
        sheet = {"type": "asphere", "to_world": at(33.3), "semi_diameter": 60.0, "bsdf": clear}
        point = {"type": "point_source", "z": -20.0, "half_angle_deg": 30.0, "power": 1.0}
        probes = [Probe(str(z), (0, 0, z), half_width=60, half_height=60, pixels=(1, 1)) for z in (33.3, 45.1)]
        scene = load(source=point, sheet=sheet, detector=detector(45.1, semi_diameter=60.0))
        t = mistray.trace(scene, rays=1000, recorders=probes)
        assert [probe.power[0] for probe in probes] == pytest.approx([t.energy.detected_W] * 2, rel=1e-6)

    @pytest.mark.parametrize("depth", [0.0, 1.7, 5.0])
    def test_in_absorbing_glass(self, load_text, depth: float) -> None:
        """Beer and Lambert up to the rectangle: exp(-4πk d/λ)."""
        probe = Probe("within", (0.0, 0.0, min(max(depth, 1e-4), 5 - 1e-4)), half_width=2.0, half_height=2.0)
        mistray.trace(load_text(plates_text(1, index="1.5 k=1e-5", R=0.0, T=1.0))[0], rays=1000, recorders=[probe])
        assert probe.power[0] == pytest.approx(np.pi * math.exp(-4 * np.pi * 1e-5 * depth / 550e-6), rel=1e-4)

    def test_radiance_of_a_screen(self, load_text) -> None:
        """A Lambertian screen under 1 W/mm² has the radiance f in every direction: 11 cells of 5 SE, 1 in 150,000."""
        f = 0.1
        probe = Probe("near", (0, 0, -0.05), normal=(0, 0, -1), half_width=0.2, half_height=0.2, pixels=(1, 1),
                      directions=6)  # fmt: skip
        scene, _ = load_text(screen_text(f, 3.9))
        t = mistray.trace(scene, rays=1_000_000, max_scatters=1, scatter_rays=1, aimed_rays=0, recorders=[probe])
        value, se = probe.radiance
        assert value.shape == (1, 1, 6, 6)
        inside = np.zeros((6, 6), dtype=bool)
        inside[2:4, 1:5] = inside[1:5, 2:4] = True  # whole cells within the unit circle
        mirrored = np.unravel_index(np.argmax(value[0, 0]), inside.shape)
        assert 2 <= min(mirrored) <= max(mirrored) <= 3  # straight back, at the corner of the four cells in the middle
        inside[mirrored] = False
        assert np.all(np.abs(value[0, 0] - f)[inside] < 5 * se[0, 0][inside])
        assert np.all(se[0, 0][inside] < 0.15 * f)
        assert value.sum() * (2 / 6) ** 2 == pytest.approx(probe.irradiance[0].sum(), rel=1e-9)
        assert abs(t.energy.closure) < 1e-5

    def test_bad_numbers(self, load_text) -> None:
        each_refused(
            ({"name": " "}, "not blank"),
            ({"half_width": 0.0}, "half_width"),
            ({"half_height": math.nan}, "half_height"),
            ({"normal": (0, 0, 0)}, "normal is 0, 0, 0"),
            ({"normal": (0, 1)}, "normal has 2 numbers"),
            ({"up": (0, 0, 2)}, "up is along"),
            ({"centre": (0, math.inf, 0)}, "centre"),
            ({"pixels": (0, 4)}, "pixels is 0"),
            ({"pixels": (65536, 65536)}, "number of its cells"),
            ({"directions": 0}, "number of directions"),
            by=lambda change: Probe(**{"name": "p", "centre": (0, 0, 0)} | change),
        )
        each_refused(
            ({"edges_deg": (0, 10, 10)}, "do not ascend"),
            ({"edges_deg": (0, 181)}, "edges_deg"),
            ({"azimuths": 0}, "azimuths"),
            by=lambda numbers: FarField("f", **numbers),
        )
        scene, _ = load_text(plates_text(1))
        twice = [Probe("focus", (0, 0, 1)), FarField("focus")]
        with pytest.raises(mistray.MistrayError, match="2 recorders have the name 'focus'"):
            mistray.trace(scene, rays=100, recorders=twice)
        with pytest.raises(mistray.MistrayError, match="'focus' has recorded nothing yet"):
            _ = twice[0].irradiance


def test_far_field_of_a_lambertian(load_text) -> None:
    """Intensity f Φ cos θ of a small screen: in a ring f Φ π (sin² θ2 - sin² θ1). 36 of 5 SE, 1 in 48,000."""
    f = 0.05
    far = FarField("sky", edges_deg=range(90, 181, 10), azimuths=4)
    scene, _ = load_text(screen_text(f, 0.5))
    t = mistray.trace(scene, rays=100_000, max_scatters=1, scatter_rays=1, aimed_rays=0, recorders=[far])
    value, se = far.intensity
    sine = np.sin(np.radians(far.edges_deg)) ** 2
    expected = f * np.pi * 0.5**2 * (sine[:-1] - sine[1:]) * np.pi / (4 * far.solid_angle_sr)
    assert value.shape == (9, 4)
    expected = np.repeat(expected[:, None], 4, axis=1)
    straight_back = np.unravel_index(np.argmax(value), value.shape)
    assert straight_back[0] == 8
    expected[straight_back] += np.pi * 0.5**2 * (1 - np.pi * f) / far.solid_angle_sr[-1]
    assert np.all(np.abs(value - expected) < 5 * se)
    assert np.all(se < 0.2 * expected)
    assert far.power[0] == pytest.approx(t.energy.escaped_W, rel=1e-9)
    # A beam at 10° and azimuth 90° (towards -x) that meets nothing behind a plate leaves in one cell
    scene, _ = load_text(plates_text(1, R=0.0, T=1.0).replace('half_width" value="50.0', 'half_width" value="0.01'))
    far = FarField("beam", edges_deg=(0, 9, 11, 180), azimuths=8)
    mistray.trace(scene, rays=1000, field_deg=10.0, azimuth_deg=100.0, recorders=[far])
    flux = far.intensity[0] * far.solid_angle_sr[:, None]
    assert (np.argmax(flux), flux[1, 2]) == (8 + 2, pytest.approx(far.power[0], rel=1e-9))
    for axis, row in (((0, 0, -1), 2), ((0, 0, 1), 0)):
        edge = FarField("edge", edges_deg=(0, 5, 170, 180), axis=axis)
        mistray.trace(scene, rays=1000, recorders=[edge])
        assert np.argmax(edge.intensity[0] * edge.solid_angle_sr[:, None]) == row


def fine(count: int = 200_000) -> np.ndarray:
    """Directions that cover the sphere evenly: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def test_rings_go_south() -> None:
    """The mean of cos θ falls from ring to ring: 4, 8, …, 4 N pixels, then 4 N in each of the belt."""
    side = 8
    d = fine()
    number = pixel(side, d, False)
    z = np.bincount(number, d[:, 2]) / np.bincount(number)
    rings = np.split(z, np.cumsum([4 * min(k, side, 4 * side - k) for k in range(1, 4 * side)])[:-1])
    assert max(float(np.ptp(ring)) for ring in rings) < 0.01
    assert np.all(np.diff([ring.mean() for ring in rings]) < 0)


@pytest.mark.parametrize("side", [1, 2, 4, 8, 16])
def test_equal_areas_and_nested_parts(side: int) -> None:
    """Of an even cover each pixel has as many points but for those along its rim; both numbers are of one pixel."""
    d = fine()
    ring, nested = (pixel(side, d, which) for which in (False, True))
    each = len(d) / (12 * side * side)
    for numbers in (ring, nested):
        count = np.bincount(numbers)
        assert len(count) == 12 * side * side
        assert np.max(np.abs(count - each)) < 3 * np.sqrt(each)
    assert np.array_equal(pixel(2 * side, d, True) // 4, nested)
    assert len(np.unique(12 * side**2 * ring + nested)) == 12 * side * side


def test_the_twelve_faces() -> None:
    """Centres at cos θ = 2/3, 0, -2/3 and azimuths of 45°, 0°, 45° plus quarters of a turn."""
    turn = np.radians([45, 135, 225, 315, 0, 90, 180, 270, 45, 135, 225, 315])
    z = np.repeat([2 / 3, 0, -2 / 3], 4)
    d = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    for nested in (False, True):
        assert pixel(1, d, nested).tolist() == list(range(12))
    assert (sides(12), sides(48), sides(3072), sides(13), sides(0)) == (1, 2, 16, 0, 0)

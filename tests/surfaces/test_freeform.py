"""Freeforms against float64 and batoid, and surfaces that meet in a seam."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import vectors
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from refusals import refused
from scipy.optimize import brentq

import mistray
from mistray.mechanics.ply import ply_bytes
from mistray.physics.sags.terms import sag
from mistray.plugins.shapes.implicit import Implicit, sqrt
from mistray.prescription import Outline, OutlineFigure, read_grid
from mistray.ranges import RADIUS_MM, Range
from mistray.surfaces import mosaic_search, seams, shell_tree
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.mosaic_search import BITS, FEWEST, mosaics
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

GLASS = {"type": "interface", "back": "N-BK7"}
GRID = read_grid(Path(__file__).parents[1] / "data" / "figure_error.dat")
SAGS: dict[str, dict[str, Any]] = {
    "biconic": {"curvature": 1 / 60, "conic": 0.3, "curvature_x": -1 / 90, "conic_x": -1.2},
    "cylinder": {"curvature": 0.0, "curvature_x": 1 / 40},
    "toroid": {"curvature": 1 / 60, "toroid_curvature": 1 / 45, "a4": 1e-6},
    "zernike": {"curvature": 1 / 80, "zernike_6": 0.02, "zernike_7": -0.01, "zernike_22": 2e-3, "zernike_radius": 11.0},
    "fringe": {"curvature": 1 / 80, "fringe_5": 0.02, "fringe_16": 4e-3, "fringe_radius": 11.0},
    "xy": {"curvature": 1 / 80, "xy_2_1": 3e-5, "xy_0_3": -2e-5, "xy_4_2": 1e-8},
    "chebyshev": {"chebyshev_2_0": 0.05, "chebyshev_3_2": 0.01, "chebyshev_x": 12.0, "chebyshev_y": 13.0},
    "odd": {"curvature": 1 / 80, "r3": 2e-5, "r5": 1e-8, "a4": 1e-6},
    "qcon": {"curvature": 1 / 80, "conic": -0.5, "qcon_0": 0.05, "qcon_3": -0.01, "q_radius": 11.0},
    "qbfs": {"curvature": 1 / 80, "qbfs_0": 0.05, "qbfs_2": -0.01, "q_radius": 11.0},
    "q2d": {"curvature": 1 / 80, "conic": -0.5, "q2d_cos_1_1": 0.04, "q2d_sin_3_2": -0.01, "q_radius": 11.0},
    "tilted": {"slope_x": 0.1, "slope_y": -0.05},
    "grid": {"curvature": 1 / 80, "xy_2_1": 3e-5, "grid": GRID, "grid_scale": 2.5, "grid_x": 0.7, "grid_y": -0.4},
}


def scene(shape: dict[str, Any]) -> Any:
    """A shape before a detector."""
    glass = {"type": "interface", "front": "N-BK7", "back": "N-BK7", "R": 0.0}
    return scene_dicts.load(
        source={"type": "collimated", "radius": 8.0, "wavelength_nm": 550.0, "distance": 20.0},
        shape={"bsdf": GLASS, **{key: getattr(value, "path", value) for key, value in shape.items()}},
        detector=scene_dicts.detector(60, half_width=30.0, half_height=30.0, bsdf=glass),
    )


def hits(table: SurfaceTable, o: np.ndarray, d: np.ndarray, last: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Distances and surfaces of the nearest hits by the kernel."""
    start = np.full(len(o), 0xFFFFFFFF) if last is None else last
    along = mi.Vector3f(*(mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in d.T))
    met = Intersector(table).nearest(table.upload_points(o), along, mi.UInt32(start.astype(np.uint32)), mi.Bool(True))
    return np.array(met[0]), np.array(met[1])


def kernel_hits(scene: Any, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, list[str]]:
    table = SurfaceTable(scene, 550.0)
    t, s = hits(table, o, d)
    return t, [table.ids[i] if i < len(table.ids) else "" for i in s]


@pytest.mark.parametrize("name", SAGS)
def test_hits_are_those_of_the_formula(name: str) -> None:
    numbers, rng = SAGS[name], np.random.default_rng(1)
    o = np.column_stack([rng.uniform(-6, 6, (40, 2)), np.full(40, -20.0)])
    d = np.column_stack([rng.uniform(-0.15, 0.15, (40, 2)), np.ones(40)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    t, ids = kernel_hits(scene({"type": "freeform", "semi_diameter": 10.0, **numbers}), o, d)

    def height(s: float, k: int) -> float:
        x, y, z = o[k] + s * d[k]
        return float(z - sag(np.array(x), np.array(y), numbers))

    for k in range(40):
        exact = brentq(height, 12.0, 30.0, args=(k,), xtol=1e-12)
        x, y, _ = o[k] + exact * d[k]
        if math.hypot(x, y) < 9.99:
            assert ids[k] == "shape"
            assert t[k] == pytest.approx(exact, abs=2e-5)  # a few digits of float32 at 20 mm
        elif math.hypot(x, y) > 10.01:
            assert ids[k] != "shape"


def test_a_freeform_is_the_asphere_of_the_same_numbers() -> None:
    numbers = {"radius": 50.0, "conic": -0.5, "a4": 1e-6, "semi_diameter": 10.0}
    found = [mistray.trace(scene({"type": kind, **numbers}), rays=20_000, seed=3) for kind in ("asphere", "freeform")]
    a, b = (next(iter(t.paths)) for t in found)
    assert a.power_W == pytest.approx(b.power_W, rel=1e-6)
    assert a.rms_radius_mm == pytest.approx(b.rms_radius_mm, rel=1e-5)
    assert all(abs(t.energy.closure) < 1e-5 for t in found)


def test_an_off_axis_piece_keeps_its_digits() -> None:
    """A parabola images the axis' direction onto its focus, 10 m away, from a piece of 20 mm far beside its axis."""
    focal = 10_000.0
    piece = {"type": "freeform", "radius": -2 * focal, "conic": -1.0, "bsdf": MIRROR | {"R": 1.0}}
    piece |= {"clip_1": "+circle", "clip_1_y": 3000.0, "clip_1_radius": 10.0}
    place = mi.ScalarTransform4f().translate([0, 3000, -(3000.0**2) / (4 * focal)])
    beam = {"type": "collimated", "radius": 8.0, "wavelength_nm": 550.0, "distance": 50.0, "to_world": place}
    film = scene_dicts.detector(-focal, half_width=1.0, half_height=1.0)
    loaded = scene_dicts.load(source=beam, mirror=piece, detector=film)
    t = mistray.trace(loaded, rays=5000, seed=1)
    image = next(iter(t.paths))
    assert image.power_W == pytest.approx(t.energy.launched_W, rel=1e-6)
    assert image.rms_radius_mm < 3e-3  # single precision over 10 m


OUTLINE = Outline(
    (
        OutlineFigure("circle", "+", sizes=(10.0,)),
        OutlineFigure("circle", "-", 1.0, 0.5, sizes=(3.0,)),
        OutlineFigure("rectangle", "-", 0.0, 4.0, 30.0, (8.0, 0.5)),
        OutlineFigure("ellipse", "&", 0.0, 0.0, 20.0, (11.0, 8.0)),
        OutlineFigure("polygon", "+", sizes=(8.0, 8.0, 14.0, 8.0, 11.0, 12.0, 11.0, 9.5)),
    )
)


def test_the_kernel_keeps_to_an_outline_and_light_the_other_way_passes() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-14, 14, (2, 4000))
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    inside = (x * x + y * y <= 100) & ((x - 1) ** 2 + (y - 0.5) ** 2 > 9)
    inside &= ~((abs(x * c + (y - 4) * s) <= 8) & (abs((y - 4) * c - x * s) <= 0.5))
    c, s = math.cos(math.radians(20)), math.sin(math.radians(20))
    inside &= ((x * c + y * s) / 11) ** 2 + ((y * c - x * s) / 8) ** 2 <= 1
    for triangle in [((8, 8), (14, 8), (11, 9.5)), ((14, 8), (11, 12), (11, 9.5))]:
        sides = [(u - a) * (y - b) - (x - a) * (v - b) > 0 for (a, b), (u, v) in pairwise((*triangle, triangle[0]))]
        inside |= np.all(sides, axis=0)
    np.testing.assert_array_equal(OUTLINE.contains(x, y), inside)
    shape: dict[str, Any] = {"type": "freeform", "curvature": 1 / 100} | OUTLINE.numbers()
    shape |= {f"clip_{k}": figure.sign + figure.kind for k, figure in enumerate(OUTLINE.figures, start=1)}
    o = np.column_stack([x, y, np.full(len(x), -20.0)])
    _, ids = kernel_hits(scene(shape), o, np.tile([0.0, 0.0, 1.0], (len(x), 1)))
    assert np.mean((np.array(ids) == "shape") != inside) < 1e-3  # but for points within the rounding of a rim
    o = np.array([[0.0, 0.0, -5.0], [0.0, 0.0, 5.0]])
    d = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for meets, hits in (("both", ["shape", "shape"]), ("+z", ["shape", ""]), ("-z", ["detector", "shape"])):
        _, ids = kernel_hits(scene({"type": "freeform", "semi_diameter": 2.0, "meets": meets}), o, d)
        assert ids == hits


def test_a_first_figure_with_the_sign_of_an_intersection_is_an_area() -> None:
    o, d = np.array([[0.0, 0.0, -5.0], [8.0, 0.0, -5.0], [0.0, 9.0, -5.0]]), np.tile([0.0, 0.0, 1.0], (3, 1))
    plate = {"type": "freeform", "clip_1": "&rectangle", "clip_1_half_width": 10.0, "clip_1_half_height": 10.0}
    hole = {"type": "freeform", "clip_1": "&circle", "clip_1_radius": 8.5}
    assert kernel_hits(scene(plate | {"clip_2": "+circle", "clip_2_radius": 2.0}), o, d)[1] == 3 * ["shape"]
    assert kernel_hits(scene(hole), o, d)[1] == ["shape", "shape", "detector"]


def test_outlines_end_at_a_circle() -> None:
    """The parts of random outlines within a circle and of the circle outside them, also where figures reach beyond."""
    rng, radius = np.random.default_rng(3), 6.0
    x, y = rng.uniform(-15, 15, (2, 4000))
    near = x**2 + y**2 <= radius**2
    outside = 0
    for _ in range(300):
        kinds = rng.choice(["circle", "rectangle"], rng.integers(1, 5))
        figures = [
            OutlineFigure(kind, rng.choice(["+", "-", "&"]), *rng.uniform(-8, 8, 3), sizes=rng.uniform(1, 9, count))
            for kind, count in zip(kinds, 1 + (kinds == "rectangle"), strict=True)
        ]
        outline = Outline(tuple(figures))
        inside = outline.contains(x, y)
        np.testing.assert_array_equal(outline.within(radius).contains(x, y), inside & near)
        if (rest := outline.around(radius)) is not None:
            outside += 1
            np.testing.assert_array_equal(rest.contains(x, y), ~inside & near)
    assert outside > 50


def test_bad_input_names_the_shape() -> None:
    for numbers, named in vectors.toml("refusals.toml")["freeform"]:
        with refused("shape", named):
            scene({"type": "freeform", **numbers})


CURVED = {"type": "freeform", "radius": 50.0, "xy_12_12": 0.0, "semi_diameter": 10.0}
ASPHERE = {"type": "asphere", "radius": 20.0, "a4": 1e-4, "a6": -2e-7, "semi_diameter": 6.0}


@pytest.mark.parametrize(
    ("shape", "changes", "words"),
    [
        (CURVED, {"xy_12_12": 1e-18}, "single precision has its sag"),
        (CURVED, {"semi_diameter": 60.0}, "its sag ends"),
        ({"type": "asphere", "semi_diameter": 10.0}, {"x": 9e11, "semi_diameter": 9e11}, "it reaches"),
        (ASPHERE, {"semi_diameter": -1.0}, "semi_diameter is -1"),
        (ASPHERE, {"curvature": 0.5}, "the conic ends at"),
        (ASPHERE, {"a8": float("nan")}, "a8 is nan"),
        (ASPHERE, {"curvature": [0.01, 0.02]}, "curvature has 2 entries"),
        (ASPHERE, {"inner_semi_diameter": 7.0}, "inner_semi_diameter is 7 mm"),
    ],
)
def test_a_refused_update_leaves_the_surface(shape: dict[str, Any], changes: dict[str, Any], words: str) -> None:
    """Its numbers, its mesh and the surface that is traced; and the next good one is taken."""
    here = scene(shape)
    params = mi.traverse(here)
    names = [f"shape.{name}" for name in (*changes, "vertex_positions")]
    before = [np.array(params[name]) for name in names]
    light = mistray.trace(here, rays=500).irradiance
    for name, value in changes.items():
        params[f"shape.{name}"] = type(params[f"shape.{name}"])(value)
    with refused("shape 'shape'", words):
        params.update()
    for name, value in zip(names, before, strict=True):
        np.testing.assert_array_equal(np.array(mi.traverse(here)[name]), value)
    np.testing.assert_array_equal(mistray.trace(here, rays=500).irradiance, light)
    params["shape.tilt_x"] = type(params["shape.tilt_x"])(0.25)
    params.update()
    assert float(mi.traverse(here)["shape.tilt_x"][0]) == 0.25
    assert [np.array(params[name]).tolist() for name in names[:-1]] == [value.tolist() for value in before[:-1]]


SIZE = 9.0
MIRROR = {"type": "interface", "R": 0.9, "mirror": True}


def segments(**changes: dict[str, Any]) -> dict[str, Any]:
    """Seven hexagons of a paraboloid; changes by the number of one."""
    found = {}
    around = np.pi / 6 + np.pi / 3 * np.arange(6)
    for k, (x, y) in enumerate([(0.0, 0.0), *1.8 * SIZE * np.stack([np.cos(around), np.sin(around)], axis=1)]):
        shape = {"type": "freeform", "radius": -90.0, "conic": -1.0, "bsdf": MIRROR, "clip_1": "+polygon"}
        for i, angle in enumerate(np.pi / 3 * np.arange(6), start=1):
            shape |= {f"clip_1_x{i}": float(x + SIZE * np.cos(angle)), f"clip_1_y{i}": float(y + SIZE * np.sin(angle))}
        found[f"s{k}"] = shape | changes.get(f"s{k}", {})
    return found


def lenslets(count: int) -> dict[str, Any]:
    """Steep spheres of an array, with a polynomial that departs from them."""
    shape = {"type": "freeform", "radius": 6.0, "half_width": 2.0, "half_height": 2.0, "bsdf": GLASS | {"back": "1.5"}}
    places = [[4.1 * (k % 6) - 10, 4.1 * (k // 6) - 10, 0.3 * k] for k in range(count)]
    placed = enumerate(map(mi.ScalarTransform4f().translate, places))
    return {f"l{k}": shape | {"xy_3_1": 1e-4 * (1 + k), "to_world": place} for k, place in placed}


CASES: dict[str, dict[str, Any]] = {
    "segments": segments(),
    "moved segments": segments(
        s1={"tilt_x": 2.0, "z": 0.4}, s2={"tilt_y": -1.5}, s3={"radius": -80.0}, s4={"x": 0.3, "tilt_z": 20.0}
    ),
    "lenslets": lenslets(36),
    "plates": {
        f"p{k}": {
            "type": "freeform", "half_width": 1.0, "half_height": 8.0, "bsdf": {"type": "interface", "R": 0.0},
            "to_world": mi.ScalarTransform4f().translate([5.0 * k - 12, 0, k]).rotate([1, 0, 0], 25 * k),
        }
        for k in range(6)
    },
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.long) if k in ("lenslets", "moved segments") else k for k in CASES]
)
def test_the_same_hits_as_one_by_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    light = {"type": "collimated", "radius": 20.0, "wavelength_nm": 550.0, "distance": 60.0}
    board = scene_dicts.detector(-45, type="freeform", half_width=40.0, half_height=40.0, meets="-z")
    table = SurfaceTable(scene_dicts.load(source=light, detector=board, **CASES[name]), 550.0)
    rng = np.random.default_rng(5)
    count = 20_000
    o = np.column_stack([rng.uniform(-25, 25, (count, 2)), np.where(rng.random(count) < 0.5, -40.0, 30.0)])
    d = np.column_stack([rng.normal(0, 0.4, (count, 2)), np.where(o[:, 2] < 0, 1.0, -1.0)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    groups = mosaics(table.pieces, range(len(table.pieces)))
    assert groups
    assert all(FEWEST <= len(group) <= BITS or len(groups) > 1 for group in groups)
    t, s = hits(table, o, d)
    lit = np.isfinite(t)
    # And from there in any direction, where the surface itself is in the way
    again = rng.normal(size=(count, 3))
    again /= np.linalg.norm(again, axis=1, keepdims=True)
    place = np.where(lit[:, None], o + t[:, None] * d, o)
    onward = hits(table, place, again, s)
    monkeypatch.setattr(mosaic_search, "FEWEST", 10_000)
    assert not mosaics(table.pieces, range(len(table.pieces)))
    single_t, single_s = hits(table, o, d)
    # Rays that pass an edge by a rounding may fall on either side
    same = s == single_s
    assert same.mean() > 0.9995
    assert len(set(s[lit].tolist())) > len(CASES[name]) / 2
    assert t[lit & same] == pytest.approx(single_t[lit & same], abs=3e-5)
    single_onward = hits(table, place, again, s)
    same = onward[1] == single_onward[1]
    assert same.mean() > 0.999
    far = same & np.isfinite(onward[0])
    assert onward[0][far] == pytest.approx(single_onward[0][far], abs=2e-4)


RAYS = 200_000  # to each seam
PLACE = 131.3  # of the vessels along z, mm: it costs digits
FRONT, REAR, HOLE = 9.7, 14.9, 6.1  # radii, mm
RADIUS, A4 = 31.3, 2.3e-6  # of the front
LENGTH = 83.7  # mm
CONIC = RADIUS - np.sqrt(RADIUS**2 - FRONT**2)
FRONTS = {  # with their sags at the seam
    "disc": ({"type": "asphere"}, 0.0),
    "conic": ({"type": "asphere", "radius": RADIUS}, CONIC),
    "asphere": ({"type": "asphere", "radius": RADIUS, "a4": A4}, CONIC + A4 * FRONT**4),
    "freeform": ({"type": "freeform", "radius": RADIUS, "a4": A4}, CONIC + A4 * FRONT**4),
}


class Drum(Implicit):
    """A tube by its formula."""

    numbers = ("radius",)
    ranges = {"radius": RADIUS_MM, "low": Range(-1e6, 1e6), "high": Range(-1e6, 1e6)}

    @staticmethod
    def residual(x: Any, y: Any, z: Any, n: Any) -> Any:
        return sqrt(x * x + y * y) - n["radius"]

    @staticmethod
    def gradient(x: Any, y: Any, z: Any, n: Any) -> tuple[Any, Any, Any]:
        r = sqrt(x * x + y * y)
        return x / r, y / r, 0 * z

    @staticmethod
    def coordinate(x: Any, y: Any, z: Any, n: Any) -> Any:
        return z

    @staticmethod
    def generatrix(u: Any, n: Any) -> tuple[Any, Any]:
        return n["radius"] + 0 * u, u

    @staticmethod
    def ends(values: Any) -> tuple[float, float]:
        return values["low"], values["high"]


mi.register_shape("test_drum", Drum)


def vessel(front: str, wall: str) -> tuple[SurfaceTable, list[tuple[float, float]]]:
    """A front, a wall around it, a ring and the detector in its hole, and the radii and places of their seams, mm."""
    black, (figure, sag_of_seam) = scene_dicts.BLACK, FRONTS[front]
    rear = REAR if wall == "cone" else FRONT
    ends = {"z0": PLACE + sag_of_seam, "z1": PLACE + LENGTH}
    side: dict[str, Any] = {"type": "frustum", "r0": FRONT, "r1": rear, **ends}
    if wall == "drum":
        side = {"type": "test_drum", "radius": FRONT, "low": ends["z0"], "high": ends["z1"]}
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 5.0},
        front={**figure, "semi_diameter": FRONT, "to_world": scene_dicts.at(PLACE), "bsdf": black},
        side={**side, "bsdf": black},
        ring={"type": "frustum", "r0": rear, "z0": ends["z1"], "r1": HOLE, "z1": ends["z1"], "bsdf": black},
        detector=scene_dicts.detector(PLACE + LENGTH, semi_diameter=HOLE),
    )
    return SurfaceTable(scene, 550.0), [(FRONT, ends["z0"]), (rear, ends["z1"]), (HOLE, ends["z1"])]


def passed(table: SurfaceTable, seams: list[tuple[float, float]]) -> int:
    """Rays from points within a vessel, to points of its seams, that meet nothing there."""
    rng, found = np.random.default_rng(3), 0
    intersector = Intersector(table)
    for radius, z in seams:
        angle = rng.uniform(0, 2 * np.pi, RAYS)
        start = rng.uniform((-4, -4, PLACE + 5), (4, 4, PLACE + LENGTH - 1), (RAYS, 3))
        way = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(RAYS, z)]) - start
        far = np.linalg.norm(way, axis=1)
        along = mi.Vector3f(*(mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in (way / far[:, None]).T))
        none = dr.full(mi.UInt32, NO_SURFACE, RAYS)
        t, _ = intersector.nearest(table.upload_points(start), along, none, mi.Bool(True))
        found += int(np.count_nonzero(np.array(t) > 1.01 * far))
    return found


VESSELS = [("disc", "tube"), ("conic", "cone"), ("asphere", "tube"), ("freeform", "tube"), ("conic", "drum")]


@pytest.mark.parametrize(("front", "wall"), VESSELS)
def test_no_ray_leaves_a_closed_vessel(front: str, wall: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert passed(*vessel(front, wall)) == 0
    if (front, wall) in VESSELS[:3]:  # nor one of many surfaces
        with monkeypatch.context() as patch:
            patch.setattr(shell_tree, "MOST_UNROLLED", 0)
            patch.setattr(shell_tree, "MOST_ASPHERES", 0)
            assert passed(*vessel(front, wall)) == 0
    monkeypatch.setattr(seams, "ROUNDINGS", 0)
    assert passed(*vessel(front, wall)) > 100  # the rays do try the seams


def test_light_at_a_seam_does_not_come_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """A beam some roundings wide at a corner: the wall is met before the board inside, by less than a rounding."""
    radius, end = 14.0, PLACE + 41.704
    paint = {"type": "interface", "R": 0.0, "model": {"type": "paint", "reflectance": 0.9}}
    place = mi.ScalarTransform4f().translate([0, -radius, end])

    def light() -> float:
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 3e-5, "to_world": place},
            lid={"type": "frustum", "r0": radius, "z0": PLACE, "r1": 0.1, "z1": PLACE, "bsdf": paint},
            wall={"type": "frustum", "r0": radius, "z0": PLACE, "r1": radius, "z1": end, "bsdf": paint},
            board={"type": "frustum", "r0": radius, "z0": end, "r1": HOLE, "z1": end, "bsdf": paint},
            detector=scene_dicts.detector(end, semi_diameter=HOLE),
        )
        found = mistray.trace(scene, rays=100_000, field_deg=50.0, seed=1, max_scatters=3)
        assert found.energy.absorbed["wall"][0] > 0.1 * found.energy.launched_W
        return float(found.energy.detected_W)

    assert light() == 0
    monkeypatch.setattr(seams, "RIM_ROUNDINGS", 0)
    assert light() > 0


def housing_text(folder: Path, shift: float = 0.0) -> str:
    """A lens-like pair of surfaces and a detector in a cone of triangles with a bracket; all displaced by `shift`."""
    phi = 2 * np.pi * np.arange(24) / 24
    rings = [(9.0 + 0.1 * z, z) for z in np.linspace(-20.0, 40.0, 7)]
    points = np.concatenate([np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(24, z)]) for r, z in rings])
    a = (24 * np.arange(6)[:, None] + np.arange(24)).ravel()
    b = (24 * np.arange(6)[:, None] + np.roll(np.arange(24), -1)).ravel()
    faces = np.concatenate([np.stack([a, b, b + 24], axis=1), np.stack([a, b + 24, a + 24], axis=1)])
    bracket = np.array([[2.0, -1.0, 25.0], [9.0, 0.5, 24.0], [9.0, -2.0, 26.0]])
    faces = np.concatenate([faces, [[len(points), len(points) + 1, len(points) + 2]]])
    points = np.concatenate([points, bracket]) + np.array([shift, 0, 0])
    (folder / "housing.ply").write_bytes(ply_bytes(points, faces))
    mesh = f'<shape type="ply" id="housing"><string name="filename" value="housing.ply"/>{interface_xml(R=0.2)}</shape>'
    shapes = (
        shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5"), semi_diameter=6.0, curvature=0.02),
        shape_xml("asphere", "rear", 3.0, interface_xml("1.5", "air"), semi_diameter=6.0, curvature=-0.02),
        shape_xml("asphere", "detector", 30.0, sensor=True, half_width=3.0, half_height=3.0),
    )
    moved = (shape.replace("<translate z=", f'<translate x="{shift}" z=') for shape in shapes)
    text = scene_text(mesh, *moved, radius=5.0)
    place = f'<float name="distance" value="10"/><transform name="to_world"><translate x="{shift}"/></transform>'
    return text.replace('<float name="radius"', f'{place}<float name="radius"', 1) if shift else text


@pytest.mark.parametrize("shift", [0.0, 500.0])
def test_no_segment_meets_a_shape(tmp_path, shift: float) -> None:
    """300,000 random segments: those that are said to be clear are so by Mitsuba's own intersection."""
    (tmp_path / "scene.xml").write_text(housing_text(tmp_path, shift))
    table = SurfaceTable(mistray.load(tmp_path / "scene.xml"), 550.0)
    assert table.free_space is not None
    rng = np.random.default_rng(2)
    o, end = rng.uniform((-15, -15, -30), (15, 15, 50), (2, 300_000, 3)) + np.array([shift, 0, 0])
    length = np.linalg.norm(end - o, axis=1)
    origin, d, t = table.upload_points(o), mi.Vector3f(((end - o) / length[:, None]).T), mi.Float(length)
    clear = np.array(table.free_space.holds(origin, d, t))
    ray = mi.Ray3f(mi.Point3f(origin + table.mitsuba_offset), d)
    ray.maxt = t
    met = np.array(table.mitsuba_scene.ray_test(ray))
    assert 0.05 < clear.mean() < 0.95
    assert not np.any(clear & met)
    # Most of what meets nothing near the axis is known to be clear
    near = np.maximum(*(np.hypot(p[:, 0] - shift, p[:, 1]) for p in (o, end))) < 5
    before = near & (o[:, 2] < 20) & (end[:, 2] < 20)
    assert clear[before].mean() > 0.99
    assert not np.any(np.array(table.free_space.holds(origin, d, dr.full(mi.Float, dr.inf, len(o)))))


def test_a_shape_on_the_axis(load_text) -> None:
    """Where a stock shape stands across the axis there is nothing to leave out but what lies beside it along z."""
    disc = '<shape type="disk" id="disc"><transform name="to_world"><scale value="2"/><translate z="5"/></transform>'
    text = scene_text(disc + interface_xml(R=0.0) + "</shape>",
                      shape_xml("asphere", "detector", 9.0, sensor=True, half_width=3.0, half_height=3.0))  # fmt: skip
    scene, _ = load_text(text)
    assert SurfaceTable(scene, 550.0).free_space is None
    assert mistray.trace(scene, rays=100).energy.absorbed["disc"][0] == pytest.approx(np.pi)


def test_host_rays_meet_a_cap_just_within_its_rim():
    """Chords to r = 9.9 … 9.999 mm of a cap of 10 mm, which leave the box around its outline right behind it."""
    table = SurfaceTable(scene({"type": "freeform", "radius": 50.0, "clip_1": "+circle", "clip_1_radius": 10.0}), 550.0)
    x, angle = np.meshgrid(np.linspace(9.9, 9.999, 34), np.linspace(0.0, 2 * np.pi, 24, endpoint=False))
    r, angle, start = x.ravel(), angle.ravel(), -3.0
    height = sag(np.array([start, 0.0]), np.zeros(2), {"curvature": 1 / 50})[0]
    to = sag(r, 0.0 * r, {"curvature": 1 / 50})
    along = np.column_stack([r - start, 0.0 * r, to - height])
    length = np.linalg.norm(along, axis=1)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0 * c], [s, c, 0 * c], [0 * c, 0 * c, 0 * c + 1]]).transpose(2, 0, 1)
    o = np.einsum("nij,j->ni", turn, [start, 0.0, height])
    d = np.einsum("nij,nj->ni", turn, along / length[:, None])
    k = table.ids.index("shape")
    hit, p, _ = first_hit(table, o, d, np.full(len(o), k))
    assert np.all(hit == k)
    np.testing.assert_allclose(np.linalg.norm(p - o, axis=1), length, rtol=1e-9)


def test_areas_of_narrow_freeforms():
    """Patches of a slit across their grid, a ring, an ellipse and a cap: 70, 12, 0.1 and 0.3 % too large by points."""
    slit = {"clip_1": "+rectangle", "clip_1_half_width": 10.0, "clip_1_half_height": 0.02, "clip_1_angle_deg": 30.0}
    ring = {"clip_1": "+circle", "clip_1_radius": 10.0, "clip_2": "-circle", "clip_2_radius": 9.9}
    oval = {"clip_1": "+ellipse", "clip_1_half_width": 8.0, "clip_1_half_height": 3.0, "clip_1_angle_deg": 20.0}
    cap = {"radius": 11.0, "clip_1": "+circle", "clip_1_radius": 10.0}
    whole = 2 * np.pi * 11 * (11 - math.sqrt(21))
    areas = (slit, 0.8, 1e-4), (ring, np.pi * 1.99, 6e-3), (oval, 24 * np.pi, 1e-4), (cap, whole, 1e-4)
    for shape, area, rel in areas:
        table = SurfaceTable(scene({"type": "freeform"} | shape), 550.0)
        parts = table.pieces[table.ids.index("shape")].areas(8, 8)
        assert parts.sum() == pytest.approx(area, rel=rel)
        np.testing.assert_allclose(parts, parts[::-1, ::-1], rtol=1e-9, atol=1e-12)

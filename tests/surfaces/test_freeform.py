"""Freeforms: their sags and outlines against float64 formulas, what they refuse, and many at once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from refusals import refused
from scipy.optimize import brentq

import mistray
from mistray.physics.geometry.outline import Outline, OutlineFigure
from mistray.physics.sags.terms import sag
from mistray.prescription import read_grid
from mistray.surfaces import mosaic_search
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.mosaic_search import BITS, FEWEST, mosaics
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


def test_the_kernel_keeps_to_an_outline() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-14, 14, (2, 4000))
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    inside = (x * x + y * y <= 100) & ((x - 1) ** 2 + (y - 0.5) ** 2 > 9)
    inside &= ~((abs(x * c + (y - 4) * s) <= 8) & (abs((y - 4) * c - x * s) <= 0.5))
    c, s = math.cos(math.radians(20)), math.sin(math.radians(20))
    inside &= ((x * c + y * s) / 11) ** 2 + ((y * c - x * s) / 8) ** 2 <= 1
    for triangle in [((8, 8), (14, 8), (11, 9.5)), ((14, 8), (11, 12), (11, 9.5))]:
        sides = [
            (q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1]) > 0
            for p, q in zip(triangle, (*triangle[1:], triangle[0]), strict=True)
        ]
        inside |= np.all(sides, axis=0)
    np.testing.assert_array_equal(OUTLINE.contains(x, y), inside)
    shape: dict[str, Any] = {"type": "freeform", "curvature": 1 / 100} | OUTLINE.numbers()
    shape |= {f"clip_{k}": figure.sign + figure.kind for k, figure in enumerate(OUTLINE.figures, start=1)}
    o = np.column_stack([x, y, np.full(len(x), -20.0)])
    _, ids = kernel_hits(scene(shape), o, np.tile([0.0, 0.0, 1.0], (len(x), 1)))
    assert np.mean((np.array(ids) == "shape") != inside) < 1e-3  # but for points within the rounding of a rim


def test_light_the_other_way_goes_through() -> None:
    o = np.array([[0.0, 0.0, -5.0], [0.0, 0.0, 5.0]])
    d = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for meets, hits in (("both", ["shape", "shape"]), ("+z", ["shape", ""]), ("-z", ["detector", "shape"])):
        _, ids = kernel_hits(scene({"type": "freeform", "semi_diameter": 2.0, "meets": meets}), o, d)
        assert ids == hits


CROSSING = {"x1": 0.0, "y1": 0.0, "x2": 4.0, "y2": 4.0, "x3": 4.0, "y3": 0.0, "x4": 0.0, "y4": 4.0}


def test_bad_input_names_the_shape() -> None:
    for numbers, named in (
        ({"clip_1": "+polygon", "clip_1_x1": 0.0, "clip_1_y1": 0.0}, "polygon"),
        ({"clip_1": "+hexagon"}, "hexagon"),
        ({"clip_1": "-circle", "clip_1_radius": 3.0}, "bounds"),
        ({"clip_1": "+circle", "clip_1_radius": -1.0}, "circle"),
        ({"semi_diameter": 10.0, "zernike_4": 0.1}, "zernike_radius"),
        ({"semi_diameter": 10.0, "curvature": 0.2}, "sag"),
        ({"semi_diameter": 10.0, "clip_1": "+circle", "clip_1_radius": 3.0}, "semi_diameter"),
        ({"semi_diameter": 10.0, "meets": "left"}, "left"),
        ({"clip_1": "+polygon"} | {f"clip_1_{k}": v for k, v in CROSSING.items()}, "crosses itself"),
        ({"semi_diameter": 20.0, "curvature": 1 / 21, "toroid_curvature": -1 / 21}, "single precision"),
    ):
        with refused("shape", named):
            scene({"type": "freeform", **numbers})


SIZE = 9.0
MIRROR = {"type": "interface", "R": 0.9, "mirror": True}


def hexagon(x: float, y: float) -> dict[str, Any]:
    found: dict[str, Any] = {"clip_1": "+polygon"}
    for k, angle in enumerate(np.pi / 3 * np.arange(6), start=1):
        found |= {f"clip_1_x{k}": x + SIZE * np.cos(angle), f"clip_1_y{k}": y + SIZE * np.sin(angle)}
    return found


def segments(**changes: dict[str, Any]) -> dict[str, Any]:
    """Seven hexagons of a paraboloid; changes by the number of one."""
    found = {}
    around = np.pi / 6 + np.pi / 3 * np.arange(6)
    for k, (x, y) in enumerate([(0.0, 0.0), *1.8 * SIZE * np.stack([np.cos(around), np.sin(around)], axis=1)]):
        shape = {"type": "freeform", "radius": -90.0, "conic": -1.0, "bsdf": MIRROR, **hexagon(float(x), float(y))}
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


def board(shapes: dict[str, Any]) -> Any:
    return scene_dicts.load(
        source={"type": "collimated", "radius": 20.0, "wavelength_nm": 550.0, "distance": 60.0},
        detector=scene_dicts.detector(-45, type="freeform", half_width=40.0, half_height=40.0, meets="-z"),
        **shapes,
    )


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.long) if k in ("lenslets", "moved segments") else k for k in CASES]
)
def test_the_same_hits_as_one_by_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    table = SurfaceTable(board(CASES[name]), 550.0)
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

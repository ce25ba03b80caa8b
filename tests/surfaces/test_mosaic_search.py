"""Freeforms of one sort that are looked for together: the same hits as one by one."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

from mistray.surfaces import mosaic_search
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.mosaic_search import BITS, FEWEST, mosaics
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

SIZE = 9.0
MIRROR = {"type": "interface", "R": 0.9, "mirror": True}


def hexagon(x: float, y: float, radius: float = SIZE) -> dict[str, Any]:
    found: dict[str, Any] = {"clip_1": "+polygon"}
    for k in range(6):
        angle = np.pi / 3 * k
        found |= {f"clip_1_x{k + 1}": x + radius * np.cos(angle), f"clip_1_y{k + 1}": y + radius * np.sin(angle)}
    return found


def segments(**changes: dict[str, Any]) -> dict[str, Any]:
    """Seven hexagons of a paraboloid; changes by the number of one."""
    found = {}
    places = [(0.0, 0.0)] + [
        (1.8 * SIZE * np.cos(a), 1.8 * SIZE * np.sin(a)) for a in np.pi / 6 + np.pi / 3 * np.arange(6)
    ]
    for k, (x, y) in enumerate(places):
        own = changes.get(f"s{k}", {})
        shape = {"type": "freeform", "radius": -90.0, "conic": -1.0, "bsdf": MIRROR, **hexagon(x, y)}
        found[f"s{k}"] = shape | own
    return found


def lenslets(count: int) -> dict[str, Any]:
    """Steep spheres of an array, with a polynomial that departs from them."""
    return {
        f"l{k}": {
            "type": "freeform", "radius": 6.0, "xy_3_1": 1e-4 * (1 + k), "half_width": 2.0, "half_height": 2.0,
            "to_world": mi.ScalarTransform4f().translate([4.1 * (k % 6) - 10, 4.1 * (k // 6) - 10, 0.3 * k]),
            "bsdf": {"type": "interface", "back": "1.5"},
        }
        for k in range(count)
    }  # fmt: skip


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


def scene(shapes: dict[str, Any]) -> Any:
    return scene_dicts.load(
        source={"type": "collimated", "radius": 20.0, "wavelength_nm": 550.0, "distance": 60.0},
        detector=scene_dicts.detector(-45, type="freeform", half_width=40.0, half_height=40.0, meets="-z"),
        **shapes,
    )


def hits(table: SurfaceTable, o: np.ndarray, d: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    along = mi.Vector3f(*(mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in d.T))
    start = mi.UInt32(last.astype(np.uint32))
    t, s = Intersector(table).nearest(table.upload_points(o), along, start, dr.full(mi.Bool, True, len(o)))
    return np.array(t), np.array(s)


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.long) if k in ("lenslets", "moved segments") else k for k in CASES]
)
def test_the_same_hits_as_one_by_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    table = SurfaceTable(scene(CASES[name]), 550.0)
    rng = np.random.default_rng(5)
    count = 20_000
    o = np.column_stack([rng.uniform(-25, 25, (count, 2)), np.where(rng.random(count) < 0.5, -40.0, 30.0)])
    d = np.column_stack([rng.normal(0, 0.4, (count, 2)), np.where(o[:, 2] < 0, 1.0, -1.0)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    none = np.full(count, 0xFFFFFFFF)
    groups = mosaics(table.pieces, range(len(table.pieces)))
    assert groups
    assert all(FEWEST <= len(group) <= BITS or len(groups) > 1 for group in groups)
    t, s = hits(table, o, d, none)
    lit = np.isfinite(t)
    # And from there in any direction, where the surface itself is in the way
    again = rng.normal(size=(count, 3))
    again /= np.linalg.norm(again, axis=1, keepdims=True)
    place = np.where(lit[:, None], o + t[:, None] * d, o)
    onward = hits(table, place, again, s)
    monkeypatch.setattr(mosaic_search, "FEWEST", 10_000)
    assert not mosaics(table.pieces, range(len(table.pieces)))
    single_t, single_s = hits(table, o, d, none)
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

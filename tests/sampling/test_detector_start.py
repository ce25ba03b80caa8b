"""Start rays of a backward trace: uniform places, and a Lambertian detector."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import placed_xml, scatter_scene
from oracles.statistics import assert_z

from mistray.kernel.targets import AimSet, Target
from mistray.recorders.start_rays import StartRays
from mistray.sampling.detector_start import FROM_BACK, DetectorStart, stratified_places
from mistray.sampling.space_filling import curve_points
from mistray.settings import BATCHES
from mistray.surfaces.surfaces import SurfaceTable

LANES = 1 << 16
AXIS = np.array([0.0, 0.0, 1.0])  # of the light
AT = np.array([1.0, -2.0, 30.0])


@pytest.mark.parametrize("dimensions", [2, 4])
def test_uniform_places_give_uniform_points(dimensions: int) -> None:
    """Counts in 16 boxes, and the mean of the place within the smallest cells; false alarm 1e-3 in all."""
    count = 200_000
    place, rng = mi.Float64(np.random.default_rng(1).random(count)), mi.PCG32(size=count, initstate=3)
    found = np.array([np.array(v) for v in curve_points(place, dimensions, rng)], dtype=np.float64)
    assert found.min() >= 0
    assert found.max() <= 1
    side = {2: 4, 4: 2}[dimensions]
    boxes = np.ravel_multi_index(np.minimum(found * side, side - 1).astype(int), (side,) * dimensions)
    share = np.bincount(boxes, minlength=16) / count
    assert_z("boxes", share, 1 / 16, np.sqrt(1 / 16 * 15 / 16 / count), false_alarm=5e-4)
    within = (found * 2.0 ** (32 // dimensions)) % 1
    assert_z("within", within.mean(axis=1), 0.5, np.sqrt(1 / 12 / count) + 1 / 256, false_alarm=5e-4)


def test_places_are_stratified() -> None:
    strata = 100
    lanes = BATCHES * strata
    batch, place = stratified_places(dr.arange(mi.UInt32, lanes), lanes, mi.PCG32(size=lanes, initstate=1))
    np.testing.assert_array_equal(np.array(batch), np.repeat(np.arange(BATCHES), strata))
    scaled = np.array(place).reshape(BATCHES, strata) * strata
    np.testing.assert_array_equal(np.sort(np.floor(scaled), axis=1), np.tile(np.arange(strata), (BATCHES, 1)))
    within = scaled - np.floor(scaled)
    # False alarm 6e-5 each
    assert abs(within.mean() - 0.5) < 4 * np.sqrt(1 / 12 / lanes)
    assert abs((within**2).mean() - 1 / 3) < 4 * np.sqrt(4 / 45 / lanes)


SAG = 10 - np.sqrt(10**2 - 6**2)  # of a sphere of radius 10 at 6
MOMENTS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "x": lambda x, y, z: x,
    "x²": lambda x, y, z: x**2,
    "y²": lambda x, y, z: y**2,
    "xy": lambda x, y, z: x * y,
    "z": lambda x, y, z: z,
    "z²": lambda x, y, z: z**2,
    "r²": lambda x, y, z: x**2 + y**2,
    "r⁴": lambda x, y, z: (x**2 + y**2) ** 2,
    "quadrant": lambda x, y, z: (x > 0) & (y > 0),
    "half": lambda x, y, z: x > y,
}
# Kind and numbers of detectors, their areas and means over these
DETECTORS: dict[str, tuple[str, dict[str, Any], float, dict[str, float]]] = {
    "rectangle": ("asphere", {"half_width": 3.0, "half_height": 2.0}, 24.0, {"x": 0, "x²": 3, "y²": 4 / 3, "xy": 0}),
    "stock rectangle": ("rectangle", {"scale": (3.0, 2.0, 1.0)}, 24.0, {"x²": 3.0, "y²": 4 / 3}),
    "round": ("asphere", {"semi_diameter": 4.0}, 16 * np.pi, {"r²": 8.0, "r⁴": 256 / 3, "quadrant": 0.25}),
    "annular": (
        "asphere", {"semi_diameter": 4.0, "inner_semi_diameter": 2.0}, 12 * np.pi,
        {"r²": 10.0, "r⁴": (4.0**6 - 2.0**6) / 36, "half": 0.5},
    ),
    # Of a sphere all heights have the same area
    "curved": (
        "asphere", {"semi_diameter": 6.0, "radius": 10.0}, 20 * np.pi * SAG,
        {"z": SAG / 2, "z²": SAG**2 / 3, "half": 0.5},
    ),
}  # fmt: skip
NEAR, FAR = AT + np.array([2.0, 1.0, -9.0]), AT + np.array([-8.0, 0.0, -20.0])
AIM = AimSet(
    (
        Target("ellipse", NEAR, np.array([3.0, 0, 0]), np.array([0, 4.0, 1.0]), share=0.7),
        Target("parallelogram", FAR, np.array([5.0, 0, 0]), np.array([0, 5.0, 0]), share=0.3),
    ),
    1,
)


@pytest.fixture(scope="module")
def detector_table(load_scene):
    @cache
    def table(name: str) -> SurfaceTable:
        kind, numbers, *_ = DETECTORS[name]
        return SurfaceTable(load_scene(scatter_scene(placed_xml(kind, "detector", at=AT, pixels=4, **numbers))), 550.0)

    return table


def rays_of(start: DetectorStart, lanes: int = LANES, seed: int = 1) -> StartRays:
    index = dr.arange(mi.UInt32, lanes)
    rng = mi.PCG32(size=lanes, initstate=seed)
    batch, place = stratified_places(index, lanes, rng)
    return start.rays(index, batch, place, rng, mi.Float(1), (4, 4))


def host(v: Any) -> np.ndarray:
    return np.array(v, dtype=np.float64).T


def averages(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over the rays, and standard errors as of independent rays; those of stratified rays are smaller."""
    return values.mean(axis=1), values.std(axis=1) / np.sqrt(values.shape[1])


@pytest.mark.parametrize("both_sides", [False, True])
@pytest.mark.parametrize("how", ["plain", "aimed"])
@pytest.mark.parametrize("name", DETECTORS)
def test_detector_is_lambertian(detector_table, name: str, how: str, both_sides: bool) -> None:
    """Weights, cosines and places of each side; 4 standard errors, 6e-5 each, 1e-2 in all 200."""
    (_, numbers, area, means), table = DETECTORS[name], detector_table(name)
    start = DetectorStart(table, AXIS, AIM if how == "aimed" else None, both_sides)
    assert start.area == pytest.approx(area, rel=1e-6)
    found = rays_of(start)
    p, (d, w, normal) = table.download_points(found.o), (host(v) for v in (found.d, found.w, found.normal))
    own = p - AT
    off = np.linalg.norm(own - [0, 0, 10], axis=1) - 10 if "radius" in numbers else own[:, 2]
    np.testing.assert_allclose(off, 0, atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-5)
    assert np.all(np.isfinite(w))
    assert w.min() >= 0
    cosine = np.einsum("ij,ij->i", d, normal)
    side = -np.sign(cosine)  # the normals go along the light, the rays against it
    if how == "plain" and not both_sides and name == "rectangle":  # whatever the azimuth
        mean, error = averages(np.stack([d[:, 0] ** 2, d[:, 1] ** 2, d[:, 0] * d[:, 1], d[:, 0], d[:, 1]]))
        assert_z("moments", mean, [0.25, 0.25, 0, 0, 0], error, k=4.0, floor=1e-5)
    for sign in (1, -1):
        weight = np.where(side == sign, w, 0)
        if sign < 0 and not both_sides:
            assert np.all(weight == 0)
            continue
        wanted = [(np.ones(LANES), 1.0), (np.abs(cosine), 2 / 3), (cosine**2, 0.5)]
        wanted += [(MOMENTS[moment](*own.T).astype(np.float64), mean) for moment, mean in means.items()]
        mean, error = averages(np.stack([weight * values for values, _ in wanted]))
        assert_z(f"{name}, {how}, side {sign}", mean, [value for _, value in wanted], error, k=4.0, floor=1e-5)
    if how == "plain" and name != "curved":  # all rays of a side weigh the same
        shares = (1 - FROM_BACK, FROM_BACK) if both_sides else (1.0, 1.0)
        np.testing.assert_allclose(w, np.where(side > 0, 1 / shares[0], 1 / shares[1]), rtol=1e-6)


def test_aimed_rays_go_to_the_targets(detector_table) -> None:
    disc = AimSet((Target("ellipse", AT - [0, 0, 40.0], np.array([3.0, 0, 0]), np.array([0, 3.0, 0])),), 1)
    share = []
    for aim in (None, disc):
        found = rays_of(DetectorStart(detector_table("rectangle"), AXIS, aim, False))
        p, d = detector_table("rectangle").download_points(found.o), host(found.d)
        met = p + ((AT[2] - 40 - p[:, 2]) / d[:, 2])[:, None] * d
        share.append(np.mean(np.hypot(*(met - AT)[:, :2].T) < 3.0))
    assert share[0] < 0.02
    assert share[1] > 0.3


def test_pixels_are_those_of_the_places(detector_table) -> None:
    """Row 0 at the smallest y of the detector's frame, which a `lookat` turns about z."""
    table = detector_table("rectangle")
    found = rays_of(DetectorStart(table, AXIS, None, False), lanes=3200)
    own = (table.download_points(found.o) - AT) @ table.rotations[table.detector]
    column, row = np.floor((own[:, 0] / 3 + 1) * 2), np.floor((own[:, 1] / 2 + 1) * 2)
    expected = 4 * row + column
    assert np.mean(np.array(found.pixel) == expected) > 0.999  # on the edge rounding decides
    assert set(np.array(found.pixel)) == set(range(16))

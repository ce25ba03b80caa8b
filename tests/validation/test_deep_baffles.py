"""Deep transmittance of a two-stage baffle against a forward random walk in float64 with a population drawn anew."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.analysis.pst.transmittance import pst
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source
from mistray.prescription.baffles.two_stage import two_stage_baffle

ALBEDO = 0.02
LOW_DEG, HIGH_DEG = 45.0, 75.0
POPULATION = 400_000
BATCHES = 8


@pytest.fixture(scope="module")
def baffle():
    return two_stage_baffle("b", optic_radius=10, z_rear=0, field_deg=5, exclusion_deg=40, depth=8, clearance=0.2)


class Walk:
    """The baffle as arrays: cylinders (R, z0, z1) and rings (z, inner, outer) facing both ways."""

    def __init__(self, shapes, optic_radius, optic_z):
        cylinders = [(s.r0, s.z0, s.z1) for s in shapes if s.r0 == s.r1]
        rings = [(s.z0, min(s.r0, s.r1), max(s.r0, s.r1)) for s in shapes if s.z0 == s.z1]
        assert len(cylinders) + len(rings) == len(shapes)
        self.cylinders, self.rings = np.array(cylinders), np.array(rings)
        self.optic_radius, self.optic_z = optic_radius, optic_z

    def cast(self, o, d):
        """First hit: distance (inf: none), and the normal towards the side of the ray."""
        best = np.full(len(o), np.inf)
        wall = np.zeros(len(o))  # radius of the cylinder that is hit; 0: a ring
        (x, y, z), (dx, dy, dz) = np.ascontiguousarray(o.T), np.ascontiguousarray(d.T)
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y
        for radius, z0, z1 in self.cylinders:
            t = (-b + np.sqrt(np.maximum(b * b - a * (c - radius**2), 0))) / a  # from within
            height = z + t * dz
            hit = (t > 1e-7) & (height > z0) & (height < z1) & (t < best)
            best[hit], wall[hit] = t[hit], radius
        for at, inner, outer in self.rings:
            t = (at - z) / dz
            r2 = c + t * (2 * b + t * a)
            hit = (t > 1e-7) & (r2 > inner**2) & (r2 < outer**2) & (t < best)
            best[hit], wall[hit] = t[hit], 0.0
        t = (self.optic_z - z) / dz
        optic = (t > 1e-7) & (t < best) & (c + t * (2 * b + t * a) < self.optic_radius**2)
        best[optic] = np.inf  # absorbed; the optic is dealt with by `seen`
        normal = np.stack([np.zeros_like(z), np.zeros_like(z), -np.sign(dz)], axis=1)
        round_ = (wall > 0) & np.isfinite(best)
        normal[round_, :2] = -(o[round_, :2] + best[round_, None] * d[round_, :2]) / wall[round_, None]
        normal[round_, 2] = 0.0
        return best, normal

    def seen(self, p, n, rng):
        """Share of what leaves each point that arrives on the optic, by one random point of the optic."""
        r, phi = self.optic_radius * np.sqrt(rng.random(len(p))), rng.uniform(0, 2 * np.pi, len(p))
        q = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(len(p), self.optic_z)])
        way = q - p
        distance = np.linalg.norm(way, axis=1)
        d = way / distance[:, None]
        cosines = np.maximum(np.sum(d * n, axis=1), 0) * np.abs(d[:, 2])
        use = cosines > 0
        free = np.zeros(len(p), bool)
        free[use] = ~(self.cast(p[use], d[use])[0] < distance[use] * (1 - 1e-9))
        return free * cosines / (np.pi * distance**2) * np.pi * self.optic_radius**2


def transmittances(walk, opening, z_front, z_between, orders, seed):
    """PST of a plane wave from random directions of the cell, after each number of scatters, (orders,)."""
    rng = np.random.default_rng(seed)
    count = POPULATION
    low, high = np.cos(np.radians([HIGH_DEG, LOW_DEG]))
    cosine, phi = rng.uniform(low, high, count), rng.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - cosine**2)
    d = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), cosine])
    r, phi = opening * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    p = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(count, z_front)])
    w = np.pi * opening**2 * cosine / count
    found = []
    for _ in range(orders):
        t, n = walk.cast(p, d)
        met = np.isfinite(t)
        p, n, w = p[met] + t[met, None] * d[met], n[met], w[met] * ALBEDO
        found.append(np.sum(w * walk.seen(p, n, rng)))
        behind = p[:, 2] > z_between
        parts = []
        for part in (behind, ~behind):
            numbers = np.flatnonzero(part)
            if numbers.size:
                total = w[numbers].sum()
                drawn = rng.choice(numbers, count // 2, p=w[numbers] / total)
                parts.append((drawn, np.full(len(drawn), total / len(drawn))))
        chosen, w = (np.concatenate(column) for column in zip(*parts, strict=True))
        p, n = p[chosen], n[chosen]
        # Cosine law: a point of the unit sphere added to the normal
        z, phi = rng.uniform(-1, 1, len(p)), rng.uniform(0, 2 * np.pi, len(p))
        ball = np.column_stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
        d = n + ball
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.array(found) / (np.pi * walk.optic_radius**2)


@pytest.mark.validation
@pytest.mark.slow
def test_transmittance_of_1e_10_is_that_of_a_random_walk(baffle):
    """Both to 5 % or better, compared within 4 combined standard errors: false alarms 6e-5 for each of two sums."""
    shapes = baffle.structures(
        coating=Coating(R=0.0), scatter=(Scatter("paint", {"reflectance": ALBEDO}, name="paint"),)
    )
    walk = Walk(shapes, baffle.inner.optic_radius, baffle.inner.z_rear)
    opening = baffle.outer.vanes[0].radius
    places = (opening, baffle.outer.z_front, baffle.inner.z_front)
    runs = np.array([transmittances(walk, *places, 5, seed) for seed in range(BATCHES)])
    np.testing.assert_array_equal(runs[:, :3], 0)
    scene = Prescription(
        name="two stages",
        surfaces=(),
        structures=shapes,
        detector=Detector(z=baffle.inner.z_rear, semi_diameter=baffle.inner.optic_radius),
        source=Source(radius=opening, z=baffle.outer.z_front, plane="axis"),
    ).to_scene()
    for scatters in (4, 5):
        sums = runs[:, :scatters].sum(axis=1)
        wanted, wanted_se = sums.mean(), sums.std(ddof=1) / np.sqrt(BATCHES)
        limits = {"max_scatters": scatters, "max_reflections": 0, "paths": False}
        middle, width = (LOW_DEG + HIGH_DEG) / 2, HIGH_DEG - LOW_DEG
        found = pst(scene, [middle], cell_deg=width, rays=1_500_000, **limits)
        value, se = found.value[0], found.standard_error[0]
        assert wanted_se < 0.05 * wanted
        assert se < 0.08 * value
        assert abs(value - wanted) < 4 * np.hypot(se, wanted_se)
        assert value < 1e-10

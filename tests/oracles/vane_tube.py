"""PST of a painted tube with thin vanes in float64: walks from the detector, connected to first hits of the light."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .geometry import Array, Frustum

CLOSE = 1e-9
WALL, BOTTOM, FIRST_VANE = 0, 1, 2


@dataclass(frozen=True)
class VaneTube:
    """Radius and length of the tube, places of the vanes, radii of their holes and of the detector; reflectance."""

    radius: float
    length: float
    vanes: tuple[float, ...]
    hole: float
    detector: float
    reflectance: float
    scatters: int

    @cached_property
    def surfaces(self) -> tuple[Frustum, ...]:
        r, length = self.radius, self.length
        vanes = (Frustum(self.hole, z, r, z) for z in self.vanes)
        return Frustum(r, 0.0, r, length), Frustum(0.0, 0.0, r, 0.0), *vanes, Frustum(0.0, length, r, length)

    def hit(self, p: Array, d: Array) -> tuple[Array, Array, Array, Array]:
        """Distance, surface, point and normal towards the ray of the next hit; the opening is the last surface."""
        lengths = np.array([surface.first_hit(p, d, np.zeros(len(p), dtype=bool)) for surface in self.surfaces])
        t, s = lengths.min(axis=0), lengths.argmin(axis=0)
        q = p + t[:, None] * d
        normal = np.array([surface.normal(q) for surface in self.surfaces])[s, np.arange(len(q))]
        return t, s, q, normal * -np.sign(np.sum(normal * d, axis=1, keepdims=True))

    def pst(self, low_deg: float, high_deg: float, paths: int, seed: int) -> tuple[float, float]:
        """PST of light from between two angles, and its standard error from batches."""
        rng = np.random.default_rng(seed)
        batches = np.array([self._batch(low_deg, high_deg, paths // 32, rng) for _ in range(32)])
        return float(batches.mean()), float(batches.std(ddof=1) / np.sqrt(32))

    def _batch(self, low_deg: float, high_deg: float, n: int, rng: np.random.Generator) -> float:
        cosine = rng.uniform(np.cos(np.radians(high_deg)), np.cos(np.radians(low_deg)), n)
        sine, turn = np.sqrt(1 - cosine**2), rng.uniform(0, 2 * np.pi, n)
        sky = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), cosine])
        _, surface, lit, lit_normal = self.hit(disc(self.radius, self.length - CLOSE, n, rng), -sky)
        scatters = surface <= FIRST_VANE + len(self.vanes) - 1
        scatters &= (surface != BOTTOM) | (np.hypot(lit[:, 0], lit[:, 1]) > self.detector)
        # Radiance that a ray of light of 1 W/mm² gives its first hit, times the area that it stands for
        light = np.where(scatters, self.reflectance / np.pi * np.pi * self.radius**2 * cosine, 0)

        p, normal = disc(self.detector, 0.0, n, rng), np.tile([0.0, 0.0, 1.0], (n, 1))
        weight, total = np.ones(n), 0.0
        for k in range(self.scatters):
            chosen = rng.integers(0, n, n)
            v = lit[chosen] - p
            distance = np.linalg.norm(v, axis=1)
            v /= distance[:, None]
            at_p, at_light = np.sum(normal * v, axis=1), -np.sum(lit_normal[chosen] * v, axis=1)
            worth = np.flatnonzero((weight > 0) & (light[chosen] > 0) & (at_p > CLOSE) & (at_light > CLOSE))
            t, *_ = self.hit(p[worth] + 1e-7 * normal[worth], v[worth])
            worth = worth[t >= distance[worth] - 1e-5 * self.radius]
            response = weight[worth] * (1.0 if k == 0 else self.reflectance / np.pi)
            geometry = at_p[worth] * at_light[worth] / distance[worth] ** 2
            total += float(np.sum(response * geometry * light[chosen[worth]])) / n
            _, surface, q, next_normal = self.hit(p + 1e-7 * normal, by_cosine(normal, rng))
            on_detector = (surface == BOTTOM) & (np.hypot(q[:, 0], q[:, 1]) < self.detector)
            weight = weight * (np.pi if k == 0 else self.reflectance)
            weight[(surface > FIRST_VANE + len(self.vanes) - 1) | on_detector] = 0
            p, normal = q, next_normal
        return total


def disc(radius: float, z: float, n: int, rng: np.random.Generator) -> Array:
    r, turn = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(n, z)])


def by_cosine(normal: Array, rng: np.random.Generator) -> Array:
    """Directions about normals with the density cos θ/π: a point of the sphere that touches the surface there."""
    z, turn = rng.uniform(-1, 1, len(normal)), rng.uniform(0, 2 * np.pi, len(normal))
    r = np.sqrt(1 - z * z)
    d = normal + np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))

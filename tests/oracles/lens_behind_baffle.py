"""A lens behind painted cylinders and rings, in float64 NumPy: its PST by a random walk with splitting.

The numbers are read from a scene file: cylinders whose inside scatters, rings that scatter on both sides, each black or
Lambertian, one lens with a front that is a conic and a plane rear, both with the same R and T at every angle, and a
round detector behind it. Walks go from the detector, each direction by the cosine. Where one passes a given plane
towards the sky for the first time, it is split into as many as the plane says. Every hit on paint is connected to the
sky: to a direction of the cell of angles, drawn uniformly. All orders of scatter are found in this way, nothing else.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .vane_tube import by_cosine, disc

Array = np.ndarray
FAR, CLOSE = 1e9, 1e-7
REFLECTED_WALKS = 0.1  # probability of a reflection at a face of the lens


@dataclass(frozen=True)
class Ring:
    """Between two radii at z, or, of the same radii, a cylinder between two z; whether it is painted."""

    r: tuple[float, float]
    z: tuple[float, float]
    painted: bool


@dataclass(frozen=True)
class BaffledLens:
    """All of it; the lens stands at z = 0."""

    rings: tuple[Ring, ...]
    radius: float
    conic: float
    thickness: float
    semi_diameter: float
    index: float
    R: float
    detector_z: float
    detector: float
    reflectance: float
    scatters: int

    @classmethod
    def read(cls, path: Path, reflectance: float, scatters: int) -> BaffledLens:
        """That of a scene file."""
        rings, lens, detector = [], {}, {}
        for shape in ET.parse(path).getroot().iter("shape"):
            numbers = {one.get("name", ""): float(one.get("value", "")) for one in shape.findall("float")}
            shift = [float(one.get("z", "")) for one in shape.iter("translate")]
            if shape.get("type") == "frustum":
                r, z = (numbers["r0"], numbers["r1"]), (numbers["z0"], numbers["z1"])
                assert r[0] == r[1] or z[0] == z[1]
                rings.append(Ring((min(r), max(r)), (min(z), max(z)), bool(shape.findall("bsdf/ref"))))
            elif shape.find("sensor") is not None:
                detector = {"detector": numbers["semi_diameter"], "detector_z": shift[0]}
            elif "radius" in numbers:
                lens |= {
                    "radius": numbers["radius"],
                    "conic": numbers["conic"],
                    "semi_diameter": numbers["semi_diameter"],
                }
                named = {one.get("name"): one.get("value", "") for one in shape.iter("string")}
                values = {one.get("name"): one.get("value", "") for one in shape.findall("bsdf/float")}
                lens |= {"index": float(named["back"]), "R": float(values["R"])}
            else:
                lens["thickness"] = shift[0]
        return cls(tuple(rings), **lens, **detector, reflectance=reflectance, scatters=scatters)

    def hit(self, p: Array, d: Array) -> tuple[Array, Array, Array, Array]:
        """
        Distance, what is met, point, normal towards the ray.

        What is met: -1 nothing, -2 what absorbs, the detector among it, 0 the front, 1 the rear, 2 paint.
        """
        n = len(p)
        t, what, normal = np.full(n, FAR), np.full(n, -1), np.zeros((n, 3))
        a, b = d[:, 0] ** 2 + d[:, 1] ** 2, np.sum(p[:, :2] * d[:, :2], axis=1)
        r2 = p[:, 0] ** 2 + p[:, 1] ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            for ring in self.rings:
                if ring.z[0] == ring.z[1]:
                    self._plane(ring.z[0], ring.r, 2 if ring.painted else -2, (p, d), (t, what, normal))
                    continue
                root = np.sqrt(b * b - a * (r2 - ring.r[0] ** 2))
                for sign in (-1, 1):
                    here = (-b + sign * root) / a
                    z = p[:, 2] + here * d[:, 2]
                    meets = (here > CLOSE) & (here < t) & (z > ring.z[0]) & (z < ring.z[1])
                    t[meets] = here[meets]
                    # The inside alone is painted; the far root meets it
                    what[meets] = 2 if ring.painted and sign == 1 else -2
                    q = p[meets, :2] + here[meets, None] * d[meets, :2]
                    normal[meets] = 0
                    normal[meets, :2] = -sign * q / ring.r[0]
            self._plane(self.detector_z, (-1.0, self.detector), -2, (p, d), (t, what, normal))
            self._plane(self.thickness, (-1.0, self.semi_diameter), 1, (p, d), (t, what, normal))
            self._front((p, d), (t, what, normal))
        return t, what, p + t[:, None] * d, normal

    @staticmethod
    def _plane(z: float, r: tuple[float, float], kind: int, ray: tuple[Array, Array], found: tuple[Array, ...]) -> None:
        (p, d), (t, what, normal) = ray, found
        here = (z - p[:, 2]) / d[:, 2]
        apart = np.hypot(p[:, 0] + here * d[:, 0], p[:, 1] + here * d[:, 1])
        meets = (here > CLOSE) & (here < t) & (apart > r[0]) & (apart < r[1])
        t[meets], what[meets] = here[meets], kind
        normal[meets] = 0
        normal[meets, 2] = -np.sign(d[meets, 2])

    def _front(self, ray: tuple[Array, Array], found: tuple[Array, ...]) -> None:
        """c (x² + y² + (1 + k) z²) = 2 z."""
        (p, d), (t, what, normal) = ray, found
        c, k1 = 1 / self.radius, 1 + self.conic
        scale = np.array([1, 1, k1])
        a = c * np.sum(scale * d * d, axis=1)
        b = c * np.sum(scale * p * d, axis=1) - d[:, 2]
        g = c * np.sum(scale * p * p, axis=1) - 2 * p[:, 2]
        root = np.sqrt(b * b - a * g)
        for sign in (-1, 1):
            here = (-b + sign * root) / a
            q = p + here[:, None] * d
            meets = (here > CLOSE) & (here < t) & (np.hypot(q[:, 0], q[:, 1]) < self.semi_diameter)
            meets &= q[:, 2] < self.radius / k1
            t[meets], what[meets] = here[meets], 0
            grad = c * scale * q[meets] - [0, 0, 1]
            grad /= np.linalg.norm(grad, axis=1, keepdims=True)
            normal[meets] = -np.sign(np.sum(grad * d[meets], axis=1))[:, None] * grad

    def pst(self, cells_deg: list[tuple[float, float]], walks: int, planes: dict[float, int], seed: int) -> Array:
        """
        PST of light from between two angles, (c, 2): values, and standard errors from 32 batches.

        `planes` are z at which walks are split, and into how many.
        """
        rng = np.random.default_rng(seed)
        batches = np.array([self._batch(cells_deg, walks // 32, planes, rng) for _ in range(32)])
        return np.stack([batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(32)], axis=1)

    def _batch(
        self, cells_deg: list[tuple[float, float]], walks: int, planes: dict[float, int], rng: np.random.Generator
    ) -> Array:
        cosines = np.cos(np.radians(cells_deg))
        p = disc(self.detector, self.detector_z, walks, rng)
        d = by_cosine(np.tile([0.0, 0.0, -1.0], (walks, 1)), rng)
        weight, scattered = np.full(walks, np.pi / walks), np.zeros(walks, dtype=int)
        left = np.full(walks, max(planes) + 1.0)  # the foremost place so far
        total = np.zeros(len(cells_deg))
        while len(p):
            _, what, q, normal = self.hit(p, d)
            foremost = np.minimum(left, q[:, 2])
            copies = np.ones(len(p), dtype=int)
            for z, number in planes.items():
                copies[(left > z) & (foremost <= z)] *= number
            here = np.repeat(np.arange(len(p)), np.where(what >= 0, copies, 0))
            weight = weight[here] / copies[here]
            q, d, normal, what, left, scattered = (x[here] for x in (q, d, normal, what, foremost, scattered))
            inside = (what == 0) & (d[:, 2] < 0) | (what == 1) & (d[:, 2] > 0)
            painted = what == 2
            next_d = self._at_lens(d, normal, inside, rng)
            weight = np.where(painted, weight, weight * next_d[1])
            d = next_d[0]
            lit = np.flatnonzero(painted)
            weight[lit] *= self.reflectance
            scattered[lit] += 1
            for k, (high, low) in enumerate(cosines):
                total[k] += self._sky(q[lit], normal[lit], weight[lit], (low, high), rng)
            d[lit] = by_cosine(normal[lit], rng)
            on = ~painted | (scattered < self.scatters)
            p, d, weight, scattered, left = q[on], d[on], weight[on], scattered[on], left[on]
        return total

    def _at_lens(self, d: Array, normal: Array, inside: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Directions behind a face of the lens, and factors of weights; rays go through or back by chance."""
        eta = np.where(inside, self.index, 1 / self.index)[:, None]
        cos_i = -np.sum(d * normal, axis=1, keepdims=True)
        left = 1 - eta**2 * (1 - cos_i**2)
        through = eta * d + (eta * cos_i - np.sqrt(np.maximum(left, 0))) * normal
        back = d + 2 * cos_i * normal
        total = left[:, 0] < 0
        reflect = total | (rng.random(len(d)) < REFLECTED_WALKS)
        factor = np.where(reflect, self.R / REFLECTED_WALKS, (1 - self.R) / (1 - REFLECTED_WALKS))
        return np.where(reflect[:, None], back, through), np.where(total, 1.0, factor)

    def _sky(
        self, q: Array, normal: Array, weight: Array, cosines: tuple[float, float], rng: np.random.Generator
    ) -> float:
        """Light of 1 W/mm² from directions between two cosines to the axis, drawn uniformly, that comes along walks."""
        n = len(q)
        z, turn = rng.uniform(*cosines, n), rng.uniform(0, 2 * np.pi, n)
        sine = np.sqrt(1 - z * z)
        sky = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -z])
        cos = np.sum(sky * normal, axis=1)
        worth = np.flatnonzero(cos > 0)
        _, what, *_ = self.hit(q[worth], sky[worth])
        free = worth[what == -1]
        # A matt surface under an irradiance cos θ has the radiance ρ cos θ/π
        return float(np.sum(weight[free] * cos[free])) / np.pi

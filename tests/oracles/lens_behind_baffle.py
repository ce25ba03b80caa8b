"""PST of a lens behind painted cylinders and rings in float64: walks from the detector, split at planes."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from .geometry import Array, Frustum
from .interface import interact
from .nonsequential import nearest_hits
from .scene_xml import SceneModel, parse_scene
from .vane_tube import by_cosine, disc

WAVELENGTH_NM = 550.0
REFLECTED_WALKS = 0.1  # probability of a reflection at a face of the lens


@dataclass(frozen=True)
class BaffledLens:
    """The scene, which of its surfaces are painted, the reflectance of the paint, and how often light may scatter."""

    model: SceneModel
    painted: Array
    reflectance: float
    scatters: int

    @classmethod
    def read(cls, path: Path, reflectance: float, scatters: int) -> BaffledLens:
        text = path.read_text(encoding="utf-8")
        refs = {shape.get("id"): shape.find("bsdf/ref") for shape in ElementTree.fromstring(text).iter("shape")}
        model = parse_scene(text, path)
        painted = [isinstance(s.surface, Frustum) and refs[s.shape_id] is not None for s in model.shapes]
        return cls(model, np.array(painted), reflectance, scatters)

    @cached_property
    def _cylinder(self) -> Array:
        return np.array([isinstance(s.surface, Frustum) and s.surface.r0 == s.surface.r1 for s in self.model.shapes])

    def hit(self, p: Array, d: Array, last: np.ndarray) -> tuple[np.ndarray, Array, Array, np.ndarray]:
        """Surface (-1: none), point, normal, and whether there is paint; of a cylinder on the inside alone."""
        t, number = nearest_hits(self.model, p, d, last)
        q = p + np.where(number < 0, 0.0, t)[:, None] * d
        normal = np.zeros_like(p)
        for k in np.unique(number[number >= 0]):
            normal[number == k] = self.model.shapes[k].normal(q[number == k])
        outwards = np.sum(d * normal, axis=1) > 0
        return number, q, normal, (number >= 0) & self.painted[number] & (outwards | ~self._cylinder[number])

    def pst(self, cells_deg: list[tuple[float, float]], walks: int, planes: dict[float, int], seed: int) -> Array:
        """PST of light from cells of angles, and errors, (c, 2); `planes`: z → into how many walks are split."""
        rng = np.random.default_rng(seed)
        batches = np.array([self._batch(cells_deg, walks // 32, planes, rng) for _ in range(32)])
        return np.stack([batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(32)], axis=1)

    def _batch(
        self, cells_deg: list[tuple[float, float]], walks: int, planes: dict[float, int], rng: np.random.Generator
    ) -> Array:
        (name,) = self.model.detectors
        detector = self.model.by_id[name]
        p = disc(detector.surface.extent(), detector.to_world[2, 3], walks, rng)
        d = by_cosine(np.tile([0.0, 0.0, -1.0], (walks, 1)), rng)
        last = np.full(walks, self.model.shapes.index(detector))
        weight, scattered = np.full(walks, np.pi / walks), np.zeros(walks, dtype=int)
        left = np.full(walks, max(planes) + 1.0)  # the foremost place so far
        total = np.zeros(len(cells_deg))
        transparent = np.array([not shape.interface.opaque for shape in self.model.shapes])
        while len(p):
            number, q, normal, paint = self.hit(p, d, last)
            foremost = np.minimum(left, q[:, 2])
            copies = np.ones(len(p), dtype=int)
            for z, into in planes.items():
                copies[(left > z) & (foremost <= z)] *= into
            goes_on = (number >= 0) & (paint | transparent[number])
            here = np.repeat(np.arange(len(p)), np.where(goes_on, copies, 0))
            weight = weight[here] / copies[here]
            p, d, normal, paint, last, left, scattered = (
                x[here] for x in (q, d, normal, paint, number, foremost, scattered)
            )
            for k in np.unique(last[~paint]):
                at = (last == k) & ~paint
                d[at], factor = self._at_lens(int(k), d[at], normal[at], rng)
                weight[at] *= factor
            weight[paint] *= self.reflectance
            scattered[paint] += 1
            normal[paint] *= -np.sign(np.sum(normal * d, axis=1, keepdims=True))[paint]
            for k, cell in enumerate(cells_deg):
                total[k] += self._sky(p[paint], normal[paint], weight[paint], last[paint], cell, rng)
            d[paint] = by_cosine(normal[paint], rng)
            on = ~paint | (scattered < self.scatters)
            p, d, weight, scattered, left, last = (x[on] for x in (p, d, weight, scattered, left, last))
        return total

    def _at_lens(self, number: int, d: Array, normal: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Directions behind a face of the lens, and factors of weights; rays go through or back by chance."""
        face = self.model.shapes[number]
        out = interact(face.interface, *self.model.indices(face.shape_id, WAVELENGTH_NM), WAVELENGTH_NM, d, normal)
        reflect = out.tir | (rng.random(len(d)) < REFLECTED_WALKS)
        chance = np.where(out.tir, 1.0, np.where(reflect, REFLECTED_WALKS, 1 - REFLECTED_WALKS))
        power = np.where(reflect, out.reflectance, out.transmittance)
        return np.where(reflect[:, None], out.reflected, out.transmitted), power / chance

    def _sky(
        self, p: Array, normal: Array, weight: Array, last: np.ndarray, cell_deg: tuple[float, float],
        rng: np.random.Generator,
    ) -> float:  # fmt: skip
        """Light of 1 W/mm² from directions between two angles to the axis, drawn uniformly, that comes along walks."""
        high, low = np.cos(np.radians(cell_deg))
        z, turn = rng.uniform(low, high, len(p)), rng.uniform(0, 2 * np.pi, len(p))
        sine = np.sqrt(1 - z * z)
        sky = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -z])
        cos = np.sum(sky * normal, axis=1)
        worth = np.flatnonzero(cos > 0)
        _, number = nearest_hits(self.model, p[worth], sky[worth], last[worth])
        free = worth[number < 0]
        # A matt surface under an irradiance cos θ has the radiance ρ cos θ/π
        return float(np.sum(weight[free] * cos[free])) / np.pi

"""Start rays of a parallel beam, as the plugin `collimated` defines it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.emission_laws import EDGE, perimeter
from mistray.sampling.source import Emission, SceneSource, Sphere
from mistray.sampling.strata import stratified_points
from mistray.surfaces.upload import opaque, upload


@dataclass(frozen=True, kw_only=True)
class Beam(SceneSource):
    """
    Parallel beam as a source: rays of one direction that start on a plane normal to it.

    The pivot and the axes are those of the cross-section, see `Collimated.frame`.

    Attributes
    ----------
    aperture : Sphere or None
        Sphere that probe rays go to, as far as the beam has light there; None: they fill the beam.
    """

    aperture: Sphere | None = None

    @property
    def pattern(self) -> str:  # type: ignore[override]  # read-only
        """Arrangement of the rays' start positions over the cross-section: "random" or "grid"."""
        return str(self.emitter.pattern)

    @property
    def reach(self) -> float:  # type: ignore[override]  # read-only
        """Radius of the largest circle, about the middle ray, within the beam's outline at the pivot, mm."""
        # Of a rectangle the inscribed circle
        return float(min(self.emitter.size) if self.emitter.rectangular else self.emitter.size[0])

    def count(self, rays: int) -> int:
        """Return the number of rays actually started for a request of `rays`; a grid has a square number of them."""
        return int(np.sqrt(rays)) ** 2 if self.pattern == "grid" else rays

    def exact(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return start rays moved to one plane normal to the beam: origins, mm, and directions, (n, 3) float64 each."""
        ahead = (o - self.pivot) @ self.direction + self.distance
        return o - ahead[:, None] * self.direction, np.broadcast_to(self.direction, d.shape).copy()

    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """
        Return the beam's start rays of one pass: origins relative to `centre`, mm, and unit directions.

        See `SceneSource.start`.
        """
        # Positions in the cross-section
        if self.pattern == "grid":
            side = int(np.sqrt(rays))
            sample = mi.Point2f((mi.Float(lane % side) + 0.5) / side, (mi.Float(lane // side) + 0.5) / side)
        else:
            sample = stratified_points(batch, rng)
        x, y = self.emitter.positions(sample)
        vectors = (self.pivot - centre, self.direction, self.u, self.v)
        pivot, direction, u, v = (opaque(mi.Vector3f, vector) for vector in vectors)
        offset = u * x + v * y
        # All rays start on one plane normal to the beam, also where the cross-section is not
        back = dr.opaque(mi.Float, self.distance) + dr.dot(offset, direction)
        origin = pivot + offset - back * direction
        return Emission(origin, dr.zeros(mi.Vector3f, dr.width(lane)) + direction)

    def edges(self, count: int, within: float = EDGE) -> list[tuple[np.ndarray, np.ndarray]]:
        """
        Return rays on the outline of the beam, and on that of its dark centre if it has one.

        Each line has origins, mm, and unit directions, (count, 3) float64 each. `within` is the relative distance by
        which they lie inside the lit area.
        """
        sample = mi.Point2f(*(upload(mi.Float, v) for v in perimeter(count, within)))
        outer = np.array(self.emitter.positions(sample), dtype=np.float64)
        hole = 0.0 if self.emitter.rectangular else self.emitter.size[1] * (1 + within)
        lines = [outer, hole * outer / np.hypot(*outer)] if hole else [outer]
        return [self.through(*line) for line in lines]

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> Beam:
        """Return a copy of the beam with probe rays aimed at `aperture`; start rays do not change, `lit` is ignored."""
        return replace(self, aperture=aperture)

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Return probe rays of the beam, aimed at `aperture` if set: origins, mm, and unit directions, (n, 3) each."""
        x, y = self.emitter.positions(sample)
        if self.aperture is not None:
            axes = np.stack([self.u, self.v, self.direction], axis=1)
            a, b, _ = opaque(mi.Vector3f, np.linalg.solve(axes, self.aperture.centre - self.pivot))
            # In a cross-section that is not normal to the beam the projection of the sphere is longer
            radius = dr.opaque(mi.Float, self.aperture.radius / float(np.linalg.det(axes)))
            disk = radius * mi.warp.square_to_uniform_disk_concentric(sample) + mi.Point2f(a, b)
            lit = self.emitter.within(disk.x, disk.y)
            x, y = dr.select(lit, disk.x, x), dr.select(lit, disk.y, y)
        dr.eval(x, y)
        return self.through(np.array(x, dtype=np.float64), np.array(y, dtype=np.float64))

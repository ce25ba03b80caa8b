"""Start rays of a warm surface: uniform over its area, with directions in proportion to ε(θ) cos θ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.lobes import from_local
from mistray.sampling.emission_laws import IntensityTable
from mistray.sampling.source import Emission, SceneSource, on_host
from mistray.sampling.strata import stratified_points
from mistray.surfaces.host_points import even_points
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload


@dataclass(frozen=True, kw_only=True)
class WarmRays(SceneSource):
    """
    Thermal emission of one side of a surface at one wavelength, as a source.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    surface : int
        Index of the surface.
    to_back : bool
        Whether the light leaves to the back.
    medium : int
        Position in `Optics.media` of the material there.
    law : IntensityTable
        ε(θ) cos θ, dimensionless, against the angle θ from the normal.
    """

    table: SurfaceTable
    surface: int
    to_back: bool
    law: IntensityTable

    @property
    def middle(self) -> None:
        """Middle ray of the source: None, since thermal emission has no single direction."""

    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """Return start rays of one pass, from the surface: origins, mm, unit directions; see `SceneSource.start`."""
        sample = stratified_points(batch, rng)
        o, d = self._rays(sample, lambda: np.array(rng.next_float32(), dtype=np.float64), dr.width(lane))
        return Emission(mi.Vector3f(*(upload(mi.Float, column) for column in (o - centre).T)), mi.Vector3f(d))

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Return probe rays from random points of the surface: origins, mm, and unit directions, (n, 3) each."""
        count = dr.width(sample)
        rng = np.random.default_rng(0)
        o, d = self._rays(sample, lambda: rng.random(count), count)
        return o, on_host(d, d)[1]

    def _rays(self, sample: mi.Point2f, draw: Callable[[], np.ndarray], count: int) -> tuple[np.ndarray, Any]:
        """
        Return origins in the world, (n, 3) float64, mm, and unit directions on the device, of `count` rays.

        `sample`, points of the unit square, gives the directions, and `draw`, which returns `count` random numbers, the
        origins.
        """
        # Points on the host, which has every family of surfaces; normals point from front to back
        o, normals = even_points(self.table, self.surface, draw, count)
        outward = mi.Vector3d(*(upload(mi.Float64, column) for column in (normals if self.to_back else -normals).T))
        # Directions of equal flux in the local frame
        local = self.law.directions(mi.Point2d(sample))
        return o, dr.normalize(from_local(mi.Vector3f(local), mi.Vector3f(outward)))

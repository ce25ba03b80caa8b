"""Derivatives of a metric by what moves the start of its rays: a parameter of their source, or the detector."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.gradients.replay import Branches
from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.sampling.source import SceneSource
from mistray.settings import BATCHES


class StartMotion(Protocol):
    """What the starts of rays contribute to the derivatives."""

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Add those of some rays, by their origins and directions."""


class SurfaceStart:
    """
    Rays that start from a surface and move with it.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Gathers the derivatives.
    surface : int
    """

    def __init__(self, surfaces: ReplaySurfaces, surface: int) -> None:
        self._surfaces, self._surface = surfaces, surface

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Add derivatives to the numbers of the surface."""
        self._surfaces.move_start(self._surface, rays.o, rays.d, by_o, by_d, rays.batch, active)


class SourceStart:
    """
    Rays that start from a source and move with its parameters.

    Parameters
    ----------
    source : SceneSource
    names : iterable of str
        The parameters that are requested; others than those of the source are left out.
    centre : (3,) float64
        What the origins of rays are relative to, mm.
    """

    def __init__(self, source: SceneSource, names: Iterable[str], centre: np.ndarray) -> None:
        self.source = source
        self._centre = mi.Vector3d(*centre.tolist())
        self._sums = {name: dr.zeros(mi.Float64, BATCHES) for name in sorted({*names} & {*source.moving})}

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Add derivatives by the parameters."""
        for name, sums in self._sums.items():
            o, d = self.source.motion(name, rays.o + self._centre, rays.d)
            gain = dr.select(active, dr.dot(by_o, o) + dr.dot(by_d, d), 0)
            dr.scatter_reduce(dr.ReduceOp.Add, sums, gain, rays.batch, active)

    def result(self) -> dict[str, np.ndarray]:
        """Name → (BATCHES,) float64."""
        return {name: np.array(sums) for name, sums in self._sums.items()}


@dataclass
class SourceDerivative:
    """
    Derivatives of a metric by a parameter of a source, by batch of start rays.

    Attributes
    ----------
    owner : mi.Emitter
    name : str
    inner : (BATCHES,) float64
        With visibility as it is.
    edges : (w, BATCHES) float64
        Of rims, for each width of the zones.
    """

    owner: Any
    name: str
    inner: np.ndarray
    edges: np.ndarray


def source_derivatives(starts: Sequence[StartMotion | None]) -> list[SourceDerivative]:
    """What has been gathered of a source: with visibility as it is and, where rims count, with each width of zones."""
    inner, *edges = (start for start in starts if isinstance(start, SourceStart))
    at_rims = [start.result() for start in edges]
    nothing = np.zeros((0, BATCHES))
    return [
        SourceDerivative(
            inner.source.emitter, name, values, np.stack([found[name] for found in at_rims]) if at_rims else nothing
        )
        for name, values in inner.result().items()
    ]

"""Derivatives of a metric by the motion of its start rays: parameters of their source, or the detector."""

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
    """Derivatives that the start of a ray contributes."""

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Accumulate derivatives, given those of the metric by origins and directions of some rays."""


class SurfaceStart:
    """
    Backward rays that start from a surface and move with it.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Accumulates the derivatives.
    surface : int
        Number of the surface.
    """

    def __init__(self, surfaces: ReplaySurfaces, surface: int) -> None:
        self._surfaces, self._surface = surfaces, surface

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Accumulate derivatives in the numbers of the surface."""
        self._surfaces.move_start(self._surface, rays.o, rays.d, by_o, by_d, rays.batch, active)


class SourceStart:
    """
    Forward rays that start from a source and move with its parameters.

    Parameters
    ----------
    source : SceneSource
    names : iterable of str
        Requested parameters; others than those of the source are left out.
    centre : (3,) float64
        Origin of the coordinates of rays on the device, mm.
    """

    def __init__(self, source: SceneSource, names: Iterable[str], centre: np.ndarray) -> None:
        self.source = source
        self._centre = mi.Vector3d(*centre.tolist())
        self._sums = {name: dr.zeros(mi.Float64, BATCHES) for name in sorted({*names} & {*source.moving})}

    def add(self, rays: Branches, by_o: mi.Vector3d, by_d: mi.Vector3d, active: mi.Bool) -> None:
        """Accumulate derivatives by the parameters."""
        for name, sums in self._sums.items():
            # Rate at which origin and direction move with the parameter, times the adjoints of both
            o, d = self.source.motion(name, rays.o + self._centre, rays.d)
            gain = dr.select(active, dr.dot(by_o, o) + dr.dot(by_d, d), 0)
            dr.scatter_reduce(dr.ReduceOp.Add, sums, gain, rays.batch, active)

    def result(self) -> dict[str, np.ndarray]:
        """Return name of a parameter → derivatives by batch, (BATCHES,) float64."""
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
        Derivatives with visibility held.
    edges : (w, BATCHES) float64
        Boundary terms of rims, for each width of the zones.
    """

    owner: Any
    name: str
    inner: np.ndarray
    edges: np.ndarray


def source_derivatives(starts: Sequence[StartMotion | None]) -> list[SourceDerivative]:
    """
    Return the derivatives by the parameters of a source.

    Parameters
    ----------
    starts : sequence of StartMotion or None
        Accumulated derivatives with visibility held, then boundary terms for each width of the zones, if any.
    """
    # The first has visibility held; each further one belongs to a width
    inner, *edges = (start for start in starts if isinstance(start, SourceStart))
    at_rims = [start.result() for start in edges]
    # No widths: the first axis is empty
    nothing = np.zeros((0, BATCHES))
    return [
        SourceDerivative(
            inner.source.emitter, name, values, np.stack([found[name] for found in at_rims]) if at_rims else nothing
        )
        for name, values in inner.result().items()
    ]

"""What a trace asks of a source of light: start rays of one wavelength, with a total flux."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.space_filling import sorted_points


class Source(ABC):
    """
    Light of one wavelength.

    Attributes
    ----------
    name : str
        For tables.
    wavelength_nm : float
        In vacuum.
    power : float
        Flux, W.
    pattern : str
        Places of the start rays: "random", or "grid" where they are laid out evenly.
    towards : str
        Where the light goes, for messages.
    moving : tuple of str
        Parameters of the source that a trace has derivatives by, see `motion`.
    """

    name: str
    wavelength_nm: float
    power: float
    pattern: str = "random"
    towards: str = ""
    moving: tuple[str, ...] = ()

    @abstractmethod
    def start(
        self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, closing: np.ndarray, centre: np.ndarray
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """
        Origins and directions of the start rays of one pass.

        Parameters
        ----------
        lane : mi.UInt32
            Numbers of the rays within the whole trace of `rays` rays; consecutive.
        batch : mi.UInt32
            Batch of each ray, ascending.
        rays : int
            Number of rays of the whole trace, as from `count`.
        rng : mi.PCG32
            One generator a lane.
        closing : (BATCHES,) float
            Independent exponential variables, see `mistray.sampling.space_filling.sorted_points`.
        centre : (3,) float64
            What the origins are relative to, mm.
        """

    def count(self, rays: int) -> int:
        """Rays that a request for `rays` starts."""
        return rays

    def exact(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start rays in the world, (n, 3) float64 each, without the rounding that the device has left on them."""
        return o, d

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Derivatives of the origins and directions of start rays by a parameter named in `moving`, in the world."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class SceneSource(Source):
    """
    A source that stands in a scene, at one field angle and wavelength.

    Attributes
    ----------
    emitter : mi.Emitter
        The plugin.
    pivot, direction, u, v : (3,) float64
        A point of the middle ray (mm), the way it goes, and the axes across it.
    distance : float
        From the pivot back to the start of the middle ray, mm.
    """

    emitter: Any
    name: str
    wavelength_nm: float
    power: float
    pivot: np.ndarray
    direction: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: float = 0.0

    @property
    def towards(self) -> str:  # type: ignore[override]  # read-only
        """The direction of the middle ray."""
        return f"along ({', '.join(f'{c:.4g}' for c in self.direction)})"

    @property
    def middle(self) -> tuple[np.ndarray, np.ndarray]:
        """The middle ray: origin (mm) and direction, (1, 3) float64 each."""
        return self.pivot[None] - self.distance * self.direction, self.direction[None]

    def parallel(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays parallel to the middle one, from places (n,) along `u` and `v`, mm: (n, 3) float64 each."""
        o = self.pivot + x[:, None] * self.u + y[:, None] * self.v
        o = o - (self.distance + (o - self.pivot) @ self.direction)[:, None] * self.direction
        return o, np.tile(self.direction, (len(o), 1))

    @property
    def reach(self) -> float:
        """Radius about the middle ray that the light fills at the pivot, mm; inf where it has no edge there."""
        return float("inf")

    @abstractmethod
    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Rays of the source for points of the unit square: origins and directions in the world, (n, 3) float64."""


@dataclass(frozen=True, kw_only=True)
class EmittedRays(SceneSource):
    """A source whose plugin says where its rays start and go, see `mistray.plugins.emitters.light_source`."""

    @property
    def moving(self) -> tuple[str, ...]:  # type: ignore[override]  # read-only
        """Those of the plugin."""
        return tuple(self.emitter.differentiable)

    def start(
        self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, closing: np.ndarray, centre: np.ndarray
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Origins and directions of the plugin's rays, see `Source.start`."""
        sample = sorted_points(batch, rng, closing)
        numbers = {name: dr.opaque(mi.Float, float(value)) for name, value in self.emitter.values.items()}
        o, d = self.emitter.rays(sample, rng, numbers)
        zero = dr.zeros(mi.Vector3f, dr.width(lane))
        pivot = mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in self.pivot - centre))
        axes = [mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in axis)) for axis in self._axes]
        return zero + pivot + _turned(o, axes), zero + dr.normalize(_turned(d, axes))

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Derivatives that the plugin knows, turned to the world."""
        axes = [mi.Vector3d(*axis.tolist()) for axis in self._axes]
        away = o - mi.Vector3d(*self.pivot.tolist())
        local = [mi.Vector3d(*(dr.dot(vector, axis) for axis in axes)) for vector in (away, d)]
        by_o, by_d = self.emitter.motion(name, *local)
        return _turned(by_o, axes), _turned(by_d, axes)

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Rays of the plugin for given points of the unit square."""
        numbers = {name: mi.Float(value) for name, value in self.emitter.values.items()}
        zero = dr.zeros(mi.Vector3f, dr.width(sample))
        rays = self.emitter.rays(sample, mi.PCG32(size=dr.width(sample)), numbers)
        o, d = (np.array(zero + vector, dtype=np.float64).T @ np.stack(self._axes) for vector in rays)
        return self.pivot + o, d / np.linalg.norm(d, axis=1, keepdims=True)

    @property
    def _axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.u, self.v, self.direction


def _turned(vector: mi.Vector3f, axes: list[mi.Vector3f]) -> mi.Vector3f:
    """From the axes of a source to the world."""
    return axes[0] * vector.x + axes[1] * vector.y + axes[2] * vector.z

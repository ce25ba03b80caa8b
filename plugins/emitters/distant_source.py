"""Base class for sources far away, whose light has the same directions everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import mitsuba as mi
import numpy as np

from mistray.plugins.emitters.light_source import LightSource
from mistray.sampling.distant import DistantRays
from mistray.sampling.source import SceneSource, SourceRequest


class DistantSource(LightSource):
    """
    A source whose rays fill the whole scene: its flux is that through a sphere around all surfaces.

    Attributes
    ----------
    densities : mapping of str to float
        What its flux may be given by, and the values of the first where nothing is.
    given : tuple of (str, float)
        What its flux is given by, and how much.
    """

    densities: ClassVar[tuple[str, ...]] = ("irradiance", "radiance")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.DeltaDirection
        self.given = self._flux_given(props, self.densities)

    @property
    def solid_angle(self) -> float:
        """Irradiance across the light for 1 W/mm²/sr in its middle: ∫ L dΩ / L₀, sr."""
        raise NotImplementedError

    @property
    def irradiance(self) -> float:
        """Irradiance of planes across each of its directions, all together: ∫ L dΩ, W/mm²."""
        key, value = self.given
        return value if key == "irradiance" else value * self.solid_angle

    def power(self, field_deg: float | None = None) -> float:
        """Flux through a disc of 1 mm² across the light, W; that of a scene is in proportion to its size."""
        return self.irradiance

    def directions(self, sample: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        """Directions in its own frame, whose z is its axis, of equal flux, for points of the unit square."""
        raise NotImplementedError

    def direction_motion(self, name: str, d: mi.Vector3d) -> mi.Vector3d:
        """Derivatives of directions in its own frame by one of its numbers."""
        raise NotImplementedError

    def source(self, request: SourceRequest, **facts: Any) -> SceneSource:
        """The rays of one wavelength."""
        scene = request.scene
        away = float((facts["pivot"] - scene.centre) @ facts["direction"]) + 1.01 * scene.radius
        facts["power"] *= np.pi * scene.radius**2
        return DistantRays(scene=scene, distance=max(away, 0.0), **facts)

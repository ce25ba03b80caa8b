"""Base class for distant sources, whose light has the same directions everywhere."""

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
    Source whose rays fill the whole scene; its flux is that through a sphere around all surfaces.

    Attributes
    ----------
    densities : tuple of str
        Names of the quantities that may give its flux, ``irradiance`` (W/mm²) and ``radiance`` (W/mm²/sr). The first is
        the default, with the value 1.
    given : tuple of (str, float)
        Quantity that gives its flux, and its value in this unit.
    """

    densities: ClassVar[tuple[str, ...]] = ("irradiance", "radiance")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.DeltaDirection
        self.given = self._flux_given(props, self.densities)

    @property
    def solid_angle(self) -> float:
        """Effective solid angle, sr: irradiance across the light over the radiance of its middle, ∫ L dΩ / L₀."""
        raise NotImplementedError

    @property
    def irradiance(self) -> float:
        """Irradiance by all directions, each on a plane normal to it: ∫ L dΩ, W/mm²."""
        key, value = self.given
        return value if key == "irradiance" else value * self.solid_angle

    def power(self, field_deg: float | None = None) -> float:
        """
        Return the flux through a disc of 1 mm² across the light, W.

        In a scene it is scaled with the scene's size.
        """
        return self.irradiance

    def directions(self, sample: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        """
        Return unit directions of equal flux for points of the unit square, in the source's frame with z as its axis.

        `n` maps names to values as in `LightSource.rays`.
        """
        raise NotImplementedError

    def direction_motion(self, name: str, d: mi.Vector3d) -> mi.Vector3d:
        """
        Return the derivatives of ray directions with respect to the parameter `name` of the source, per its unit.

        The directions are in the source's frame.
        """
        raise NotImplementedError

    def source(self, request: SourceRequest, **facts: Any) -> SceneSource:
        """Return the source of start rays of a trace at one wavelength, with the flux through the scene's sphere, W."""
        scene = request.scene
        away = float((facts["pivot"] - scene.centre) @ facts["direction"]) + 1.01 * scene.radius
        facts["power"] *= np.pi * scene.radius**2
        return DistantRays(scene=scene, distance=max(away, 0.0), **facts)

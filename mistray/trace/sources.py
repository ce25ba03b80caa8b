"""Start rays of the collimated beams of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError


@dataclass(frozen=True)
class Beam:
    """
    One source at one field angle and wavelength.

    Attributes
    ----------
    emitter : mi.Emitter
        The ``collimated`` plugin.
    name : str
    wavelength_nm : float
    power : float
        Flux at this wavelength, W.
    pivot, direction, u, v : (3,) float64
        See `Collimated.frame`.
    distance : float
        From the cross-section back to the start, mm, for the ray through the pivot.
    """

    emitter: Any
    name: str
    wavelength_nm: float
    power: float
    pivot: np.ndarray
    direction: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: float

    def count(self, rays: int) -> int:
        """Rays that a request for `rays` starts: a grid has a square number."""
        return int(np.sqrt(rays)) ** 2 if self.emitter.pattern == "grid" else rays

    def start(self, lane: mi.UInt32, rays: int, rng: mi.PCG32) -> tuple[mi.Vector3f, mi.Vector3f]:
        """
        Origins and directions of the start rays.

        Parameters
        ----------
        lane : mi.UInt32
            Numbers of the rays, 0 … rays - 1.
        rays : int
            Number of rays of the whole trace, as from `count`.
        rng : mi.PCG32
            One generator a lane; two numbers are drawn.
        """
        sample = mi.Point2f(rng.next_float32(), rng.next_float32())
        if self.emitter.pattern == "grid":
            side = int(np.sqrt(rays))
            sample = mi.Point2f(
                (mi.Float(lane % side) + 0.5) / side, (mi.Float(lane // side) + 0.5) / side
            )
        x, y = self.emitter.positions(sample)
        opaque = {key: [dr.opaque(mi.Float, float(c)) for c in getattr(self, key)] for key in ("pivot", "direction", "u", "v")}
        direction, u, v = (mi.Vector3f(*opaque[key]) for key in ("direction", "u", "v"))
        offset = u * x + v * y
        # All rays start on one plane normal to the beam, also where the cross-section is not
        back = dr.opaque(mi.Float, self.distance) + dr.dot(offset, direction)
        origin = mi.Vector3f(*opaque["pivot"]) + offset - back * direction
        return origin, dr.zeros(mi.Vector3f, dr.width(lane)) + direction


def beams(
    scene: mi.Scene, field_deg: float | None = None, azimuth_deg: float | None = None, wavelength_nm: Any = None
) -> list[Beam]:
    """
    The beams to trace: every ``collimated`` emitter of a scene at every wavelength.

    Parameters
    ----------
    field_deg, azimuth_deg : float, optional
        Instead of the emitters' own.
    wavelength_nm : float or sequence of float, optional
        Instead of the emitters' own wavelengths; equal weights.

    Raises
    ------
    MistrayError
        If there is no source, or a field angle or wavelength is out of range.
    """
    emitters = [emitter for emitter in scene.emitters() if hasattr(emitter, "start_distance")]
    if not emitters:
        raise MistrayError("the scene has no source; add an emitter of type 'collimated'")
    for key, value in (("field_deg", field_deg), ("azimuth_deg", azimuth_deg)):
        if value is not None and not np.isfinite(value):
            raise MistrayError(f"{key} is {value}; give a finite angle in degrees")
    if field_deg is not None and not -90 < field_deg < 90:
        raise MistrayError(f"field_deg is {field_deg:g}; it must lie between -90 and 90 degrees")
    result = []
    for emitter in emitters:
        wavelengths, weights = emitter.wavelengths_nm, emitter.weights
        if wavelength_nm is not None:
            wavelengths = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
            weights = np.full(len(wavelengths), 1 / len(wavelengths))
            if np.any(~(wavelengths > 0)):
                raise MistrayError(f"wavelength_nm is {wavelength_nm}; it must be positive (nm)")
        pivot, direction, u, v = emitter.frame(field_deg, azimuth_deg)
        distance = emitter.start_distance(scene.bbox(), direction, pivot)
        for wavelength, weight in zip(wavelengths, weights, strict=True):
            power = emitter.power(field_deg) * weight
            result.append(Beam(emitter, emitter.name, float(wavelength), power, pivot, direction, u, v, distance))
    return result

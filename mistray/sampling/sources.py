"""Start rays of the collimated beams of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, WAVELENGTH_NM, WEIGHT
from mistray.sampling.space_filling import curve_points
from mistray.settings import BATCHES
from mistray.surfaces.surfaces import solid_shapes
from mistray.surfaces.upload import upload

DEFAULT_NM = 550.0  # where a scene has no source


class Source(Protocol):
    """What a run asks of its source: start rays, of one wavelength, with a total flux."""

    @property
    def name(self) -> str:
        """Id, for tables."""

    @property
    def wavelength_nm(self) -> float:
        """Vacuum wavelength, nm."""

    @property
    def power(self) -> float:
        """Flux, W."""

    @property
    def pattern(self) -> str:
        """Positions of the rays: "random" or "grid"."""

    def start(
        self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, closing: np.ndarray, centre: np.ndarray
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Origins and directions of the start rays of one pass, see `Beam.start`."""

    def exact(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start rays in the world, (n, 3) float64 each, without the rounding that the device has left on them."""


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

    @property
    def pattern(self) -> str:
        """Positions of the rays: "random" or "grid"."""
        return str(self.emitter.pattern)

    def count(self, rays: int) -> int:
        """Rays that a request for `rays` starts: a grid has a square number."""
        return int(np.sqrt(rays)) ** 2 if self.pattern == "grid" else rays

    def exact(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same lines from one plane normal to the exact direction: o, d (n, 3) float64 → (n, 3) float64 each."""
        ahead = (o - self.pivot) @ self.direction + self.distance
        return o - ahead[:, None] * self.direction, np.broadcast_to(self.direction, d.shape).copy()

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
            One generator a lane; three numbers are drawn.
        closing : (BATCHES,) float
            Independent exponential variables.
        centre : (3,) float64
            What the origins are relative to, mm.
        """
        if self.pattern == "grid":
            side = int(np.sqrt(rays))
            sample = mi.Point2f((mi.Float(lane % side) + 0.5) / side, (mi.Float(lane // side) + 0.5) / side)
        else:
            sample = sorted_points(batch, rng, closing)
        x, y = self.emitter.positions(sample)
        vectors = (self.pivot - centre, self.direction, self.u, self.v)
        pivot, direction, u, v = (mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in vector)) for vector in vectors)
        offset = u * x + v * y
        # All rays start on one plane normal to the beam, also where the cross-section is not
        back = dr.opaque(mi.Float, self.distance) + dr.dot(offset, direction)
        origin = pivot + offset - back * direction
        return origin, dr.zeros(mi.Vector3f, dr.width(lane)) + direction


def sorted_points(batch: mi.UInt32, rng: mi.PCG32, closing: np.ndarray) -> mi.Point2f:
    """
    Independent uniform points of the unit square, those of each batch in the order of a space-filling curve.

    Neighbouring lanes then walk similar trees, so that few of them idle, and the batches stay independent samples. The
    positions on the curve are sorted uniform numbers without a sort: partial sums of exponential variables over their
    total, which holds one more variable, `closing` (L. Devroye, Non-Uniform Random Variate Generation, 1986, section
    V.2.2). The curve is Morton's with 2^32 cells; the place within a cell is random.
    """
    sums = dr.cumsum(mi.Float64(-dr.log(1 - rng.next_float32())))
    first = np.searchsorted(np.array(batch), np.arange(BATCHES + 1))
    totals = np.concatenate([[0.0], np.array(sums)])[first]
    start, length = upload(mi.Float64, totals[:-1]), upload(mi.Float64, np.diff(totals) + closing)
    u = (sums - dr.gather(mi.Float64, start, batch)) / dr.gather(mi.Float64, length, batch)
    return mi.Point2f(*curve_points(u, 2, rng))


def beams(
    scene: mi.Scene,
    field_deg: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: Any = None,
    weights: Any = None,
) -> list[Beam]:
    """
    The beams to trace: every ``collimated`` emitter of a scene at every wavelength.

    Parameters
    ----------
    field_deg, azimuth_deg : float, optional
        Instead of the emitters' own.
    wavelength_nm : float or sequence of float, optional
        Instead of the emitters' own wavelengths.
    weights : sequence of float, optional
        Shares of the flux, one for each of `wavelength_nm`; normalised. By default all are equal.

    Raises
    ------
    MistrayError
        If there is no source, or a field angle, a wavelength or a weight is out of range.
    """
    emitters = [emitter for emitter in scene.emitters() if hasattr(emitter, "start_distance")]
    if not emitters:
        raise MistrayError("the scene has no source; add an emitter of type 'collimated'")
    if field_deg is not None:
        FIELD_DEG.check("field_deg", field_deg)
    if azimuth_deg is not None:
        AZIMUTH_DEG.check("azimuth_deg", azimuth_deg)
    given = None if wavelength_nm is None and weights is None else spectrum(wavelength_nm, weights)
    bounds = mi.ScalarBoundingBox3f()
    for shape in solid_shapes(scene):
        bounds.expand(shape.bbox())
    result = []
    for number, emitter in enumerate(emitters, start=1):
        name = emitter.name or f"source_{number}"
        wavelengths, shares = given or (emitter.wavelengths_nm, emitter.weights)
        pivot, direction, u, v = emitter.frame(field_deg, azimuth_deg)
        distance = emitter.start_distance(bounds, direction, pivot)
        for wavelength, share in zip(wavelengths, shares, strict=True):
            power = emitter.power(field_deg) * share
            if not np.isfinite(power):
                raise MistrayError(f"source '{name}' has a power of {power} W; give a smaller irradiance or beam")
            result.append(Beam(emitter, name, float(wavelength), power, pivot, direction, u, v, distance))
    return result


def spectrum_of(
    scene: mi.Scene, wavelength_nm: float | Sequence[float] | None, weights: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (nm) and their shares: what is given, else those of the scene's first source, else 550 nm."""
    if wavelength_nm is None and weights is None:
        for emitter in scene.emitters():
            if hasattr(emitter, "wavelengths_nm"):
                return emitter.wavelengths_nm, emitter.weights
        return np.array([DEFAULT_NM]), np.ones(1)
    return spectrum(wavelength_nm, weights)


def spectrum(wavelength_nm: Any, weights: Any) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths and normalised weights of a call."""
    if wavelength_nm is None:
        raise MistrayError("weights are given without wavelength_nm; give one wavelength for each weight")
    wavelengths = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
    if not wavelengths.size:
        raise MistrayError("wavelength_nm is empty; give at least one")
    for wavelength in wavelengths:
        WAVELENGTH_NM.check("wavelength_nm", float(wavelength))
    if len(np.unique(wavelengths)) < len(wavelengths):
        raise MistrayError(f"wavelength_nm is {wavelength_nm}; give every wavelength once")
    shares = np.ones(len(wavelengths)) if weights is None else np.atleast_1d(np.asarray(weights, dtype=np.float64))
    if len(shares) != len(wavelengths):
        raise MistrayError(f"{len(shares)} weights for {len(wavelengths)} wavelengths; give one for each")
    for share in shares:
        WEIGHT.check("weights", float(share))
    if not shares.sum() > 0:
        raise MistrayError(f"weights are {weights}; give one above 0")
    return wavelengths, shares / shares.sum()

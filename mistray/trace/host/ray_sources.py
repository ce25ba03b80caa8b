"""Start points of rays that search for objects: at the detector, on a disc, or all around the scene.

Weights of rays from outside are areas, mm². For a source of 1 W/mm² (across the beam, averaged over its directions) a
ray of weight w in a sample of n rays carries w/n W. Rays from the detector have a mean weight of 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, CONE_DEG, FIELD_DEG, POINT_MM, SIZE_MM, check_fields
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.outlines import detector_area, outline
from mistray.sampling.plane_wave import PlaneWave, PlaneWaves, hull_points
from mistray.settings import BATCHES
from mistray.surfaces.host_points import across, surface_points
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.single_rays import StartPoints


class RaySource(Protocol):
    """Interface of sources of rays that search for objects in a scene."""

    @property
    def name(self) -> str:
        """Name of the ray source in tables."""

    def sample(self, n: int, rng: np.random.Generator) -> StartPoints:
        """
        Return the start points of n rays, mm, with unit directions and weights.

        For the unit of the weights see `mistray.trace.host.ray_sources`.
        """


@dataclass(frozen=True, eq=False)
class DetectorView:
    """
    Detector as a Lambertian source, on the side on which the light of the design arrives.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    light : (3,) float64
        Unit vector along which the light of the design travels to the detector.
    half_angle_deg : float
        Greatest angle between rays and the normal, degrees; 90 for a complete Lambertian source.
    name : str
        Name for tables.

    Raises
    ------
    MistrayError
        If `half_angle_deg` is out of range.
    """

    table: SurfaceTable
    light: np.ndarray
    half_angle_deg: float = 90.0
    name: str = "detector"

    def __post_init__(self) -> None:
        CONE_DEG.check("view_half_angle_deg", self.half_angle_deg)

    def sample(self, n: int, rng: np.random.Generator) -> StartPoints:
        """Return the start points of n rays on the detector, mm, with Lambertian directions and a mean weight of 1."""
        table, number = self.table, self.table.detector
        p, normal = surface_points(table, number, n, rng)
        outward = np.where((normal @ self.light > 0)[:, None], -normal, normal)
        weight = np.ones(n)
        if number < len(table.pieces):  # the points are uniform in the projection along the axis
            axis = table.rotations[number][:, 2]
            weight = outline(table.shapes[number]).area / self.area / np.abs(normal @ axis)
        d = lambertian(outward, self.half_angle_deg, 0.0, rng)
        return StartPoints(p, d, weight, number, normal, self._medium(bool(normal[0] @ self.light > 0)))

    def _medium(self, from_front: bool) -> int:
        """
        Return the index of the material on the front of the detector if `from_front`, else on its back.

        It is 0 if the material is unknown.
        """
        interface, media = self.table.interfaces[self.table.detector], self.table.optics.media
        material = (interface.front if from_front else interface.back).strip()
        return media.index(material) if material in media else 0

    @property
    def area(self) -> float:
        """Area of the detector, mm²."""
        return detector_area(self.table)

    @property
    def share(self) -> float:
        """Share of a complete Lambertian source's flux that leaves within `half_angle_deg`, 0 … 1."""
        return float(np.sin(np.radians(self.half_angle_deg)) ** 2)


@dataclass(frozen=True, eq=False)
class DiskSource:
    """
    Flat disc that emits by the cosine law within a limited cone.

    Attributes
    ----------
    centre : (3,) float
        Centre of the disc, mm.
    radius : float
        Radius of the disc, mm.
    half_angle_deg : float
        Greatest angle between rays and the axis, degrees; the density per solid angle is proportional to cos θ.
    inner_radius : float
        Radius of a hole in the disc, mm.
    inner_half_angle_deg : float
        Half angle of a hole in the cone, degrees.
    axis : (3,) float
        Direction of the cone's axis, the normal of the disc, of any length; light travels along it.
    name : str
        Name for tables.

    Raises
    ------
    MistrayError
        If a value is out of range, a hole is not smaller than the disc or cone, or `axis` is 0.

    Examples
    --------
    >>> lamp = mistray.analysis.DiskSource(centre=(0, 0, -50), radius=15, half_angle_deg=20)
    >>> found = mistray.objects(mistray.load("cooke_triplet"), rays=2000, source=lamp)
    >>> [lit.id for lit in found.illuminated[:2]]
    ['barrel_face', 'barrel_1_wall']
    """

    centre: tuple[float, float, float] = POINT_MM.field()
    radius: float = SIZE_MM.field()
    half_angle_deg: float = CONE_DEG.field()
    inner_radius: float = 0.0
    inner_half_angle_deg: float = 0.0
    axis: tuple[float, float, float] = POINT_MM.field((0.0, 0.0, 1.0))
    name: str = "disc"

    def __post_init__(self) -> None:
        check_fields(self, "source")
        if not np.linalg.norm(self.axis) > 0:
            raise MistrayError("source: axis is 0, 0, 0; give the direction of the light")
        if not 0 <= self.inner_radius < self.radius:
            raise MistrayError(
                f"source: inner_radius is {self.inner_radius:g} mm; it must lie between 0 and radius = "
                f"{self.radius:g} mm"
            )
        if not 0 <= self.inner_half_angle_deg < self.half_angle_deg:
            raise MistrayError(
                f"source: inner_half_angle_deg is {self.inner_half_angle_deg:g}; it must lie between 0 and "
                f"half_angle_deg = {self.half_angle_deg:g}"
            )

    def sample(self, n: int, rng: np.random.Generator) -> StartPoints:
        """Return the start points of n rays, uniform over the disc, mm, with Lambertian directions; weights in mm²."""
        axis = np.asarray(self.axis, dtype=np.float64) / np.linalg.norm(self.axis)
        r = np.sqrt(self.inner_radius**2 + (self.radius**2 - self.inner_radius**2) * even(n, rng))
        turn = 2 * np.pi * even(n, rng)
        o = self.centre + (r * np.stack([np.cos(turn), np.sin(turn)])).T @ across(axis).T
        d = lambertian(np.tile(axis, (n, 1)), self.half_angle_deg, self.inner_half_angle_deg, rng)
        # A beam of 1 W/mm² sends A cos θ through the disc; its mean over the solid angle of the cone
        low, high = np.cos(np.radians([self.half_angle_deg, self.inner_half_angle_deg]))
        area = np.pi * (self.radius**2 - self.inner_radius**2) * (high + low) / 2
        return StartPoints(o, d, np.full(n, area))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """
    Distant source of uniform radiance, in a cone or one direction, that illuminates the whole scene.

    A ray's direction is uniform in solid angle within the cone. Its position is uniform over a cross-section of the
    beam that covers the whole scene.

    Attributes
    ----------
    wave : PlaneWave
        Directions and cross-section of the beam.
    name : str
        Name for tables.
    """

    wave: PlaneWave
    name: str

    @classmethod
    def cone(cls, table: SurfaceTable, axes: np.ndarray, half_angle_deg: float) -> Surroundings:
        """
        Return a distant source within `half_angle_deg` of the axis of field angles; `axes` are from `field_axes`.

        An angle out of range raises `MistrayError`.
        """
        CONE_DEG.check("half_angle_deg", half_angle_deg)
        grid = _one_cell(0.0, half_angle_deg, 0.0, 360.0, axes)
        return cls(
            PlaneWaves(hull_points(table), grid).at(0, 0),
            f"a distant source within {half_angle_deg:g}° of the axis",
        )

    @classmethod
    def direction(cls, table: SurfaceTable, axes: np.ndarray, field_deg: float, azimuth_deg: float) -> Surroundings:
        """
        Return a distant source at one field angle and azimuth, degrees; azimuth runs from +y to -x.

        A field angle below 0 lies on the opposite azimuth; `axes` are from `field_axes`. Raise `MistrayError` for an
        angle out of range.
        """
        FIELD_DEG.check("field_deg", field_deg)
        AZIMUTH_DEG.check("azimuth_deg", azimuth_deg)
        turned = azimuth_deg + 180 if field_deg < 0 else azimuth_deg
        grid = _one_cell(abs(field_deg), abs(field_deg), turned, 0.0, axes)
        return cls(
            PlaneWaves(hull_points(table), grid).at(0, 0),
            f"a distant source at {field_deg:g}°",
        )

    def sample(self, n: int, rng: np.random.Generator) -> StartPoints:
        """Return the start points of n rays, mm, with unit directions; each weight is the beam's cross-section, mm²."""
        wave = self.wave
        low, high = wave.half_sine2
        h = low + (high - low) * even(n, rng)
        cosine, sine = 1 - 2 * h, 2 * np.sqrt(h * (1 - h))
        azimuth = wave.azimuth[0] + wave.azimuth[1] * (2 * even(n, rng) - 1)
        x_axis, y_axis, z_axis = wave.rotation.T
        radial = np.outer(np.cos(azimuth), y_axis) - np.outer(np.sin(azimuth), x_axis)
        d = sine[:, None] * radial + np.outer(cosine, z_axis)
        u = np.outer(np.cos(azimuth), x_axis) + np.outer(np.sin(azimuth), y_axis)
        v = cosine[:, None] * radial - np.outer(sine, z_axis)
        x, y = 2 * np.array([even(n, rng), even(n, rng)]) - 1
        if wave.is_round:
            turn, r = np.pi * x, np.sqrt(0.5 * (1 + y))
            x, y = r * np.cos(turn), r * np.sin(turn)
        x, y = x * wave.half[0] + wave.middle[0], y * wave.half[1] + wave.middle[1]
        o = wave.centre + x[:, None] * u + y[:, None] * v - wave.distance * d
        return StartPoints(o, d, np.full(n, wave.area))


def _one_cell(low_deg: float, high_deg: float, azimuth_deg: float, width_deg: float, axes: np.ndarray) -> DirectionGrid:
    """
    Return a direction grid of one cell, from `low_deg` to `high_deg` in field angle, `width_deg` wide in azimuth.

    `azimuth_deg` is the middle of the cell, and `axes` are from `field_axes`. With equal limits and a width of 0 it is
    a single direction.
    """
    middle = np.array([0.5 * (low_deg + high_deg)])
    return DirectionGrid(middle, np.array([[low_deg, high_deg]]), np.array([azimuth_deg]), width_deg, axes)


def lambertian(
    normal: np.ndarray, half_angle_deg: float, inner_half_angle_deg: float, rng: np.random.Generator
) -> np.ndarray:
    """
    Return unit directions, (n, 3), of density ∝ cos θ per solid angle, one about each unit vector of `normal`, (n, 3).

    Their angles θ to it lie between the two half angles, degrees.
    """
    low, high = np.sin(np.radians([inner_half_angle_deg, half_angle_deg])) ** 2
    sine2 = low + (high - low) * even(len(normal), rng)
    return _around(normal, np.sqrt(1 - sine2), 2 * np.pi * even(len(normal), rng))


def even(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return stratified random numbers in 0 … 1, (n,): one in each equal part for every batch, in random order."""
    batches = [rng.permutation(len(part)) for part in np.array_split(np.arange(n), BATCHES) if len(part)]
    size = np.concatenate([np.full(len(batch), len(batch)) for batch in batches])
    return np.asarray((np.concatenate(batches) + rng.random(n)) / size)


def _around(axis: np.ndarray, cosine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Return unit vectors about unit vectors, (n, 3), from cosines of the polar angle and azimuths, rad, (n,)."""
    # T. Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017
    x, y, z = axis.T
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    u = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    v = np.stack([b, sign + y * y * a, -y], axis=1)
    sine = np.sqrt(np.maximum(0.0, 1 - cosine * cosine))
    return np.asarray(
        (sine * np.cos(azimuth))[:, None] * u + (sine * np.sin(azimuth))[:, None] * v + cosine[:, None] * axis
    )

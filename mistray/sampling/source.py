"""What a trace asks of a source of light: start rays of one wavelength, with a total flux."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.kernel.polarization import carried, from_plane
from mistray.sampling.aimed_cones import Cone, Sphere
from mistray.sampling.emission_laws import EDGE
from mistray.sampling.space_filling import stratified_points
from mistray.sampling.strata import Strata
from mistray.surfaces.upload import upload

NEAR = 20.0  # radii of the scene: rays that start farther away start anew at the scene, where float32 is fine enough
# Half of the rays go to the first aperture, a tenth of them to all of it where a part of it is lit, and half elsewhere.
# So neither light has more than twice the variance that it would have with all rays, and where a path takes both, the
# weights of the one are not far above those of the other. Of the rays elsewhere a fifth follow the law of the source,
# where the others are aimed at the scene.
OPTICS, UNLIT, BY_LAW = 0.5, 0.1, 0.2
LOOKS, LEAST_LIT = 256, 0.3  # directions to a target that are looked at, and how many of them must have light


class Emission(NamedTuple):
    """
    Rays as they leave a source.

    Attributes
    ----------
    o, d : mi.Vector3f
        Origins, mm, and unit directions.
    w : mi.Float or None
        Their flux in units of the mean of all; 1 where it is None.
    stokes : mi.Vector3f or None
        Their polarisation with respect to the axes of `mistray.kernel.polarization`; None: what `Source.stokes_along`
        says.
    """

    o: mi.Vector3f
    d: mi.Vector3f
    w: mi.Float | None = None
    stokes: mi.Vector3f | None = None


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
    shape : str
        Id of the shape that its rays start on, or "".
    medium : int
        Number of the material that they start in; 0: not known.
    moving : tuple of str
        Parameters of the source that a trace has derivatives by, see `motion`.
    """

    name: str
    wavelength_nm: float
    power: float
    pattern: str = "random"
    towards: str = ""
    shape: str = ""
    medium: int = 0
    moving: tuple[str, ...] = ()

    @abstractmethod
    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """
        The start rays of one pass.

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

    @property
    def polarized(self) -> bool:
        """Whether its light is polarised."""
        return False

    @property
    def stokes(self) -> tuple[float, float, float] | None:
        """The state of all its light, s1, s2, s3 in its own axes; None where there is no such state."""
        return None

    @property
    def pupil_power(self) -> float:
        """Flux that counts as launched where a result is relative to that, W."""
        return self.power

    def stokes_along(self, d: mi.Vector3f) -> mi.Vector3f | None:
        """The same for light along d with respect to the axes of `mistray.kernel.polarization`."""
        return None


@dataclass(frozen=True)
class SourceRequest:
    """
    What a trace asks of the plugin of a source, whose ``sources`` answers with a `SceneSource` for each wavelength.

    Attributes
    ----------
    name : str
        For tables: its id, or a number.
    system : mi.Scene
        The scene.
    bounds : mi.ScalarBoundingBox3f
        Of all its shapes.
    field_deg, azimuth_deg : float or None
        Instead of the plugin's own.
    wavelengths_nm, weights : (n,) float64
        The shares of the flux add up to 1.
    """

    name: str
    system: mi.Scene
    bounds: mi.ScalarBoundingBox3f
    field_deg: float | None
    azimuth_deg: float | None
    wavelengths_nm: np.ndarray
    weights: np.ndarray

    @property
    def scene(self) -> Sphere:
        """Holds all shapes."""
        if not self.bounds.valid():
            raise MistrayError("the scene holds no shapes; add surfaces and a detector")
        low, high = (np.array(corner, dtype=np.float64) for corner in (self.bounds.min, self.bounds.max))
        return Sphere(0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


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
    aims : bool
        Whether `aimed_at` changes where its rays start.
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
    shape: str = ""
    aims: ClassVar[bool] = False

    @property
    def polarized(self) -> bool:
        """Whether the plugin says so."""
        return bool(getattr(self.emitter, "polarized", False))

    @property
    def pupil_power(self) -> float:
        """The part of its flux that the plugin states."""
        return self.power * float(getattr(self.emitter, "pupil_share", 1.0))

    @property
    def stokes(self) -> tuple[float, float, float] | None:
        """What the plugin states, see `mistray.physics.polarization.state`."""
        return getattr(self.emitter, "stokes", None)

    def stokes_along(self, d: mi.Vector3f) -> mi.Vector3f | None:
        """What the plugin states with respect to `u` and ``direction × u``, which are carried to d, see `carried`."""
        if self.stokes is None:
            return None
        u, axis = (mi.Vector3d(*(dr.opaque(mi.Float64, float(c)) for c in one)) for one in (self.u, self.direction))
        stokes, along = mi.Vector3d(*(dr.opaque(mi.Float64, s) for s in self.stokes)), mi.Vector3d(d)
        return mi.Vector3f(from_plane(stokes, along, carried(u, axis, along)))

    @property
    def towards(self) -> str:  # type: ignore[override]  # read-only
        """The direction of the middle ray."""
        return f"along ({', '.join(f'{c:.4g}' for c in self.direction)})"

    @property
    def middle(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The middle ray, where there is one: origin (mm) and direction, (1, 3) float64 each."""
        return self.pivot[None] - self.distance * self.direction, self.direction[None]

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Rays of the middle of the source through places (n,) along `u` and `v`, mm: (n, 3) float64 each.

        The places lie in the plane of the pivot; of an object plane in that of the origin of the source's frame.
        """
        o = self.pivot + x[:, None] * self.u + y[:, None] * self.v
        o = o - (self.distance + (o - self.pivot) @ self.direction)[:, None] * self.direction
        return o, np.tile(self.direction, (len(o), 1))

    @property
    def reach(self) -> float:
        """Radius about the middle ray that the light fills at the pivot, mm; inf where it has no edge there."""
        return float("inf")

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> SceneSource:
        """The same light, of which more rays go to an aperture, or to a part of it; of a beam only those that probe."""
        return self

    def unaimed(self) -> SceneSource:
        """The same light, all its rays by the law of the source."""
        return self

    @abstractmethod
    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Rays to what it is aimed at, for points of the unit square: origins and directions, (n, 3) float64 each."""

    def edges(self, count: int, within: float = EDGE) -> list[tuple[np.ndarray, np.ndarray]]:
        """
        The rays along the edge of its light, beyond which there is none: `count` for each closed line of them.

        Parameters
        ----------
        count : int
        within : float
            How far inside of the edge, as a share of the size of the beam.

        Returns
        -------
        list of ((n, 3), (n, 3)) float64
            Origins (mm) and directions in the world. Light that fades out, or fills the scene, has no edge.
        """
        return []


@dataclass(frozen=True, kw_only=True)
class EmittedRays(SceneSource):
    """
    A source whose plugin says where its rays start and go, see `mistray.plugins.emitters.light_source`.

    Attributes
    ----------
    scene : Sphere
        Holds all surfaces.
    aperture : Sphere or None
        Holds the first surface of the design path.
    lit : Sphere or None
        Holds the part of that surface through which light comes to the detector.
    aimed : bool
        Whether more rays go to the aperture and to the scene than the law of the source sends there.
    """

    scene: Sphere
    aperture: Sphere | None = None
    lit: Sphere | None = None
    aimed: bool = True

    @property
    def moving(self) -> tuple[str, ...]:  # type: ignore[override]  # read-only
        """Those of the plugin."""
        return tuple(self.emitter.differentiable)

    @property
    def aims(self) -> bool:  # type: ignore[override]  # read-only
        """Whether the plugin knows the density of its directions."""
        return hasattr(self.emitter, "density")

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> EmittedRays:
        """The same light with more of its rays on an aperture, or on a part of it."""
        return replace(self, aperture=aperture, lit=lit)

    def unaimed(self) -> EmittedRays:
        """The same light, all its rays by the law of the source."""
        return replace(self, aimed=False)

    @property
    def middle(self) -> None:
        """There is none: the light goes many ways."""

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays from the middle of an object, see `SceneSource.through`; raises `MistrayError` where there is none."""
        if not getattr(self.emitter, "in_object_plane", False):
            raise MistrayError(
                f"source '{self.name}': it is neither far away nor a point of an object plane, so that it has no "
                "pupil; put 'collimated' or 'point_source' in its place"
            )
        values = self.emitter.values
        o = self.pivot + values["x"] * self.u + values["y"] * self.v + values["z"] * self.direction
        d = self.emitter.matrix[:3, 3] + x[:, None] * self.u + y[:, None] * self.v - o
        return np.tile(o, (len(d), 1)), d / np.linalg.norm(d, axis=1, keepdims=True)

    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """The plugin's rays, see `Source.start`: those to the aperture and to the scene more often than the others."""
        targets, w = self._targets, None
        if targets:
            strata = Strata(batch, self._shares)
            sample = stratified_points(strata.group, rng)
        else:
            sample = stratified_points(batch, rng)
        place = mi.Point2d(rng.next_float32(), rng.next_float32()) if self.emitter.extended else mi.Point2d(0.5)
        o, d = self._rays(place, mi.Point2d(sample), rng)
        if targets:
            cones = [Cone(target, o) for target in targets]
            for number, cone in enumerate(cones):
                d = dr.select(strata.number == number, cone.directions(mi.Point2d(sample)), d)
            law = self._density(place, d)
            mixed = strata.parts[-1] * law
            zone = dr.zeros(mi.UInt32, dr.width(lane))
            for part, cone in zip(strata.parts, cones, strict=False):
                density = cone.density(d)
                mixed += part * density
                zone += dr.select(density > 0, 0, mi.UInt32(1))
            w = strata.closed(dr.select(law > 0, law / mixed, 0), zone, len(targets) + 1)
        o = self._near(o, d) - mi.Vector3d(*(dr.opaque(mi.Float64, float(c)) for c in centre))
        return Emission(mi.Vector3f(o), dr.normalize(mi.Vector3f(d)), w)

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Derivatives that the plugin knows, turned to the world."""
        axes = [mi.Vector3d(*axis.tolist()) for axis in self._axes]
        away = o - mi.Vector3d(*self.pivot.tolist())
        local = [mi.Vector3d(*(dr.dot(vector, axis) for axis in axes)) for vector in (away, d)]
        by_o, by_d = self.emitter.motion(name, *local)
        return turned(by_o, axes), turned(by_d, axes)

    def edges(self, count: int, within: float = EDGE) -> list[tuple[np.ndarray, np.ndarray]]:
        """Those that the plugin names."""
        points = self.emitter.edge_samples(count, within)
        if points is None:
            return []
        sample = mi.Point2d(*(upload(mi.Float64, v) for v in points))
        o, d = self._rays(mi.Point2d(0.5), sample, mi.PCG32(size=count))
        origins, directions = (np.array(vector, dtype=np.float64).T for vector in (self._near(o, d), d))
        return [(origins, directions / np.linalg.norm(directions, axis=1, keepdims=True))]

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Rays of the plugin for given points of the unit square; where it aims, those of its first target."""
        rng = mi.PCG32(size=dr.width(sample))
        place = mi.Point2d(rng.next_float32(), rng.next_float32()) if self.emitter.extended else mi.Point2d(0.5)
        o, d = self._rays(place, mi.Point2d(sample), rng)
        for target in self._targets[:1]:
            aimed = Cone(target, o).directions(mi.Point2d(sample))
            d = dr.select(self._density(place, aimed) > 0, aimed, d)
        origins, directions = (np.array(vector, dtype=np.float64).T for vector in (self._near(o, d), d))
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)

    @cached_property
    def _targets(self) -> list[Sphere]:
        """What is lit of the aperture, the aperture and the scene, those that the source is not in and shines at."""
        if not self.aims or not self.aimed:
            return []
        o, _ = self._rays(mi.Point2d(0.5), mi.Point2d(0.5), mi.PCG32(size=1))
        place = np.array(o, dtype=np.float64).ravel()
        found = [target for target in (self.lit, self.aperture, self.scene) if target is not None]
        outside = [target for target in found if not target.contains(place)]
        return [target for target in outside if (self._misses if target is self.scene else self._lights)(target)]

    @property
    def _shares(self) -> list[float]:
        """Shares of the rays: to the targets, and by the law of the source."""
        optics = [target for target in self._targets if target is not self.scene]
        to_optics = [OPTICS] if len(optics) == 1 else [OPTICS * (1 - UNLIT), OPTICS * UNLIT][: len(optics)]
        elsewhere = 1 - sum(to_optics)
        if len(optics) == len(self._targets):
            return [*to_optics, elsewhere]
        return [*to_optics, elsewhere * (1 - BY_LAW), elsewhere * BY_LAW]

    def _misses(self, target: Sphere) -> bool:
        """Whether the law of the source sends less than half of its light to a target."""
        sample = mi.Point2d(*(upload(mi.Float64, v) for v in np.random.default_rng(0).random((2, LOOKS))))
        o, d = self._rays(mi.Point2d(0.5), sample, mi.PCG32(size=LOOKS))
        return float(np.mean(np.array(Cone(target, o).density(d)) > 0)) < 0.5

    def _lights(self, target: Sphere) -> bool:
        """Whether the source sends light to most of a target: else many rays to it would carry none."""
        sample = mi.Point2d(*(upload(mi.Float64, v) for v in np.random.default_rng(0).random((2, LOOKS))))
        place = mi.Point2d(0.5)
        o, _ = self._rays(place, sample, mi.PCG32(size=LOOKS))
        d = Cone(target, o).directions(sample)
        return float(np.mean(np.array(self._density(place, d)) > 0)) > LEAST_LIT

    def _rays(self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Rays of the plugin in the world."""
        one, point = (mi.Float64, mi.Point2d) if self.emitter.precise else (mi.Float, mi.Point2f)
        o, d = self.emitter.rays_from(point(place), point(sample), rng, self._numbers(one))
        zero, axes = dr.zeros(mi.Vector3d, dr.width(sample)), self._device_axes
        pivot = mi.Vector3d(*(dr.opaque(mi.Float64, float(c)) for c in self.pivot))
        return zero + pivot + turned(mi.Vector3d(o), axes), zero + dr.normalize(turned(mi.Vector3d(d), axes))

    def _density(self, place: mi.Point2d, d: mi.Vector3d) -> mi.Float64:
        """Of the plugin's directions, 1/sr; d in the world."""
        one, point = (mi.Float64, mi.Point2d) if self.emitter.precise else (mi.Float, mi.Point2f)
        local = mi.Vector3d(*(dr.dot(d, axis) for axis in self._device_axes))
        return mi.Float64(self.emitter.density(point(place), local, self._numbers(one)))

    def _near(self, o: mi.Vector3d, d: mi.Vector3d) -> mi.Vector3d:
        """Rays from far away start anew on their way, near the scene: there float32 is fine enough."""
        middle = mi.Vector3d(*(dr.opaque(mi.Float64, float(c)) for c in self.scene.centre))
        radius = dr.opaque(mi.Float64, self.scene.radius)
        ahead = dr.dot(middle - o, d) - 1.01 * radius
        return dr.fma(dr.select(ahead > NEAR * radius, ahead, 0), d, o)

    def _numbers(self, one: Any) -> dict[str, Any]:
        """The plugin's own numbers, and what else it may need."""
        given = {**self.emitter.values, "wavelength_nm": self.wavelength_nm}
        return {name: dr.opaque(one, float(value)) for name, value in given.items()}

    @property
    def _device_axes(self) -> list[mi.Vector3d]:
        return [mi.Vector3d(*(dr.opaque(mi.Float64, float(c)) for c in axis)) for axis in self._axes]

    @property
    def _axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.u, self.v, self.direction


def turned(vector: Any, axes: list[Any]) -> Any:
    """From the axes of a source to the world."""
    return axes[0] * vector.x + axes[1] * vector.y + axes[2] * vector.z

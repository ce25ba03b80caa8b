"""
Sources of light as a trace uses them: start rays of one wavelength, with a total flux.

Rays of a near source are drawn from its law and from cones to its targets, and weighted by the balance heuristic
(E. Veach, Robust Monte Carlo methods for light transport simulation, 1997, section 9.2). The weight of a direction d is

    w = pdf_law(d)/Σ_i c_i pdf_i(d),

where c_i = n_i/n is the share of technique i in the rays (``strata.parts``) and pdf_i its density, see
`AimedCone.density`. The last technique is the law of the source itself. The others are uniform in a cone to a sphere
that holds what matters, seen from the origin of the ray: of density 1/(2π (1 - cos α)) for the half angle α, with
sin α = radius/distance.
"""

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
from mistray.sampling.emission_laws import EDGE, direction, polar
from mistray.sampling.strata import Strata, stratified_points
from mistray.surfaces.upload import download, opaque, upload

NEAR = 20.0  # radii of the scene: rays from farther away are moved to the scene, where float32 is fine enough
# Half of the rays go to the first aperture, and a tenth of these to all of it where only a part of it is lit. The other
# half goes elsewhere. So neither stratum has more than twice the variance that it would have with all rays, and where
# rays of both follow the same path, their weights do not differ much. Of the rays elsewhere a fifth follow the law of
# the source, if the others are aimed at the scene.
OPTICS, UNLIT, BY_LAW = 0.5, 0.1, 0.2
LOOKS, LEAST_LIT = 256, 0.3  # directions to a target that are tested, and the share of them that must have light


@dataclass(frozen=True, eq=False)
class Sphere:
    """Sphere at which start rays are aimed: centre in the world, (3,), and radius, both in mm."""

    centre: np.ndarray
    radius: float

    def contains(self, point: np.ndarray) -> bool:
        """True if a point, (3,), mm, lies within the sphere or on it."""
        return bool(np.linalg.norm(point - self.centre) <= self.radius)


class Emission(NamedTuple):
    """
    Start rays of a source: origins, directions, relative flux and polarisation.

    Attributes
    ----------
    o, d : mi.Vector3f
        Origins, mm, relative to the centre that `SceneSource.start` is given, and unit directions.
    w : mi.Float or None
        Flux of each ray in units of the mean of all; None: 1.
    stokes : mi.Vector3f or None
        Polarisation of each ray with respect to the axes of `mistray.kernel.polarization`; None: that of
        `SceneSource.stokes_along`.
    """

    o: mi.Vector3f
    d: mi.Vector3f
    w: mi.Float | None = None
    stokes: mi.Vector3f | None = None


@dataclass(frozen=True)
class SourceRequest:
    """
    Request from a trace to the plugin of a source, whose ``sources`` returns one `SceneSource` per wavelength.

    Attributes
    ----------
    name : str
        Name of the source in tables: its id, or a number.
    system : mi.Scene
        Mitsuba scene that is traced.
    bounds : mi.ScalarBoundingBox3f
        Bounding box of all shapes of the scene that light can meet, mm.
    field_deg, azimuth_deg : float or None
        Field angle and azimuth, degrees, that replace the plugin's own; None: the plugin's own are kept.
    wavelengths_nm, weights : (n,) float64
        Wavelengths, nm, and their fractions of the flux, which add up to 1.
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
        """Sphere around all shapes of the scene, mm; raises `MistrayError` if there are none."""
        if not self.bounds.valid():
            raise MistrayError("the scene holds no shapes; add surfaces and a detector")
        low, high = (np.array(corner, dtype=np.float64) for corner in (self.bounds.min, self.bounds.max))
        return Sphere(0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


@dataclass(frozen=True, kw_only=True)
class SceneSource(ABC):
    """
    Source of the start rays of a trace, at one field angle and wavelength and with a total flux.

    Attributes
    ----------
    emitter : mi.Emitter
        Plugin of the source.
    name : str
        Name in tables.
    wavelength_nm : float
        Wavelength in vacuum, nm.
    power : float
        Flux, W.
    pivot, direction, u, v : (3,) float64
        A point of the middle ray (mm), the ray's unit direction, and the axes across it.
    distance : float
        Distance from the pivot back to the start of the middle ray, mm.
    shape : str
        Id of the shape that the rays start on; "": they start in space.
    medium : int
        Position in `Optics.media` of the material that the rays start in; 0: not known.
    aims : bool
        Whether `aimed_at` changes the start rays.
    pattern : str
        Pattern of the start positions: "random", or "grid" for an even one.
    reach : float
        Radius about the middle ray that the light fills at the pivot, mm; inf: the light has no edge there.
    moving : tuple of str
        Parameters of the source by which a trace can be differentiated, see `motion`.
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
    medium: int = 0
    aims: ClassVar[bool] = False
    pattern: ClassVar[str] = "random"
    reach: ClassVar[float] = float("inf")
    moving: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """
        Return the start rays of one pass: origins, mm, unit directions, relative flux and polarisation.

        Parameters
        ----------
        lane : mi.UInt32
            Indices of the rays within the whole trace of `rays` rays, consecutive.
        batch : mi.UInt32
            Batch of each ray, ascending.
        rays : int
            Number of rays of the whole trace, as from `count`.
        rng : mi.PCG32
            One generator per lane.
        centre : (3,) float64
            Point that the origins are relative to, mm.
        """

    def count(self, rays: int) -> int:
        """Return the number of rays actually started when `rays` are requested, which is the same by default."""
        return rays

    def exact(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return start rays free of float32 rounding, as far as the source can compute them so; else as they are.

        They are given and returned as origins, mm, and unit directions, (n, 3) float64 each.
        """
        return o, d

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """
        Return derivatives of ray origins, mm, and unit directions with respect to the parameter `name` of `moving`.

        They are in the world, per unit of the parameter.
        """
        raise NotImplementedError

    @property
    def polarized(self) -> bool:
        """True if the plugin of the source emits polarised light."""
        return bool(getattr(self.emitter, "polarized", False))

    @property
    def pupil_power(self) -> float:
        """
        Flux of the source through the pupil that its plugin defines, W; all its flux if it defines none.

        Results relative to the launched light are divided by this flux.
        """
        return self.power * float(getattr(self.emitter, "pupil_share", 1.0))

    @property
    def stokes(self) -> tuple[float, float, float] | None:
        """Normalised Stokes vector (s1, s2, s3), see `mistray.physics.polarization.state`; None: unpolarised light."""
        return getattr(self.emitter, "stokes", None)

    def stokes_along(self, d: mi.Vector3f) -> mi.Vector3f | None:
        """Return the Stokes vector (s1, s2, s3) of light along d, in the axes of d, see `carried`; None without one."""
        if self.stokes is None:
            return None
        u, axis = (opaque(mi.Vector3d, one) for one in (self.u, self.direction))
        stokes, along = opaque(mi.Vector3d, self.stokes), mi.Vector3d(d)
        # Of full width: a part of the rays is taken from all of its components, or from none
        return dr.zeros(mi.Vector3f, dr.width(d)) + mi.Vector3f(from_plane(stokes, along, carried(u, axis, along)))

    @property
    def towards(self) -> str:
        """Phrase "along (x, y, z)" with the direction of the middle ray, for messages."""
        return f"along ({', '.join(f'{c:.4g}' for c in self.direction)})"

    @property
    def middle(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Middle ray of the source: origin, mm, and unit direction, (1, 3) float64 each; None: it has no such ray."""
        return self.pivot[None] - self.distance * self.direction, self.direction[None]

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return rays of a distant source through points (x, y), mm, along `u` and `v`, all parallel to the middle ray.

        These are origins, mm, and unit directions, (n, 3) float64 each. The points lie in the plane of the pivot.
        """
        # Back to the plane normal to the middle ray on which all rays start
        o = self.pivot + x[:, None] * self.u + y[:, None] * self.v
        o = o - (self.distance + (o - self.pivot) @ self.direction)[:, None] * self.direction
        return o, np.tile(self.direction, (len(o), 1))

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> SceneSource:
        """Return a copy that aims more rays at an aperture, or its part `lit`; by default the source itself."""
        return self

    def unaimed(self) -> SceneSource:
        """Return a copy whose rays are sampled by the law of emission alone; by default the source itself."""
        return self

    @abstractmethod
    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Return probe rays of points of the unit square: origins, mm, and unit directions, (n, 3) float64 each."""

    def edges(self, count: int, within: float = EDGE) -> list[tuple[np.ndarray, np.ndarray]]:
        """
        Return rays along the edge of the source's light, beyond which it is dark, `count` for each closed line.

        Parameters
        ----------
        count : int
            Number of rays of each line.
        within : float
            Distance of the rays inside the edge, as a fraction of the size of the beam.

        Returns
        -------
        list of ((n, 3), (n, 3)) float64
            Origins (mm) and unit directions in the world of each line. The list is empty for light that fades out, or
            fills the scene: it has no edge.
        """
        return []


@dataclass(frozen=True, kw_only=True)
class PluginRays(SceneSource):
    """
    Source whose plugin samples rays in the source's own frame.

    Attributes
    ----------
    scene : Sphere
        Sphere around all surfaces.
    aperture : Sphere or None
        Sphere around the first surface of the design path, at which more rays are aimed; None: at none.
    """

    scene: Sphere
    aperture: Sphere | None = None

    @property
    def moving(self) -> tuple[str, ...]:  # type: ignore[override]  # read-only
        """Names of the plugin's parameters by which a trace can be differentiated."""
        return tuple(self.emitter.differentiable)

    @property
    def _axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.u, self.v, self.direction

    @property
    def _device_axes(self) -> list[mi.Vector3d]:
        """Unit vectors of the source's x, y and z axes in the world, as device arrays."""
        return [opaque(mi.Vector3d, axis) for axis in self._axes]

    def _numbers(self, one: Any) -> dict[str, Any]:
        """Return the plugin's parameters and the wavelength (nm) by name, as opaque device numbers of type `one`."""
        # Opaque, so that another value compiles no other kernel
        given = {**self.emitter.values, "wavelength_nm": self.wavelength_nm}
        return {name: dr.opaque(one, float(value)) for name, value in given.items()}


@dataclass(frozen=True, kw_only=True)
class EmittedRays(PluginRays):
    """
    Source whose plugin samples both origins and directions, see `mistray.plugins.emitters.light_source`.

    Attributes
    ----------
    lit : Sphere or None
        Sphere around the part of the first aperture through which light reaches the detector; None: not known, or
        hardly smaller than the aperture.
    aimed : bool
        Whether more rays go to the aperture and to the scene than the law of the source sends there.
    """

    lit: Sphere | None = None
    aimed: bool = True

    @property
    def aims(self) -> bool:  # type: ignore[override]  # read-only
        """True if rays can be aimed at apertures, for which the plugin must provide the pdf of its directions."""
        return hasattr(self.emitter, "density")

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> EmittedRays:
        """Return a copy that aims more of its rays at an aperture, and at its lit part if that is given."""
        return replace(self, aperture=aperture, lit=lit)

    def unaimed(self) -> EmittedRays:
        """Return a copy whose rays are sampled by the source's own law of emission alone."""
        return replace(self, aimed=False)

    @property
    def middle(self) -> None:
        """Middle ray of the source: None, because its light has many directions."""

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return rays from the source's object point through points (x, y), mm, along `u` and `v`.

        The points lie in the plane of the origin of the source's frame. The rays are origins, mm, and unit directions,
        (n, 3) float64 each. Raise `MistrayError` if the source has no object point.
        """
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
        """
        Return the start rays of one pass, drawn from the emission law and towards targets, with MIS weights.

        Without targets all rays follow the law, and have no weights. See `SceneSource.start`.
        """
        # Points and directions by the law of the source
        targets, w, strata = self._targets, None, Strata(batch, self._shares)
        sample = stratified_points(strata.group, rng)
        place = mi.Point2d(rng.next_float32(), rng.next_float32()) if self.emitter.extended else mi.Point2d(0.5)
        o, d = self._rays(place, mi.Point2d(sample), rng)
        if targets:
            # Directions to the targets, in the strata of these
            cones = [AimedCone(target, o) for target in targets]
            for number, cone in enumerate(cones):
                d = dr.select(strata.number == number, cone.directions(mi.Point2d(sample)), d)
            # MIS weight: pdf_law/Σ c_i pdf_i over the law and the cones
            law = self._density(place, d)
            mixed = strata.parts[-1] * law
            zone = dr.zeros(mi.UInt32, dr.width(lane))
            for part, cone in zip(strata.parts, cones, strict=False):
                density = cone.density(d)
                mixed += part * density
                zone += dr.select(density > 0, 0, mi.UInt32(1))
            # The number of cones that miss the direction is its zone: 0 is within all of them
            w = strata.closed(dr.select(law > 0, law / mixed, 0), zone, len(targets) + 1)
        o = self._near(o, d) - opaque(mi.Vector3d, centre)
        return Emission(mi.Vector3f(o), dr.normalize(mi.Vector3f(d)), w)

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Return derivatives of rays with respect to the parameter `name` of the plugin, see `SceneSource.motion`."""
        axes = [mi.Vector3d(*axis.tolist()) for axis in self._axes]
        away = o - mi.Vector3d(*self.pivot.tolist())
        local = [mi.Vector3d(*(dr.dot(vector, axis) for axis in axes)) for vector in (away, d)]
        by_o, by_d = self.emitter.motion(name, *local)
        by_o, z = turned(by_o, axes), self.emitter.values.get("z")
        if name == "z" and z and getattr(self.emitter, "in_object_plane", False):
            # A field angle displaces the pivot in proportion to z
            by_o += mi.Vector3d(*((self.pivot - self.emitter.matrix[:3, 3]) / z).tolist())
        return by_o, turned(by_d, axes)

    def edges(self, count: int, within: float = EDGE) -> list[tuple[np.ndarray, np.ndarray]]:
        """
        Return rays along the edge that the plugin defines: origins, mm, and unit directions, (count, 3) each.

        The list has one such line, or is empty if the light has no edge. See `SceneSource.edges`.
        """
        points = self.emitter.edge_samples(count, within)
        if points is None:
            return []
        sample = mi.Point2d(*(upload(mi.Float64, v) for v in points))
        o, d = self._rays(mi.Point2d(0.5), sample, mi.PCG32(size=count))
        return [on_host(self._near(o, d), d)]

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """
        Return probe rays of points of the unit square: origins, mm, and unit directions, (n, 3) float64 each.

        They go to the first target, if there is one and the source sends light there; else they follow the emission
        law.
        """
        rng = mi.PCG32(size=dr.width(sample))
        place = mi.Point2d(rng.next_float32(), rng.next_float32()) if self.emitter.extended else mi.Point2d(0.5)
        o, d = self._rays(place, mi.Point2d(sample), rng)
        for target in self._targets[:1]:
            # Where the source sends no light to the target, probes keep to its law
            aimed = AimedCone(target, o).directions(mi.Point2d(sample))
            d = dr.select(self._density(place, aimed) > 0, aimed, d)
        return on_host(self._near(o, d), d)

    @cached_property
    def _targets(self) -> list[Sphere]:
        """
        Spheres at which rays are aimed: of lit part, aperture and scene, those that do not hold the source.

        Spheres at which aiming does not reduce noise are left out. The list is empty if nothing is to be aimed.
        """
        if not self.aims or not self.aimed:
            return []
        o, _ = self._rays(mi.Point2d(0.5), mi.Point2d(0.5), mi.PCG32(size=1))
        place = np.array(o, dtype=np.float64).ravel()
        found = [target for target in (self.lit, self.aperture, self.scene) if target is not None]
        # A cone to the whole scene pays only where the law of the source misses most of it
        return [target for target in found if not target.contains(place) and self._pays(target)]

    @property
    def _shares(self) -> list[float]:
        """Fractions of the rays aimed at each target, then of those sampled by the law of the source."""
        optics = [target for target in self._targets if target is not self.scene]
        to_optics = [OPTICS] if len(optics) == 1 else [OPTICS * (1 - UNLIT), OPTICS * UNLIT][: len(optics)]
        # Without the scene as a target, all others follow the law
        elsewhere = 1 - sum(to_optics)
        if len(optics) == len(self._targets):
            return [*to_optics, elsewhere]
        return [*to_optics, elsewhere * (1 - BY_LAW), elsewhere * BY_LAW]

    def _pays(self, target: Sphere) -> bool:
        """True if aiming at a target reduces noise: much of the target is lit, or most light would miss the scene."""
        # At the middle of the source, which is enough to decide by
        sample = mi.Point2d(*(upload(mi.Float64, v) for v in np.random.default_rng(0).random((2, LOOKS))))
        place = mi.Point2d(0.5)
        o, d = self._rays(place, sample, mi.PCG32(size=LOOKS))
        cone = AimedCone(target, o)
        if target is self.scene:
            return float(np.mean(np.array(cone.density(d)) > 0)) < 0.5
        return float(np.mean(np.array(self._density(place, cone.directions(sample))) > 0)) > LEAST_LIT

    def _rays(self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32) -> tuple[mi.Vector3d, mi.Vector3d]:
        """
        Return rays sampled by the plugin, in the world: origins, mm, and unit directions.

        `place` and `sample` are points of the unit square, for origin and direction.
        """
        # Plugins whose directions need it compute in float64
        one, point = (mi.Float64, mi.Point2d) if self.emitter.precise else (mi.Float, mi.Point2f)
        o, d = self.emitter.rays_from(point(place), point(sample), rng, self._numbers(one))
        zero, axes = dr.zeros(mi.Vector3d, dr.width(sample)), self._device_axes
        pivot = opaque(mi.Vector3d, self.pivot)
        return zero + pivot + turned(mi.Vector3d(o), axes), zero + dr.normalize(turned(mi.Vector3d(d), axes))

    def _density(self, place: mi.Point2d, d: mi.Vector3d) -> mi.Float64:
        """Return the pdf, 1/sr, with which the plugin samples world directions d, for the `place` of `_rays`."""
        one, point = (mi.Float64, mi.Point2d) if self.emitter.precise else (mi.Float, mi.Point2f)
        local = mi.Vector3d(*(dr.dot(d, axis) for axis in self._device_axes))
        return mi.Float64(self.emitter.density(point(place), local, self._numbers(one)))

    def _near(self, o: mi.Vector3d, d: mi.Vector3d) -> mi.Vector3d:
        """
        Return origins, mm, moved along their rays from far away to the scene, where float32 is precise enough.

        Those in a `medium`, which weakens the light on all of its way, stay.
        """
        if self.medium:
            return o
        middle = opaque(mi.Vector3d, self.scene.centre)
        radius = dr.opaque(mi.Float64, self.scene.radius)
        ahead = dr.dot(middle - o, d) - 1.01 * radius
        return dr.fma(dr.select(ahead > NEAR * radius, ahead, 0), d, o)


def on_host(o: mi.Vector3d, d: mi.Vector3d) -> tuple[np.ndarray, np.ndarray]:
    """Return ray origins, mm, and directions on the host, (n, 3) float64 each, with directions normalised again."""
    origins, directions = (download(vector) for vector in (o, d))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def turned(vector: Any, axes: list[Any]) -> Any:
    """Return a vector in the world frame from its components along the axes of a source."""
    return axes[0] * vector.x + axes[1] * vector.y + axes[2] * vector.z


class AimedCone:
    """
    Cone of directions from each point to a sphere; from points within the sphere, all directions.

    Parameters
    ----------
    target : Sphere
        Sphere that the directions go to.
    o : mi.Vector3d
        Points, mm.
    """

    def __init__(self, target: Sphere, o: mi.Vector3d) -> None:
        away = opaque(mi.Vector3d, target.centre) - o
        distance = dr.norm(away)
        self._axis = away / dr.maximum(distance, 1e-300)
        sine = dr.minimum(dr.opaque(mi.Float64, target.radius) / dr.maximum(distance, 1e-300), 1)
        within = distance <= dr.opaque(mi.Float64, target.radius)
        # 1 - cos of the half angle, exact for small ones
        self._height = dr.select(within, 2, sine * sine / (1 + dr.safe_sqrt(1 - sine * sine)))

    def directions(self, sample: mi.Point2d) -> mi.Vector3d:
        """Return unit directions within the cone, uniform in solid angle, for points of the unit square."""
        square, cosine, sine = polar(sample)
        local = direction(square * self._height, cosine, sine)
        u, v = across(self._axis)
        return local.x * u + local.y * v + local.z * self._axis

    def density(self, d: mi.Vector3d) -> mi.Float64:
        """Return the pdf, 1/sr, of directions d sampled uniformly in the cone; 0 outside."""
        # 1 - cos from the chord: exact in narrow cones
        apart = 0.5 * dr.squared_norm(d - self._axis)
        return dr.select(apart <= self._height * (1 + 1e-12), dr.rcp(2 * dr.pi * self._height), 0)


def across(axis: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
    """
    Return two unit vectors at right angles to a unit vector and to each other.

    T. Duff et al., "Building an orthonormal basis, revisited", J. Computer Graphics Techniques 6(1), 1-8 (2017).
    """
    # Without this sign the basis degenerates near axis.z = -1
    sign = dr.select(axis.z < 0, mi.Float64(-1), 1)
    a = -dr.rcp(sign + axis.z)
    b = axis.x * axis.y * a
    return (
        mi.Vector3d(1 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x),
        mi.Vector3d(b, sign + axis.y * axis.y * a, -axis.y),
    )

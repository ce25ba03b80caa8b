"""A scene as the kernel reads it at one wavelength, and the search for the next surface that each ray meets."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction
from mistray.kernel.light_vertices import LightVertices
from mistray.kernel.scattering import Scattering
from mistray.recorders.importance import BACK
from mistray.recorders.sampler import mixed_word
from mistray.recorders.start_rays import StartRays
from mistray.recorders.tallies import ESCAPED, MEDIUM
from mistray.settings import Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable

GRAZING = 0.01  # smallest cosine by which the offset from a Mitsuba surface is divided
MOST_RAYS, LEAST_PROBABILITY = 64, 1 / 8  # a weight window splits a hit into so many rays at most, or lets it survive


@dataclass(frozen=True)
class BranchProbabilities:
    """
    Probabilities that a hit scatters and that a reflection at a transparent surface is followed.

    A followed branch's throughput is divided by them.

    Attributes
    ----------
    scatter : mi.Float
        (surfaces,) probability that a hit scatters.
    reflection : mi.Float
        Probability that the reflection at a surface that transmits is followed.
    """

    scatter: mi.Float
    reflection: mi.Float


@dataclass(frozen=True)
class WeightWindows:
    """
    Weight windows of scattered rays (T. E. Booth, A sample problem for variance reduction in MCNP, 1985).

    A hit whose throughput is above the upper bound is split into several scattered rays, and one whose throughput is
    below the lower bound scatters by roulette. The mean of results stays the same.

    Attributes
    ----------
    inverse_upper, inverse_lower : mi.Float
        Inverse of the upper and lower bounds of throughput, in units of a start ray's flux, by
        `mistray.recorders.importance.window_row`.
    per_mm : mi.Float
        Places per mm along the z axis of the world and away from it.
    values : mi.Float or None
        Factor on the throughput before it is compared with the bounds, by the cell of the start ray, (c,); None: 1.
    """

    inverse_upper: mi.Float
    inverse_lower: mi.Float
    per_mm: mi.Float
    values: mi.Float | None = None

    def place(self, it: Interaction) -> mi.UInt32:
        """
        Return a word for the part of the scene along and away from the z axis that each hit lies in, and for its side.

        Parts of a long wall matter to different field angles.
        """
        along, away = (mi.UInt32(mi.Int32(dr.floor(v * self.per_mm))) for v in (it.p.z, dr.hypot(it.p.x, it.p.y)))
        word = mixed_word(along * 0x846CA68B + away * 0x9E3779B1)
        return (word << 1) | dr.select(it.from_front, mi.UInt32(0), BACK)

    def value(self, start: StartRays, weight: mi.Float, active: mi.Bool) -> mi.Float:
        """Return the throughput `weight` of rays times the factor of their start cells, as the windows compare it."""
        if self.values is None:
            return weight
        return weight * dr.gather(mi.Float, self.values, start.cell, active)

    def read(
        self, row: mi.UInt32, weight: mi.Float, known: tuple[mi.UInt32, mi.Float], active: mi.Bool
    ) -> tuple[mi.UInt32, mi.Float]:
        """
        Return the factor on a hit's number of scattered rays, and the probability that the hit scatters.

        The factor is `weight` over the upper bound, 1 … `MOST_RAYS`. The probability is `weight` over the lower bound,
        `LEAST_PROBABILITY` … 1. In lanes that are not active both are those in `known`. For `row` see
        `mistray.recorders.importance.window_row`.
        """
        above, below = (
            weight * dr.gather(mi.Float, inverse, row, active) for inverse in (self.inverse_upper, self.inverse_lower)
        )
        rays = mi.UInt32(dr.clip(dr.round(above), 1, MOST_RAYS))
        probability = dr.clip(below, LEAST_PROBABILITY, 1)
        return dr.select(active, rays, known[0]), dr.select(active, probability, known[1])


@dataclass(frozen=True)
class CompetingTrace:
    """
    Trace in the other direction that samples the same paths, for MIS weights; see `mistray.kernel.pdf_ratios`.

    Attributes
    ----------
    scattering : Scattering
        Scatter of the rays of that trace.
    probabilities : BranchProbabilities
        Probabilities with which its branches are followed.
    connects : bool
        Whether backward rays are connected to light vertices.
    """

    scattering: Scattering
    probabilities: BranchProbabilities
    connects: bool = False


@dataclass(frozen=True)
class KernelScene:
    """
    Scene as the kernel traces it at one wavelength: surfaces, scatter, branch probabilities and competing trace.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    scattering : Scattering
        Scatter of forward rays, or of backward ones.
    intersector : Intersector
        Search for the nearest hit of rays.
    probabilities : BranchProbabilities or None
        Probabilities with which branches are followed; None: all are.
    backward : bool
        Whether rays go from the detector to the sky: the detector is a surface like others then, and the share of a ray
        that a surface absorbs is the share that it emits towards the detector. Forward rays go from a source to the
        detector.
    competing : CompetingTrace or None
        Trace in the other direction that builds the same paths; None: all MIS weights are 1.
    vertices : LightVertices or None
        Light vertices that backward rays are connected to; None: no ray is connected.
    windows : WeightWindows or None
        Weight windows of scattered rays; None: all hits scatter as many rays as the settings say.
    closed : mi.Bool or None
        Mask of the media in which no ray can leave the scene, so that one which does is lost; None: there are none.
    """

    table: SurfaceTable
    scattering: Scattering
    intersector: Intersector
    probabilities: BranchProbabilities | None = None
    backward: bool = False
    competing: CompetingTrace | None = None
    vertices: LightVertices | None = None
    windows: WeightWindows | None = None
    closed: mi.Bool | None = None

    def way_out(self, medium: mi.UInt32, gone: mi.Bool) -> tuple[int | mi.UInt32, mi.Bool]:
        """
        Return the channel of the energy ledger for rays that meet no further surface, and a mask of those that leave.

        `gone` is a mask of such rays. In a medium where no ray can leave, the channel is MEDIUM, else ESCAPED.
        """
        if self.closed is None:
            return ESCAPED, gone
        lost = dr.gather(mi.Bool, self.closed, medium, gone)
        return dr.select(lost, mi.UInt32(MEDIUM), ESCAPED), gone & ~lost

    def scatters(self, settings: Settings) -> bool:
        """True if surfaces or media can scatter light in a trace with these settings."""
        return (self.scattering.any or self.table.optics.scatters) and settings.max_scatters > 0

    def draws(self, settings: Settings) -> bool:
        """True if a trace with these settings draws random numbers at the nodes of its trees."""
        roulette = settings.below_threshold == "roulette" or self.probabilities is not None
        one_child = settings.splitting == "one" or self.table.optics.one_child
        return roulette or one_child or self.scatters(settings)


def next_hit(
    table: SurfaceTable,
    intersector: Intersector,
    o: mi.Vector3f,
    d: mi.Vector3f,
    last: mi.UInt32,
    active: mi.Bool,
    normal: mi.Vector3f | None = None,
) -> tuple[mi.Float, mi.UInt32, mi.Vector3f]:
    """
    Return the nearest hit of each ray: distance in mm, surface index, and unit normal on a Mitsuba shape.

    Without a hit the distance is infinite and the index `NO_SURFACE`. The normal is from front to back; it has no
    meaning on analytic surfaces.
    `o` is in mm, relative to the centre of the scene, and `last` is the index of the surface that the ray starts on.
    `normal` is that of a Mitsuba shape there; None: rays start on none.
    """
    # Analytic surfaces first: they bound the ray for Mitsuba's tracer
    t, s = intersector.nearest(o, d, last, active)
    if table.mitsuba_scene is None:
        return t, s, mi.Vector3f(0)
    if table.free_space is not None:
        # Rays that stay in the space without Mitsuba shapes skip their tracer
        active = active & ~table.free_space.holds(o, d, t)
    skip = mi.Float(0)
    if normal is not None:  # offset from a Mitsuba surface by a few roundings, along the ray so that it stays the same
        slant = dr.maximum(dr.abs(dr.dot(normal, d)), GRAZING)
        on_mitsuba = (last >= len(table.pieces)) & (last != NO_SURFACE)
        skip = dr.select(on_mitsuba, dr.opaque(mi.Float, table.mitsuba_epsilon) / slant, 0)
    ray = mi.Ray3f(mi.Point3f(dr.fma(skip, d, o) + table.mitsuba_offset), d)
    ray.maxt = dr.select(dr.isfinite(t), t - skip, dr.largest(mi.Float))
    hit = table.mitsuba_scene.ray_intersect_preliminary(ray, coherent=False, active=active)
    nearer = active & hit.is_valid() & (hit.t + skip < t)
    si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, nearer)
    number = dr.gather(mi.UInt32, table.mitsuba_lookup, dr.reinterpret_array(mi.UInt32, si.shape), nearer)
    return dr.select(nearer, si.t + skip, t), dr.select(nearer, number, s), mi.Vector3f(si.n)


def film_coordinates(table: SurfaceTable, it: Interaction, s: mi.UInt32) -> tuple[mi.Float, mi.Float]:
    """Return the coordinates x and y, mm, of detector hits in the frame of the detector with the index `s`."""
    x, y = it.local.x, it.local.y
    for detector, (middle, right, up) in table.detector_axes.items():
        if detector in table.detectors:
            here = mi.Bool(True) if len(table.detectors) == 1 else s == detector
            x = dr.select(here, dr.dot(it.p - middle, right), x)
            y = dr.select(here, dr.dot(it.p - middle, up), y)
    return x, y

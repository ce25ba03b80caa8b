"""Scatter of light within media: scatter points along ray segments, and directions by phase function or target.

The place on a segment has the density of the flux that is scattered there. The direction is sampled either from the
phase function or towards a target of the side of the surface at which the segment ends. All rays of a segment together
are weighted by the balance heuristic, as in `mistray.kernel.scattering`: given the place, a ray in a direction carries

    f/(n_r f + n_a p)

of the flux that the segment scatters. Here f is the phase function and p the pdf of aimed rays, both in 1/sr, and n_r
and n_a are the numbers of rays of the two techniques. In the code these are `phase`, `density`, `random_rays` and
`aimed_rays`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.device_targets import DeviceTargets
from mistray.kernel.interaction import Interaction
from mistray.kernel.lobes import tangents
from mistray.kernel.targets import AimSet, Inside, Place
from mistray.physics.henyey_greenstein import phase_about, sampled_cosine
from mistray.recorders.sampler import DIRECTION, EVENT, TECHNIQUE, Sampler
from mistray.surfaces.optics import THIN
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload


@dataclass
class BulkAim:
    """
    Importance targets, per ray segment, of light that the medium scatters.

    Attributes
    ----------
    targets : mi.Vector2u
        Index of the first target and number of targets.
    rays : mi.UInt32
        Number of aimed rays of the segment; 0 where the segment has no targets.
    """

    targets: mi.Vector2u
    rays: mi.UInt32


class MediumRay(NamedTuple):
    """
    Sampling technique of a ray that a medium scatters on a segment: phase function or target.

    Attributes
    ----------
    aim : mi.Bool
        Whether the ray goes to a target.
    random_rays, aimed_rays : mi.Float
        Mean number of rays that the segment scatters by either technique.
    """

    aim: mi.Bool
    random_rays: mi.Float
    aimed_rays: mi.Float


class BulkScattering:
    """
    Scatter in the media of a scene at one wavelength.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    aims : mapping
        Targets by `Inside`; entries with other keys are ignored.
    """

    def __init__(self, table: SurfaceTable, aims: Mapping[Place, AimSet]) -> None:
        optics = table.optics
        rows = np.zeros((2 * len(optics.bsdfs), 4), dtype=np.uint32)
        sets, first = [], 0
        for place, aim in aims.items():
            if isinstance(place, Inside):
                # Row of a side: first target, number of targets, aimed rays
                rows[2 * place.surface + place.at_back, :3] = first, len(aim.targets), aim.rays
                sets.append(aim)
                first += len(aim.targets)
        self._optics, self._aimed = optics, bool(sets)
        self._rows, self._targets = upload(mi.UInt32, rows), DeviceTargets(sets, table.centre)

    def aim(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> BulkAim:
        """Return the targets, possibly none, of light that media scatter on ray segments that end at surfaces `s`."""
        if not self._aimed:
            return BulkAim(mi.Vector2u(0), mi.UInt32(0))
        side = 2 * s + dr.select(it.from_front, mi.UInt32(0), 1)
        row = dr.gather(mi.Vector4u, self._rows, side, active)
        return BulkAim(row.xy, row.z)

    def one_ray(self, aim: BulkAim, random_rays: mi.UInt32, u: mi.Float) -> MediumRay:
        """
        Return the sampling technique, phase function or target, of the only scattered ray of a segment.

        With targets, the random number u aims the ray with probability ½, or always if there is no random ray. Without
        targets it follows the phase function.
        """
        if not self._aimed:
            return MediumRay(mi.Bool(False), mi.Float(1), mi.Float(0))
        # Always aimed where `max_random_scatters` leaves no random ray
        aiming = dr.select(aim.rays > 0, dr.select(random_rays > 0, mi.Float(0.5), 1), 0)
        return MediumRay(u < aiming, 1 - aiming, aiming)

    def scatter(
        self,
        medium: mi.UInt32,
        p: mi.Vector3f,
        d: mi.Vector3f,
        length: mi.Float,
        aim: BulkAim,
        ray: MediumRay,
        sampler: Sampler,
        active: mi.Bool,
    ) -> tuple[mi.Float, mi.Vector3f, mi.Float]:
        """
        Return a random scatter point on each segment in a medium, mm, a unit direction, and the ray's throughput.

        Parameters
        ----------
        medium : mi.UInt32
            Position of the medium in `Optics.media`.
        p, d : mi.Vector3f
            End of the segment relative to `SurfaceTable.centre` (mm) and its unit direction.
        length : mi.Float
            Length of the segment, mm.
        aim : BulkAim
            Importance targets of the segments.
        ray : MediumRay
            Sampling technique of the rays.
        sampler : Sampler
            Random numbers of the rays.
        active : mi.Bool
            Lanes that take part.

        Returns
        -------
        away : mi.Float
            Distance from the end of the segment, mm; its density is proportional to exp(extinction · distance).
        direction : mi.Vector3f
            Unit direction of the scattered ray.
        share : mi.Float
            Flux of the ray over the flux that the segment scatters; 0 where neither technique can send the ray.
        """
        coefficient = dr.gather(mi.Float, self._optics.extinction, medium, active)
        g = dr.gather(mi.Float, self._optics.asymmetry, medium, active)
        (along, _), u, (choice, _) = (sampler.pair(number) for number in (EVENT, DIRECTION, TECHNIQUE))

        # Place: invert ∫ exp(μ x) dx, where x is the distance from the end; uniform in a thin medium. It is
        # ln(1 + u (e^τ - 1))/μ of the optical depth τ; where that is large it is taken out, for e^τ ends at τ = 88
        depth = coefficient * length
        scaled = dr.select(
            depth < 1,
            dr.log(dr.fma(along, dr.exp(depth) - 1, 1)),
            depth + dr.log(dr.fma(1 - along, dr.exp(-depth), along)),
        )
        away = dr.select(depth < THIN, along * length, scaled / dr.maximum(coefficient, 1e-30))
        away = dr.clip(away, 0, length)

        # Direction by the Henyey-Greenstein phase function about d
        cosine = sampled_cosine(u[0], g)
        sine = dr.sqrt(dr.maximum(dr.fma(-cosine, cosine, 1), 0))
        across, beside = tangents(d)
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * u[1])
        direction = dr.normalize(cosine * d + sine * (cos_phi * across + sin_phi * beside))
        if not self._aimed:
            return away, direction, mi.Float(1)

        # Direction towards a target. In a medium the specular direction is d
        origin = dr.fma(-away, d, p)
        here = active & (ray.aimed_rays > 0)
        to_target, own = self._targets.sample(aim.targets, choice, u, origin, d, here & ray.aim)
        direction = dr.select(here & ray.aim, to_target, direction)

        # MIS weight: f/(n_r f + n_a p)
        phase = phase_about(dr.squared_norm(direction - d), dr.squared_norm(direction + d), g)
        density = self._targets.density(aim.targets, origin, direction, d, ray.aim, own, here)
        share = phase / dr.fma(ray.random_rays, phase, dr.select(here, ray.aimed_rays * density, 0))
        # 0 instead of 0/0 where neither technique can send a ray
        return away, direction, dr.select(dr.isfinite(share), share, 0)

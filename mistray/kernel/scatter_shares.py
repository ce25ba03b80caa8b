"""
Scattering shares of a node: the fraction of flux that it scatters, and which of its scattered rays is drawn.

The shares come from tables of the total integrated scatter over the angle of incidence, see
`mistray.kernel.scatter_tables`. With the coating's x = R or T, an event keeps the share x (1 - a₀) in its specular beam
and scatters a₁ + a₂ x + a₃ x², with the columns a of the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction
from mistray.kernel.sample_axes import fraction_of, plane_of_sample
from mistray.kernel.scatter_tables import ANGLES, RANDOM_RAYS_SHIFT, ScatterTables
from mistray.surfaces.surfaces import SurfaceTable

# Flag of the word of a connected ray, which holds the number of its light vertex plus one: it has been there
CONNECTED = 1 << 31


class ScatterHit(NamedTuple):
    """
    Hits of surfaces that scatter: surface, interaction and direction of arrival.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    s : mi.UInt32
        Indices of the surfaces.
    interaction : Interaction
        Interaction at the hits.
    d : mi.Vector3f
        Unit direction of arrival.
    """

    table: SurfaceTable
    s: mi.UInt32
    interaction: Interaction
    d: mi.Vector3f


@dataclass
class Shares:
    """
    Specular and scattered fractions of the flux for one event at a node, transmission or reflection.

    Attributes
    ----------
    kept : mi.Float
        Fraction of the coating's R or T that stays in the specular beam.
    scattered : mi.Float
        Scattered fraction of the incident flux.
    slope : mi.Float
        Derivative of `scattered` with respect to R or T.
    """

    kept: mi.Float
    scattered: mi.Float
    slope: mi.Float


@dataclass
class ScatterBudget:
    """
    Fractions of the incident flux that a node scatters and absorbs, and numbers of scattered rays.

    Attributes
    ----------
    transmission, reflection : Shares
        Specular and scattered fractions for either event.
    scattered : mi.Float
        Scattered fraction of the incident flux, the sum of both events.
    absorbed : mi.Float
        Fraction of the incident flux that is neither reflected, transmitted nor scattered, for light that travels along
        the ray, also in a backward trace.
    first_case : mi.UInt32
        Index of the case of transmission in the tables; reflection has the next index.
    aimed_t, aimed_r : mi.UInt32
        Number of aimed rays in transmission and in reflection.
    random_rays : mi.UInt32
        Number of random rays that the surface requests; 0: as many as the settings say.
    """

    transmission: Shares
    reflection: Shares
    scattered: mi.Float
    absorbed: mi.Float
    first_case: mi.UInt32
    aimed_t: mi.UInt32
    aimed_r: mi.UInt32
    random_rays: mi.UInt32

    def ray(
        self, number: mi.UInt32, random_rays: mi.UInt32, u: mi.Float, connection: Connection | None = None
    ) -> ScatteredRay:
        """
        Return the event and the sampling technique of the scattered ray with index `number` of a node.

        The first `random_rays` are drawn at random, their event by the random number u. Then come the aimed ones of
        transmission and of reflection, and then those of `connection`, if there is one.
        """
        aim = number >= random_rays
        at_random = u * self.scattered >= self.transmission.scattered
        reflect = dr.select(aim, number >= random_rays + self.aimed_t, at_random)
        connects = mi.Bool(False)
        if connection is not None:
            connects = number >= random_rays + self.aimed_t + self.aimed_r
            aim &= ~connects
            reflect = dr.select(connects, connection.reflect, reflect)
        event_share = dr.select(reflect, self.reflection.scattered, self.transmission.scattered) / self.scattered
        aimed = mi.Float(dr.select(reflect, self.aimed_r, self.aimed_t))
        return ScatteredRay(reflect, aim, mi.Float(random_rays) * event_share, aimed, connects, connection)

    def one_ray(self, probability: mi.Float, random_rays: mi.UInt32, u: tuple[mi.Float, mi.Float]) -> ScatteredRay:
        """
        Return the event and sampling technique of a node's only scattered ray, sent with `probability`.

        Two random numbers u choose them. Where its event has targets, the ray is aimed with probability ½, or always if
        `random_rays` is 0. Without targets and without random rays it has no weight.
        """
        reflect = u[0] * self.scattered >= self.transmission.scattered
        event_share = dr.select(reflect, self.reflection.scattered, self.transmission.scattered) / self.scattered
        aimed = dr.select(reflect, self.aimed_r, self.aimed_t) > 0
        aiming = dr.select(aimed, dr.select(random_rays > 0, mi.Float(0.5), 1), 0)
        aim = u[1] < aiming
        probability = probability * event_share
        at_random = dr.select(random_rays > 0, 1 - aiming, 0)
        return ScatteredRay(reflect, aim, probability * at_random, probability * aiming, mi.Bool(False))


@dataclass
class Turn:
    """
    Azimuth of an anisotropic sample, such as brushed metal, relative to the plane of incidence.

    Attributes
    ----------
    rotation : mi.Float
        Azimuth of the x axis of the sample, in turns, see `plane_of_sample`.
    count : mi.UInt32
        Number of rotations in the totals of a case; 1 where they make no difference.
    """

    rotation: mi.Float
    count: mi.UInt32


@dataclass
class Connection:
    """
    Connection of a scattered backward ray to a light vertex.

    Attributes
    ----------
    direction : mi.Vector3f
        Unit direction of the ray: to the light vertex, or at that vertex back along its incident light.
    reflect : mi.Bool
        Whether the ray stays on the side of incidence.
    factor : mi.Float
        Factor on its throughput, from `LightVertices.pick`; 1 at the light vertex.
    word : mi.UInt32
        Index of the vertex plus one; with the flag `CONNECTED` once the ray has been there.
    """

    direction: mi.Vector3f
    reflect: mi.Bool
    factor: mi.Float
    word: mi.UInt32


@dataclass
class ScatteredRay:
    """
    Scattered ray to be drawn at a node: event, sampling technique, and mean number of rays by either technique.

    Attributes
    ----------
    reflect : mi.Bool
        Whether the ray stays on the side of incidence.
    aim : mi.Bool
        Whether the ray is aimed at a target.
    random_rays, aimed_rays : mi.Float
        Mean number of rays that the node sends in this event by either technique.
    connects : mi.Bool
        Whether the ray is connected to a light vertex.
    connection : Connection or None
        Connection of the rays in `connects`; None: no ray is connected.
    """

    reflect: mi.Bool
    aim: mi.Bool
    random_rays: mi.Float
    aimed_rays: mi.Float
    connects: mi.Bool
    connection: Connection | None = None


class ScatterPdfs(NamedTuple):
    """
    Densities of a scattered direction, for MIS weights.

    Attributes
    ----------
    pdf_ratio : mi.Float
        Pdf of the competing trace over that of this trace, per étendue; 1 where no trace competes.
    pdf_rev : mi.Float
        Backward rays per sr that a hit sends in this direction, one at random and all that are aimed; 0 where no trace
        competes.
    light_vertex : mi.UInt32
        Index of the light vertex plus one, see `CONNECTED`; 0 for rays that are not connected.
    """

    pdf_ratio: mi.Float = 1.0
    pdf_rev: mi.Float = 0.0
    light_vertex: mi.UInt32 = 0


class ScatterShares:
    """
    Fractions of the incident flux that surfaces scatter and absorb at one wavelength.

    Parameters
    ----------
    tables : ScatterTables
        Tables of the scatter of all surfaces.
    """

    def __init__(self, tables: ScatterTables) -> None:
        self.tables = tables
        self.any, self.bulk = tables.any, tables.bulk

    def budget(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> ScatterBudget:
        """Return the fractions of flux that hits of surfaces s scatter and absorb, and numbers of scattered rays."""
        # Row of the side: first rows of its totals in transmission and reflection, and its numbers of aimed rays
        side = 2 * s + dr.select(it.from_front, mi.UInt32(0), 1)
        plan = dr.gather(mi.Vector4u, self.tables.sides, side, active)

        # Shares of either event, for the light that rays stand for
        rarer = dr.minimum(it.cos_i, it.cos_t)
        turns = self._turns(it.reflected, it.axis, self._x_axis(s, it, active), side, active)
        transmission = self._shares(plan.x, rarer, self._transmittance(it), active, turns["transmission"])
        reflection = self._shares(plan.y, it.cos_i, it.R, active, turns["reflection"])

        # Absorption is that of light along the ray, whose shares differ where rays go backward
        along, back = transmission, reflection
        if self.tables.backward:
            row = dr.gather(mi.UInt32, self.tables.transmission_rows, side, active)
            along = self._shares(row, rarer, it.T, active, turns["along"])
            if turns["back"] is not None:
                back = self._shares(plan.y, it.cos_i, it.R, active, turns["back"])
        absorbed = 1 - it.R * back.kept - it.T * along.kept - back.scattered - along.scattered

        # Numbers of rays
        aimed_t = dr.select(transmission.scattered > 0, plan.z & ((1 << RANDOM_RAYS_SHIFT) - 1), 0)
        aimed_r = dr.select(reflection.scattered > 0, plan.w, 0)
        scattered = transmission.scattered + reflection.scattered
        random_rays = plan.z >> RANDOM_RAYS_SHIFT
        return ScatterBudget(transmission, reflection, scattered, absorbed, 2 * side, aimed_t, aimed_r, random_rays)

    def _transmittance(self, it: Interaction) -> mi.Float:
        """Return T of the coating, but 1 for backward rays in total reflection, where light can still scatter in."""
        return dr.select(it.tir, 1, it.T) if self.tables.backward else it.T

    def _x_axis(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> mi.Vector3f | None:
        """
        Return the sample's x axis at each hit, a unit vector in the scene's frame.

        The result is None if all samples are isotropic.
        """
        if self.tables.frames is None:
            return None
        return self.tables.frames.at(s, dr.select(it.from_front, it.axis, -it.axis), it.local, active)

    def _turns(
        self, heading: mi.Vector3f, axis: mi.Vector3f, x_axis: mi.Vector3f | None, side: mi.UInt32, active: mi.Bool
    ) -> dict[str, Turn | None]:
        """
        Return the azimuths of the sample from the plane of incidence, by light and event; None for isotropic samples.

        "transmission" and "reflection" are for the light of the path, which goes against the ray in a backward trace;
        "along" and "back" are for light that goes along the ray.

        Parameters
        ----------
        heading : mi.Vector3f
            Direction of a ray before or after its reflection.
        axis : mi.Vector3f
            Normal on the side that the ray goes to.
        x_axis : mi.Vector3f or None
            The x axis of the sample, a unit vector; None: all samples are isotropic.
        side : mi.UInt32
            Index of the surface's side: 2 s for the front of surface s, 2 s + 1 for its back.
        active : mi.Bool
            Lanes that take part.
        """
        if x_axis is None:
            return dict.fromkeys(("transmission", "reflection", "along", "back"))
        _, _, along = plane_of_sample(heading - dr.dot(heading, axis) * axis, -axis, x_axis)
        counts = dr.gather(mi.Vector4u, self.tables.turns, side, active)
        # The light of a backward ray comes from where that is reflected or refracted to: the axis seen from there
        backward = self.tables.backward
        return {
            "transmission": Turn(0.5 - along if backward else along, counts.x),
            "reflection": Turn(along + 0.5 if backward else along, counts.y),
            "along": Turn(along, counts.z),
            "back": Turn(along, counts.y),
        }

    def _shares(
        self, first: mi.UInt32, cosine: mi.Float, x: mi.Float, active: mi.Bool, turn: Turn | None = None
    ) -> Shares:
        """
        Return the specular and scattered fractions of the incident flux at a cosine of incidence.

        The case's table starts at row `first`, which is 0 for a case without scatter. `x` is R or T, `turn` the azimuth
        of an anisotropic sample.
        """
        # Totals are linear in the cosine between nodes
        here = active & (first != 0)
        place = dr.select(here, cosine * ANGLES, 0)
        node = dr.minimum(mi.UInt32(place), ANGLES - 1)

        def at(start: mi.UInt32) -> mi.Vector4f:
            low, high = (self.tables.total(start + node + k, here) for k in range(2))
            return dr.lerp(low, high, place - mi.Float(node))

        # And in the azimuth of an anisotropic sample
        if turn is None:
            row = at(first)
        else:
            block = fraction_of(turn.rotation) * mi.Float(turn.count - 1)
            before = dr.minimum(mi.UInt32(block), dr.maximum(turn.count, 2) - 2)
            after = dr.minimum(before + 1, turn.count - 1)
            low, high = (at(first + number * (ANGLES + 1)) for number in (before, after))
            row = dr.lerp(low, high, block - mi.Float(before))
        # A share of the specular beam, a constant, and parts that go with R or T and its square
        scattered = dr.fma(x, dr.fma(x, row.w, row.z), row.y)
        return Shares(
            1 - dr.select(here, dr.minimum(row.x, 1), 0),
            dr.select(here, scattered, 0),
            dr.select(here, dr.fma(2 * x, row.w, row.z), 0),
        )

"""What scatter takes from the light of a node and gives to it, and which of its rays is to be drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

# Rays that are connected to light remember the number of its point, plus one, and whether they have been there
JOINED = 1 << 31


@dataclass
class Shares:
    """
    What scatter takes and gives at a node, for one event.

    Attributes
    ----------
    kept : mi.Float
        Share of the coating's R or T that stays in the specular beam.
    scattered : mi.Float
        Scattered share of the incident flux.
    slope : mi.Float
        Derivative of `scattered` by R or T.
    """

    kept: mi.Float
    scattered: mi.Float
    slope: mi.Float


@dataclass
class ScatterBudget:
    """
    What scatter makes of the light of a node.

    Attributes
    ----------
    transmission, reflection : Shares
    scattered : mi.Float
        Both together.
    absorbed : mi.Float
        Share of the light that neither event takes; of light along the ray, also in a backward trace.
    first_case : mi.UInt32
        That of transmission; reflection is the next.
    aimed_t, aimed_r : mi.UInt32
        Aimed rays of either.
    random_rays : mi.UInt32
        Random rays that the surface asks for; 0 for those of the settings.
    """

    transmission: Shares
    reflection: Shares
    scattered: mi.Float
    absorbed: mi.Float
    first_case: mi.UInt32
    aimed_t: mi.UInt32
    aimed_r: mi.UInt32
    random_rays: mi.UInt32

    def ray(self, number: mi.UInt32, random_rays: mi.UInt32, rng: mi.PCG32, joint: Joint | None = None) -> ScatteredRay:
        """
        The scattered ray of this number: first those at random, then the aimed ones of either event.

        With `joint` the rays behind those go to where it says.
        """
        aim = number >= random_rays
        at_random = rng.next_float32() * self.scattered >= self.transmission.scattered
        reflect = dr.select(aim, number >= random_rays + self.aimed_t, at_random)
        joins = mi.Bool(False)
        if joint is not None:
            joins = number >= random_rays + self.aimed_t + self.aimed_r
            aim &= ~joins
            reflect = dr.select(joins, joint.reflect, reflect)
        event_share = dr.select(reflect, self.reflection.scattered, self.transmission.scattered) / self.scattered
        aimed = mi.Float(dr.select(reflect, self.aimed_r, self.aimed_t))
        return ScatteredRay(reflect, aim, mi.Float(random_rays) * event_share, aimed, joins, joint)

    def one_ray(self, probability: mi.Float, random_rays: mi.UInt32, rng: mi.PCG32) -> ScatteredRay:
        """
        One ray for all, where the node scatters with this probability; it is aimed half of the time if it can be.

        Without random rays it has no weight in an event that has no target.
        """
        reflect = rng.next_float32() * self.scattered >= self.transmission.scattered
        event_share = dr.select(reflect, self.reflection.scattered, self.transmission.scattered) / self.scattered
        aimed = dr.select(reflect, self.aimed_r, self.aimed_t) > 0
        aiming = dr.select(aimed, dr.select(random_rays > 0, mi.Float(0.5), 1), 0)
        aim = rng.next_float32() < aiming
        probability = probability * event_share
        at_random = dr.select(random_rays > 0, 1 - aiming, 0)
        return ScatteredRay(reflect, aim, probability * at_random, probability * aiming, mi.Bool(False))


@dataclass
class Turn:
    """
    How a sample lies to the plane of incidence.

    Attributes
    ----------
    rotation : mi.Float
        Azimuth of its x axis, in turns, see `plane_of_sample`.
    count : mi.UInt32
        Rotations in the totals of a case; 1 where they make no difference.
    """

    rotation: mi.Float
    count: mi.UInt32


@dataclass
class Joint:
    """
    Where a ray that is connected to light goes.

    Attributes
    ----------
    direction : mi.Vector3f
    reflect : mi.Bool
        Whether that is on the side of incidence.
    factor : mi.Float
        By which the ray is stronger.
    word : mi.UInt32
        What the ray remembers, see `JOINED`.
    """

    direction: mi.Vector3f
    reflect: mi.Bool
    factor: mi.Float
    word: mi.UInt32


@dataclass
class ScatteredRay:
    """
    Which of the scattered rays of a node is to be drawn.

    Attributes
    ----------
    reflect : mi.Bool
        On the side of incidence.
    aim : mi.Bool
        Towards a target.
    random_rays, aimed_rays : mi.Float
        How many rays of either technique the node sends in this event on average.
    joins : mi.Bool
        Whether it is connected to light.
    joint : Joint or None
        Where it goes then; None: no ray is connected.
    """

    reflect: mi.Bool
    aim: mi.Bool
    random_rays: mi.Float
    aimed_rays: mi.Float
    joins: mi.Bool
    joint: Joint | None = None


class Rivalry(NamedTuple):
    """
    What a scattered ray knows of rays of the other direction.

    Attributes
    ----------
    odds : mi.Float
        How many of them go this way for one of this direction, per étendue; 1 without them.
    against : mi.Float
        Rays per sr that go this way against the light, one at random and all that are aimed.
    joint : mi.UInt32
        See `JOINED`; 0 of rays that are not connected.
    """

    odds: mi.Float = 1.0
    against: mi.Float = 0.0
    joint: mi.UInt32 = 0

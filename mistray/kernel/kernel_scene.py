"""A scene as the kernel sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from mistray.kernel.scattering import Scattering
from mistray.settings import Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable

MOST_RAYS, LEAST_CHANCE = 64, 1 / 8  # of a hit, by its weight window


@dataclass(frozen=True)
class BranchProbabilities:
    """
    Probabilities with which rays branch; branches carry so much more, and results stay the same.

    Attributes
    ----------
    scatter : mi.Float
        (surfaces,) that a hit scatters.
    reflection : mi.Float
        That the reflection at a surface that transmits is followed.
    """

    scatter: mi.Float
    reflection: mi.Float


@dataclass(frozen=True)
class WeightWindows:
    """
    How many rays are scattered where, by surface and the way there; results stay the same.

    Attributes
    ----------
    many, few : mi.Float
        Rays at random for a weight of 1, in rows of `worth_row`: a hit that has more than one by `many` is split into
        so many, and one that has less by `few` scatters with that chance.
    """

    many: mi.Float
    few: mi.Float

    def split(self, row: mi.UInt32, weight: mi.Float, active: mi.Bool) -> mi.UInt32:
        """Rays that a hit is split into."""
        rays = weight * dr.gather(mi.Float, self.many, row, active)
        return mi.UInt32(dr.clip(dr.round(rays), 1, MOST_RAYS))

    def chance(self, row: mi.UInt32, weight: mi.Float, active: mi.Bool) -> mi.Float:
        """Probability that a hit scatters."""
        rays = weight * dr.gather(mi.Float, self.few, row, active)
        return dr.clip(rays, LEAST_CHANCE, 1)


@dataclass(frozen=True)
class Opposite:
    """
    A trace in the other direction, that rays are weighed against.

    Attributes
    ----------
    scattering : Scattering
    probabilities : BranchProbabilities
    connects : bool
        Whether rays against the light are connected to rays with it, see `Connections`.
    """

    scattering: Scattering
    probabilities: BranchProbabilities
    connects: bool = False


class Connections(Protocol):
    """Points where light arrives, to which scattered rays against the light are sent: ends of rays with it."""

    def pick(self, batch: mi.UInt32, u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """Numbers of points for random numbers 0 … 1, and by what a ray to one of them is stronger; 0 of none."""

    def point(self, number: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
        """Place of points."""

    def heading(self, number: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
        """Unit direction in which the light arrives there."""

    def meets(self, number: mi.UInt32, s: mi.UInt32, p: mi.Vector3f, active: mi.Bool) -> mi.Bool:
        """Whether rays that meet the surfaces s at p have come to the points."""


@dataclass(frozen=True)
class KernelScene:
    """
    A scene as the kernel sees it, at one wavelength.

    Attributes
    ----------
    table : SurfaceTable
    scattering : Scattering
        For rays along the light, or of a backward trace.
    intersector : Intersector
    probabilities : BranchProbabilities or None
        None: all branches are followed.
    backward : bool
        Whether rays go from the detector to the sky: the detector is a surface like others then, and what a surface
        absorbs of a ray is what it emits towards the detector. Else they follow the light.
    opposite : Opposite or None
        The trace in the other direction, where rays are weighed against those of such a trace, see
        `mistray.kernel.odds`; None: they are not.
    connections : Connections or None
        What rays of a backward trace are connected to.
    windows : WeightWindows or None
        None: all hits scatter as many rays as the settings say.
    """

    table: SurfaceTable
    scattering: Scattering
    intersector: Intersector
    probabilities: BranchProbabilities | None = None
    backward: bool = False
    opposite: Opposite | None = None
    connections: Connections | None = None
    windows: WeightWindows | None = None

    def scatters(self, settings: Settings) -> bool:
        """Whether anything scatters in a trace with these settings."""
        return (self.scattering.any or self.table.optics.scatters) and settings.max_scatters > 0

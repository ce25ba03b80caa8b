"""A scene as the kernel sees it."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from mistray.kernel.scattering import Scattering
from mistray.settings import Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable


@dataclass(frozen=True)
class BranchProbabilities:
    """
    Probabilities with which rays of a backward trace branch; branches carry so much more, and results stay the same.

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
        Of a backward trace, from the detector to the sky: the detector is a surface like others then, and what a
        surface absorbs of a ray is what it emits towards the detector. None: rays follow the light.
    """

    table: SurfaceTable
    scattering: Scattering
    intersector: Intersector
    probabilities: BranchProbabilities | None = None

    @property
    def backward(self) -> bool:
        """Whether rays go from the detector to the sky."""
        return self.probabilities is not None

    def scatters(self, settings: Settings) -> bool:
        """Whether anything scatters in a trace with these settings."""
        return (self.scattering.any or self.table.optics.scatters) and settings.max_scatters > 0

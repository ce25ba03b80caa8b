"""Probability that scattered light hits a small detector unaided: the reason why rays are aimed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import CHANCE, FIELD_DEG, SOLID_ANGLE_SR
from mistray.scatter.evaluate import bsdf
from mistray.scatter.lobe import LobeModel
from mistray.scatter.scan import IncidentLight


@dataclass(frozen=True)
class Chance:
    """
    Probability that a ray is scattered into a small solid angle without being aimed.

    Attributes
    ----------
    of_scatter : float
        Probability for a ray that meets the surface, BSDF · cos θs · ΔΩ.
    before : float
        Probability that a ray from the source gets to the surface.
    """

    of_scatter: float
    before: float = 1.0

    @property
    def total(self) -> float:
        """Probability that a ray from the source is scattered into the small solid angle without aiming."""
        return self.before * self.of_scatter

    @property
    def rays_for_one_hit(self) -> float:
        """
        Number of start rays that give one hit on average; infinite if a hit has no chance.

        So many rays give at least one hit with 63 % probability.
        """
        return 1 / self.total if self.total > 0 else math.inf

    def rays_for(self, confidence: float) -> float:
        """
        Return the number of rays for at least one hit with a given probability, ln(1 - confidence)/ln(1 - p).

        p is `total`. The result is 1 if p is 1, and infinite if p is 0.

        Parameters
        ----------
        confidence : float
            Probability of at least one hit, between 0 and 1.

        Raises
        ------
        MistrayError
            If `confidence` is not between 0 and 1.
        """
        if not 0 < confidence < 1:
            raise MistrayError(f"confidence {confidence:g}: give a probability between 0 and 1")
        if self.total >= 1:
            return 1.0
        return math.log1p(-confidence) / math.log1p(-self.total) if self.total > 0 else math.inf


def chance(
    model: LobeModel,
    towards_deg: float,
    solid_angle_sr: float,
    *,
    incidence_deg: float = 0.0,
    event: str = "reflection",
    light: IncidentLight | None = None,
    before: float = 1.0,
) -> Chance:
    """
    Return the probability that a ray is scattered into a small solid angle in the plane of incidence.

    Parameters
    ----------
    model : LobeModel
        Scatter of the surface.
    towards_deg : float
        Angle of the scattered direction with the normal, above -90° and below 90°; positive on the side of the specular
        direction.
    solid_angle_sr : float
        Solid angle of the detector as seen from the surface, sr, > 0; so small that the BSDF is constant over it.
    incidence_deg : float
        Angle of incidence, from 0° to below 90°.
    event : {"reflection", "transmission"}
        Event whose scatter is considered.
    light : IncidentLight, optional
        Incident light; by default that of `IncidentLight()`.
    before : float
        Probability that a ray from the source gets to the surface, above 0 and at most 1.

    Returns
    -------
    Chance
        Probabilities per ray, before and at the surface.

    Raises
    ------
    MistrayError
        If an angle, the solid angle or `before` is out of range, transmission is requested for totally reflected light,
        or BSDF · cos θs · ΔΩ exceeds 1.

    Notes
    -----
    Example "A World without Importance Sampling" of a webinar on TracePro: a lens of A = 2e-5, B = 1e-6, g = 2 scatters
    at 30° to a detector of (2 mrad)². A ray meets the lens with the probability 1/8. The webinar's 3e10 rays for "a 50
    % chance of one ray" give one hit on average; 2.0e10 rays are enough for 50 %.
    """
    light = light or IncidentLight()
    FIELD_DEG.check("angle of the scattered direction", towards_deg)
    SOLID_ANGLE_SR.check("solid angle", solid_angle_sr)
    CHANCE.check("chance of getting to the surface", before)
    light.sin_specular(event, incidence_deg)
    lobes = model.lobes(light.wavelength_nm, light.n_in, light.n_out, light.from_front)
    angle, cos_i = math.radians(towards_deg), math.cos(math.radians(incidence_deg))
    out = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
    value = float(bsdf(lobes, event, cos_i, out, light.n_in, light.n_out, light.share(event), light.rotation)[0])
    found = value * math.cos(angle) * solid_angle_sr
    if found > 1:
        raise MistrayError(f"solid angle {solid_angle_sr:g} sr: too large for one value of the BSDF, {value:g} 1/sr")
    return Chance(found, before)

"""Particles on a surface as a scatter model: Mie scattering of a cleanliness level."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.materials import complex_index, resolved
from mistray.param import Param
from mistray.physics import contamination
from mistray.physics.contamination import CLEANED_SLOPE, SMALLEST_UM, Cloud
from mistray.ranges import COVERAGE_PERCENT, INDEX, LENGTH_UM, LEVEL, SPECTRUM_SLOPE, TEXT
from mistray.scatter.lobe import RELATIVE_TO, Lobe, LobeModel, Placement
from mistray.scatter.particle_clouds import kept_cloud

DUST = "dust"
LEVEL_POWER = float(2 * CLEANED_SLOPE * np.log10(300))
"""Exponent p, 4.6, of the power law level^p that the covered area, 10^(0.926 log10² level), follows about level 300."""
GREATEST_LOSS = 0.5
"""Fraction of the light that particles take from a reflection at grazing incidence, where 1/cos θ would exceed all
light. If they take more at normal incidence, light meets several particles, and the model does not hold."""
LEAST_DEFLECTION = np.radians(30)
"""Least angle, rad, of light scattered away from the surface without a reflection. The lobe about the direction back to
the light ends there, because its nodes lie too far apart near the forward direction. The part left out is above the
horizon only beyond 60° of incidence, and is less than a fifth of the scatter; it counts as absorbed."""
LEAST_COSINE = 1e-2
"""Least cosine before the refraction, so that the lobe stays finite at the critical angle."""


@dataclass(frozen=True)
class Particulate(Placement):
    """
    Spherical particles on one side of a surface, with the size distribution of IEST-STD-CC1246.

    Light that crosses the surface passes the particles once, and forward scatter is a lobe about the transmitted light.
    Light that is reflected on the side of the particles passes them twice. Forward scatter before or after the
    reflection, 2R F, is a lobe about the reflected light. Backward scatter on the way in or, reflected twice, on the
    way out, (1 + R²) F, is a lobe about the direction back to the light. The specular beam loses the extinction; light
    that it loses without scatter is absorbed by the particles. F is the fraction of the light that one passage scatters
    per solid angle, 1/sr. It depends on the angle between two directions, so the lobes have the measure "angle".

    Light that enters glass is scattered before it is refracted: a small deflection α in the medium of the particles is
    α/n in the glass. Light that is reflected inside the glass does not meet the particles. Equations and sources:
    `mistray.physics.contamination`.

    Attributes
    ----------
    level : float, optional
        Cleanliness level, ≥ 1. Give either the level or `coverage_percent`.
    coverage_percent : float, optional
        Area that the spheres cover, percent of the surface; the level follows from it. The formula in the standard
        itself gives 7.6 % more area at the same level, see `contamination.standard_coverage_percent`.
    slope : float
        Slope of the size distribution, > 0; 0.926 for cleaned surfaces, 0.383 for fallout.
    particle : str
        "dust" (Lindberg and Gillespie), or a material: ``"1.53+0.002i"``, a CSV file over the wavelength, ….
    min_um, max_um : float
        Least and greatest diameter, µm, 1 ≤ min_um < max_um ≤ level; `max_um` is the level by default.
    immersion : float
        Refractive index around the particles. They lie on the side of the surface whose index is nearer to it.

    Raises
    ------
    MistrayError
        If a parameter is out of range, not exactly one of `level` and `coverage_percent` is given, or `relative_to` is
        "incident": the scatter of particles is a fraction of the specular beam.
    """

    level: float | None = Param(
        "1", LEVEL, "cleanliness level of IEST-STD-CC1246, such as 400", power=LEVEL_POWER
    ).field(None)
    coverage_percent: float | None = Param(
        "%", COVERAGE_PERCENT, "area that the spheres cover, instead of the level"
    ).field(None)
    slope: float = Param("1", SPECTRUM_SLOPE, "slope of the size distribution; 0.383 for fallout", 0.05).field(
        CLEANED_SLOPE
    )
    particle: str = Param(
        "string", TEXT, "``dust``, or a material: ``1.53+0.002i``, a CSV file, …; see docs/materials.md"
    ).field(DUST)
    min_um: float = Param("um", LENGTH_UM, "smallest diameter", differentiable=False, within="≥ 1").field(SMALLEST_UM)
    max_um: float | None = Param(
        "um", LENGTH_UM, "largest diameter", differentiable=False, within="≤ level", otherwise="level"
    ).field(None)
    immersion: float = Param(
        "1",
        INDEX,
        "index of the medium around the particles; they lie on the side of the surface whose index is nearer to it",
        differentiable=False,
    ).field(1.0)

    _: KW_ONLY
    relative_to: str = replace(RELATIVE_TO, doc="BSDF per unit of R and T", within="specular").field("specular")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.relative_to != "specular":
            raise MistrayError(f"{self.title}: relative_to is '{self.relative_to}'; particles know 'specular' only")
        if (self.level is None) == (self.coverage_percent is None):
            given = "neither" if self.level is None else "both"
            raise MistrayError(f"{self.title}: {given} of level and coverage_percent given; give one of them")
        contamination.check_distribution(self.cleanliness, self.slope, self.min_um, self.max_um)

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> Particulate:
        """Return the model with given properties, see `Placement.of`; `resolve` is applied to a file of `particle`."""
        particle = properties.get("particle", DUST)
        return super().of(**{**properties, "particle": particle if particle == DUST else resolved(particle, resolve)})

    @property
    def cleanliness(self) -> float:
        """Cleanliness level, given or computed from the coverage."""
        if self.level is not None:
            return self.level
        assert self.coverage_percent is not None
        return contamination.level_of_coverage(self.coverage_percent, self.slope, self.min_um, self.max_um)

    def index(self, wavelength_nm: float) -> complex:
        """Return the complex index n + ik of the particle material at a vacuum wavelength, nm."""
        if self.particle == DUST:
            return contamination.dust_index(wavelength_nm * 1e-3)
        return complex_index(self.particle, wavelength_nm)

    def cloud(self, wavelength_nm: float) -> Cloud:
        """
        Return the effect of the particles on light that passes them once, at a vacuum wavelength, nm.

        Raises
        ------
        MistrayError
            If the index is not known at the wavelength, or the particles are too large or too small for Mie's series.
        """
        return kept_cloud(
            wavelength_nm * 1e-3,
            self.index(wavelength_nm),
            self.cleanliness,
            self.slope,
            self.min_um,
            self.max_um,
            self.immersion,
        )

    def on_near_side(self, n_in: float, n_out: float) -> bool:
        """True if the particles lie on the side of incidence, judged by the refractive indices."""
        return abs(n_in - self.immersion) <= abs(n_out - self.immersion)

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        """
        Return one lobe in transmission and two in reflection; parameters as in `LobeModel.lobes`.

        Only events that scatter have lobes, and reflection only if the particles lie on the side of incidence.

        At an interface the transmitted lobe is that of normal incidence. At grazing incidence it is too strong by the
        light that is scattered away from the surface; particles that do not absorb then remove that much more light.
        Raise `MistrayError` if the particles take more than `GREATEST_LOSS` at normal incidence.
        """
        events = self.events(from_front)
        near = self.on_near_side(n_in, n_out)
        cloud = self.cloud(wavelength_nm)
        depth = cloud.extinction
        if n_in != n_out:  # the transmitted lobe does not know how much of the light stays above the horizon
            depth = max(depth, cloud.between(0, np.pi / 2) + cloud.between(LEAST_DEFLECTION, np.pi) / 2)
        limit = GREATEST_LOSS / (2 * depth)
        if limit < 1:
            raise MistrayError(
                f"{self.title}: at level {self.cleanliness:.4g} the particles take {200 * depth:.3g} % of the light in "
                f"two passages at {wavelength_nm:g} nm; they may take {100 * GREATEST_LOSS:g} %, lower the level"
            )
        result: tuple[Lobe, ...] = ()
        if "transmission" in events:
            once = Lobe(
                "transmission",
                lambda r: _refracted(cloud, _angle(r), n_out / n_in if near else 1.0),
                "angle",
                optical_depth=depth,
                oblique_limit=limit,
            )
            result += (once,)
        if "reflection" in events and near:
            forward = Lobe(
                "reflection",
                lambda r: cloud.f(_angle(r)),
                "angle",
                shares=(0.0, 2.0, 0.0),
                optical_depth=2 * depth,
                oblique_limit=limit,
            )
            back = Lobe(
                "reflection",
                lambda r: _backward(cloud, np.pi - _angle(r)),
                "angle",
                "retro",
                shares=(1.0, 0.0, 1.0),
                oblique_limit=limit,
            )
            result += (forward, back)
        return result


def _refracted(cloud: Cloud, angle: np.ndarray, ratio: float) -> np.ndarray:
    """
    Return the phase function F, 1/sr, at angles from the transmitted light, rad, for light refracted after scatter.

    `ratio` is the index behind the surface divided by that of the particles' medium. At normal incidence sin α' = ratio
    sin α, and the flux per solid angle changes by ratio² cos α/cos α'. Beyond the critical angle there is no light.
    """
    if ratio == 1:
        return cloud.f(angle)
    sine = ratio * np.sin(angle)
    before = np.arcsin(np.minimum(sine, 1))
    denser = np.maximum(np.cos(before), LEAST_COSINE)
    before = np.where(angle > np.pi / 2, np.pi - before, before)
    spread = ratio**2 * np.abs(np.cos(angle)) / denser
    lit = (sine < 1) & ((angle < np.pi / 2) | (ratio < 1))
    return np.asarray(np.where(lit, spread * cloud.f(before), 0.0))


def _backward(cloud: Cloud, deflection: np.ndarray) -> np.ndarray:
    """Return the fraction of light scattered per solid angle, 1/sr, at deflections, rad; 0 below `LEAST_DEFLECTION`."""
    return np.asarray(np.where(deflection >= LEAST_DEFLECTION, cloud.f(deflection), 0.0))


def _angle(r: np.ndarray) -> np.ndarray:
    """Return the angle, rad, between two unit vectors whose difference has the length r."""
    return np.asarray(2 * np.arcsin(np.minimum(r / 2, 1)))


def particle_indices(models: Iterable[LobeModel], wavelength_nm: float) -> tuple[complex, ...]:
    """
    Return the indices n + ik of the particles of all models that have them, at a vacuum wavelength, nm.

    They identify cached results: two equal models name one file, whose content may have changed.
    """
    return tuple(model.index(wavelength_nm) for model in models if isinstance(model, Particulate))

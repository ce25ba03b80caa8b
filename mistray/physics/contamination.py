"""Particulate contamination of a surface: the size distribution of a cleanliness level, and the light that it scatters.

Sources: IEST-STD-CC1246 (formerly MIL-STD-1246) for the distribution, log10 N(>D) = S (log10² level - log10² D) per 0.1
m², D in µm; M. G. Dittman, Proc. SPIE 4774 (2002), for its slope without cleaning; J. B. Lindberg and J. B. Gillespie,
Appl. Opt. 16, 2628 (1977), for the refractive index of dust, as tabulated in a stray-light study of a phone camera.
Particles are spheres, far from one another and from the surface. The clean surface reflects or transmits their
scattered light, and intensities add.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mistray.errors import MistrayError
from mistray.physics.mie import spheres

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

CLEANED_SLOPE = 0.926
"""Slope S of the standard, for cleaned surfaces; fallout has 0.383 (Dittman)."""
SMALLEST_UM = 1.0
"""Least diameter of the distribution, µm: N(>D) has its maximum there."""
AREA_UM2 = 1e11
"""Reference area of N, 0.1 m², in µm²."""

_DUST = np.array(
    [
        # λ µm, n, k
        [0.2, 1.53, 0.05],
        [0.3, 1.53, 0.01],
        [0.4, 1.53, 0.005],
        [0.6328, 1.53, 0.0005],
        [1.15, 1.5, 0.001],
        [3.39, 1.5, 0.02],
        [10.6, 1.7, 0.2],
        [20.0, 1.9, 1.0],
    ]
)
_PANEL, _PANELS = 16, 375  # Gauss-Legendre nodes in D^0.1: sizes are dense enough for the ripple of Mie's curves
_POWER = 0.1
_U = np.linspace(np.log(5e-6), np.log(2e4), 900)  # nodes of log tan(θ/2): from 1e-5 rad to 1e-4 rad before π


def count(diameter_um: ArrayLike, level: float, slope: float = CLEANED_SLOPE) -> np.ndarray:
    """
    Return the number of particles larger than a diameter, per 0.1 m² of surface: 10^(S (log10² level - log10² D)).

    Parameters
    ----------
    diameter_um : float or array
        Diameter D, µm, ≥ 1; the result has its shape.
    level : float
        Cleanliness level, ≥ 1: the diameter of the largest particle on 0.1 m², µm.
    slope : float
        Slope S of the distribution.
    """
    d = np.asarray(diameter_um, dtype=np.float64)
    return np.asarray(10 ** (slope * (np.log10(level) ** 2 - np.log10(d) ** 2)))


def density(diameter_um: ArrayLike, level: float, slope: float = CLEANED_SLOPE) -> np.ndarray:
    """Return the number of particles per diameter, -dN/dD, per µm and 0.1 m²; parameters as in `count`."""
    d = np.asarray(diameter_um, dtype=np.float64)
    return np.asarray(2 * slope * np.log10(d) / d * count(d, level, slope))


def standard_coverage_percent(level: ArrayLike) -> np.ndarray:
    """
    Return the part of a surface that particles cover by the standard, percent: 10^(-7.245 + 0.926 log10² level).

    `level` is that of `count`, and gives the shape. The formula holds for the slope 0.926. It gives 7.6 % more than the
    area of the spheres, `coverage_percent`, because the standard counts particles in size classes and allows other
    shapes.
    """
    return np.asarray(10 ** (-7.245 + 0.926 * np.log10(np.asarray(level, dtype=np.float64)) ** 2))


def coverage_percent(
    level: float, slope: float = CLEANED_SLOPE, min_um: float = SMALLEST_UM, max_um: float | None = None
) -> float:
    """
    Return the part of a surface that the spheres cover, percent: ∫ n(D) πD²/4 dD over 0.1 m²; n(D) is `density`.

    Parameters
    ----------
    level, slope : float
        Parameters of `count`.
    min_um, max_um : float
        Least and greatest diameter, µm; `max_um` is the level by default.
    """
    d, weight = _sizes(min_um, level if max_um is None else max_um)
    return float(100 * np.sum(weight * density(d, level, slope) * np.pi * d**2 / 4) / AREA_UM2)


@lru_cache(maxsize=256)
def level_of_coverage(
    percent: float, slope: float = CLEANED_SLOPE, min_um: float = SMALLEST_UM, max_um: float | None = None
) -> float:
    """
    Return the cleanliness level whose spheres cover a given area, percent: the inverse of `coverage_percent`.

    The slope and the diameters, µm, are those of `coverage_percent`.

    Raises
    ------
    MistrayError
        If no level covers just this area: each one from the greatest given diameter up to 1e5 covers more, or less.
    """
    from scipy.optimize import brentq

    def excess(log_level: float) -> float:
        level = 10**log_level
        covered = coverage_percent(level, slope, min_um, max_um) if level > min_um else 0.0
        return float(np.log(max(covered, 1e-300) / percent))

    least, most = float(np.log10(max(min_um, max_um or 0) * (1 + 1e-9))), 5.0
    if not excess(least) < 0 < excess(most):
        raise MistrayError(
            f"particles: no cleanliness level with slope {slope:g} and diameters {min_um:g} … "
            f"{'level' if max_um is None else f'{max_um:g}'} µm covers {percent:g} % of the area; change one of them"
        )
    return float(10 ** brentq(excess, least, most, xtol=1e-12))


def dust_index(wavelength_um: float) -> complex:
    """
    Return the index n + ik of dust at a wavelength, µm, linear in Lindberg and Gillespie's table, 0.2 … 20 µm.

    Logarithmic interpolation of k would give half as much at 0.55 µm; the scatter changes little.

    Raises
    ------
    MistrayError
        If the wavelength is outside the table.
    """
    wavelengths, n, k = _DUST.T
    if not wavelengths[0] <= wavelength_um <= wavelengths[-1]:
        raise MistrayError(
            f"particles: no index of dust at {wavelength_um:g} µm; the table covers {wavelengths[0]:g} … "
            f"{wavelengths[-1]:g} µm, give the particle's n + ik"
        )
    return complex(np.interp(wavelength_um, wavelengths, n), np.interp(wavelength_um, wavelengths, k))


@dataclass(frozen=True, eq=False)
class Cloud:
    """
    Light that all particles on a surface scatter when it passes them once, at normal incidence: a phase function.

    Attributes
    ----------
    extinction, scattering : float
        Fractions of the incident light: what the particles remove from the beam, and what they scatter. They absorb the
        difference.
    """

    extinction: float
    scattering: float
    _log_f: CubicSpline

    @classmethod
    def of_nodes(cls, extinction: float, scattering: float, log_f: ArrayLike) -> Cloud:
        """Create a cloud from its attributes, and from the values of `nodes`: ln f (f in 1/sr), (a,)."""
        from scipy.interpolate import CubicSpline

        return cls(extinction, scattering, CubicSpline(_U, np.asarray(log_f, dtype=np.float64)))

    @property
    def nodes(self) -> np.ndarray:
        """
        Values of ln f (f in 1/sr), (a,), at the fixed angles of the spline, from 1e-5 rad to π - 1e-4 rad.

        With `extinction` and `scattering` they define a cloud.
        """
        return np.asarray(self._log_f(self._log_f.x))

    def f(self, angle: ArrayLike) -> np.ndarray:
        """
        Return the fraction of the incident light that is scattered per solid angle, 1/sr, at given angles.

        Parameters
        ----------
        angle : float or array
            Angle between the directions of the incident and the scattered light, 0 … π rad; the result has its shape.
            Below 1e-5 rad and within 1e-4 rad of π the value at that limit is used.
        """
        return np.asarray(np.exp(self._log_f(_place(angle))))

    def between(self, low: float, high: float) -> float:
        """
        Return the fraction of the incident light scattered by angles from `low` to `high`, rad.

        The part below 1e-5 rad and the part within 1e-4 rad of π are left out.
        """
        u = np.linspace(_place(low), _place(high), 4 * len(_U))
        angle = 2 * np.arctan(np.exp(u))
        return float(np.trapezoid(2 * np.pi * np.sin(angle) ** 2 * self.f(angle), u))


@lru_cache(maxsize=32)
def cloud(
    wavelength_um: float,
    index: complex,
    level: float,
    slope: float = CLEANED_SLOPE,
    min_um: float = SMALLEST_UM,
    max_um: float | None = None,
    immersion: float = 1.0,
) -> Cloud:
    """
    Return the Mie scattering of all particles of a cleanliness level.

    Parameters
    ----------
    wavelength_um : float
        Vacuum wavelength, µm.
    index : complex
        Index n + ik of the particles.
    level, slope : float
        Parameters of `count`.
    min_um, max_um : float
        Least and greatest diameter, µm, 1 ≤ min_um < max_um ≤ level; `max_um` is the level by default, also if the
        level changes.
    immersion : float
        Refractive index of the medium around the particles.

    Returns
    -------
    Cloud
        Scattered light, with an error of 1e-3 at every angle for particles that absorb like dust. Without absorption
        the sharp resonances of the spheres leave an error of 1 % beyond 90°, and of 1e-4 in the total.

    Raises
    ------
    MistrayError
        If the size distribution, the size of a sphere relative to the wavelength, or the index is out of range.
    """
    check_distribution(level, slope, min_um, max_um)
    largest = level if max_um is None else max_um
    d, weight = _sizes(min_um, largest)
    weight = weight * density(d, level, slope) / AREA_UM2
    cross, area, scattered = _cross_sections(min_um, largest, wavelength_um, index, immersion)
    f, extinction, scattering = weight @ cross, float(weight @ area), float(weight @ scattered)
    return Cloud.of_nodes(extinction, scattering, np.log(f))


def check_distribution(level: float, slope: float, min_um: float, max_um: float | None) -> None:
    """Raise `MistrayError` if these parameters of `cloud` are out of range, or the spheres cover more than 100 %."""
    if not (np.isfinite(level) and level >= 1):
        raise MistrayError(f"particles: cleanliness level {level:g}; it must be 1 or more, 100 … 1000 is usual")
    if not slope > 0:
        raise MistrayError(f"particles: slope {slope:g}; it must be greater than 0, {CLEANED_SLOPE} is the standard's")
    largest = level if max_um is None else max_um
    if not SMALLEST_UM <= min_um < largest <= level:
        raise MistrayError(
            f"particles: diameters {min_um:g} … {largest:g} µm at level {level:g}; they must keep "
            f"{SMALLEST_UM:g} ≤ min_um < max_um ≤ level, where the distribution is defined"
        )
    with np.errstate(all="ignore"):  # what is not finite is refused
        covered = coverage_percent(level, slope, min_um, max_um)
    if not covered <= 100:
        raise MistrayError(
            f"particles: level {level:g} with slope {slope:g} covers {covered:.4g} % of the area, more than there is; "
            "lower the level"
        )


@lru_cache(maxsize=8)
def _cross_sections(
    min_um: float, max_um: float, wavelength_um: float, index: complex, immersion: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the Mie cross-sections, µm², of spheres with the diameters of `_sizes`; parameters as in `cloud`.

    They are the scattering per solid angle at the nodes, (m, a), µm²/sr, the extinction, (m,), µm², and the scattering,
    (m,), µm².
    """
    d, _ = _sizes(min_um, max_um)
    k = 2 * np.pi * immersion / wavelength_um
    answer = spheres(k * d / 2, index / immersion, 2 * np.arctan(np.exp(_U)))
    area = np.pi * d**2 / 4
    return answer.intensity / k**2, answer.extinction * area, answer.scattering * area


def _sizes(min_um: float, max_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Return particle diameters, (m,), µm, and their weights in an integral over the diameter, (m,), µm."""
    nodes, weights = np.polynomial.legendre.leggauss(_PANEL)
    edges = np.linspace(min_um**_POWER, max_um**_POWER, _PANELS + 1)
    half = np.diff(edges)[:, None] / 2
    t = (edges[:-1, None] + half * (1 + nodes)).ravel()
    return t ** (1 / _POWER), (half * weights).ravel() * t ** (1 / _POWER - 1) / _POWER


def _place(angle: ArrayLike) -> np.ndarray:
    """Return ln tan(θ/2), the coordinate of the scatter table, of the scattering angle θ, rad, clipped to the table."""
    theta = np.asarray(angle, dtype=np.float64)
    with np.errstate(divide="ignore"):
        return np.clip(np.log(np.tan(theta / 2)), _U[0], _U[-1])

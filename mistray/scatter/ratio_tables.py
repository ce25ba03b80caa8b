"""Tables of the ratios that multiply lobes, computed from functions of the incident and scattered directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mistray.scatter.lobe import RatioTable

GRAZING = 1e-3  # least cosine in tables: they hold ratios of T, which is 0 at grazing incidence
RADIAL, R_MIN = (49, 121, 49), 1e-3  # nodes of the cosine of the specular direction, of log r and of ψ


@dataclass(frozen=True, eq=False)
class Directions:
    """
    Incident, specular and scattered directions by their cosines, as arrays that broadcast together.

    Attributes
    ----------
    cos_i, cos_specular, cos_s : float64
        Cosines of the angles of the incident, specular and scattered direction with the normal, each in its own medium.
    cos_phi : float64
        Cosine of the azimuth between the specular and the scattered direction.
    r : float64
        Distance |β - β0| of the direction cosines.
    """

    cos_i: np.ndarray
    cos_specular: np.ndarray
    cos_s: np.ndarray
    cos_phi: np.ndarray
    r: np.ndarray


def over_cosines(
    ratio: Callable[[Directions], np.ndarray], sine_ratio: float, nodes: tuple[int, int, int]
) -> RatioTable:
    """
    Return a table of a function over the cosines of specular and scattered directions and the azimuth.

    Parameters
    ----------
    ratio : callable
        Function to tabulate.
    sine_ratio : float
        Ratio of sin θi to the sine of the specular direction: n_out/n_in in transmission, 1 in reflection.
    nodes : tuple of int
        How many nodes there are of the cosine of the specular direction, of that of the scattered direction, and of the
        azimuth.
    """
    cosine, cos_s = (np.linspace(0, 1, count) for count in nodes[:2])
    cos_i, refracted = _incidence(cosine, sine_ratio)
    cos_phi = np.cos(np.linspace(0, np.pi, nodes[2]))
    first, second, third = np.ix_(np.arange(nodes[0]), cos_s, cos_phi)
    sine, sine_s = np.sqrt(1 - refracted[first] ** 2), np.sqrt(1 - second * second)
    r = np.sqrt(np.maximum(0.0, sine * sine + sine_s * sine_s - 2 * sine * sine_s * third))
    values = ratio(Directions(cos_i[first], refracted[first], second, third, r))
    return RatioTable(np.ascontiguousarray(np.broadcast_to(values, nodes)), axes="cosines", fixed=True)


def over_radius(ratio: Callable[[Directions], np.ndarray], sine_ratio: float) -> RatioTable:
    """Return a table of a ratio over the specular cosine, log r and azimuth ψ; for parameters see `over_cosines`."""
    cosine = np.linspace(0, 1, RADIAL[0])[:, None, None]
    cos_i, refracted = _incidence(cosine, sine_ratio)
    r = np.geomspace(R_MIN, 2, RADIAL[1])[None, :, None]
    psi = np.linspace(0, np.pi, RADIAL[2])[None, None, :]
    sine = np.sqrt(1 - cosine * cosine)
    along, across = sine + r * np.cos(psi), r * np.sin(psi)
    beta = np.hypot(along, across)
    cos_s = np.sqrt(np.maximum(0.0, 1 - beta * beta))
    cos_phi = np.divide(along, beta, out=np.ones_like(beta), where=beta > 0)
    values = ratio(Directions(cos_i, refracted, cos_s, cos_phi, r))
    return RatioTable(np.ascontiguousarray(np.broadcast_to(values, RADIAL)), R_MIN)


def _incidence(cosine: np.ndarray, sine_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the cosine of incidence for each specular cosine, and the specular cosine; neither below `GRAZING`.

    `sine_ratio` is that of `over_cosines`.
    """
    cosine = np.maximum(cosine, GRAZING)
    cos_i = np.sqrt(np.maximum(GRAZING**2, 1 - sine_ratio**2 * (1 - cosine * cosine)))
    return cos_i, np.sqrt(np.maximum(GRAZING**2, 1 - (1 - cos_i * cos_i) / sine_ratio**2))

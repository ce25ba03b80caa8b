"""Closed forms of plates, paraxial ghosts and counts; R and T are power factors of a surface, lengths in mm."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .geometry import Array


def normal_reflectance(n1: float, n2: float) -> float:
    return ((n1 - n2) / (n1 + n2)) ** 2


def plate(r: float) -> tuple[float, float]:
    """T and R of a lossless plate over all orders, incoherent: (1 - R)/(1 + R) and 2R/(1 + R)."""
    return (1 - r) / (1 + r), 2 * r / (1 + r)


def plate_orders(r: float, orders: int) -> Array:
    """Transmitted power by number of reflection pairs 0 … orders - 1: (1 - R)^2 R^(2m)."""
    return np.array([(1 - r) ** 2 * r ** (2 * m) for m in range(orders)])


def coated_plate(
    r1: float, r2: float, tau: float = 1.0, t1: float | None = None, t2: float | None = None
) -> tuple[float, float]:
    """T and R of a plate with surfaces (r1, t1), (r2, t2) and internal transmittance tau; t = 1 - r by default."""
    t1, t2 = 1 - r1 if t1 is None else t1, 1 - r2 if t2 is None else t2
    loop = 1 - r1 * r2 * tau**2
    return t1 * t2 * tau / loop, r1 + t1**2 * r2 * tau**2 / loop


def plates(r: float, number: int) -> float:
    """T of N equal lossless plates, incoherent: (1 - R) / (1 + (2N - 1) R)."""
    return (1 - r) / (1 + (2 * number - 1) * r)


def fresnel(incidence_deg: float, n: float) -> tuple[float, float]:
    """R of s and of p at a bare surface; n is the index behind it over that before it."""
    cos_i = np.cos(np.radians(incidence_deg))
    cos_t = np.sqrt(1 - (np.sin(np.radians(incidence_deg)) / n) ** 2)
    s, p = (cos_i - n * cos_t) / (cos_i + n * cos_t), (n * cos_i - cos_t) / (n * cos_i + cos_t)
    return float(s * s), float(p * p)


def tilted_plate(n: float, incidence_deg: float) -> tuple[float, float]:
    """Unpolarised T of a lossless plate: with s and p kept apart, and with R averaged at every hit."""
    r_s, r_p = fresnel(incidence_deg, n)
    return float(0.5 * (plate(r_s)[0] + plate(r_p)[0])), float(plate(0.5 * (r_s + r_p))[0])


@dataclass(frozen=True)
class ParaxialSurface:
    """Vertex z in mm, curvature in 1/mm, indices before and behind, R and T of the surface."""

    z: float
    curvature: float
    n_before: float
    n_after: float
    r: float
    t: float


@dataclass(frozen=True)
class ParaxialGhost:
    """Ghost of surfaces i < j (1-based), reflected first at j: marginal ray at the detector, power per start power."""

    second: int
    first: int
    height: float
    slope: float
    power: float


def trace_paraxial(
    surfaces: Sequence[ParaxialSurface], route: Sequence[tuple[int, str]], y: float, u: float, z: float
) -> Array:
    """Height, slope dy/dz, z and power factor after a route of (surface index from 0, "T" or "R")."""
    power, forward = 1.0, True
    for index, event in route:
        s = surfaces[index]
        y, z = y + u * (s.z - z), s.z
        if event == "T":
            n1, n2 = (s.n_before, s.n_after) if forward else (s.n_after, s.n_before)
            slope = y * s.curvature
            u = (n1 * (u + slope) / n2) - slope
            power *= s.t
        else:
            u = -(u + 2 * y * s.curvature)
            forward = not forward
            power *= s.r
    return np.array([y, u, z, power])


def paraxial_ghosts(
    surfaces: Sequence[ParaxialSurface], detector_z: float, detector_r: float, radius: float
) -> list[ParaxialGhost]:
    """All two-reflection ghosts of a collimated beam of the given radius; surface N + 1 is the detector."""
    last_index = surfaces[-1].n_after
    system = [*surfaces, ParaxialSurface(detector_z, 0.0, last_index, last_index, detector_r, 1 - detector_r)]
    found = []
    for first in range(1, len(system)):
        for second in range(first):
            route = ghost_route(len(surfaces), (first, second))
            y, u, z, power = trace_paraxial(system, route, radius, 0.0, surfaces[0].z)
            found.append(ParaxialGhost(second + 1, first + 1, float(y + u * (detector_z - z)), float(u), float(power)))
    return found


def back_focus(surfaces: Sequence[ParaxialSurface]) -> tuple[float, float]:
    y, u, _, _ = trace_paraxial(surfaces, [(i, "T") for i in range(len(surfaces))], 1.0, 0.0, surfaces[0].z)
    return float(-1 / u), float(-y / u)


def ghost_sequences(surfaces: int, reflections: int) -> Iterator[tuple[int, ...]]:
    """Sequences of reflecting surfaces (0-based): each lies before, then behind, the last one."""

    def extend(done: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(done) == reflections:
            yield done
            return
        backward = len(done) % 2 == 0
        lowest = (done[-1] + 1 if done else 0) if backward else 0
        for surface in range(lowest, surfaces if backward else done[-1]):
            yield from extend((*done, surface))

    yield from extend(())


def ghost_count(surfaces: int, reflections: int) -> int:
    """Number of `ghost_sequences`, by summing over the last mirror; n(n-1)/2 for two reflections."""
    counts = [1] * surfaces
    for step in range(1, reflections):
        if step % 2:
            counts = [sum(counts[mirror + 1 :]) for mirror in range(surfaces)]
        else:
            counts = [sum(counts[:mirror]) for mirror in range(surfaces)]
    return sum(counts)


def ghost_route(surfaces: int, sequence: Sequence[int]) -> list[tuple[int, str]]:
    """The full route of (surface, "T" or "R") through N surfaces; a reflection at number N is one at the detector."""
    route: list[tuple[int, str]] = []
    place, forward = 0, True
    for mirror in sequence:
        between = range(place, mirror) if forward else range(place, mirror, -1)
        route += [(surface, "T") for surface in between] + [(mirror, "R")]
        forward = not forward
        place = mirror + 1 if forward else mirror - 1
    return route + [(surface, "T") for surface in range(place, surfaces)]


def ghost_events(surface_ids: Sequence[str], sequence: Sequence[int], detector_id: str) -> list[tuple[str, str]]:
    """Event list of a ghost for `replay`, detector absorption included; number N is a reflection at the detector."""
    ids = [*surface_ids, detector_id]
    names = {"T": "SpecTran", "R": "SpecRefl"}
    return [(ids[i], names[e]) for i, e in ghost_route(len(surface_ids), sequence)] + [(detector_id, "Absorbed")]

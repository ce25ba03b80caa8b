"""Scattered flux by quadrature and in closed form, float64; BSDFs are functions of r = |beta - beta0|, in 1/sr."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from .geometry import Array

Profile = Callable[[Array], Array]
ANGLES = 33  # nodes of a lobe's total over the cosine, for a cubic spline


def abg(a: float, b: float, g: float) -> Profile:
    return lambda r: a / (b + np.asarray(r, dtype=float) ** g)


def harvey_shack(b0: float, length: float, slope: float) -> Profile:
    return lambda r: b0 * (1 + (np.asarray(r, dtype=float) / length) ** 2) ** (slope / 2)


def lambertian(rho: float) -> Profile:
    return lambda r: np.full(np.shape(r), rho / np.pi)


_legendre = cache(np.polynomial.legendre.leggauss)


def gauss_legendre(edges: Array, nodes: int) -> tuple[Array, Array]:
    """Nodes and weights of a composite rule over the panels between edges (k + 1,), flat."""
    x, w = _legendre(nodes)
    low, half = edges[:-1, None], 0.5 * np.diff(edges)[:, None]
    return (low + half * (x + 1)).ravel(), (half * w).ravel()


def total_scatter(profile: Profile, sine: float) -> float:
    """TIS at a specular direction of this sine, in polar coordinates about it: the integral of f over the unit disc."""
    inside = 1 - sine
    edges = np.concatenate([[0.0], inside * np.logspace(-10, 0, 81)]) if inside > 0 else np.zeros(1)
    total = 0.0
    if inside > 0:
        r, w = gauss_legendre(edges, 16)
        total += float(np.sum(w * 2 * np.pi * r * profile(r)))
    if sine > 0:
        # r = 1 - s cos t: the arc ends with square roots at both ends, which t removes
        t, w = gauss_legendre(np.pi * np.concatenate([[0.0], np.logspace(-8, 0, 65)]), 16)
        r, dr = 1 - sine * np.cos(t), sine * np.sin(t)
        if inside < 1e-12:
            r = np.maximum(r, 1e-300)
        arc = 2 * np.pi - 2 * np.arccos(np.clip((1 - sine**2 - r**2) / (2 * sine * r), -1, 1))
        total += float(np.sum(w * dr * r * profile(r) * arc))
    return total


@dataclass(frozen=True)
class Lobe:
    """X profile(|β - βc|) per projected solid angle, X is R or T, or 1 where `absolute`; βc is specular or 0."""

    event: str
    profile: Profile
    absolute: bool = False
    sides: tuple[str, ...] = ("front", "back")
    about_normal: bool = False

    @cached_property
    def _totals(self) -> CubicSpline:
        cosines = np.linspace(0.0, 1.0, ANGLES)
        sines = np.zeros(ANGLES) if self.about_normal else np.sqrt(1 - cosines**2)
        totals = {sine: total_scatter(self.profile, sine) for sine in np.unique(sines)}
        return CubicSpline(cosines, [totals[sine] for sine in sines])

    def total(self, cosine: Array) -> Array:
        """Integral of the profile over the projected hemisphere, where the specular direction has these cosines."""
        return np.asarray(self._totals(cosine))

    @cached_property
    def _within(self) -> tuple[Array, Array]:
        """Radii 0 … 2 and the flux within them, on a fine grid; linear in r² between its nodes."""
        r = np.concatenate([[0.0], np.logspace(-9, np.log10(2.0), 20_000)])
        rings = np.pi * np.diff(r * r) * self.profile(np.sqrt(0.5 * (r[1:] ** 2 + r[:-1] ** 2)))
        return r, np.concatenate([[0.0], np.cumsum(rings)])

    def drawn(self, heading: Array, normal: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Directions (n, 3), one for each specular one, by the profile, and weights whose mean is the total."""
        along = np.einsum("ij,ij->i", heading, normal)
        centre = 0.0 * heading if self.about_normal else heading - along[:, None] * normal
        r, within = self._within
        most = np.interp(1 + np.linalg.norm(centre, axis=1), r, within)
        radius = np.sqrt(np.interp(rng.random(len(most)) * most, within, r * r))
        first = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        angle = 2 * np.pi * rng.random((len(most), 1))
        beta = centre + radius[:, None] * (np.cos(angle) * first + np.sin(angle) * np.cross(normal, first))
        beta2 = np.sum(beta * beta, axis=1)
        up = np.copysign(np.sqrt(np.maximum(0.0, 1 - beta2)), along)
        return beta + up[:, None] * normal, np.where(beta2 < 1, most, 0.0)


def cone_flux(profile: Profile, incidence_deg: float, axis_deg: float, azimuth_deg: float, half_deg: float) -> float:
    """Share of the incident flux scattered into a cone about an axis; the specular azimuth is 0."""
    theta, phi, half = np.radians([axis_deg, azimuth_deg, half_deg])
    axis = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    first = np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
    second = np.cross(axis, first)
    a, wa = gauss_legendre(half * np.concatenate([[0.0], np.logspace(-7, 0, 43)]), 12)
    b, wb = np.arange(256) * (2 * np.pi / 256), 2 * np.pi / 256
    d = np.cos(a)[:, None, None] * axis + np.sin(a)[:, None, None] * (
        np.cos(b)[:, None] * first + np.sin(b)[:, None] * second
    )
    r = np.hypot(d[..., 0] - np.sin(np.radians(incidence_deg)), d[..., 1])
    value = profile(r) * np.maximum(d[..., 2], 0.0)
    return float(np.sum(wa * np.sin(a) * np.sum(value, axis=1)) * wb)


def rectangle_flux(
    profile: Profile, incident: Array, centre: Array, right: Array, up: Array, spot: Array | None = None
) -> float:
    """Share of the flux at ``spot`` of z = 0 that is scattered in transmission onto a rectangle about ``centre``."""
    x, w = np.polynomial.legendre.leggauss(12)
    place = (0.0 if spot is None else spot) * np.ones(3)
    points = centre + x[:, None, None] * right + x[None, :, None] * up - place
    across = 4 * np.cross(right, up)  # area and normal; the weights of the rule sum to 4
    distance = np.linalg.norm(points, axis=-1)
    d = points / distance[..., None]
    beta0 = incident[:2] / np.linalg.norm(incident)
    r = np.hypot(d[..., 0] - beta0[0], d[..., 1] - beta0[1])
    projected = np.abs(d @ across) / distance**2
    return float(np.sum(np.outer(w, w) / 4 * profile(r) * np.abs(d[..., 2]) * projected))


def disc_to_disc(r1: float, r2: float, distance: float) -> float:
    a, b = r1 / distance, r2 / distance
    x = 1 + (1 + b * b) / (a * a)
    return float(0.5 * (x - np.sqrt(x * x - 4 * (b / a) ** 2)))


def element_to_disc(radius: float, distance: float, offset: float) -> float:
    """View factor from a small plane element, parallel to a disc and ``offset`` off its axis, to the disc."""
    if offset == 0:
        return radius**2 / (radius**2 + distance**2)
    h, r = distance / offset, radius / offset
    z = 1 + h * h + r * r
    return float(0.5 * (1 - (1 + h * h - r * r) / np.sqrt(z * z - 4 * r * r)))


def tube_orders(length: float, rho: float, orders: int, nodes: int = 600) -> Array:
    """Transmission of a diffuse tube of radius 1 by number of wall reflections, view factors after Sparrow and Cess."""
    x, w = gauss_legendre(np.linspace(0.0, length / 2, nodes // 10 + 1), 10)  # in units of the diameter

    def to_disc(s: Array) -> Array:
        return (s * s + 0.5) / np.sqrt(s * s + 1) - s

    gap = np.abs(x[:, None] - x)
    kernel = (1 - gap * (2 * gap**2 + 3) / (2 * (gap**2 + 1) ** 1.5)) * w
    # the rule is poor where the kernel has its kink; all that leaves a ring arrives at the wall or at an end
    np.fill_diagonal(kernel, np.diag(kernel) + 1 - to_disc(x) - to_disc(length / 2 - x) - kernel.sum(axis=1))
    out = [disc_to_disc(1.0, 1.0, length)]
    wall = 4 * to_disc(x)  # flux on the wall per unit of x and per unit of flux of the entrance
    for _ in range(orders):
        wall = rho * wall
        out.append(float(np.sum(w * wall * to_disc(length / 2 - x))))
        wall = kernel @ wall
    return np.array(out)


def sphere_orders(rho: float, port: float, orders: int) -> Array:
    """Flux out of the ports of an integrating sphere by number of wall reflections 1 … orders, from the wall on."""
    return rho * port * (rho * (1 - port)) ** np.arange(orders)


def two_scatters(
    first: Profile, second: Profile, distance: float, radius: float, target: Array, target_normal: Array
) -> float:
    """Irradiance at ``target`` of a thin beam of 1 W along +z, scattered by a plate at 0 and then by a disc."""
    h, wh = gauss_legendre(radius * np.concatenate([[0.0], np.logspace(-6, 0, 37)]), 12)
    phi, wphi = np.arange(512) * (2 * np.pi / 512), 2 * np.pi / 512
    points = np.stack([h[:, None] * np.cos(phi), h[:, None] * np.sin(phi), np.full((len(h), 512), distance)], axis=-1)
    s1 = np.linalg.norm(points, axis=-1)
    d1 = points / s1[..., None]
    rest = target - points
    s2 = np.linalg.norm(rest, axis=-1)
    d2 = rest / s2[..., None]
    on_disc = first(np.hypot(d1[..., 0], d1[..., 1])) * d1[..., 2] * d1[..., 2] / s1**2
    r = np.hypot(d2[..., 0] - d1[..., 0], d2[..., 1] - d1[..., 1])
    onward = second(r) * d2[..., 2] * np.abs(d2 @ target_normal) / s2**2
    return float(np.sum(wh * h * np.sum(on_disc * onward, axis=1)) * wphi)

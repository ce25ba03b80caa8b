"""Irradiance on the detector from sky, Earth, Moon or sun: the PST integrated over an extended source.

E = ∫ L PST_n dΩ, with the radiance L in W/(mm² sr) and PST_n = E_det / E_⊥. (With PST_projected the integrand has a
further cos θ, which gives the same result.) The integral runs over the cells of the PST. Directions in no cell count
as dark, and every result states their share of the source; interpolation fills the gaps between cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.sums import Light, weighted_sum
from mistray.errors import MistrayError
from mistray.known_arguments import known_arguments
from mistray.metrics.stray_metric import StrayMetric
from mistray.ranges import several
from mistray.recorders.directions import DirectionGrid

SUN_DEG = 0.53
"""Angular diameter of the sun from the Earth, degrees (0.524 … 0.542 over the year)."""
SUN_W_MM2 = 1.361e-3
"""Irradiance of the sun outside the atmosphere, all wavelengths, W/mm² (G. Kopp and J. Lean, Geophys. Res. Lett. 38,
L01706, 2011: 1360.8 W/m²)."""
INTERPOLATIONS = ("cells", "linear", "log")
PANEL_DEG = 1.0  # widest panel of the quadrature in field angle
NODES = 12  # of a panel
AZIMUTHS = 720  # nodes around the axis for a radiance that is a function

Radiance = float | Callable[[np.ndarray, np.ndarray], np.ndarray]


class ExtendedSource(Protocol):
    """Interface of extended sources, such as sky or sun, whose radiance is integrated; all angles in radians."""

    def breaks(self) -> tuple[float, ...]:
        """Return the field angles where the source begins, changes shape or ends, ascending within 0 … π, radians."""

    def around(self, theta: np.ndarray, centre: float, half: float) -> np.ndarray:
        """
        Return the radiance integrated over azimuths from `centre` - `half` to `centre` + `half`, W rad/(mm² sr), (q,).

        `theta` are the field angles, (q,). All angles are in rad.
        """


@dataclass(frozen=True)
class SkyRadiance:
    """
    Sky or other scenery, given by its radiance.

    Attributes
    ----------
    radiance : float or callable
        Radiance, W/(mm² sr); a function is called with arrays of field angle and azimuth in degrees and returns an
        array.
    from_deg, to_deg : float
        Field angles between which it lies, 0 … 90 degrees.
    """

    radiance: Radiance = 1.0
    from_deg: float = 0.0
    to_deg: float = 90.0

    def __post_init__(self) -> None:
        if not 0 <= self.from_deg < self.to_deg <= 90:
            raise MistrayError(
                f"sky from {self.from_deg:g} to {self.to_deg:g}°; field angles must ascend within 0 … 90 degrees"
            )
        if not callable(self.radiance):
            _check_radiance("sky", self.radiance)

    def breaks(self) -> tuple[float, ...]:
        """Return the two field angles between which the sky lies, radians."""
        return np.radians(self.from_deg), np.radians(self.to_deg)

    def around(self, theta: np.ndarray, centre: float, half: float) -> np.ndarray:
        """
        Return the integral of radiance over an arc of azimuth, (q,), W rad/(mm² sr), see `ExtendedSource.around`.

        A radiance given as a function is integrated by the midpoint rule.

        Raises
        ------
        MistrayError
            If a radiance given as a function is negative, not finite or of the wrong shape.
        """
        if not callable(self.radiance):
            return np.full(len(theta), 2 * half * self.radiance)
        count = max(int(np.ceil(AZIMUTHS * half / np.pi)), 16)
        azimuth = centre + half * ((2 * np.arange(count) + 1) / count - 1)
        grid = np.broadcast_arrays(np.degrees(theta)[:, None], np.degrees(azimuth) % 360)
        value = np.asarray(self.radiance(*grid), dtype=np.float64)
        if value.shape not in ((), grid[0].shape) or not np.all(np.isfinite(value)) or np.any(value < 0):
            raise MistrayError(
                "the radiance of the sky is negative, not finite or of the wrong shape somewhere; its function must "
                "give one number ≥ 0 for each direction"
            )
        return np.broadcast_to(value, grid[0].shape).sum(axis=1) * (2 * half / count)


Sky = SkyRadiance  # its name before version 0.3


@known_arguments
@dataclass(frozen=True)
class Disc:
    """
    Disc of uniform radiance in the sky: the Earth, the Moon, the sun, a distant lamp.

    Attributes
    ----------
    radius_deg : float
        Angular radius, 0 … 90 degrees: the angle between its centre and its limb.
    radiance : float
        Radiance, W/(mm² sr).
    field_deg, azimuth_deg : float
        Direction of its centre, degrees, as for `mistray.pst`. The field angle is 0 … 180, so that the disc may reach
        into the field from behind.
    name : str
        Name for messages.
    """

    radius_deg: float
    radiance: float
    field_deg: float = 0.0
    azimuth_deg: float = 0.0
    name: str = "disc"

    def __post_init__(self) -> None:
        if not 0 < self.radius_deg <= 90:
            raise MistrayError(f"{self.name}: radius_deg is {self.radius_deg:g}; it must lie between 0 and 90 degrees")
        if not 0 <= self.field_deg <= 180 or not np.isfinite(self.azimuth_deg):
            raise MistrayError(
                f"{self.name}: its centre is at {self.field_deg:g}°, azimuth {self.azimuth_deg:g}°; the field angle "
                "must lie between 0 and 180 degrees"
            )
        _check_radiance(self.name, self.radiance)

    def breaks(self) -> tuple[float, ...]:
        """
        Return field angles, rad, at which the disc begins and ends in the plane of its centre.

        0 or π is added if the disc covers the axis there.
        """
        limb = abs(self.field_deg - self.radius_deg), 180 - abs(180 - self.field_deg - self.radius_deg)
        axis = [0.0] if self.field_deg < self.radius_deg else []
        behind = [180.0] if 180 - self.field_deg < self.radius_deg else []
        return tuple(np.radians(sorted({*axis, *limb, *behind})))

    def around(self, theta: np.ndarray, centre: float, half: float) -> np.ndarray:
        """Return the radiance integrated over an arc of azimuth, (q,), W rad/(mm² sr), see `ExtendedSource.around`."""
        radius, away = np.radians(self.radius_deg), np.radians(self.field_deg)
        sines = np.maximum(np.sin(theta) * np.sin(away), np.finfo(float).tiny)
        with np.errstate(over="ignore"):
            cosine = (np.cos(radius) - np.cos(theta) * np.cos(away)) / sines
        own = np.arccos(np.clip(cosine, -1, 1))  # half of the arc at this field angle
        apart = (np.radians(self.azimuth_deg) - centre + np.pi) % (2 * np.pi) - np.pi
        arc = np.zeros(len(theta))
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            arc += np.maximum(np.minimum(apart + turn + own, half) - np.maximum(apart + turn - own, -half), 0)
        return self.radiance * arc


@known_arguments
def sun(
    field_deg: float, azimuth_deg: float = 0.0, irradiance_W_mm2: float = SUN_W_MM2, diameter_deg: float = SUN_DEG
) -> Disc:
    """
    Return the disc of the sun with a uniform radiance.

    Parameters
    ----------
    field_deg, azimuth_deg : float
        Direction of its centre, degrees.
    irradiance_W_mm2 : float
        Irradiance on a plane normal to its light, W/mm²; the default is for all wavelengths, give that of your band.
    diameter_deg : float
        Angular diameter, degrees.

    Returns
    -------
    Disc
        Disc of radiance L = E / (π sin²(diameter/2)), W/(mm² sr).

    Raises
    ------
    MistrayError
        If the diameter is not between 0 and 180 degrees, or the irradiance or the direction is impossible.
    """
    if not 0 < diameter_deg <= 180:
        raise MistrayError(f"sun: diameter_deg is {diameter_deg:g}; it must lie between 0 and 180 degrees")
    solid = np.pi * np.sin(np.radians(0.5 * diameter_deg)) ** 2
    return Disc(0.5 * diameter_deg, irradiance_W_mm2 / float(solid), field_deg, azimuth_deg, "sun")


def _check_radiance(name: str, radiance: float) -> None:
    if not np.isfinite(radiance) or radiance < 0:
        raise MistrayError(f"{name}: its radiance is {radiance:g} W/(mm² sr); it must be finite and not negative")


@dataclass(frozen=True)
class Cover:
    """
    Integral of a source's radiance over the cells of a PST.

    Attributes
    ----------
    coefficients : (n, m) float64
        Factor of the PST_normal of each cell, W/mm². The sum of all products is the irradiance on the detector, W/mm².
    total : float
        Integral of the radiance over the whole source, W/mm².
    covered, interpolated : float
        Fractions of `total` within cells, and between cells where the PST is interpolated.
    """

    coefficients: np.ndarray
    total: float
    covered: float
    interpolated: float


def cover(
    grid: DirectionGrid, source: ExtendedSource, interpolation: str = "cells", curve: np.ndarray | None = None
) -> Cover:
    """
    Return the integral of a source's radiance over the cells of a PST grid.

    Parameters
    ----------
    grid : DirectionGrid
        Cells of field angle and azimuth.
    source : ExtendedSource
        Source whose radiance is integrated.
    interpolation : {"cells", "linear", "log"}
        "cells": the PST is constant over a cell and 0 between cells. "linear": linear in field angle between
        the middles of the cells, gaps included. "log": the logarithm is linear, if both values are positive. In
        azimuth the PST is constant over a cell and 0 between cells.
    curve : (n, m) float64, optional
        PST_normal, required for "log": the coefficients are then the derivatives of the integral with respect to the
        PST of the cells. Because the integral is homogeneous in the PST, they give its value as well.

    Raises
    ------
    MistrayError
        If no cell contains any of the source, the source is dark, or the interpolation is unknown.
    """
    if interpolation not in INTERPOLATIONS:
        raise MistrayError(f"interpolation is '{interpolation}'; use 'cells', 'linear' or 'log'")
    edges, centres = np.radians(grid.edges_deg), np.radians(grid.field_deg)
    breaks = source.breaks()
    theta, weight = _quadrature(breaks, np.concatenate([edges.ravel(), centres]))
    total = float(np.sum(weight * source.around(theta, 0.0, np.pi)))
    if not total > 0:
        raise MistrayError("the source is dark; give a radiance greater than 0")

    # Cell, if any, and the two middles that a field angle lies between
    cell = np.clip(np.searchsorted(edges[:, 0], theta, side="right") - 1, 0, None)
    inside = (theta >= edges[cell, 0]) & (theta <= edges[cell, 1])
    first = np.clip(np.searchsorted(centres, theta) - 1, 0, max(len(centres) - 2, 0))
    second = np.minimum(first + 1, len(centres) - 1)
    between = ~inside & (theta > centres[0]) & (theta < centres[-1]) & (interpolation != "cells")
    apart = np.where(second > first, centres[second] - centres[first], 1.0)
    share = np.clip((theta - centres[first]) / apart, 0, 1)  # beyond the outer middles the value of the cell

    coefficients = np.zeros(grid.shape)
    covered = interpolated = 0.0
    half = np.radians(0.5 * grid.azimuth_cell_deg)
    for j, azimuth in enumerate(np.radians(grid.azimuths_deg)):
        light = weight * source.around(theta, float(azimuth), half)
        covered += float(np.sum(light[inside]))
        interpolated += float(np.sum(light[between]))
        if interpolation == "cells":
            np.add.at(coefficients[:, j], cell[inside], light[inside])
            continue
        parts = 1 - share, share
        if interpolation == "log":
            assert curve is not None
            parts = _log_parts(curve[first, j], curve[second, j], share)
        known = inside | between
        for rows, part in zip((first, second), parts, strict=True):
            np.add.at(coefficients[:, j], rows[known], (light * part)[known])
    if not covered + interpolated > 0:
        raise MistrayError(
            f"the source lies between {np.degrees(breaks[0]):.4g} and {np.degrees(breaks[-1]):.4g}° and no cell of the "
            f"PST holds any of it; its cells reach from {grid.edges_deg.min():g} to {grid.edges_deg.max():g}°"
        )
    return Cover(coefficients, total, covered / total, interpolated / total)


def _log_parts(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the derivatives of the interpolation a^(1-t) b^t with respect to a and to b, with t = `share`.

    Unless both are positive, it is linear.
    """
    good = (a > 0) & (b > 0)
    ratio = np.log(np.where(good, b, 1) / np.where(good, a, 1))
    return (
        np.where(good, (1 - share) * np.exp(share * ratio), 1 - share),
        np.where(good, share * np.exp((share - 1) * ratio), share),
    )


def _quadrature(breaks: tuple[float, ...], more: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return field angles, rad, and weights, (q,) each, for integrals over solid angle; the weights include sin θ.

    Panels end at the breaks of the source and at `more`, rad. In each the rule is that of Gauss and Legendre in t with
    θ = a + (b - a)(1 - cos t)/2, which removes the square roots at the limb of a disc.
    """
    cuts = np.unique(np.concatenate([breaks, more[(more > breaks[0]) & (more < breaks[-1])]]))
    parts = np.maximum(np.ceil(np.degrees(np.diff(cuts)) / PANEL_DEG).astype(int), 1)
    panels = [np.linspace(a, b, count + 1) for a, b, count in zip(cuts[:-1], cuts[1:], parts, strict=True)]
    start = np.concatenate([panel[:-1] for panel in panels])
    half = 0.5 * (np.concatenate([panel[1:] for panel in panels]) - start)
    x, w = np.polynomial.legendre.leggauss(NODES)
    t = 0.5 * np.pi * (x + 1)
    theta = (start[:, None] + half[:, None] * (1 - np.cos(t))).ravel()
    return theta, (half[:, None] * (0.5 * np.pi * w * np.sin(t))).ravel() * np.sin(theta)


def source_irradiance(
    pst: Pst, source: ExtendedSource, classes: Light = "stray", interpolation: str = "cells"
) -> StrayMetric:
    """
    Return the irradiance on the detector from an extended source, W/mm².

    Parameters
    ----------
    pst : Pst
        PST in either convention.
    source : ExtendedSource
        `SkyRadiance`, `Disc`, `sun` …
    classes : str or sequence of str
        Light that counts, see `Pst.samples`.
    interpolation : {"cells", "linear", "log"}
        See `cover`. "cells" is right if the cells leave no gap; for a sun of 0.5° in cells of 2° the others show
        the effect of its position within the cell.

    Returns
    -------
    StrayMetric
        Irradiance, W/mm², with the fractions of the source within cells and between them.

    Raises
    ------
    MistrayError
        If no cell contains any of the source, the source is dark, the interpolation or a class is unknown, or a cell
        that counts was not traced.
    """
    normal = pst.to("normal")
    curve = normal.map(classes)[0] if interpolation == "log" else None
    seen = cover(pst.grid, source, interpolation, curve)
    light = "+".join(several(classes))
    facts = {"light": light, "interpolation": interpolation, "source_W_mm2_sr": str(source)}
    return StrayMetric.of(
        "irradiance",
        weighted_sum(normal, seen.coefficients, classes),
        "W/mm2",
        {"light": light},
        covered=seen.covered,
        interpolated=seen.interpolated,
        facts=facts,
    )

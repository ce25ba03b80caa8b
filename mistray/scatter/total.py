"""Total scatter of a surface: totals of lobes over the hemisphere, and the budget R + T + A + scatter = 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mistray.errors import MistrayError
from mistray.scatter.lobe import Lobe, LobeModel, RatioTable, factor
from mistray.scatter.radial import OCTAVES, R_MAX, RadialTable

ROUNDING = 1e-6  # rounding error by which the sum of a surface's fractions may exceed 1
CUT_NODES, ARC_NODES, NODES_PER_OCTAVE = 96, 32, 4
ANISOTROPIC_ARC_NODES = 80
_GAUSS = np.polynomial.legendre.leggauss(NODES_PER_OCTAVE)


def specular_cosine(event: str, cos_i: np.ndarray, n_in: float, n_out: float) -> np.ndarray:
    """
    Return the cosine with the normal of the specular direction, at cosines of incidence.

    For transmission it is the refracted direction, and the cosine is 0 in total reflection.
    """
    if event == "reflection":
        return cos_i
    return np.sqrt(np.maximum(0.0, 1 - (n_in / n_out) ** 2 * (1 - cos_i * cos_i)))


def lobe_total(
    lobe: Lobe,
    cos_i: np.ndarray,
    n_in: float,
    n_out: float,
    table: RadialTable | None = None,
    rotation: float = 0.0,
) -> np.ndarray:
    """
    Return the flux of a lobe over the hemisphere per unit of incident flux and of its coefficient c.

    Parameters
    ----------
    lobe : Lobe
        Lobe to integrate.
    cos_i : (m,) float64
        Cosines of the angles of incidence.
    n_in, n_out : float
        Refractive indices on the side of incidence and on the other side.
    table : RadialTable, optional
        Table of the lobe's profile, if it is already made.
    rotation : float
        Rotation of the sample, rad, as in `RatioTable`; used by an anisotropic lobe only.

    Returns
    -------
    (m,) float64
        Total integrated scatter of the lobe. In transmission it is 0 for totally reflected light, unless the lobe is
        centred at the normal.
    """
    table = table or RadialTable.of(lobe.profile, lobe.r_max)
    cos_i = np.asarray(cos_i, dtype=np.float64)
    cosine = np.ones_like(cos_i) if lobe.centre == "normal" else specular_cosine(lobe.event, cos_i, n_in, n_out)
    if lobe.measure == "angle":
        values = _by_angle(table, cosine, lobe.factor == "cosine") * lobe.oblique(cos_i)
    elif lobe.factor == "none" and lobe.ratio is None:
        values = _by_cosines(table, cosine)
    else:
        shape = lobe.event, lobe.centre, lobe.factor, lobe.ratio
        ratio = 1.0 if lobe.event == "reflection" else n_out / n_in  # one table for light of both sides
        rings = _rings if lobe.fixed else _recent_rings
        r, weight, first = rings(*shape, cos_i.tobytes(), ratio, rotation if lobe.anisotropic else 0.0)
        values = np.add.reduceat(weight * table.value(r), first)
    if lobe.event == "transmission" and lobe.centre != "normal":
        values = np.where(n_in * np.sqrt(np.maximum(0, 1 - cos_i**2)) >= n_out, 0.0, values)
    return values


@lru_cache(maxsize=8)
def _smooth_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights on 0 … 1, (count,) each, of a quadrature for square-root singularities at both ends."""
    x, w = np.polynomial.legendre.leggauss(count)
    t = 0.5 * (x + 1)
    return t * t * (3 - 2 * t), 0.5 * w * 6 * t * (1 - t)


def _ring_nodes(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return radii and weights, (m, CUT_NODES), of integrals over the radius r from low to high, (m,).

    In log r the radii are the nodes of `_smooth_nodes`.
    """
    t, w = _smooth_nodes(CUT_NODES)
    span = np.log(high / low)[:, None]
    r = low[:, None] * np.exp(span * t)
    return r, w * span * r


def _by_cosines(table: RadialTable, cosine: np.ndarray) -> np.ndarray:
    """
    Return the integrals, (m,), of a radial profile about sin θ over the unit disc of direction cosines.

    `cosine` is cos θ, (m,).
    """
    b = np.sqrt(np.maximum(0.0, 1 - cosine * cosine))
    # 1 - b without cancellation at grazing incidence
    low = np.maximum(cosine * cosine / (1 + b), 1e-12)
    high = np.minimum(1 + b, R_MAX)
    r, weight = _ring_nodes(low, np.maximum(high, low))
    with np.errstate(divide="ignore", invalid="ignore"):
        arc = 2 * np.arccos(np.clip((r * r + (b * b - 1)[:, None]) / (2 * b[:, None] * r), -1, 1))
    arc = np.where(b[:, None] > 0, arc, 0.0)
    return np.asarray(table.within(np.minimum(low, R_MAX)) + np.sum(weight * r * arc * table.value(r), axis=1))


def _by_angle(table: RadialTable, cosine: np.ndarray, projected: bool) -> np.ndarray:
    """
    Return the integrals over the hemisphere, (m,), of a profile of the chord from the direction at the angle θ.

    `cosine` is cos θ, (m,). The profile is multiplied by cos θs if `projected`.
    """
    theta = np.arccos(np.clip(cosine, -1, 1))
    low = np.maximum(2 * np.sin((np.pi / 2 - theta) / 2), 1e-12)
    high = 2 * np.sin((np.pi / 2 + theta) / 2)
    r, weight = _ring_nodes(low, np.maximum(high, low))
    alpha = 2 * np.arcsin(np.minimum(r / 2, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(np.clip(-1 / (np.tan(alpha) * np.tan(theta)[:, None]), -1, 1))
    half = np.where(theta[:, None] > 0, half, 0.0)
    if not projected:
        return np.asarray(table.within(low) + np.sum(weight * r * 2 * half * table.value(r), axis=1))
    # cos θs = cos θ cos α + sin θ sin α cos ψ, and cos α = 1 - r²/2
    whole = cosine * (table.within(low) - 0.5 * table.times_r2().within(low))
    over_arc = half * cosine[:, None] * np.cos(alpha) + np.sin(theta)[:, None] * np.sin(alpha) * np.sin(half)
    return np.asarray(whole + np.sum(weight * r * 2 * over_arc * table.value(r), axis=1))


@lru_cache(maxsize=128)
def _rings(
    event: str,
    centre: str,
    factor: str,
    ratio: RatioTable | None,
    cosines: bytes,
    index_ratio: float,
    rotation: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return radii and weights that give the integral of `_by_cosines` with a factor or a ratio, for any profile.

    Parameters
    ----------
    event, centre, factor, ratio
        Fields of `Lobe`.
    cosines : bytes
        Cosines of the angles of incidence, (m,) float64.
    index_ratio : float
        Ratio n_out/n_in of the refractive indices; not used in reflection.
    rotation : float
        Rotation of the sample, rad.

    Returns
    -------
    r, weight : (k,) float64
        Radii of all angles of incidence, one after the other, and the weights of the profile there.
    first : (m,) int
        Position of the first radius of each angle of incidence.
    """
    lobe = Lobe(event, np.ones_like, centre=centre, factor=factor, ratio=ratio)
    cos_i = np.frombuffer(cosines)
    specular = specular_cosine(event, cos_i, 1.0, index_ratio)
    cosine = np.ones_like(cos_i) if centre == "normal" else specular
    found = [_ring_weights(lobe, *row, rotation) for row in zip(cos_i, cosine, specular, strict=True)]
    first = np.cumsum([0, *(len(r) for r, _ in found[:-1])])
    return np.concatenate([r for r, _ in found]), np.concatenate([w for _, w in found]), first


_recent_rings = lru_cache(maxsize=16)(_rings.__wrapped__)  # for ratio tables that change with a model's parameters


def _ring_weights(
    lobe: Lobe, cos_i: float, cosine: float, cos_specular: float, rotation: float
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return radii r and weights, (k,) each, of the sum of `_rings` at one incidence and sample rotation, rad.

    `cosine` and `cos_specular` are the cosines of the lobe's centre and of the specular direction with the normal.
    """
    b = float(np.sqrt(max(0.0, 1 - cosine * cosine)))
    edge = max(cosine * cosine / (1 + b), 1e-12)
    # Whole circles by octaves, the last one with nodes that take the square root at the horizon; then cut circles
    first = R_MAX * 2.0**-OCTAVES
    panels = max(2, int(np.ceil(np.log2(max(edge / 2, 2 * first) / first))))
    span = np.log(max(edge / 2, 2 * first) / first) / panels
    x, w = _GAUSS
    inner = first * np.exp(span * (np.arange(panels)[:, None] + 0.5 * (1 + x)).ravel())
    outer = [(edge / 2, edge), (edge, max(min(1 + b, R_MAX), edge))]
    rings = [_ring_nodes(np.array([low]), np.array([high])) for low, high in outer]
    r = np.concatenate([inner, *(ring[0][0] for ring in rings)])
    weight = np.concatenate([np.tile(0.5 * w * span, panels) * inner, *(ring[1][0] for ring in rings)])
    # Half the arc of directions above the horizon: ψ from `start` to π, twice for the other side of the plane
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(np.clip((r * r + b * b - 1) / (2 * b * r), -1, 1)) if b > 0 else np.where(r < 1, np.pi, 0.0)
    start = np.pi - half
    t, wt = _smooth_nodes(ANISOTROPIC_ARC_NODES if lobe.anisotropic else ARC_NODES)
    psi = start[:, None] + half[:, None] * t
    beta2 = b * b + r[:, None] ** 2 + 2 * b * r[:, None] * np.cos(psi)
    cos_s = np.sqrt(np.maximum(0.0, 1 - beta2))
    values = factor(lobe.factor, cos_i, cos_s, cosine, r[:, None] ** 2)
    if lobe.ratio is not None:
        second, azimuth = r[:, None], psi
        if lobe.ratio.axes == "cosines":
            second, azimuth = cos_s, np.arctan2(r[:, None] * np.sin(psi), b + r[:, None] * np.cos(psi))
        sides = (azimuth, -azimuth) if lobe.anisotropic else (azimuth,)
        ratios = [lobe.ratio.at(np.asarray(cos_specular), second, angle, rotation) for angle in sides]
        values = values * np.mean(ratios, axis=0)
    over_arc = 2 * half * np.sum(wt * values, axis=1)
    return r, weight * r * over_arc


@dataclass(frozen=True)
class Totals:
    """
    Total scatter and specular loss of all models of a surface, for light from one side at (m,) angles of incidence.

    Attributes
    ----------
    loss : dict
        Fraction of its flux that the specular beam loses, (m,), by event.
    terms : dict
        Coefficients (3, m) by event: the scattered fraction of the incident flux is terms[0] + terms[1] X + terms[2]
        X², where X is R or T.
    """

    loss: dict[str, np.ndarray]
    terms: dict[str, np.ndarray]

    def scattered(self, event: str, x: np.ndarray) -> np.ndarray:
        """Return the scattered fraction of the incident flux at each angle, (m,), for R or T = x, (m,)."""
        c0, c1, c2 = self.terms[event]
        return np.asarray(c0 + c1 * x + c2 * x * x)


def totals(
    lobes: Sequence[Lobe],
    cos_i: np.ndarray,
    n_in: float,
    n_out: float,
    tables: Sequence[RadialTable] | None = None,
    rotation: float = 0.0,
) -> Totals:
    """
    Return the total scatter and specular loss of several lobes together, at each angle of incidence.

    Parameters
    ----------
    lobes : sequence of Lobe
        Lobes to add.
    cos_i : (m,) float64
        Cosines of the angles of incidence.
    n_in, n_out : float
        Refractive indices on the side of incidence and on the other side.
    tables : sequence of RadialTable, optional
        Tables of the lobes' profiles, if they are already made.
    rotation : float
        Rotation of the sample, rad, as in `RatioTable`.
    """
    cos_i = np.asarray(cos_i, dtype=np.float64)
    loss = {event: np.zeros(len(cos_i)) for event in ("reflection", "transmission")}
    terms = {event: np.zeros((3, len(cos_i))) for event in ("reflection", "transmission")}
    for k, lobe in enumerate(lobes):
        total = lobe_total(lobe, cos_i, n_in, n_out, tables[k] if tables else None, rotation)
        terms[lobe.event] += np.array(lobe.shares)[:, None] * total
        lost = lobe.shares[1] * total if lobe.optical_depth is None else lobe.optical_depth * lobe.oblique(cos_i)
        loss[lobe.event] += lost
    return Totals(loss, terms)


def check_loss(title: str, event: str, sums: Totals, cos_i: np.ndarray, lit: np.ndarray | bool = True) -> None:
    """
    Check that scatter takes no more light from a specular beam than it has.

    Parameters
    ----------
    title : str
        Name of the scattering object.
    event : {"reflection", "transmission"}
        Event of the specular beam.
    sums : Totals
        Totals of its lobes.
    cos_i : (m,) float64
        Cosines of the angles of incidence.
    lit : (m,) bool
        Whether there is a specular beam at each angle.

    Raises
    ------
    MistrayError
        If the beam would lose more than all of its light at an angle where there is one.
    """
    lost = np.where(lit, sums.loss[event], 0.0)
    worst = int(np.argmax(lost))
    if not lost[worst] <= 1 + ROUNDING:
        raise MistrayError(
            f"{title}: at {_degrees(cos_i[worst]):.3g}° scatter takes {lost[worst]:.4g} of the specular {event}, which "
            "is more than there is; make it weaker"
        )


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, 0, 1))))


def check_budget(
    title: str, sums: Totals, cos_i: np.ndarray, reflectance: np.ndarray, transmittance: np.ndarray
) -> np.ndarray:
    """
    Return the fraction of the incident light that a scattering surface absorbs, 1 - specular - scattered, (m,).

    Parameters
    ----------
    title : str
        Name of the surface and the side of incidence, for messages.
    sums : Totals
        Totals of the surface's lobes.
    cos_i, reflectance, transmittance : (m,) float64
        Cosines of the angles of incidence, and R and T of the coating before scatter.

    Raises
    ------
    MistrayError
        If the specular beam would lose more than it has, or the fractions add up to more than 1; the message names
        surface and angle.
    """
    for event, x in (("reflection", reflectance), ("transmission", transmittance)):
        check_loss(title, event, sums, cos_i, x > 0)
    scattered = sums.scattered("reflection", reflectance) + sums.scattered("transmission", transmittance)
    specular = reflectance * (1 - sums.loss["reflection"]) + transmittance * (1 - sums.loss["transmission"])
    worst = int(np.argmax(scattered + specular))
    if scattered[worst] + specular[worst] > 1 + ROUNDING:
        raise MistrayError(
            f"{title}: at {_degrees(cos_i[worst]):.3g}° specular {specular[worst]:.4g} + scattered "
            f"{scattered[worst]:.4g} is more than 1; lower R, T or the scatter"
        )
    return np.asarray(1 - specular - scattered)


def model_lobes(
    models: Sequence[LobeModel], wavelength_nm: float, n_in: float, n_out: float, from_front: bool
) -> tuple[Lobe, ...]:
    """Return the lobes of all scatter models of a surface for light from one side."""
    return tuple(lobe for model in models for lobe in model.lobes(wavelength_nm, n_in, n_out, from_front))

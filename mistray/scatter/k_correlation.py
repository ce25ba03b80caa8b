"""A surface given by its roughness spectrum, the K-correlation model, and a theory of how it scatters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from mistray.errors import MistrayError
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack, k_correlation, rayleigh_rice
from mistray.scatter.harvey_shack import index_step, need_smooth
from mistray.scatter.lobe import Lobe, Placement, RatioTable
from mistray.scatter.numbers import need_not_negative, need_positive

THEORIES = ("ghs", "ghs_full", "rayleigh_rice", "rayleigh_rice_vector")
MAX_FULL_PHASE = 2.0
"""Largest 2π Δn σ/λ of the theory "ghs_full": there the specular beam keeps 1.8 % of its light."""

GRAZING = 1e-3  # the least cosine in tables: of T, which is 0 at grazing incidence, they hold ratios
# Of the tables' variables: cosine of the specular direction, cosine of the scattered direction and azimuth, or log r
# and ψ. Refraction into glass puts the last ten degrees of incidence between few cosines of the refracted beam.
SCALAR, REFRACTED = (257, 129, 2), (257, 129, 13)
REFLECTED = (65, 65, 33)
RADIAL, R_MIN = (49, 121, 49), 1e-3


def substrate_index(text: str, title: str) -> complex:
    """N + ik of a substrate from its text, ``0.96+6.69i``; the error message starts with `title`."""
    try:
        return complex(text.replace(" ", "").replace("i", "j"))
    except ValueError:
        raise MistrayError(f"{title}: substrate is '{text}'; write n+ik as 0.96+6.69i") from None


@dataclass(frozen=True, eq=False)
class Directions:
    """
    Arrays that say where light comes from and goes to; they broadcast together.

    Attributes
    ----------
    cos_i, cos_specular, cos_s : float64
        Cosines with the normal of the incident, the specular and the scattered direction, in their own media.
    cos_phi : float64
        Cosine of the azimuth between the specular and the scattered direction.
    r : float64
        |β - β0|.
    """

    cos_i: np.ndarray
    cos_specular: np.ndarray
    cos_s: np.ndarray
    cos_phi: np.ndarray
    r: np.ndarray


@dataclass(frozen=True)
class KCorrelation(Placement):
    """
    Roughness spectrum A'/(1 + (B f)²)^(S/2), the same for both events and from both sides.

    The scatter of each event and side follows from its own path difference per height of the surface. β is taken in the
    medium of the scattered light, where its spatial frequency is f = n |β - β0|/λ. Equations and sources:
    `mistray.physics.k_correlation`, `mistray.physics.generalized_harvey_shack` and `mistray.physics.rayleigh_rice`.

    Attributes
    ----------
    rms_nm : float
        σ, nm, ≥ 0: over all spatial frequencies, or over 0 … 1/λ if `band_limited`.
    B_um : float
        B, µm, > 0: 1/B is the frequency of the knee.
    slope : float
        S, > 2 for a total roughness, > 0 for a band-limited one. 3 is the surface with an exponential autocovariance of
        length B/2π.
    band_limited : bool
        What `rms_nm` means.
    theory : {"ghs", "ghs_full", "rayleigh_rice", "rayleigh_rice_vector"}
        Generalised Harvey-Shack for smooth surfaces; the same for rougher ones (slope 3 and total roughness only);
        Rayleigh-Rice with R as polarisation factor (reflection only); the same with the vector Q of a bare surface. In
        transmission the last one alone is right far from the specular direction, where the others are too low.
    reference_nm : float, optional
        λ of the band of `rms_nm`, a vacuum wavelength. Without it, the wavelength of the light: then the spectrum of
        the surface changes with it. Only with `band_limited`.
    substrate : complex, optional
        n + ik of what reflects, for "rayleigh_rice_vector", where it is not the medium on the other side: of a mirror.

    Raises
    ------
    MistrayError
        If a number is out of range or parameters do not go together. `lobes` raises it for a surface that is too rough
        for the theory at a wavelength.
    """

    rms_nm: float
    B_um: float
    slope: float
    band_limited: bool = False
    theory: str = "ghs"
    reference_nm: float | None = None
    substrate: complex | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        need_not_negative(self.title, "rms_nm", self.rms_nm, " nm")
        need_positive(self.title, "B_um", self.B_um, " um")
        need_positive(self.title, "slope", self.slope)
        if self.slope <= 2 and not self.band_limited:
            raise MistrayError(
                f"{self.title}: slope is {self.slope:g}, whose total roughness is infinite; give slope > 2 or "
                "band_limited"
            )
        if self.theory not in THEORIES:
            raise MistrayError(
                f"{self.title}: theory is '{self.theory}'; use {', '.join(THEORIES[:-1])} or {THEORIES[-1]}"
            )
        if self.theory == "ghs_full" and (self.slope != 3 or self.band_limited):
            raise MistrayError(f"{self.title}: theory ghs_full needs slope 3 and a total roughness; use ghs for others")
        if self.theory == "rayleigh_rice" and self.event != "reflection":
            raise MistrayError(
                f"{self.title}: theory rayleigh_rice is about reflection, event is '{self.event}'; set event to "
                "'reflection' or theory to rayleigh_rice_vector"
            )
        if self.reference_nm is not None:
            need_positive(self.title, "reference_nm", self.reference_nm, " nm")
            if not self.band_limited:
                raise MistrayError(f"{self.title}: reference_nm goes with band_limited; leave it out or set that")
        if self.substrate is not None:
            if self.theory != "rayleigh_rice_vector":
                raise MistrayError(f"{self.title}: substrate goes with theory rayleigh_rice_vector; leave it out")
            n = complex(self.substrate)
            if not (math.isfinite(n.real) and math.isfinite(n.imag) and n.real > 0 and n.imag >= 0):
                raise MistrayError(f"{self.title}: substrate is {n:g}; give n + ik with n > 0 and k ≥ 0")

    def amplitude_um4(self, wavelength_nm: float) -> float:
        """A' of the roughness spectrum, µm⁴; depends on the wavelength, nm, only where the band of `rms_nm` does."""
        rms_um = self.rms_nm * 1e-3
        if not self.band_limited:
            return float(k_correlation.amplitude_um4(rms_um, self.B_um, self.slope))
        band_um = (self.reference_nm or wavelength_nm) * 1e-3
        return float(k_correlation.band_amplitude_um4(rms_um, self.B_um, self.slope, band_um))

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        """At most one lobe for each event; parameters as in `mistray.scatter.lobe.Scatter.lobes`."""
        if self.rms_nm == 0:
            return ()
        make = {
            "ghs": self._smooth,
            "ghs_full": self._full,
            "rayleigh_rice": self._scalar,
            "rayleigh_rice_vector": self._vector,
        }[self.theory]
        return tuple(
            make(event, wavelength_nm, n_in, n_out)
            for event in self.events(from_front)
            if index_step(event, n_in, n_out) > 0
        )

    def advice(self) -> str | None:
        """What is unusual about the slope, in one line, or nothing: polished surfaces have 1.5 … 3.5."""
        if 1.5 <= self.slope <= 3.5:
            return None
        return f"{self.title}: slope {self.slope:g} is outside of what is usual, 1.5 … 3.5"

    def _spectrum(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Callable:
        """PSD over r, µm⁴, after the check that the surface is smooth."""
        amplitude = self.amplitude_um4(wavelength_nm)
        wavelength_um, n = wavelength_nm * 1e-3, n_in if event == "reflection" else n_out
        rms_um = k_correlation.relevant_rms_um(amplitude, self.B_um, self.slope, wavelength_um / n)
        remedy = "use theory ghs_full, with slope 3"
        need_smooth(self.title, event, rms_um, wavelength_um, index_step(event, n_in, n_out), remedy)
        return lambda r: k_correlation.psd_um4(n * r / wavelength_um, amplitude, self.B_um, self.slope)

    def _smooth(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """First order of the generalised Harvey-Shack theory."""
        psd = self._spectrum(event, wavelength_nm, n_in, n_out)
        wavelength_um, step = wavelength_nm * 1e-3, index_step(event, n_in, n_out)
        n = n_in if event == "reflection" else n_out

        def profile(r: np.ndarray) -> np.ndarray:
            return np.asarray(ghs.smooth(step, psd(r), wavelength_um, n))

        if event == "reflection":
            return Lobe(event, profile, shares=self.shares, factor="ghs")
        return Lobe(event, profile, shares=self.shares, ratio=_path_growth(n_in, n_out))

    def _full(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """The generalised Harvey-Shack theory to all orders, relative to its form at normal incidence."""
        rms_um, wavelength_um = self.rms_nm * 1e-3, wavelength_nm * 1e-3
        step, reflected = index_step(event, n_in, n_out), event == "reflection"
        phase = float(harvey_shack.phase_rms(rms_um, wavelength_um, step))
        if phase > MAX_FULL_PHASE:
            raise MistrayError(
                f"{self.title}: rms roughness {self.rms_nm:g} nm is too much in {event} at {wavelength_nm:g} nm (2π Δn "
                f"σ/λ is {phase:.3g}, limit {MAX_FULL_PHASE:g}); use a paint or a table of measured values"
            )
        n, length = n_in if reflected else n_out, self.B_um / (2 * math.pi)

        def bsdf(path: np.ndarray | float, r: np.ndarray) -> np.ndarray:
            return np.asarray(ghs.exponential(path, n * r / wavelength_um, rms_um, length, wavelength_um, n))

        def ratio(at: Directions) -> np.ndarray:
            path = ghs.path_in_reflection(at.cos_i, at.cos_s, n_in)
            if not reflected:
                path = ghs.path_in_transmission(at.cos_i, at.cos_s, n_in, n_out)
            return bsdf(path, at.r) / bsdf(step, at.r)

        table = _over_radius(ratio, 1.0 if reflected else n_out / n_in)
        return Lobe(event, lambda r: bsdf(step, r), shares=self.shares, ratio=table)

    def _scalar(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """The Rayleigh-Rice theory with R of the coating as polarisation factor."""
        psd, in_medium_um = self._spectrum(event, wavelength_nm, n_in, n_out), wavelength_nm * 1e-3 / n_in
        return Lobe(
            event,
            lambda r: np.asarray(rayleigh_rice.brdf(1.0, 1.0, 1.0, psd(r), in_medium_um)),
            shares=self.shares,
            factor="rayleigh_rice",
        )

    def _vector(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """The Rayleigh-Rice theory with Q, over R or T of the bare surface if that of the coating is multiplied."""
        absolute = self.relative_to == "incident"
        if event == "reflection":
            index = (self.substrate or n_out) / n_in
            if index == 1:
                raise MistrayError(
                    f"{self.title}: indices are {n_in:g} on both sides, which has no reflection; give the substrate, "
                    "or event 'transmission'"
                )
            lobe = self._scalar(event, wavelength_nm, n_in, n_out)
            return replace(lobe, ratio=_reflected_polarization(index, absolute))
        psd, step = self._spectrum(event, wavelength_nm, n_in, n_out), index_step(event, n_in, n_out)
        return Lobe(
            event,
            lambda r: np.asarray(ghs.smooth(step, psd(r), wavelength_nm * 1e-3, n_out)),
            shares=self.shares,
            ratio=_transmitted_polarization(n_in, n_out, absolute),
        )


# The ratios that no roughness changes: one table for all surfaces between two materials


@lru_cache(maxsize=32)
def _path_growth(n_in: float, n_out: float) -> RatioTable:
    """Square of the path difference in transmission over that at normal incidence."""
    step = index_step("transmission", n_in, n_out)

    def ratio(at: Directions) -> np.ndarray:
        return np.asarray((ghs.path_in_transmission(at.cos_i, at.cos_s, n_in, n_out) / step) ** 2)

    return _over_cosines(ratio, n_out / n_in, SCALAR)


@lru_cache(maxsize=32)
def _reflected_polarization(index: complex, absolute: bool) -> RatioTable:
    """Q of a bare surface in reflection; `index` is relative to the medium of the light."""

    def ratio(at: Directions) -> np.ndarray:
        q = rayleigh_rice.polarization_factor(at.cos_i, at.cos_s, at.cos_phi, index)
        whole = rayleigh_rice.polarization_factor(at.cos_i, at.cos_i, np.ones_like(at.cos_i), index)
        return np.asarray(q if absolute else q / whole)

    return _over_cosines(ratio, 1.0, REFLECTED)


@lru_cache(maxsize=32)
def _transmitted_polarization(n_in: float, n_out: float, absolute: bool) -> RatioTable:
    """Q in transmission, with the square of the path difference over that at normal incidence."""
    step = index_step("transmission", n_in, n_out)

    def ratio(at: Directions) -> np.ndarray:
        q = rayleigh_rice.transmitted_factor(at.cos_i, at.cos_s, at.cos_phi, n_out / n_in)
        whole = rayleigh_rice.transmitted_factor(at.cos_i, at.cos_specular, np.ones_like(at.cos_i), n_out / n_in)
        path = ghs.path_in_transmission(at.cos_i, at.cos_specular, n_in, n_out)
        return np.asarray((path / step) ** 2 * (q if absolute else q / whole))

    return _over_cosines(ratio, n_out / n_in, REFRACTED)


def _over_cosines(
    ratio: Callable[[Directions], np.ndarray], sine_ratio: float, nodes: tuple[int, int, int]
) -> RatioTable:
    """
    Tabulate a function of the directions of incidence and of scatter over their cosines and the azimuth.

    Parameters
    ----------
    ratio : callable
    sine_ratio : float
        sin θi over the sine of the specular direction: n_out/n_in in transmission, 1 in reflection.
    nodes : tuple of int
        Of the cosines of the specular and of the scattered direction, of the azimuth.
    """
    cosine, cos_s = (np.linspace(0, 1, count) for count in nodes[:2])
    cos_i, refracted = _incidence(cosine, sine_ratio)
    cos_phi = np.cos(np.linspace(0, np.pi, nodes[2]))
    first, second, third = np.ix_(np.arange(nodes[0]), cos_s, cos_phi)
    sine, sine_s = np.sqrt(1 - refracted[first] ** 2), np.sqrt(1 - second * second)
    r = np.sqrt(np.maximum(0.0, sine * sine + sine_s * sine_s - 2 * sine * sine_s * third))
    values = ratio(Directions(cos_i[first], refracted[first], second, third, r))
    return RatioTable(np.ascontiguousarray(np.broadcast_to(values, nodes)), axes="cosines", fixed=True)


def _over_radius(ratio: Callable[[Directions], np.ndarray], sine_ratio: float) -> RatioTable:
    """The same over the cosine of the specular direction, log r and ψ, for what depends on r."""
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
    """Cosines of incidence and of the specular direction at nodes of the latter, into some of which no light goes."""
    cosine = np.maximum(cosine, GRAZING)
    cos_i = np.sqrt(np.maximum(GRAZING**2, 1 - sine_ratio**2 * (1 - cosine * cosine)))
    return cos_i, np.sqrt(np.maximum(GRAZING**2, 1 - (1 - cos_i * cos_i) / sine_ratio**2))

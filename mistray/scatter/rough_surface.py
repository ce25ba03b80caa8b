"""Surfaces with a roughness spectrum: scatter theories that apply to any spectrum."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import rayleigh_rice
from mistray.ranges import Demand, Words, shown
from mistray.scatter.harvey_shack import index_step, need_smooth
from mistray.scatter.lobe import Lobe, Placement, RatioTable
from mistray.scatter.ratio_tables import Directions, over_cosines

# Of the tables' variables: cosine of the specular direction, cosine of the scattered direction and azimuth. Refraction
# into glass puts the last ten degrees of incidence between few cosines of the refracted beam.
SCALAR, REFRACTED = (257, 129, 2), (257, 129, 13)
REFLECTED = (65, 65, 33)


THEORIES = ("ghs", "ghs_full", "rayleigh_rice", "rayleigh_rice_vector")


class Substrate(Demand):
    """Parameter check for a refractive index n + ik of a substrate, given as a number or as a string."""

    demand = "must be n+ik with n > 0 and k ≥ 0, as 0.96+6.69i"

    def check(self, name: str, value: Any, owner: str = "") -> complex:
        """Return the index as a complex number; raise `MistrayError` if the value is not an index."""
        n = complex(math.nan)
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            n = complex(value.replace(" ", "").replace("i", "j") if isinstance(value, str) else value)
        if not (math.isfinite(n.real) and math.isfinite(n.imag) and n.real > 0 and n.imag >= 0):
            found = f"{value:g}" if isinstance(value, complex) else shown(value)
            raise MistrayError(f"{owner}: {name} is {found}; it {self.demand}")
        return n


@dataclass(frozen=True)
class RoughSurface(Placement):
    """
    Base of the scatter models with a roughness spectrum.

    The scatter of each event and side follows from its own path difference per height of the surface. β is taken in the
    medium of the scattered light, in which its spatial frequency is f = n |β - β0|/λ. Equations and sources:
    `mistray.physics.generalized_harvey_shack` and `mistray.physics.rayleigh_rice`.

    Attributes
    ----------
    theory : {"ghs", "rayleigh_rice", "rayleigh_rice_vector"}
        Generalised Harvey-Shack for smooth surfaces; Rayleigh-Rice with R as polarisation factor (reflection only); or
        Rayleigh-Rice with the vector factor Q of a bare surface. In transmission far from the specular direction only
        the last one is correct; the others are too low.
    substrate : complex, optional
        Index n + ik of the reflecting material of a mirror, as a number or a string, for "rayleigh_rice_vector". The
        default is the medium beyond the surface.

    Raises
    ------
    MistrayError
        If parameters do not go together. `lobes` raises it for a surface that is too rough for the theory at a
        wavelength.
    """

    _: KW_ONLY
    theory: str = Param(
        "string",
        Words(THEORIES),
        "theory of scatter; ``ghs`` is for smooth surfaces, ``ghs_full``, of ``k_correlation`` with S = 3 alone, for "
        "rougher ones",
    ).field("ghs")
    substrate: complex | None = Param(
        "string", Substrate(), "n+ik of the substrate for ``rayleigh_rice_vector``: ``0.96+6.69i``", otherwise="back"
    ).field(None)

    def __post_init__(self) -> None:
        super().__post_init__()
        theories = list(self._theories())
        if self.theory not in theories:
            raise MistrayError(
                f"{self.title}: theory is '{self.theory}'; use {', '.join(theories[:-1])} or {theories[-1]}"
            )
        if self.theory == "rayleigh_rice" and self.event != "reflection":
            raise MistrayError(
                f"{self.title}: theory rayleigh_rice is about reflection, event is '{self.event}'; set event to "
                "'reflection' or theory to rayleigh_rice_vector"
            )
        if self.substrate is not None and self.theory != "rayleigh_rice_vector":
            raise MistrayError(f"{self.title}: substrate goes with theory rayleigh_rice_vector; leave it out")

    def psd(self, wavelength_nm: float) -> Callable[[np.ndarray], np.ndarray]:
        """
        Return the two-dimensional roughness spectrum: a function of the spatial frequency, 1/µm → µm⁴.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm, for spectra whose amplitude depends on it.
        """
        raise NotImplementedError

    def relevant_rms_um(self, wavelength_nm: float, n: float) -> float:
        """
        Return the rms roughness, µm, in the spatial frequencies 0 … n/λ that scatter light at normal incidence.

        `n` is the index of the medium of the scattered light, and `wavelength_nm` the vacuum wavelength, nm.
        """
        raise NotImplementedError

    @property
    def is_smooth_as_glass(self) -> bool:
        """True if the surface has no roughness at all."""
        raise NotImplementedError

    rougher = "use a paint or a table of measured values"
    """Advice in the error message for a surface that is too rough."""

    def _theories(self) -> Mapping[str, Callable[[str, float, float, float], Lobe]]:
        """Return, by the name of each theory, a function of event, wavelength, nm, n_in and n_out that makes a lobe."""
        return {"ghs": self._smooth, "rayleigh_rice": self._scalar, "rayleigh_rice_vector": self._vector}

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """
        Return the lobe of an event by the chosen theory, see `Placement.event_lobes`.

        The result is () if the surface has no roughness, or for transmission between equal indices.
        """
        if self.is_smooth_as_glass or not index_step(event, n_in, n_out) > 0:
            return ()
        return (self._theories()[self.theory](event, wavelength_nm, n_in, n_out),)

    def _spectrum(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Callable:
        """
        Return the roughness spectrum, µm⁴, as a function of r = |β - β0| in direction cosines.

        Raise `MistrayError` if the surface is too rough for scatter in first order.
        """
        wavelength_um, n = wavelength_nm * 1e-3, n_in if event == "reflection" else n_out
        rms_um, psd = self.relevant_rms_um(wavelength_nm, n), self.psd(wavelength_nm)
        need_smooth(self.title, event, rms_um, wavelength_um, index_step(event, n_in, n_out), self.rougher)
        return lambda r: psd(n * r / wavelength_um)

    def _smooth(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """Return the lobe of the generalised Harvey-Shack theory in first order, for a wavelength in nm."""
        psd = self._spectrum(event, wavelength_nm, n_in, n_out)
        wavelength_um, step = wavelength_nm * 1e-3, index_step(event, n_in, n_out)
        n = n_in if event == "reflection" else n_out

        def profile(r: np.ndarray) -> np.ndarray:
            return np.asarray(ghs.smooth(step, psd(r), wavelength_um, n))

        if event == "reflection":
            return Lobe(event, profile, shares=self.shares, factor="ghs")
        return Lobe(event, profile, shares=self.shares, ratio=_path_growth(n_in, n_out))

    def _scalar(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """Return the Rayleigh-Rice lobe with R of the coating as polarisation factor, for a wavelength in nm."""
        psd, in_medium_um = self._spectrum(event, wavelength_nm, n_in, n_out), wavelength_nm * 1e-3 / n_in
        return Lobe(
            event,
            lambda r: np.asarray(rayleigh_rice.brdf(1.0, 1.0, 1.0, psd(r), in_medium_um)),
            shares=self.shares,
            factor="rayleigh_rice",
        )

    def _vector(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """
        Return the lobe of vector Rayleigh-Rice theory with the polarisation factor Q of a bare surface.

        Q is divided by R or T of that surface, unless the BSDF is absolute. Raise `MistrayError` for reflection between
        equal indices.
        """
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


# Ratios that do not depend on the roughness: one table for all surfaces between two materials


@lru_cache(maxsize=32)
def _path_growth(n_in: float, n_out: float) -> RatioTable:
    """Return a table of the squared optical path difference in transmission, divided by that at normal incidence."""
    step = index_step("transmission", n_in, n_out)

    def ratio(at: Directions) -> np.ndarray:
        return np.asarray((ghs.path_in_transmission(at.cos_i, at.cos_s, n_in, n_out) / step) ** 2)

    return over_cosines(ratio, n_out / n_in, SCALAR)


@lru_cache(maxsize=32)
def _reflected_polarization(index: complex, absolute: bool) -> RatioTable:
    """
    Return a table of the Rayleigh-Rice factor Q in reflection, divided by R at the specular angle unless `absolute`.

    `index` is relative to the medium of the light.
    """

    def ratio(at: Directions) -> np.ndarray:
        q = rayleigh_rice.polarization_factor(at.cos_i, at.cos_s, at.cos_phi, index)
        whole = rayleigh_rice.polarization_factor(at.cos_i, at.cos_i, np.ones_like(at.cos_i), index)
        return np.asarray(q if absolute else q / whole)

    return over_cosines(ratio, 1.0, REFLECTED)


@lru_cache(maxsize=32)
def _transmitted_polarization(n_in: float, n_out: float, absolute: bool) -> RatioTable:
    """
    Return a table of the Rayleigh-Rice factor Q in transmission, divided by its specular value unless `absolute`.

    It is multiplied by the squared path difference in the specular direction, relative to normal incidence.
    """
    step = index_step("transmission", n_in, n_out)

    def ratio(at: Directions) -> np.ndarray:
        q = rayleigh_rice.transmitted_factor(at.cos_i, at.cos_s, at.cos_phi, n_out / n_in)
        whole = rayleigh_rice.transmitted_factor(at.cos_i, at.cos_specular, np.ones_like(at.cos_i), n_out / n_in)
        path = ghs.path_in_transmission(at.cos_i, at.cos_specular, n_in, n_out)
        return np.asarray((path / step) ** 2 * (q if absolute else q / whole))

    return over_cosines(ratio, n_out / n_in, REFRACTED)

"""Surface with a K-correlation roughness spectrum, and a theory of its scatter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack, k_correlation
from mistray.ranges import FLAG, LENGTH_UM, SPECTRUM_SLOPE
from mistray.scatter.harvey_shack import index_step
from mistray.scatter.lobe import Lobe
from mistray.scatter.numbers import REFERENCE, ROUGHNESS
from mistray.scatter.ratio_tables import Directions, over_radius
from mistray.scatter.rough_surface import RoughSurface

MAX_FULL_PHASE = 2.0
"""Largest 2π Δn σ/λ for the theory "ghs_full": there the specular beam keeps 1.8 % of its light."""


@dataclass(frozen=True)
class KCorrelation(RoughSurface):
    """
    Surface with the roughness spectrum A'/(1 + (B f)²)^(S/2), for both events and from both sides.

    Equations and sources: `mistray.physics.k_correlation` and those of `RoughSurface`.

    Attributes
    ----------
    rms_nm : float
        Rms roughness σ, nm, ≥ 0: over all spatial frequencies, or over 0 … 1/λ if `band_limited`.
    B_um : float
        Parameter B, µm, > 0: 1/B is the spatial frequency of the knee.
    slope : float
        Slope S of the spectrum, > 2 for a total roughness, > 0 for a band-limited one. Slope 3 gives an exponential
        autocovariance of length B/2π.
    band_limited : bool
        Whether `rms_nm` is the roughness of the band 0 … 1/λ only.
    reference_nm : float, optional
        Vacuum wavelength λ of the band of `rms_nm`, nm; only with `band_limited`. Without it the wavelength of the
        light counts, and the spectrum of the surface changes with it.
    theory, substrate
        Options of `RoughSurface`. The theory may also be "ghs_full", generalised Harvey-Shack for rougher surfaces
        (slope 3 and total roughness only).

    Raises
    ------
    MistrayError
        If a parameter is out of range or parameters do not go together. `lobes` raises it for a surface that is too
        rough for the theory at a wavelength.
    """

    rms_nm: float = replace(
        ROUGHNESS, doc="rms roughness σ: over all frequencies, or over 0 … 1/λ if ``band_limited``"
    ).field()
    B_um: float = Param("um", LENGTH_UM, "B: 1/B is the frequency of the knee").field()
    slope: float = Param(
        "1", SPECTRUM_SLOPE, "slope S of the spectrum; > 2, or > 0 if ``band_limited``", tolerance=0.05
    ).field()
    band_limited: bool = Param("bool", FLAG, "whether ``rms_nm`` is that of the band 0 … 1/λ only").field(False)
    reference_nm: float | None = replace(
        REFERENCE, doc="wavelength of the band of ``rms_nm``; none: that of the light"
    ).field(None)

    rougher = "use theory ghs_full, with slope 3"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slope <= 2 and not self.band_limited:
            raise MistrayError(
                f"{self.title}: slope is {self.slope:g}, whose total roughness is infinite; give slope > 2 or "
                "band_limited"
            )
        if self.theory == "ghs_full" and (self.slope != 3 or self.band_limited):
            raise MistrayError(f"{self.title}: theory ghs_full needs slope 3 and a total roughness; use ghs for others")
        if self.reference_nm is not None and not self.band_limited:
            raise MistrayError(f"{self.title}: reference_nm goes with band_limited; leave it out or set that")

    def amplitude_um4(self, wavelength_nm: float) -> float:
        """Return A' of the spectrum, µm⁴; it depends on the wavelength, nm, only if the band of `rms_nm` does."""
        rms_um = self.rms_nm * 1e-3
        if not self.band_limited:
            return float(k_correlation.amplitude_um4(rms_um, self.B_um, self.slope))
        band_um = (self.reference_nm or wavelength_nm) * 1e-3
        return float(k_correlation.band_amplitude_um4(rms_um, self.B_um, self.slope, band_um))

    def psd(self, wavelength_nm: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return the roughness spectrum, µm⁴, as a function of frequency, 1/µm, at a vacuum wavelength, nm."""
        amplitude = self.amplitude_um4(wavelength_nm)
        return lambda f: np.asarray(k_correlation.psd_um4(f, amplitude, self.B_um, self.slope))

    def relevant_rms_um(self, wavelength_nm: float, n: float) -> float:
        """Return the rms roughness, µm, that scatters into the half space of index n, see `RoughSurface`."""
        amplitude = self.amplitude_um4(wavelength_nm)
        return k_correlation.relevant_rms_um(amplitude, self.B_um, self.slope, wavelength_nm * 1e-3 / n)

    @property
    def is_smooth_as_glass(self) -> bool:
        """True if the rms roughness is 0."""
        return self.rms_nm == 0

    def advice(self) -> str | None:
        """Return a line of advice if the slope is outside 1.5 … 3.5, usual for polished surfaces; None otherwise."""
        if 1.5 <= self.slope <= 3.5:
            return None
        return f"{self.title}: slope {self.slope:g} is outside what is usual, 1.5 … 3.5"

    def _theories(self) -> Mapping[str, Callable[[str, float, float, float], Lobe]]:
        """Return, by the name of each scatter theory, the function that makes a lobe; see `RoughSurface._theories`."""
        theories = super()._theories()
        return {"ghs": theories["ghs"], "ghs_full": self._full, **theories}

    def _full(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> Lobe:
        """
        Return the scatter lobe by the full Harvey-Shack theory, without the first-order approximation.

        Its `ratio` is relative to normal incidence. Raise `MistrayError` if the surface is too rough for it.
        """
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

        table = over_radius(ratio, 1.0 if reflected else n_out / n_in)
        return Lobe(event, lambda r: bsdf(step, r), shares=self.shares, ratio=table)

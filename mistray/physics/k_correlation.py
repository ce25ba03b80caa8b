"""K-correlation (ABC) spectrum of surface roughness: PSD(f) = A'/(1 + (B f)²)^(S/2).

It is the two-dimensional, isotropic power spectral density in µm⁴ over spatial frequencies f in 1/µm. S is the slope;
authors who write the exponent as (C + 1)/2 have C = S - 1. Its integral over all frequencies is σ², finite for S > 2. S
= 3 is the surface with the autocovariance σ² exp(-ρ/lc), B = 2π lc. Sources: J. C. Stover, *Optical Scattering*, 3rd
ed., SPIE Press 2012; M. G. Dittman, *K-correlation power spectral density and surface scatter model*, Proc. SPIE 6291
(2006), for the roughness within a band.
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics import harvey_shack
from mistray.physics.disc import disc_total


def psd_um4(frequency: Any, amplitude_um4: Any, length_um: Any, slope: Any) -> Any:
    """
    Return the roughness spectrum A'/(1 + (B f)²)^(S/2), µm⁴.

    Parameters
    ----------
    frequency : float or array
        Spatial frequency f, 1/µm, ≥ 0.
    amplitude_um4 : float or array
        Amplitude A', µm⁴.
    length_um : float or array
        Length B, µm, > 0: 1/B is the frequency of the knee.
    slope : float or array
        Slope S, > 0.

    Returns
    -------
    float or array
        Spectrum, µm⁴. Differentiable in all arguments in Dr.Jit.
    """
    return harvey_shack.bsdf(frequency, amplitude_um4, 1 / length_um, -slope)


def amplitude_um4(rms_um: Any, length_um: Any, slope: Any) -> Any:
    """
    Return the amplitude A' for a total roughness, ``σ² B² (S - 2)/(2π)``.

    Parameters
    ----------
    rms_um : float or array
        Rms roughness σ over all spatial frequencies, µm.
    length_um : float or array
        Length B, µm.
    slope : float or array
        Slope S, > 2; the total roughness of a smaller slope is infinite.

    Returns
    -------
    float or array
        Amplitude A', µm⁴.
    """
    return rms_um * rms_um * length_um * length_um * (slope - 2) / (2 * math.pi)


def band_amplitude_um4(rms_um: Any, length_um: Any, slope: Any, wavelength_um: Any) -> Any:
    """
    Return the amplitude A' for a roughness at the spatial frequencies 0 … 1/λ.

    ``σ² B² (S - 2)/(2π [1 - (1 + B²/λ²)^(1 - S/2)])``; at S = 2 it is ``σ² B²/(π ln(1 + B²/λ²))``.

    Parameters
    ----------
    rms_um : float or array
        Rms roughness σ in the band, µm.
    length_um, slope : float or array
        Length B, µm, and slope S, as in `psd_um4`.
    wavelength_um : float or array
        Wavelength λ of the band, µm.

    Returns
    -------
    float or array
        Amplitude A', µm⁴.
    """
    variance = rms_um * rms_um * wavelength_um * wavelength_um
    return harvey_shack.b0_from_tis(variance, wavelength_um / length_um, -slope)


def relevant_rms_um(
    amplitude_um4: float, length_um: float, slope: float, wavelength_um: float, sin_i: float = 0.0
) -> float:
    """
    Return the rms roughness that scatters into directions of the half space, at one angle of incidence.

    Its square is the integral of the PSD over the frequencies |f + f0| < 1/λ, f0 = sin θi/λ; other frequencies make
    evanescent waves.

    Parameters
    ----------
    amplitude_um4, length_um, slope : float
        Amplitude A', µm⁴, length B, µm, and slope S, as in `psd_um4`.
    wavelength_um : float
        Wavelength λ in the medium of the scattered light, µm.
    sin_i : float
        Sine of the angle of the specular beam with the normal, 0 … 1.

    Returns
    -------
    float
        Rms roughness, µm.
    """
    knee = wavelength_um / length_um
    if sin_i == 0:
        share = float(harvey_shack.tis(amplitude_um4, knee, -slope))
    else:
        share = disc_total(lambda r: harvey_shack.bsdf(r, amplitude_um4, knee, -slope), sin_i)
    return math.sqrt(share) / wavelength_um

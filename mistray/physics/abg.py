"""ABg scatter model: BSDF = A/(B + r^g), r = |β - β0|.

r is the distance of the direction cosines of the scattered ray from those of the specular ray, tangential to the
surface, 0 ≤ r < 2. BSDF and A are in 1/sr (A in fact in 1/sr times r^g). Source: J. E. Harvey, *Understanding Surface
Scatter*, SPIE Press 2019; the manuals of OpticStudio, TracePro and FRED have the same definition. The parameters hold
at one wavelength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.physics import k_correlation
from mistray.physics._arrays import arithmetic
from mistray.ranges import CHANCE, INDEX_STEP, LENGTH_UM

# Smallest r in r^g, because 0 to the power of 0 is NaN in Dr.Jit. It is a normal number in float32.
_SMALLEST_R = 1e-30
_SLIGHT, _TERMS = 0.1, 60  # g below which a series is used, and its number of terms, with which it is exact


def bsdf(r: Any, a: Any, b: Any, g: Any) -> Any:
    """
    Return the BSDF of the ABg model, A/(B + r^g).

    Parameters
    ----------
    r : float or array
        Distance |β - β0| of the direction cosines, ≥ 0.
    a : float or array
        Numerator A, 1/sr, ≥ 0.
    b : float or array
        Constant B, > 0, or ≥ 0 with ``g = 0``.
    g : float or array
        Slope, ≥ 0. Slope 0 is a Lambertian surface of reflectance π A/(1 + B).

    Returns
    -------
    float or array
        BSDF, 1/sr. Differentiable in all arguments in Dr.Jit.
    """
    return a / (b + arithmetic(r, a, b, g).maximum(r, _SMALLEST_R) ** g)


def tis(a: float, b: float, g: float) -> float:
    """
    Return the fraction of light scattered at normal incidence, the integral of BSDF cos θ over the half space.

    ``π A/B · 2F1(1, 2/g; 1 + 2/g; -1/B)``; at g = 2 it is ``π A ln(1 + 1/B)``, at B = 0 ``2π A/(2 - g)``, at g = 0
    ``π A/(1 + B)``. It is less at oblique incidence, where the lobe is cut by the horizon.

    Parameters
    ----------
    a, b, g : float
        Parameters of `bsdf`; B = 0 is allowed for g < 2.

    Returns
    -------
    float
        Scattered fraction of the incident flux; relative error below 1e-7.

    Raises
    ------
    MistrayError
        If B = 0 and g ≥ 2: the integral diverges.
    """
    from scipy.special import hyp2f1

    if b == 0:
        if g >= 2:
            raise MistrayError(f"ABg: B is 0 with g {g:g}, which scatters without limit; give B > 0")
        return 2 * math.pi * a / (2 - g)
    if g < _SLIGHT:
        # Pfaff's transformation, 2F1(1, 1; 1 + 2/g; 1/(1 + B)), term by term: library functions are lost here
        power = 2 / g if g > 0 else math.inf
        term = total = 1.0
        for n in range(_TERMS):
            term *= (n + 1) / ((1 + b) * (1 + power + n))
            total += term
        return math.pi * a / (1 + b) * total
    power = 2 / g
    if abs(power - round(power)) < 1e-9:  # the transformations of 2F1 lose digits next to an integer
        power = float(round(power))
    if power == 1:
        return math.pi * a * math.log1p(1 / b)
    return float(math.pi * a / b * hyp2f1(1.0, power, 1 + power, -1 / b))


def at_wavelength(
    a: Any, b: Any, g: Any, ratio: Any, step_ratio: Any = 1.0, specular_ratio: Any = 1.0
) -> tuple[Any, Any]:
    """
    Return A, 1/sr, and B at another wavelength, for a smooth surface.

    The surface keeps its roughness, so BSDF₂(r) = BSDF₁(r/k)/k⁴ with k = λ₂/λ₁. The slope g does not change.

    Parameters
    ----------
    a, b, g : float or array
        Parameters at the wavelength λ₁.
    ratio : float or array
        Ratio of the wavelengths k = λ₂/λ₁, > 0.
    step_ratio : float or array
        Ratio of the index steps Δn₂/Δn₁.
    specular_ratio : float or array
        Ratio R₂/R₁ or T₂/T₁ if the BSDF is not relative to the specular beam; else 1.

    Returns
    -------
    a, b : float or array
        Parameters ``A k^(g-4) (Δn₂/Δn₁)² R₂/R₁``, 1/sr, and ``B k^g`` at λ₂.
    """
    return a * ratio ** (g - 4) * step_ratio * step_ratio * specular_ratio, b * ratio**g


@dataclass(frozen=True)
class AbgFromRms:
    """
    ABg parameters of a polished surface, computed from its roughness, with intermediate quantities.

    The symbols σ, λ, Δn and R are those of `abg_from_rms`; f is the spatial frequency, 1/µm.

    Attributes
    ----------
    a, b, g : float
        ABg parameters; `a` in 1/sr.
    psd_amplitude_um4 : float
        Amplitude As of the roughness spectrum ``As/(1 + (Bs f)²)^((C+1)/2)``, µm⁴.
    psd_length_um : float
        Length Bs of the spectrum, µm.
    psd_slope : float
        Slope C of the spectrum.
    bsdf_per_psd : float
        Ratio of the BSDF to the spectrum, D = 4π² Δn² R/λ⁴, µm⁻⁴.
    bsdf_0 : float
        BSDF in the specular direction before normalisation, D As, 1/sr.
    tis : float
        Total integrated scatter ``R (1 - exp(-(2π Δn σ/λ)²))`` of Bennett and Porteus.
    correction : float
        Factor of the normalisation: `a` is this factor times `a_unnormalised`.
    a_unnormalised : float
        Tail of the spectrum at r = 1, ``D As/(1 + (Bs/λ)²)^((C+1)/2)``, 1/sr.
    shortest_wavelength_um : float
        Wavelength σ/0.02, µm, below which the surface is not smooth.
    """

    a: float
    b: float
    g: float
    psd_amplitude_um4: float
    psd_length_um: float
    psd_slope: float
    bsdf_per_psd: float
    bsdf_0: float
    tis: float
    correction: float
    a_unnormalised: float
    shortest_wavelength_um: float


def abg_from_rms(
    rms_um: float,
    correlation_length_um: float,
    wavelength_um: float,
    index_step: float,
    reflectance: float = 1.0,
    raw_integral: float | None = None,
) -> AbgFromRms:
    """
    Return ABg parameters from the roughness of a surface with an exponential autocovariance.

    The roughness spectrum belongs to the autocovariance ``σ² exp(-ρ/l)``, so C = 2 and g = 3. A/(B + r^g) has its knee
    at that of the spectrum, ``B = (λ/Bs)³``. A is scaled to the total of Bennett and Porteus. This follows the sheet
    "ABg from RMS" of TracePro. The sheet normalises by the integral over the spectrum, on a grid that it does not
    disclose; A/(B + r^g) itself has 17 % more than that. The default here is the integral of A/(B + r^g), so that the
    result scatters exactly `AbgFromRms.tis` at normal incidence.

    Parameters
    ----------
    rms_um : float
        Rms roughness σ, µm, > 0.
    correlation_length_um : float
        Correlation length l, µm, > 0.
    wavelength_um : float
        Vacuum wavelength λ, µm, > 0.
    index_step : float
        Index step Δn: 2 for a mirror in air, n - 1 for transmission from air into glass.
    reflectance : float
        Reflectance R (or transmittance T), in (0, 1].
    raw_integral : float, optional
        Scattered fraction of the BSDF before normalisation, if another one than the exact one is to be used. The
        sheet's 0.015552516 for σ = 5 nm, l = 100 µm, λ = 0.5 µm, Δn = 2, R = 0.95 gives the sheet's A.

    Returns
    -------
    AbgFromRms
        Parameters, with the quantities that lead to them.

    Raises
    ------
    MistrayError
        If a length is not positive, R or `raw_integral` is not in (0, 1], Δn is 0 or the surface is not smooth (σ >
        0.02 λ).
    """
    owner = "ABg from rms"
    for name, value in (("rms", rms_um), ("correlation length", correlation_length_um), ("wavelength", wavelength_um)):
        LENGTH_UM.check(name, value, owner)
    CHANCE.check("reflectance", reflectance, owner)
    INDEX_STEP.check("size of the index step", abs(index_step), owner)
    if raw_integral is not None:
        CHANCE.check("raw integral", raw_integral, owner)
    shortest = rms_um / 0.02
    if wavelength_um < shortest:
        raise MistrayError(
            f"ABg from rms: rms {rms_um:g} um is not smooth at {wavelength_um:g} um; give at least {shortest:g} um"
        )
    length = 2 * math.pi * correlation_length_um
    amplitude = float(k_correlation.amplitude_um4(rms_um, length, 3.0))
    factor = 4 * math.pi**2 * index_step**2 * reflectance / wavelength_um**4
    tail = factor * float(k_correlation.psd_um4(1 / wavelength_um, amplitude, length, 3.0))
    b = (wavelength_um / length) ** 3
    scattered = reflectance * -math.expm1(-((2 * math.pi * index_step * rms_um / wavelength_um) ** 2))
    correction = scattered / (tis(tail, b, 3.0) if raw_integral is None else raw_integral)
    return AbgFromRms(
        a=correction * tail,
        b=b,
        g=3.0,
        psd_amplitude_um4=amplitude,
        psd_length_um=length,
        psd_slope=2.0,
        bsdf_per_psd=factor,
        bsdf_0=factor * amplitude,
        tis=scattered,
        correction=correction,
        a_unnormalised=tail,
        shortest_wavelength_um=shortest,
    )

"""Noise-equivalent temperature difference (NETD): the change of a scene's temperature whose signal equals the noise.

Both functions take the irradiance that the optics really deliver to a pixel, so that they need no f-number and no
transmission. Sources: J. M. Lloyd, Thermal Imaging Systems (Plenum Press 1975), for the detectivity D*; E. L. Dereniak,
G. D. Boreman, Infrared Detectors and Systems (Wiley 1996), for the noise of photons.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

_MM_PER_CM = 10.0


def netd_by_detectivity(
    per_kelvin_W_mm2: npt.ArrayLike, detectivity: npt.ArrayLike, pixel_mm2: npt.ArrayLike, bandwidth_hz: npt.ArrayLike
) -> Any:
    """
    Return the NETD, K, of a pixel whose noise is given by its detectivity, √(Δf/A)/(D* dE/dT).

    The noise-equivalent power is √(A Δf)/D*, and a kelvin adds the power A dE/dT.

    Parameters
    ----------
    per_kelvin_W_mm2 : array_like
        Derivative dE/dT of the irradiance in the scene's image, in the band, W/(mm² K), > 0.
    detectivity : array_like
        Detectivity D*, mean over the band, cm √Hz/W, > 0.
    pixel_mm2 : array_like
        Area A of the pixel, mm², > 0.
    bandwidth_hz : array_like
        Noise bandwidth Δf, Hz, > 0; 1/(2t) if a pixel integrates during t.
    """
    slope, d_star, area, bandwidth = (
        np.asarray(v, dtype=np.float64) for v in (per_kelvin_W_mm2, detectivity, pixel_mm2, bandwidth_hz)
    )
    return np.sqrt(bandwidth / area) / (_MM_PER_CM * d_star * slope)


def netd_by_photons(
    photons: npt.ArrayLike,
    photons_per_kelvin: npt.ArrayLike,
    quantum_efficiency: npt.ArrayLike,
    pixel_mm2: npt.ArrayLike,
    bandwidth_hz: npt.ArrayLike,
) -> Any:
    """
    Return the NETD, K, of a photodiode limited by photon noise, √(2 Δf Q/(η A))/(dQ/dT).

    With Δf = 1/(2t) it is √N over dN/dT. N = η A t Q is the number of electrons in a frame, with Poisson's noise.
    Bunching of photons is neglected: it adds less than 1 % to the noise below 12 µm and 300 K. A photoconductor has √2
    times as much noise, by recombination.

    Parameters
    ----------
    photons : array_like
        Irradiance Q on the pixel from all sources, photons/(s mm²), ≥ 0.
    photons_per_kelvin : array_like
        Derivative dQ/dT of the irradiance in the scene's image, photons/(s mm² K), > 0.
    quantum_efficiency : array_like
        Quantum efficiency η, electrons per photon, > 0 … 1.
    pixel_mm2, bandwidth_hz : array_like
        Area A, mm², and noise bandwidth Δf, Hz, as in `netd_by_detectivity`.
    """
    flux, slope, efficiency, area, bandwidth = (
        np.asarray(v, dtype=np.float64)
        for v in (photons, photons_per_kelvin, quantum_efficiency, pixel_mm2, bandwidth_hz)
    )
    return np.sqrt(2 * bandwidth * flux / (efficiency * area)) / slope

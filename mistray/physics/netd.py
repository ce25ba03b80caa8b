"""Noise-equivalent temperature difference (NETD): the change of a scene's temperature whose signal equals the noise.

Both functions take the irradiance that the optics really give a pixel, so that no f-number and no transmission stand in
them. Sources: J. M. Lloyd, Thermal Imaging Systems (Plenum Press 1975), for the detectivity D*; E. L. Dereniak,
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
    NETD of a pixel whose noise its detectivity states, √(Δf/A)/(D* dE/dT), K.

    The noise-equivalent power is √(A Δf)/D*, the power that a kelvin adds A dE/dT.

    Parameters
    ----------
    per_kelvin_W_mm2 : array_like
        dE/dT of the image of the scene in the band, W/(mm² K), > 0.
    detectivity : array_like
        D*, mean over the band, cm √Hz/W, > 0.
    pixel_mm2 : array_like
        Area A, mm², > 0.
    bandwidth_hz : array_like
        Δf of the noise, Hz, > 0; 1/(2t) if a pixel integrates during t.
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
    NETD of a photodiode without noise of its own, √(2 Δf Q/(η A))/(dQ/dT), K: background-limited.

    With Δf = 1/(2t) it is √N over dN/dT, where N = η A t Q are the electrons of a frame, by Poisson's law. That photons
    come in bunches is left out: it adds less than 1 % to the noise below 12 µm and 300 K. A photoconductor
    has √2 times as much noise, by recombination.

    Parameters
    ----------
    photons : array_like
        Irradiance Q by all that shines on the pixel, photons/(s mm²), ≥ 0.
    photons_per_kelvin : array_like
        dQ/dT of the image of the scene, photons/(s mm² K), > 0.
    quantum_efficiency : array_like
        η, electrons per photon, > 0 … 1.
    pixel_mm2, bandwidth_hz : array_like
        As in `netd_by_detectivity`.
    """
    flux, slope, efficiency, area, bandwidth = (
        np.asarray(v, dtype=np.float64)
        for v in (photons, photons_per_kelvin, quantum_efficiency, pixel_mm2, bandwidth_hz)
    )
    return np.sqrt(2 * bandwidth * flux / (efficiency * area)) / slope

"""Diffraction limit of a path's RMS radius on the detector, mm: the Airy radius of its light cone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.physics.imaging.ideal import airy_diameter
from mistray.trace.sampled_hits import LightCone

SLOWEST = 100.0  # F-number: where the RMS radius is above its Airy radius, nobody looks for the cone of a path
MM_PER_NM = 1e-6

Floats = npt.NDArray[np.float64]


def tight(table: pd.DataFrame) -> pd.DataFrame:
    """
    Return rows of a path table whose RMS radius is below the Airy radius at F/100: diffraction may count there.

    Radii are in mm.
    """
    return table[table.rms_radius_mm < 0.5 * airy_diameter(1.0, SLOWEST) * MM_PER_NM * table.wavelength_nm]


def with_airy(table: pd.DataFrame, cones: Mapping[int, LightCone]) -> pd.DataFrame:
    """
    Return a path table with the RMS irradiance that the Airy radius allows.

    Parameters
    ----------
    table : DataFrame
        Path table with ``path_id`` and the columns of `mistray.trace.PathRow`.
    cones : mapping of int to LightCone
        Light cones by ``path_id``; one that is not `known` counts as missing.

    Returns
    -------
    DataFrame
        Table with more columns: ``airy_radius_mm``, 1.22 λN with the wavelength λ and the F-number N of the cone, and
        ``airy_irradiance_W_mm2``, the power over π times its square, each with its standard error (``_se``). They are
        NaN where the RMS radius is not below the Airy radius or no cone is known.
    """
    found = [cones.get(path_id) for path_id in table.path_id]
    known = [(cone.aperture, cone.aperture_se) if cone and cone.known else (np.nan, np.nan) for cone in found]
    aperture, aperture_se = np.reshape(known, (-1, 2)).T
    wavelength, raw, power, power_se = (
        table[name].to_numpy(np.float64) for name in ("wavelength_nm", "rms_radius_mm", "power_W", "power_se_W")
    )
    radius = 0.5 * airy_diameter(1.0, 0.5) * MM_PER_NM * wavelength / aperture  # N = 1/(2 NA)
    radius = np.where(raw < radius, radius, np.nan)
    irradiance = power / (np.pi * radius**2)
    relative = aperture_se / aperture
    return table.assign(
        airy_radius_mm=radius,
        airy_radius_se_mm=radius * relative,
        airy_irradiance_W_mm2=irradiance,
        airy_irradiance_se_W_mm2=irradiance * np.hypot(power_se / power, 2 * relative),
    )

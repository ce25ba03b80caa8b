"""Irradiance maps at each wavelength, the direct image and the stray light apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.analysis.ranking import DIRECT
from mistray.trace import Trace


@dataclass(frozen=True)
class SpectralMaps:
    """
    Irradiance of a trace, split by wavelength.

    Attributes
    ----------
    wavelengths_nm : (n,) float
        Ascending.
    launched_W : (n,) float
        Flux of the sources.
    direct, stray : (n, H, W) float
        Of the direct paths and of all others, W/mm² in each line or band; not divided by its width.
    """

    wavelengths_nm: npt.NDArray[np.float64]
    launched_W: npt.NDArray[np.float64]
    direct: npt.NDArray[np.float64]
    stray: npt.NDArray[np.float64]


def spectral_maps(t: Trace) -> SpectralMaps:
    """The maps of a trace at each of its wavelengths, by tracing its rays again."""
    table = t.paths.to_pandas()
    direct, stray = [], []
    for wavelength in t.wavelengths_nm:
        rows = table[table.wavelength_nm == wavelength]
        groups = [list(rows.path_id[rows.kind == DIRECT]), list(rows.path_id[rows.kind != DIRECT])]
        (image, _), (others, _) = t.maps(groups)
        direct.append(image)
        stray.append(others)
    launched = [t.energy_at(wavelength).launched_W for wavelength in t.wavelengths_nm]
    return SpectralMaps(np.array(t.wavelengths_nm), np.array(launched), np.array(direct), np.array(stray))

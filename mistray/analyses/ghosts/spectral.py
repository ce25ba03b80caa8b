"""Irradiance maps at each wavelength, with the direct image and the stray light separated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace


@dataclass(frozen=True)
class SpectralMaps:
    """
    Irradiance of a trace, split by wavelength.

    Attributes
    ----------
    wavelengths_nm : (n,) float
        Wavelengths, nm, ascending.
    launched_W : (n,) float
        Flux of the sources at each wavelength, W.
    direct, stray : (n, H, W) float
        Irradiance of the direct paths and of all others, W/mm² in each line or band; not divided by its width.
    stray_hits : (n,) float
        Number of hits of the detector by rays of stray paths.
    """

    wavelengths_nm: npt.NDArray[np.float64]
    launched_W: npt.NDArray[np.float64]
    direct: npt.NDArray[np.float64]
    stray: npt.NDArray[np.float64]
    stray_hits: npt.NDArray[np.float64]

    def block_for(self, hits: float) -> int:
        """
        Return the side of pixel blocks, whose lit ones hold at least `hits` stray rays of each wavelength on average.

        Returns
        -------
        int
            Number of pixels, a common divisor of height and width; 1 if the pixels themselves hold enough, and the
            largest one if none does.
        """
        height, width = self.stray.shape[1:]
        blocks = [b for b in range(1, min(height, width) + 1) if height % b == width % b == 0]
        for block in blocks:
            lit = np.count_nonzero(self.binned(block).stray, axis=(1, 2))
            if np.all(self.stray_hits >= hits * np.maximum(lit, 1) * (self.stray_hits > 0)):
                return block
        return blocks[-1]

    def binned(self, block: int) -> SpectralMaps:
        """Return the maps averaged over blocks of pixels; `block` is the side and divides height and width."""
        n, height, width = self.stray.shape
        shape = (n, height // block, block, width // block, block)
        direct, stray = (values.reshape(shape).mean(axis=(2, 4)) for values in (self.direct, self.stray))
        return replace(self, direct=direct, stray=stray)


def spectral_maps(t: Trace) -> SpectralMaps:
    """Return the irradiance maps of a trace at each of its wavelengths, by tracing its rays again."""
    table = t.paths.to_pandas()
    direct, stray, hits = [], [], []
    for wavelength in t.wavelengths_nm:
        rows = table[table.wavelength_nm == wavelength]
        groups = [list(rows.path_id[rows.kind == DIRECT]), list(rows.path_id[rows.kind != DIRECT])]
        image, others = t.each_map(groups, [False, False])
        direct.append(image.value)
        stray.append(others.value)
        hits.append(float(rows.rays[rows.kind != DIRECT].sum()))
    launched = [t.energy_at(wavelength).launched_W for wavelength in t.wavelengths_nm]
    return SpectralMaps(
        np.array(t.wavelengths_nm), np.array(launched), np.array(direct), np.array(stray), np.array(hits)
    )

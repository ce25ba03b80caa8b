"""Image of one object point at one wavelength: wavefront, spot and point spread."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.physics.imaging.pupil import PEAK_POINTS, PEAK_ZOOMS, Pupil
from mistray.physics.imaging.zernike_fit import ZernikeFit, fit_zernikes
from mistray.ranges import FINITE
from mistray.result import KeyNumber, Result

AZIMUTHS = {"sagittal": 0.0, "tangential": 90.0}

Array = npt.NDArray[np.float64]


class PointSpread(NamedTuple):
    """
    Point spread function on square pixels.

    Attributes
    ----------
    values : (n, n) float64
        Irradiance in the middle of each pixel for a total flux of 1, 1/mm²; rows along y.
    pixel_mm : float
        Side of a pixel, mm.
    x_mm, y_mm : (n,) float64
        Middles of the columns and rows relative to the image point, mm: x sagittal, y tangential.

    Examples
    --------
    >>> (field,) = mistray.image_quality(mistray.load("ritchey_chretien"), 0.1, grid=32)
    >>> spread = field.psf(pixels=32, pixel_mm=0.001)
    >>> print(f"{spread.values.sum() * spread.pixel_mm**2:.2f} of the light falls into 32 µm x 32 µm")
    0.89 of the light falls into 32 µm x 32 µm
    """

    values: Array
    pixel_mm: float
    x_mm: Array
    y_mm: Array


def direction_of(azimuth: str | float) -> tuple[float, float]:
    """
    Return the unit vector (x, y) for "sagittal" (x), "tangential" (y), or an angle in degrees from x towards y.

    Raises
    ------
    MistrayError
        If it is another name, or no finite number.
    """
    if isinstance(azimuth, str):
        if azimuth not in AZIMUTHS:
            raise MistrayError(f"azimuth is '{azimuth}'; give 'tangential', 'sagittal' or degrees from sagittal on")
        azimuth = AZIMUTHS[azimuth]
    angle = math.radians(FINITE.check("azimuth", azimuth))
    x, y = math.cos(angle), math.sin(angle)
    return (0.0 if abs(x) < 1e-15 else x), (0.0 if abs(y) < 1e-15 else y)


@dataclass(frozen=True, eq=False, repr=False)
class LineImage(Result):
    """
    Image of a field point at one wavelength.

    Attributes
    ----------
    wavelength_nm : float
        Wavelength, nm.
    weight : float
        Share of this wavelength in the flux that starts, 0 … 1.
    pupil : Pupil
        Amplitude and OPD over direction cosines, see `mistray.physics.imaging.pupil.Pupil`; its x is sagittal, its y
        tangential.
    spot_mm : (n, n, 2) float64
        Points on the detector of the n × n cells of the pupil, x and y relative to the image point, mm; NaN in dark
        cells. Of a cell that a rim or a vane cuts it is the mean of the lit part.
    blur_mm2 : (n, n) float64
        Mean square distance of the light of a cell at a rim from that point, mm²; 0 in other cells.
    stop_xy : (n, n, 2) float64
        Points where the rays cross the stop, in units of its radius; NaN in dark cells.
    stop_area : (n, n) float64
        Area in the stop, in squares of its radius, per area of direction cosines; NaN in dark cells.

    Examples
    --------
    >>> (field,) = mistray.image_quality(mistray.load("ritchey_chretien"), 0.1, grid=32)
    >>> (line,) = field.lines
    >>> print(f"{line.wavelength_nm:.0f} nm: {line.rms_waves():.2f} waves RMS")
    550 nm: 0.06 waves RMS
    """

    wavelength_nm: float
    weight: float
    pupil: Pupil
    spot_mm: Array
    blur_mm2: Array
    stop_xy: Array
    stop_area: Array

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the wavelength (nm), and RMS and peak-to-valley OPD (waves), by label."""
        return {
            "wavelength [nm]": self.wavelength_nm,
            "RMS OPD [waves]": self.rms_waves(),
            "PV OPD [waves]": self.pv_waves(),
        }

    @property
    def opd_waves(self) -> Array:
        """OPD in waves, (n, n): OPL of the chief ray minus that of each ray, at the reference sphere; NaN if dark."""
        return np.where(self.pupil.lit, self.pupil.opd_waves, np.nan)

    def rms_waves(self, removed: str = "tilt") -> float:
        """Return the RMS OPD, waves, with "piston", "tilt" (piston too) or "focus" (all three) removed."""
        return self.pupil.rms_waves(removed)

    def pv_waves(self, removed: str = "tilt") -> float:
        """Return the peak-to-valley OPD, waves, with "piston", "tilt" or "focus" removed as in `rms_waves`."""
        return self.pupil.pv_waves(removed)

    def zernikes(self, kind: str = "noll", terms: int = 37) -> ZernikeFit:
        """
        Return Zernike coefficients of the OPD, waves, over the stop, fitted to the lit points by least squares.

        Parameters
        ----------
        kind : {"noll", "fringe"}
            Standard polynomials of unit variance in the order of Noll, or Fringe polynomials of unit value at the rim.
        terms : int
            Number of polynomials.
        """
        lit = self.pupil.lit & np.isfinite(self.stop_area)
        weights = (self.pupil.share * self.stop_area)[lit]
        return fit_zernikes(self.stop_xy[lit], self.pupil.opd_waves[lit], weights, kind, terms)

    @property
    def centroid_mm(self) -> Array:
        """Centroid of the flux relative to the image point, (2,) mm."""
        w, lit = self.pupil.energy, self.pupil.lit
        return np.asarray((w[lit, None] * self.spot_mm[lit]).sum(axis=0) / self.pupil.total)

    @cached_property
    def peak(self) -> tuple[float, Array]:
        """
        Peak irradiance of the PSF for a flux of 1, 1/mm², and its position relative to the image point, (2,) mm.

        All are NaN if the grid does not resolve the wavefront.
        """
        if not self.pupil.resolved:
            return math.nan, np.full(2, np.nan)
        at = self.centroid_mm.copy()
        lit = self.pupil.lit
        spread = float(np.abs(self.spot_mm[lit] - at).max())
        sizes = [self.pupil.cut_off(direction_of(name)) for name in AZIMUTHS]
        half = min(2 * spread + 2 / min(sizes), 0.5 / self.pupil.frequency_step)
        best = 0.0
        while True:
            count = int(min(max(PEAK_POINTS, 4 * half * max(sizes)), 512))
            steps = half * np.linspace(-1, 1, count)
            values = self.pupil.psf(at[0] + steps, at[1] + steps)
            row, column = np.unravel_index(np.argmax(values), values.shape)
            at = at + np.array([steps[column], steps[row]])
            best = max(best, float(values.max()))
            if half * max(sizes) < 4.0**-PEAK_ZOOMS:
                return best, at
            half = 1.5 * float(steps[1] - steps[0])

    @property
    def strehl(self) -> float:
        """
        Strehl ratio, 0 … 1: peak irradiance of the PSF over that of the same light without aberration.

        It is NaN if the grid does not resolve the wavefront.
        """
        return self.peak[0] / self.pupil.ideal_peak()

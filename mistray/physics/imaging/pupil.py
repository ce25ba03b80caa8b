"""Diffraction of the light in a pupil: point spread function, transfer function, encircled energy.

The pupil is described on the reference sphere about an image point C, where κ = 1/R is the sphere's curvature (R > 0
where the pupil lies before the image; κ = 0: the pupil lies at infinity). A point P of the sphere sends a wavelet to C
along the unit vector s = (C - P)/R with components (α, β, γ) in the frame of the image: x and y in its tangent plane,
z along the light. Then, in a medium of index n,

    |x - P| - R = s·x + O(κ x²),    U(x) = ∫∫ A(α, β) exp(-2πi W) exp(2πi n s·x/λ) dα dβ,

with W = OPL(chief) - OPL(ray) in waves, positive where the wavefront leads. |A|² is the flux per dα dβ, so that by
Parseval's theorem |U|² is the irradiance, and its integral the flux: nothing has to be normalised over a window. This
is Debye's integral (M. Born, E. Wolf, *Principles of Optics*, 7th ed., section 8.8.1), in direction cosines of the
image plane, so that it holds for oblique and fast beams; one component of the field stands for all (scalar theory).
Flux A² = dE/(dα dβ) is Kirchhoff's amplitude on the sphere times √γ; polarisation is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

REMOVED = {"piston": 1, "tilt": 3, "focus": 4}  # terms of 1, α, β, γ that are removed from a wavefront
PEAK_ZOOMS, PEAK_POINTS = 4, 33
FINEST_WAVES = 0.5  # greatest step of the OPD between cells, at which waves of neighbouring cells have opposite phase
AT_ONCE = 1 << 21  # product of the numbers of wavelets and points
SPLINE_ORDER = 3


@dataclass(frozen=True, eq=False)
class Pupil:
    """
    Light of one wavelength on the reference sphere about an image point, on a grid of direction cosines.

    Rows of arrays run along β (y), columns along α (x). Cells without light have the flux 0.

    If the grid is too coarse for the wavefront, see `resolved`, PSF, transfer function and encircled energy are NaN.

    Attributes
    ----------
    wavelength_mm : float
        Vacuum wavelength, mm.
    index : float
        Refractive index of the medium before the image.
    step : float
        Spacing of the grid, in direction cosines.
    alpha, beta : (n,) float64
        Direction cosines of the columns and of the rows.
    flux : (n, n) float64
        Flux per unit of α and β in the lit part of each cell; its unit cancels in all results for a flux of 1.
    share : (n, n) float64
        Lit fraction of each cell, 0 … 1.
    opd_waves : (n, n) float64
        Optical path difference W = OPL(chief ray) - OPL(ray), waves, positive where the wavefront leads; 0 in dark
        cells.
    curvature : float
        Curvature κ of the reference sphere, 1/mm: positive if the pupil lies before the image, 0 if at infinity.
    """

    wavelength_mm: float
    index: float
    step: float
    alpha: Array
    beta: Array
    flux: Array
    share: Array
    opd_waves: Array
    curvature: float = 0.0

    @property
    def lit(self) -> npt.NDArray[np.bool_]:
        """Mask of the pupil cells through which light passes, (n, n) bool."""
        return self.share > 0

    @cached_property
    def energy(self) -> Array:
        """Flux in each cell, (n, n): `flux` times the cell's lit area in α and β."""
        return np.asarray(self.flux * self.share * self.step**2)

    @property
    def total(self) -> float:
        """Flux through the whole pupil, in the unit of `energy`."""
        return float(self.energy.sum())

    @property
    def scale(self) -> float:
        """Spatial frequency per unit of direction cosines, n/λ, 1/mm."""
        return self.index / self.wavelength_mm

    @property
    def gamma(self) -> Array:
        """Direction cosine γ along the normal of the image at each cell, (n, n)."""
        a, b = np.meshgrid(self.alpha, self.beta)
        return np.asarray(np.sqrt(np.maximum(1 - a * a - b * b, 0.0)))

    @cached_property
    def amplitude(self) -> Complex:
        """Integral of the complex amplitude √flux · exp(-2πi W) over α and β in each cell, (n, n)."""
        return np.asarray(np.sqrt(self.flux) * self.share * np.exp(-2j * np.pi * self.opd_waves) * self.step**2)

    @cached_property
    def steepest(self) -> float:
        """
        Largest difference of the wavefront between neighbouring lit cells after removal of its tilt, waves.

        Above 0.5 the grid is too coarse.
        """
        w, lit = self.residual("tilt"), self.lit
        steps = [np.abs(np.diff(w, axis=k))[np.logical_and(*_pairs(lit, k))] for k in (0, 1)]
        return float(max((s.max() for s in steps if s.size), default=0.0))

    @property
    def resolved(self) -> bool:
        """True if the grid is fine enough for point spread and transfer functions."""
        return self.steepest <= FINEST_WAVES

    # ---- the wavefront

    def removed(self, terms: str) -> Array:
        """
        Return coefficients of 1, α, β and γ fitted to the wavefront, weighted by flux, (4,), waves.

        α and β are relative to the middle of the grid.

        Parameters
        ----------
        terms : {"piston", "tilt", "focus"}
            Terms that are fitted: 1 only; 1, α and β; or 1, α, β and γ. The other coefficients are 0.

        Raises
        ------
        MistrayError
            If `terms` is another word.
        """
        if terms not in REMOVED:
            raise MistrayError(f"removed is {terms!r}; give 'piston', 'tilt' or 'focus'")
        count, lit = REMOVED[terms], self.lit
        a, b = np.meshgrid(self.alpha - self.alpha.mean(), self.beta - self.beta.mean())
        basis = np.stack([np.ones_like(a), a, b, self.gamma])[:count, lit]
        root = np.sqrt(self.energy[lit])
        found = np.zeros(4)
        found[:count] = np.linalg.lstsq((basis * root).T, self.opd_waves[lit] * root, rcond=None)[0]
        return found

    def residual(self, terms: str) -> Array:
        """Return the wavefront after removal of the fitted `terms` of `removed`, (n, n), waves; 0 in dark cells."""
        piston, x, y, z = self.removed(terms)
        a, b = np.meshgrid(self.alpha - self.alpha.mean(), self.beta - self.beta.mean())
        return np.asarray(np.where(self.lit, self.opd_waves - piston - x * a - y * b - z * self.gamma, 0.0))

    def rms_waves(self, terms: str = "tilt") -> float:
        """Return the rms of the wavefront, waves, weighted by flux, after removal of the fitted terms of `removed`."""
        return math.sqrt(float((self.energy * self.residual(terms) ** 2).sum()) / self.total)

    def pv_waves(self, terms: str = "tilt") -> float:
        """Return the peak-to-valley value of the wavefront after removal of the fitted `terms` of `removed`, waves."""
        return float(np.ptp(self.residual(terms)[self.lit]))

    def best_focus_mm(self) -> float:
        """Return the shift of the image point along its normal to the least rms, mm, positive along the light."""
        return float(self.removed("focus")[3]) / self.scale

    def moved(self, dz: float) -> Pupil:
        """Return the pupil for an image point moved along the image's normal by dz, mm, positive along the light."""
        return replace(self, opd_waves=np.where(self.lit, self.opd_waves - self.scale * dz * self.gamma, 0.0))

    def ideal(self) -> Pupil:
        """Return a pupil with the same flux and an optical path difference of 0 in all cells."""
        return replace(self, opd_waves=np.zeros_like(self.opd_waves))

    # ---- point spread function

    def psf(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """
        Return the point spread function on a grid of points: irradiance for a flux of 1.

        It is computed by the Fourier transform of the pupil.

        Parameters
        ----------
        x, y : (m,), (k,) array_like
            Coordinates of the points from the image point, mm.

        Returns
        -------
        (k, m) float64
            Irradiance, 1/mm²; NaN if the pupil is not `resolved`.
        """
        x, y = (np.asarray(values, dtype=np.float64) for values in (x, y))
        if not self.resolved:
            return np.full((len(y), len(x)), np.nan)
        turns = [2j * np.pi * self.scale * np.outer(at, axis - axis.mean())
                 for at, axis in ((x, self.alpha), (y, self.beta))]  # fmt: skip
        field = np.exp(turns[1]) @ self.amplitude @ np.exp(turns[0]).T
        return np.asarray(np.abs(field) ** 2 * self.scale**2 / self.total)

    def huygens(self, points: npt.ArrayLike) -> Array:
        """
        Return the point spread function at points: irradiance for a flux of 1.

        It sums the wavelets of all cells with exact path lengths.

        Parameters
        ----------
        points : (m, 3) array_like
            Points relative to the image point, in the frame of the image, mm.

        Returns
        -------
        (m,) float64
            Irradiance, 1/mm²; NaN if the pupil is not `resolved`.
        """
        points = np.asarray(points, dtype=np.float64)
        if not self.resolved:
            return np.full(len(points), np.nan)
        lit = self.lit
        a, b = np.meshgrid(self.alpha, self.beta)
        s = np.stack([a, b, self.gamma])[:, lit]
        amplitude, k = self.amplitude[lit], self.curvature
        result = np.empty(len(points))
        some = max(1, AT_ONCE // s.shape[1])
        for first in range(0, len(points), some):
            x = points[first : first + some]
            along, square = x @ s, (x**2).sum(axis=1)[:, None]
            length = np.sqrt(1 + 2 * k * along + k * k * square)  # |x - P| in units of R
            path = (2 * along + k * square) / (1 + length)
            field = (amplitude / length * np.exp(2j * np.pi * self.scale * path)).sum(axis=1)
            result[first : first + some] = np.abs(field) ** 2
        return result * self.scale**2 / self.total

    def ideal_peak(self) -> float:
        """Return the irradiance, 1/mm², at the image point for an OPD of 0 in all cells and a flux of 1."""
        return float(np.abs(self.amplitude).sum() ** 2 * self.scale**2 / self.total)

    # ---- transfer function

    @cached_property
    def _lattice(self) -> Complex:
        """Optical transfer function at multiples of `frequency_step`, zero frequency in the middle, (2n+1, 2n+1)."""
        n = len(self.alpha)
        spectrum = np.fft.fft2(self.amplitude, (2 * n + 1, 2 * n + 1))
        lattice = np.fft.fftshift(np.fft.ifft2(np.abs(spectrum) ** 2)) / (self.total * self.step**2)
        lattice[n, n] = 1.0  # cells that are partly lit have less of the flux than of the amplitude
        return np.asarray(lattice)

    @cached_property
    def _middle(self) -> Array:
        """Point to which the mean tilt of the wavefront sends light, (2,), mm from the image point."""
        return self.removed("tilt")[1:3] / self.scale

    @property
    def frequency_step(self) -> float:
        """Step of the transfer function's frequencies, 1/mm; its inverse is the period of the PSF, mm."""
        return self.step * self.scale

    def otf(self, fx: npt.ArrayLike, fy: npt.ArrayLike) -> Complex:
        """
        Return the optical transfer function ∫ PSF exp(-2πi f·x) dx, 1 at zero frequency.

        It is the autocorrelation of the pupil, interpolated by cubic splines about the middle of the image; NaN if the
        pupil is not `resolved`.

        Parameters
        ----------
        fx, fy : array_like
            Frequencies along x and y, 1/mm.
        """
        from scipy.interpolate import CubicSpline
        from scipy.ndimage import map_coordinates

        fx, fy = np.broadcast_arrays(np.asarray(fx, dtype=np.float64), np.asarray(fy, dtype=np.float64))
        if not self.resolved:
            return np.full(fx.shape, np.nan + 0j)
        n, lattice, (x, y) = len(self.alpha), self._lattice, self._middle
        # About its middle the image is narrowest, so that the function turns least from one frequency to the next
        places = np.arange(n + 1) * self.frequency_step
        back = np.exp(-2j * np.pi * (fx * x + fy * y))
        # The function has a cusp at zero: along the axes there are values on either side of it
        for along, across, line, middle in ((fx, fy, lattice[n, n:], x), (fy, fx, lattice[n:, n], y)):
            if not np.any(across):
                centred = CubicSpline(places, line * np.exp(2j * np.pi * places * middle))
                found = centred(np.clip(np.abs(along), 0, places[-1]))
                found = np.where(np.abs(along) > places[-1], 0, found)
                return np.asarray(back * np.where(along < 0, found.conj(), found))
        every = np.concatenate([-places[:0:-1], places])
        lattice = lattice * np.exp(2j * np.pi * (every * x + every[:, None] * y))
        at = np.stack([fy / self.frequency_step + n, fx / self.frequency_step + n])
        real, imaginary = (
            map_coordinates(part, at, order=SPLINE_ORDER, mode="constant") for part in (lattice.real, lattice.imag)
        )
        return np.asarray(back * (real + 1j * imaginary))

    def cut_off(self, direction: tuple[float, float]) -> float:
        """
        Return the frequency along a direction (x, y) beyond which there is no contrast, 1/mm.

        It is n/λ times the pupil's width along it. The direction may have any length.
        """
        a, b = np.meshgrid(self.alpha, self.beta)
        along = (a * direction[0] + b * direction[1])[self.lit] / math.hypot(*direction)
        reach = (self.share[self.lit] - 0.5) * self.step  # the rim lies within the outermost cells
        width = np.max(along + reach) - np.min(along - reach)
        return float(self.scale * max(width, self.share.max() * self.step))  # a cell may be outermost on both sides

    # ---- energy

    def encircled(self, radius: npt.ArrayLike, centre: tuple[float, float] = (0.0, 0.0), square: bool = False) -> Array:
        """
        Return the fraction of the flux within circles or squares about a point, (m,); NaN if not `resolved`.

        It is the integral of the transfer function times the transform of the figure. So light far out is not lost at
        the edge of a window. Radii must be well below 1 / (2 `frequency_step`).

        Parameters
        ----------
        radius : (m,) array_like
            Radii of the circles, or half sides of the squares along x and y, mm.
        centre : (2,) float
            Centre relative to the image point, mm.
        square : bool
            Whether the figures are squares.
        """
        from scipy.special import j1

        if not self.resolved:
            return np.full(np.atleast_1d(radius).shape, np.nan)
        n, df = len(self.alpha), self.frequency_step
        # Only one of f and -f is needed
        kx, ky = (values[n:].ravel() for values in np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)))
        value = self._lattice[n:].ravel() * np.exp(2j * np.pi * df * (kx * centre[0] + ky * centre[1]))
        weight: Array = np.where(ky == 0, 1.0, 2.0) * value.real * df * df
        if not square:
            # A circle weights all frequencies of one modulus equally
            squares = kx * kx + ky * ky
            weight = np.bincount(squares, weights=weight).astype(np.float64)
            used = np.flatnonzero(weight)
            q, weight = df * np.sqrt(used), weight[used]
        result = []
        for r in np.atleast_1d(np.asarray(radius, dtype=np.float64)):
            if square:
                figure = 4 * r * r * np.sinc(2 * r * df * kx) * np.sinc(2 * r * df * ky)
            else:
                figure = np.where(q == 0, np.pi * r * r, r * j1(2 * np.pi * r * q) / np.where(q == 0, 1.0, q))
            result.append(float(weight @ figure))
        return np.array(result)


def _pairs(lit: npt.NDArray[np.bool_], axis: int) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return two masks of pairs of cells that are neighbours along `axis`: whether each one of a pair is lit."""
    return np.take(lit, range(lit.shape[axis] - 1), axis), np.take(lit, range(1, lit.shape[axis]), axis)

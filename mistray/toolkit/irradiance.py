"""Statistics of irradiance maps, and images made from them.

A map is an (H, W) float64 array in W/mm² with row 0 at the smallest y; its extent is (x0, x1, y0, y1) in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.files.irradiance_files import Extent, Map
from mistray.recorders.film import in_squares
from mistray.recorders.sampled import Sampled


@dataclass(frozen=True)
class MapStatistics:
    """
    Statistics of an irradiance map: extremes, mean and flux.

    Attributes
    ----------
    minimum, maximum, mean, rms : float
        Extremes, mean and root mean square of the pixels, W/mm².
    maximum_se : float
        Standard error of the brightest pixel, W/mm². The maximum over noisy pixels is biased upwards by about as much.
    flux_W : float
        Flux on the map, W: sum over the pixels times the area of a pixel.
    incident_rays : int
        Rays that reached the map.
    pixel_mm : (float, float)
        Width and height of a pixel, mm.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> found = mistray.analysis.statistics(t.irradiance, t.irradiance_se, t.extent, 10_000)
    >>> print(f"{found.flux_W:.1f} W in all, at most {found.maximum:.3g} W/mm²")
    83.1 W in all, at most 2.06e+03 W/mm²
    """

    minimum: float
    maximum: float
    maximum_se: float
    mean: float
    rms: float
    flux_W: float
    incident_rays: int
    pixel_mm: tuple[float, float]


def statistics(irradiance: Map, irradiance_se: Map, extent: Extent, incident_rays: int) -> MapStatistics:
    """
    Return the statistics of a map.

    Parameters
    ----------
    irradiance, irradiance_se : (H, W) float
        Irradiance and its standard error, W/mm².
    extent : (float, float, float, float)
        Extent x0, x1, y0, y1, mm.
    incident_rays : int
        Rays that reached the map, a number that the map itself does not contain.

    Examples
    --------
    >>> x = np.linspace(-1, 1, 101)
    >>> spot = np.exp(-np.add.outer(x**2, x**2) / 0.02)
    >>> found = mistray.analysis.statistics(spot, 0 * spot, (-1, 1, -1, 1), 1000)
    >>> print(f"{found.flux_W:.4f} W")
    0.0616 W
    """
    pixel = pixel_size(irradiance, extent)
    brightest = np.unravel_index(np.argmax(irradiance), irradiance.shape)
    return MapStatistics(
        minimum=float(irradiance.min()),
        maximum=float(irradiance[brightest]),
        maximum_se=float(irradiance_se[brightest]),
        mean=float(irradiance.mean()),
        rms=float(np.sqrt(np.mean(np.square(irradiance)))),
        flux_W=float(irradiance.sum() * pixel[0] * pixel[1]),
        incident_rays=int(incident_rays),
        pixel_mm=pixel,
    )


def brightest(image: Sampled) -> Sampled:
    """Return the brightest pixel of a map, with its noise by batch, in the unit of the map."""
    return image[np.unravel_index(int(np.argmax(image.value)), image.value.shape)]


def highest_cell(value: npt.NDArray[np.float64], se: npt.NDArray[np.float64]) -> tuple[tuple[int, ...], Estimate]:
    """Return the index of the largest value of an array, and that value with its error from `se`, of the same shape."""
    place = tuple(int(k) for k in np.unravel_index(int(np.argmax(value)), value.shape))
    return place, Estimate(float(value[place]), float(se[place]))


def pixel_size(irradiance: Map, extent: Extent) -> tuple[float, float]:
    """Return the width and height of a pixel, mm."""
    height, width = irradiance.shape
    x0, x1, y0, y1 = extent
    return (x1 - x0) / width, (y1 - y0) / height


def pixels_averaged(image: Map, cells: int) -> int:
    """Return the side, in pixels, of square blocks such that a map has at most `cells` blocks along either side."""
    return max(-(-max(image.shape) // cells), 1)


def averaged(image: Map, extent: Extent, cells: int) -> tuple[Map, Extent]:
    """
    Return a map of fewer pixels: means over squares whose side in pixels is `pixels_averaged`.

    Parameters
    ----------
    image : (H, W) float
        Irradiance, W/mm².
    extent : (float, float, float, float)
        Extent x0, x1, y0, y1, mm.
    cells : int
        Largest number of squares along either side, at least 1.

    Returns
    -------
    (h, w) float
        Mean irradiance, W/mm². Squares that reach beyond the detector have the mean of their pixels on it.
    (float, float, float, float)
        Extent x0, x1, y0, y1 of the whole squares, mm.
    """
    pixels = pixels_averaged(image, cells)
    sums, counts = in_squares(image, pixels), in_squares(np.ones_like(image), pixels)
    (rows, columns), (width, height) = sums.shape, pixel_size(image, extent)
    right, top = extent[0] + columns * pixels * width, extent[2] + rows * pixels * height
    return sums / counts, (extent[0], float(right), extent[2], float(top))


def log10_image(irradiance: Map, floor: float) -> npt.NDArray[np.float64]:
    """
    Return the decimal logarithm of a map.

    Parameters
    ----------
    irradiance : (H, W) float
        Irradiance, W/mm².
    floor : float
        Smallest irradiance shown, W/mm², > 0. Pixels below it are NaN, so that a plot leaves them empty.

    Raises
    ------
    MistrayError
        If the floor is not above 0.

    Examples
    --------
    >>> mistray.analysis.log10_image(np.array([[1e-3, 1e-9]]), floor=1e-6)
    array([[-3., nan]])
    """
    if not floor > 0:
        raise MistrayError(f"log10_image: floor is {floor:g} W/mm²; it must be positive")
    image = np.full(irradiance.shape, np.nan)
    lit = irradiance >= floor
    image[lit] = np.log10(irradiance[lit])
    return image


def log_range(maps: list[Map], decades: float = 10.0) -> tuple[float, float] | None:
    """
    Return the common colour range of several maps on a log10 scale.

    Parameters
    ----------
    maps : list of (H, W) float
        Irradiance, W/mm².
    decades : float
        Widest range, in powers of ten.

    Returns
    -------
    (float, float) or None
        Exponents of ten of floor and top, W/mm². The top is the largest irradiance, rounded up to a power of ten. The
        floor is the 1 % quantile of the pixels above 0, rounded down. It lies at least one decade below the top, and at
        most ``decades``. None when no pixel is above 0.
    """
    lit = np.concatenate([m[m > 0] for m in maps]) if maps else np.empty(0)
    if not lit.size:
        return None
    top = float(np.ceil(np.log10(lit.max())))
    floor = float(np.floor(np.log10(np.quantile(lit, 0.01, method="lower"))))
    return max(min(floor, top - 1), top - decades), top


def mirror_asymmetry(irradiance: Map, irradiance_se: Map) -> tuple[float, float]:
    """
    Return the relative difference of a map from its mirror image x → -x, as a check of the sampling.

    A system of revolution with the source in the y-z plane (azimuth 0 or 180 degrees) gives a map that is symmetric
    about its vertical centre line. What remains is noise, so the measured value should be about the expected one.

    Returns
    -------
    measured : float
        Σ|E - E'| / Σ(E + E'), 0 … 1, where E' is the mirrored map. The sums are over pixels that have a known error, as
        their mirror images have. Both numbers are NaN if there is no light in these pixels.
    expected : float
        Expected value of `measured` for Gaussian noise of the standard errors alone: the mean of |N(0, s)| is
        s·sqrt(2/π).

    Examples
    --------
    >>> image = np.array([[1.0, 2.0, 1.0], [3.0, 5.0, 3.0]])
    >>> measured, expected = mistray.analysis.mirror_asymmetry(image, 0.1 * image)
    >>> print(f"{measured:.3f}, {expected:.3f} by noise alone")
    0.000, 0.030 by noise alone
    """
    difference, noise = np.abs(irradiance - irradiance[:, ::-1]), np.hypot(irradiance_se, irradiance_se[:, ::-1])
    known = np.isfinite(noise)
    total = 2.0 * irradiance[known].sum()
    if total == 0:
        return float("nan"), float("nan")
    # The centre column of an odd width is its own mirror image
    if irradiance.shape[1] % 2:
        noise[:, irradiance.shape[1] // 2] = 0
    return float(difference[known].sum() / total), float(np.sqrt(2 / np.pi) * noise[known].sum() / total)

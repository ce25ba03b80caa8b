"""Results of image quality: sampled light of each field and wavelength, and quantities derived from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analyses.image.line_image import AZIMUTHS, Array, LineImage, PointSpread, direction_of
from mistray.errors import MistrayError
from mistray.physics.imaging.ideal import airy_diameter
from mistray.ranges import FINITE, FREQUENCY_PER_MM, PLACE_MM, POSITIVE, SHARE, Each, Range
from mistray.result import KeyNumber, Result
from mistray.toolkit.tables.frames import row_of

OfField = TypeVar("OfField")

PIXELS = Range(2, 4096, whole=True)
PSF_PIXELS = 128
ENERGY = 0.8  # share of the flux whose radius the tables state
WINDOW = 0.45  # of the period of the PSF, the largest radius that encircled energy is worked out for
PSF_METHODS = ("fft", "huygens")
OWN_COLUMNS = (
    *("relative_illumination", "distortion_percent", "calibrated_distortion_percent", "tangential_focus_mm"),
    *("sagittal_focus_mm", "chief_angle_deg", "pupil_distance_mm"),
)


FREQUENCIES = Each(FREQUENCY_PER_MM, least=0)


@dataclass(frozen=True, eq=False, repr=False)
class FieldImage(Result, table=".page:field_image_table", figure=".figures:field_mtf_figure"):
    """
    Image of one field point at all wavelengths.

    Attributes
    ----------
    field_deg, azimuth_deg : float
        Angle and azimuth of the field, degrees.
    field_mm : float
        Object height of a near object, mm; NaN for one far away.
    lines : tuple of LineImage
        Image at each wavelength. All have the same image point: that of the chief ray at the reference wavelength.
    reference : int
        Index of the reference wavelength.
    point_mm : (3,) float64
        Image point in world coordinates, mm.
    image_mm : (2,) float64
        Image point in the frame of the detector, mm.
    axes : (3, 3) float64
        Unit vectors as columns: x (sagittal) and y (tangential) on the detector, and z along the light.
    pupil_distance_mm : float
        Radius of the reference sphere, mm: by default from the exit pupil on the axis to the image point, negative if
        the pupil lies behind it. It is ``inf`` for a plane, as with a pupil at infinity or within the blur.
    chief_angle_deg : float
        Angle between the chief ray and the normal of the detector, degrees.
    distortion_percent, calibrated_distortion_percent : float
        Relative deviation of the image height from f tan θ, or from the magnification of a near object, percent. The
        scale is that on the axis, or the one that leaves the least distortion in all fields. NaN on the axis.
    relative_illumination : float
        Irradiance of the image of an even scene over that on the axis, dimensionless. If no light reaches the detector
        on the axis, it is over that of the first field.
    tangential_focus_mm, sagittal_focus_mm : float
        Foci of rays close to the chief ray, mm from the detector along z, positive beyond it; NaN for afocal light.

    Examples
    --------
    >>> (field,) = mistray.image_quality(mistray.load("ritchey_chretien"), 0.1, grid=32)
    >>> print(f"RMS spot {1000 * field.rms_spot_mm():.1f} µm, Airy disc {1000 * field.airy_diameter_mm():.1f} µm")
    RMS spot 3.3 µm, Airy disc 13.2 µm
    >>> field.mtf([20.0, 50.0]).round(2)
    array([0.74, 0.39])
    """

    field_deg: float
    azimuth_deg: float
    field_mm: float
    lines: tuple[LineImage, ...]
    reference: int
    point_mm: Array
    image_mm: Array
    axes: Array
    pupil_distance_mm: float
    chief_angle_deg: float
    distortion_percent: float
    calibrated_distortion_percent: float
    relative_illumination: float
    tangential_focus_mm: float
    sagittal_focus_mm: float

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the field, its RMS spot (µm), RMS OPD (waves) and Strehl ratio, by label."""
        numbers = {
            "RMS spot [µm]": 1e3 * self.rms_spot_mm(),
            "RMS OPD [waves]": self.rms_waves(),
            "Strehl": self.strehl,
        }
        return {"field": self.name, **numbers}

    @property
    def resolved(self) -> bool:
        """True if the grid resolves the wavefronts, so that a PSF and an MTF exist."""
        return all(line.pupil.resolved for line in self.lines)

    @property
    def name(self) -> str:
        """Name of the field for tables, such as ``10°`` or ``2 mm``."""
        return f"{self.field_deg:g}°" if math.isnan(self.field_mm) else f"{self.field_mm:g} mm"

    @property
    def shares(self) -> Array:
        """Fraction of the image's flux at each wavelength, (n,)."""
        flux = np.array([line.weight * line.pupil.total for line in self.lines])
        return np.asarray(flux / flux.sum())

    @property
    def main(self) -> LineImage:
        """Image at the reference wavelength."""
        return self.lines[self.reference]

    @property
    def centroid_mm(self) -> Array:
        """Centroid of the flux of all wavelengths relative to the image point, (2,) mm."""
        return np.asarray(sum(s * line.centroid_mm for s, line in zip(self.shares, self.lines, strict=True)))

    def rms_spot_mm(self, about: str = "centroid") -> float:
        """
        Return the RMS distance of the rays of all wavelengths from their centroid, or from the chief ray, mm.

        Parameters
        ----------
        about : {"centroid", "chief"}
            Point from which distances are measured.

        Raises
        ------
        MistrayError
            If `about` is another word.
        """
        if about not in ("centroid", "chief"):
            raise MistrayError(f"about is '{about}'; give 'centroid' or 'chief'")
        middle = self.centroid_mm if about == "centroid" else np.zeros(2)
        total = 0.0
        for share, line in zip(self.shares, self.lines, strict=True):
            lit = line.pupil.lit
            square = ((line.spot_mm[lit] - middle) ** 2).sum(axis=1) + line.blur_mm2[lit]
            total += share * float((line.pupil.energy[lit] * square).sum()) / line.pupil.total
        return math.sqrt(total)

    def spot_radius_mm(self) -> float:
        """Return the largest distance of a ray from the centroid of the spot, mm."""
        middle = self.centroid_mm
        return max(float(np.linalg.norm(line.spot_mm[line.pupil.lit] - middle, axis=1).max()) for line in self.lines)

    def rms_waves(self, removed: str = "tilt") -> float:
        """Return the RMS OPD over all wavelengths by their shares, waves; see `LineImage.rms_waves`."""
        squares = [line.rms_waves(removed) ** 2 for line in self.lines]
        return math.sqrt(float(self.shares @ squares))

    @property
    def strehl(self) -> float:
        """Mean of the Strehl ratios at the wavelengths, 0 … 1, weighted by their shares; NaN if one is not resolved."""
        return float(self.shares @ [line.strehl for line in self.lines])

    def otf(self, frequencies_per_mm: npt.ArrayLike, azimuth: str | float = "tangential") -> npt.NDArray[np.complex128]:
        """
        Return the complex optical transfer function about the image point, (m,), dimensionless, 1 at frequency 0.

        Parameters
        ----------
        frequencies_per_mm : float or (m,) array_like
            Spatial frequencies on the detector, 1/mm.
        azimuth : {"tangential", "sagittal"} or float
            Direction in which the pattern varies; degrees count from sagittal (x) to tangential (y).
        """
        x, y = direction_of(azimuth)
        f = _frequencies(frequencies_per_mm)
        return np.asarray(
            sum(s * line.pupil.otf(f * x, f * y) for s, line in zip(self.shares, self.lines, strict=True))
        )

    def mtf(self, frequencies_per_mm: npt.ArrayLike, azimuth: str | float = "tangential") -> Array:
        """Return the modulation transfer function |OTF|, (m,), 0 … 1; for the arguments see `otf`."""
        return np.asarray(np.abs(self.otf(frequencies_per_mm, azimuth)))

    def diffraction_limit(self, frequencies_per_mm: npt.ArrayLike, azimuth: str | float = "tangential") -> Array:
        """Return the MTF, (m,), 0 … 1, of the same light without aberration, with its vignetting; see `otf`."""
        x, y = direction_of(azimuth)
        f = _frequencies(frequencies_per_mm)
        parts = (s * line.pupil.ideal().otf(f * x, f * y) for s, line in zip(self.shares, self.lines, strict=True))
        return np.asarray(np.abs(sum(parts)))

    def cut_off_per_mm(self, azimuth: str | float = "tangential") -> float:
        """Return the largest spatial frequency, 1/mm, with any contrast at some wavelength; for `azimuth` see `otf`."""
        return max(line.pupil.cut_off(direction_of(azimuth)) for line in self.lines)

    def f_number(self, azimuth: str | float = "tangential") -> float:
        """Return the working F-number, 1/(λ cut-off) at the reference wavelength λ; for `azimuth` see `otf`."""
        pupil = self.main.pupil
        return 1 / (pupil.wavelength_mm * pupil.cut_off(direction_of(azimuth)))

    def airy_diameter_mm(self) -> float:
        """Return the Airy diameter 2.44 λN, mm, at the reference wavelength; N is the geometric mean of T and S."""
        n = math.sqrt(self.f_number("tangential") * self.f_number("sagittal"))
        return airy_diameter(self.main.pupil.wavelength_mm, n)

    def psf(
        self, pixels: int = PSF_PIXELS, pixel_mm: float | None = None, method: str = "fft", line: int | None = None
    ) -> PointSpread:
        """
        Return the point spread function about the image point.

        Parameters
        ----------
        pixels : int
            Number of pixels across.
        pixel_mm : float, optional
            Size of a pixel, mm; by default a quarter of the inverse of the cut-off frequency.
        method : {"fft", "huygens"}
            Fourier transform of the pupil, or sum of wavelets with exact path lengths to points of the tangent plane.
        line : int, optional
            Index of a wavelength. Default: all, weighted by their shares.

        Raises
        ------
        MistrayError
            If the method is unknown, or a value is out of range or goes beyond the computed image.
        """
        pixels = PIXELS.check("pixels", pixels)
        if line is not None:
            line = Range(-len(self.lines), len(self.lines) - 1, whole=True).check("line", line)
        if method not in PSF_METHODS:
            raise MistrayError(f"method is '{method}'; give 'fft' or 'huygens'")
        if pixel_mm is None:
            pixel_mm = 0.25 / max(self.cut_off_per_mm(name) for name in AZIMUTHS)
        POSITIVE.check("pixel_mm", pixel_mm)
        largest = 2 * self.largest_radius_mm
        if pixels * pixel_mm > largest:
            raise MistrayError(
                f"{pixels} pixels of {pixel_mm:.4g} mm: the grid of the pupil gives a PSF of {largest:.4g} mm at most; "
                "give fewer or smaller pixels, or a larger grid"
            )
        at: Array = np.asarray(pixel_mm * (np.arange(pixels) - pixels // 2), dtype=np.float64)
        some = range(len(self.lines)) if line is None else [line]
        shares = self.shares if line is None else {line: 1.0}
        points = np.stack([*np.meshgrid(at, at), np.zeros((pixels, pixels))], axis=-1).reshape(-1, 3)
        total = np.zeros((pixels, pixels))
        for k in some:
            pupil = self.lines[k].pupil
            found = pupil.psf(at, at) if method == "fft" else pupil.huygens(points).reshape(pixels, pixels)
            total += shares[k] * found
        return PointSpread(total, pixel_mm, at, at)

    def encircled_energy(self, radii_mm: npt.ArrayLike, about: str = "centroid", square: bool = False) -> Array:
        """
        Return the share of the flux within circles of given radii, or within squares of these half sides, (m,), 0 … 1.

        Parameters
        ----------
        radii_mm : float or (m,) array_like
            Radii, or half sides of squares, mm.
        about : {"centroid", "chief", "peak"}
            Centre of the circles or squares; "peak" is that of the point spread at the reference wavelength.
        square : bool
            Whether to use squares.

        Raises
        ------
        MistrayError
            If a radius is below 0 or beyond the computed image, or `about` is another word.
        """
        if about not in MIDDLES:
            raise MistrayError(f"about is '{about}'; give 'centroid', 'chief' or 'peak'")
        x, y = MIDDLES[about](self)
        radii = np.array(FINITE.check_each("radii_mm", radii_mm))
        if not np.all((radii >= 0) & (radii <= self.largest_radius_mm)):
            raise MistrayError(
                f"radii_mm reach from {radii.min():g} to {radii.max():g}; they must lie between 0 and "
                f"{self.largest_radius_mm:.4g} mm, or give a larger grid"
            )
        parts = (
            s * line.pupil.encircled(radii, (float(x), float(y)), square)
            for s, line in zip(self.shares, self.lines, strict=True)
        )
        return np.asarray(sum(parts))

    @property
    def largest_radius_mm(self) -> float:
        """Largest radius for which the sampling of the pupil allows encircled energy, mm."""
        return min(WINDOW / line.pupil.frequency_step for line in self.lines)

    def encircled_radius_mm(self, share: float = ENERGY, about: str = "centroid") -> float:
        """
        Return the radius of the circle that holds a share of the flux, mm; NaN if it exceeds `largest_radius_mm`.

        `share` is 0 … 1, and `about` the centre of the circle, as in `encircled_energy`.
        """
        from scipy.optimize import brentq

        SHARE.check("share", share)
        high = self.largest_radius_mm
        if not float(self.encircled_energy(high, about)[0]) >= share:
            return math.nan
        low = 0.0
        for radius in np.geomspace(high / 256, high, 17):
            if float(self.encircled_energy(radius, about)[0]) >= share:
                high = float(radius)
                break
            low = float(radius)
        return float(brentq(lambda r: float(self.encircled_energy(r, about)[0]) - share, low, high, xtol=1e-6 * high))

    def line_spread(self, x_mm: npt.ArrayLike, azimuth: str | float = "tangential") -> tuple[Array, Array]:
        """
        Return line and edge spread functions along a direction, by the Fourier transform of the OTF.

        Parameters
        ----------
        x_mm : float or (m,) array_like
            Positions along the direction relative to the image point, mm.
        azimuth : {"tangential", "sagittal"} or float
            Direction across the line and the edge; degrees count from sagittal (x) to tangential (y).

        Returns
        -------
        line, edge : (m,) float64
            Flux per mm at each position, 1/mm, and flux up to each position, for a total flux of 1.

        Raises
        ------
        MistrayError
            If a position is beyond the computed image, where the image would be repeated.
        """
        x = np.array(PLACE_MM.check_each("x_mm", x_mm))
        if not np.all(np.abs(x) <= self.largest_radius_mm):
            raise MistrayError(
                f"x_mm reach from {x.min():g} to {x.max():g}; they must lie within {self.largest_radius_mm:.4g} mm of "
                "the image point, or give a larger grid"
            )
        df = min(line.pupil.frequency_step for line in self.lines) / 2
        f = np.arange(1, math.ceil(self.cut_off_per_mm(azimuth) / df) + 1) * df
        values = self.otf(f, azimuth)
        turns = np.exp(2j * np.pi * np.outer(x, f))
        line = df * (1 + 2 * (turns @ values).real)
        first = np.where(np.arange(1, len(f) + 1) % 2, -1, 1)  # exp(2πi f x) where the period of the image begins
        edge = 0.5 + df * x + 2 * df * ((turns - first) @ (values / (2j * np.pi * f))).real
        return line, edge


MIDDLES: dict[str, Callable[[FieldImage], Array]] = {
    "centroid": lambda image: image.centroid_mm,
    "chief": lambda image: np.zeros(2),
    "peak": lambda image: image.main.peak[1],
}


def _frequencies(values: npt.ArrayLike) -> Array:
    return np.array(FREQUENCIES.check("frequencies_per_mm", values), dtype=np.float64)


class OfFields(Sequence[OfField]):
    """Base of results that are sequences over field points; `fields` holds the items."""

    fields: tuple[OfField, ...]

    def __len__(self) -> int:
        return len(self.fields)

    def __getitem__(self, number: Any) -> Any:
        return self.fields[number]


@dataclass(frozen=True, eq=False, repr=False)
class ImageQuality(OfFields[FieldImage], Result, table=".page:quality_table", figure=".figures:mtf_figure"):
    """
    Image quality of the direct light of a scene, as a sequence of the images of its field points.

    Attributes
    ----------
    fields : tuple of FieldImage
        Image of each field point.
    wavelengths_nm, weights : (n,) float64
        Wavelengths, nm, and their shares of the flux, whose sum is 1.
    stop : str
        Id of the surface at the rim of the aperture stop.
    image_scale_mm : float
        Image height per unit of tan θ on the axis, mm: the focal length if the detector is in focus;
        ``nan`` for a near object.
    magnification : float
        Image height per object height on the axis, dimensionless; ``nan`` for an object far away.
    facts : dict
        Settings and facts of the computation, as plain values.
    notes : tuple of str
        Limits of validity and other remarks on the result.

    Examples
    --------
    >>> found = mistray.image_quality(mistray.load("ritchey_chretien"), [0, 0.1], grid=32)
    >>> print(f"focal length {found.image_scale_mm:.0f} mm, stop: {found.stop}")
    focal length 4929 mm, stop: primary
    >>> found.to_pandas([50.0])[["field_deg", "mtf_tangential_50_per_mm"]].round(2)
       field_deg  mtf_tangential_50_per_mm
    0        0.0                      0.48
    1        0.1                      0.39
    """

    fields: tuple[FieldImage, ...]
    wavelengths_nm: Array
    weights: Array
    stop: str
    image_scale_mm: float
    magnification: float
    facts: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of fields, and the largest RMS spot (µm) and RMS OPD (waves) of any field, by label."""
        found: dict[str, KeyNumber] = {"fields": len(self)}
        if len(self):
            found["largest RMS spot [µm]"] = 1e3 * max(image.rms_spot_mm() for image in self)
            found["largest RMS OPD [waves]"] = max(image.rms_waves() for image in self)
        return found

    @property
    def near(self) -> bool:
        """True if the object is at a finite distance."""
        return not math.isnan(self.magnification)

    def default_frequencies(self) -> list[float]:
        """Return three default frequencies, 1/mm: 1/8, 1/4 and 1/2 of the sagittal cut-off of the first field."""
        cut = self.fields[0].cut_off_per_mm("sagittal")
        return [float(f"{share * cut:.2g}") for share in (0.125, 0.25, 0.5)]

    def to_pandas(self, frequencies_per_mm: float | Sequence[float] | None = None) -> pd.DataFrame:
        """
        Return a table with a row for each field, all wavelengths together.

        Columns hold field, image point and spots (mm), wavefronts (waves), Strehl ratio, MTF, F-numbers, distortion and
        illumination. Their names end in units.

        Parameters
        ----------
        frequencies_per_mm : float or sequence of float, optional
            Frequencies of the columns ``mtf_tangential_…_per_mm`` and ``mtf_sagittal_…_per_mm``, 1/mm; by default three
            below the cut-off.
        """
        given = self.default_frequencies() if frequencies_per_mm is None else frequencies_per_mm
        frequencies = FREQUENCIES.check("frequencies_per_mm", given)
        rows = []
        for image in self:
            row: dict[str, Any] = {
                **row_of(image, "field_deg", "azimuth_deg", *["field_mm"] * self.near),
                "x_mm": image.image_mm[0],
                "y_mm": image.image_mm[1],
                "rms_spot_mm": image.rms_spot_mm(),
                "rms_spot_about_chief_mm": image.rms_spot_mm("chief"),
                "spot_radius_mm": image.spot_radius_mm(),
                "rms_opd_waves": image.rms_waves(),
                "rms_opd_in_focus_waves": image.rms_waves("focus"),
                "pv_opd_waves": max(line.pv_waves() for line in image.lines),
                "best_focus_mm": float(image.shares @ [line.pupil.best_focus_mm() for line in image.lines]),
                "strehl": image.strehl,
            }
            for azimuth in ("tangential", "sagittal"):
                for f, value in zip(frequencies, image.mtf(frequencies, azimuth), strict=True):
                    row[f"mtf_{azimuth}_{f:g}_per_mm"] = float(value)
            row |= {
                "encircled_80_radius_mm": image.encircled_radius_mm(ENERGY),
                "airy_diameter_mm": image.airy_diameter_mm(),
                "f_number_tangential": image.f_number("tangential"),
                "f_number_sagittal": image.f_number("sagittal"),
            }
            rows.append(row | row_of(image, *OWN_COLUMNS))
        return pd.DataFrame(rows)

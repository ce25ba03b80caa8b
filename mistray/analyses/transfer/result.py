"""Effects of stray light on the image of each field point: energy balance, transfer and spread functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analyses.image.line_image import PointSpread, direction_of
from mistray.analyses.image.result import FieldImage, OfFields
from mistray.analyses.transfer.image_spread import CLASSES, DIFFRACTION, DIRECT, GHOSTS, SCATTER, ImageSpread
from mistray.analyses.transfer.pixels import PixelResponse
from mistray.errors import MistrayError
from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.stray_metric import StrayMetric
from mistray.ranges import FINITE, SHARE
from mistray.recorders.sampled import Sampled
from mistray.result import KeyNumber, Result
from mistray.toolkit.tables.frames import flat

Array = npt.NDArray[np.float64]

AZIMUTHS = ("tangential", "sagittal")
# Of the period of the point spread function: where its asymptote takes over at the earliest and at the latest
JOIN, LAST = 0.125, 0.25
REACH = 2.0  # radii of the spot, before which it does not
PARTS = ("direct", "ghosts", "scatter")
"""Of a point spread function: `CLASSES` with the light that edges diffract in the direct image, whose diffraction has
it already."""


class TransferCurve(NamedTuple):
    """Values over frequency or radius with their standard errors, (m,) each; dimensionless unless stated otherwise."""

    value: Array
    se: Array


@dataclass(frozen=True, eq=False, repr=False)
class FieldTransfer(Result, table=".page:curve_table", figure=".figures:mtf_figure"):
    """
    Image of one field point with its stray light.

    The origin is the centroid of the direct image. All light on the detector counts as 1, except in `books` and
    `glare`.

    Attributes
    ----------
    image : FieldImage
        Direct image.
    spread : ImageSpread
        All light on the detector about the origin.
    books : dict of str to Estimate
        Balance of the launched light, as shares, 0 … 1: the classes of `CLASSES` on the detector,
        "absorbed_by_surfaces", "absorbed_in_media", "escaped" and "cut". The sum is 1.
    frequencies_per_mm : (m,) float64
        Spatial frequencies of all curves, 1/mm.
    pixels : PixelResponse or None
        Pixels of the detector; None: it resolves everything.
    glare : StrayMetric
        Flux of all stray light over that of the direct image, dimensionless: "gsr" of `mistray.analyses.pst.glare`.
    axes : (2, 2) float64
        Rows: directions of `AZIMUTHS` in the frame of the detector.
    origin_mm : (2,) float64
        Position of the origin in the frame of the detector, mm.
    resolution_mm : float
        Uncertainty of the hits of rays in float32, mm. Fourier sums of stray light are blurred by a Gaussian of this
        standard deviation, so that finer frequencies fade and do not alias.
    notes : tuple of str
        Remarks on the reliability of the results.

    Examples
    --------
    >>> (field,) = mistray.transfer(mistray.load("cooke_triplet"), rays=5000, frequencies_per_mm=[10, 20, 40])
    >>> print(f"stray light lowers the contrast of fine detail to {field.veiling_floor.value:.1%}")
    stray light lowers the contrast of fine detail to 98.1%
    """

    image: FieldImage
    spread: ImageSpread
    books: dict[str, Estimate]
    frequencies_per_mm: Array
    pixels: PixelResponse | None
    glare: StrayMetric
    axes: Array
    origin_mm: Array
    resolution_mm: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the field, such as "10°"."""
        return self.image.name

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the field, the veiling floor of its transfer functions, and its glare, by label."""
        glare = Estimate(self.glare.value, self.glare.se)
        return {"field": self.name, "veiling floor [1]": self.veiling_floor, "glare [1]": glare}

    # Powers

    def _power(self, kind: int, line: float | None = None) -> Sampled:
        return self.spread.rings(kind, line).total()

    def _direct(self, line: float | None = None) -> Sampled:
        return self._power(DIRECT, line) + self._power(DIFFRACTION, line)

    @cached_property
    def _detected(self) -> Sampled:
        return Sampled.total(_stacked([self._power(k) for k in range(len(CLASSES))]))

    @cached_property
    def shares(self) -> dict[str, Estimate]:
        """Share of the light on the detector by class, 0 … 1 each."""
        return {name: _estimate(self._power(k).over(self._detected)) for k, name in enumerate(CLASSES)}

    @property
    def veiling_floor(self) -> Estimate:
        """
        Veiling floor, 0 … 1: contrast of fine detail with stray light over that without it.

        It is the direct light over all light on the detector, without ghosts 1 - TIS. The `composite` over
        `without_stray` drops to it between zero and the frequencies of the lens.
        """
        return _estimate(self._direct().over(self._detected))

    @property
    def contrast_factor(self) -> StrayMetric:
        """Contrast with stray light over contrast without it in an even scene: 1/(1 + `glare`)."""
        inverse = 1 / (1 + self.glare.value)
        return StrayMetric.of("contrast_factor", Estimate(inverse, inverse**2 * self.glare.se), facts=self.glare.facts)

    # Transfer functions

    def _number(self, azimuth: str) -> int:
        if azimuth not in AZIMUTHS:
            raise MistrayError(f"azimuth is '{azimuth}'; give {' or '.join(map(repr, AZIMUTHS))}")
        return AZIMUTHS.index(azimuth)

    def _waves(self, kind: int, azimuth: str, line: float | None = None) -> _Complex:
        """
        Return Fourier sums of a light class about the origin, W, (m,), complex with batch deviations for errors.

        `kind` is the place of the class in `CLASSES`, `line` a traced wavelength, nm; None: sums over all of them. Fine
        frequencies fade by `resolution_mm`.
        """
        n, m = self._number(azimuth), len(self.frequencies_per_mm)
        part = slice(n * m, (n + 1) * m)
        real, imaginary = (found[part] for found in self.spread.waves(kind, line))
        found = _Complex(real.value + 1j * imaginary.value, real.apart + 1j * imaginary.apart)
        return found.times(np.exp(-2 * (np.pi * self.resolution_mm * self.frequencies_per_mm) ** 2))

    def _direct_otf(self, azimuth: str) -> list[npt.NDArray[np.complex128]]:
        """Return the OTF of the direct image about the origin at each wavelength, (m,) each, complex."""
        x, y = direction_of(azimuth)
        f = self.frequencies_per_mm
        moved = np.exp(2j * np.pi * f * float(self.image.centroid_mm @ np.array([x, y])))
        return [line.pupil.otf(f * x, f * y) * moved for line in self.image.lines]

    @cached_property
    def _traced(self) -> list[tuple[float, float]]:
        """Traced wavelength that stands for each line of the image, nm, and the line's fraction of the light there."""
        traced = np.sort([*self.spread.by_line])  # a time budget leaves wavelengths out
        nearest = [float(traced[np.abs(traced - line.wavelength_nm).argmin()]) for line in self.image.lines]
        sums = {nm: self.image.shares[np.equal(nearest, nm)].sum() for nm in nearest}
        return [(nm, share / sums[nm]) for nm, share in zip(nearest, self.image.shares, strict=True)]

    def lens(self, azimuth: str = "tangential") -> Array:
        """Return the MTF of the direct image alone, (m,), 0 … 1, along `azimuth`, without Monte Carlo noise."""
        return self.image.mtf(self.frequencies_per_mm, azimuth)

    def detector(self, azimuth: str = "tangential") -> Array:
        """
        Return the transfer function of the detector along `azimuth`, (m,).

        It is negative in places beyond 1/pixel, and 1 without `pixels`.
        """
        if self.pixels is None:
            return np.ones(len(self.frequencies_per_mm))
        nu = self.frequencies_per_mm[:, None] * self.axes[self._number(azimuth)]
        return self.pixels.at(nu[:, 0], nu[:, 1])

    def stf(self, azimuth: str = "tangential") -> TransferCurve:
        """
        Return the scatter transfer function |STF| along `azimuth`, (m,), with errors.

        The direct light counts as a point, and its sum with the scattered light as 1. The value is 1 at zero frequency,
        and 1 - TIS of this light where scatter is not resolved.
        """
        light = self._direct()
        return (self._waves(SCATTER, azimuth) + light).over(light + self._power(SCATTER)).modulus()

    def ghosts(self, azimuth: str = "tangential") -> TransferCurve:
        """
        Return the ghost transfer function along `azimuth`, (m,), with errors.

        It is like `stf` with ghosts in place of scatter: 1 at zero frequency, then a floor of direct light.
        """
        light = self._direct()
        return (self._waves(GHOSTS, azimuth) + light).over(light + self._power(GHOSTS)).modulus()

    def composite(self, azimuth: str = "tangential") -> TransferCurve:
        """
        Return the MTF with stray light and detector, (m,): |Σ_λ lens · (direct + scatter) + ghosts| · |detector|.

        The lens multiplies scattered light too, as in Harvey's product; ghosts are added as rays.
        """
        total = self._waves(GHOSTS, azimuth)
        for otf, (line, part) in zip(self._direct_otf(azimuth), self._traced, strict=True):
            light = self._waves(SCATTER, azimuth, line) + self._direct(line)
            total = total + light.times(part * otf)
        found = total.over(self._detected).modulus()
        factor = np.abs(self.detector(azimuth))
        return TransferCurve(found.value * factor, found.se * factor)

    def without_stray(self, azimuth: str = "tangential") -> Array:
        """Return the MTF of lens and detector along `azimuth`, (m,), 0 … 1."""
        return self.lens(azimuth) * np.abs(self.detector(azimuth))

    def in_doubt(self, azimuth: str = "tangential") -> float:
        """
        Return the largest share of contrast, 0 … 1, that scatter would gain if the lens did not multiply it.

        Scatter so narrow that it lies within the direct image is multiplied by the lens, although its rays include that
        blur already. The truth lies between. The contrast is that along `azimuth`.
        """
        waves = self._waves(SCATTER, azimuth).over(self._detected)
        return float(np.max(np.abs(waves.value) * (1 - self.lens(azimuth)), initial=0.0))

    def frequency_at(self, contrast: float = 0.5, azimuth: str = "tangential", stray: bool = True) -> float:
        """
        Return the first frequency at which the MTF along `azimuth` falls to a contrast, 1/mm.

        The MTF is that with `stray` light, or without. The frequency is interpolated linearly. It is the first of
        `frequencies_per_mm` if the MTF is as low there, and NaN if it does not fall so far within them.
        """
        SHARE.check("contrast", contrast)
        curve = self.composite(azimuth).value if stray else self.without_stray(azimuth)
        below = np.flatnonzero(curve <= contrast)
        if not len(below):
            return float("nan")
        k = int(below[0])
        if k == 0:
            return float(self.frequencies_per_mm[0])
        (x0, x1), (y0, y1) = self.frequencies_per_mm[k - 1 : k + 1], curve[k - 1 : k + 1]
        return float(x0 + (y0 - contrast) / (y0 - y1) * (x1 - x0))

    # Point spread functions

    @property
    def edges_mm(self) -> Array:
        """Borders of the rings about the origin, (n + 1,) mm, the first 0."""
        return self.spread.edges_mm

    @cached_property
    def _direct_within(self) -> Array:
        """Fraction of the flux of the direct image within the radius of each ring edge, (n + 1,)."""
        return _continued(self.image, self.edges_mm)

    @cached_property
    def ring_shares(self) -> dict[str, TransferCurve]:
        """
        Share of the light on the detector in each ring, (n,), by part of `PARTS`.

        The direct image is spread by diffraction; its light beyond the last ring is `outside`. All shares and `outside`
        add up to 1.
        """
        floor = self.veiling_floor
        inside = np.diff(self._direct_within)
        found = {"direct": TransferCurve(floor.value * inside, floor.se * inside)}
        for name, kind in (("ghosts", GHOSTS), ("scatter", SCATTER)):
            part = self.spread.rings(kind).over(self._detected[None])
            found[name] = TransferCurve(part.value, part.se)
        return found

    @property
    def outside(self) -> float:
        """Fraction, 0 … 1, of the light on the detector that diffraction of the image spreads beyond the last ring."""
        return self.veiling_floor.value * float(1 - self._direct_within[-1])

    def psf_rings(self) -> dict[str, TransferCurve]:
        """Return the mean irradiance of each ring for a flux of 1 on the detector, (n,) 1/mm², by part of `PARTS`."""
        area = np.pi * np.diff(self.edges_mm**2)
        return {name: TransferCurve(part.value / area, part.se / area) for name, part in self.ring_shares.items()}

    def psf(self, pixels: int = 128, pixel_mm: float | None = None) -> tuple[PointSpread, Array]:
        """
        Return the composite point spread function on pixels about the image point, and its stray light.

        Ghosts and scatter are means over rings about the origin, which is adequate near the direct image.

        Parameters
        ----------
        pixels, pixel_mm
            Arguments of `FieldImage.psf`.

        Returns
        -------
        whole : PointSpread
            Irradiance of all light for a flux of 1 on the detector, 1/mm².
        stray : (pixels, pixels) float64
            Irradiance of the stray light in it, 1/mm².
        """
        direct = self.image.psf(pixels, pixel_mm)
        x, y = np.meshgrid(direct.x_mm - self.image.centroid_mm[0], direct.y_mm - self.image.centroid_mm[1])
        ring = np.clip(np.searchsorted(self.edges_mm, np.hypot(x, y), side="right") - 1, 0, len(self.edges_mm) - 2)
        rings = self.psf_rings()
        stray = (rings["ghosts"].value + rings["scatter"].value)[ring]
        return direct._replace(values=direct.values * self.veiling_floor.value + stray), stray

    def encircled_energy(self, radii_mm: npt.ArrayLike, stray: bool = True) -> TransferCurve:
        """
        Return the fraction, 0 … 1, of the light on the detector within circles about the origin, (m,) with its error.

        Parameters
        ----------
        radii_mm : float or (m,) array_like
            Radii of the circles, mm, from 0 to the last of `edges_mm`. Between two edges the irradiance of ghosts and
            scatter counts as constant.
        stray : bool
            Whether to include stray light; without it the fraction is that of the direct image alone.

        Raises
        ------
        MistrayError
            If a radius is below 0 or beyond the last edge.
        """
        radii = np.array(FINITE.check_each("radii_mm", radii_mm))
        if not np.all((radii >= 0) & (radii <= self.edges_mm[-1])):
            raise MistrayError(
                f"radii_mm reach from {np.min(radii):g} to {np.max(radii):g}; they must lie between 0 and "
                f"{self.edges_mm[-1]:.4g} mm"
            )
        direct = _continued(self.image, radii)
        return self._encircled(radii, direct) if stray else TransferCurve(direct, np.zeros(len(direct)))

    def _encircled(self, radii: Array, direct: Array) -> TransferCurve:
        """
        Return the fraction of all light within circles of some radii, mm, (m,), with errors.

        `direct` is the fraction of the direct image within them, (m,).
        """
        light = self._direct()
        inner, outer = self.edges_mm[:-1] ** 2, self.edges_mm[1:] ** 2
        part = np.clip((radii[:, None] ** 2 - inner) / (outer - inner), 0, 1)
        rings = self.spread.rings(GHOSTS) + self.spread.rings(SCATTER)
        within = Sampled(part @ rings.value + direct * light.value, part @ rings.apart + np.outer(direct, light.apart))
        found = within.over(self._detected[None])
        return TransferCurve(found.value, found.se)

    # Tables

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each frequency, 1/mm, and columns for each transfer function and azimuth."""
        columns: dict[str, Array] = {"frequency_per_mm": self.frequencies_per_mm}
        for azimuth in AZIMUTHS:
            columns[f"lens_{azimuth}"] = self.lens(azimuth)
            columns[f"detector_{azimuth}"] = self.detector(azimuth)
            for what in ("stf", "ghosts", "composite"):
                found = getattr(self, what)(azimuth)
                columns[f"{what}_{azimuth}"], columns[f"{what}_{azimuth}_se"] = found
        return pd.DataFrame(columns)

    def rings_to_pandas(self) -> pd.DataFrame:
        """
        Return a table with a row for each ring: radii, mm, irradiance of each part, 1/mm², and encircled energy.

        The last is the fraction within the outer radius, 0 … 1, of all light and of the direct image.
        """
        columns: dict[str, Array] = {"inner_mm": self.edges_mm[:-1], "outer_mm": self.edges_mm[1:]}
        for name, found in self.psf_rings().items():
            columns[f"{name}_per_mm2"], columns[f"{name}_se_per_mm2"] = found
        direct = self._direct_within[1:]
        whole = self._encircled(self.edges_mm[1:], direct)
        columns |= {"encircled": whole.value, "encircled_se": whole.se, "encircled_direct": direct}
        return pd.DataFrame(columns)

    def row(self, contrast: float = 0.5) -> dict[str, Any]:
        """
        Return the results of the field as plain values: shares, floor, glare, frequencies (1/mm) at a contrast.

        Shares and floor are 0 … 1; the glare is stray over direct light.
        """
        found: dict[str, Any] = {"field_deg": self.image.field_deg}
        if not np.isnan(self.image.field_mm):
            found["field_mm"] = self.image.field_mm
        found |= flat({f"share_{name}": share for name, share in self.shares.items()})
        found |= flat({"veiling_floor": self.veiling_floor, "glare": Estimate(self.glare.value, self.glare.se)})
        for azimuth in AZIMUTHS:
            for stray, text in ((False, "without_stray"), (True, "with_stray")):
                key = f"mtf{round(100 * contrast)}_{azimuth}_{text}_per_mm"
                found[key] = self.frequency_at(contrast, azimuth, stray)
        return found


@dataclass(frozen=True, eq=False, repr=False)
class Transfer(OfFields[FieldTransfer], Result, table=".page:field_table", figure=".figures:first_figure"):
    """
    Result of `mistray.transfer`: a sequence of the images of field points with their stray light.

    Attributes
    ----------
    fields : tuple of FieldTransfer
        Image of each field point.
    facts : dict
        Settings and facts of the computation, as plain values.
    notes : tuple of str
        Limits of validity and other remarks on the result.

    Examples
    --------
    >>> found = mistray.transfer(mistray.load("cooke_triplet"), rays=5000, frequencies_per_mm=[10, 20, 40])
    >>> found.books()[["direct", "ghosts", "escaped"]].round(2)
       direct  ghosts  escaped
    0    0.22     0.0     0.14
    """

    fields: tuple[FieldTransfer, ...]
    facts: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of fields, the lowest veiling floor and the highest glare of any field, by label."""
        found: dict[str, KeyNumber] = {"fields": len(self)}
        if len(self):
            glare = max((one.glare for one in self), key=lambda glare: glare.value)
            found["lowest veiling floor [1]"] = min(one.veiling_floor for one in self)
            found["highest glare [1]"] = Estimate(glare.value, glare.se)
        return found

    def to_pandas(self) -> pd.DataFrame:
        """
        Return a DataFrame with a row of results for each field.

        The columns are those of `FieldTransfer.row`: shares and veiling floor (0 … 1), glare (stray over direct light),
        and frequencies at 50 % contrast (1/mm).
        """
        return pd.DataFrame([one.row() for one in self])

    def books(self) -> pd.DataFrame:
        """Return the fractions, 0 … 1, of the launched light by destination, with standard errors, a row per field."""
        return pd.DataFrame([flat({"field_deg": one.image.field_deg, **one.books}) for one in self])


class _Complex(NamedTuple):
    """Complex values, (m,), with their deviation in each batch, (m, batches), from which standard errors follow."""

    value: npt.NDArray[np.complex128]
    apart: npt.NDArray[np.complex128]

    def __add__(self, other: Any) -> _Complex:
        return _Complex(self.value + other.value, self.apart + other.apart)

    def times(self, factor: npt.NDArray[Any]) -> _Complex:
        return _Complex(self.value * factor, self.apart * factor[:, None])

    def over(self, other: Sampled) -> _Complex:
        if not other.value:
            return _Complex(np.full_like(self.value, np.nan), np.full_like(self.apart, np.nan))
        value = self.value / other.value
        return _Complex(value, (self.apart - value[:, None] * other.apart) / other.value)

    def modulus(self) -> TransferCurve:
        size = np.abs(self.value)
        turn = np.where(size > 0, self.value.conj() / np.where(size > 0, size, 1), 1)
        return TransferCurve(size, np.sqrt(np.sum(np.real(turn[:, None] * self.apart) ** 2, axis=1)))


def _stacked(parts: Sequence[Sampled]) -> Sampled:
    return Sampled(np.stack([one.value for one in parts]), np.stack([one.apart for one in parts]))


def _estimate(found: Sampled) -> Estimate:
    value = float(found.value)
    return Estimate(value, float(found.se)) if np.isfinite(value) else UNKNOWN


def _continued(image: FieldImage, radii_mm: Array) -> Array:
    """
    Return the fraction of the flux of the direct image within circles of some radii, mm, about its centroid, (m,).

    Far out the share outside falls with the inverse of the radius, as for any aperture with a hard edge. This law
    takes over at `JOIN` of the period of the sampled point spread function, or farther out if rays of the image get
    there, up to `LAST`. At the edge of the period nothing is left outside, because light beyond it is folded back. At
    `LAST` this folding removes 1.8 π `LAST`³ = 9 % of the share outside, if it is spread evenly.
    """
    period = 1 / max(line.pupil.frequency_step for line in image.lines)
    join = min(max(JOIN * period, REACH * image.spot_radius_mm()), LAST * period)
    outside = max(0.0, 1 - float(image.encircled_energy([join])[0]))
    within = image.encircled_energy(np.minimum(radii_mm, join))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.clip(np.where(radii_mm <= join, within, 1 - outside * join / radii_mm), 0, 1)

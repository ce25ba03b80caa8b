"""Ghosts in colour: irradiance at each wavelength → CIE XYZ → sRGB, as a photograph would show them.

The light of a trace consists of lines or narrow bands, each with its share of the flux. The integrals of colorimetry
are therefore sums over the lines: ``X = Σ E_i x̄(λ_i)`` with E_i the irradiance of line i in W/mm² (not per nm) and x̄,
ȳ, z̄ the CIE 1931 2° observer (ISO/CIE 11664-1), linear between its values at whole nm. XYZ are in W/mm², up to the
factor 683 lm/W of the luminous flux; only their ratios matter here.

White
    "source": the light of the source itself appears grey, as after the white balance of a camera. The adaptation
    is Bradford's, from the XYZ of the launched flux to D65. "D65": no adaptation; the colours are those that an eye
    adapted to daylight sees.
Exposure
    Exposure is given in stops (factors of two) above the one that just fills the brightest channel of the reference.
    The reference is the stray light of all fields ("ghosts") or the direct image on axis ("direct"). All fields share
    it. If the reference is dark, the pictures are black.
Luminance
    The luminance of every pixel is its Y times the exposure, linear in the power; adaptation and gamut change the
    chromaticity alone.
Gamut
    Outside sRGB the negative channels are set to 0, which keeps the colour as saturated as the screen allows and the
    luminance right. Channels are clipped at 1 one by one, so that overexposed ghosts
    go towards white, as on a sensor. The shares of the affected pixels are reported.
Noise
    Every wavelength has rays of its own, so pixels with few rays show speckles of all colours. Pixels are averaged in
    square blocks, as many as it takes for `HITS_PER_BLOCK` stray rays of each wavelength in a lit block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.analyses.ghosts.request import Look
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.spectral import spectral_maps
from mistray.errors import MistrayError
from mistray.spectra import cie
from mistray.toolkit.figures.figure import Figure

Array = npt.NDArray[np.float64]
FEWEST_WAVELENGTHS = 3
LEAST_CONE_RESPONSE = 1e-3  # of a white, relative to its luminance
ROUNDING = 1e-9
HITS_PER_BLOCK = 20  # leaves about 20 % of noise in each line, less in luminance


@dataclass(frozen=True)
class Developed:
    """
    Picture in sRGB, ready to be shown.

    Attributes
    ----------
    rgb : (..., 3) float
        Encoded sRGB, 0 … 1.
    outside, overexposed : float
        Shares of the lit pixels, 0 … 1: outside the gamut of sRGB, and with a channel above its upper end.
    """

    rgb: Array
    outside: float
    overexposed: float


def check_wavelengths(wavelengths_nm: Sequence[float]) -> None:
    """Raise `MistrayError` unless these wavelengths, nm, suffice for a colour picture."""
    if len(wavelengths_nm) < FEWEST_WAVELENGTHS:
        known = ", ".join(f"{value:g}" for value in wavelengths_nm)
        raise MistrayError(
            f"colour: {len(wavelengths_nm)} wavelength{'s' * (len(wavelengths_nm) > 1)} ({known} nm); a colour picture "
            f"needs at least {FEWEST_WAVELENGTHS}, such as 450 550 650"
        )
    observer(np.array(wavelengths_nm))


def observer(wavelength_nm: npt.ArrayLike) -> Array:
    """
    Return x̄, ȳ, z̄ of the CIE 1931 2° observer, interpolated linearly.

    Parameters
    ----------
    wavelength_nm : (n,) float
        Wavelengths, 360 … 830 nm.

    Returns
    -------
    (n, 3) float

    Raises
    ------
    MistrayError
        If a wavelength lies outside the table.
    """
    known, table = cie.observer()
    wavelengths = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
    low, high = float(known[0]), float(known[-1])
    outside = wavelengths[(wavelengths < low) | (wavelengths > high)]
    if outside.size:
        raise MistrayError(
            f"colour: {outside[0]:g} nm is not visible; the CIE observer is known from {low:g} to {high:g} nm"
        )
    return np.column_stack([np.interp(wavelengths, known, values) for values in table.T])


def xyz(power: npt.ArrayLike, wavelength_nm: npt.ArrayLike) -> Array:
    """
    Return the CIE XYZ of light that consists of lines.

    Parameters
    ----------
    power : (n, ...) float
        Power, irradiance or reflectance at each wavelength.
    wavelength_nm : (n,) float
        Wavelengths, 360 … 830 nm.

    Returns
    -------
    (..., 3) float
        XYZ in the unit of `power`.
    """
    return np.tensordot(np.asarray(power, dtype=np.float64), observer(wavelength_nm), axes=(0, 0))


def develop(light: Array, exposure: float, white: Array | None = None) -> Developed:
    """
    Return XYZ as a picture in encoded sRGB (IEC 61966-2-1), as described at the head of this module.

    Parameters
    ----------
    light : (..., 3) float
        Light as XYZ, on any common scale.
    exposure : float
        Factor on the light; with 1 a Y of 1 becomes white.
    white : (3,) float, optional
        XYZ that appears grey, of any luminance. Default: D65, without adaptation.

    Raises
    ------
    MistrayError
        If `white` is too saturated to be a white: one of its cone responses is not positive.
    """
    linear, outside = linear_rgb(light, white)
    count = max(int(np.count_nonzero(linear.max(axis=-1) > 0)), 1)
    linear = exposure * linear
    over = linear.max(axis=-1) > 1 + ROUNDING
    encode = cie.colour_science().RGB_COLOURSPACES["sRGB"].cctf_encoding
    rgb = np.asarray(encode(np.clip(linear, 0.0, 1.0)), dtype=np.float64)
    return Developed(rgb, np.count_nonzero(outside) / count, np.count_nonzero(over) / count)


def linear_rgb(light: Array, white: Array | None = None) -> tuple[Array, npt.NDArray[np.bool_]]:
    """
    Return linear sRGB, (..., 3), with the light's luminance and no negative channel, and a mask of out-of-gamut pixels.

    Parameters
    ----------
    light, white
        Arguments of `develop`.

    Raises
    ------
    MistrayError
        If `white` is too saturated to be a white.
    """
    colour = cie.colour_science()
    space = colour.RGB_COLOURSPACES["sRGB"]
    primaries = colour.normalised_primary_matrix(space.primaries, space.whitepoint)
    to_rgb = np.linalg.inv(primaries)
    if white is not None:
        cones = colour.CHROMATIC_ADAPTATION_TRANSFORMS["Bradford"]
        own, wanted = cones @ (white / white[1]), cones @ colour.xy_to_XYZ(space.whitepoint)
        if own.min() < LEAST_CONE_RESPONSE:
            raise MistrayError("colour: the light of the source is too saturated to be taken as white; use white D65")
        to_rgb = to_rgb @ np.linalg.inv(cones) @ np.diag(wanted / own) @ cones
    linear = light @ to_rgb.T
    luminance = light[..., 1]
    outside = linear.min(axis=-1) < -ROUNDING * luminance
    inside = np.maximum(linear, 0.0)
    own_luminance = inside @ primaries[1]
    lit = own_luminance > 0
    inside[lit] *= (luminance[lit] / own_luminance[lit])[..., None]
    return inside, outside


class ColourPictures:
    """
    Colour pictures of all light and of the stray light at every field, with one exposure.

    Parameters
    ----------
    report : GhostReport
        Report with at least three wavelengths, all of them visible.
    look : Look, optional
        Settings of the pictures. Default: ``Look()``.

    Raises
    ------
    MistrayError
        If there are fewer than three wavelengths, one is not visible, blocks do not fill the picture, or the light of
        the source is too saturated to be white.

    Attributes
    ----------
    look : Look
        Settings of the pictures.
    block : int
        Number of pixels averaged along each side of a block.
    all_light, stray : dict
        Field angle in degrees → `Developed`, (H / block, W / block, 3); row 0 is at the smallest y.

    Examples
    --------
    >>> lines = [450, 550, 650]
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), 0, lines, rays=10_000)
    >>> pictures = mistray.report.ColourPictures(report, mistray.report.Look(stops=2.0))
    >>> pictures.block, list(pictures.stray)
    (38, [0.0])
    """

    def __init__(self, report: GhostReport, look: Look | None = None) -> None:
        check_wavelengths(report.wavelengths_nm)
        self.look = look or Look()
        self._wavelengths_nm = report.wavelengths_nm
        self._extents = {field: t.extent for field, t in report.items()}
        light, stray = {}, {}
        spectral = {field: spectral_maps(t) for field, t in report.items()}
        self.block = self.look.block or max(maps.block_for(HITS_PER_BLOCK) for maps in spectral.values())
        for maps in spectral.values():
            if any(size % self.block for size in maps.stray.shape[1:]):
                height, width = maps.stray.shape[1:]
                raise MistrayError(
                    f"colour: blocks of {self.block} pixels do not fill {width} × {height}; give a common divisor"
                )
        for field in report:
            maps = spectral[field].binned(self.block)
            stray[field] = xyz(maps.stray, maps.wavelengths_nm)
            light[field] = stray[field] + xyz(maps.direct, maps.wavelengths_nm)
        white = None
        if self.look.white == "source":
            white = xyz([report.weight(wavelength) for wavelength in report.wavelengths_nm], report.wavelengths_nm)
        references = list(stray.values())
        if self.look.reference == "direct":
            on_axis = [spectral[field] for field, t in report.items() if t is report.nominal_trace]
            maps = on_axis[0] if on_axis else spectral_maps(report.nominal_trace)
            references = [xyz(maps.binned(self.block).direct, maps.wavelengths_nm)]
        peak = max(float(linear_rgb(image, white)[0].max()) for image in references)
        self._dark = peak == 0
        exposure = 0.0 if self._dark else 2.0**self.look.stops / peak
        self.all_light = {field: develop(image, exposure, white) for field, image in light.items()}
        self.stray = {field: develop(image, exposure, white) for field, image in stray.items()}

    def figure(self, field_deg: float) -> Figure:
        """Draw all light of a field on the left and its stray light on the right, with a caption; axes in mm."""
        extent = self._extents[field_deg]
        aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
        height = 1.1 + 4.3 * max(aspect, 0.45)
        figure, panels = Figure.of_panels(9.6, height, 1, 2, dpi=110, sharex=True, sharey=True)
        pictures = (self.all_light[field_deg], "all light"), (self.stray[field_deg], "without the direct image")
        for axes, (picture, title) in zip(panels, pictures, strict=True):
            axes.imshow(picture.rgb, origin="lower", extent=extent, interpolation="nearest", aspect="equal")
            axes.set_title(f"field {field_deg:g}°, {title}", fontsize=10)
            axes.set_xlabel("x [mm]")
        panels[0].set_ylabel("y [mm]")
        return figure.small_print(self.caption(field_deg))

    def caption(self, field_deg: float) -> str:
        """Return the caption of a field's pictures: wavelengths, white, exposure, and light outside sRGB."""
        nm = self._wavelengths_nm
        lines = ", ".join(f"{value:g}" for value in nm) if len(nm) <= 7 else f"{len(nm)} from {nm[0]:g} to {nm[-1]:g}"
        over = "brightest ghost" if self.look.reference == "ghosts" else "direct image on axis"
        if self._dark:
            return f"wavelengths: {lines} nm; the {over} is dark, so there is nothing to expose for"
        white = "the light of the source" if self.look.white == "source" else "D65"
        stray = self.stray[field_deg]
        blocks = f"; {self.block} × {self.block} pixels averaged" if self.block > 1 else ""
        return (
            f"wavelengths: {lines} nm; white: {white}; exposure: {self.look.stops:+g} stops over the {over}{blocks}\n"
            f"of the pixels with stray light {stray.outside:.0%} lie outside sRGB, {stray.overexposed:.0%} are "
            "overexposed"
        )

"""Spectrum of a coating between two materials, over wavelength and angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mistray.coatings.response import METAL_K, CoatingModel
from mistray.errors import MistrayError
from mistray.materials import complex_index
from mistray.ranges import POLAR_DEG, WAVELENGTH_NM


@dataclass(frozen=True, eq=False)
class CoatingSpectrum:
    """
    Reflectance and transmittance of a coating on a grid of wavelengths and angles.

    Attributes
    ----------
    wavelength_nm : (w,) float64
        Vacuum wavelengths, nm.
    angle_deg : (a,) float64
        Angles of incidence, degrees, as given to `spectrum`.
    R, T : (w, a, 2) float64
        Fractions of the flux for s and p. Light that enters a metal (k > `METAL_K`) is absorbed: T = 0.
    phase_r, phase_t : (w, a) float64
        Phases arg(j_s) - arg(j_p), rad, see `Response`.

    Examples
    --------
    >>> quarter_wave = mistray.coatings.coating_from_text("MgF2 0.25w")
    >>> found = mistray.coatings.spectrum(quarter_wave, [450, 550, 650], [0, 45])
    >>> found.R.shape  # wavelengths, angles, s and p
    (3, 2, 2)
    >>> found.mean("R").round(4)
    array([[0.0171, 0.0202],
           [0.0133, 0.0215],
           [0.015 , 0.0257]])
    """

    wavelength_nm: np.ndarray
    angle_deg: np.ndarray
    R: np.ndarray
    T: np.ndarray
    phase_r: np.ndarray
    phase_t: np.ndarray

    @property
    def A(self) -> np.ndarray:
        """Fraction of the flux that is absorbed, (w, a, 2) float64."""
        return 1 - self.R - self.T

    def mean(self, share: str = "R") -> np.ndarray:
        """Return the mean over s and p of `share` ("R", "T" or "A"), (w, a), which holds for unpolarised light."""
        return np.asarray(getattr(self, share).mean(axis=2))


def spectrum(
    coating: CoatingModel,
    wavelengths_nm: float | Sequence[float] | np.ndarray,
    angles_deg: float | Sequence[float] | np.ndarray,
    front: str = "air",
    back: str = "N-BK7",
    from_front: bool = True,
    rarer: bool = False,
) -> CoatingSpectrum:
    """
    Return R, T and phases of a coating on a grid of wavelengths and angles.

    Parameters
    ----------
    coating : CoatingModel
        Coating to evaluate.
    wavelengths_nm, angles_deg : float or sequence of float
        Vacuum wavelengths, nm, and angles of incidence, degrees.
    front, back : str
        Materials in front and behind, see `mistray.materials`; their k must be known.
    from_front : bool
        Whether the light comes from the front.
    rarer : bool
        Whether the angles are those in the material of lower index, instead of those on the side of incidence. If the
        far material is a metal, they are always those on the side of incidence.

    Raises
    ------
    MistrayError
        If there is no wavelength or no angle, an angle is outside 0 … 90°, a material is unknown at a wavelength, or
        the light would come from a metal.

    Examples
    --------
    >>> quarter_wave = mistray.coatings.coating_from_text("MgF2 0.25w")
    >>> found = mistray.coatings.spectrum(quarter_wave, [450, 550, 650], [0], back="N-BK7")
    >>> found.R[:, 0, 0].round(4)
    array([0.0171, 0.0133, 0.015 ])
    """
    owner = f"coating '{coating.name}'"
    lam = np.array(WAVELENGTH_NM.check_each("wavelengths_nm", wavelengths_nm, owner))
    angle = np.array(POLAR_DEG.check_each("angles_deg", angles_deg, owner))
    cosine = np.cos(np.radians(angle))
    answers = []
    for wavelength in lam.tolist():
        sides = complex_index(front, wavelength), complex_index(back, wavelength)
        n_1, n_2 = sides if from_front else sides[::-1]
        if n_1.imag > METAL_K:
            raise MistrayError(
                f"{owner}: light from '{front if from_front else back}' (k = {n_1.imag:g} at "
                f"{wavelength:g} nm), in which nothing travels; take the other side"
            )
        metal = n_2.imag > METAL_K
        own = cosine
        if rarer and n_1.real > n_2.real and not metal:
            own = np.sqrt(1 - (n_2.real / n_1.real) ** 2 * (1 - cosine**2))
        one = coating.response(wavelength, *sides, own, from_front)
        answers.append((one.R, 0 * one.T if metal else one.T, one.phase_r, one.phase_t))
    return CoatingSpectrum(lam, angle, *(np.array(values) for values in zip(*answers, strict=True)))

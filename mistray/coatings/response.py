"""Response of a coating to light: reflected and transmitted fractions of the flux, and phases, for s and p."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.physics.thinfilm import amplitudes_and_shares
from mistray.ranges import shown

# In a medium of larger k, a metal, light falls to 1/e within a wavelength. It is the substrate of the coating, whatever
# its n, and light that enters it is recorded as absorbed at the surface
METAL_K = 1 / (4 * math.pi)
CRITICAL_ROUNDING = 1e-12  # of the squared sine of refraction, so that light at the critical angle is refracted
COSINE_ROUNDING = 1e-6  # of a product of two unit vectors, of float32, too


@dataclass(frozen=True, eq=False)
class Response:
    """
    Reflection and transmission of one interface at one wavelength, for m angles of incidence.

    Attributes
    ----------
    R, T : (m, 2) float64
        Fractions of the incident flux that are reflected and that enter the far medium; columns s and p. The coating
        absorbs A = 1 - R - T.
    phase_r, phase_t : (m,) float64
        Phase arg(j_s) - arg(j_p) of the amplitudes of the E field, rad, with the signs of `mistray.physics.thinfilm`: π
        in the reflection of an ordinary mirror at normal incidence, 0 in transmission.

    Examples
    --------
    >>> cosines = np.cos([0.0, np.arctan(1.5)])  # normal incidence, and Brewster's angle
    >>> found = mistray.coatings.Bare().response(550.0, 1.0, 1.5, cosines, from_front=True)
    >>> found.R.round(4)  # columns s and p
    array([[0.04  , 0.04  ],
           [0.1479, 0.    ]])
    """

    R: np.ndarray
    T: np.ndarray
    phase_r: np.ndarray
    phase_t: np.ndarray

    @property
    def A(self) -> np.ndarray:
        """Fraction of the incident flux that the coating absorbs, (m, 2) float64."""
        return 1 - self.R - self.T


class CoatingModel(Protocol):
    """
    Coating of an interface between two media: the properties and the method that every kind of coating has.

    A coating is hashable, because its tables are cached.

    Examples
    --------
    >>> for coating in mistray.coatings.Bare(), mistray.coatings.preset("bbar3"):
    ...     found = mistray.coatings.spectrum(coating, [550], [0])
    ...     print(f"{coating.name}: R = {found.R.mean():.2%}")
    bare: R = 4.24%
    bbar3: R = 0.18%
    """

    @property
    def name(self) -> str:
        """Name of the coating for messages and titles."""
        ...

    @property
    def opaque(self) -> bool:
        """True if the coating transmits nothing, T = 0, at every wavelength and angle."""
        ...

    def response(
        self, wavelength_nm: float, n_front: complex, n_back: complex, cos_incident: npt.ArrayLike, from_front: bool
    ) -> Response:
        """
        Return R, T and phases of the coating for light from one side.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        n_front, n_back : complex
            Complex indices n + ik of the media in front and behind.
        cos_incident : float or (m,) float64
            Cosine of the angle of incidence in the medium that the light comes from, 0 … 1. Beyond the critical angle
            nothing is transmitted, and R is that of total reflection.
        from_front : bool
            Whether the light comes from the front.

        Raises
        ------
        MistrayError
            If a material is unknown at the wavelength, or a cosine is out of range.
        """
        ...


def layered_response(
    n_layers: Sequence[complex] | np.ndarray,
    d_nm: Sequence[float] | np.ndarray,
    wavelength_nm: float,
    n_front: complex,
    n_back: complex,
    cos_incident: npt.ArrayLike,
    from_front: bool,
) -> Response:
    """
    Return R and T of homogeneous layers for s and p light, and phase differences s minus p, radians.

    Without layers it is the bare interface.

    Parameters
    ----------
    n_layers, d_nm : sequence
        Indices n + ik and thicknesses, nm, of the layers from the front to the back.
    wavelength_nm, n_front, n_back, cos_incident, from_front
        Parameters of `CoatingModel.response`. Only the real index of the medium that the light comes from is used: its
        absorption is counted along the ray. In an absorbing medium incident and reflected waves interfere, so that R
        and T alone would not balance the energy.
    """
    if not from_front:
        n_layers, d_nm, n_front, n_back = n_layers[::-1], d_nm[::-1], n_back, n_front
    setting = (complex(n_front.real), list(n_layers), list(d_nm), n_back, wavelength_nm, cosines(cos_incident))
    (r_s, r_p), (t_s, t_p), reflected, transmitted = amplitudes_and_shares(*setting)
    return Response(
        np.stack(reflected, axis=1),
        np.stack(transmitted, axis=1),
        np.angle(r_s * np.conj(r_p)),
        np.angle(t_s * np.conj(t_p)),
    )


def cosines(given: npt.ArrayLike) -> np.ndarray:
    """
    Return one or several cosines of incidence as an array, (m,), each within 0 … 1.

    Products of unit vectors may lie beyond by `COSINE_ROUNDING`; they become 0 or 1. Raise `MistrayError` for others.
    """
    found = np.zeros((0, 0))
    with contextlib.suppress(TypeError, ValueError):
        found = np.atleast_1d(np.asarray(given, dtype=np.float64))
    if found.ndim != 1 or not np.all((found >= -COSINE_ROUNDING) & (found <= 1 + COSINE_ROUNDING)):
        raise MistrayError(f"cos_incident is {shown(given)}; give cosines of angles of incidence, 0 … 1")
    return found.clip(0.0, 1.0)


def total_reflection(n_front: complex, n_back: complex, cos_incident: np.ndarray, from_front: bool) -> np.ndarray:
    """
    Return a mask of cosines of incidence, (m,), beyond the critical angle for light from one side.

    A metal has no critical angle, however small its n.
    """
    n_1, n_2 = (n_front, n_back) if from_front else (n_back, n_front)
    beyond = (n_1.real / n_2.real) ** 2 * (1 - np.square(cos_incident)) > 1 + CRITICAL_ROUNDING
    return np.asarray(beyond & (n_2.imag <= METAL_K))

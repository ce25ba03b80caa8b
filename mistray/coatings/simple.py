"""Coatings without layers: no coating at all, and fixed fractions of the flux."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.coatings.response import Response, cosines, layered_response, total_reflection
from mistray.errors import MistrayError

# R + T of a lossless coating, written with six digits
SUM_TOLERANCE = 1e-6


def check_shares(r: float, t: float, what: str) -> None:
    """
    Raise `MistrayError` if R and T of a coating at one angle and wavelength are not fractions of a flux.

    Raises
    ------
    MistrayError
        If one of them is not a number in 0 … 1, or their sum exceeds 1. The message starts with `what`.
    """
    if not (0 <= r <= 1 and 0 <= t <= 1 and r + t <= 1 + SUM_TOLERANCE):
        raise MistrayError(f"{what}: R = {r:g} and T = {t:g}; both must lie in 0 … 1 and R + T must not exceed 1")


@dataclass(frozen=True)
class Bare:
    """
    Interface without coating: Fresnel's equations between the two media, which may absorb.

    Attributes
    ----------
    name : str
        Name for messages and titles.
    opaque : bool
        Whether T = 0 for all media.

    Examples
    --------
    >>> found = mistray.coatings.Bare().response(550.0, 1.0, 1.5, np.array([1.0]), from_front=True)
    >>> found.R.round(4)  # s and p at normal incidence
    array([[0.04, 0.04]])
    """

    name: str = "bare"
    opaque: bool = False

    def response(
        self, wavelength_nm: float, n_front: complex, n_back: complex, cos_incident: npt.ArrayLike, from_front: bool
    ) -> Response:
        """Return R, T and phases for light from one side, see `CoatingModel.response`."""
        return layered_response((), (), wavelength_nm, n_front, n_back, cos_incident, from_front)


@dataclass(frozen=True)
class Ideal:
    """
    Coating with the same R and T at all wavelengths and angles, from both sides, for s and p.

    Attributes
    ----------
    R, T : float
        Reflected and transmitted fractions of the flux; beyond the critical angle R + T is reflected.
    name : str
        Name for messages and titles.

    Raises
    ------
    MistrayError
        If R or T is not in 0 … 1, or R + T > 1.

    Examples
    --------
    >>> splitter = mistray.coatings.Ideal(R=0.48, T=0.48)
    >>> found = splitter.response(550.0, 1.0, 1.5, np.array([1.0]), from_front=True)
    >>> found.A.round(4)
    array([[0.04, 0.04]])
    """

    R: float
    T: float
    name: str = ""

    def __post_init__(self) -> None:
        check_shares(self.R, self.T, f"coating '{self.name}'" if self.name else "ideal coating")

    @property
    def opaque(self) -> bool:
        """True if the coating transmits nothing, T = 0."""
        return self.T == 0

    def response(
        self, wavelength_nm: float, n_front: complex, n_back: complex, cos_incident: npt.ArrayLike, from_front: bool
    ) -> Response:
        """Return R, T and phases for light from one side, see `CoatingModel.response`; phase_r is π, phase_t 0."""
        cosine = cosines(cos_incident)
        count = len(cosine)
        beyond = total_reflection(n_front, n_back, cosine, from_front) & (not self.opaque)
        r, t = np.where(beyond, self.R + self.T, self.R), np.where(beyond, 0.0, self.T)
        return Response(np.stack([r, r], 1), np.stack([t, t], 1), np.full(count, math.pi), np.zeros(count))

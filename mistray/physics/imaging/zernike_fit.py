"""Zernike coefficients of a wavefront by least squares, over pupils of any shape.

The polynomials are those of `mistray.physics.sags.zernike`. They are orthogonal over a full disc only. Over a vignetted
or obstructed pupil a coefficient depends on the number of terms, though their sum does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.physics.sags.zernike import LAST_FRINGE, LAST_STANDARD, fringe, fringe_orders, noll_orders, standard

Array = npt.NDArray[np.float64]

_NAMES = {
    (0, 0): "piston", (1, 1): "tilt x", (1, -1): "tilt y", (2, 0): "defocus", (2, -2): "astigmatism 45°",
    (2, 2): "astigmatism 0°", (3, -1): "coma y", (3, 1): "coma x", (3, -3): "trefoil y", (3, 3): "trefoil x",
    (4, 0): "spherical", (4, 2): "secondary astigmatism 0°", (4, -2): "secondary astigmatism 45°",
    (4, 4): "tetrafoil x", (4, -4): "tetrafoil y", (5, 1): "secondary coma x", (5, -1): "secondary coma y",
    (5, 3): "secondary trefoil x", (5, -3): "secondary trefoil y", (5, 5): "pentafoil x", (5, -5): "pentafoil y",
    (6, 0): "secondary spherical", (8, 0): "tertiary spherical", (10, 0): "quaternary spherical",
}  # fmt: skip
_KINDS = {"noll": (standard, noll_orders, LAST_STANDARD), "fringe": (fringe, fringe_orders, LAST_FRINGE)}


@dataclass(frozen=True)
class ZernikeFit:
    """
    Zernike coefficients fitted to a wavefront.

    Attributes
    ----------
    kind : {"noll", "fringe"}
        Kind of polynomials.
    coefficients : (n,) float64
        Coefficients in the unit of the wavefront; the first belongs to the polynomial of index 1.
    residual_rms : float
        Weighted rms of the wavefront after removal of the polynomials, in its unit.
    """

    kind: str
    coefficients: Array
    residual_rms: float

    @property
    def names(self) -> list[str]:
        """Names of the polynomials, such as "coma y", or their orders n and m, in the order of `coefficients`."""
        orders = [_KINDS[self.kind][1](j) for j in range(1, len(self.coefficients) + 1)]
        return [_NAMES.get(pair, f"n = {pair[0]}, m = {pair[1]}") for pair in orders]


def fit_zernikes(points: Array, values: Array, weights: Array, kind: str = "noll", terms: int = 37) -> ZernikeFit:
    """
    Return a least-squares fit of Zernike polynomials to a wavefront.

    Parameters
    ----------
    points : (m, 2) float64
        Positions of the points in units of the radius of the disc.
    values, weights : (m,) float64
        Wavefront at the points, in any unit, and area that each point represents.
    kind : {"noll", "fringe"}
        Standard polynomials of unit variance in the order of Noll, or Fringe polynomials of unit value at the rim.
    terms : int
        Number of terms, 1 … 231 for Noll or 1 … 37 for Fringe.

    Raises
    ------
    MistrayError
        If the kind is unknown, the number of terms is out of range, or there are fewer points than terms.
    """
    if kind not in _KINDS:
        raise MistrayError(f"Zernike polynomials '{kind}': there are 'noll' and 'fringe'")
    polynomial, _, last = _KINDS[kind]
    if terms != int(terms) or not 1 <= terms <= last:
        raise MistrayError(f"{terms} Zernike polynomials: of '{kind}' there are 1 to {last}")
    if len(values) < terms:
        raise MistrayError(f"{terms} Zernike polynomials for {len(values)} points of the pupil; ask for fewer")
    x, y = points.T
    basis = np.stack([polynomial(x, y, {j: 1.0}) for j in range(1, int(terms) + 1)], axis=1)
    root = np.sqrt(weights)
    found = np.linalg.lstsq(basis * root[:, None], values * root, rcond=None)[0]
    left = values - basis @ found
    return ZernikeFit(kind, found, float(np.sqrt((weights * left**2).sum() / weights.sum())))

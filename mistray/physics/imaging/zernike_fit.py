"""Zernike coefficients of a wavefront by least squares, over pupils of any shape.

The polynomials are those of `mistray.physics.sags.zernike`. They are orthogonal over a full disc only: over a pupil
that is vignetted or obstructed a coefficient depends on how many are fitted, though their sum does not.
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
    Coefficients of Zernike polynomials.

    Attributes
    ----------
    kind : {"noll", "fringe"}
    coefficients : (n,) float64
        In the unit of the wavefront; the first is number 1.
    residual_rms : float
        Root mean square of what the polynomials do not describe.
    """

    kind: str
    coefficients: Array
    residual_rms: float

    @property
    def names(self) -> list[str]:
        """Name of each polynomial, such as "coma y"; its orders n, m where it has none."""
        orders = [_KINDS[self.kind][1](j) for j in range(1, len(self.coefficients) + 1)]
        return [_NAMES.get(pair, f"n = {pair[0]}, m = {pair[1]}") for pair in orders]


def fit_zernikes(points: Array, values: Array, weights: Array, kind: str = "noll", terms: int = 37) -> ZernikeFit:
    """
    Fit polynomials to a wavefront.

    Parameters
    ----------
    points : (m, 2) float64
        In units of the radius of the disc.
    values, weights : (m,) float64
        The wavefront, and the area that each point stands for.
    kind : {"noll", "fringe"}
        Standard polynomials of unit variance in the order of Noll, or Fringe polynomials of unit value at the rim.
    terms : int
        1 … 231 of Noll's, or 1 … 37 of Fringe.

    Raises
    ------
    MistrayError
        If there is no such kind, or number of terms, or there are fewer points than terms.
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

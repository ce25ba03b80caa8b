"""Start designs of an optimisation: local minima of a cheap proxy of the metric, found from many points.

A ghost of two reflections carries about R² of the light. The proxy is therefore the mean square of R over the band, a
few angles and the glasses of a coating's surfaces. It traces no rays; the traced metric ranks its minima.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from mistray.analyses.optimize.study.state import Start
from mistray.analyses.optimize.study.study_scene import PlacedDesign
from mistray.analyses.optimize.study.variables import Variables
from mistray.analyses.optimize.thickness_minima import thickness_minima
from mistray.materials import complex_index
from mistray.physics.thinfilm import reflectance_transmittance

ANGLES_DEG = (0.0, 15.0, 30.0, 45.0)  # in the rarer material
POINTS = 256  # of the Latin hypercube
KEPT = 24  # of them that are followed to a minimum
SAME_NM = 1.0  # minima nearer than this in every layer are one


@dataclass(frozen=True)
class Proxy:
    """
    Mean square reflectance of a coating over wavelengths, angles and adjacent glasses, a cheap measure of ghosts.

    Attributes
    ----------
    layers : list of (L, w, 1) complex128
        Complex indices of the layers in the order from the rarer medium, for each pair of adjacent media.
    media : list of ((w, 1) complex128, (w, 1) complex128)
        Complex indices of the rarer and the denser medium, for each pair.
    orders : list of (L,) int
        Indices of the layers in the design, in that order, for each pair.
    wavelength_nm, weights : (w, 1) float64
        Wavelengths, nm, and weights that sum to 1.
    """

    layers: list[np.ndarray]
    media: list[tuple[np.ndarray, np.ndarray]]
    orders: list[np.ndarray]
    wavelength_nm: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, placed: PlacedDesign, wavelength_nm: Sequence[float], weights: Sequence[float]) -> Proxy:
        """Return the proxy of one coating of a study for wavelengths, nm, and their weights, which sum to 1."""
        start = placed.group.start
        layers, media, orders = [], [], []
        for front, back in placed.glasses:
            sides = np.array([[complex_index(front, nm), complex_index(back, nm)] for nm in wavelength_nm])
            stacks = [start.front_to_back(nm, *pair) for nm, pair in zip(wavelength_nm, sides, strict=True)]
            indices, order = np.array([stack[0] for stack in stacks]), stacks[0][2]
            if sides[0, 1].real < sides[0, 0].real:  # light comes from the rarer medium
                sides, indices, order = sides[:, ::-1], indices[:, ::-1], order[::-1]
            layers.append(np.moveaxis(indices, 1, 0)[:, :, None])
            media.append((sides[:, 0, None], sides[:, 1, None]))
            orders.append(order)
        return cls(layers, media, orders, np.array(wavelength_nm)[:, None], np.array(weights)[:, None])

    def __call__(self, thickness_nm: np.ndarray) -> np.ndarray:
        """Return the mean square reflectance of designs, (n,), from their layer thicknesses in nm, (n, L)."""
        cosines = np.cos(np.radians(ANGLES_DEG))[None, None, :]
        total = np.zeros(len(thickness_nm))
        for indices, (before, behind), order in zip(self.layers, self.media, self.orders, strict=True):
            d = [thickness_nm[:, k, None, None] for k in order]
            (r_s, r_p), _ = reflectance_transmittance(
                before[None], [n[None] for n in indices], d, behind[None], self.wavelength_nm[None], cosines
            )
            mean = np.mean(np.square(0.5 * (r_s + r_p)), axis=2)
            total += mean @ self.weights[:, 0]
        return total / len(self.layers)


def minima(proxy: Proxy, bounds_nm: Sequence[tuple[float, float]], given: np.ndarray, seed: int) -> list[np.ndarray]:
    """
    Return local minima of the proxy within bounds, the deepest first; minima within 1 nm in every layer are one.

    Parameters
    ----------
    proxy : Proxy
        Reflectance as a function of the layers.
    bounds_nm : sequence of (low, high)
        Bounds of the thickness of each layer, nm.
    given : (L,) float64
        Further starting design, nm.
    seed : int
        Seed of the Latin hypercube.

    Returns
    -------
    list of (L,) float64
        Thicknesses, nm.
    """
    distinct: list[np.ndarray] = []
    for d in thickness_minima(proxy, bounds_nm, [given], points=POINTS, followed=KEPT, seed=seed):
        if all(np.max(np.abs(d - other)) > SAME_NM for other in distinct):
            distinct.append(d)
    return distinct


def starts(
    variables: Variables,
    placed: Sequence[PlacedDesign],
    wavelength_nm: Sequence[float],
    weights: Sequence[float],
    count: int,
    seed: int,
) -> list[Start]:
    """
    Return up to `count` starting designs: the given one first, then combined minima of the proxy or random points.

    With coatings the others combine minima of the proxy: the first takes the deepest minimum of every coating, the
    second the next, and so on. A coating with fewer minima keeps its last, and other variables stay as they are.
    Without coatings they are points of a Latin hypercube within the bounds.

    Parameters
    ----------
    variables : Variables
        Variables of the study, those of the layers of the coatings first.
    placed : sequence of PlacedDesign
        Coatings of the study on their surfaces.
    wavelength_nm, weights : sequence of float
        Wavelengths of the band, nm, and their weights, which sum to 1; not used without coatings.
    count : int
        Largest number of starts.
    seed : int
        Seed of the Latin hypercube.
    """
    result = [Start("given", variables.start)]
    if count == 1:
        return result
    if not placed:
        points = qmc.LatinHypercube(len(variables), seed=np.random.default_rng(seed)).random(count - 1)
        return result + [
            Start(f"point {k + 1} of a Latin hypercube", variables.values(y)) for k, y in enumerate(points)
        ]
    lists = []
    for item in placed:
        given = np.array([layer.thickness_nm for layer in item.group.start.layers])
        lists.append(minima(Proxy.of(item, wavelength_nm, weights), item.group.bounds_nm, given, seed))
    for k in range(min(count - 1, max(map(len, lists)))):
        layers = np.concatenate([found[min(k, len(found) - 1)] for found in lists])
        x = np.concatenate([layers, variables.start[len(layers) :]])
        result.append(Start(f"minimum {k + 1} of the mean square R", x))
    return result

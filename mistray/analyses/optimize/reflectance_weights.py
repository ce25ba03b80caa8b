"""Derivatives of a metric with respect to the reflectance of each coated surface, by wavelength and angle of incidence.

To first order, lossless coatings change a metric by Σ w ΔR alone, w being these weights, surface by surface. A ghost
that has the detector as one of its mirrors is even linear in R of the other. Weights of one gradient therefore let
designs of any number of layers be compared on the host, without a trace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mistray.analyses.optimize.thickness_minima import Cost, thickness_minima
from mistray.coatings import Stack
from mistray.errors import MistrayError
from mistray.gradients.table_gradient import GradientRequest
from mistray.materials import complex_index
from mistray.metrics.metric import Metric
from mistray.physics.thinfilm import reflectance_transmittance
from mistray.surfaces.optics import REFLECTION_BACK, REFLECTION_FRONT, TABLED, TRANSMISSION

COSINES = np.linspace(0.0, 1.0, 33)  # in the rarer material; R is taken as linear between them
POINTS, KEPT = 128, 6  # of the Latin hypercube, and those of them that are followed to a minimum


@dataclass(frozen=True)
class ReflectanceWeights:
    """
    Derivatives of a metric with respect to the reflectances of coated surfaces.

    Attributes
    ----------
    value : float
        The metric, in its unit.
    wavelength_nm : (w,) float64
        Wavelengths, nm.
    weights : dict of str to (w, len(COSINES)) float64
        Id of a surface with layers → d metric/d R at the cosines in the rarer of its materials, with T = 1 - R, in the
        unit of the metric.
    glasses : dict of str to (str, str)
        Id → the rarer and the denser material.
    """

    value: float
    wavelength_nm: np.ndarray
    weights: dict[str, np.ndarray]
    glasses: dict[str, tuple[str, str]]

    def cost(self, surfaces: Sequence[str], stack: Stack) -> Cost:
        """
        Return Σ w R over some surfaces as a function of the thicknesses of their common coating.

        Parameters
        ----------
        surfaces : sequence of str
            Ids of surfaces with layers.
        stack : Stack
            Materials of the layers, of which the first lies outside.

        Returns
        -------
        callable
            Function of thicknesses, nm, (n, L), that returns Σ w R in the unit of the metric, (n,).

        Raises
        ------
        MistrayError
            If a surface has no layers.
        """
        by_glass: dict[tuple[str, str], np.ndarray] = {}
        for name in surfaces:
            if name not in self.weights:
                raise MistrayError(f"surface '{name}' has no layers; choose from {', '.join(self.weights)}")
            glass = self.glasses[name]
            by_glass[glass] = by_glass.get(glass, 0.0) + self.weights[name]
        layers = np.array([stack.indices(nm) for nm in self.wavelength_nm]).T  # (L, w)
        media = {glass: [self._index(material) for material in glass] for glass in by_glass}
        met = np.any([weights.any(axis=0) for weights in by_glass.values()], axis=0)
        met[0] = False  # at grazing incidence R is 1 with any coating
        nm, x = self.wavelength_nm[None, :, None], COSINES[None, None, met]

        def cost(thickness_nm: np.ndarray) -> np.ndarray:
            d = [column[:, None, None] for column in thickness_nm.T]
            total = np.zeros(len(thickness_nm))
            for glass, weights in by_glass.items():
                before, behind = media[glass]
                (r_s, r_p), _ = reflectance_transmittance(
                    before[None, :, None], [n[None, :, None] for n in layers], d, behind[None, :, None], nm, x
                )
                total += np.sum(0.5 * (r_s + r_p) * weights[None][:, :, met], axis=(1, 2)) + weights[:, 0].sum()
            return total

        return cost

    def _index(self, material: str) -> np.ndarray:
        return np.array([complex_index(material, nm) for nm in self.wavelength_nm])


def reflectance_weights(metric: Metric) -> ReflectanceWeights:
    """
    Return the derivatives of a metric with respect to the reflectances of surfaces with layers.

    They come from one reverse-mode run for each observation of the metric.

    Raises
    ------
    MistrayError
        If the scene has no surface with layers.
    """
    observations = metric.observe()
    value, _ = metric.differentiate(observations)
    found: dict[str, dict[float, np.ndarray]] = {}
    glasses: dict[str, tuple[str, str]] = {}
    for observation in observations:
        for raw in observation.table_gradients(GradientRequest(rows=True)):
            optics = raw.table.optics
            assert raw.inner.rows is not None
            slopes = raw.inner.rows.sum(axis=0)
            for i, bsdf in enumerate(optics.bsdfs):
                if int(optics.host_words[i]) & 3 != TABLED or bsdf.film is None:
                    continue
                first, last = (int(v) for v in optics.host_places[i][:2])
                own = slopes[first : first + last + 1]
                by_r = own[:, REFLECTION_FRONT] + own[:, REFLECTION_BACK] - own[:, TRANSMISSION]
                name = raw.table.ids[i]
                lines = found.setdefault(name, {})
                lines[optics.wavelength_nm] = lines.get(optics.wavelength_nm, 0.0) + _spread(by_r)
                front, back = bsdf.front, bsdf.back
                ordered = (
                    complex_index(front, optics.wavelength_nm).real <= complex_index(back, optics.wavelength_nm).real
                )
                glasses[name] = (front, back) if ordered else (back, front)
    if not found:
        raise MistrayError("no surface that the light meets has layers; put coatings on with 'mistray coat'")
    wavelengths = np.unique([nm for lines in found.values() for nm in lines])
    nothing = np.zeros(len(COSINES))
    weights = {name: np.array([lines.get(nm, nothing) for nm in wavelengths]) for name, lines in found.items()}
    return ReflectanceWeights(value, wavelengths, weights, glasses)


def _spread(by_node: np.ndarray) -> np.ndarray:
    """
    Return derivatives with respect to R at `COSINES`, from those at more cosines, evenly spaced from 0 to 1.

    Each derivative is shared linearly between the two nearest of `COSINES`.
    """
    place = np.linspace(0.0, 1.0, len(by_node)) * (len(COSINES) - 1)
    low = np.minimum(place.astype(int), len(COSINES) - 2)
    share = place - low
    return np.bincount(low, by_node * (1 - share), len(COSINES)) + np.bincount(low + 1, by_node * share, len(COSINES))


def best_thicknesses(
    cost: Cost, low: Sequence[float], high: Sequence[float], given: Sequence[np.ndarray]
) -> np.ndarray:
    """
    Return the layer thicknesses, nm, of least cost within bounds, from minima found on a Latin hypercube.

    Parameters
    ----------
    cost : callable
        Cost function made by `ReflectanceWeights.cost`, greater than 0.
    low, high : (L,) float
        Bounds, nm.
    given : sequence of (L,) float64
        Further starting points within the bounds, nm.

    Returns
    -------
    (L,) float64
        Thicknesses, nm.
    """
    bounds = list(zip(low, high, strict=True))
    return thickness_minima(cost, bounds, given, points=POINTS, followed=KEPT)[0]

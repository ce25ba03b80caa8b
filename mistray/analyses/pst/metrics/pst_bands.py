"""Point source transmittance in bands of field angle as a function of parameters: values, noise and Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.metrics.pst_observation import Light, PstObservation, named_classes
from mistray.analyses.pst.metrics.pst_view import PstView
from mistray.errors import MistrayError
from mistray.gradients.parameter_gradient import parameter_gradient
from mistray.metrics.gradient import chosen_parameters, gradient_request
from mistray.metrics.parameters import Parameter
from mistray.metrics.scene_values import assign
from mistray.ranges import AZIMUTH_DEG, FINITE, POLAR_DEG, Each
from mistray.recorders.direction_recorder import CLASSES
from mistray.recorders.sampled import batch_error
from mistray.settings import BATCHES

TOLERANCES = 1e4  # that a parameter without a range may be off


@dataclass(frozen=True)
class Modelled:
    """
    Values of a model at given parameters, with their noise and derivatives.

    Attributes
    ----------
    value : (n,) float64
        Values of the model, in the unit of the data; of `PstBands` dimensionless.
    covariance : (n, n) float64
        Covariance of the Monte Carlo noise of the values, in the square of their unit.
    jacobian : (n, k) float64
        Derivatives of the values with respect to the k parameters, in the unit of the values over theirs.

    Examples
    --------
    >>> model = mistray.optimize.Modelled(np.array([2.0, 4.0]), np.zeros((2, 2)), np.array([[1.0], [2.0]]))
    >>> model.value + model.jacobian @ np.array([0.1])  # to first order
    array([2.1, 4.2])
    """

    value: np.ndarray
    covariance: np.ndarray
    jacobian: np.ndarray


def _ends(scene: Any, chosen: Sequence[Parameter], value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return lower and upper bounds of scene parameters, (k,) each, in their own units, from their values, (k,).

    Parameters without a lower limit get bounds near their values, see `PstBands`. The upper one of others may be
    infinite.
    """
    box = scene.bbox()
    size = float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
    low, high = (np.array([getattr(p, end) for p in chosen]) for end in ("low", "high"))
    reach = np.array([size if p.unit == "mm" else TOLERANCES * p.tolerance for p in chosen])
    signed = np.isinf(low)
    return np.where(signed, value - reach, low), np.where(signed, np.minimum(high, value + reach), high)


class PstBands:
    """
    PST_normal averaged over bands of field angle, at one or several azimuths, as a function of scene parameters.

    All derivatives come from one backward trace and one replay of its rays: those of each ray are added to the
    band in which it leaves. Visibility is held constant, so that derivatives of shapes lack the contribution of rims.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    keys : str or sequence of str
        Parameters of one entry, such as ``"polish.rms_nm"``; see `mistray.metrics.parameters`.
    edges_deg : sequence of float
        Ends of the bands, 0 … 90 degrees, ascending, multiples of `cell_deg` apart.
    light : str or sequence of str
        Classes of light, see `PstObservation`.
    azimuths_deg : float or sequence of float, optional
        Azimuths, degrees, as for `mistray.pst`; by default one mean over all azimuths.
    cell_deg : float
        Width of the cells that a band consists of, degrees.
    **traced
        Further arguments of `mistray.pst`: rays, seed, azimuth_cell_deg, max_scatters, ….

    Attributes
    ----------
    keys : tuple of str
        Keys of the parameters.
    start : (k,) float64
        Values of the parameters in the scene, in their units.
    low, high : (k,) float64
        Bounds of the parameters, in their units. A parameter without a lower limit has bounds about its value in the
        scene: a length within the size of the scene, others within ten thousand times the tolerance.
    power : (k,) float64
        Exponent p of each parameter: light grows as its p-th power; for `fit`.
    bands : list of tuple
        (azimuth or None, low, high) of each value, degrees, the azimuths of the first band first.

    Raises
    ------
    MistrayError
        If a key has no derivative or several entries, the edges do not fit, or an argument would have no effect here.

    Examples
    --------
    >>> bands = mistray.optimize.PstBands(mistray.load("plate_and_wall"), ["polish.A"], [10, 20, 40], rays=10_000)
    >>> bands.bands  # azimuth, and ends in degrees
    [(None, 10.0, 20.0), (None, 20.0, 40.0)]
    >>> modelled = bands(bands.start)
    >>> [f"{value:.1e}" for value in modelled.value]
    ['4.8e-03', '3.0e-03']
    """

    def __init__(
        self,
        scene: Any,
        keys: str | Sequence[str],
        edges_deg: Sequence[float],
        light: Light = "stray",
        *,
        azimuths_deg: float | Sequence[float] | None = None,
        cell_deg: float = 1.0,
        **traced: Any,
    ) -> None:
        edges = np.array(POLAR_DEG.check_each("edges_deg", edges_deg))
        counts = np.diff(edges) / cell_deg
        uneven = np.any(counts < 0.5) or np.any(np.abs(counts - np.round(counts)) > 1e-6)
        if edges.size < 2 or uneven:
            raise MistrayError(
                f"edges_deg is {edges.tolist()}; give ascending field angles that are multiples of cell_deg = "
                f"{cell_deg:g} apart"
            )
        self._params = mi.traverse(scene)
        chosen = chosen_parameters(scene, self._params, keys)
        for key, parameter in chosen.items():
            if parameter.value.size != 1:
                raise MistrayError(f"parameter '{key}' has {parameter.value.size} entries; fit parameters of one entry")
        self.scene, self.keys = scene, tuple(chosen)
        self.start = np.array([float(p.value.ravel()[0]) for p in chosen.values()])
        self.low, self.high = _ends(scene, list(chosen.values()), self.start)
        scatter = [p.owner.model.param(p.name) if p.kind == "scatter" else None for p in chosen.values()]
        self.power = np.array([1.0 if param is None else param.power for param in scatter])
        self._places = [(id(p.owner), p.name) for p in chosen.values()]
        self._request = gradient_request(chosen.values(), edges=False)
        self._light = named_classes(light)
        middles = edges[0] + cell_deg * (np.arange(round(float(counts.sum()))) + 0.5)
        self._band_of_cell = np.repeat(np.arange(len(counts)), np.round(counts).astype(int))
        around = None if azimuths_deg is None else tuple(AZIMUTH_DEG.check_each("azimuths_deg", azimuths_deg))
        azimuths = {} if around is None else {"azimuths_deg": around}
        self.bands = [
            (azimuth, float(low), float(high)) for low, high in pairwise(edges) for azimuth in around or [None]
        ]
        view = PstView({"field_deg": tuple(middles.tolist()), "cell_deg": float(cell_deg), **azimuths, **traced})
        self._view = view

    def observe(self, values: float | Sequence[float] | np.ndarray, **changes: Any) -> PstObservation:
        """
        Return the PST of the scene with its parameters set to `values`, (k,), which stay set.

        `changes` replace arguments of the PST.
        """
        numbers = Each(FINITE, len(self.keys)).check("values", values)
        assign(self._params, {key: np.array([v]) for key, v in zip(self.keys, numbers, strict=True)})
        observation = self._view.observe(self.scene, 1.0, changes)
        assert isinstance(observation, PstObservation)
        return observation

    def measure(self, values: float | Sequence[float] | np.ndarray, **changes: Any) -> tuple[np.ndarray, np.ndarray]:
        """
        Return PST_normal averaged over each band and the covariance of its noise, without derivatives.

        Parameters
        ----------
        values : float or (k,) float
            Values of the parameters.
        **changes
            Replacements of arguments of the PST, for example ``seed=1``.

        Returns
        -------
        value : (n,) float64
            PST_normal of each band.
        covariance : (n, n) float64
            Variances from the spread of the batches; bands are taken as independent.
        """
        return self._noise(self.observe(values, **changes))

    def __call__(self, values: float | Sequence[float] | np.ndarray) -> Modelled:
        """
        Return the PST bands, in the order of `bands`, for values of the parameters, (k,), each in its unit.

        They come with Monte Carlo noise and derivatives. The scene keeps the values.
        """
        observation = self.observe(values)
        value, covariance = self._noise(observation)
        weights = self._weights(observation)
        jacobian = np.zeros((len(value), len(self.keys)))
        for first in range(0, len(value), BATCHES):
            here = weights[first : first + BATCHES]
            derivative = np.zeros((len(CLASSES), *observation.pst.grid.shape))
            derivative[[CLASSES.index(name) for name in self._light]] = here.sum(axis=0)
            groups = np.argmax(here > 0, axis=0)  # cells of no band have no weight
            for raw in observation.pst.table_gradients(derivative, self._request, groups):
                for owner, name, parts in parameter_gradient(raw, lambda o, n: (id(o), n) in self._places):
                    jacobian[first : first + BATCHES, self._places.index((id(owner), name))] += parts[: len(here), 0]
        return Modelled(value, covariance, jacobian)

    def _weights(self, observation: PstObservation) -> np.ndarray:
        """Return the weight of each PST cell in each band average, (values, n, m), by solid angle."""
        grid = observation.pst.grid
        n, m = grid.shape
        solid = np.zeros((self._band_of_cell[-1] + 1, n))
        solid[self._band_of_cell, np.arange(n)] = grid.solid_angle
        solid /= solid.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("bn,am->banm", solid, np.eye(m)).reshape(-1, n, m))

    def _noise(self, observation: PstObservation) -> tuple[np.ndarray, np.ndarray]:
        pst = observation.pst
        light = pst.by_batch[[CLASSES.index(name) for name in self._light]].sum(axis=0)
        parts = np.tensordot(self._weights(observation), light, axes=([1, 2], [0, 1]))  # (numbers, batches)
        share = np.asarray(pst.weight, dtype=np.float64)
        value = parts @ share
        # The few batches know variances, but not correlations, which are weak: a ray leaves in one band
        return value, np.diag(np.square(batch_error(parts * share, share)))

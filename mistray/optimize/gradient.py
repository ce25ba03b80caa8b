"""`mistray.gradient`: a metric's value and its derivative by every parameter asked for, with standard errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from mistray.coatings import LAYER_PARAMETERS
from mistray.errors import MistrayError
from mistray.optimize.metrics import Metric
from mistray.trace.coating_gradient import IDEAL_PARAMETERS, coating_gradient
from mistray.trace.energy import batch_error
from mistray.trace.ledger import BATCHES

if TYPE_CHECKING:
    from mistray.trace.optics import Optics


@dataclass(frozen=True)
class Gradient:
    """
    A metric and its derivatives.

    Attributes
    ----------
    value, value_se : float
        The metric and its standard error.
    gradient, standard_error : dict
        Key of the parameter → (entries,) float64. The errors are those of the mean over the start rays, for the
        derivatives of the metric by the fluxes as they were traced: for a metric that is not linear in the fluxes, such
        as a ratio, the noise of those is not in it.
    left_out : list of str
        What the derivatives do not contain.
    seconds : tuple of float
        Time of the primal and of the adjoint walks.
    """

    value: float
    value_se: float
    gradient: dict[str, np.ndarray]
    standard_error: dict[str, np.ndarray]
    left_out: list[str]
    seconds: tuple[float, float]

    def __str__(self) -> str:
        lines = [f"value {self.value:.6e} ± {self.value_se:.1e}"]
        for key, values in self.gradient.items():
            for k, (value, error) in enumerate(zip(values, self.standard_error[key], strict=True)):
                lines.append(f"d/d {key}[{k}] {value:+.5e} ± {error:.1e}")
        return "\n".join([*lines, *(f"left out: {text}" for text in self.left_out)])


# Runs of several fields and wavelengths are added batch by batch; each splits its rays evenly
EQUAL = np.ones(BATCHES)
LEFT_OUT = "branches below flux_threshold and children of R = 0 or T = 0, which the trace does not follow"


def gradient(metric: Metric, params: Mapping[str, Any], keys: Iterable[str] | None = None) -> Gradient:
    """
    Derivatives of a metric by coating parameters, by one primal and one adjoint walk for each field and wavelength.

    Parameters
    ----------
    metric : Metric
        From `mistray.optimize.metrics`.
    params : mi.SceneParameters
        ``mi.traverse(metric.scene)``, perhaps reduced by its `keep`.
    keys : iterable of str, optional
        The parameters; by default all coating parameters in `params`.

    Returns
    -------
    Gradient

    Raises
    ------
    MistrayError
        If a key is no coating parameter of the scene, or the scene or the settings have no derivative.
    """
    owners = parameter_owners(params, keys)
    observations = metric.observe()
    value = metric.evaluate(observations)
    dr.backward(value, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)  # no path at all: nothing to differentiate
    primal = sum(o.trace.seconds for o in observations)
    sums: dict[tuple[int, str], np.ndarray] = {}
    rows: dict[tuple[float, ...], tuple[Optics, np.ndarray]] = {}
    seconds, variance = 0.0, 0.0
    by_batch = np.zeros(BATCHES)
    for observation in observations:
        pixel, path = observation.derivatives()
        for optics, part, elapsed in observation.trace.adjoint(pixel, path):
            seconds += elapsed
            # Fields share their tables: the rows of all of them go through the chain rule at once
            shared = optics.wavelength_nm, *(id(table) for table in optics.tables)
            rows[shared] = optics, part + rows[shared][1] if shared in rows else part
        by_batch += observation.trace.by_batch(path)
        variance += float(np.sum(np.square(pixel * observation.trace.irradiance_se)))
    places = set(owners.values())
    for optics, total in rows.values():
        for owner, name, part in coating_gradient(optics, total, lambda owner, name: (id(owner), name) in places):
            sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    result: dict[str, np.ndarray] = {}
    errors: dict[str, np.ndarray] = {}
    for key, place in owners.items():
        batches = sums.get(place)
        if batches is None:  # the coating was never met
            batches = np.zeros((BATCHES, int(np.size(params[key]))))
        result[key], errors[key] = batches.sum(axis=0), batch_error(batches.T, EQUAL)
    return Gradient(
        float(dr.detach(value)[0]),
        float(np.sqrt(variance + batch_error(by_batch, EQUAL) ** 2)),
        result,
        errors,
        [LEFT_OUT],
        (primal, seconds),
    )


def parameter_owners(params: Mapping[str, Any], keys: Iterable[str] | None = None) -> dict[str, tuple[int, str]]:
    """
    Keys of coating parameters → identity of the plugin that owns them and name.

    Raises
    ------
    MistrayError
        If a key is unknown or no coating parameter, or there is none.
    """
    properties = params.properties  # type: ignore[attr-defined]
    names = (*LAYER_PARAMETERS, *IDEAL_PARAMETERS)
    found = {}
    for key in keys if keys is not None else list(params.keys()):
        if key not in params:
            raise MistrayError(f"parameter '{key}' does not exist; list(mi.traverse(scene).keys()) shows them all")
        name = key.rsplit(".", 1)[-1]
        node = properties[key][2]
        if name in names and hasattr(node, "film"):
            found[key] = (id(node), name)
        elif keys is not None:
            raise MistrayError(f"parameter '{key}' has no derivative; coatings have, by {', '.join(names)}")
    if not found:
        raise MistrayError("no coating parameter to differentiate by; give surfaces a 'thinfilm' or an ideal R and T")
    return found

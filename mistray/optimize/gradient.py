"""`mistray.gradient`: a metric's value and its derivative by every parameter requested, with standard errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from mistray.analysis.estimate import Estimate
from mistray.errors import MistrayError
from mistray.gradients.geometry_gradient import geometry_columns
from mistray.gradients.parameter_gradient import edge_gradient, parameter_gradient
from mistray.gradients.table_gradient import EDGE_WIDTH, GradientRequest, TableGradient
from mistray.optimize.metrics.metric import Metric
from mistray.optimize.parameters import Parameter, match, parameters
from mistray.ranges import EDGE_WIDTH as ZONE
from mistray.recorders.sampled import Sampled, batch_error
from mistray.settings import BATCHES
from mistray.surfaces.optics import OPAQUE, TABLED

COATING_KINDS = ("coating", "share")
OTHER_KINDS = ("scatter", "index", "source")


@dataclass(frozen=True)
class Gradient:
    """
    A metric and its derivatives.

    Attributes
    ----------
    value, value_se : float
        The metric and its standard error.
    value_noise : (b,) float64
        The noise of the metric by batch, or by group of batches, see `mistray.recorders.sampled.Sampled.apart`.
    gradient, standard_error : dict
        Key of the parameter → (entries,) float64. The errors are those of the mean over the start rays, for the
        derivatives of the metric by the fluxes as they were traced: for a metric that is not linear in the fluxes, such
        as a ratio, the noise of those is not in it.
    edge_check : dict
        Key → (entries,): the gradient with half the width of the zones at rims less the gradient. What is larger than
        its noise is the bias of the width. Only parameters that rims or rays at rims depend on are in it.
    batches : dict
        Key → (BATCHES, entries): the parts of the gradient from single batches of start rays, whose sum it is.
    left_out : list of str
        What the derivatives do not contain.
    seconds : tuple of float
        Time of the primal walks and of those for the derivatives.
    """

    value: float
    value_se: float
    value_noise: np.ndarray
    gradient: dict[str, np.ndarray]
    standard_error: dict[str, np.ndarray]
    edge_check: dict[str, np.ndarray]
    batches: dict[str, np.ndarray]
    left_out: list[str]
    seconds: tuple[float, float]

    @property
    def untouched(self) -> list[str]:
        """Keys whose derivatives are 0 in every batch: no ray says anything about them."""
        return [key for key, parts in self.batches.items() if not np.any(parts)]

    def covariance(self, keys: Iterable[str] | None = None) -> np.ndarray:
        """Covariance matrix of the derivatives, their entries one after the other in the order of the keys."""
        chosen = list(self.gradient if keys is None else keys)
        parts = np.concatenate([self.batches[key] for key in chosen], axis=1)
        apart = parts - parts.mean(axis=0)
        return np.asarray(BATCHES / (BATCHES - 1) * apart.T @ apart)

    def along(self, slopes: Mapping[str, float]) -> Estimate:
        """
        Derivative by what moves several numbers at once, such as a body.

        Parameters
        ----------
        slopes : mapping of str to float
            Key → how far the parameter moves, for instance from `mistray.optimize.Body.slopes`.

        Raises
        ------
        MistrayError
            If one of the keys is not among those of the gradient.
        """
        missing = [key for key, slope in slopes.items() if slope and key not in self.batches]
        if missing:
            raise MistrayError(f"the gradient has no '{missing[0]}'; give it keys={sorted(slopes)}")
        parts = sum((slope * self.batches[key][:, 0] for key, slope in slopes.items() if slope), np.zeros(BATCHES))
        return Estimate(float(parts.sum()), float(batch_error(parts, EQUAL)))

    def __str__(self) -> str:
        lines = [f"value {self.value:.6e} ± {self.value_se:.1e}"]
        for key, values in self.gradient.items():
            if key in self.untouched:
                continue
            for k, (value, error) in enumerate(zip(values, self.standard_error[key], strict=True)):
                check = f" (edge width: {self.edge_check[key][k]:+.1e})" if key in self.edge_check else ""
                lines.append(f"d/d {key}[{k}] {value:+.5e} ± {error:.1e}{check}")
        if self.untouched:
            lines.append(
                f"exactly 0, because no traced ray of the metric depends on them: {', '.join(self.untouched)}; trace "
                "more rays or wider zones at rims (edge_width), or choose light that meets them"
            )
        return "\n".join([*lines, *(f"left out: {text}" for text in self.left_out)])


# Runs of several fields and wavelengths are added batch by batch; each splits its rays evenly
EQUAL = np.ones(BATCHES)
LEFT_OUT = "branches below flux_threshold and children of R = 0 or T = 0, which the trace does not follow"
NO_EDGES = "what rays gain and lose at rims and silhouettes (edges=False)"
ONSET = (
    "silhouettes of surfaces with tabled coatings, and the onset of total reflection at them, where R and T can jump"
)
INDEX_OF_SCATTER = "the change of what surfaces scatter with the index of the materials beside them"


def gradient(
    metric: Metric,
    params: Mapping[str, Any],
    keys: Iterable[str] | None = None,
    *,
    edges: bool = True,
    edge_width: float = EDGE_WIDTH,
) -> Gradient:
    """
    Derivatives of a metric by parameters of its scene: coatings, scatter, indices, shapes, positions, rims.

    Coatings alone cost one reverse run for each field and wavelength. For anything else the rays are recorded and
    followed again in float64, and where shapes are concerned rays that hit a surface near a rim are sent past it as
    well: what the rim takes from the metric, or gives to it.

    Parameters
    ----------
    metric : Metric
        From `mistray.optimize.metrics.metric`.
    params : mi.SceneParameters
        ``mi.traverse(metric.scene)``, perhaps reduced by its `keep`.
    keys : iterable of str, optional
        Keys of parameters or patterns such as ``"vane_*.r0"``; by default all in `params` that have a derivative.
    edges : bool
        Count what rays gain and lose at rims. Without it visibility is held as it is.
    edge_width : float
        Width of the zone at a rim in which rays are looked at, in units of its radius, 0 … 0.5. Wider zones have less
        noise and more bias, see `Gradient.edge_check`.

    Returns
    -------
    Gradient

    Raises
    ------
    MistrayError
        If a key is unknown or has no derivative, or the scene or the settings have none.
    """
    chosen = chosen_parameters(metric.scene, params, keys)
    request = gradient_request(chosen.values(), edges, edge_width)
    return gradient_seen(metric, metric.observe(), chosen, request)


def gradient_seen(
    metric: Metric,
    observations: list[Any],
    chosen: Mapping[str, Parameter],
    request: GradientRequest,
) -> Gradient:
    """
    `gradient` from observations that are made already: several metrics of the same views share them.

    Parameters
    ----------
    metric : Metric
    observations : list of Observation or PstObservation
        From `Metric.observe`.
    chosen : mapping of str to Parameter
        From `chosen_parameters`.
    request : GradientRequest
        From `gradient_request`.
    """
    value = metric.evaluate(observations)
    dr.backward(value, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)  # no path at all: nothing to differentiate
    left_out, seconds = [LEFT_OUT], 0.0
    noise = Sampled.of(np.zeros(BATCHES), EQUAL)
    raws: dict[tuple[Any, ...], TableGradient] = {}
    for observation in observations:
        for raw in observation.table_gradients(request):
            seconds += raw.seconds
            left_out += [text for text in raw.left_out if text not in left_out]
            # Fields share their tables: all of them go through the chain rule at once
            tables = map(id, raw.table.optics.tables)
            shared = raw.table.wavelength_nm, raw.backward, raw.parts, *tables
            if shared in raws:
                raws[shared].add(raw)
            else:
                raws[shared] = raw
        noise = noise + observation.noise()
    places = {(id(p.owner), p.name) for p in chosen.values()}

    def is_chosen(owner: Any, name: str) -> bool:
        return (id(owner), name) in places

    # By plugin and name, by batch: with visibility as it is, and at rims with zones of the whole and of half the width
    inner, wide, narrow = (dict[tuple[int, str], np.ndarray]() for _ in range(3))
    for raw in raws.values():
        for sums, found in (
            (inner, parameter_gradient(raw, is_chosen)),
            (wide, edge_gradient(raw, is_chosen, False)),
            (narrow, edge_gradient(raw, is_chosen, True)),
        ):
            for owner, name, part in found:
                sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    if request.moves and not request.edges:
        left_out.append(NO_EDGES)
    if request.moves and any(_jumps(raw) for raw in raws.values()):
        left_out.append(ONSET)
    if request.indices and any(raw.scattering.any for raw in raws.values()):
        left_out.append(INDEX_OF_SCATTER)
    result: dict[str, np.ndarray] = {}
    errors, checks, parts = dict(result), dict(result), dict(result)
    for key, p in chosen.items():
        place = id(p.owner), p.name
        nothing = np.zeros((BATCHES, p.value.size))  # a surface that was never met
        at_rims, at_half_width = wide.get(place, nothing), narrow.get(place, nothing)
        total = inner.get(place, nothing) + at_rims
        parts[key], result[key] = total, total.sum(axis=0)
        errors[key] = batch_error(total.T, EQUAL)
        if at_rims.any() or at_half_width.any():
            checks[key] = (at_half_width - at_rims).sum(axis=0)
    return Gradient(
        value=float(dr.detach(value)[0]),
        value_se=float(noise.se),
        value_noise=noise.apart,
        gradient=result,
        standard_error=errors,
        edge_check=checks,
        batches=parts,
        left_out=left_out,
        seconds=(sum(o.seconds for o in observations), seconds),
    )


def _jumps(raw: TableGradient) -> bool:
    """Whether the R and T of a surface come from a table, which does not say what they do at grazing incidence."""
    optics = raw.table.optics
    clear = (optics.host_words & OPAQUE) == 0
    tabled = [
        kind == TABLED and bsdf.film is None for bsdf, kind in zip(optics.bsdfs, optics.host_words & 3, strict=True)
    ]
    return bool(np.any(clear & np.array(tabled)))


def chosen_parameters(scene: Any, params: Mapping[str, Any], keys: Iterable[str] | None = None) -> dict[str, Parameter]:
    """
    The parameters that keys or patterns name; without keys all in `params` that have a derivative.

    Raises
    ------
    MistrayError
        If a key is unknown or has no derivative, or there is none.
    """
    known = parameters(scene, params)
    chosen = list(known) if keys is None else match(known, keys)
    if not chosen:
        raise MistrayError("no parameter to differentiate by; list(mistray.optimize.parameters(scene)) shows them all")
    return {key: known[key] for key in chosen}


def gradient_request(
    chosen: Iterable[Parameter], edges: bool = True, edge_width: float = EDGE_WIDTH
) -> GradientRequest:
    """What the tracer must gather for some parameters."""
    ZONE.check("edge_width", edge_width)
    chosen = list(chosen)
    kinds = {p.kind for p in chosen}
    shapes = [p for p in chosen if p.kind not in (*COATING_KINDS, *OTHER_KINDS)]
    return GradientRequest(
        rows=bool(kinds & {*COATING_KINDS, "index"}),
        geometry=geometry_columns(p.name for p in shapes),
        indices="index" in kinds,
        scatter="scatter" in kinds,
        sources=frozenset(p.name for p in chosen if p.kind == "source"),
        edges=edges and bool(shapes or kinds & {"index", "source"}),
        edge_width=edge_width,
    )

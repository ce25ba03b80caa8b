"""`mistray.gradient`: a metric's value and its derivative by every parameter requested, with standard errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np

from mistray.analysis.estimate import Estimate
from mistray.errors import MistrayError
from mistray.gradients.edge_widths import EQUAL, WidthErrors, further_samples, least_error, widths_of
from mistray.gradients.geometry_gradient import geometry_columns
from mistray.gradients.parameter_gradient import gathered
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.notes import warns
from mistray.optimize.metrics.metric import Metric
from mistray.optimize.metrics.views import seen_unpolarized
from mistray.optimize.one_sided import FullKey, OneSided, full_keys, one_sided
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
    batches : dict
        Key of the parameter → (BATCHES, entries): the parts of the gradient from single batches of start rays, whose
        sum it is.
    edge_width : float or None
        Width of the zones at rims, in units of their radii; None where no ray near a rim counts.
    edge_number : int
        Its place among the widths of `edge_batches`.
    edge_batches : dict
        Key → (widths, BATCHES, entries): `batches` for all widths that were compared, each half of the one before. Only
        parameters that rays near rims depend on are in it.
    full : dict
        Key → `FullKey`: the rim that a beam just fills and that the parameter moves relative to the beam. Such a
        parameter has no derivative: it is NaN.
    one_sided : dict
        Key → the derivatives below and above its value, where it has none. They are not linear: those of parameters
        that move together are not the sum.
    left_out : list of str
        What the derivatives do not contain.
    seconds : tuple of float
        Time of the primal walks and of those for the derivatives.
    """

    value: float
    value_se: float
    value_noise: np.ndarray
    batches: dict[str, np.ndarray]
    edge_width: float | None
    edge_number: int
    edge_batches: dict[str, np.ndarray]
    full: dict[str, FullKey]
    one_sided: dict[str, OneSided]
    left_out: list[str]
    seconds: tuple[float, float]

    @cached_property
    def gradient(self) -> dict[str, np.ndarray]:
        """Key → (entries,) float64."""
        return {key: parts.sum(axis=0) for key, parts in self.batches.items()}

    @cached_property
    def standard_error(self) -> dict[str, np.ndarray]:
        """
        Key → (entries,) float64: noise and `edge_bias` together.

        The noise is that of the mean over the start rays, for the derivatives of the metric by the fluxes as they were
        traced: for a metric that is not linear in the fluxes, such as a ratio, the noise of those is not in it.
        """
        noise = {key: np.asarray(batch_error(parts.T, EQUAL)) for key, parts in self.batches.items()}
        return noise | {key: errors.total()[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_bias(self) -> dict[str, np.ndarray]:
        """
        Key → (entries,): bias by the width of the zones at rims, see `mistray.gradients.edge_widths.WidthErrors`.

        It is never less than its own noise, `edge_check_se`.
        """
        return {key: errors.bias[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_check(self) -> dict[str, np.ndarray]:
        """Key → (entries,): the gradient with half the width of the zones at rims less the gradient."""
        return {key: errors.check[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_check_se(self) -> dict[str, np.ndarray]:
        """Key → (entries,): standard error of `edge_check`."""
        return {key: errors.check_se[self.edge_number] for key, errors in self._at_rims.items()}

    @cached_property
    def _at_rims(self) -> dict[str, WidthErrors]:
        return {key: WidthErrors.of(sums) for key, sums in self.edge_batches.items()}

    def require(self, keys: Iterable[str]) -> None:
        """Raise `MistrayError` if one of these has no derivative, because a beam just fills a rim that it moves."""
        for key in keys:
            if key in self.full:
                raise MistrayError(
                    f"parameter '{key}' has no derivative, because a beam just fills {self.full[key].rim}; widen the "
                    "source by a few per cent"
                )

    @property
    def untouched(self) -> list[str]:
        """Keys whose derivatives are 0 in every batch: no ray says anything about them."""
        return [key for key, parts in self.batches.items() if not np.any(parts)]

    def covariance(self, keys: Iterable[str] | None = None) -> np.ndarray:
        """
        Covariance matrix of the derivatives, their entries one after the other in the order of the keys.

        It is that of the noise, and the biases of the edge width are taken to come and go together.
        """
        chosen = list(self.gradient if keys is None else keys)
        parts = np.concatenate([self.batches[key] for key in chosen], axis=1)
        apart = parts - parts.mean(axis=0)
        none = {key: np.zeros(parts.shape[1]) for key, parts in self.batches.items()}
        bias = np.concatenate([{**none, **self.edge_bias}[key] for key in chosen])
        return np.asarray(BATCHES / (BATCHES - 1) * apart.T @ apart + np.outer(bias, bias))

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
            If one of the keys is not among those of the gradient, or has no derivative, because a beam just fills a
            rim that it moves.
        """
        used = {key: slope for key, slope in slopes.items() if slope}
        missing = [key for key in used if key not in self.batches]
        if missing:
            raise MistrayError(f"the gradient has no '{missing[0]}'; give it keys={sorted(slopes)}")
        self.require(used)
        widths = {key: self.edge_batches.get(key, self.batches[key][None]) for key in used}
        sums = np.asarray(sum((slope * widths[key][..., 0] for key, slope in used.items()), np.zeros((1, BATCHES))))
        if len(sums) == 1:  # no ray near a rim counts
            return Estimate(float(sums.sum()), float(batch_error(sums[0], EQUAL)))
        return Estimate(
            float(sums[self.edge_number].sum()), float(WidthErrors.of(sums[..., None]).total()[self.edge_number, 0])
        )

    def __str__(self) -> str:
        lines = [f"value {self.value:.6e} ± {self.value_se:.1e}"]
        for key, values in self.gradient.items():
            if key in self.untouched:
                continue
            if key in self.full:
                lines.append(
                    f"d/d {key} {self.one_sided.get(key, 'does not exist')}: a beam just fills {self.full[key].rim}"
                )
                continue
            for k, (value, error) in enumerate(zip(values, self.standard_error[key], strict=True)):
                check = ""
                if key in self.edge_batches:
                    at_half, noise = self.edge_check[key][k], self.edge_check_se[key][k]
                    check = f" (half the edge width: {at_half:+.1e} ± {noise:.1e})"
                lines.append(f"d/d {key}[{k}] {value:+.5e} ± {error:.1e}{check}")
        if self.edge_width is not None:
            lines.append(f"width of the zones at rims: {self.edge_width:g} of their radii; errors hold its bias")
        if self.untouched:
            lines.append(
                f"exactly 0, because no traced ray of the metric depends on them: {', '.join(self.untouched)}; trace "
                "more rays or wider zones at rims (edge_width), or choose light that meets them"
            )
        return "\n".join([*lines, *(f"left out: {text}" for text in self.left_out)])


LEFT_OUT = "branches below flux_threshold and children of R = 0 or T = 0, which the trace does not follow"
NO_EDGES = "what rays gain and lose at rims and silhouettes (edges=False)"
ONSET = (
    "silhouettes of surfaces with tabled coatings, and the onset of total reflection at them, where R and T can jump"
)
INDEX_OF_SCATTER = "the change of what surfaces scatter with the index of the materials beside them"


@warns
def gradient(
    metric: Metric,
    params: Mapping[str, Any],
    keys: Iterable[str] | None = None,
    *,
    edges: bool = True,
    edge_width: float | None = None,
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
    edge_width : float, optional
        Width of the zone at a rim in which rays are looked at, in units of its radius, 1e-6 … 0.5. Wider zones have
        less noise and more bias. By default the one of `mistray.gradients.edge_widths.AUTOMATIC` with the least error.

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
    found = gradient_where_smooth(metric, metric.observe(), chosen, request)
    found.left_out.extend(seen_unpolarized(metric.scene, metric.views))
    if not found.full:
        return found
    return replace(found, one_sided=one_sided(metric, {key: at.step for key, at in found.full.items()}, chosen))


def gradient_seen(
    metric: Metric,
    observations: list[Any],
    chosen: Mapping[str, Parameter],
    request: GradientRequest,
) -> Gradient:
    """
    `gradient` from observations that are made already, to be added up: several metrics of the same views share them.

    Parameters as for `gradient_where_smooth`.

    Raises
    ------
    MistrayError
        If a beam just fills a rim that one of the parameters moves: then there is nothing that could be added.
    """
    found = gradient_where_smooth(metric, observations, chosen, request)
    found.require(found.full)
    return found


def gradient_where_smooth(
    metric: Metric,
    observations: list[Any],
    chosen: Mapping[str, Parameter],
    request: GradientRequest,
) -> Gradient:
    """
    `gradient` from observations that are made already, NaN where a beam just fills a rim.

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
    left_out = [LEFT_OUT]
    noise = sum((observation.noise() for observation in observations), Sampled.of(np.zeros(BATCHES), EQUAL))
    raws = _tables(observations, request)
    left_out += dict.fromkeys(text for raw in raws for text in raw.left_out)
    places = {(id(p.owner), p.name) for p in chosen.values()}

    def is_chosen(owner: Any, name: str) -> bool:
        return (id(owner), name) in places

    inner, rims = gathered(raws, is_chosen)
    if request.moves and not request.edge_widths:
        left_out.append(NO_EDGES)
    if request.moves and any(_jumps(raw) for raw in raws):
        left_out.append(ONSET)
    if request.indices and any(raw.scattering.any for raw in raws):
        left_out.append(INDEX_OF_SCATTER)
    full = full_keys(chosen, [full for raw in raws for full in raw.full])
    left_out += dict.fromkeys(
        f"what {at.rim} takes and gives, which a beam just fills: a derivative on each side alone; widen the source"
        for at in full.values()
    )
    batches: dict[str, np.ndarray] = {}
    at_rims: dict[str, np.ndarray] = {}
    for key, p in chosen.items():
        place = id(p.owner), p.name
        batches[key] = inner.get(place, np.zeros((BATCHES, p.value.size)))  # 0: a surface that was never met
        if key in full:
            batches[key] = np.full_like(batches[key], np.nan)
        elif place in rims and rims[place].any():
            at_rims[key] = batches[key] + rims[place]
    more = all(observation.resamples for observation in observations)
    number = least_error(at_rims.values(), more)
    width = request.edge_widths[number] if at_rims else None
    samples = further_samples(number) if more and at_rims else 0
    if samples:
        again = replace(request, edge_widths=widths_of(request.edge_widths[number]), edge_samples=samples)
        others = _tables(observations, again)
        _, further = gathered(others, is_chosen)
        raws += others
        for key, sums in at_rims.items():
            # What further samples say of the two widths, weighed by rays; narrower ones are judged by the first alone
            own = rims[id(chosen[key].owner), chosen[key].name][number : number + 2]
            both = (own + further.get((id(chosen[key].owner), chosen[key].name), 0.0)) / (1 + samples)
            at_rims[key] = np.concatenate([batches[key] + both, sums[number + 2 :]])
        number = 0
    return Gradient(
        value=float(dr.detach(value)[0]),
        value_se=float(noise.se),
        value_noise=noise.apart,
        batches=batches | {key: sums[number] for key, sums in at_rims.items()},
        edge_width=width,
        edge_number=number,
        edge_batches=at_rims,
        full=full,
        one_sided={},
        left_out=left_out,
        seconds=(sum(o.seconds for o in observations), sum(raw.seconds for raw in raws)),
    )


def _tables(observations: Sequence[Any], request: GradientRequest) -> list[TableGradient]:
    """Collect the tracer's part of a metric's derivatives; fields that share tables pass the chain rule at once."""
    raws: dict[tuple[Any, ...], TableGradient] = {}
    for observation in observations:
        for raw in observation.table_gradients(request):
            tables = map(id, raw.table.optics.tables)
            shared = raw.table.wavelength_nm, raw.backward, raw.parts, *tables
            if shared in raws:
                raws[shared].add(raw)
            else:
                raws[shared] = raw
    return list(raws.values())


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
    chosen: Iterable[Parameter], edges: bool = True, edge_width: float | None = None
) -> GradientRequest:
    """List what the tracer must gather for some parameters; edges and edge_width as for `gradient`."""
    if edge_width is not None:
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
        edge_widths=widths_of(edge_width) if edges and (shapes or kinds & {"index", "source"}) else (),
    )

"""A metric's value and its derivatives with respect to scene parameters, with standard errors (`mistray.gradient`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mistray.errors import MistrayError, nearest
from mistray.estimate import Estimate
from mistray.gradients.edge_widths import EQUAL, WidthErrors, further_samples, least_error, widths_of
from mistray.gradients.geometry_gradient import geometry_columns
from mistray.gradients.parameter_gradient import gathered
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.metrics.metric import Metric
from mistray.metrics.one_sided import FullKey, OneSided, full_keys, one_sided
from mistray.metrics.parameters import Parameter, chosen_keys, parameters
from mistray.metrics.views import seen_unpolarized
from mistray.notes import warns
from mistray.ranges import EDGE_WIDTH as ZONE
from mistray.ranges import FINITE, TEXT, ByName, Several, several
from mistray.recorders.sampled import batch_error
from mistray.result import KeyNumber, Result
from mistray.scene.titles import scene_name
from mistray.settings import BATCHES
from mistray.surfaces.optics import OPAQUE, TABLED

COATING_KINDS = ("coating", "share")
OTHER_KINDS = ("scatter", "index", "source")
KEYS = Several(TEXT, least=0)
SLOPES = ByName(FINITE, "{'window_front.z': 1.0}")


@dataclass(frozen=True, repr=False)
class Gradient(
    Result, table="..toolkit.tables.gradients:gradient_table", figure="..toolkit.figures.gradients:gradient_figure"
):
    """
    Value of a metric and its derivatives with respect to parameters.

    Attributes
    ----------
    value, value_se : float
        Value of the metric and its standard error, in its unit.
    value_noise : (b,) float64
        Noise of the metric, in its unit, by batch, or by group of batches, see
        `mistray.recorders.sampled.Sampled.apart`.
    batches : dict of str to (BATCHES, entries) float64
        Contributions of single batches of start rays by the key of the parameter, in the unit of the metric over that
        of the parameter. Their sum is the gradient.
    edge_width : float or None
        Width of the zones at rims, in units of the rims' radii; None if no rays near rims contribute.
    edge_number : int
        Position of this width among the widths of `edge_batches`.
    edge_batches : dict of str to (widths, BATCHES, entries) float64
        Values of `batches` for all compared widths, by key; each width is half of the one before. Only parameters on
        which rays near rims depend are included.
    full : dict of str to FullKey
        Rims that a beam just fills and that a parameter moves relative to the beam, by key. Such a parameter has no
        derivative: it is NaN.
    one_sided : dict of str to OneSided
        Derivatives below and above the value of a parameter without derivative, by key. They are not linear: those of
        parameters that move together do not add up.
    left_out : list of str
        Effects that the derivatives do not include.
    seconds : (float, float)
        Times of the primal traces and of those for the derivatives, s.

    Examples
    --------
    >>> import mitsuba as mi
    >>> scene = mistray.load("lens_and_window")
    >>> ghosts = mistray.optimize.path_power(scene, "ghost", rays=5000)
    >>> found = mistray.gradient(ghosts, mi.traverse(scene), keys=["detector.bsdf.R", "window_front.z"])
    >>> mistray.report.with_error(found.along({"detector.bsdf.R": -0.1}))  # if R falls by a tenth
    '-3.103e-03 ± 1.4e-05'
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

    def key_numbers(self) -> dict[str, KeyNumber]:
        """
        Return, by label, the metric's value, the number of `untouched` parameters, and that of all other derivatives.

        A parameter with several entries, such as the layers of a coating, has several derivatives.
        """
        touched = sum(len(parts) for key, parts in self.gradient.items() if key not in self.untouched)
        return {"value": Estimate(self.value, self.value_se), "derivatives": touched, "exactly 0": len(self.untouched)}

    @cached_property
    def gradient(self) -> dict[str, np.ndarray]:
        """Derivatives of the metric, (entries,) float64, in its unit per unit of the parameter, by key."""
        return {key: parts.sum(axis=0) for key, parts in self.batches.items()}

    @cached_property
    def standard_error(self) -> dict[str, np.ndarray]:
        """
        Standard errors of the derivatives, (entries,) float64, by key: noise and `edge_bias` together.

        The noise is that of the mean over the start rays, for the derivatives with respect to the traced fluxes. For a
        metric that is not linear in the fluxes, such as a ratio, the noise of these derivatives is not included.
        """
        noise = {key: np.asarray(batch_error(parts.T, EQUAL)) for key, parts in self.batches.items()}
        return noise | {key: errors.total()[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_bias(self) -> dict[str, np.ndarray]:
        """
        Bias of the derivatives, (entries,), from the finite width of the zones at rims, in their units, by key.

        Keys are those of `edge_batches`. The size of a bias is never less than its own noise, `edge_check_se`; see
        `mistray.gradients.edge_widths.WidthErrors`.
        """
        return {key: errors.bias[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_check(self) -> dict[str, np.ndarray]:
        """Change of the derivatives, (entries,), in their units, if zones at rims are half as wide, by key."""
        return {key: errors.check[self.edge_number] for key, errors in self._at_rims.items()}

    @property
    def edge_check_se(self) -> dict[str, np.ndarray]:
        """Standard error of `edge_check`, (entries,), by key, in the derivative's unit."""
        return {key: errors.check_se[self.edge_number] for key, errors in self._at_rims.items()}

    @cached_property
    def _at_rims(self) -> dict[str, WidthErrors]:
        return {key: WidthErrors.of(sums) for key, sums in self.edge_batches.items()}

    def require(self, keys: str | Iterable[str]) -> None:
        """Raise `MistrayError` if one of `keys` has no derivative, because a beam just fills a rim that it moves."""
        for key in KEYS.check("keys", several(keys)):
            if key in self.full:
                raise MistrayError(
                    f"parameter '{key}' has no derivative, because a beam just fills {self.full[key].rim}; widen the "
                    "source by a few per cent"
                )

    @property
    def untouched(self) -> list[str]:
        """Keys of parameters whose derivatives are exactly 0, since no traced ray depends on them."""
        return [key for key, parts in self.batches.items() if not np.any(parts)]

    def covariance(self, keys: str | Iterable[str] | None = None) -> np.ndarray:
        """
        Return the covariance matrix of the derivatives, (n, n), with the entries of `keys` (None: all) in their order.

        It is that of the noise, with the biases of the edge width taken as fully correlated. Units are products of
        those of the derivatives. Raise `MistrayError` if the gradient lacks a key.
        """
        chosen = KEYS.check("keys", several(self.gradient if keys is None else keys))
        missing = [key for key in chosen if key not in self.batches]
        if missing:
            raise MistrayError(f"the gradient has no '{missing[0]}'; {nearest(missing[0], self.batches)}")
        parts = np.concatenate([np.zeros((BATCHES, 0)), *(self.batches[key] for key in chosen)], axis=1)
        apart = parts - parts.mean(axis=0)
        none = {key: np.zeros(parts.shape[1]) for key, parts in self.batches.items()}
        bias = np.concatenate([np.zeros(0), *({**none, **self.edge_bias}[key] for key in chosen)])
        return np.asarray(BATCHES / (BATCHES - 1) * apart.T @ apart + np.outer(bias, bias))

    def along(self, slopes: Mapping[str, float]) -> Estimate:
        """
        Return the derivative along a direction in which several parameters change at once, such as that of a body.

        It is in the metric's unit per unit of the motion. Of a parameter with several entries, all change.

        Parameters
        ----------
        slopes : mapping of str to float
            Change of each parameter, in its unit, per unit of the motion, by key; for instance from
            `mistray.optimize.Body.slopes`.

        Raises
        ------
        MistrayError
            If a key is not among those of the gradient, or has no derivative because a beam just fills a rim that it
            moves.
        """
        used = {key: slope for key, slope in SLOPES.check("slopes", slopes).items() if slope}
        missing = [key for key in used if key not in self.batches]
        if missing:
            raise MistrayError(f"the gradient has no '{missing[0]}'; give it keys={sorted(slopes)}")
        self.require(used)
        widths = {key: self.edge_batches.get(key, self.batches[key][None]) for key in used}
        sums = np.asarray(
            sum((slope * widths[key].sum(axis=-1) for key, slope in used.items()), np.zeros((1, BATCHES)))
        )
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
    "silhouettes of surfaces with tabulated coatings, and the onset of total reflection at them, where R and T can jump"
)
HEIGHT = "the change of the field angle with the z of a source at a height field_mm: the derivative holds the angle"
INDEX_OF_SCATTER = "the change of what surfaces scatter with the index of the materials beside them"


@warns
def gradient(
    metric: Metric,
    params: Mapping[str, Any],
    keys: str | Iterable[str] | None = None,
    *,
    edges: bool = True,
    edge_width: float | None = None,
) -> Gradient:
    """
    Return the derivatives of a metric with respect to coatings, scatter, indices, shapes, places, rims and sources.

    Coatings alone cost one reverse run for each field and wavelength. For other parameters the rays are recorded, and
    differentiated event by event. For shapes, rays that hit a surface near a rim are also sent past it. The difference
    is what the rim takes from the metric, or adds to it.

    Parameters
    ----------
    metric : Metric
        Metric to differentiate, such as one of `mistray.metrics.metric` or a `combine` of several.
    params : mi.SceneParameters
        Parameters of ``mi.traverse(metric.scene)``, perhaps reduced by its `keep`.
    keys : str or iterable of str, optional
        Keys of parameters or patterns such as ``"vane_*.r0"``; by default all in `params` that have a derivative.
    edges : bool
        Whether light that rays gain and lose at rims is included. Otherwise visibility counts as constant.
    edge_width : float, optional
        Width of the zone at a rim that is sampled, in units of the rim's radius, 1e-6 … 0.5. Wider zones have less
        noise and more bias. The default is the width of `mistray.gradients.edge_widths.AUTOMATIC` with the least error.

    Returns
    -------
    Gradient
        Value of the metric, its derivatives and their errors.

    Raises
    ------
    MistrayError
        If a key is unknown or has no derivative, or the scene or the settings have none.

    Examples
    --------
    >>> import mitsuba as mi
    >>> scene = mistray.load("lens_and_window")
    >>> ghosts = mistray.optimize.path_power(scene, "ghost", rays=5000)
    >>> found = mistray.gradient(ghosts, mi.traverse(scene), keys="detector.bsdf.R")
    >>> print(f"{found.value:.4f}, d/dR = {found.gradient['detector.bsdf.R'][0]:.3f}")
    0.0136, d/dR = 0.031
    """
    chosen = chosen_parameters(metric.scene, params, keys)
    request = gradient_request(chosen.values(), edges, edge_width)
    found = gradient_where_smooth(metric, metric.observe(), chosen, request)
    found.left_out.extend(seen_unpolarized(metric.scene, metric.views))
    if found.full:
        sides = one_sided(metric, {key: at.step for key, at in found.full.items()}, chosen)
        found = replace(found, one_sided=sides)
    return found.of_scene(scene_name(metric))


def gradient_seen(
    metric: Metric,
    observations: list[Any],
    chosen: Mapping[str, Parameter],
    request: GradientRequest,
) -> Gradient:
    """
    Return the `gradient` of a metric from traces already made, which metrics of equal views can share.

    Parameters are those of `gradient_where_smooth`.

    Raises
    ------
    MistrayError
        If a beam just fills a rim that one of the parameters moves: derivatives would not add up.
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
    Return the `gradient` from observations already made; NaN for parameters that move a rim which a beam just fills.

    Parameters
    ----------
    metric : Metric
        Metric to differentiate.
    observations : list of Observation or PstObservation
        Observations made by `Metric.observe`.
    chosen : mapping of str to Parameter
        Parameters made by `chosen_parameters`.
    request : GradientRequest
        Request made by `gradient_request`.

    Raises
    ------
    MistrayError
        If the value or a derivative does not exist, see `Metric.evaluate` and
        `mistray.gradients.path_replay.PathReplay`.
    """
    value, noise = metric.differentiate(observations)
    left_out = [LEFT_OUT]
    raws = _tables(observations, request)
    left_out += dict.fromkeys(text for raw in raws for text in raw.left_out)
    if "z" in request.sources and any(view.arguments.get("field_mm") for view in metric.views):
        left_out.append(HEIGHT)
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
            # Further samples compare the two widths, weighted by rays; narrower ones are judged by the first alone
            own = rims[id(chosen[key].owner), chosen[key].name][number : number + 2]
            both = (own + further.get((id(chosen[key].owner), chosen[key].name), 0.0)) / (1 + samples)
            at_rims[key] = np.concatenate([batches[key] + both, sums[number + 2 :]])
        number = 0
    return Gradient(
        value=value,
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
    """
    Return the derivatives of an evaluated metric with respect to the tracer's tables, for each source and wavelength.

    `request` says which. Those of several observations are added up where they share all tables.
    """
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
    """True if a transparent surface takes R and T from a table, which leaves them undefined at grazing incidence."""
    optics = raw.table.optics
    clear = (optics.host_words & OPAQUE) == 0
    tabled = [
        kind == TABLED and bsdf.film is None for bsdf, kind in zip(optics.bsdfs, optics.host_words & 3, strict=True)
    ]
    return bool(np.any(clear & np.array(tabled)))


def chosen_parameters(
    scene: Any, params: Mapping[str, Any], keys: str | Iterable[str] | None = None
) -> dict[str, Parameter]:
    """
    Return the parameters that keys or patterns select; without keys, all in `params` that have a derivative.

    Raises
    ------
    MistrayError
        If a key is unknown or has no derivative, or no parameter is left.
    """
    known = parameters(scene, params)
    return {key: known[key] for key in chosen_keys(scene, known, keys)}


def gradient_request(
    chosen: Iterable[Parameter], edges: bool = True, edge_width: float | None = None
) -> GradientRequest:
    """
    Return the request for derivatives with respect to the chosen parameters.

    `edges` and `edge_width` are as for `gradient`; a width out of range raises `MistrayError`.
    """
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

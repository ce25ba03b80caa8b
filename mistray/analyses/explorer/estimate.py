"""Estimate of stray light for changed controls: the traced power of each path, scaled by the changes along it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analyses.explorer.controls import NUMBER, VALUES, WAVELENGTH, Control
from mistray.analyses.explorer.looks import Looks
from mistray.analyses.explorer.traced import Traced
from mistray.estimate import UNKNOWN, Estimate
from mistray.events import FIRST_SCATTERED
from mistray.recorders.path_events import DIRECT

Floats = npt.NDArray[np.float64]
OF_FIRST_ORDER = "first order"
COLUMNS = ["source", "events", "label", "kind", "power_W", "power_se_W", "rms_radius_mm", "rms_irradiance_W_mm2",
           "rms_irradiance_se_W_mm2"]  # fmt: skip
IN_PROPORTION = [name for name in COLUMNS if "_W" in name]  # to the power, the radius being as it was traced


@dataclass(frozen=True)
class Guess:
    """
    Estimate of the light for control values that have not been traced.

    Attributes
    ----------
    ways : DataFrame
        `COLUMNS` of each path of the light, see `mistray.trace.path_row.PathRow`.
    stray_W, direct_W, ratio : Estimate
        Stray and direct power, W, and stray over direct. In `guess` the errors are those of the trace, in proportion,
        with those of the sample of rays and of the derivatives.
    map_W : (h, w) float64
        Stray power on the cells of `Traced.maps`, W.
    extent : tuple of float
        Extent of the cells: x0, x1, y0, y1, mm.
    left_out : tuple of str
        Effects that the estimate neglects.
    """

    ways: pd.DataFrame
    stray_W: Estimate
    direct_W: Estimate
    ratio: Estimate
    map_W: Floats
    extent: tuple[float, float, float, float]
    left_out: tuple[str, ...]


def guess(of: Traced, looks: Looks, controls: Mapping[str, Control], state: Mapping[str, VALUES]) -> Guess:
    """
    Return an estimate of the light for changed control values, from a trace.

    Each sampled ray is multiplied, at its own angles of incidence, by a ratio for each of its surfaces: the fraction of
    light that goes its way now over that in the trace. A path is multiplied by the mean over its rays. Paths without
    rays in the sample follow those of their kind. Controls of first order change the stray power alone.

    Parameters
    ----------
    of : Traced
        Trace with other values of the controls.
    looks : Looks
        Coatings and scatter models of the surfaces.
    controls : mapping of str to Control
        Controls of the explorer, by name.
    state : mapping
        Values of all controls.
    """
    moved = [controls[name] for name, value in state.items() if value != of.state[name]]
    factor, factor_se = _factors(of, _ray_factors(of, looks, state, moved))
    traced, stray = np.asarray(of.ways.power_W), of.stray
    power, sampled_se = traced * factor, traced * factor_se
    change, change_se = _of_first_order(of, state, moved)
    # With the errors of the sample and of the derivatives; those of the trace are beside them, in proportion
    found = [
        Estimate(
            float(power[stray].sum()) * max(1 + change, 0.0),
            math.hypot(float(np.linalg.norm(sampled_se[stray])), of.stray_W.value * change_se),
        ),
        Estimate(float(power[~stray].sum()), float(np.linalg.norm(sampled_se[~stray]))),
    ]
    stray_W, direct_W, ratio = (
        Estimate(now.value, math.hypot(_in_proportion(was, now.value).se, now.se))
        for was, now in zip((of.stray_W, of.direct_W, of.ratio), (*found, found[0].over(found[1])), strict=True)
    )
    ways = of.ways[COLUMNS].copy()
    for value, se in (("power_W", "power_se_W"), ("rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2")):
        ways[se] = np.hypot(of.ways[se] * factor, of.ways[value] * factor_se)
        ways[value] = of.ways[value] * factor
    return Guess(
        ways,
        stray_W,
        direct_W,
        ratio,
        map_W=_map(of, factor),
        extent=of.maps.extent,
        left_out=tuple(_left_out(of, moved)),
    )


def _of_first_order(of: Traced, state: Mapping[str, VALUES], moved: list[Control]) -> Estimate:
    """
    Return the relative change of the stray power to first order in the moved controls, with its standard error.

    Controls whose derivative is unknown count as unmoved.
    """
    slopes = [(c.name, of.slopes[c.name]) for c in moved if c.name in of.slopes]
    found = [(slope, float(state[k]) - float(of.state[k])) for k, slope in slopes if math.isfinite(slope.value)]
    change = sum(slope.value * step for slope, step in found)
    return Estimate(change, math.sqrt(sum((slope.se * step) ** 2 for slope, step in found)))


def at_field(
    traces: Mapping[float, Traced],
    looks: Looks,
    controls: Mapping[str, Control],
    state: Mapping[str, VALUES],
) -> Guess:
    """
    Return an estimate of the light at a field angle, with powers interpolated linearly between the nearest two traces.

    The light of a path may rise anywhere between two traced fields a and b. At the share s of the way from a to b, 2 s
    (1 - s) |P(b) - P(a)| is therefore added to the error of each path. In the middle this is half the difference,
    enough for a step anywhere, and twice the error for light that rises with the square of the field. The errors of all
    paths add up linearly, as the same rims cut them. Beyond the traced fields the error is the estimate itself.

    Parameters
    ----------
    traces : mapping of float to Traced
        Traces by field angle, degrees; at least one.
    looks, controls, state
        Arguments of `guess`.
    """
    field = float(state["field"])
    below, above = [f for f in traces if f <= field], [f for f in traces if f >= field]
    ends = sorted({max(below, default=min(traces)), min(above, default=max(traces))})
    found = [guess(traces[f], looks, controls, {**state, "field": f}) for f in ends]
    if len(ends) == 1:
        return found[0] if ends[0] == field else _beyond(found[0], f"field: all as at {ends[0]:g}°")
    share = (field - ends[0]) / (ends[1] - ends[0])
    note = f"field: powers between those at {ends[0]:g}° and {ends[1]:g}°, map and rays of the nearer one"
    shares = (1 - share, share)
    near = found[int(share > 0.5)]
    both = pd.concat(
        one.ways.assign(**{key: one.ways[key] * part for key in IN_PROPORTION}, rise_W=sign * one.ways.power_W)
        for one, part, sign in zip(found, shares, (-1, 1), strict=True)
    )
    added = partial(pd.Series.sum, skipna=False)  # what one of both does not know is not known
    ways = both.groupby(COLUMNS[:2], sort=False, as_index=False).agg(
        {name: added if name in (*IN_PROPORTION, "rise_W") else "first" for name in (*COLUMNS[2:], "rise_W")}
    )
    missed = 2 * share * (1 - share) * np.abs(np.asarray(ways.rise_W))
    ways = ways.assign(power_se_W=np.hypot(ways.power_se_W, missed))[COLUMNS]
    stray = np.asarray(ways.kind != DIRECT)
    totals: dict[str, Any] = {}
    for name, of_its_ways in (("stray_W", stray), ("direct_W", ~stray)):
        value, se = np.array([getattr(one, name) for one in found]).T @ shares
        totals[name] = Estimate(float(value), math.hypot(se, missed[of_its_ways].sum()))
    light, ratio = totals["direct_W"], math.nan
    error = totals["stray_W"].se
    if light.value > 0:
        ratio = totals["stray_W"].value / light.value
        error = (error + ratio * light.se) / light.value
    totals["ratio"] = Estimate(ratio, error)
    left_out = tuple(dict.fromkeys([note, *(text for one in found for text in one.left_out)]))
    return dataclasses.replace(near, ways=ways, left_out=left_out, **totals)


def _beyond(near: Guess, note: str) -> Guess:
    """Return the estimate beyond the traced fields: that of the nearest field, with errors as large as its values."""
    whole: dict[str, Any] = {
        name: Estimate(*[getattr(near, name).value] * 2) for name in ("stray_W", "direct_W", "ratio")
    }
    ways = near.ways.assign(power_se_W=near.ways.power_W)
    return dataclasses.replace(near, ways=ways, left_out=(note, *near.left_out), **whole)


def _ray_factors(of: Traced, looks: Looks, state: Mapping[str, VALUES], moved: list[Control]) -> Floats:
    """Return the factor, (rays,), by which changed coatings, scatter and wavelength scale each sampled ray's flux."""
    found = np.ones(len(of.sample.way))
    before, now = looks.of(of.state), looks.of(state)
    nm = next((float(state[c.name]) for c in moved if c.kind == WAVELENGTH), None)
    for number, group in enumerate(of.sample.groups):
        if nm is None and before[group.surface] == now[group.surface]:
            continue
        hits = group.hits
        if nm is not None and hits.event < FIRST_SCATTERED:
            hits = dataclasses.replace(hits, wavelength_nm=nm)
        becomes = looks.factor(group.surface, now[group.surface], hits)
        np.multiply.at(found, group.rays, _quotient(of.factors[number], becomes))
    return found


def _quotient(was: Floats, becomes: Floats) -> Floats:
    """Return `becomes` / `was`; 1 where `was` is 0, as rounding differs near the critical angle."""
    return np.where(was > 0, becomes / np.where(was > 0, was, 1.0), 1.0)


def _factors(of: Traced, by_ray: Floats) -> tuple[Floats, Floats]:
    """
    Return the factor on each path's power, (paths,), and its standard error, from the factors of its rays.

    A path without sampled rays has the mean factor of the paths of its kind, or else of all stray paths, and the error
    0.
    """
    count, sample = len(of.ways), of.sample
    weight = np.bincount(sample.way, sample.weight, minlength=count)
    changed = np.bincount(sample.way, sample.weight * by_ray, minlength=count)
    known = weight > 0
    factor = np.where(known, changed / np.where(known, weight, 1.0), np.nan)
    apart = np.square(sample.weight * (by_ray - factor[sample.way]))
    error = np.sqrt(np.bincount(sample.way, apart, minlength=count)) / np.where(known, weight, 1.0)
    power = np.asarray(of.ways.power_W)
    kinds = np.asarray(of.ways.kind)
    for kind in np.unique(kinds[~known]):
        alike = known & (kinds == kind)
        if not alike.any():
            alike = known & of.stray
        total = power[alike].sum()
        factor[~known & (kinds == kind)] = (power[alike] * factor[alike]).sum() / total if total > 0 else 1.0
    return factor, error


def _map(of: Traced, factor: Floats) -> Floats:
    """
    Return the stray power, W, in the detector's cells, (h, w), with the power of paths times `factor`, (paths,).

    Paths without a map of their own are multiplied by their mean factor.
    """
    others = np.setdiff1d(np.flatnonzero(of.stray), of.maps.ways)
    power = np.asarray(of.ways.power_W)[others]
    rest = float((power * factor[others]).sum() / power.sum()) if power.sum() > 0 else 1.0
    return np.asarray(np.tensordot(np.append(factor[of.maps.ways], rest), of.maps.power_W, axes=1))


def _in_proportion(traced: Estimate, value: float) -> Estimate:
    return Estimate(value, traced.se * value / traced.value if traced.value > 0 else 0.0)


def _left_out(of: Traced, moved: list[Control]) -> list[str]:
    """Return one line of text on each effect that the estimate neglects."""
    found = []
    for c in moved:
        if c.kind == WAVELENGTH:
            found.append("wavelength: R and T follow; rays and scatter stay as they were")
        elif c.kind == NUMBER and c.way == OF_FIRST_ORDER:
            slope = of.slopes.get(c.name, UNKNOWN)
            known = "total to first order; paths and map" if math.isfinite(slope.value) else "no derivative; all"
            found.append(f"{c.label}: {known} as traced")
        elif c.parameter is not None and c.parameter.kind == "scatter":
            found.append(f"{c.label}: specular beams lose to scatter what they lost")
    if any(c.parameter is not None and c.parameter.name in ("level", "coverage_percent") for c in moved):
        found.append("cleanliness: scatter in proportion to the area that particles cover")
    if of.polarized and any(c.way != OF_FIRST_ORDER for c in moved):
        found.append("polarisation: R and T are those of unpolarised light")
    return found

"""
Chain rule from derivatives with respect to scatter-table entries to those with respect to scatter parameters.

The tables are functions of the models' values, in float64 on the host. Each table is computed again a little to either
side of a value, and the difference quotients are multiplied by the derivatives with respect to the entries. The models
are smooth: the relative error is about the square of the relative step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import drjit as dr
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.scatter_replay import LOBES, LOGS, RATIOS, TOTAL_FLOATS, TOTALS
from mistray.kernel.lobes import STRIDE, stored_logs
from mistray.kernel.scatter_tables import (
    LOBE_FLOATS,
    RATIO_HEAD,
    Case,
    PackedLobes,
    Side,
    light_indices,
    lobe_floats,
    make_side,
    pack,
)
from mistray.kernel.scattering import Scattering
from mistray.scatter.lobe import Lobe
from mistray.settings import BATCHES
from mistray.surfaces.surfaces import SurfaceTable

STEP = 1e-4  # relative to the value
PROBES = ((550.0, 1.0, 1.5, True), (550.0, 1.5, 1.0, False))  # wavelength, indices and side that `fixed` examines


def scatter_gradient(
    table: SurfaceTable,
    scattering: Scattering,
    derivatives: dict[str, np.ndarray],
    is_chosen: Callable[[Any, str], bool] = lambda owner, name: True,
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Yield derivatives of a metric with respect to the parameters of scatter models, by batch of start rays.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the run.
    scattering : Scattering
        Scatter of the run.
    derivatives : dict
        Result of `mistray.gradients.scatter_replay.ScatterReplay.derivatives`.
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested. By default all are.

    Yields
    ------
    owner, name, gradient
        A scatter plugin, the name of one of its values, and the derivatives by batch, (BATCHES, 1), summed over all
        surfaces that have the plugin, in the metric's unit per unit of the value.

    Raises
    ------
    MistrayError
        If lobes appear or vanish at a value, so that it has no derivative, see `fixed`.
    """
    # Cases of the tables that each plugin is part of
    packed = pack(scattering.tables.all_cases, by_plugin=True)
    cases: dict[int, dict[int, Case]] = {}  # by plugin and place
    for number, case in enumerate(scattering.tables.all_cases):
        for member in case.members:
            cases.setdefault(id(member.plugin), {})[number] = case
    for plugin in {id(plugin): plugin for bsdf in table.optics.bsdfs for plugin in bsdf.scatterers}.values():
        own = list(cases.get(id(plugin), {}).values())
        for name in plugin.values:
            if not is_chosen(plugin, name):
                continue
            reason = fixed(plugin, name)
            if reason is not None:
                raise MistrayError(
                    f"{plugin.title}: {reason}, where it has no derivative; leave it out, or start elsewhere"
                )
            total = np.zeros(BATCHES)
            for array, place, slope in table_slopes(table, own, packed, plugin, quotient(plugin, name)):
                total += derivatives[array][:, place : place + slope.size] @ slope.ravel()
            yield plugin, name, total[:, None]


def fixed(plugin: Any, name: str) -> str | None:
    """
    Return the reason why a scatter parameter cannot be differentiated in a trace, as a phrase; None if it can.

    It cannot where lobes appear or vanish at 0, such as at an amplitude of 0, or where the model allows only one value.
    None is also returned where the model refuses the indices tried here: the trace raises an error of its own.
    """
    value = float(dr.detach(plugin.values[name])[0])
    try:
        models = [plugin.model, *(model for _, model in quotient(plugin, name))]
        if value != 0:
            return None
    except MistrayError:
        return f"{name} can only be {value:g}"
    try:
        kinds = {tuple(_kind(lobe) for at in PROBES for lobe in model.lobes(*at)) for model in models}
    except MistrayError:  # the model refuses these indices; a trace of the scene raises its own error
        return None
    return None if len(kinds) == 1 else f"lobes come or go at {name} = 0"


def quotient(plugin: Any, name: str, relative_step: float = STEP) -> list[tuple[float, Any]]:
    """
    Return the terms of a difference quotient with respect to a scatter parameter.

    It is central, or one-sided at the end of a range.

    Parameters
    ----------
    plugin : Scatterer
        Scatter model of the scene.
    name : str
        Name of the parameter.
    relative_step : float
        Step in units of the value, or of 1 if that is 0.

    Returns
    -------
    list of (float, model)
        Weights and models; the weighted sum of anything that follows from a model is its derivative.

    Raises
    ------
    MistrayError
        If there is no room to either side.
    """
    values = plugin.model.values
    step = relative_step * (abs(values[name]) or 1.0)

    def at(steps: int) -> Any:
        return plugin.model.changed(**{name: values[name] + steps * step})

    for stencil in ({-1: -0.5, 1: 0.5}, {0: -1.5, 1: 2.0, 2: -0.5}, {0: 1.5, -1: -2.0, -2: 0.5}):
        try:
            return [(weight / step, at(steps)) for steps, weight in stencil.items()]
        except MistrayError:
            continue
    raise MistrayError(
        f"{plugin.title}: no derivative with respect to {name} at {values[name]:g}, which has no neighbours"
    )


def table_slopes(
    table: SurfaceTable, cases: list[Case], packed: PackedLobes, plugin: Any, models: list[tuple[float, Any]]
) -> Iterator[tuple[str, int, np.ndarray]]:
    """
    Yield derivatives of scatter-table entries with respect to one parameter of a scatter plugin.

    `cases` are those that the plugin is part of, `packed` the lobes of all cases by plugin, and `models` the terms of
    `quotient` with respect to that parameter. Each item is the name of an array of `Scattering.arrays`, the index of
    the first entry in the flattened array, and the derivatives from there on. Tables that several lobes share are
    yielded once.

    Raises
    ------
    MistrayError
        If the number or the kinds of lobes change with the parameter.
    """
    known: dict[tuple[float, float, bool], list[tuple[float, Side]]] = {}
    done: set[tuple[str, int]] = set()
    for case in cases:
        own = [(case.first_lobe + k, member) for k, member in enumerate(case.members) if member.plugin is plugin]
        key = (*light_indices(table.optics, case.surface, case.from_front), case.from_front)
        if key not in known:
            known[key] = [(weight, make_side((model,), table.wavelength_nm, *key)) for weight, model in models]
        sides = known[key]
        # The number and the kinds of lobes must be those of the trace
        for _, side in sides:
            lobes = [lobe for lobe in side.lobes if lobe.event == case.event]
            if [_kind(lobe) for lobe in lobes] != [_kind(member.lobe) for _, member in own]:
                raise MistrayError(
                    f"{plugin.title}: its lobes at surface '{table.ids[case.surface]}' come or go with its values, so "
                    "they have no derivative there"
                )
        # Totals of the event, then floats, radial table and ratio table of each lobe
        slopes = _sum((w, np.broadcast_to(side.rows[case.event], case.rows.shape)) for w, side in sides)
        yield TOTALS, case.first_row * TOTAL_FLOATS, slopes
        for k, member in own:
            moved = [(w, side.lobes[member.number], side.tables[member.number]) for w, side in sides]
            yield LOBES, k * LOBE_FLOATS, _sum((w, lobe_floats(lobe, radial)) for w, lobe, radial in moved)
            # Tables that several lobes share are yielded once
            place = packed.table_numbers[k] * STRIDE
            if (LOGS, place) not in done:
                yield LOGS, place, _sum((w, stored_logs(radial)) for w, _, radial in moved)
            done.add((LOGS, place))
            place = int(packed.words[k, 1]) + RATIO_HEAD
            if not member.lobe.fixed and (RATIOS, place) not in done:
                yield RATIOS, place, _sum((w, lobe.ratio.values) for w, lobe, _ in moved if lobe.ratio is not None)
                done.add((RATIOS, place))


def _sum(terms: Iterable[tuple[float, np.ndarray]]) -> np.ndarray:
    """Return the weighted sum of arrays, which are given as pairs of a weight and an array."""
    return np.asarray(sum(weight * values for weight, values in terms))


def _kind(lobe: Lobe) -> tuple[Any, ...]:
    """Return properties of a lobe that a parameter must not change: event, measure, centre, factor, table shape."""
    shape = None if lobe.ratio is None else (lobe.ratio.axes, lobe.ratio.r_min, lobe.ratio.values.shape)
    return lobe.event, lobe.measure, lobe.centre, lobe.factor, shape

"""Metrics of scenes by name, for studies and commands, with the arguments that each takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from mistray.analyses.pst.metrics.pst_metrics import PST_FIELD, pst_band, pst_bin, pst_mask, veiling_glare
from mistray.analyses.pst.request import PstRequest
from mistray.metrics.metric import (
    Metric,
    ghost_focus,
    ghost_rms_irradiance,
    ghost_to_signal,
    path_power,
    peak_irradiance,
    relative_illumination,
    rms_spot,
    transmission,
)
from mistray.ranges import demand_of
from mistray.settings import Settings
from mistray.toolkit.fields import flat_fields

TRACED: dict[str, Callable[..., Metric]] = {
    factory.__name__: factory
    for factory in (
        path_power,
        ghost_to_signal,
        peak_irradiance,
        ghost_rms_irradiance,
        ghost_focus,
        rms_spot,
        transmission,
        relative_illumination,
    )
}
"""Of traces: `factory(scene, **own, field_deg=…, **arguments of mistray.trace)`."""
OF_PST: dict[str, Callable[..., Metric]] = {
    factory.__name__: factory for factory in (pst_bin, pst_band, pst_mask, veiling_glare)
}
"""Of a point source transmittance: `factory(scene, **own, **arguments of mistray.pst)`."""
FACTORIES = {**TRACED, **OF_PST}
SETTINGS = {
    one.name: demand
    for kind in (Settings, PstRequest)
    for one, part in flat_fields(kind)
    if part is None and (demand := demand_of(one)) is not None
}
SETTINGS[PST_FIELD] = SETTINGS.pop("field_deg")
"""Demands on what metrics hand on to `mistray.trace` and `mistray.pst`, but the light, of which files have lists."""


def own_arguments(factory: Callable[..., Metric]) -> dict[str, bool]:
    """Return the arguments of a metric other than settings of its traces, by name; True: the argument is required."""
    named = inspect.signature(factory).parameters.values()
    return {p.name: p.default is p.empty for p in list(named)[1:] if p.kind != p.VAR_KEYWORD}

"""Numbers of one trace that make up a row of a sweep: flux, W, spot sizes, mm, and the strongest stray path."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mistray.analyses.ghosts.field_summary import power_of
from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.changes.first_surfaces import Entering, FirstLight, together
from mistray.metrics.changes.gaps import Gap
from mistray.metrics.ghost_ranking import direct_image, ranked, stray_to_direct
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.tables.frames import estimate_of, flat
from mistray.trace import Trace

KIND_COLUMNS = {kind: re.sub(r"\W+", "_", kind).lower() for kind in STRAY_KINDS}
"""Kinds of stray paths and the beginnings of their columns."""
FIRST_LIGHT = "first_light"
TEXTS = ("worst_path", "worst_events", "polarization", "polarization_reason")
OF_WORST = ("power_W", "rms_radius_mm", "rms_irradiance_W_mm2")  # numbers of the worst path
_ESTIMATES = (
    *("detected_W", "direct_W", "stray_W", "ghost_to_signal", *(f"{name}_W" for name in KIND_COLUMNS.values())),
    *("direct_rms_radius_mm", "direct_rms_irradiance_W_mm2", *(f"worst_{name}" for name in OF_WORST)),
)
COLUMNS = (
    *("rays", "paths", "launched_W", "cut_W", "closure", "polarization_change", *TEXTS),
    *flat(dict.fromkeys(_ESTIMATES, UNKNOWN), before_unit=True),
)
"""What every row has, beside `FIRST_LIGHT`."""
Numbers = dict[str, Any]


def numbers_of(t: Trace) -> Numbers:
    """
    Return the results of a trace, such as powers in W and spot radii in mm, as a row of a sweep by column.

    Parameters
    ----------
    t : Trace
        Trace at one wavelength.

    Returns
    -------
    dict
        ``rays`` (start rays), ``paths`` (their number), ``launched_W``, ``detected_W``, ``direct_W``, ``stray_W`` (all
        but the direct image) and the power of every kind of `KIND_COLUMNS`; ``ghost_to_signal`` (stray_W over direct_W;
        NaN out of field), ``direct_rms_radius_mm``, ``direct_rms_irradiance_W_mm2``; ``worst_path``, the stray path of
        the highest RMS irradiance in words (None without stray paths), with its ``worst_events``, ``worst_power_W``,
        ``worst_rms_radius_mm`` and ``worst_rms_irradiance_W_mm2``; ``cut_W`` and ``closure``. Radii, irradiances, the
        ratio, and powers but the launched and the cut one have a standard error, ``_se`` before the unit.
        ``polarization``, ``polarization_reason`` and ``polarization_change`` (NaN if it was not measured) are those of
        the trace. ``first_light`` is the light of each first surface, see `FirstLight`.
    """
    rows = t.paths.by_way()
    kinds, path_ids = rows.kind.to_numpy(object), rows.path_ids.to_numpy(object)
    direct = direct_image(t.paths)
    table = ranked(rows, t.paths, direct)
    worst = table[table.kind != DIRECT].sort_values("rank_rms_irradiance").head(1)
    last = worst.iloc[0] if len(worst) else None
    numbers: Numbers = {
        "rays": int(t.settings["rays"]),
        "paths": len(rows),
        "launched_W": float(t.energy.launched_W),
        "detected_W": Estimate(t.energy.detected_W, t.energy.detected_se_W),
        "direct_W": power_of(t, path_ids[kinds == DIRECT]),
        "stray_W": power_of(t, path_ids[kinds != DIRECT]),
        "ghost_to_signal": stray_to_direct(t.paths, direct),
        **{f"{name}_W": power_of(t, path_ids[kinds == kind]) for kind, name in KIND_COLUMNS.items()},
        "direct_rms_radius_mm": direct.rms_radius_mm,
        "direct_rms_irradiance_W_mm2": direct.rms_irradiance_W_mm2,
        "worst_path": None if last is None else str(last.label),
        "worst_events": None if last is None else str(last.events),
        **{f"worst_{name}": UNKNOWN if last is None else estimate_of(last, name) for name in OF_WORST},
        "cut_W": float(sum(t.energy.cut.values())),
        "closure": float(t.energy.closure),
        **{name: t.settings[name] for name in ("polarization", "polarization_reason")},
        "polarization_change": float(t.settings.get("polarization_change", np.nan)),
    }
    return flat(numbers, before_unit=True) | {FIRST_LIGHT: asdict(FirstLight.of_trace(t))}


def read_numbers(content: bytes) -> Numbers:
    """
    Return a cached row, read from JSON of `numbers_of`.

    Raises
    ------
    ValueError, TypeError, KeyError
        If the content is not such a row: another form, a missing column, or a value of another type or infinite.
    """
    row: Numbers = json.loads(content)
    first = FirstLight(**row[FIRST_LIGHT])
    numbers = [row[name] for name in COLUMNS if name not in TEXTS] + [first.unseen]
    for part in (first.power, first.variance, first.direct, first.strongest):
        numbers += part.values()
    if any(type(number) not in (int, float) or math.isinf(number) for number in numbers):
        raise ValueError("what should be a number is none, or infinite")
    if any(not isinstance(row[name], str | None) for name in TEXTS):
        raise ValueError("what should be a text is none")
    return row


def entering_columns(found: Sequence[Entering]) -> dict[str, Any]:
    """Return table columns on light that enters by new first surfaces: their names, and its percentage of the light."""
    percent = Estimate(*(100 * number for number in together(found)))
    return flat({"entering": " ".join(one.surface for one in found), "entering_percent": percent})


def widest(gaps: Iterable[Gap]) -> float:
    """Return the width of the widest gap that a change opens between surfaces, mm; NaN if there are none."""
    return max((gap.gap_mm for gap in gaps), default=math.nan)

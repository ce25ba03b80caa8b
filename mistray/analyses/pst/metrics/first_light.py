"""Light of a PST at one field angle, sorted by the first surface that it meets on its way to the detector."""

from __future__ import annotations

import numpy as np

from mistray.analyses.pst.found_paths import PATHS_LISTED
from mistray.analyses.pst.result import Pst
from mistray.metrics.changes.first_surfaces import FirstLight, first_surfaces
from mistray.recorders.path_events import DIRECT


def first_light(pst: Pst, field: int) -> FirstLight:
    """Return PST_normal at the field angle of index `field` by first surface of the light; empty without paths."""
    if pst.path_rows is None:
        return FirstLight({}, {}, {}, {})
    rows = pst.path_rows[pst.path_rows.cell == field]
    azimuths = pst.grid.shape[1]
    power, se = rows.pst_normal.to_numpy() / azimuths, rows.pst_normal_se.to_numpy() / azimuths
    first = first_surfaces(rows.events)
    errors = {name: float(np.sum(se[first == name] ** 2)) for name in dict.fromkeys(first)}
    full = rows.groupby("azimuth_cell").size() >= PATHS_LISTED
    weakest = rows.groupby("azimuth_cell").pst_normal.min()[full]
    unseen = float(weakest.max()) / azimuths if len(weakest) else 0.0
    return FirstLight.of_paths(first, power, (rows.kind == DIRECT).to_numpy(), errors, unseen)

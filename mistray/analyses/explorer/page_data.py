"""JSON data for the page of the live explorer: powers, paths and map of a state."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from mistray.analyses.explorer.estimate import Guess
from mistray.analyses.ghosts.verdict import Remedy
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.metrics.ghost_ranking import bounds
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.pages.embedded import power_codes
from mistray.toolkit.tables.frames import row_of
from mistray.toolkit.tables.text import with_error
from mistray.toolkit.typeset import typeset

SHOWN = ("source", "events", "label", "kind", "power_W", "power_se_W", "rms_radius_mm", "rank_power", "rank_rms")
PATHS = 25  # rows of the table, by either rank


def view_data(found: Guess) -> dict[str, Any]:
    """Return powers (W), the worst paths and the map of a state as JSON-serialisable values."""
    stray = found.ways[found.ways.kind != DIRECT].sort_values("power_W", ascending=False)
    if found.ways.source.nunique() > 1:
        stray = stray.assign(label=stray.label + " (" + stray.source + ")")
    stray = stray.assign(rank_power=range(len(stray)), low=bounds(stray)[0])
    stray = stray.sort_values("low", ascending=False, kind="stable").assign(rank_rms=range(len(stray)))
    total = found.stray_W.value
    height, width = found.map_W.shape
    codes = power_codes(found.map_W).ravel()
    planes = (codes >> 8).astype(np.uint8).tobytes() + (codes & 255).astype(np.uint8).tobytes()
    return {
        "stray_W": plain(found.stray_W),
        "direct_W": plain(found.direct_W),
        "ratio": plain(found.ratio),
        "shown": {name: _print(getattr(found, name)) for name in ("stray_W", "direct_W", "ratio")},
        "left_out": list(found.left_out),
        "count": len(stray),
        "listed": PATHS,
        "paths": [
            plain(row_of(row, *SHOWN))
            | {
                "percent": 100 * row.power_W / total if total > 0 else 0.0,
                "power": _print(Estimate(row.power_W, row.power_se_W)),
            }
            for row in stray[(stray.rank_rms < PATHS) | (stray.rank_power < PATHS)].itertuples()
        ],
        "map": {
            "width": width,
            "height": height,
            "extent": list(found.extent),
            "codes": base64.b64encode(planes).decode("ascii"),
        },
    }


def _print(value: Estimate) -> str:
    """Return a value with its standard error as typeset text."""
    return typeset(with_error(value))


def remedy_data(found: Remedy | None) -> dict[str, Any] | None:
    """Return the surface to change first, with its share of the stray light in percent; None if there is none."""
    if found is None:
        return None
    return {"surface": found.surface, "deed": found.deed, "percent": plain(found.percent.value)}

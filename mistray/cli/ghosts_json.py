"""A ghost analysis as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mistray.analysis.ghosts import GhostReport

WORST_SHOWN = 4


def as_json(report: GhostReport, files: Sequence[Path]) -> dict[str, Any]:
    """What `mistray ghosts --json` prints."""
    from mistray.report.tables import summary_frame, warnings

    fields = []
    for row in summary_frame(report).to_dict("records"):
        energy = report[row["field_deg"]].energy
        row["energy"] = {
            "launched_W": energy.launched_W,
            "detected_W": energy.detected_W,
            "detected_se_W": energy.detected_se_W,
            "absorbed_W": {name: {"value": power, "se": se} for name, (power, se) in energy.absorbed.items()},
            "escaped_W": energy.escaped_W,
            "escaped_se_W": energy.escaped_se_W,
            "cut_W": dict(energy.cut),
            "closure": energy.closure,
        }
        row["worst_paths"] = report.top(row["field_deg"], WORST_SHOWN).to_dict("records")
        fields.append(row)
    settings = {key: value for key, value in next(iter(report.values())).settings.items() if key != "field_deg"}
    answer = {
        "settings": settings,
        "fields": fields,
        "warnings": warnings(report),
        "files": [str(file) for file in files],
    }
    return dict(_plain(answer))


def _plain(value: Any) -> Any:
    """The value with what JSON knows: numpy scalars as numbers, NaN and infinity as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

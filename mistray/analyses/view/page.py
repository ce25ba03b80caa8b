"""Output of a 3-D view as JSON values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mistray.files.json_values import plain
from mistray.toolkit.drawings.path_polylines import rows_of
from mistray.toolkit.drawings.ray_choice import RayChoice
from mistray.toolkit.tables.frames import row_of
from mistray.trace import Trace

SHOWN = ("path_id", "label", "kind", "events", "wavelength_nm", "power_W", "power_se_W", "percent")


def record(traced: Sequence[Trace], chosen: RayChoice) -> dict[str, Any]:
    """
    Return the drawn rows of the path table as JSON-serialisable values; powers in W, wavelengths in nm.

    Without a trace the list of paths is empty.
    """
    if not traced:
        return {"paths": []}
    fields = [one.settings["field_deg"] for one in traced]
    rows = [
        {"field_deg": field} | row_of(row, *SHOWN)
        for field, one in zip(fields, traced, strict=True)
        for row in rows_of(chosen, one)
    ]
    single = fields[0] if len(fields) == 1 else fields
    return dict(plain({"field_deg": single, "wavelength_nm": traced[0].wavelengths_nm, "paths": rows}))

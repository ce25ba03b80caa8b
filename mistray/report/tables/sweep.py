"""A sweep as tables, as text and as values for JSON."""

from __future__ import annotations

from typing import Any

from mistray.files.json_values import plain
from mistray.report.model import Table, columns
from mistray.report.tables.text import ABSENT, number, table_text
from mistray.sweeps import Sweep
from mistray.sweeps.result import estimate_of

SHOWN = ("direct_W", "stray_W", "ghost_to_signal", "direct_rms_radius_mm", "worst_rms_irradiance_W_mm2")


def rows_table(result: Sweep) -> Table:
    """A line for each configuration, wavelength and field."""
    heads = columns(
        "<configuration", "field [deg]", "wavelength [nm]", "direct [W]", "stray [W]", "stray/direct",
        "RMS radius [mm]", "<brightest stray path", "its RMS irradiance [W/mm²]",
    )  # fmt: skip
    rows = []
    for row in result.rows:
        *numbers, last = (estimate_of(row, name) for name in SHOWN)
        place = (row["configuration"], f"{row['field_deg']:g}", f"{row['wavelength_nm']:g}")
        rows.append([*place, *numbers, row["worst_path"] or ABSENT, last])
    return Table(heads, rows, "t-rows", filter=("filter rows", "filter rows"))


def sweep_text(result: Sweep) -> str:
    """What `mistray sweep` prints: a line for each configuration, wavelength and field."""
    return f"{table_text(rows_table(result))}\n\n{cache_line(result)}"


def cache_line(result: Sweep) -> str:
    """What the cache has saved."""
    if result.cache_folder is None:
        return f"{len(result)} rows, all traced"
    return f"{len(result)} rows, {result.reused} of them from the cache in {result.cache_folder}"


def values_text(result: Sweep, configuration: str, most: int = 4) -> str:
    """What a configuration sets, in one line; beyond `most` parameters only their number."""
    (one,) = (one for one in result.configurations if one.name == configuration)
    if not one.values:
        return "the scene as it is"
    shown = [
        f"{key} = {', '.join(number(value) for value in numbers)} {one.units.get(key, '').removesuffix('1')}".rstrip()
        for key, numbers in list(one.values.items())[:most]
    ]
    return "; ".join(shown) + (f"; and {len(one.values) - most} more" if len(one.values) > most else "")


def sweep_record(result: Sweep) -> dict[str, Any]:
    """All of a result as values that JSON knows."""
    record = {
        "configurations": [
            {
                "name": one.name,
                "values": [
                    {"key": key, "unit": one.units.get(key), "value": float(value)}
                    for key, numbers in one.values.items()
                    for value in numbers
                ],
            }
            for one in result.configurations
        ],
        "rows": result.rows,
        "settings": result.arguments,
        "cache": None if result.cache_folder is None else str(result.cache_folder),
        "rows_from_cache": result.reused,
        "warnings": list(result.warnings),
    }
    return dict(plain(record))

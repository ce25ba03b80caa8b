"""A sweep as text and as values for JSON."""

from __future__ import annotations

from typing import Any

from mistray.files.json_values import plain
from mistray.report.tables.text import ABSENT, number, text_table, with_error
from mistray.sweeps import Sweep
from mistray.sweeps.result import estimate_of

SHOWN = (
    ("direct_W", "direct", "W"),
    ("stray_W", "stray", "W"),
    ("ghost_to_signal", "stray/direct", ""),
    ("direct_rms_radius_mm", "RMS radius", "mm"),
    ("worst_rms_irradiance_W_mm2", "its RMS irradiance", "W/mm²"),
)
"""Numbers of a row that are shown: column, header, unit."""


def sweep_text(result: Sweep) -> str:
    """What `mistray sweep` prints: a line for each configuration, wavelength and field."""
    columns = [("configuration", ""), ("field", "deg"), ("wavelength", "nm")]
    columns += [(head, unit) for _, head, unit in SHOWN]
    columns.insert(-1, ("brightest stray path", ""))
    lines = []
    for row in result.rows:
        cells = [row["configuration"], f"{row['field_deg']:g}", f"{row['wavelength_nm']:g}"]
        cells += [with_error(estimate_of(row, name)) for name, _, _ in SHOWN]
        cells.insert(-1, row["worst_path"] or ABSENT)
        lines.append(cells)
    return f"{text_table(columns, lines, left=(0, len(columns) - 2))}\n\n{cache_line(result)}"


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

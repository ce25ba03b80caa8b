"""Units of table columns, from the ends of their names."""

from __future__ import annotations

UNITS = (
    ("W_mm2_sr", "W/(mm² sr)"), ("W_sr", "W/sr"), ("W_mm2", "W/mm²"), ("1_sr", "1/sr"),
    ("percent_of_first_level", "% of first-level scatter"),
    ("percent_of_stray", "% of stray light"), ("percent_of_all", "% of all light"), ("per_deg", "decades/°"),
    ("percent", "%"), ("mm2", "mm²"), ("mm", "mm"), ("deg", "°"), ("nm", "nm"), ("lm", "lm"), ("W", "W"), ("K", "K"),
)  # fmt: skip
"""Ends of the names of columns and the units that they stand for; the first that fits is taken."""


def unit_of(column: str) -> tuple[str, str]:
    """Return the name of a column without the unit at its end, and that unit; "" if the name ends in none."""
    for end, unit in UNITS:
        if column == end or column.endswith(f"_{end}"):
            return column[: -len(end)].rstrip("_"), unit
    return column, ""

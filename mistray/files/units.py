"""Units of table columns, from the ends of their names."""

from __future__ import annotations

import re

UNITS = (
    ("W_mm2_sr", "W/(mm² sr)"), ("per_kelvin_W_mm2", "W/(mm² K)"), ("W_sr", "W/sr"), ("W_mm2", "W/mm²"),
    ("1_sr", "1/sr"), ("mm2_s", "1/(s mm²)"), ("per_mm2", "1/mm²"), ("per_mm", "1/mm"), ("per_um4", "1/µm⁴"),
    ("percent_of_first_level", "% of first-level scatter"),
    ("percent_of_stray", "% of stray light"), ("percent_of_all", "% of all light"), ("per_deg", "decades/°"),
    ("percent", "%"), ("mm2", "mm²"), ("mm", "mm"), ("um4", "µm⁴"), ("um", "µm"), ("nm", "nm"), ("deg", "°"),
    ("rad", "rad"), ("hz", "Hz"), ("lm", "lm"), ("W", "W"), ("K", "K"),
)  # fmt: skip
"""Ends of the names of columns and the units that they stand for; the first that fits is taken."""
_AT_FREQUENCY = re.compile(r".*_\d[\d.e+-]*_per_mm")  # a pure number at a frequency: mtf_tangential_50_per_mm


def unit_of(column: str) -> tuple[str, str]:
    """Return the name of a column without the unit at its end, and that unit; "" if the name ends in none."""
    if _AT_FREQUENCY.fullmatch(column):
        return column, ""
    for end, unit in UNITS:
        if column == end or column.endswith(f"_{end}"):
            return column[: -len(end)].rstrip("_"), unit
    return column, ""

"""Tables of a study made from the names of their columns."""

from __future__ import annotations

import math
import re

import pandas as pd

from mistray.analyses.study.page import fact_text
from mistray.analyses.study.step import Fact
from mistray.analysis.estimate import Estimate
from mistray.report.html.render import html_parts
from mistray.report.tables.frames import error_of, frame_table, heading_of, value_text


def test_headings_and_errors_are_made_of_names():
    for column, heading in {
        "z_mm": ("z", "mm"),
        "slope_before_per_deg": ("slope before", "decades/°"),
        "id": ("surface", ""),
    }.items():
        assert heading_of(column) == heading
    columns = ["pst", "pst_se", "power_W", "power_se_W", "flux_W", "flux_W_se", "rays"]
    errors = ["pst_se", "power_se_W", "flux_W_se", None]
    assert [error_of(column, columns) for column in ("pst", "power_W", "flux_W", "rays")] == errors
    for value, text in (
        (3, "3"), (12345.0, "12 345"), (0.123456789, "0.12346"), (-math.inf, "-∞"), (math.nan, "–"), (None, "–"),
        (Estimate(0.2, 0.01), "0.200 ± 0.010"),
    ):  # fmt: skip
        assert value_text(value) == text
    assert fact_text(Fact("half field", 18.0, "°")) == "18°"
    assert fact_text(Fact("focal length", 7.0734, "mm")) == "7.0734 mm"
    assert fact_text(Fact("defocus", math.nan, "mm")) == "–"


def test_a_table_hides_its_errors_below_the_values():
    frame = pd.DataFrame(
        {
            "id": ["<L1>", "wall"],
            "space": [2, -1],
            "power_W": [0.5, math.nan],
            "power_se_W": [0.01, math.nan],
            "low": [True, False],
        }
    )
    html = html_parts([frame_table("t", frame)])
    cells = re.findall(r"<td[^>]*>(.*?)</td>", html)
    assert len(cells) == 2 * 4
    assert cells[0] == "&lt;L1&gt;"
    assert cells[2] == "0.500<small>± 0.010</small>"
    assert cells[3] == "yes"
    assert cells[5] == cells[6] == "–"
    assert "power_se" not in html

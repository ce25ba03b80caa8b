"""Tables, picture and page of critical, illuminated and common objects."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import html_pages
import numpy as np
import pandas as pd
import pytest

import mistray
from mistray.analysis.objects.search import objects
from mistray.report import objects_output as output
from mistray.report.figures.objects import STYLES, groups, objects_layout
from mistray.report.tables.text import table_text


@pytest.fixture(scope="module")
def found() -> Any:
    return objects(mistray.load("phone_camera_scatter"), rays=20_000, field_deg=[0.0, 30.0])


@pytest.fixture(scope="module")
def estimates(found: Any) -> pd.DataFrame:
    return found.estimates()


def test_text_holds_the_lists(found: Any, estimates: pd.DataFrame) -> None:
    text = output.objects_text(found, estimates, 5)
    for part in ("barrel_6_cone", f"… and {len(found.critical) - 5} more", "aperture stop: stop"):
        assert part in text
    # Rows left out are added up
    lines = table_text(output.object_table(found.critical, 3)).splitlines()
    assert lines[-1].split()[0] == str(sum(row.rays for row in found.critical[3:]))
    assert table_text(output.object_table([])) == table_text(output.common_table([])) == "none"
    text = table_text(output.estimate_table(estimates, 2))
    assert text.count("… and") == 2
    np.testing.assert_allclose(estimates.groupby("angle_deg").percent.sum(), 100, rtol=1e-12)
    assert "no common object scatters" in table_text(output.estimate_table(estimates.assign(pst=0.0)))
    of_shape = groups(found)
    assert set(of_shape.values()) <= set(STYLES)
    assert of_shape["L1_front"] == "optics"
    assert of_shape["barrel_7_plane"] == "apart"  # its back is seen, its front is lit
    assert of_shape["barrel_3_cone"] == "common"
    assert of_shape["barrel_0_front_face"] == "illuminated"
    assert of_shape["L4_edge"] in ("critical", "common")
    (axes,) = objects_layout(found, "camera").axes
    shown = {text.get_text().strip() for text in axes.texts}
    assert shown <= {row.id for row in found.common}
    assert len(shown) >= min(10, len(found.common))


def test_files(found: Any, estimates: pd.DataFrame, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    output.write_objects(found, estimates, out, "a <camera>", "mistray objects x")
    assert list(pd.read_csv(out / "objects_critical.csv").id) == [row.id for row in found.critical]
    tables = output.csv_tables(found, estimates)
    assert len(tables["objects_optics.csv"]) == 15
    assert set(tables) == {file.name for file in out.glob("*.csv")}
    record = json.loads(json.dumps(output.objects_record(found, estimates), allow_nan=False))
    assert (record["stop"], record["angles_deg"]) == ("stop", [0.0, 30.0])
    assert record["critical"][0]["id"] == found.critical[0].id
    html = (out / "objects.html").read_text(encoding="utf-8")
    html_pages.check(html)
    assert "a &lt;camera&gt;" in html
    assert "<camera>" not in html

"""Tables, picture, files and HTML of critical, illuminated and common objects."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

import mistray
from mistray.analysis.objects.search import objects
from mistray.errors import MistrayError
from mistray.report.figures.objects import STYLES, groups, objects_layout
from mistray.report.objects_output import (
    common_table,
    csv_tables,
    estimate_table,
    object_table,
    objects_record,
    objects_text,
    write_objects,
)
from mistray.report.tables.text import table_text


@pytest.fixture(scope="module")
def found():
    return objects(mistray.load("phone_camera_scatter"), rays=20_000, field_deg=[0.0, 30.0])


@pytest.fixture(scope="module")
def estimates(found):
    return found.estimates()


def test_text_holds_the_lists(found, estimates):
    text = objects_text(found, estimates, 5)
    for part in ("Critical objects", "Illuminated objects", "Common objects", "barrel_6_cone", "± ", "Φ · BSDF"):
        assert part in text
    assert f"… and {len(found.critical) - 5} more" in text
    assert "warning: the detector sees the outside past L3_rear through L3_bevel_2" in text
    assert "a distant source at 0, 30° each" in text
    assert "aperture stop: stop" in text


def test_rows_left_out_are_added_up(found):
    lines = table_text(object_table(found.critical, 3)).splitlines()
    assert lines[-1].split()[0] == str(sum(row.rays for row in found.critical[3:]))
    assert table_text(object_table([])) == table_text(common_table([])) == "none"


def test_estimates_of_each_angle(found, estimates):
    text = table_text(estimate_table(estimates, 2))
    assert text.count("… and") == 2
    assert "(optic)" in text
    shares = estimates.groupby("angle_deg").percent.sum()
    np.testing.assert_allclose(shares, 100, rtol=1e-12)
    assert "no common object scatters" in table_text(estimate_table(estimates.assign(pst=0.0)))


def test_csv(found, estimates):
    tables = csv_tables(found, estimates)
    assert len(tables["objects_critical.csv"]) == len(found.critical)
    assert list(tables["objects_common.csv"].columns)[:4] == ["id", "part", "side", "space"]
    assert len(tables["objects_optics.csv"]) == 15
    assert list(tables["objects_straight_shots.csv"].columns)[:2] == ["way", "surfaces"]


def test_record_is_json(found, estimates):
    record = json.loads(json.dumps(objects_record(found, estimates), allow_nan=False))
    assert record["stop"] == "stop"
    assert record["angles_deg"] == [0.0, 30.0]
    assert record["critical"][0]["id"] == found.critical[0].id
    assert record["facts"]["detector"] == "detector"


def test_groups_of_the_picture(found):
    of_shape = groups(found)
    assert set(of_shape.values()) <= set(STYLES)
    assert of_shape["L1_front"] == "optics"
    assert of_shape["barrel_7_plane"] == "apart"  # its back is seen, its front is lit
    assert of_shape["barrel_3_cone"] == "common"
    assert of_shape["barrel_0_front_face"] == "illuminated"
    assert of_shape["L4_edge"] in ("critical", "common")


def test_picture_has_all_names(found):
    figure = objects_layout(found, "camera")
    (axes,) = figure.axes
    shown = {text.get_text().strip() for text in axes.texts}
    assert shown <= {row.id for row in found.common}
    assert len(shown) >= min(10, len(found.common))
    assert "camera" in axes.get_title()
    figure.canvas.draw()


class Tags(HTMLParser):
    """Collects what a page loads and its ids; a tag that is not closed is an error of the test."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values[key] for key in ("src", "href") if key in values]
        if tag not in ("meta", "img", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_files(found, estimates, tmp_path):
    files = write_objects(found, estimates, tmp_path / "new" / "out", "a <camera>", "mistray objects x")
    names = {path.name for path in files}
    assert {"objects.html", "objects.png", "objects.json", "objects_common.csv", "objects_estimates.csv"} <= names
    assert all(path.stat().st_size for path in files)
    back = pd.read_csv(tmp_path / "new" / "out" / "objects_critical.csv")
    assert list(back.id) == [row.id for row in found.critical]
    html = (tmp_path / "new" / "out" / "objects.html").read_text(encoding="utf-8")
    page = Tags()
    page.feed(html)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    assert not [link for link in page.links if not link.startswith(("#", "data:"))]
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert "a &lt;camera&gt;" in html
    assert "<camera>" not in html
    assert re.search(r"<b>barrel_3_cone</b>|<b>window_front</b>|<b>L\d_\w+</b>", html)


def test_a_file_in_the_way(found, estimates, tmp_path):
    (tmp_path / "out").write_text("x")
    with pytest.raises(MistrayError, match="is a file"):
        write_objects(found, estimates, tmp_path / "out")

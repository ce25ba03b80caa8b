"""Step 8 of a study has images of points with their stray light, or says why there are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from oracles.rough_paraboloid import paraboloid_text
from oracles.scatter_scenes import bsdf_xml

import mistray
from mistray.analysis.study.transfer import transfer_findings

pytestmark = pytest.mark.long

HALO = bsdf_xml("abg", A=1e-3, B=1e-6, g=2.0, event="reflection")


@pytest.fixture(scope="module")
def found(load_scene):
    scene = load_scene(paraboloid_text(HALO, detector=5.0))
    # At 4° the direct image misses the detector
    return mistray.study(scene, (0, 20), (0, 0.5, 4), rays=20_000, quick=True, name="rough mirror", next_order=False)


def test_the_report_shows_them(found, tmp_path: Path):
    files = found.write(tmp_path)
    assert {"8_books.csv", "8_transfer_functions.csv", "8_image_rings.csv"} <= {file.name for file in files}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("Image of a point with stray light, field") == 2


def test_tables_facts_and_findings(found):
    assert [one.image.field_deg for one in found.images] == [0, 0.5]  # whose image meets the detector
    step = found["analysis"]
    numbers = step.tables["image_with_stray_light"]
    assert list(numbers.field_deg) == [0, 0.5]
    books = step.tables["books"].drop(columns="field_deg")
    shares = books[[name for name in books if not name.endswith("_se")]].sum(axis=1)
    np.testing.assert_allclose(shares, 1, atol=1e-6)
    assert len(step.tables["transfer_functions"]) == 2 * len(found.images[0].frequencies_per_mm)
    assert len(step.tables["image_rings"]) > 100
    assert step.fact("veiling floor at 0°") == found.images[0].veiling_floor
    (text,) = transfer_findings(found.images)
    assert text in step.findings
    lost = 100 * (1 - min(one.veiling_floor.value for one in found.images))
    assert f"{lost:.3g} %" in text


def test_a_scene_without_an_image_says_so():
    step = mistray.study(mistray.load("plate_and_wall"), (0, 40), (0,), rays=500, next_order=False)["analysis"]
    assert "There are no images of points" in step.text
    assert "books" not in step.tables
    assert step.result["images"] is None

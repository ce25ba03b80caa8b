"""Results as text and as files, by the functions that a notebook calls; the commands write the same."""

import json
import re
from pathlib import Path

import pytest

import mistray
from mistray import materials, report


@pytest.mark.core
def test_image_quality(tmp_path: Path) -> None:
    found = mistray.image_quality(mistray.load("double_gauss"), field_deg=[0.0])
    assert re.search(r"\bfield\b", report.quality_text(found, [20.0]))
    files = report.write_quality(found, tmp_path / "out", frequencies=[20.0])
    assert {"report.html", "image_quality.json"} <= {path.name for path in files}
    assert all(path.stat().st_size for path in files)
    record = json.loads((tmp_path / "out/image_quality.json").read_text())
    assert len(record["fields"]) == 1


@pytest.mark.core
def test_ghosts_and_study(tmp_path: Path) -> None:
    scene = mistray.load("plate_and_wall")
    files = report.write_png(mistray.ghosts(scene, field_deg=[0.0], rays=500), tmp_path)
    assert files
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in files)
    text = report.study_text(mistray.study(scene, field_deg=[0.0], rays=200))
    assert text.count("\n") > 3
    assert "plate" in text


@pytest.mark.core
def test_first_level() -> None:
    limits = {"ghosts off": {"max_reflections": 0}, "all": {"max_reflections": 2}}
    found = mistray.first_level(mistray.load("lens_and_window"), [0.0], limits=limits, rays=1000)
    ghosts = {name: curve.curve("ghost")[0].sum() for name, curve in found.curves.items()}
    assert ghosts["ghosts off"] == 0 < ghosts["all"]


def test_tables_of_materials() -> None:
    assert materials.table_nodes_nm("nd=1.5 Vd=60") == ()
    nodes = materials.table_nodes_nm("Ag")
    assert nodes == tuple(sorted(nodes))
    assert len(nodes) > 10

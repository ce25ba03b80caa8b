"""Files, tables and pictures of an optimisation."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.errors import MistrayError
from mistray.optimize import Optimization, optimize_coatings
from mistray.report.optimization import (
    comparison_table,
    convergence_figure,
    design_table,
    reflectance_figure,
    report_text,
    write_optimization,
)

STUDY = {
    "metric": {"wavelength_nm": [500, 600], "fields_deg": [0, 2], "rays": 32},
    "coating": [
        {"name": "front", "surfaces": ["p0_front"], "layers": "1.38 60, 2.0 30", "thickness_nm": [20, 180]},
        {"name": "rear", "surfaces": ["p0_rear"], "layers": "1.38 60", "thickness_nm": [20, 90]},
    ],
    "optimizer": {"starts": 2, "steps": 6},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Optimization:
    return optimize_coatings(write(tmp_path_factory.mktemp("plate"), plates_text(1)), STUDY)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_files(result: Optimization, tmp_path: Path) -> None:
    files = write_optimization(result, tmp_path / "new" / "out")
    assert [file.name for file in files] == [
        "scene.xml",
        "table.csv",
        "history.csv",
        "convergence.png",
        "reflectance.png",
        "report.html",
    ]
    assert sorted(file.name for file in (tmp_path / "new" / "out").iterdir()) == sorted(file.name for file in files)
    for file in files[3:5]:
        assert file.read_bytes().startswith(b"\x89PNG")
    scene = mistray.load(files[0])
    for shape in scene.shapes():
        if shape.id().startswith("p0"):
            name = shape.id().removeprefix("p0_")
            layers = shape.bsdf().coating.layers
            assert [layer.thickness_nm for layer in layers] == pytest.approx(result.best.thickness_nm[name], rel=1e-6)
    rows = read(files[1])
    assert len(rows) == len(result.comparison.rows) == 1 + 2 + 2 + 4
    assert (rows[0]["field_deg"], rows[0]["wavelength_nm"]) == ("all", "all")
    assert float(rows[0]["after"]) == result.comparison.total.after
    assert (rows[-1]["field_deg"], rows[-1]["wavelength_nm"]) == ("2.0", "600.0")
    history = read(files[2])
    assert len(history) == len(result.steps)
    assert float(history[0]["rear_1_nm"]) == 60.0
    assert float(history[0]["front_2_nm"]) == 30.0
    assert write_optimization(result, tmp_path / "new" / "out") == files, "files are replaced"


def test_html(result: Optimization, tmp_path: Path) -> None:
    """Complete in itself, with every row of the comparison, every layer and the command."""
    html = write_optimization(result, tmp_path, "mistray optimize <x>")[-1].read_text(encoding="utf-8")
    assert "http" not in html
    assert html.count("data:image/png;base64,") == 2
    assert "mistray optimize &lt;x&gt;" in html
    table = html[html.index("t-comparison") : html.index("t-designs")]
    assert table.count("<tr>") == 1 + len(result.comparison.rows)
    assert f"{result.best.thickness_nm['front'][0]:.2f}" in html
    assert "times smaller" in html


def test_a_file_in_the_way(result: Optimization, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(MistrayError, match="is a file; name a directory"):
        write_optimization(result, tmp_path / "out")


def test_text(result: Optimization) -> None:
    text = report_text(result)
    assert "path_power of the paths 'ghost', 8 seeds not used in the search" in text
    assert comparison_table(result.comparison, "W/W") in text
    assert design_table(result) in text
    assert "coating 'front' on p0_front; first layer outside" in text
    assert "branches below flux_threshold" in text
    lines = comparison_table(result.comparison).splitlines()
    assert [line.split("  ")[0].strip() for line in lines[3:]] == ["all", "field 0°", "field 2°", "500 nm", "600 nm"]
    *_, front, _, rear, note = design_table(result).splitlines()
    assert rear.endswith("90.00*"), "the quarter wave lies beyond"
    assert "*" not in front
    assert note == "* at its bound"


def test_convergence(result: Optimization) -> None:
    left, right = convergence_figure(result).axes
    curves = [container.lines[0].get_ydata() for container in left.containers]
    assert sum(len(curve) for curve in curves) == len(result.steps)
    assert min(np.min(curve) for curve in curves) == result.best_step.value
    assert len(right.lines) == len(result.designs) == 2


def test_reflectance(result: Optimization) -> None:
    """Before and after at two angles, and the values are those of Airy's formula at normal incidence."""
    front, rear = reflectance_figure(result).axes
    assert front.get_title() == "front, air | 1.5"
    assert len(rear.lines) == 4
    x, before = rear.lines[0].get_data()
    r1, r2 = (1 - 1.38) / (1 + 1.38), (1.38 - 1.5) / (1.38 + 1.5)
    phase = np.exp(4j * np.pi * 1.38 * 60.0 / x)
    assert before == pytest.approx(100 * abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2, rel=1e-9)
    assert x[0] < 500 < 600 < x[-1]


def test_materials_end_with_the_band(tmp_path: Path) -> None:
    """Curves are drawn a little beyond the band where the materials are known there."""
    (tmp_path / "film.csv").write_text("wavelength_nm,n,k\n500,1.38,0\n600,1.38,0\n")
    study = {**STUDY, "coating": [{**STUDY["coating"][1], "layers": f"{tmp_path / 'film.csv'} 60"}]}
    study["optimizer"] = {"starts": 1, "steps": 0}
    (axes,) = reflectance_figure(optimize_coatings(write(tmp_path, plates_text(1)), study)).axes
    assert (axes.lines[0].get_xdata()[0], axes.lines[0].get_xdata()[-1]) == (500.0, 600.0)

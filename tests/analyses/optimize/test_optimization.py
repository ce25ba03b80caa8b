"""Files, tables and pictures of an optimisation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import html_pages
import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.analyses.optimize.figures import reflectance_figure, search_figure, variables_figure
from mistray.analyses.optimize.page import scene_text, write_optimization
from mistray.analyses.optimize.tables import (
    comparison_table,
    goal_text,
    optimization_record,
    report_text,
    terms_table,
    variables_table,
)
from mistray.optimize import Optimization, Term, measure, optimize

STUDY: dict[str, Any] = {
    "trace": {"wavelength_nm": [500, 600], "field_deg": [0, 2], "rays": 32},
    "term": [
        {"name": "ghosts", "kind": "path_power", "goal": "minimise"},
        {"name": "price", "kind": "total_thickness", "goal": "at_most", "limit_of_start": 1.5},
    ],
    "coating": [
        {"name": "front", "surfaces": ["p0_front"], "layers": "1.38 60, 2.0 30", "thickness_nm": [20, 180]},
        {"name": "rear", "surfaces": ["p0_rear"], "layers": "1.38 60", "thickness_nm": [20, 70]},
    ],
    "variable": [{"name": "n", "parameters": ["front.n_shift[0]", "rear.n_shift"], "low": -0.01, "high": 0.03}],
    "optimizer": {"starts": 2, "steps": 6},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Optimization:
    return optimize(write(tmp_path_factory.mktemp("plate"), plates_text(1)), STUDY, verification_seeds=2)


@pytest.fixture(scope="module")
def out(result: Optimization, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("optimised") / "new" / "out"
    write_optimization(result, folder, "mistray optimize <x>")
    return folder


@pytest.mark.long
def test_tables(result: Optimization, out: Path) -> None:
    rows = pd.read_csv(out / "terms.csv")
    assert len(rows) == len(result.comparison.rows) == 1 + 2 + 2 + 4 + 1
    assert rows.iloc[0][["field_deg", "wavelength_nm"]].isna().all()
    assert rows.after[0] == pytest.approx(result.comparison.total.after, rel=1e-8)
    assert list(rows.iloc[8][["field_deg", "wavelength_nm"]]) == [2, 600]
    moved = pd.read_csv(out / "variables.csv").set_index("parameter")
    layers = [f"front.thickness_nm[{k}]" for k in (0, 1)] + ["rear.thickness_nm[0]"]
    assert set(moved.index) == {*layers, "front.n_shift[0]", "rear.n_shift[0]"}
    assert moved.after["rear.n_shift[0]"] == pytest.approx(result.after["n"], rel=1e-8)
    history = pd.read_csv(out / "history.csv")
    assert len(history) == len(result.steps)
    assert list(history.iloc[0][["rear.thickness_nm[0]", "price"]]) == pytest.approx([60, 150])


def test_the_scene(result: Optimization, out: Path) -> None:
    scene = mistray.load(out / "scene.xml")
    params = mi.traverse(scene)
    for name in ("front", "rear"):
        assert np.array(params[f"{name}.thickness_nm"]) == pytest.approx(result.thickness_nm(name), rel=1e-6)
    assert np.array(params["front.n_shift"]) == pytest.approx([result.after["n"], 0.0], rel=1e-6)
    assert np.array(params["rear.n_shift"]) == pytest.approx([result.after["n"]], rel=1e-6)
    row = result.comparison.total
    assert measure(scene, result.study).of("ghosts").mean() == pytest.approx(row.after, rel=1e-5)
    assert row.ratio > 1.1, "the design has changed"


def test_a_scene_that_names_files(tmp_path: Path) -> None:
    """Files are found from the folder of the result, with coatings and other values changed in one go."""
    (tmp_path / "glass.csv").write_text("wavelength_nm,n,k\n400,1.5,0\n700,1.5,0\n")
    scene = write(tmp_path, plates_text(1).replace('"1.5"', '"glass.csv"'))
    assert "glass.csv" in scene.read_text()
    result = optimize(scene, {**STUDY, "optimizer": {"starts": 1, "steps": 1}}, verification_seeds=2)
    folder = tmp_path / "deep" / "out"
    folder.mkdir(parents=True)
    text = scene_text(result, folder)
    assert not list(folder.iterdir())
    (file := folder / "scene.xml").write_text(text)
    assert np.array(mi.traverse(mistray.load(file))["rear.n_shift"]) == pytest.approx([result.after["n"]], rel=1e-6)
    # Curves are drawn a little beyond the band where the materials are known there
    (tmp_path / "film.csv").write_text("wavelength_nm,n,k\n500,1.38,0\n600,1.38,0\n")
    study = {**STUDY, "coating": [{**STUDY["coating"][1], "layers": f"{tmp_path / 'film.csv'} 60"}], "variable": []}
    study["optimizer"] = {"starts": 1, "steps": 0}
    result = optimize(write(tmp_path, plates_text(1)), study, verification_seeds=2)
    (axes,) = reflectance_figure(result).axes
    assert (axes.lines[0].get_xdata()[0], axes.lines[0].get_xdata()[-1]) == (500.0, 600.0)


def test_without_coatings(tmp_path: Path) -> None:
    scene = write(tmp_path, plates_text(1, R=0.05, T=0.9))
    study = {
        "term": [{"kind": "path_power", "goal": "minimise", "rays": 32}],
        "variable": [{"parameters": "p0_*.bsdf.R", "low": 0.01, "high": 0.1}],
        "optimizer": {"steps": 2},
    }
    result = optimize(scene, study, verification_seeds=2)
    files = write_optimization(result, tmp_path / "out")
    assert "reflectance.png" not in [file.name for file in files]
    params = mi.traverse(mistray.load(files[0]))
    for key in ("p0_front.bsdf.R", "p0_rear.bsdf.R"):
        assert float(params[key][0]) == pytest.approx(result.after["p0_front.bsdf.R"], rel=1e-6)
    assert "Coatings" not in files[-1].read_text(encoding="utf-8")


def test_text_and_record(result: Optimization, out: Path) -> None:
    text = report_text(result)
    tables = terms_table(result), comparison_table(result.comparison), variables_table(result)
    assert all(table in text for table in tables)
    assert tables[0].split()[-3:] == ["≤", "225", "yes"]
    (row,) = (line for line in tables[2].splitlines() if line.startswith("rear.thickness_nm[0]"))
    assert "70* " in row, "the quarter wave lies beyond"
    record = json.loads(json.dumps(optimization_record(result), allow_nan=False))
    assert record["holds"] == {"ghosts": True, "price": True}
    assert {row["name"]: row["after"] for row in record["variables"]} == pytest.approx(result.after)
    assert record["terms"][0]["ratio"] == pytest.approx(result.comparison.total.ratio)
    html = (out / "report.html").read_text(encoding="utf-8")
    html_pages.check(html)
    assert "mistray optimize &lt;x&gt;" in html
    assert html_pages.table_of(html, "t-terms").count("<tr>") == 1 + len(result.comparison.rows)
    assert html_pages.table_of(html, "t-variables").count("<tr>") == 1 + 4


def test_goals() -> None:
    assert goal_text(Term("t", "path_power"), 3.0) == "minimise"
    assert goal_text(Term("t", "path_power", "at_least", limit=2.0), 3.0) == "≥ 2"
    assert goal_text(Term("t", "path_power", "keep", tolerance=0.02), 3.0) == "keep ± 2 %"


def test_pictures_of_the_search(result: Optimization) -> None:
    left, middle, right = search_figure(result).axes
    curves = [container.lines[0].get_ydata() for container in left.containers]
    assert sum(len(curve) for curve in curves) == len(result.steps)
    assert min(np.min(curve) for curve in curves) == result.best.merit
    assert len(right.lines) == len(result.starts) == 2
    ghosts, price = (line.get_ydata() for line in middle.lines)
    own = [step for step in result.steps if step.start == result.best.start]
    first = result.steps[0].terms
    assert ghosts == pytest.approx([step.terms["ghosts"] / first["ghosts"] for step in own])
    assert price == pytest.approx([step.terms["price"] / first["price"] for step in own])
    (axes,) = variables_figure(result).axes
    assert len(axes.lines) == 4
    assert axes.lines[2].get_ydata() == pytest.approx((np.array([step.x[2] for step in own]) - 20) / 50)
    # Reflectance before and after at two angles; the values are those of Airy's formula at normal incidence
    front, rear = reflectance_figure(result).axes
    assert front.get_title() == "front, air | 1.5"
    assert len(rear.lines) == 4
    x = rear.lines[0].get_xdata()
    moved = 1.38 + result.after["n"], result.thickness_nm("rear")[0]
    for line, (n, thickness), error in ((rear.lines[0], (1.38, 60.0), 1e-9), (rear.lines[2], moved, 1e-6)):
        r1, r2 = (1 - n) / (1 + n), (n - 1.5) / (n + 1.5)
        phase = np.exp(4j * np.pi * n * thickness / x)
        expected = 100 * abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2
        assert line.get_ydata() == pytest.approx(expected, rel=error)
    assert x[0] < 500 < 600 < x[-1]

"""Optimisations: closed-form optima, bounds, starts, methods, checkpoints, files and tables, and other seeds."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import html_pages
import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
import vectors
from oracles.small_scenes import plates_text, write
from refusals import each_refused

import mistray
from mistray.analyses.optimize import tables
from mistray.analyses.optimize.figures import reflectance_figure, search_figure, variables_figure
from mistray.analyses.optimize.page import scene_text, write_optimization
from mistray.analyses.optimize.study.comparison import ComparisonCell, Levels
from mistray.coatings import preset
from mistray.errors import MistrayError
from mistray.optimize import DesignStudy, Optimization, Step, Term, compare, measure, optimize, path_power, read_study
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

QUARTER_WAVE = 550 / 4 / 1.38
optimized = partial(optimize, verification_seeds=2)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A plate of n = 1.5 in normal incidence: the ghost is R² T² of the launched power."""
    return write(tmp_path, plates_text(1))


def study(start: float = 60.0, bounds: Any = (20.0, 180.0), band: Any = 550.0, **optimizer: Any) -> dict[str, Any]:
    """One layer of n = 1.38 on both faces of the plate."""
    return {
        "term": [{"name": "ghosts", "kind": "path_power", "goal": "minimise", "wavelength_nm": band, "rays": 32}],
        "coating": [{"name": "AR", "surfaces": "all", "layers": f"1.38 {start}", "thickness_nm": list(bounds)}],
        "optimizer": {"starts": 1, "tolerance": 1e-4, "patience": 1, **optimizer},
    }


def reflectance(d: float, nm: Any = 550.0, n: float = 1.38) -> Any:
    """Airy's formula for one layer at normal incidence, thickness and wavelength in nm."""
    r1, r2 = (1 - n) / (1 + n), (n - 1.5) / (n + 1.5)
    phase = np.exp(4j * np.pi * n * d / nm)
    return abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2


class TestSearch:
    def test_quarter_wave(self, plate: Path, tmp_path: Path) -> None:
        """Near it the metric is flat: a relative excess of 1e-4, the tolerance, is 0.4 nm."""
        file = tmp_path / "new" / "checkpoint.json"
        result = optimized(plate, study(), checkpoint=file)
        assert result.ended[0].startswith("converged")
        assert result.thickness_nm("AR") == pytest.approx([QUARTER_WAVE], abs=0.5)
        assert result.before == {"AR.thickness_nm[0]": 60.0}
        assert result.after == {"AR.thickness_nm[0]": result.thickness_nm("AR")[0]}
        row = result.comparison.of("ghosts")
        r0, r1 = reflectance(60.0), reflectance(QUARTER_WAVE)
        assert row.before == pytest.approx((r0 * (1 - r0)) ** 2, rel=1e-5)
        assert row.after == pytest.approx((r1 * (1 - r1)) ** 2, rel=2e-4)
        assert row.ratio == pytest.approx(row.before / row.after)
        assert result.best.merit == pytest.approx(np.log(row.after / row.before), abs=1e-5)
        scene = mistray.load(write_recoated(plate, result.coatings, tmp_path / "result.xml"))
        assert measure(scene, result.study).of("ghosts").mean() == pytest.approx(row.after, rel=1e-6)
        again = optimized(plate, study(), checkpoint=file, resume=True)
        assert (again.steps, again.ended) == (result.steps, result.ended), "a search that has converged is over"

    @pytest.mark.parametrize(("method", "patience"), [("adam", 5), ("nlopt", 10)])
    def test_other_methods(self, plate: Path, method: str, patience: int) -> None:
        if method == "nlopt":
            pytest.importorskip("nlopt")
        result = optimized(plate, study(step_size=0.05, method=method, patience=patience, steps=40))
        assert result.thickness_nm("AR") == pytest.approx([QUARTER_WAVE], abs=2.0)
        ratio = (reflectance(60.0) / reflectance(QUARTER_WAVE)) ** 2
        assert result.comparison.total.ratio == pytest.approx(ratio, rel=0.05)

    def test_limits_and_variables_beside_coatings(self, plate: Path) -> None:
        """A bound; and the least ghost of at most 80 nm: the penalty begins 1 % below the limit and costs 1 at it."""
        bound = optimized(plate, study(bounds=(20.0, 80.0)))
        assert bound.thickness_nm("AR") == pytest.approx([80.0])
        assert bound.best.gradient_norm == 0, "the layer is not free to move on"
        given = study()
        given["term"].append({"name": "price", "kind": "total_thickness", "goal": "at_most", "limit": 80})
        result = optimized(plate, given)
        (thickness,), price = result.thickness_nm("AR"), result.comparison.of("price")
        assert 79.2 < thickness <= 80.0
        assert result.steps[-1].broken == ()
        assert (price.after, price.after_se) == (pytest.approx(thickness), 0)
        # The index of the layer moves with its thickness: towards the root of 1.5, and the quarter wave follows
        given = study()
        given["variable"] = [{"name": "n", "parameters": "AR.n_shift", "low": -0.1, "high": 0.1}]
        result = optimized(plate, given)
        assert result.after["n"] == pytest.approx(-0.1)
        assert result.after["AR.thickness_nm[0]"] == pytest.approx(550 / 4 / (1.38 + result.after["n"]), abs=0.7)
        assert result.parameters == {"AR.n_shift": pytest.approx(np.array([-0.1]))}, "thicknesses go with the coating"

    def test_ideal_coatings_without_thin_films(self, tmp_path: Path) -> None:
        """The ghost of a plate, R² T², is least where R is; a limit on R by the transmission T² is not touched."""
        given = {
            "trace": {"wavelength_nm": 550, "rays": 32},
            "term": [
                {"kind": "path_power", "goal": "minimise"},
                {"kind": "transmission", "goal": "at_least", "limit_of_start": 0.95},
            ],
            "variable": [{"name": "R", "parameters": "p0_*.bsdf.R", "low": 1e-3, "high": 0.1, "scale": "log"}],
        }
        result = optimized(write(tmp_path, plates_text(1, R=0.05, T=0.9)), given)
        assert result.after == {"R": pytest.approx(1e-3)}
        assert set(result.parameters) == {"p0_front.bsdf.R", "p0_rear.bsdf.R"}
        assert result.comparison.of("path_power").ratio == pytest.approx(2500, rel=1e-4)
        files = write_optimization(result, tmp_path / "out")
        assert "reflectance.png" not in [file.name for file in files]
        params = mi.traverse(mistray.load(files[0]))
        assert [float(params[key][0]) for key in result.parameters] == pytest.approx([1e-3, 1e-3], rel=1e-6)
        assert "Coatings" not in files[-1].read_text(encoding="utf-8")

    def test_several_starts_shared_and_separate_designs(self, plate: Path) -> None:
        """Three quarter waves are a minimum too, a worse one over a band: from there only other starts lead away."""
        band = [450, 550, 650]
        alone, several = (optimized(plate, study(280.0, (20.0, 400.0), band, starts=starts)) for starts in (1, 3))
        assert alone.thickness_nm("AR")[0] > 250
        assert several.thickness_nm("AR") == pytest.approx([97.0], abs=4.0)
        assert several.best.merit < alone.best.merit - np.log(2)
        assert several.starts[several.best.start].name.startswith("minimum 1")
        # Two coatings that start apart both end at the quarter wave
        given = study()
        (one,) = given["coating"]
        layers = {"front": "1.38 60", "rear": "1.38 130"}
        given["coating"] = [one | {"name": k, "surfaces": [f"p0_{k}"], "layers": v} for k, v in layers.items()]
        result = optimized(plate, given)
        for name in layers:
            assert result.thickness_nm(name) == pytest.approx([QUARTER_WAVE], abs=0.7)


class TestCheckpoint:
    class Stop(BaseException):
        """As Ctrl-C: no error that anybody catches."""

    def interrupted(self, plate: Path, file: Path, after: int, **optimizer: Any) -> None:
        left = iter(range(after - 1))

        def progress(*_: object) -> None:
            if next(left, None) is None:
                raise self.Stop

        with pytest.raises(self.Stop):
            optimized(plate, study(**optimizer), checkpoint=file, progress=progress)

    def test_interrupted_between_starts(self, plate: Path, tmp_path: Path) -> None:
        """The starts are kept, and none is evaluated twice."""
        file, how = tmp_path / "checkpoint.json", {"start": 280.0, "bounds": (20.0, 400.0), "starts": 3}
        self.interrupted(plate, file, 2, **how)
        result = optimized(plate, study(**how), checkpoint=file, resume=True)
        assert [step.start for step in result.steps[:3]] == [0, 1, 2]
        assert sum(step.step == 0 for step in result.steps) == 3

    def test_refusals(self, plate: Path, tmp_path: Path) -> None:
        file, other = tmp_path / "checkpoint.json", tmp_path / "other.xml"

        def refused(message: str, scene: Path = plate, start: float = 60.0, **more: Any) -> None:
            with pytest.raises(MistrayError, match=message):
                optimized(scene, study(start), **{"checkpoint": file, "resume": True, **more})

        refused(r"checkpoint\.json': No such file.*")
        self.interrupted(plate, file, 1)
        refused("belongs to another study", start=70.0)
        other.write_text(plate.read_text() + "\n")
        refused("belongs to another scene", scene=other)
        content = json.loads(file.read_text())
        file.write_text(json.dumps({**content, "form": 0}))
        refused("belongs to another version of mistray")
        for changed in ("{", "[]", json.dumps({**content, "evaluations": [[{}]]})):
            file.write_text(changed)
            refused("is damaged; remove it")
        refused("resume needs a checkpoint", checkpoint=None)
        refused("verification_seeds is 1", verification_seeds=1, checkpoint=None, resume=False)
        refused("steps is -1", steps=-1, checkpoint=None, resume=False)

    def test_files_that_scene_and_layers_name(self, tmp_path: Path) -> None:
        """What was evaluated with their former content is of no use."""
        glass, layer = (tmp_path / f"{name}.dat" for name in ("glass", "layer"))
        glass.write_text("MATE G\n0.55 1.5 0\n")
        layer.write_text("MATE L\n0.55 1.38 0\n")
        scene, file, given = write(tmp_path, plates_text(1, "glass.dat:G")), tmp_path / "checkpoint.json", study()
        given["coating"][0]["layers"] = f"{layer}:L 60"
        optimized(scene, given, checkpoint=file, steps=0)
        going_on = partial(optimized, scene, given, checkpoint=file, resume=True, steps=0)
        assert going_on().thickness_nm("AR") == pytest.approx([60.0])
        layer.write_text("MATE L\n0.55 1.45 0\n")
        each_refused((going_on, "belongs to another study"))
        glass.write_text("MATE G\n0.55 1.6 0\n")
        each_refused((going_on, "belongs to another scene"))


class TestOwnTerm:
    """A kind that is a function of one's own."""

    def given(self, kind: Any) -> dict[str, Any]:
        return {**study(band=[500.0, 600.0], steps=1), "term": [{"kind": kind, "goal": "minimise", "rays": 32,
                "wavelength_nm": [500.0, 600.0]}]}  # fmt: skip

    def test_takes_cells_as_it_takes_terms(self, plate: Path) -> None:
        """It counts the wavelengths, as it did in the search; one wavelength was a number then, and no list."""

        def ghosts(scene: Any, **traced: Any) -> Any:
            assert len(traced["wavelength_nm"]) in (1, 2)
            return path_power(scene, "ghost", **traced)

        result = optimized(plate, self.given(ghosts))
        assert not result.unverified
        by_line = {row.wavelength_nm: row for row in result.comparison.rows}
        # The search is at equal weights: the whole is the mean of the two
        assert by_line[None].after == pytest.approx((by_line[500].after + by_line[600].after) / 2, rel=1e-5)
        r = reflectance(result.after["AR.thickness_nm[0]"], 500.0)
        assert by_line[500].after == pytest.approx((r * (1 - r)) ** 2, rel=1e-4)

    def test_is_tried_on_one_cell_before_the_search(self, plate: Path) -> None:
        def pairs(scene: Any, **traced: Any) -> Any:
            first, second = traced.pop("wavelength_nm")
            return path_power(scene, "ghost", wavelength_nm=(first, second), **traced)

        seen: list[Step] = []
        with pytest.raises(MistrayError, match="term 'pairs': its function fails at one field and one wavelength"):
            optimized(plate, self.given(pairs), progress=lambda step, start: seen.append(step))
        assert not seen

    def test_what_a_search_found_outlives_an_error_after_it(self, plate: Path, tmp_path: Path) -> None:
        searched = False

        def over(step: Step, _: object) -> None:
            nonlocal searched
            searched = step.step == 1

        def late(scene: Any, **traced: Any) -> Any:
            if searched:
                raise ZeroDivisionError("no more")
            return path_power(scene, "ghost", **traced)

        result = optimized(plate, self.given(late), progress=over)
        assert "ZeroDivisionError: no more" in result.unverified
        assert result.comparison.seeds == ()
        assert result.comparison.total.after == result.best.terms["late"] < result.comparison.total.before
        assert tables.optimization_record(result)["unverified"] == result.unverified
        for text in (tables.report_text(result), write_optimization(result, tmp_path / "out")[-1].read_text()):
            assert "ZeroDivisionError: no more" in text

        searched = False
        given = self.given(late)
        given["optimizer"]["steps"] = 9
        ended = optimized(plate, given, progress=over)
        assert "ZeroDivisionError: no more" in ended.ended[0]
        assert [step.x for step in ended.steps] == [step.x for step in result.steps[:2]]


STUDY: dict[str, Any] = vectors.toml("plate_study.toml")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Optimization:
    return optimize(write(tmp_path_factory.mktemp("plate"), plates_text(1)), STUDY, verification_seeds=2)


@pytest.fixture(scope="module")
def out(result: Optimization, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("optimised") / "new" / "out"
    write_optimization(result, folder, "mistray optimize <x>")
    return folder


def test_tables_and_the_scene(result: Optimization, out: Path) -> None:
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
    scene = mistray.load(out / "scene.xml")
    params = mi.traverse(scene)
    for name, shifts in (("front", [result.after["n"], 0.0]), ("rear", [result.after["n"]])):
        assert np.array(params[f"{name}.thickness_nm"]) == pytest.approx(result.thickness_nm(name), rel=1e-6)
        assert np.array(params[f"{name}.n_shift"]) == pytest.approx(shifts, rel=1e-6)
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


def test_text_and_record(result: Optimization, out: Path) -> None:
    text = tables.report_text(result)
    found = tables.terms_table(result), tables.comparison_table(result.comparison), tables.variables_table(result)
    assert all(table in text for table in found)
    assert found[0].split()[-3:] == ["≤", "225", "yes"]
    (row,) = (line for line in found[2].splitlines() if line.startswith("rear.thickness_nm[0]"))
    assert "70* " in row, "the quarter wave lies beyond"
    record = json.loads(json.dumps(tables.optimization_record(result), allow_nan=False))
    assert record["holds"] == {"ghosts": True, "price": True}
    assert {row["name"]: row["after"] for row in record["variables"]} == pytest.approx(result.after)
    assert record["terms"][0]["ratio"] == pytest.approx(result.comparison.total.ratio)
    assert tables.goal_text(Term("t", "path_power"), 3.0) == "minimise"
    assert tables.goal_text(Term("t", "path_power", "at_least", limit=2.0), 3.0) == "≥ 2"
    assert tables.goal_text(Term("t", "path_power", "keep", tolerance=0.02), 3.0) == "keep ± 2 %"
    html = (out / "report.html").read_text(encoding="utf-8")
    html_pages.check(html)
    assert "mistray optimize &lt;x&gt;" in html
    assert html_pages.table_of(html, "t-terms").count("<tr>") == 1 + len(result.comparison.rows)
    assert html_pages.table_of(html, "t-variables").count("<tr>") == 1 + 4


def test_pictures_of_the_search(result: Optimization) -> None:
    left, middle, right = search_figure(result).axes
    curves = [container.lines[0].get_ydata() for container in left.containers]
    assert sum(len(curve) for curve in curves) == len(result.steps)
    assert min(np.min(curve) for curve in curves) == result.best.merit
    assert len(right.lines) == len(result.starts) == 2
    own = [step for step in result.steps if step.start == result.best.start]
    for line, name in zip(middle.lines, ("ghosts", "price"), strict=True):
        assert line.get_ydata() == pytest.approx([step.terms[name] / result.steps[0].terms[name] for step in own])
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
        assert line.get_ydata() == pytest.approx(100 * reflectance(thickness, x, n), rel=error)
    assert x[0] < 500 < 600 < x[-1]


def asked(*terms: dict[str, Any], seed: int = 0, **trace: Any) -> DesignStudy:
    variable = {"parameters": "x", "low": 0, "high": 1}
    return read_study({"trace": trace, "term": list(terms), "variable": [variable], "optimizer": {"seed": seed}})


GHOSTS = {"name": "ghosts", "kind": "path_power", "goal": "minimise"}


def plate_of(folder: Path, R: float) -> Any:
    return mistray.load(write(folder, plates_text(1, R=R, T=0.9)))


class TestRows:
    def test_cells(self, tmp_path: Path) -> None:
        """Of each term the whole, each field, each wavelength and each pair of both."""
        both = {"wavelength_nm": [500, 600]}
        signal = {"name": "signal", "kind": "transmission", "goal": "keep", "field_deg": [0], **both}
        read = asked(GHOSTS, signal, field_deg=[0, 1], **both, weights=[1, 3], rays=64)
        comparison = compare(measure(plate_of(tmp_path, 0.05), read, 2), measure(plate_of(tmp_path, 0.02), read, 2))
        cells = {(row.term, row.field_deg, row.wavelength_nm): row for row in comparison.rows}
        assert len(cells) == len(comparison.rows) == (1 + 2 + 2 + 4) + (1 + 2)
        assert len(list(comparison.marginals())) == 5 + 3
        assert comparison.total is comparison.of("ghosts") is cells["ghosts", None, None]
        assert comparison.seeds == (1, 2), "not the seed of the search"
        for row in comparison.rows:
            assert row.unit == "W/W"
            ghosts = (0.05 * 0.9) ** 2, (0.02 * 0.9) ** 2, 6.25
            expected = (0.81, 0.81, 1.0) if row.term == "signal" else ghosts
            assert (row.before, row.after, row.ratio) == pytest.approx(expected, rel=1e-5)

    def test_the_mean_and_parts_without_light(self) -> None:
        """Of the fields, and of the wavelengths with their weights; the coatings of the triplet are not grey."""
        light = {"field_deg": [0, 10], "wavelength_nm": [450, 550], "weights": [1, 3]}
        scene = mistray.load("cooke_triplet")
        levels = measure(scene, asked(GHOSTS, **light, rays=1000, flux_threshold=1e-9), seeds=2)

        def mean(field: float | None, nm: float | None) -> float:
            return float(levels.values[ComparisonCell("ghosts", field, nm)].mean())

        assert mean(None, None) == pytest.approx((mean(0, None) + mean(10, None)) / 2, rel=1e-12)
        for field in (None, 0, 10):
            # The same seed draws other rays for one wavelength than for that among two
            assert mean(field, None) == pytest.approx(0.25 * mean(field, 450) + 0.75 * mean(field, 550), rel=0.2)
        # A field without a value has no number, but the others have; the result of a search is not lost for it
        term = {"kind": "ghost_rms_irradiance", "goal": "minimise", "rays": 300}
        levels = measure(scene, asked({**term, "field_deg": [0, 10], "wavelength_nm": [500, 510, 520, 530]}), seeds=2)
        values = {cell: value for cell, value in levels.values.items() if not cell.whole}
        assert np.all(np.isfinite(levels.of("ghost_rms_irradiance")))
        assert any(np.isnan(value).any() for value in values.values())
        assert {row.ratio for row in compare(levels, levels).rows if np.isfinite(row.ratio)} == {1.0}
        assert measure(scene, asked({**term, "selection": "structure"}), seeds=2).of(term["kind"]).tolist() == [0, 0]
        beside = measure(scene, asked({**term, "kind": "rms_spot", "field_deg": [80]}), seeds=2)
        assert np.isnan(beside.of("rms_spot")).all()
        assert np.isnan(compare(beside, beside).of("rms_spot").ratio)
        # Against the formulas: the error of a ratio of means knows that both see the same rays
        levels = Levels((1, 2), {ComparisonCell("a"): np.array([1.0, 3.0])}, {"a": "mm"})
        row = compare(levels.including({"b": 7.0}, {"b": "nm"}), levels.including({"b": 14.0}, {"b": "nm"})).of("b")
        assert (row.before, row.before_se, row.after, row.ratio, row.ratio_se) == (7.0, 0.0, 14.0, 0.5, 0.0)
        assert row.unit == "nm"
        b, a = np.array([1.0, 1.2, 0.9, 1.1]), np.array([0.5, 0.62, 0.44, 0.56])
        row = compare(*(Levels((1, 2, 3, 4), {ComparisonCell("t"): v}) for v in (b, a))).of("t")
        ratio, covariance = b.mean() / a.mean(), np.cov(b, a)
        assert (row.before, row.after, row.ratio) == pytest.approx((b.mean(), a.mean(), ratio))
        assert row.before_se == pytest.approx(b.std(ddof=1) / 2)
        variance = (covariance[0, 0] - 2 * ratio * covariance[0, 1] + ratio**2 * covariance[1, 1]) / a.mean() ** 2 / 4
        assert row.ratio_se == pytest.approx(np.sqrt(variance))


def test_errors(tmp_path: Path) -> None:
    """Two sets of eight seeds agree within five errors of their difference, and common rays sharpen the ratio.

    False-alarm probability 2e-4: Student's t with 14 degrees of freedom; the seeds are fixed.
    """
    scenes = []
    for name in ("mgf2_quarter_wave", "bbar3"):
        coating = SharedCoating("AR", preset(name), ("L1_front", "L1_rear", "L2_front", "L2_rear"))
        scenes.append(mistray.load(write_recoated(find("cooke_triplet"), [coating], tmp_path / "scene.xml")))
    light = {"field_deg": [10], "wavelength_nm": 550, "rays": 300}
    reads = (asked(GHOSTS, seed=seed, **light) for seed in (0, 100))
    one, two = (compare(*(measure(scene, read) for scene in scenes)).total for read in reads)
    for key in ("before", "after", "ratio"):
        error = np.hypot(getattr(one, f"{key}_se"), getattr(two, f"{key}_se"))
        assert error > 0
        assert abs(getattr(one, key) - getattr(two, key)) < 5 * error, key
    assert one.ratio_se / one.ratio < 0.5 * one.before_se / one.before


def test_different_measurements(tmp_path: Path) -> None:
    scene, read = plate_of(tmp_path, 0.05), asked(GHOSTS, rays=64)
    one, renamed = measure(scene, read, 2), asked({**GHOSTS, "name": "x"}, rays=64)
    each_refused(
        (lambda: compare(one, measure(scene, read, 3)), "differ in seeds"),
        (lambda: compare(one, measure(scene, renamed, 2)), "differ in terms"),
        (lambda: measure(scene, read, 1), "seeds is 1"),
    )

"""The whole of it: closed-form optima, bounds, several starts, methods, and checkpoints."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import optimization_record, report_text
from mistray.errors import MistrayError
from mistray.optimize import Start, Step, measure, path_power
from mistray.optimize import optimize as optimize_and_verify
from mistray.scene.recoat import write_recoated

QUARTER_WAVE = 550 / 4 / 1.38
optimize = partial(optimize_and_verify, verification_seeds=2)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A plate of n = 1.5 in normal incidence: the ghost is R² T² of the launched power."""
    return write(tmp_path, plates_text(1))


def study(start: float = 60.0, bounds: Any = (20.0, 180.0), band: Any = 550.0, **optimizer: Any) -> dict[str, Any]:
    """One layer of n = 1.38 on both faces of the plate."""
    return {
        "term": [{"name": "ghosts", "kind": "path_power", "goal": "minimise", "wavelength_nm": band, "rays": 32}],
        "coating": [
            {"name": "AR", "surfaces": "all", "layers": f"1.38 {start}", "thickness_nm": [float(b) for b in bounds]}
        ],
        "optimizer": {"starts": 1, "tolerance": 1e-4, "patience": 1, **optimizer},
    }


def reflectance(d: float, nm: float = 550.0) -> float:
    """Airy's formula for one layer at normal incidence, thickness and wavelength in nm."""
    r1, r2 = (1 - 1.38) / (1 + 1.38), (1.38 - 1.5) / (1.38 + 1.5)
    phase = np.exp(4j * np.pi * 1.38 * d / nm)
    return float(abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2)


class TestSearch:
    def test_quarter_wave(self, plate: Path, tmp_path: Path) -> None:
        """Near it the metric is flat: a relative excess of 1e-4, the tolerance, is 0.4 nm."""
        file = tmp_path / "new" / "checkpoint.json"
        result = optimize(plate, study(), checkpoint=file)
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
        again = optimize(plate, study(), checkpoint=file, resume=True)
        assert (again.steps, again.ended) == (result.steps, result.ended), "a search that has converged is over"

    @pytest.mark.parametrize(
        "how", [{"method": "adam", "steps": 40, "patience": 5}, {"method": "nlopt", "patience": 10}]
    )
    def test_other_methods(self, plate: Path, how: dict[str, Any]) -> None:
        if how["method"] == "nlopt":
            pytest.importorskip("nlopt")
        result = optimize(plate, study(**{"step_size": 0.05, **how}))
        assert result.thickness_nm("AR") == pytest.approx([QUARTER_WAVE], abs=2.0)
        ratio = (reflectance(60.0) / reflectance(QUARTER_WAVE)) ** 2
        assert result.comparison.total.ratio == pytest.approx(ratio, rel=0.05)

    def test_limits(self, plate: Path) -> None:
        """A bound; and the least ghost of at most 80 nm: the penalty begins 1 % below the limit and costs 1 at it."""
        bound = optimize(plate, study(bounds=(20.0, 80.0)))
        assert bound.thickness_nm("AR") == pytest.approx([80.0])
        assert bound.best.gradient_norm == 0, "the layer is not free to move on"
        given = study()
        given["term"].append({"name": "price", "kind": "total_thickness", "goal": "at_most", "limit": 80})
        result = optimize(plate, given)
        assert 79.2 < result.thickness_nm("AR")[0] <= 80.0
        assert result.steps[-1].broken == ()
        assert result.comparison.of("price").after == pytest.approx(result.thickness_nm("AR")[0])
        assert result.comparison.of("price").after_se == 0

    def test_variables_beside_coatings(self, plate: Path) -> None:
        """The index of the layer moves with its thickness: towards the root of 1.5, and the quarter wave follows."""
        given = study()
        given["variable"] = [{"name": "n", "parameters": "AR.n_shift", "low": -0.1, "high": 0.1}]
        result = optimize(plate, given)
        n = 1.38 + result.after["n"]
        assert result.after["n"] == pytest.approx(-0.1)
        assert result.after["AR.thickness_nm[0]"] == pytest.approx(550 / 4 / n, abs=0.7)
        assert result.parameters == {"AR.n_shift": pytest.approx(np.array([-0.1]))}, "thicknesses go with the coating"

    def test_ideal_coatings_without_thin_films(self, tmp_path: Path) -> None:
        """The ghost of a plate, R² T², is least where R is; a limit on R by the transmission T² is not touched."""
        scene = write(tmp_path, plates_text(1, R=0.05, T=0.9))
        given = {
            "trace": {"wavelength_nm": 550, "rays": 32},
            "term": [
                {"kind": "path_power", "goal": "minimise"},
                {"kind": "transmission", "goal": "at_least", "limit_of_start": 0.95},
            ],
            "variable": [{"name": "R", "parameters": "p0_*.bsdf.R", "low": 1e-3, "high": 0.1, "scale": "log"}],
        }
        result = optimize(scene, given)
        assert result.after == {"R": pytest.approx(1e-3)}
        assert set(result.parameters) == {"p0_front.bsdf.R", "p0_rear.bsdf.R"}
        assert result.comparison.of("path_power").ratio == pytest.approx(2500, rel=1e-4)

    @pytest.mark.long
    def test_several_starts_leave_a_local_minimum(self, plate: Path) -> None:
        """Three quarter waves are a minimum too, a worse one over a band: from there only other starts lead away."""
        band = [450, 550, 650]
        alone = optimize(plate, study(280.0, (20.0, 400.0), band))
        assert alone.thickness_nm("AR")[0] > 250
        several = optimize(plate, study(280.0, (20.0, 400.0), band, starts=3))
        assert several.thickness_nm("AR") == pytest.approx([97.0], abs=4.0)
        assert several.best.merit < alone.best.merit - np.log(2)
        assert several.starts[several.best.start].name.startswith("minimum 1")

    def test_shared_and_separate_designs(self, plate: Path) -> None:
        """Two coatings that start apart both end at the quarter wave."""
        given = study()
        (one,) = given["coating"]
        given["coating"] = [
            {**one, "name": "front", "surfaces": ["p0_front"]},
            {**one, "name": "rear", "surfaces": ["p0_rear"], "layers": "1.38 130"},
        ]
        result = optimize(plate, given)
        for name in ("front", "rear"):
            assert result.thickness_nm(name) == pytest.approx([QUARTER_WAVE], abs=0.7)


class TestCheckpoint:
    class Stop(BaseException):
        """As Ctrl-C: no error that anybody catches."""

    def interrupted(self, plate: Path, file: Path, after: int, **optimizer: Any) -> None:
        seen: list[Step] = []

        def progress(step: Step, start: Start) -> None:
            seen.append(step)
            if len(seen) == after:
                raise self.Stop

        with pytest.raises(self.Stop):
            optimize(plate, study(**optimizer), checkpoint=file, progress=progress)

    def test_interrupted_between_starts(self, plate: Path, tmp_path: Path) -> None:
        """The starts are kept, and none is evaluated twice."""
        file, how = tmp_path / "checkpoint.json", {"start": 280.0, "bounds": (20.0, 400.0), "starts": 3}
        self.interrupted(plate, file, 2, **how)
        result = optimize(plate, study(**how), checkpoint=file, resume=True)
        assert [step.start for step in result.steps[:3]] == [0, 1, 2]
        assert sum(step.step == 0 for step in result.steps) == 3

    def test_refusals(self, plate: Path, tmp_path: Path) -> None:
        file, other = tmp_path / "checkpoint.json", tmp_path / "other.xml"

        def refused(message: str, scene: Path = plate, start: float = 60.0, **more: Any) -> None:
            with pytest.raises(MistrayError, match=message):
                optimize(scene, study(start), **{"checkpoint": file, "resume": True, **more})

        refused(r"checkpoint\.json': No such file.*")
        self.interrupted(plate, file, 1)
        refused("belongs to another study", start=70.0)
        other.write_text(plate.read_text() + "\n")
        refused("belongs to another scene", scene=other)
        content = json.loads(file.read_text())
        for changed, message in (
            (json.dumps({**content, "form": 0}), "belongs to another version of mistray"),
            ("{", "is damaged; remove it"),
            ("[]", "is damaged; remove it"),
            (json.dumps({**content, "evaluations": [[{}]]}), "is damaged; remove it"),
        ):
            file.write_text(changed)
            refused(message)
        refused("resume needs a checkpoint", checkpoint=None)
        refused("verification_seeds is 1", verification_seeds=1, checkpoint=None, resume=False)
        refused("steps is -1", steps=-1, checkpoint=None, resume=False)


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

        result = optimize(plate, self.given(ghosts))
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
            optimize(plate, self.given(pairs), progress=lambda step, start: seen.append(step))
        assert not seen

    def test_what_a_search_found_outlives_an_error_after_it(self, plate: Path, tmp_path: Path) -> None:
        searched = False

        def over(step: Step, start: Start) -> None:
            nonlocal searched
            searched = step.step == 1

        def late(scene: Any, **traced: Any) -> Any:
            if searched:
                raise ZeroDivisionError("no more")
            return path_power(scene, "ghost", **traced)

        result = optimize(plate, self.given(late), progress=over)
        assert "ZeroDivisionError: no more" in result.unverified
        assert result.comparison.seeds == ()
        assert result.comparison.total.after == result.best.terms["late"] < result.comparison.total.before
        assert optimization_record(result)["unverified"] == result.unverified
        for text in (report_text(result), write_optimization(result, tmp_path / "out")[-1].read_text()):
            assert "ZeroDivisionError: no more" in text

        searched = False
        given = self.given(late)
        given["optimizer"]["steps"] = 9
        ended = optimize(plate, given, progress=over)
        assert "ZeroDivisionError: no more" in ended.ended[0]
        assert [step.x for step in ended.steps] == [step.x for step in result.steps[:2]]

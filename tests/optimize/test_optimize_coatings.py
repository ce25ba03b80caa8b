"""The search: closed-form optima, bounds, several starts, checkpoints, and no recompilation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.errors import MistrayError
from mistray.optimize import Design, Step, compare, measure, optimize_coatings, read_study
from mistray.optimize.designs import CoatedScene, Placed, place
from mistray.optimize.starts import Proxy, minima
from mistray.scene.load import find
from mistray.scene.recoat import write_recoated

QUARTER_WAVE = 550 / 4 / 1.38
TRIPLET = find("cooke_triplet")


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A plate of n = 1.5 in normal incidence: the ghost is R² T² of the launched power."""
    return write(tmp_path, plates_text(1))


def study(start: float = 60.0, bounds: Any = (20.0, 180.0), band: Any = 550.0, **optimizer: Any) -> dict[str, Any]:
    """One layer of n = 1.38 on both faces of the plate."""
    return {
        "metric": {"wavelength_nm": band, "rays": 32},
        "coating": [
            {"name": "AR", "surfaces": "all", "layers": f"1.38 {start}", "thickness_nm": [float(b) for b in bounds]}
        ],
        "optimizer": {"starts": 1, "tolerance": 1e-9, **optimizer},
    }


def reflectance(d: float, nm: float = 550.0) -> float:
    """Airy's formula for one layer at normal incidence, thickness and wavelength in nm."""
    r1, r2 = (1 - 1.38) / (1 + 1.38), (1.38 - 1.5) / (1.38 + 1.5)
    phase = np.exp(4j * np.pi * 1.38 * d / nm)
    return float(abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2)


class TestSearch:
    def test_quarter_wave(self, plate: Path) -> None:
        """R has one minimum within the bounds, the quarter wave; the metric there is known.

        Near it the metric is flat: a relative excess of 1e-6, a thousandth of the default tolerance, is 0.04 nm.
        """
        result = optimize_coatings(plate, study())
        assert result.ended == {0: "converged"}
        assert result.best.thickness_nm["AR"] == pytest.approx([QUARTER_WAVE], abs=0.1)
        row = result.comparison.total
        r0, r1 = reflectance(60.0), reflectance(QUARTER_WAVE)
        assert row.before == pytest.approx((r0 * (1 - r0)) ** 2, rel=1e-5)
        assert row.after == pytest.approx((r1 * (1 - r1)) ** 2, rel=1e-5)
        assert row.ratio == pytest.approx(row.before / row.after)

    def test_ghost_to_signal(self, plate: Path) -> None:
        """Without T: the ratio is R²."""
        given = study()
        given["metric"]["kind"] = "ghost_to_signal"
        result = optimize_coatings(plate, given)
        assert result.best.thickness_nm["AR"] == pytest.approx([QUARTER_WAVE], abs=0.1)
        assert result.comparison.total.after == pytest.approx(reflectance(QUARTER_WAVE) ** 2, rel=1e-5)

    def test_first_step_is_small(self, plate: Path) -> None:
        """The first trial moves no layer by more than 5 nm, wherever the gradient points."""
        result = optimize_coatings(plate, study(steps=1))
        first = result.steps[1].thickness_nm["AR"][0] - 60.0
        assert 0 < first <= 5.01
        assert result.ended == {0: "all steps used"}

    def test_bound(self, plate: Path) -> None:
        result = optimize_coatings(plate, study(bounds=(20.0, 80.0)))
        assert result.best.thickness_nm["AR"] == pytest.approx([80.0])
        assert result.best_step.gradient_norm == 0, "the layer is not free to move on"

    def test_several_starts_leave_a_local_minimum(self, plate: Path) -> None:
        """Three quarter waves are a minimum too, a worse one over a band: from there only other starts lead away."""
        band = [450, 550, 650]
        alone = optimize_coatings(plate, study(280.0, (20.0, 400.0), band))
        assert alone.best.thickness_nm["AR"][0] > 250
        several = optimize_coatings(plate, study(280.0, (20.0, 400.0), band, starts=3))
        assert several.best.thickness_nm["AR"] == pytest.approx([97.0], abs=4.0)
        assert several.best_step.value < 0.5 * alone.best_step.value
        assert several.best.name.startswith("minimum 1")

    def test_searches_from_the_best_starts(self, plate: Path) -> None:
        result = optimize_coatings(plate, study(280.0, (20.0, 400.0), [450, 650], starts=3, searches=2))
        assert len(result.ended) == 2
        starts = sorted((step.value, step.start) for step in result.steps if step.step == 0)
        assert set(result.ended) == {start for _, start in starts[:2]}

    def test_shared_and_separate_designs(self, plate: Path) -> None:
        """Two coatings that start apart both end at the quarter wave."""
        given = study()
        (one,) = given["coating"]
        given["coating"] = [
            {**one, "name": "front", "surfaces": ["p0_front"]},
            {**one, "name": "rear", "surfaces": ["p0_rear"], "layers": "1.38 130"},
        ]
        result = optimize_coatings(plate, given)
        for name in ("front", "rear"):
            assert result.best.thickness_nm[name] == pytest.approx([QUARTER_WAVE], abs=0.3)

    def test_no_light(self, plate: Path) -> None:
        given = study()
        given["metric"]["paths"] = "structure"
        with pytest.raises(MistrayError, match="the metric is 0; no light goes the paths 'structure'"):
            optimize_coatings(plate, given)

    def test_the_result_as_a_scene(self, plate: Path, tmp_path: Path) -> None:
        result = optimize_coatings(plate, study())
        scene = mistray.load(write_recoated(plate, result.coatings, tmp_path / "result.xml"))
        levels = measure(scene, result.study.metric)
        assert levels.at().mean() == pytest.approx(result.comparison.total.after, rel=1e-6)


class TestCheckpoint:
    class Stop(BaseException):
        """As Ctrl-C: no error that anybody catches."""

    def interrupted(self, plate: Path, file: Path, after: int, **optimizer: Any) -> list[Step]:
        seen: list[Step] = []

        def progress(step: Step, design: Design) -> None:
            seen.append(step)
            if len(seen) == after:
                raise self.Stop

        with pytest.raises(self.Stop):
            optimize_coatings(plate, study(**optimizer), checkpoint=file, progress=progress)
        return seen

    def test_going_on(self, plate: Path, tmp_path: Path) -> None:
        file = tmp_path / "new" / "checkpoint.json"
        seen = self.interrupted(plate, file, 4)
        assert len(json.loads(file.read_text())["steps"]) == 4
        result = optimize_coatings(plate, study(), checkpoint=file, resume=True)
        assert result.steps[:4] == tuple(seen)
        assert [step.step for step in result.steps] == list(range(len(result.steps)))
        assert result.steps[4].seconds > seen[-1].seconds
        assert result.steps[4].evaluations > seen[-1].evaluations
        assert result.best.thickness_nm["AR"] == pytest.approx([QUARTER_WAVE], abs=0.1)

    def test_interrupted_between_starts(self, plate: Path, tmp_path: Path) -> None:
        """The start designs are kept, and none is evaluated twice."""
        file, how = tmp_path / "checkpoint.json", {"start": 280.0, "bounds": (20.0, 400.0), "starts": 3}
        self.interrupted(plate, file, 2, **how)
        result = optimize_coatings(plate, study(**how), checkpoint=file, resume=True)
        assert [step.start for step in result.steps[:3]] == [0, 1, 2]
        assert sum(step.step == 0 for step in result.steps) == 3

    def test_more_steps_later(self, plate: Path, tmp_path: Path) -> None:
        file = tmp_path / "checkpoint.json"
        short = optimize_coatings(plate, study(), steps=2, checkpoint=file)
        assert short.ended == {0: "all steps used"}
        same = optimize_coatings(plate, study(), steps=0, checkpoint=file, resume=True)
        assert same.steps == short.steps, "no step: only the verification"
        long = optimize_coatings(plate, study(), checkpoint=file, resume=True)
        assert long.ended == {0: "converged"}
        again = optimize_coatings(plate, study(), checkpoint=file, resume=True)
        assert again.steps == long.steps, "a search that has converged is over"

    def test_refusals(self, plate: Path, tmp_path: Path) -> None:
        file = tmp_path / "checkpoint.json"
        with pytest.raises(MistrayError, match=r"checkpoint\.json': No such file.*; run without resuming"):
            optimize_coatings(plate, study(), checkpoint=file, resume=True)
        self.interrupted(plate, file, 1)
        with pytest.raises(MistrayError, match="belongs to another study"):
            optimize_coatings(plate, study(70.0), checkpoint=file, resume=True)
        other = tmp_path / "other.xml"
        other.write_text(plate.read_text() + "\n")
        with pytest.raises(MistrayError, match="belongs to another scene"):
            optimize_coatings(other, study(), checkpoint=file, resume=True)
        content = json.loads(file.read_text())
        file.write_text(json.dumps({**content, "form": 0}))
        with pytest.raises(MistrayError, match="belongs to another version of mistray"):
            optimize_coatings(plate, study(), checkpoint=file, resume=True)
        for damaged in ("{", "[]", json.dumps({**content, "steps": [{}]})):
            file.write_text(damaged)
            with pytest.raises(MistrayError, match="is damaged; remove it"):
                optimize_coatings(plate, study(), checkpoint=file, resume=True)
        with pytest.raises(MistrayError, match="resume needs a checkpoint"):
            optimize_coatings(plate, study(), resume=True)
        with pytest.raises(MistrayError, match="steps is -1"):
            optimize_coatings(plate, study(), steps=-1)


class TestKernels:
    def test_none_is_compiled_after_the_second_step(self) -> None:
        """Counted on the Cooke triplet with all three layers of both coatings moving, two fields and two wavelengths.

        A kernel found in the disk cache counts too: it is new to this process.
        """
        given = {
            "metric": {"fields_deg": [0, 15], "wavelength_nm": [480, 620], "rays": 400},
            "coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 250]}],
            "optimizer": {"starts": 1, "steps": 6, "tolerance": 0},
        }
        new: list[int] = []

        def compiled() -> int:
            entries = dr.kernel_history([dr.KernelType.JIT])
            return sum(not entry["cache_hit"] or entry["cache_disk"] for entry in entries)

        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(mi.Float([1.0, 2.0]) * float(np.random.default_rng().uniform()))
            assert compiled() == 1, "the count sees a literal that is baked in"
            optimize_coatings("cooke_triplet", given, progress=lambda step, design: new.append(compiled()))
            compiled()
        assert len(new) == 7
        assert new[3:] == [0, 0, 0, 0], new


class TestStarts:
    def placed(self, layers: str, surfaces: Any, bounds: list[float]) -> Placed:
        coating = {"surfaces": surfaces, "layers": layers, "thickness_nm": bounds}
        (placed,) = place(mistray.load("cooke_triplet"), read_study({"coating": [coating]}))
        return placed

    def test_proxy_is_the_mean_square_of_R(self) -> None:
        """Against the coating's own response, from the air on both sides of a lens, whatever side is the front."""
        placed = self.placed("1.38 90, 2.1 120", ["L1_front", "L1_rear"], [10.0, 200.0])
        proxy = Proxy.of(placed, (500.0, 600.0), (0.25, 0.75))
        stack = placed.stack((90.0, 120.0))
        expected = 0.0
        for nm, weight in ((500.0, 0.25), (600.0, 0.75)):
            n = mistray.materials.complex_index("N-LAK9", nm)
            for from_front, sides in ((True, (1 + 0j, n)), (False, (n, 1 + 0j))):
                answer = stack.response(nm, *sides, np.cos(np.radians([0.0, 15.0, 30.0, 45.0])), from_front)
                expected += weight * np.mean(answer.R.mean(axis=1) ** 2) / 2
        assert proxy(np.array([[90.0, 120.0], [50.0, 50.0]]))[0] == pytest.approx(expected, rel=1e-12)

    def test_minima(self) -> None:
        """Of one layer at one wavelength: odd quarter waves, the one next to the given design among them, each once."""
        placed = self.placed("1.38 530", ["L1_front"], [20.0, 600.0])
        proxy = Proxy.of(placed, (550.0,), (1.0,))
        found = minima(proxy, placed.group.bounds_nm, np.array([530.0]), seed=0)
        quarter = min(d[0] for d in found)
        assert sorted(round(d[0] / quarter) for d in found) == [1, 3, 5]
        assert np.all(np.diff([proxy(d[None])[0] for d in found]) >= -1e-12)


class TestComparison:
    def result(self, plate: Path, before: float, after: float, metric: dict[str, Any]) -> Any:
        given = read_study({**study(), "metric": {"rays": 64, **metric}})
        placed = place(mistray.load(plate), given)
        coated = CoatedScene(plate, placed)
        levels = []
        for d in (before, after):
            coated.apply({"AR": np.array([d])})
            levels.append(measure(coated.scene, given.metric))
        return compare(*levels)

    def test_rows(self, plate: Path) -> None:
        """The whole is the weighted mean of the wavelengths and the mean of the fields."""
        comparison = self.result(
            plate, 60.0, 100.0, {"fields_deg": [0, 1], "wavelength_nm": [500, 600], "weights": [1, 3]}
        )
        cells = {(row.field_deg, row.wavelength_nm): row for row in comparison.rows}
        assert len(cells) == 1 + 2 + 2 + 4
        assert len(list(comparison.marginals())) == 5
        for nm in (500.0, 600.0):
            r = reflectance(60.0, nm)
            assert cells[0.0, nm].before == pytest.approx((r * (1 - r)) ** 2, rel=1e-5)
        for field in (0.0, 1.0):
            whole = 0.25 * cells[field, 500.0].after + 0.75 * cells[field, 600.0].after
            assert cells[field, None].after == pytest.approx(whole, rel=1e-12)
        assert cells[None, None].after == pytest.approx((cells[0.0, None].after + cells[1.0, None].after) / 2)

    def test_errors(self) -> None:
        """Two sets of eight seeds agree within five errors of their difference, and common rays sharpen the ratio.

        False-alarm probability 2e-4: Student's t with 14 degrees of freedom; the seeds are fixed.
        """
        comparisons = [
            self.result(TRIPLET, 60.0, 100.0, {"fields_deg": [10], "wavelength_nm": 550, "rays": 300, "seed": seed})
            for seed in (0, 100)
        ]
        one, two = (comparison.total for comparison in comparisons)
        assert comparisons[0].seeds == tuple(range(1, 9)), "not the seed of the search"
        for key in ("before", "after", "ratio"):
            error = np.hypot(getattr(one, f"{key}_se"), getattr(two, f"{key}_se"))
            assert error > 0
            assert abs(getattr(one, key) - getattr(two, key)) < 5 * error, key
        assert one.ratio_se / one.ratio < 0.5 * one.before_se / one.before

    def test_different_measurements(self, plate: Path) -> None:
        given = read_study(study()).metric
        scene = mistray.load("cooke_triplet")
        levels = [measure(scene, given, seeds) for seeds in (2, 3)]
        with pytest.raises(MistrayError, match="differ in seeds"):
            compare(*levels)
        with pytest.raises(MistrayError, match="seeds is 1"):
            measure(scene, given, 1)

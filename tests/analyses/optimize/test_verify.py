"""The comparison of two designs on seeds that the search has not seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import plates_text, write

import mistray
from mistray.analyses.optimize.study.comparison import ComparisonCell, Levels
from mistray.coatings import preset
from mistray.errors import MistrayError
from mistray.optimize import DesignStudy, compare, measure, read_study
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

VARIABLE = {"parameters": "x", "low": 0, "high": 1}


def study(*terms: dict[str, Any], seed: int = 0, **trace: Any) -> DesignStudy:
    return read_study({"trace": trace, "term": list(terms), "variable": [VARIABLE], "optimizer": {"seed": seed}})


GHOSTS = {"name": "ghosts", "kind": "path_power", "goal": "minimise"}


def plate(folder: Path, R: float) -> Any:
    return mistray.load(write(folder, plates_text(1, R=R, T=0.9)))


class TestRows:
    def test_cells(self, tmp_path: Path) -> None:
        """Of each term the whole, each field, each wavelength and each pair of both."""
        read = study(
            GHOSTS,
            {"name": "signal", "kind": "transmission", "goal": "keep", "field_deg": [0], "wavelength_nm": [500, 600]},
            field_deg=[0, 1],
            wavelength_nm=[500, 600],
            weights=[1, 3],
            rays=64,
        )
        comparison = compare(measure(plate(tmp_path, 0.05), read, 2), measure(plate(tmp_path, 0.02), read, 2))
        cells = {(row.term, row.field_deg, row.wavelength_nm): row for row in comparison.rows}
        assert len(cells) == len(comparison.rows) == (1 + 2 + 2 + 4) + (1 + 2)
        assert len(list(comparison.marginals())) == 5 + 3
        assert comparison.total is comparison.of("ghosts") is cells["ghosts", None, None]
        assert comparison.seeds == (1, 2), "not the seed of the search"
        for row in comparison.rows:
            assert row.unit == "W/W"
            signal = row.term == "signal"
            assert row.before == pytest.approx(0.81 if signal else (0.05 * 0.9) ** 2, rel=1e-5)
            assert row.after == pytest.approx(0.81 if signal else (0.02 * 0.9) ** 2, rel=1e-5)
            assert row.ratio == pytest.approx(1.0 if signal else 6.25, rel=1e-5)

    def test_the_whole_is_the_mean(self) -> None:
        """Of the fields, and of the wavelengths with their weights; the coatings of the triplet are not grey."""
        read = study(
            GHOSTS, field_deg=[0, 10], wavelength_nm=[450, 550], weights=[1, 3], rays=1000, flux_threshold=1e-9
        )
        levels = measure(mistray.load("cooke_triplet"), read, seeds=2)

        def mean(field: float | None, nm: float | None) -> float:
            return float(levels.values[ComparisonCell("ghosts", field, nm)].mean())

        assert mean(None, None) == pytest.approx((mean(0, None) + mean(10, None)) / 2, rel=1e-12)
        for field in (None, 0, 10):
            # The same seed draws other rays for one wavelength than for that among two
            assert mean(field, None) == pytest.approx(0.25 * mean(field, 450) + 0.75 * mean(field, 550), rel=0.2)

    def test_no_light_in_a_part(self) -> None:
        """A field without a value has no number, but the others have; the result of a search is not lost for it."""
        term = {"kind": "ghost_rms_irradiance", "goal": "minimise", "rays": 300}
        scene = mistray.load("cooke_triplet")
        levels = measure(scene, study({**term, "field_deg": [0, 10], "wavelength_nm": [500, 510, 520, 530]}), seeds=2)
        values = {cell: value for cell, value in levels.values.items() if not cell.whole}
        assert np.all(np.isfinite(levels.of("ghost_rms_irradiance")))
        assert any(np.isnan(value).any() for value in values.values())
        assert {row.ratio for row in compare(levels, levels).rows if np.isfinite(row.ratio)} == {1.0}
        assert measure(scene, study({**term, "selection": "structure"}), seeds=2).of(term["kind"]).tolist() == [0, 0]
        beside = measure(
            scene, study({"kind": "rms_spot", "goal": "minimise", "rays": 300, "field_deg": [80]}), seeds=2
        )
        assert np.isnan(beside.of("rms_spot")).all()
        assert np.isnan(compare(beside, beside).of("rms_spot").ratio)

    def test_exact_terms_and_standard_errors(self) -> None:
        """Against the formulas: the error of a ratio of means knows that both see the same rays."""
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


def compared(folder: Path, seed: int) -> Any:
    read = study(GHOSTS, field_deg=[10], wavelength_nm=550, rays=300, seed=seed)
    levels = []
    for name in ("mgf2_quarter_wave", "bbar3"):
        coating = SharedCoating("AR", preset(name), ("L1_front", "L1_rear", "L2_front", "L2_rear"))
        scene = write_recoated(find("cooke_triplet"), [coating], folder / "scene.xml")
        levels.append(measure(mistray.load(scene), read))
    return compare(*levels).total


@pytest.mark.long
def test_errors(tmp_path: Path) -> None:
    """Two sets of eight seeds agree within five errors of their difference, and common rays sharpen the ratio.

    False-alarm probability 2e-4: Student's t with 14 degrees of freedom; the seeds are fixed.
    """
    one, two = (compared(tmp_path, seed) for seed in (0, 100))
    for key in ("before", "after", "ratio"):
        error = np.hypot(getattr(one, f"{key}_se"), getattr(two, f"{key}_se"))
        assert error > 0
        assert abs(getattr(one, key) - getattr(two, key)) < 5 * error, key
    assert one.ratio_se / one.ratio < 0.5 * one.before_se / one.before


def test_different_measurements(tmp_path: Path) -> None:
    scene, read = plate(tmp_path, 0.05), study(GHOSTS, rays=64)
    one = measure(scene, read, 2)
    for other, message in (
        (measure(scene, read, 3), "differ in seeds"),
        (measure(scene, study({**GHOSTS, "name": "x"}, rays=64), 2), "differ in terms"),
    ):
        with pytest.raises(MistrayError, match=message):
            compare(one, other)
    with pytest.raises(MistrayError, match="seeds is 1"):
        measure(scene, read, 1)

"""Fits with a covariance: a model in closed form, and the PST in bands against its own cells and differences."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mistray
from mistray.errors import MistrayError
from mistray.gradients.table_gradient import GradientRequest
from mistray.optimize import Modelled, PstBands, fit, pst_bin

X = np.linspace(0, 2, 12)
TRUTH = {"height": 3.0, "decay": 0.7}


def exponential(values: np.ndarray, noise: float = 0.0) -> Modelled:
    a, b = values
    value = a * np.exp(-b * X)
    return Modelled(value, noise**2 * np.eye(len(X)), np.stack([value / a, -X * value], axis=1))


class TestFit:
    """A sum of squares whose minimum is known."""

    def test_exact_data_give_the_truth(self):
        found = fit(
            exponential, exponential(np.array([3.0, 0.7])).value, np.full(12, 0.01), {"height": 30, "decay": 0.05}
        )
        assert found.value == pytest.approx([3.0, 0.7], rel=1e-4)
        assert found.chi_square < 1e-3
        assert found.degrees == 10

    def test_regions_hold_the_truth_as_often_as_they_say(self):
        """400 draws at 95 %: 380 ± 4.4 expected, 362 or less with a probability of 1e-4."""
        rng, inside, distances = np.random.default_rng(3), 0, []
        spread = 0.05
        for _ in range(400):
            data = exponential(np.array([3.0, 0.7])).value + np.hypot(spread, 0.03) * rng.standard_normal(12)
            found = fit(
                lambda values: exponential(values, 0.03), data, np.full(12, spread), {"height": 2.0, "decay": 1.0}
            )
            inside += found.covers(TRUTH)
            distances.append(found.distance(TRUTH))
        assert 362 <= inside <= 396
        # Mean of χ² with 2 degrees: 2 ± 0.1; a covariance that is wrong by a factor of 1.5 is seen
        assert np.mean(distances) == pytest.approx(2.0, abs=0.4)

    def test_a_wrong_jacobian_is_seen(self):
        """The same with the derivative by the decay 1.5 times too large: regions are too small."""

        def wrong(values: np.ndarray) -> Modelled:
            right = exponential(values)
            return Modelled(right.value, right.covariance, right.jacobian * [1.0, 1.5])

        rng, distances = np.random.default_rng(4), []
        for _ in range(200):
            data = exponential(np.array([3.0, 0.7])).value + 0.05 * rng.standard_normal(12)
            distances.append(fit(wrong, data, np.full(12, 0.05), {"height": 2.5, "decay": 0.8}).distance(TRUTH))
        assert np.mean(distances) > 2.4

    def test_bad_input_is_one_clear_line(self):
        data, start = np.ones(12), {"height": 1.0, "decay": 1.0}
        with pytest.raises(MistrayError, match="standard error of 0"):
            fit(exponential, data, np.zeros(12), start)
        with pytest.raises(MistrayError, match="above 0"):
            fit(exponential, data, np.ones(12), {"height": -1.0, "decay": 1.0})
        with pytest.raises(MistrayError, match="2 observed numbers for 2 parameters"):
            fit(exponential, data[:2], np.ones(2), start)
        with pytest.raises(MistrayError, match="shape"):
            fit(exponential, data, np.ones(3), start)
        with pytest.raises(MistrayError, match="12 numbers for 11"):
            fit(exponential, data[:11], np.ones(11), start)

        def twins(values: np.ndarray) -> Modelled:
            return Modelled(values.sum() * X + 1, np.zeros((12, 12)), np.stack([X, X], axis=1))

        with pytest.raises(MistrayError, match="do not tell height, decay apart"):
            fit(twins, data, np.ones(12), start)


KEYS = ("polish.rms_nm", "dust.level", "black.reflectance")
SETTINGS: dict[str, Any] = {"azimuths_deg": (0, 180), "rays": 2000, "max_scatters": 1, "seed": 5}


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("lens_and_screen")


class TestPstBands:
    """The derivatives of a curve from one replay."""

    @pytest.mark.long
    def test_jacobian_is_that_of_single_numbers(self, scene):
        """Each row against `mistray.gradient` of that cell alone: the same rays, another way of adding them up."""
        import mitsuba as mi

        bands = PstBands(scene, KEYS, (20, 22, 24), cell_deg=2.0, **SETTINGS)
        found = bands(bands.start)
        assert bands.bands == [(0, 20.0, 22.0), (180, 20.0, 22.0), (0, 22.0, 24.0), (180, 22.0, 24.0)]
        for row, (azimuth, low, high) in enumerate(bands.bands):
            metric = pst_bin(
                scene, (low + high) / 2, azimuth_deg=azimuth, pst_field_deg=(21.0, 23.0), cell_deg=2.0, **SETTINGS
            )
            expected = mistray.gradient(metric, mi.traverse(scene), KEYS)
            assert found.value[row] == pytest.approx(expected.value, rel=1e-6)
            derivatives = [expected.gradient[key][0] for key in KEYS]
            assert found.jacobian[row] == pytest.approx(derivatives, rel=1e-5, abs=1e-6 * expected.value)
            assert np.sqrt(found.covariance[row, row]) == pytest.approx(expected.value_se, rel=1e-6)

    def test_means_over_bands(self, scene):
        """A band of several cells is the mean over the solid angle, and light is added up."""
        narrow = PstBands(scene, KEYS, (20, 22, 24), cell_deg=2.0, **SETTINGS)
        wide = PstBands(scene, KEYS, (20, 24), cell_deg=2.0, **SETTINGS)
        solid = -np.diff(np.cos(np.radians([20, 22, 24])))
        parts = narrow.measure(narrow.start)[0].reshape(2, 2)
        assert wide.measure(wide.start)[0] == pytest.approx(solid @ parts / solid.sum(), rel=1e-6)

    def test_bad_input_is_one_clear_line(self, scene):
        with pytest.raises(MistrayError, match="multiples of cell_deg"):
            PstBands(scene, KEYS, (4, 6.5, 9))
        with pytest.raises(MistrayError, match=r"polish\.rms_nm"):
            PstBands(scene, ("polish.rms",), (4, 6))
        seen = PstBands(scene, KEYS, (20, 22), cell_deg=2.0, **SETTINGS).observe((1.5, 300, 0.04)).pst
        request = GradientRequest(scatter=True, edge_widths=(0.05, 0.025))
        with pytest.raises(MistrayError, match="edges=False"):
            next(seen.table_gradients(np.ones((5, 1, 2)), request, np.zeros((1, 2), dtype=int)))


@pytest.fixture(scope="module")
def example():
    """The example: data and model have rays of their own in each draw."""
    file = Path(__file__).parents[2] / "examples" / "fit_pst.py"
    spec = importlib.util.spec_from_file_location("fit_pst", file)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


@pytest.mark.long
@pytest.mark.validation
def test_truth_is_near_in_four_draws(example):
    """χ² of 12 degrees of freedom is beyond 32.9 with a probability of 1e-3; half the covariance doubles it."""
    assert sum(example.estimate(draw).distance(example.TRUTH) for draw in range(4)) < 32.9


@pytest.mark.slow
@pytest.mark.validation
def test_truth_lies_in_the_region_in_18_of_20_draws(example):
    """
    The issue asks for 18 of 20 at 95 %: a right covariance fails that with a probability of 7.5 % (binomial), one that
    gives 91 %, as 80 draws say, with 27 %; seeds are fixed. Half the covariance gives 73 % and fails with 94 %.
    """
    fits = [example.estimate(draw) for draw in range(example.DRAWS)]
    assert sum(found.covers(example.TRUTH) for found in fits) >= 18
    # Mean of 20 values of χ² with 3 degrees of freedom: 3 ± 0.55
    assert np.mean([found.distance(example.TRUTH) for found in fits]) < 3 + 3 * 0.55

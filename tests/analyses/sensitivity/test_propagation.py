"""Linear propagation of tolerances: closed forms, groups, and its errors against their spread."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.analyses.sensitivity.propagation import propagate

BATCHES = 32


def batches(changes, noise=0.0, seed=0) -> np.ndarray:
    """Parts whose sums have the given means, and noise of the given standard deviation each."""
    generator = np.random.default_rng(seed)
    changes = np.asarray(changes, dtype=float)
    return changes / BATCHES + noise / np.sqrt(BATCHES) * generator.standard_normal((BATCHES, len(changes)))


def test_closed_forms() -> None:
    """3² + 4² = 5²; what varies together adds with its signs, (3 - 4)² + 2²; and no change at all."""
    spread = propagate(["a", "b", "c"], batches([3.0, -4.0, 0.0]))
    assert spread.variance == pytest.approx((25.0, 0.0))
    assert spread.deviation == pytest.approx((5.0, 0.0))
    assert [item.name for item in spread.contributions] == ["b", "a", "c"]
    assert [item.share.value for item in spread.contributions] == pytest.approx([16 / 25, 9 / 25, 0])
    spread = propagate(["a", "b", "c"], batches([3.0, -4.0, 2.0]), [("a and b", [0, 1])])
    assert spread.variance.value == pytest.approx(5.0)
    names = {item.name: item for item in spread.contributions}
    assert names["a and b"].members == ("a", "b")
    assert names["a and b"].change.value == pytest.approx(-1.0)
    assert names["c"].share.value == pytest.approx(0.8)
    spread = propagate(["a"], batches([0.0]))
    assert spread.variance.value == spread.deviation.value == 0
    assert np.isnan(spread.contributions[0].share.value)


def test_the_error_of_the_metric() -> None:
    """All s are divided by the metric: with 1 % in it the standard deviation has 1 %, too, and 1e-4 of V are noise."""
    of_metric = np.tile([1.0, -1.0], BATCHES // 2) * 0.01 * np.sqrt((BATCHES - 1) / BATCHES) / np.sqrt(BATCHES)
    spread = propagate(["a", "b"], np.outer(1 / BATCHES - of_metric, [3.0, 4.0]))
    assert spread.variance.value == pytest.approx(25 * (1 - 1e-4))
    assert spread.deviation == pytest.approx((5.0, 0.05), rel=1e-4)
    assert spread.contributions[0].change == pytest.approx((4.0, 0.04))


def test_noise_does_not_add_up() -> None:
    """200 parameters of which one counts: V = 1 within 4.5 of its errors, over 100 draws on average within 4.5 σ/10.

    False-alarm probability 1e-5 for both together. Uncorrected the noise would be 200 · 0.1² = 2.
    """
    changes = np.zeros(200)
    changes[7] = 1.0
    found = [propagate([str(k) for k in range(200)], batches(changes, 0.1, seed)) for seed in range(100)]
    values = np.array([spread.variance for spread in found])
    assert abs(values[0, 0] - 1) < 4.5 * values[0, 1]
    assert abs(values[:, 0].mean() - 1) < 0.45 * values[:, 0].std()
    assert found[0].noise == pytest.approx(2.0, rel=0.2)


def test_standard_errors() -> None:
    """The spread over 300 draws is the error: χ² with 299 degrees of freedom, false-alarm probability 1e-6 a side."""
    found = [propagate(["a", "b", "c"], batches([1.0, -4.0, 0.5], 0.2, seed), [("g", [1, 2])]) for seed in range(300)]
    values = np.array([[*spread.variance, *spread.contributions[0].change] for spread in found])
    for value, se in ((0, 1), (2, 3)):
        ratio = values[:, value].var(ddof=1) / np.mean(values[:, se] ** 2)
        assert 0.65 < ratio < 1.48, ratio

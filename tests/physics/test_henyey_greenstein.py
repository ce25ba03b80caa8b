"""The phase function against float64 test vectors, its norm, its mean cosine, and its samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from vectors import frame

from mistray.physics.henyey_greenstein import phase_function, sampled_cosine


def test_vectors() -> None:
    table = frame("hg_phase.csv")
    np.testing.assert_allclose(phase_function(table["cos"], table["g"]), table["p_per_sr"], rtol=1e-12)


@pytest.mark.parametrize("g", [-0.7, 0.0, 0.3, 0.9])
def test_norm_and_mean_cosine(g: float) -> None:
    def moment(power: int) -> float:
        return 2 * np.pi * quad(lambda c: c**power * float(phase_function(c, g)), -1, 1, points=[np.sign(g)])[0]

    assert moment(0) == pytest.approx(1, rel=1e-7)
    assert moment(1) == pytest.approx(g, abs=1e-7)


@pytest.mark.parametrize("g", [-0.7, 0.0, 1e-4, 0.3, 0.9])
def test_samples_invert_the_distribution(g: float) -> None:
    """P(cos < c) of the sample of u is u."""
    for u in (0.01, 0.2, 0.5, 0.9):
        cosine = float(sampled_cosine(u, g))
        share = 2 * np.pi * quad(lambda c: float(phase_function(c, g)), -1, cosine)[0]
        assert share == pytest.approx(u, abs=1e-4)  # below |g| = 1e-3 the direction is uniform

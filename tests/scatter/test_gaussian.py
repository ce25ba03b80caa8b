"""The Gaussian model: lobes, totals at all angles, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import scatter_integrals

from mistray.errors import MistrayError
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.total import lobe_total

QUADRATURE = 1e-4  # relative, as required


@pytest.mark.parametrize("width", [1e-3, 0.05, 0.5, 3.0])
def test_total(width: float) -> None:
    cos_i = np.array([1.0, 0.7, 0.1])
    flat = math.pi * width**2 * -math.expm1(-1 / width**2)

    def profile(r: np.ndarray) -> np.ndarray:
        return 0.2 / flat * np.exp(-((r / width) ** 2))

    for lobe in Gaussian(0.2, width).lobes(550.0, 1.0, 1.5, True):
        n = 1.0 if lobe.event == "reflection" else 1.5
        expected = [scatter_integrals.total_scatter(profile, math.sqrt(1 - c * c) / n) for c in cos_i]
        assert expected[0] == pytest.approx(0.2, rel=1e-6)
        np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, 1.5), expected, rtol=QUADRATURE)


def test_events() -> None:
    assert Gaussian(0.0, 0.1).lobes(550.0, 1.0, 1.5, True) == ()
    assert [lobe.event for lobe in Gaussian(0.1, 0.1, event="reflection").lobes(550.0, 1.0, 1.5, False)] == [
        "reflection"
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-0.1, 0.1), "total is -0.1; it must lie between 0 and 1"),
        ((1.1, 0.1), "total is 1.1"),
        ((math.nan, 0.1), "total is nan"),
        ((0.1, 0.0), "width is 0; it must lie"),
    ],
)
def test_refuses(arguments: tuple[float, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        Gaussian(*arguments)


def test_advice() -> None:
    assert Gaussian(0.1, 0.5).advice() is None
    assert "TIS is 0.95" in str(Gaussian(0.95, 0.5).advice())
    assert "width 2" in str(Gaussian(0.1, 2.0).advice())

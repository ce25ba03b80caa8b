"""Coatings without a recipe: bare surfaces and constant shares, from both sides, in dielectrics and metals."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.coatings import Bare, Ideal
from mistray.coatings.response import total_reflection
from mistray.errors import MistrayError

pytestmark = pytest.mark.quick

COSINES = np.cos(np.radians(np.concatenate([np.linspace(0, 89.9, 60), [90.0]])))
GLASS, METAL = 1.5168 + 0j, 0.958 + 6.69j


def test_grazing_light_is_finite() -> None:
    """What bare surfaces reflect is compared with `tmm` in test_stack.py, in test_fresnel.py with vectors."""
    for front, back in ((1 + 0j, GLASS), (GLASS, 1 + 0j), (1.2 + 0j, METAL), (1 + 0j, 1 + 0j)):
        grazing = Bare().response(550.0, front, back, np.array([0.0, 1e-12, 0.5]), True)
        np.testing.assert_allclose(grazing.R + grazing.T, 1.0, atol=1e-12)


def test_absorption_of_the_medium_in_front_is_booked_along_the_ray() -> None:
    """R + T > 1 is possible for waves that decay along their way; only the real part of their index counts."""
    grey = Bare().response(550.0, 1.5 + 0.01j, 1 + 0j, COSINES, True)
    clear = Bare().response(550.0, 1.5 + 0j, 1 + 0j, COSINES, True)
    np.testing.assert_array_equal(grey.R, clear.R)
    np.testing.assert_array_equal(grey.T, clear.T)
    assert grey.A.min() > -1e-12


def test_ideal_shares() -> None:
    """The same everywhere; beyond the critical angle what would be transmitted is reflected too."""
    front, back = (Ideal(0.3, 0.5).response(550.0, 1 + 0j, GLASS, COSINES, side) for side in (True, False))
    for found, expected in ((front.R, 0.3), (front.T, 0.5), (front.A, 0.2), (front.phase_r, np.pi), (front.phase_t, 0)):
        np.testing.assert_allclose(found, expected)
    beyond = total_reflection(1 + 0j, GLASS, COSINES, False)
    assert beyond.sum() > 20
    assert not total_reflection(1 + 0j, GLASS, COSINES, True).any()
    np.testing.assert_allclose(back.R[beyond], 0.8)
    np.testing.assert_allclose(back.T[beyond], 0.0)
    np.testing.assert_allclose(back.T[~beyond], 0.5)
    assert Ideal(0.3, 0.0).opaque
    assert not Ideal(0.3, 0.1).opaque


@pytest.mark.parametrize(("r", "t"), [(0.6, 0.5), (-0.1, 0.5), (0.1, -0.2), (float("nan"), 0.0)])
def test_bad_shares(r: float, t: float) -> None:
    with pytest.raises(MistrayError, match=r"coating 'x': R = .* and T = .*R \+ T must not exceed 1"):
        Ideal(r, t, "x")

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


def fresnel(n_1: complex, n_2: complex, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r_s and r_p of the E field with the signs of Byrnes: Born & Wolf 1.5.2 with r_p turned round."""
    sine2 = (n_1 / n_2) ** 2 * (1 - cosine.astype(complex) ** 2)
    inside = np.sqrt(1 - sine2)
    inside = np.where((n_2 * inside).imag < 0, -inside, inside)
    with np.errstate(invalid="ignore", divide="ignore"):
        r_s = (n_1 * cosine - n_2 * inside) / (n_1 * cosine + n_2 * inside)
        r_p = (n_2 * cosine - n_1 * inside) / (n_2 * cosine + n_1 * inside)
    return r_s, r_p


@pytest.mark.parametrize(("front", "back"), [(1 + 0j, GLASS), (GLASS, 1 + 0j), (1.2 + 0j, METAL), (1 + 0j, 1 + 0j)])
def test_bare_surfaces_follow_fresnel(front: complex, back: complex) -> None:
    r_s, r_p = fresnel(front, back, COSINES[:-1])
    own = Bare().response(550.0, front, back, COSINES[:-1], True)
    np.testing.assert_allclose(own.R, np.abs(np.stack([r_s, r_p], axis=1)) ** 2, atol=1e-12)
    strong = np.minimum(abs(r_s), abs(r_p)) > 1e-6  # at Brewster's angle there is no phase
    turn = np.exp(1j * own.phase_r[strong])
    np.testing.assert_allclose(turn, np.exp(1j * np.angle(r_s * r_p.conj()))[strong], atol=1e-9)


def test_bare_surfaces_lose_nothing_and_are_reciprocal() -> None:
    cosines = COSINES[:-1]  # at 90° the other side is the critical angle itself
    front = Bare().response(550.0, 1 + 0j, GLASS, cosines, True)
    np.testing.assert_allclose(front.R + front.T, 1.0, atol=1e-12)
    inside = np.sqrt(1 - (1 - cosines**2) / GLASS.real**2)
    back = Bare().response(550.0, 1 + 0j, GLASS, inside, False)
    np.testing.assert_allclose(back.T, front.T, atol=1e-12)
    np.testing.assert_allclose(back.R, front.R, atol=1e-12)


def test_total_reflection_is_total() -> None:
    beyond = total_reflection(GLASS, 1 + 0j, COSINES, True)
    assert beyond.sum() > 20
    own = Bare().response(550.0, GLASS, 1 + 0j, COSINES, True)
    np.testing.assert_allclose(own.R[beyond], 1.0, atol=1e-12)
    np.testing.assert_allclose(own.T[beyond], 0.0, atol=1e-12)
    assert not total_reflection(GLASS, 1 + 0j, COSINES, False).any()


def test_grazing_incidence_is_finite() -> None:
    for back in (1 + 0j, GLASS, METAL):
        own = Bare().response(550.0, 1.2 + 0j, back, np.array([0.0, 1e-12]), True)
        assert np.isfinite(own.R).all()
        assert np.isfinite(own.T).all()


def test_absorption_of_the_medium_in_front_is_booked_along_the_ray() -> None:
    """R + T > 1 is possible for waves that decay along their way; only the real part of their index counts."""
    grey = Bare().response(550.0, 1.5 + 0.01j, 1 + 0j, COSINES, True)
    clear = Bare().response(550.0, 1.5 + 0j, 1 + 0j, COSINES, True)
    np.testing.assert_array_equal(grey.R, clear.R)
    np.testing.assert_array_equal(grey.T, clear.T)
    assert grey.A.min() > -1e-12


def test_metals_reflect_what_the_reference_says() -> None:
    """Aluminium 0.958 + 6.69i at 550 nm: 92.1136 %."""
    own = Bare().response(550.0, 1 + 0j, METAL, np.array([1.0]), True)
    np.testing.assert_allclose(own.R, 0.921136, atol=5e-7)
    np.testing.assert_allclose(own.R + own.T, 1.0, atol=1e-12)


class TestIdeal:
    def test_the_same_everywhere(self) -> None:
        own = Ideal(0.3, 0.5).response(550.0, 1 + 0j, GLASS, COSINES, True)
        np.testing.assert_allclose(own.R, 0.3)
        np.testing.assert_allclose(own.T, 0.5)
        np.testing.assert_allclose(own.A, 0.2)
        np.testing.assert_allclose(own.phase_r, np.pi)
        np.testing.assert_allclose(own.phase_t, 0.0)

    def test_beyond_the_critical_angle_it_reflects_both(self) -> None:
        own = Ideal(0.3, 0.5).response(550.0, 1 + 0j, GLASS, COSINES, False)
        beyond = total_reflection(1 + 0j, GLASS, COSINES, False)
        np.testing.assert_allclose(own.R[beyond], 0.8)
        np.testing.assert_allclose(own.T[beyond], 0.0)
        np.testing.assert_allclose(own.T[~beyond], 0.5)

    def test_opaque(self) -> None:
        assert Ideal(0.3, 0.0).opaque
        assert not Ideal(0.3, 0.1).opaque

    @pytest.mark.parametrize(("r", "t"), [(0.6, 0.5), (-0.1, 0.5), (0.1, -0.2), (float("nan"), 0.0), (1.1, 0.0)])
    def test_bad_shares(self, r: float, t: float) -> None:
        with pytest.raises(MistrayError, match=r"coating 'x': R = .* and T = .*R \+ T must not exceed 1"):
            Ideal(r, t, "x")


def test_coatings_are_keys() -> None:
    """Tables are cached by coating: equal ones are one key."""
    assert len({Bare(), Bare(), Ideal(0.1, 0.9), Ideal(0.1, 0.9), Ideal(0.1, 0.8)}) == 3

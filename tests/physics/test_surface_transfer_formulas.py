"""Harvey's surface transfer function: correlations against transforms of their spectra, and the lag by real rays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.scatter_integrals import gauss_legendre
from scipy import special

from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import k_correlation as spectra
from mistray.physics.imaging import surface_transfer as st

pytestmark = pytest.mark.quick

LENGTH_UM = 7.0
LAGS_UM = np.array([0.0, 0.01, 0.3, 2.0, 9.0, 40.0])


def hankel(spectrum, lag: float, highest: float) -> float:
    """∫ 2π f PSD(f) J0(2π f s) df between the zeros of J0."""
    if lag == 0:
        edges = np.array([0.0, *np.geomspace(1e-4, highest, 40)])
    else:
        zeros = special.jn_zeros(0, 2000) / (2 * math.pi * lag)
        edges = np.concatenate([[0.0], zeros[zeros < highest], [highest]])
        edges = np.unique(np.concatenate([edges, np.geomspace(1e-4, highest, 40)]))
    f, weight = gauss_legendre(edges, 12)
    return float(np.sum(weight * 2 * math.pi * f * spectrum(f) * special.j0(2 * math.pi * f * lag)))


@pytest.mark.parametrize("slope", [2.4, 3.0, 4.7])
def test_the_correlation_of_k_correlation_is_the_transform_of_its_spectrum(slope):
    def spectrum(f):
        return spectra.psd_um4(f, spectra.amplitude_um4(1.0, LENGTH_UM, slope), LENGTH_UM, slope)

    # Beyond the highest frequency F of the quadrature the spectrum holds (B F)^(2-S) of the variance
    highest = 40.0
    left = (1 + (LENGTH_UM * highest) ** 2) ** (1 - slope / 2)
    for lag in LAGS_UM:
        found = hankel(spectrum, lag, highest)
        assert st.k_correlation(lag, LENGTH_UM, slope) == pytest.approx(found, abs=left + 1e-8)


def test_a_slope_of_3_is_the_exponential_correlation():
    expected = st.exponential_correlation(LAGS_UM, LENGTH_UM / (2 * math.pi))
    np.testing.assert_allclose(st.k_correlation(LAGS_UM, LENGTH_UM, 3.0), expected, rtol=1e-12)


def test_a_large_slope_and_a_large_lag_stay_finite():
    found = st.k_correlation(np.array([0.0, 1e-12, 1e-3, 1.0, 1e9]), 5.0, 90.0)
    assert np.all(np.isfinite(found))
    assert np.all(np.diff(found) <= 1e-12)
    assert (found[0], found[-1]) == (1, 0)


def test_the_correlation_of_a_gaussian_is_the_transform_of_its_spectrum():
    def spectrum(f):
        return math.pi * LENGTH_UM**2 * np.exp(-((math.pi * LENGTH_UM * f) ** 2))

    for lag in LAGS_UM:
        assert st.gaussian_correlation(lag, LENGTH_UM) == pytest.approx(hankel(spectrum, lag, 3.0), abs=1e-9)


def test_it_begins_at_1_and_ends_at_the_share_that_is_not_scattered():
    a = float(ghs.phase_variance(ghs.path_in_reflection(0.8, 0.8), 0.02, 0.5))
    assert a == pytest.approx((4 * math.pi * 0.02 * 0.8 / 0.5) ** 2)
    found = st.surface_transfer(st.exponential_correlation(np.array([0.0, 1e9]), LENGTH_UM), a)
    np.testing.assert_allclose(found, [1.0, math.exp(-a)], rtol=1e-14)


def test_rings_have_the_transform_of_a_disc():
    radii = np.array([0.0, 0.1, 0.4, 1.0])
    flux = np.diff(radii**2)
    q = np.array([0.0, 1e-6, 1e-3, 0.2, 3.0, 50.0])
    x = 2 * math.pi * q
    expected = np.where(q > 0, 2 * special.j1(x) / np.where(x > 0, x, 1), 1)
    np.testing.assert_allclose(st.ring_transform(radii[:-1], radii[1:], flux, q), expected, atol=1e-10)


@pytest.mark.parametrize(("before", "after"), [(0.0, 90.0), (25.0, 60.0)])
def test_the_lag_is_that_of_rays_turned_at_the_surface(before, after):
    """
    A surface anywhere before a lens: B of the lag against the place where a ray lands that it turns.

    The lens, of focal length f, stands `before` behind the surface, the image in its focus, where the beam is parallel
    in front of it; or beside it, for a beam that converges already.
    """
    f, half = 90.0, 6.0
    # The beam of the image point on the axis, backwards from the image: its height at the surface per unit of aperture
    lens = np.array([[1.0, 0.0], [-1 / f, 1.0]])

    def gap(z):
        return np.array([[1.0, z], [0.0, 1.0]])

    system = gap(after) @ lens @ gap(before)
    turned = 1e-6
    landed = (system @ [0.0, turned])[0]
    slope = -system[0, 0] / system[0, 1] * half  # of the ray at the edge of the footprint, so that it meets the image
    aperture = abs((system @ [half, slope])[1])
    n = 1 / (2 * aperture)
    assert (system @ [half, slope])[0] == pytest.approx(0, abs=1e-12)
    lag = st.lag_um(50.0, 0.6, n, 2 * half)
    # A turn of λ f of the direction moves the image by λ f B: f = s-conjugate of ν means s = λ B ν
    assert lag == pytest.approx(0.6 * abs(landed / turned) * 50.0, rel=1e-12)
    # and at the cut-off of diffraction it is the footprint
    assert st.lag_um(1 / (0.6e-3 * n), 0.6, n, 2 * half) * 1e-3 == pytest.approx(2 * half, rel=1e-12)

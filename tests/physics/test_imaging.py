"""Pupils whose images have closed forms, and Harvey's surface transfer function against transforms and real rays."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from oracles import ideal_images
from oracles.scatter_integrals import gauss_legendre
from refusals import each_refused
from scipy import special

from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import k_correlation as spectra
from mistray.physics.imaging import ideal
from mistray.physics.imaging import surface_transfer as st
from mistray.physics.imaging.pupil import Pupil
from mistray.physics.imaging.zernike_fit import fit_zernikes

pytestmark = pytest.mark.quick

WAVELENGTH_MM, F_NUMBER = 550e-6, 2.2
NA = 0.5 / F_NUMBER
CUT_OFF = ideal_images.cut_off(WAVELENGTH_MM, F_NUMBER)


def disc(cells=128, obstruction=0.0, w20=0.0, curvature=0.0, parts=8):
    """A circular pupil about the axis, each cell at the rim by its share."""
    step = 2 * NA * 1.03 / cells
    axis = (np.arange(cells) - (cells - 1) / 2) * step
    fine = (axis[:, None] + step * ((np.arange(parts) + 0.5) / parts - 0.5)).ravel()
    r = np.hypot(*np.meshgrid(fine, fine)) / NA
    share = ((r < 1) & (r >= obstruction)).reshape(cells, parts, cells, parts).mean(axis=(1, 3))
    x, y = np.meshgrid(axis, axis)
    opd = np.where(share > 0, w20 * (x * x + y * y) / NA**2, 0.0)
    return Pupil(WAVELENGTH_MM, 1.0, step, axis, axis, np.ones((cells, cells)), share, opd, curvature)


def test_airy_pattern():
    """The first dark ring has 2.44 λN, 2.952 µm; 83.8 % lie within."""
    diameter = ideal.airy_diameter(WAVELENGTH_MM, F_NUMBER)
    assert diameter == pytest.approx(2.952e-3, abs=1e-6)
    pupil, r = disc(), np.linspace(0, 3e-3, 61)
    psf = pupil.psf(r, [0.0])[0]
    assert psf == pytest.approx(ideal_images.airy_irradiance(r, WAVELENGTH_MM, F_NUMBER), abs=2e-4 * psf[0])
    fine = np.linspace(0.45, 0.55, 1001) * diameter
    assert fine[np.argmin(pupil.psf(fine, [0.0])[0])] == pytest.approx(diameter / 2, rel=1e-3)
    radii = np.array([0.5, 1.5, 5.0]) * diameter
    shares = pupil.encircled(radii)
    assert shares == pytest.approx(ideal_images.airy_encircled(radii, WAVELENGTH_MM, F_NUMBER), abs=5e-4)
    assert shares[0] == pytest.approx(0.838, abs=5e-4)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 34.0])
@pytest.mark.parametrize("obstruction", [0.0, 0.4])
def test_transfer_function(obstruction, azimuth_deg):
    pupil, share = disc(obstruction=obstruction), np.linspace(0, 1.1, 45)
    x, y = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    found = pupil.otf(share * CUT_OFF * x, share * CUT_OFF * y)
    assert np.abs(found) == pytest.approx(ideal_images.annular_mtf(share, obstruction), abs=1e-3)
    assert found[0] == pytest.approx(1.0, abs=1e-12)
    assert pupil.cut_off((x, y)) == pytest.approx(CUT_OFF, rel=2e-3 if azimuth_deg in (0, 90) else 0.01)
    slit = replace(pupil, share=0.3 * (pupil.alpha == pupil.alpha[9]) * np.ones_like(pupil.share))
    assert slit.cut_off((1, 0)) == pytest.approx(0.3 * pupil.step / WAVELENGTH_MM)  # 30 % of one column


def test_defocus_and_tilt():
    """Strehl is sinc² of the defocus, and the best focus is where it was before."""
    for waves in (0.25, 0.6, 1.0):
        pupil = disc(w20=waves)
        strehl = ideal_images.defocused_strehl(waves)
        assert pupil.psf([0], [0])[0, 0] / pupil.ideal_peak() == pytest.approx(strehl, abs=5e-4)
    # A shift of the image by dz leaves the wavefront -dz γ/λ
    moved = disc().moved(0.004)
    assert moved.best_focus_mm() == pytest.approx(-0.004, rel=1e-9)
    assert moved.rms_waves("focus") == pytest.approx(0, abs=1e-9)
    assert moved.rms_waves() == pytest.approx(0.004 * NA**2 / 2 / WAVELENGTH_MM / np.sqrt(12), rel=0.03)
    pupil, dx = disc(), 2e-3
    a, _ = np.meshgrid(pupil.alpha, pupil.beta)
    tilted = replace(pupil, opd_waves=np.where(pupil.lit, a * dx / WAVELENGTH_MM, 0.0))
    assert tilted.psf([dx], [0])[0, 0] == pytest.approx(pupil.psf([0], [0])[0, 0], rel=1e-12)
    f = np.array([100.0, 300.0])
    assert tilted.otf(f, 0 * f) == pytest.approx(pupil.otf(f, 0 * f) * np.exp(-2j * np.pi * f * dx), abs=1e-3)
    assert tilted.encircled([1e-3], (dx, 0.0)) == pytest.approx(pupil.encircled([1e-3]), abs=1e-6)
    pupil = disc(64, w20=1.3)
    period = 1 / pupil.frequency_step
    at = period * (np.arange(192) / 192 - 0.5)
    total = pupil.psf(at, at).sum() * (at[1] - at[0]) ** 2
    # Cells that are partly lit count by the square of their share in the PSF
    assert total == pytest.approx((pupil.share**2).sum() / pupil.share.sum(), rel=1e-9)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 34.0])
def test_transfer_function_of_an_image_aside(azimuth_deg):
    """An image at (x, y) has that of one at the origin times exp(-2πi f·r), also between the samples of the pupil."""
    pupil, cosines = disc(64, w20=2.0), np.meshgrid(*2 * [disc(64).alpha])
    x, y = np.array([0.3, -0.2]) / pupil.frequency_step
    opd = np.where(pupil.lit, pupil.opd_waves + (x * cosines[0] + y * cosines[1]) * pupil.scale, 0.0)
    share = np.linspace(0, 0.6, 90)
    fx, fy = (share * CUT_OFF * part(np.radians(azimuth_deg)) for part in (np.cos, np.sin))
    found = replace(pupil, opd_waves=opd).otf(fx, fy)
    assert found == pytest.approx(pupil.otf(fx, fy) * np.exp(-2j * np.pi * (fx * x + fy * y)), abs=1e-9)


def test_slow_beams_huygens_and_zernike_fit():
    """I(z) = (R/(R + z))² sinc²(N z/(2 (R + z))), N = a²/(λR): Y. Li, E. Wolf, Opt. Commun. 39, 211 (1981)."""
    fresnel, na = 4.0, 1e-3
    radius = fresnel * WAVELENGTH_MM / na**2
    base = disc()
    scale = na / NA
    pupil = Pupil(WAVELENGTH_MM, 1.0, base.step * scale, base.alpha * scale, base.beta * scale, base.flux, base.share,
                  base.opd_waves, 1 / radius)  # fmt: skip
    z = np.linspace(-0.35, 0.2, 23) * radius
    points = np.stack([0 * z, 0 * z, z], axis=1)
    exact = (radius / (radius + z)) ** 2 * np.sinc(fresnel * z / (2 * (radius + z))) ** 2
    found = pupil.huygens(points) / pupil.ideal_peak()
    assert found == pytest.approx(exact, abs=2e-3)
    assert z[np.argmax(found)] < 0  # the brightest point lies before the focus
    debye = np.array([pupil.moved(dz).psf([0], [0])[0, 0] for dz in z]) / pupil.ideal_peak()
    assert np.abs(debye - exact).max() > 0.1
    # The terms that differ are of the size of x²/(λR)
    at = np.linspace(-4e-3, 4e-3, 9)
    points = np.stack([*np.meshgrid(at, at), np.zeros((9, 9))], axis=-1).reshape(-1, 3)
    for curvature in (0.0, 1e-2):
        pupil = disc(64, w20=0.4, curvature=curvature)
        peak = pupil.ideal_peak()
        assert pupil.huygens(points).reshape(9, 9) / peak == pytest.approx(pupil.psf(at, at) / peak, abs=1e-4)
    # Coefficients come back, over the full disc and over a part of it, whatever the kind
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (4000, 2))
    points = points[np.hypot(*points.T) < 1]
    r2 = (points**2).sum(axis=1)
    # r⁴ = R40/6 + R20/2 + 1/3
    for kind, terms, number, amount in (("noll", 22, 11, 1 / (6 * np.sqrt(5))), ("fringe", 16, 9, 1 / 6)):
        fit = fit_zernikes(points, r2**2, np.ones(len(points)), kind, terms)
        assert fit.coefficients[number - 1] == pytest.approx(amount, abs=1e-12)
        assert fit.names[number - 1] == "spherical"
        assert fit.residual_rms < 1e-12
        half = points[:, 0] > 0
        part = fit_zernikes(points[half], r2[half] ** 2, np.ones(half.sum()), kind, terms)
        assert part.coefficients == pytest.approx(fit.coefficients, abs=1e-9)
    each_refused(("noll", 300, "231"), ("zemax", "'zemax'"), by=partial(fit_zernikes, points, r2, r2))


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
    """For a slope of 3 the exponential one; a large slope and a large lag stay finite."""

    def spectrum(f):
        return spectra.psd_um4(f, spectra.amplitude_um4(1.0, LENGTH_UM, slope), LENGTH_UM, slope)

    # Beyond the highest frequency F of the quadrature the spectrum holds (B F)^(2-S) of the variance
    highest = 40.0
    left = (1 + (LENGTH_UM * highest) ** 2) ** (1 - slope / 2)
    found = st.k_correlation(LAGS_UM, LENGTH_UM, slope)
    assert found == pytest.approx([hankel(spectrum, lag, highest) for lag in LAGS_UM], abs=left + 1e-8)
    if slope == 3:
        exponential = st.exponential_correlation(LAGS_UM, LENGTH_UM / (2 * math.pi))
        np.testing.assert_allclose(found, exponential, rtol=1e-12)
    steep = st.k_correlation(np.array([0.0, 1e-12, 1e-3, 1.0, 1e9]), 5.0, 90.0)
    assert np.all(np.isfinite(steep) & (np.diff(steep, append=0.0) <= 1e-12))
    assert (steep[0], steep[-1]) == (1, 0)


def test_correlation_of_spectra_and_rings():
    def spectrum(f):
        return math.pi * LENGTH_UM**2 * np.exp(-((math.pi * LENGTH_UM * f) ** 2))

    for lag in LAGS_UM:
        assert st.gaussian_correlation(lag, LENGTH_UM) == pytest.approx(hankel(spectrum, lag, 3.0), abs=1e-9)
    a = float(ghs.phase_variance(ghs.path_in_reflection(0.8, 0.8), 0.02, 0.5))
    assert a == pytest.approx((4 * math.pi * 0.02 * 0.8 / 0.5) ** 2)
    found = st.surface_transfer(st.exponential_correlation(np.array([0.0, 1e9]), LENGTH_UM), a)
    np.testing.assert_allclose(found, [1.0, math.exp(-a)], rtol=1e-14)
    radii, q = np.array([0.0, 0.1, 0.4, 1.0]), np.array([0.0, 1e-6, 1e-3, 0.2, 3.0, 50.0])
    x = 2 * math.pi * q
    expected = np.where(q > 0, 2 * special.j1(x) / np.where(x > 0, x, 1), 1)
    found = st.ring_transform(radii[:-1], radii[1:], np.diff(radii**2), q)
    np.testing.assert_allclose(found, expected, atol=1e-10)


@pytest.mark.parametrize(("before", "after"), [(0.0, 90.0), (25.0, 60.0)])
def test_the_lag_is_that_of_rays_turned_at_the_surface(before, after):
    """A surface before a lens in whose focus the image is, or beside one: B of the lag by where a turned ray lands."""
    f, half = 90.0, 6.0
    lens = np.array([[1.0, 0.0], [-1 / f, 1.0]])
    gaps = [np.array([[1.0, z], [0.0, 1.0]]) for z in (after, before)]
    system = gaps[0] @ lens @ gaps[1]
    landed = system[0, 1]  # per unit of the turn
    slope = -system[0, 0] / landed * half  # of the ray at the edge of the footprint, so that it meets the image
    (height, aperture) = system @ [half, slope]
    n = 1 / (2 * abs(aperture))
    assert height == pytest.approx(0, abs=1e-12)
    # A turn of λ f of the direction moves the image by λ f B: f = s-conjugate of ν means s = λ B ν
    assert st.lag_um(50.0, 0.6, n, 2 * half) == pytest.approx(0.6 * abs(landed) * 50.0, rel=1e-12)
    assert st.lag_um(1 / (0.6e-3 * n), 0.6, n, 2 * half) * 1e-3 == pytest.approx(2 * half, rel=1e-12)

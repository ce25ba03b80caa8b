"""Pupils whose images have closed forms: Airy pattern, circular and annular transfer functions, defocus, tilt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.physics.imaging import ideal
from mistray.physics.imaging.pupil import Pupil
from mistray.physics.imaging.zernike_fit import fit_zernikes

pytestmark = pytest.mark.quick

WAVELENGTH_MM, F_NUMBER = 550e-6, 2.2
NA = 0.5 / F_NUMBER
CUT_OFF = ideal.cut_off(WAVELENGTH_MM, F_NUMBER)


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
    assert psf == pytest.approx(ideal.airy_irradiance(r, WAVELENGTH_MM, F_NUMBER), abs=2e-4 * psf[0])
    fine = np.linspace(0.45, 0.55, 1001) * diameter
    assert fine[np.argmin(pupil.psf(fine, [0.0])[0])] == pytest.approx(diameter / 2, rel=1e-3)
    radii = np.array([0.5, 1.5, 5.0]) * diameter
    shares = pupil.encircled(radii)
    assert shares == pytest.approx(ideal.airy_encircled(radii, WAVELENGTH_MM, F_NUMBER), abs=5e-4)
    assert shares[0] == pytest.approx(0.838, abs=5e-4)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 34.0])
@pytest.mark.parametrize("obstruction", [0.0, 0.4])
def test_transfer_function(obstruction, azimuth_deg):
    pupil, share = disc(obstruction=obstruction), np.linspace(0, 1.1, 45)
    x, y = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    found = pupil.otf(share * CUT_OFF * x, share * CUT_OFF * y)
    assert np.abs(found) == pytest.approx(ideal.annular_mtf(share, obstruction), abs=1e-3)
    assert found[0] == pytest.approx(1.0, abs=1e-12)
    assert pupil.cut_off((x, y)) == pytest.approx(CUT_OFF, rel=2e-3 if azimuth_deg in (0, 90) else 0.01)


def test_defocus():
    """Strehl is sinc² of the defocus, and the best focus is where it was before."""
    for waves in (0.25, 0.6, 1.0):
        pupil = disc(w20=waves)
        assert pupil.psf([0], [0])[0, 0] / pupil.ideal_peak() == pytest.approx(ideal.defocused_strehl(waves), abs=5e-4)
    # A shift of the image by dz leaves the wavefront -dz γ/λ
    moved = disc().moved(0.004)
    assert moved.best_focus_mm() == pytest.approx(-0.004, rel=1e-9)
    assert moved.rms_waves("focus") == pytest.approx(0, abs=1e-9)
    assert moved.rms_waves() == pytest.approx(0.004 * NA**2 / 2 / WAVELENGTH_MM / np.sqrt(12), rel=0.03)


def test_tilt_moves_the_image():
    pupil, dx = disc(), 2e-3
    a, _ = np.meshgrid(pupil.alpha, pupil.beta)
    tilted = replace(pupil, opd_waves=np.where(pupil.lit, a * dx / WAVELENGTH_MM, 0.0))
    assert tilted.psf([dx], [0])[0, 0] == pytest.approx(pupil.psf([0], [0])[0, 0], rel=1e-12)
    f = np.array([100.0, 300.0])
    assert tilted.otf(f, 0 * f) == pytest.approx(pupil.otf(f, 0 * f) * np.exp(-2j * np.pi * f * dx), abs=1e-3)
    assert tilted.encircled([1e-3], (dx, 0.0)) == pytest.approx(pupil.encircled([1e-3]), abs=1e-6)


def test_total_is_that_of_the_pupil():
    """The integral of the PSF over its period is 1 whatever the aberration: Parseval."""
    pupil = disc(64, w20=1.3)
    period = 1 / pupil.frequency_step
    at = period * (np.arange(192) / 192 - 0.5)
    total = pupil.psf(at, at).sum() * (at[1] - at[0]) ** 2
    # Cells that are partly lit count by the square of their share in the PSF
    assert total == pytest.approx((pupil.share**2).sum() / pupil.share.sum(), rel=1e-9)


def test_focal_shift_of_a_slow_beam():
    """
    Huygens' sum on the axis against the closed form of small Fresnel numbers, which the Fourier transform has not.

    I(z) = (R/(R + z))² sinc²(N z/(2 (R + z))) for N = a²/(λR): Y. Li, E. Wolf, "Focal shifts in diffracted converging
    spherical waves", Opt. Commun. 39, 211 (1981).
    """
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


def test_huygens_is_the_fourier_transform_where_the_pupil_is_far():
    """The terms that differ are of the size of x²/(λR)."""
    at = np.linspace(-4e-3, 4e-3, 9)
    points = np.stack([*np.meshgrid(at, at), np.zeros((9, 9))], axis=-1).reshape(-1, 3)
    for curvature in (0.0, 1e-2):
        pupil = disc(64, w20=0.4, curvature=curvature)
        peak = pupil.ideal_peak()
        assert pupil.huygens(points).reshape(9, 9) / peak == pytest.approx(pupil.psf(at, at) / peak, abs=1e-4)


def test_zernike_fit():
    """Coefficients come back, over the full disc and over a part of it, whatever the kind."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (4000, 2))
    points = points[np.hypot(*points.T) < 1]
    r2 = (points**2).sum(axis=1)
    for kind, terms, spherical in (("noll", 22, (11, 1 / (6 * np.sqrt(5)))), ("fringe", 16, (9, 1 / 6))):
        fit = fit_zernikes(points, r2**2, np.ones(len(points)), kind, terms)
        number, amount = spherical  # r⁴ = R40/6 + R20/2 + 1/3
        assert fit.coefficients[number - 1] == pytest.approx(amount, abs=1e-12)
        assert fit.names[number - 1] == "spherical"
        assert fit.residual_rms < 1e-12
        half = points[:, 0] > 0
        part = fit_zernikes(points[half], r2[half] ** 2, np.ones(half.sum()), kind, terms)
        assert part.coefficients == pytest.approx(fit.coefficients, abs=1e-9)
    with pytest.raises(MistrayError, match="231"):
        fit_zernikes(points, r2, r2, "noll", 300)
    with pytest.raises(MistrayError, match="'zemax'"):
        fit_zernikes(points, r2, r2, "zemax")

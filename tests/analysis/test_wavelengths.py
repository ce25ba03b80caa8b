"""Several wavelengths in one analysis, traced for real: weights, independence of the lines, standard errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from oracles.statistics import assert_z

import mistray
from mistray.prescription import Detector, Prescription, Source, Surface

LINES = {450.0: 1.0, 550.0: 2.0, 650.0: 1.0}
RAYS = 8000


def singlet(pixels=(40, 40)):
    """A dense flint lens: strong dispersion, two-reflection ghost inside of it; the stop is the lens."""
    glass = "N-SF5"
    front = Surface("L1_front", radius=40.0, semi_diameter=6.0, back=glass, part="L1")
    rear = Surface("L1_rear", z=3.0, radius=-40.0, semi_diameter=6.0, front=glass, part="L1")
    return Prescription(
        name="singlet",
        surfaces=(front, rear),
        detector=Detector(z=30.0, half_width=20.0, half_height=20.0, pixels=pixels),
        source=Source(radius=5.0, field_deg=5.0),
    )


@pytest.fixture(scope="module")
def scene():
    return singlet().to_scene()


def analyse(scene, seed=0, **options):
    spectrum = {"wavelength_nm": list(LINES), "weights": list(LINES.values())}
    return mistray.ghosts(scene, field_deg=[0.0], rays=RAYS, seed=seed, **(spectrum | options))


@pytest.fixture(scope="module")
def report(scene):
    return analyse(scene)


def ghost_of(report):
    table = report.table(0.0)
    (row,) = table[table.label == "L1_rear → L1_front"].itertuples(index=False)
    return row


def test_each_line_is_the_trace_at_its_wavelength(scene, report):
    """Powers by their share, centroids and radii unchanged; 3 lines × 3 numbers, false alarm 1e-6."""
    spectrum = report.spectrum(0.0, ghost_of(report).path_id)
    names, got, expected, error = [], [], [], []
    for row in spectrum.itertuples(index=False):
        alone = ghost_of(analyse(scene, seed=11, wavelength_nm=row.wavelength_nm, weights=None))
        share = LINES[row.wavelength_nm] / 4
        for name, factor in (("power", share), ("rms_radius", 1.0), ("rms_irradiance", share)):
            unit = {"power": "_W", "rms_radius": "_mm", "rms_irradiance": "_W_mm2"}[name]
            names.append(f"{name} at {row.wavelength_nm:g} nm")
            got.append(getattr(row, f"{name}{unit}"))
            expected.append(factor * getattr(alone, f"{name}{unit}"))
            errors = getattr(row, f"{name}_se{unit}"), factor * getattr(alone, f"{name}_se{unit}")
            error.append(math.hypot(*errors))
    assert_z("line of a polychromatic trace", got, expected, error, false_alarm=1e-6, names=names)


def test_the_ghost_of_all_lines_is_their_sum(report):
    ghost = ghost_of(report)
    image, _ = report[0.0].irradiance_of(ghost.path_ids)
    side = np.diff(report[0.0].extent[:2])[0] / image.shape[0]
    assert image.sum() * side**2 == pytest.approx(ghost.power_W, rel=1e-5)
    # Chromatic aberration widens an image: the root of the mean square of the radii of the lines, on axis
    table = report.table(0.0)
    direct = table[table.kind == "direct"].iloc[0]
    lines = report.spectrum(0.0, direct.path_id)
    centred = math.sqrt(float(np.average(lines.rms_radius_mm**2, weights=lines.power_W)))
    assert np.ptp(lines.rms_radius_mm) > 10 * lines.rms_radius_se_mm.max()
    assert direct.rms_radius_mm == pytest.approx(centred, rel=1e-3)
    # Energy closes at every wavelength, with the weights of the call or of the scene
    t = report[0.0]
    source = replace(singlet().source, wavelength_nm=tuple(LINES), weights=tuple(LINES.values()))
    own = mistray.ghosts(replace(singlet(), source=source).to_scene(), field_deg=[0.0], rays=100)
    for found in (report, own):
        assert [found.weight(wavelength) for wavelength in LINES] == pytest.approx([0.25, 0.5, 0.25])
    for wavelength in LINES:
        assert abs(t.energy_at(wavelength).closure) < 1e-5
    launched = sum(t.energy_at(wavelength).launched_W for wavelength in LINES)
    assert launched == pytest.approx(t.energy.launched_W, rel=1e-12)
    assert launched == pytest.approx(math.pi * 5.0**2, rel=1e-6)


@pytest.mark.long
def test_standard_errors_of_the_ghost_of_all_lines(scene):
    """40 seeds: Σz² against the common mean is χ² with 39 degrees of freedom; within 9.5 … 100, false alarm 1e-6.

    Three numbers, each with its own χ²; that of the radius and the irradiance comes from 16 batches, which widens the
    distribution of z by 1 + 1/15.
    """
    names = {
        "power_W": "power_se_W",
        "rms_radius_mm": "rms_radius_se_mm",
        "rms_irradiance_W_mm2": "rms_irradiance_se_W_mm2",
    }
    rows = [ghost_of(analyse(scene, seed=seed)) for seed in range(40)]
    for value, error in names.items():
        values = np.array([getattr(row, value) for row in rows])
        errors = np.array([getattr(row, error) for row in rows])
        chi2 = float(np.sum(((values - values.mean()) / errors) ** 2))
        assert 9.5 < chi2 < 100, f"{value}: χ² = {chi2:.1f} for 39 degrees of freedom"

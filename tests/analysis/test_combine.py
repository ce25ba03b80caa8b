"""Paths at all their wavelengths as one: exact numbers from known discs, errors by repeated experiments."""

import math

import numpy as np
import pandas as pd
import pytest
from report.fake_trace import DETECTOR_ABSORBS, LENS, FakePath, FakeTrace

from mistray.analysis.combine import by_path

EVENTS = f"{LENS} detector:A"
GHOST = f"{LENS} detector:R L1_rear:R detector:A"
# share of the power, x and radius of the disc in mm, at 450, 550, 650 nm
DISCS = {450.0: (1.0, -0.05, 0.08), 550.0: (3.0, 0.0, 0.1), 650.0: (2.0, 0.12, 0.14)}


def lines(rays=500):
    return [
        FakePath(EVENTS, share, rays, x, 0.02, radius, wavelength=wavelength)
        for wavelength, (share, x, radius) in DISCS.items()
    ]


def made(*more):
    return FakeTrace([*lines(), *more], shares=dict.fromkeys(DISCS, 1 / 3))


@pytest.fixture
def trace():
    return made()


def test_numbers_are_those_of_all_rays_together(trace):
    points = np.concatenate([path.points for path in trace.fakes])
    weights = np.concatenate([np.full(path.rays, path.power / path.rays) for path in trace.fakes])
    centre = np.average(points, axis=0, weights=weights)
    radius = math.sqrt(np.average(np.sum((points - centre) ** 2, axis=1), weights=weights))
    (got,) = by_path(trace.paths.by_way(), trace.paths).itertuples()
    assert got.power_W == pytest.approx(6.0, rel=1e-12)
    assert got.incident_W == pytest.approx(6.0 / DETECTOR_ABSORBS, rel=1e-12)
    assert got.percent == pytest.approx(100.0, rel=1e-12)
    assert got.rays == 1500
    assert (got.x_mm, got.y_mm) == pytest.approx(tuple(centre), rel=1e-9)
    assert got.rms_radius_mm == pytest.approx(radius, rel=1e-9)
    assert got.rms_irradiance_W_mm2 == pytest.approx(6.0 / (math.pi * radius**2), rel=1e-9)
    assert got.wavelength_nm == pytest.approx((450 + 3 * 550 + 2 * 650) / 6, rel=1e-12)
    assert math.isnan(got.polarization)
    assert math.isnan(got.polarization_se)


def test_errors_of_different_wavelengths_add_in_quadrature(trace):
    rows = trace.paths.by_way()
    expected = float(np.linalg.norm(rows.power_se_W))
    assert by_path(rows, trace.paths).power_se_W.iloc[0] == pytest.approx(expected, rel=1e-12)


def test_the_whole_is_100_percent_without_error():
    """Of two paths that are all the light the shares have the same error, which is less than that of the powers."""
    t = made(FakePath(GHOST, 3.0, 300, wavelength=550.0))
    table = by_path(t.paths.by_way(), t.paths)
    assert table.percent.sum() == pytest.approx(100.0, rel=1e-12)
    assert table.percent_se.iloc[0] == pytest.approx(table.percent_se.iloc[1], rel=1e-9)
    alone = by_path(made().paths.by_way(), made().paths)
    assert alone.percent_se.iloc[0] == pytest.approx(0.0, abs=1e-9)


def test_one_ray_has_an_unknown_radius():
    rows = made(FakePath(GHOST, 0.1, 1, wavelength=550.0)).paths.by_way()
    row = rows[rows.events == GHOST].iloc[0]
    assert (row.rms_radius_mm, row.effective_rays, row.error_rays) == pytest.approx((0, 1, 1))
    assert row.few_rays
    assert all(math.isnan(row[name]) for name in ("rms_irradiance_W_mm2", "rms_radius_se_mm", "power_se_W"))


def test_a_path_is_one_row_for_all_its_wavelengths():
    t = made(FakePath(GHOST, 0.5, 100, wavelength=550.0))
    rows = t.paths.by_way()
    table = by_path(rows, t.paths)
    assert list(table.events) == [EVENTS, GHOST]
    assert list(table.path_ids) == [(0, 1, 2), (3,)]
    assert list(table.path_id) == [0, 3]
    assert table.power_W.iloc[0] == pytest.approx(6.0)
    assert table.percent.sum() == pytest.approx(100)
    assert dict(table.dtypes) == dict(rows.dtypes)


def test_the_order_is_by_the_power_of_all_wavelengths():
    """A path of three weak lines is stronger than another of one strong line."""
    t = made(FakePath(GHOST, 3.5, 100, wavelength=550.0))
    table = by_path(t.paths.by_way(), t.paths)
    assert list(table.kind) == ["direct", "ghost"]
    assert list(table.path_id) == [1, 0]


def test_one_wavelength_keeps_its_table(trace):
    rows = trace.paths.by_way()
    one = rows[rows.wavelength_nm == 550.0].reset_index(drop=True)
    pd.testing.assert_frame_equal(by_path(one, trace.paths), one)
    assert len(by_path(one.iloc[:0], trace.paths)) == 0

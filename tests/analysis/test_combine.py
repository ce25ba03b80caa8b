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


def made(*more):
    lines = [FakePath(EVENTS, share, 500, x, 0.02, radius, wavelength=nm) for nm, (share, x, radius) in DISCS.items()]
    return FakeTrace([*lines, *more], shares=dict.fromkeys(DISCS, 1 / 3))


def test_numbers_are_those_of_all_rays_together():
    trace = made()
    points = np.concatenate([path.points for path in trace.fakes])
    weights = np.concatenate([np.full(path.rays, path.power / path.rays) for path in trace.fakes])
    centre = np.average(points, axis=0, weights=weights)
    radius = math.sqrt(np.average(np.sum((points - centre) ** 2, axis=1), weights=weights))
    rows = trace.paths.by_way()
    (got,) = by_path(rows, trace.paths).itertuples()
    assert got.power_W == pytest.approx(6.0, rel=1e-12)
    assert got.power_se_W == pytest.approx(float(np.linalg.norm(rows.power_se_W)), rel=1e-12)  # of independent rays
    assert got.incident_W == pytest.approx(6.0 / DETECTOR_ABSORBS, rel=1e-12)
    assert (got.percent, got.percent_se) == (pytest.approx(100.0, rel=1e-12), pytest.approx(0.0, abs=1e-9))
    assert got.rays == 1500
    assert (got.x_mm, got.y_mm) == pytest.approx(tuple(centre), rel=1e-9)
    assert got.rms_radius_mm == pytest.approx(radius, rel=1e-9)
    assert got.rms_irradiance_W_mm2 == pytest.approx(6.0 / (math.pi * radius**2), rel=1e-9)
    assert got.wavelength_nm == pytest.approx((450 + 3 * 550 + 2 * 650) / 6, rel=1e-12)
    assert math.isnan(got.polarization)
    assert math.isnan(got.polarization_se)
    one = rows[rows.wavelength_nm == 550.0].reset_index(drop=True)
    pd.testing.assert_frame_equal(by_path(one, trace.paths), one)
    assert len(by_path(one.iloc[:0], trace.paths)) == 0


@pytest.mark.parametrize(
    ("power", "events", "ids"), [(0.5, [EVENTS, GHOST], [(0, 1, 2), (3,)]), (3.5, [EVENTS, GHOST], [(1, 2, 3), (0,)])]
)
def test_a_path_is_one_row_in_the_order_of_all_its_power(power, events, ids):
    """A path of three weak lines is stronger than another of one strong line; the shares of both have one error."""
    t = made(FakePath(GHOST, power, 100, wavelength=550.0))
    rows = t.paths.by_way()
    table = by_path(rows, t.paths)
    assert list(table.events) == events
    assert [tuple(sorted(one)) for one in table.path_ids] == ids
    assert table.power_W.tolist() == pytest.approx([6.0, power])
    assert table.percent.sum() == pytest.approx(100.0, rel=1e-12)
    assert table.percent_se.iloc[0] == pytest.approx(table.percent_se.iloc[1], rel=1e-9)
    assert dict(table.dtypes) == dict(rows.dtypes)


def test_one_ray_has_an_unknown_radius():
    rows = made(FakePath(GHOST, 0.1, 1, wavelength=550.0)).paths.by_way()
    row = rows[rows.events == GHOST].iloc[0]
    assert (row.rms_radius_mm, row.effective_rays, row.error_rays) == pytest.approx((0, 1, 1))
    assert row.few_rays
    assert all(math.isnan(row[name]) for name in ("rms_irradiance_W_mm2", "rms_radius_se_mm", "power_se_W"))

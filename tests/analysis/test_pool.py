"""Rows of a path table as one: exact numbers from known discs, errors by repeated experiments."""

import math

import numpy as np
import pandas as pd
import pytest
from oracles.statistics import z_limit
from report.fake_trace import LENS, FakePath, FakeTrace

from mistray.analysis.pool import by_path, pooled, power

EVENTS = f"{LENS} detector:A"
# share of the power, x and radius of the disc in mm, at 450, 550, 650 nm
DISCS = {450.0: (1.0, -0.05, 0.08), 550.0: (3.0, 0.0, 0.1), 650.0: (2.0, 0.12, 0.14)}


def lines(rays=500):
    return [
        FakePath(EVENTS, share, rays, x, 0.02, radius, wavelength=wavelength)
        for wavelength, (share, x, radius) in DISCS.items()
    ]


@pytest.fixture
def trace():
    return FakeTrace(lines(), shares=dict.fromkeys(DISCS, 1 / 3))


@pytest.fixture
def rows(trace):
    return trace.paths.by_way()


def test_pooled_numbers_are_those_of_all_rays_together(trace, rows):
    points = np.concatenate([path.points for path in trace.fakes])
    weights = np.concatenate([np.full(path.rays, path.power / path.rays) for path in trace.fakes])
    centre = np.average(points, axis=0, weights=weights)
    radius = math.sqrt(np.average(np.sum((points - centre) ** 2, axis=1), weights=weights))
    got = pooled(rows)
    assert got["power_W"] == pytest.approx(6.0, rel=1e-12)
    assert got["incident_W"] == pytest.approx(6.0 / 0.8, rel=1e-12)
    assert got["percent"] == pytest.approx(100.0, rel=1e-12)
    assert got["rays"] == 1500
    assert (got["x_mm"], got["y_mm"]) == pytest.approx(tuple(centre), rel=1e-9)
    assert got["rms_radius_mm"] == pytest.approx(radius, rel=1e-9)
    assert got["rms_irradiance_W_mm2"] == pytest.approx(6.0 / (math.pi * radius**2), rel=1e-9)
    assert got["wavelength_nm"] == pytest.approx((450 + 3 * 550 + 2 * 650) / 6, rel=1e-12)


def test_errors_of_different_wavelengths_add_in_quadrature(rows):
    assert power(rows).se == pytest.approx(float(np.linalg.norm(rows.power_se_W)), rel=1e-12)
    assert pooled(rows)["power_se_W"] == power(rows).se


def test_errors_of_one_run_add_linearly(rows):
    same = rows.assign(wavelength_nm=550.0)
    assert power(same).se == pytest.approx(rows.power_se_W.sum(), rel=1e-12)
    assert power(rows.iloc[:0]) == (0.0, 0.0)


def test_errors_are_those_of_repeated_experiments():
    """500 repetitions with Poisson numbers of rays; the mean of z² lies within 5 of its own errors of 1.

    For normal numbers the mean of 500 z² has the error sqrt(2/500) = 0.063; chance of a false alarm 6e-7 for each of
    the four numbers. The propagated errors come from small samples themselves, which the margin covers.
    """
    rng = np.random.default_rng(7)
    names = {"power_W": "power_se_W", "x_mm": "x_se_mm", "rms_radius_mm": "rms_radius_se_mm",
             "rms_irradiance_W_mm2": "rms_irradiance_se_W_mm2"}  # fmt: skip
    values, errors = [], []
    for _ in range(500):
        rows = []
        for wavelength, (share, x, radius) in DISCS.items():
            n = rng.poisson(400)
            r, phi = radius * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
            points = np.column_stack([x + r * np.cos(phi), r * np.sin(phi)])
            distance2 = np.sum((points - points.mean(axis=0)) ** 2, axis=1)
            p, rms = share * n / 400, math.sqrt(distance2.mean())
            density = p / (math.pi * rms**2)
            p_se, rms_se = p / math.sqrt(n), distance2.std() / math.sqrt(n) / (2 * rms)
            x_se, y_se = points.std(axis=0) / math.sqrt(n)
            rows.append(
                {"source": "s", "wavelength_nm": wavelength, "rays": n, "power_W": p, "power_se_W": p_se,
                 "incident_W": p, "incident_se_W": p_se, "percent": 0.0, "percent_se": 0.0,
                 "x_mm": points[:, 0].mean(), "x_se_mm": x_se, "y_mm": points[:, 1].mean(), "y_se_mm": y_se,
                 "rms_radius_mm": rms, "rms_radius_se_mm": rms_se, "rms_irradiance_W_mm2": density,
                 "rms_irradiance_se_W_mm2": density * math.hypot(p_se / p, 2 * rms_se / rms),
                 "polarization": math.nan, "polarization_se": math.nan}
            )  # fmt: skip
        got = pooled(pd.DataFrame(rows))
        values.append([got[name] for name in names])
        errors.append([got[name] for name in names.values()])
    z = (np.array(values) - np.mean(values, axis=0)) / np.array(errors)
    assert np.abs(np.mean(z**2, axis=0) - 1) == pytest.approx(np.zeros(4), abs=5 * math.sqrt(2 / 500))
    assert np.abs(z).max() < z_limit(z.size, 1e-6)


def test_an_unknown_error_stays_unknown(rows):
    """One ray has a radius of 0 with an infinite error; polarisation that was not traced stays NaN."""
    rows.loc[0, ["rms_radius_mm", "rms_radius_se_mm"]] = 0.0, np.inf
    got = pooled(rows)
    assert got["rms_radius_se_mm"] == math.inf
    assert got["rms_irradiance_se_W_mm2"] == math.inf
    assert math.isfinite(got["power_se_W"])
    assert math.isnan(got["polarization"])
    assert math.isnan(got["polarization_se"])


def test_polarisation_is_the_mean_with_the_powers_as_weights(rows):
    got = pooled(rows.assign(polarization=[0.3, 0.2, 0.1], polarization_se=[0.01, 0.01, 0.01]))
    assert got["polarization"] == pytest.approx((3 * 0.3 + 2 * 0.2 + 1 * 0.1) / 6)
    assert 0 < got["polarization_se"] < 0.02


def test_a_path_is_one_row_for_all_its_wavelengths():
    ghost = f"{LENS} detector:R L1_rear:R detector:A"
    paths = [*lines(), FakePath(ghost, 0.5, 100, wavelength=550.0)]
    rows = FakeTrace(paths, shares=dict.fromkeys(DISCS, 1 / 3)).paths.by_way()
    table = by_path(rows)
    assert list(table.events) == [EVENTS, ghost]
    assert list(table.path_ids) == [(0, 1, 2), (3,)]
    assert list(table.path_id) == [0, 3]
    assert table.power_W.iloc[0] == pytest.approx(6.0)
    assert table.percent.sum() == pytest.approx(100)
    assert dict(table.dtypes) == dict(rows.dtypes)


def test_the_order_is_by_the_power_of_all_wavelengths():
    """A path of three weak lines is stronger than another of one strong line."""
    strong = FakePath(f"{LENS} detector:R L1_rear:R detector:A", 3.5, 100, wavelength=550.0)
    table = by_path(FakeTrace([*lines(), strong], shares=dict.fromkeys(DISCS, 1 / 3)).paths.by_way())
    assert list(table.kind) == ["direct", "ghost"]
    assert list(table.path_id) == [1, 0]


def test_one_wavelength_keeps_its_table(rows):
    one = rows[rows.wavelength_nm == 550.0].reset_index(drop=True)
    pd.testing.assert_frame_equal(by_path(one), one)
    assert len(by_path(one.iloc[:0])) == 0

"""Numbers of paths from known discs: their brightest pixels, all their wavelengths as one, their maps in cells."""

import math

import numpy as np
import pandas as pd
import pytest
from report.fake_trace import DETECTOR_ABSORBS, LENS, FakePath, FakeTrace
from report.ranked_paths import ORDERS, ROUND, TWIN, WIDE, ranked_report

from mistray.analysis import peaks
from mistray.analysis.combine import by_path
from mistray.analysis.maps.path_maps import FieldMaps, PathMap
from mistray.analysis.peaks import with_peaks
from mistray.errors import MistrayError


@pytest.mark.parametrize("rank", ORDERS)
def test_each_rank_has_its_order(rank):
    assert tuple(ranked_report().top(0.0, rank=rank).events) == ORDERS[rank]
    report = ranked_report(rank)
    assert tuple(report.top(0.0).events) == ORDERS[rank]
    for count in (0, 1, 2, 9):  # every list has the strongest path
        events = list(report.listed(0.0, count).events)
        assert tuple(events[:count]) == ORDERS[rank][:count]
        assert events.count(WIDE) == min(count, 1)
        assert len(events) <= count + 1


def test_a_peak_is_the_brightest_pixel_of_all_wavelengths():
    """The wide disc covers 628 pixels of 318 rays each: 3.8 σ of the brightest is 21 %, whose spread is below 10 %."""
    report = ranked_report("peak")
    table = report.table(0.0).set_index("events")
    for events, peak in (
        (WIDE, 1e-3 / (math.pi * 0.5)),
        (ROUND, 2e-4 / (math.pi * 0.04)),
        (TWIN, 1e-4 / (math.pi * 0.01)),
    ):
        image, se = report[0.0].irradiance_of(table.path_ids[events])
        at = np.unravel_index(np.argmax(image), image.shape)
        assert table.peak_W_mm2[events] == image[at]
        assert table.peak_se_W_mm2[events] == se[at]
        assert 1.0 < table.peak_W_mm2[events] / peak < 1.4
    assert table.rank_peak[table.kind == "direct"].tolist() == [0]
    # Refused before anything is traced
    for call in (lambda: ranked_report("rms_irradiance"), lambda: ranked_report().top(0.0, rank="rms_irradiance")):
        with pytest.raises(MistrayError, match=r"'rms_irradiance'.*rms, power, peak"):
            call()


def test_maps_that_do_not_fit_come_from_several_runs(monkeypatch):
    """Until no other path can be brighter than the direct image, whose map alone is enough for the brightest path."""
    report = ranked_report()
    whole = with_peaks(report.table(0.0), report[0.0])
    monkeypatch.setattr(peaks, "MAP_BYTES", 1.0)  # room for one path
    single = with_peaks(report.table(0.0), report[0.0])
    for column in ("peak_W_mm2", "peak_se_W_mm2", "rank_peak"):
        np.testing.assert_array_equal(single[column], whole[column])
    monkeypatch.setattr(peaks, "SURE", 1)
    found = with_peaks(report.table(0.0), report[0.0])
    assert found.peak_W_mm2.notna().tolist() == [True, False, False, False]
    assert found.rank_peak.tolist() == [0, 1, 2, 3]  # by power, as nothing else is known


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
    one = rows[rows.wavelength_nm == 550.0].reset_index(drop=True)
    pd.testing.assert_frame_equal(by_path(one, trace.paths), one)
    assert len(by_path(one.iloc[:0], trace.paths)) == 0
    # One ray has an unknown radius
    rows = made(FakePath(GHOST, 0.1, 1, wavelength=550.0)).paths.by_way()
    row = rows[rows.events == GHOST].iloc[0]
    assert (row.rms_radius_mm, row.effective_rays, row.error_rays) == pytest.approx((0, 1, 1))
    assert row.few_rays
    assert all(math.isnan(row[name]) for name in ("rms_irradiance_W_mm2", "rms_radius_se_mm", "power_se_W"))

    # A path of three weak lines is stronger than another of one strong line; the shares of both have one error
    for power, ids in ((0.5, [(0, 1, 2), (3,)]), (3.5, [(1, 2, 3), (0,)])):
        t = made(FakePath(GHOST, power, 100, wavelength=550.0))
        rows = t.paths.by_way()
        table = by_path(rows, t.paths)
        assert list(table.events) == [EVENTS, GHOST]
        assert [tuple(sorted(one)) for one in table.path_ids] == ids
        assert table.power_W.tolist() == pytest.approx([6.0, power])
        assert table.percent.sum() == pytest.approx(100.0, rel=1e-12)
        assert table.percent_se.iloc[0] == pytest.approx(table.percent_se.iloc[1], rel=1e-9)
        assert dict(table.dtypes) == dict(rows.dtypes)


def spot(shape: tuple[int, int], rows: slice, columns: slice) -> np.ndarray:
    """A map of random powers in a rectangle, dark elsewhere."""
    power = np.zeros(shape)
    power[rows, columns] = 0.1 + np.random.default_rng(3).random(power[rows, columns].shape)
    return power


def test_cells_are_as_small_as_they_may_be():
    """97 pixels from an odd one on touch 49 cells of two, one too many; darkness has none; a grid has the largest."""
    for shape, rows, columns, pixels in (
        ((512, 512), slice(200, 230), slice(7, 90), 1),  # 83 columns: full resolution
        ((512, 512), slice(0, 97), slice(0, 96), 2),
        ((512, 512), slice(0, 512), slice(0, 512), 8),  # 512/96 = 5.3
        ((500, 300), slice(1, 499), slice(0, 300), 8),  # cells reach beyond the edge
        ((60, 80), slice(59, 60), slice(79, 80), 1),
    ):
        power = spot(shape, rows, columns)
        found = PathMap.of(power, 96)
        assert found.pixels == pixels
        assert max(found.power_W.shape) <= 96
        assert found.power_W.sum() == pytest.approx(power.sum(), rel=1e-13)
        assert found.row * pixels <= rows.start < (found.row + 1) * pixels
        assert found.column * pixels <= columns.start < (found.column + 1) * pixels
    assert PathMap.of(spot((512, 512), slice(1, 98), slice(0, 1)), 48).pixels == 4
    dark = PathMap.of(np.zeros((5, 6)), 96)
    assert (dark.pixels, dark.power_W.shape, dark.within((0, 6), (0, 5))) == (1, (0, 0), 0)
    small, large = PathMap.of(spot((512, 512), slice(3, 5), slice(3, 5)), 96), PathMap.of(np.ones((512, 512)), 96)
    assert FieldMaps(large, large, {0: small}, small, {}).grid == 1
    assert FieldMaps(small, small, {0: small, 1: large}, small, {}).grid == 8
    # The power in a rectangle is that of its pixels
    rng = np.random.default_rng(5)
    power = spot((500, 300), slice(30, 480), slice(11, 270))
    found = PathMap.of(power, 64)
    assert found.pixels == 8
    for _ in range(50):
        c0, c1 = sorted(rng.choice(np.arange(0, 305, 8), 2, replace=False))
        r0, r1 = sorted(rng.choice(np.arange(0, 505, 8), 2, replace=False))
        expected = power[r0:r1, c0:c1].sum()
        assert found.within((c0, c1), (r0, r1)) == pytest.approx(expected, rel=1e-12, abs=1e-15)

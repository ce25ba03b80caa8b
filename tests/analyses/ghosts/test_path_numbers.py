"""Numbers of paths from known discs, of maps, and of the Airy disc that no radius is below."""

import math

import numpy as np
import pandas as pd
import pytest
from analyses.fake_trace import DETECTOR_ABSORBS, LENS, ORDERS, ROUND, TWIN, WIDE, FakePath, FakeTrace, ranked_report
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.analyses.ghosts import peaks
from mistray.analyses.ghosts.airy import with_airy
from mistray.analyses.ghosts.combine import by_path
from mistray.analyses.ghosts.maps.path_maps import FieldMaps, PathMap
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.peaks import with_peaks
from mistray.analyses.ghosts.tables.ghosts import AIRY_TEXT, main_table
from mistray.analyses.ghosts.tables.ghosts_csv import path_table
from mistray.errors import MistrayError
from mistray.toolkit.irradiance import log10_image, log_range, mirror_asymmetry, pixel_size, statistics
from mistray.trace.sampled_hits import LightCone


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
    for call in (lambda: ranked_report("rms_irradiance"), lambda: ranked_report().top(0.0, rank="rms_irradiance")):
        with pytest.raises(MistrayError, match=r"'rms_irradiance'.*rms, power, peak"):
            call()


def test_maps_that_do_not_fit_come_from_several_runs(monkeypatch):
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
    rows = made(FakePath(ROUND, 0.1, 1, wavelength=550.0)).paths.by_way()
    row = rows[rows.events == ROUND].iloc[0]
    assert (row.rms_radius_mm, row.effective_rays, row.error_rays) == pytest.approx((0, 1, 1))
    assert row.few_rays
    assert all(math.isnan(row[name]) for name in ("rms_irradiance_W_mm2", "rms_radius_se_mm", "power_se_W"))

    # A path of three weak lines is stronger than another of one strong line; the shares of both have one error
    for power, ids in ((0.5, [(0, 1, 2), (3,)]), (3.5, [(1, 2, 3), (0,)])):
        t = made(FakePath(ROUND, power, 100, wavelength=550.0))
        rows = t.paths.by_way()
        table = by_path(rows, t.paths)
        assert list(table.events) == [EVENTS, ROUND]
        assert [tuple(sorted(one)) for one in table.path_ids] == ids
        assert table.power_W.tolist() == pytest.approx([6.0, power])
        assert table.percent.sum() == pytest.approx(100.0, rel=1e-12)
        assert table.percent_se.iloc[0] == pytest.approx(table.percent_se.iloc[1], rel=1e-9)
        assert dict(table.dtypes) == dict(rows.dtypes)


def spot(shape: tuple[int, int], rows: slice, columns: slice) -> np.ndarray:
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
    rng = np.random.default_rng(5)
    power = spot((500, 300), slice(30, 480), slice(11, 270))
    found = PathMap.of(power, 64)
    assert found.pixels == 8
    for _ in range(50):
        c0, c1 = sorted(rng.choice(np.arange(0, 305, 8), 2, replace=False))
        r0, r1 = sorted(rng.choice(np.arange(0, 505, 8), 2, replace=False))
        expected = power[r0:r1, c0:c1].sum()
        assert found.within((c0, c1), (r0, r1)) == pytest.approx(expected, rel=1e-12, abs=1e-15)


EXTENT = (-2.0, 2.0, -1.5, 1.5)


@pytest.fixture
def noisy():
    counts = np.random.default_rng(3).poisson(50, (60, 80)).astype(float)
    return counts, np.sqrt(counts)


def test_statistics_asymmetry_and_range_of_a_map(noisy):
    image, se = noisy
    got = statistics(image, se, EXTENT, incident_rays=1234)
    assert (got.minimum, got.maximum, got.mean) == (image.min(), image.max(), image.mean())
    assert got.rms == pytest.approx(np.linalg.norm(image) / np.sqrt(image.size), rel=1e-12)
    assert got.flux_W == pytest.approx(image.sum() * 0.05**2, rel=1e-12)
    assert got.maximum_se == se.flat[np.argmax(image)]
    assert got.incident_rays == 1234
    assert pixel_size(np.zeros((3, 8)), EXTENT) == (0.5, 1.0)
    measured, expected = mirror_asymmetry(*noisy)
    # 2400 independent pairs: the mean of |N| has a relative error of 0.76/sqrt(2400) = 1.5 %
    assert measured == pytest.approx(expected, rel=4 * 0.0155)
    noisy[0][:, :40] *= 1.5  # lopsided
    measured, expected = mirror_asymmetry(*noisy)
    assert measured > 1.5 * expected
    assert np.isnan(mirror_asymmetry(np.zeros((2, 2)), np.zeros((2, 2)))).all()

    for width in (4, 5):  # a symmetric map
        row = np.minimum(np.arange(width), np.arange(width)[::-1]) + 1.0
        measured, expected = mirror_asymmetry(np.tile(row, (3, 1)), np.ones((3, width)))
        assert measured == 0
        assert expected == pytest.approx(2 / np.sqrt(np.pi) * (width - width % 2) / (2 * row.sum()))
    assert log_range([np.array([[2e-4, 3e-2]]), np.array([[0.0, 50.0]])], decades=12) == (-4.0, 2.0)
    assert log_range([np.array([[1e-15, 50.0]])], decades=12) == (-10.0, 2.0)
    assert log_range([np.array([[1.0, 1.0]])]) == (-1.0, 0.0)
    assert log_range([np.zeros((2, 2))]) is None
    assert log_range([]) is None
    image = log10_image(np.array([[0.0, 1e-9], [1e-3, 100.0]]), floor=1e-6)
    assert np.isnan(image[0]).all()
    np.testing.assert_allclose(image[1], [-3.0, 2.0], rtol=1e-15)
    with pytest.raises(MistrayError, match="floor is 0 W/mm²"):
        log10_image(np.ones((2, 2)), 0.0)


LAMBDA_MM, INDEX, RADIUS = 550e-6, 1.5, 10.0
FOCUS = INDEX * RADIUS / (INDEX - 1)  # mm behind the vertex
FIRST_ZERO = 3.8317059702075125  # of J1


def ellipsoid(half: float, inner: float = 0.0) -> str:
    """A surface into glass of conic constant -1/n² (Descartes), a detector at its focus, its middle covered or not."""
    glass = interface_xml("air", f"{INDEX}", R=0.0, T=1.0)
    shapes = [
        shape_xml("asphere", "front", 0.0, glass, radius=RADIUS, conic=-1 / INDEX**2, semi_diameter=half),
        shape_xml("asphere", "detector", FOCUS, interface_xml(f"{INDEX}", R=0.0), sensor=True, semi_diameter=1.0),
    ]
    if inner:
        shapes.append(shape_xml("asphere", "spot", -1.0, interface_xml(R=0.0), semi_diameter=inner))
    return scene_text(*shapes, radius=half)


def aperture(half: float, inner: float) -> float:
    """√(2 <n² sin²u>) over an evenly lit annulus, by Gauss-Legendre over the squares of the heights."""
    x, weight = np.polynomial.legendre.leggauss(40)
    square = inner**2 + (half**2 - inner**2) * (x + 1) / 2
    sag = square / RADIUS / (1 + np.sqrt(1 - (1 - 1 / INDEX**2) * square / RADIUS**2))
    sine = square / (square + (FOCUS - sag) ** 2)
    return float(INDEX * np.sqrt(2 * np.sum(weight * sine) / 2))


@pytest.mark.long
@pytest.mark.parametrize(("half", "inner"), [(1.5, 0.0), (4.0, 2.0)])
def test_airy_radius_of_a_perfect_focus_in_glass(load_scene, half: float, inner: float) -> None:
    """The aperture is n sin u in the glass, within 4 errors (false alarm 6e-5 each) of below 3 %; P/(π r²) follows."""
    report = mistray.ghosts(load_scene(ellipsoid(half, inner)), [0.0], rays=4000, seed=1)
    table = report.table(0.0)
    (cone,) = report[0.0].light_cones(list(table.path_id)).values()
    exact = aperture(half, inner)
    assert cone.aperture_se < 0.03 * exact
    assert abs(cone.aperture - exact) < 4 * cone.aperture_se
    row = report.with_airy(0.0, table).iloc[0]
    expected = FIRST_ZERO / (2 * math.pi) * LAMBDA_MM / exact
    assert row.rms_radius_mm < 0.05 * expected  # the raw value stays
    assert row.airy_radius_mm == pytest.approx(expected, abs=4 * row.airy_radius_se_mm)
    assert row.airy_radius_se_mm / row.airy_radius_mm == pytest.approx(cone.aperture_se / cone.aperture, rel=1e-9)
    assert row.airy_irradiance_W_mm2 == pytest.approx(row.power_W / (math.pi * row.airy_radius_mm**2), rel=1e-12)
    assert row.airy_irradiance_W_mm2 < row.rms_irradiance_W_mm2
    assert list(path_table(report).airy_radius_mm) == [row.airy_radius_mm]


def test_only_radii_below_the_floor_of_a_known_cone_have_one() -> None:
    """Of F/4: 1.22 λN = 2.684 µm; half of it at half of the wavelength. Then cones of few or parallel rays, none."""
    lines, radii = [550, 550, 275, 275, 550, 550, 550], [2.6e-3, 2.7e-3, 1.3e-3, 1.4e-3, 1e-4, 1e-4, 1e-4]
    table = pd.DataFrame({"path_id": range(7), "wavelength_nm": lines, "rms_radius_mm": radii})
    cones = dict.fromkeys(range(4), LightCone(0.125, 0.0025, 99))
    cones |= {4: LightCone(0.125, 0.01, 9), 5: LightCone(0.0, 0.0, 99)}
    found = with_airy(table.assign(power_W=2.0, power_se_W=0.1), cones)
    assert list(found.airy_radius_mm[[0, 2]]) == pytest.approx([2.683274e-3, 1.341637e-3], rel=1e-6)
    names = [name for name in found if str(name).startswith("airy")]
    assert len(names) == 4
    assert found[names].isna().all(axis=1).tolist() == [False, True, False, True, True, True, True]
    row = found.iloc[0]  # errors of cone and power add up
    assert row.airy_radius_se_mm == pytest.approx(0.02 * row.airy_radius_mm)
    assert row.airy_irradiance_se_W_mm2 == pytest.approx(math.hypot(0.05, 0.04) * row.airy_irradiance_W_mm2)


@pytest.mark.long
def test_where_it_is_told() -> None:
    report = mistray.ghosts(mistray.load("phone_camera"), [10.0], rays=50_000, contested_rays=0, seed=2)
    listed = report.with_airy(10.0, report.listed(10.0, 4))
    floored = listed[listed.airy_radius_mm.notna()]
    assert 0 < len(floored) < len(listed)
    assert floored.label.str.contains("stop_front").all()
    assert AIRY_TEXT in main_table(report)
    paths = record(report)["fields"][0]["worst_paths"]
    assert [path["airy_radius_mm"] is not None for path in paths] == list(listed.airy_radius_mm.notna())

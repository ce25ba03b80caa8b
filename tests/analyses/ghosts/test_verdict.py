"""What a ghost analysis comes to: the worst paths, the surface to change first, several wavelengths, Airy discs."""

import importlib
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from analyses import fake_trace as fake
from analyses.fake_scene import lens_scene
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z
from refusals import refused

import mistray
from mistray import Detector, GhostReport, Prescription, Source, Surface, ghosts
from mistray.analyses.ghosts import peaks
from mistray.analyses.ghosts.airy import with_airy
from mistray.analyses.ghosts.combine import by_path
from mistray.analyses.ghosts.maps.path_maps import FieldMaps, PathMap
from mistray.analyses.ghosts.page.answer import verdict
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.peaks import with_peaks
from mistray.analyses.ghosts.tables.ghosts_csv import path_table, summary_frame
from mistray.analyses.ghosts.tables.printed import AIRY_TEXT, CONTESTED, main_table
from mistray.analyses.ghosts.verdict import brightest_field, most_stray, remedy, shares_of_kinds, worst_of_all_fields
from mistray.errors import Interrupted
from mistray.metrics.ghost_ranking import bounds
from mistray.toolkit.irradiance import log10_image, log_range, mirror_asymmetry, pixel_size, statistics
from mistray.trace.sampled_hits import LightCone


def report_of(paths_by_field, rank="rms"):
    traces = {field: fake.FakeTrace(paths, field) for field, paths in paths_by_field.items()}
    return GhostReport(lens_scene(), traces, traces.get(0.0, fake.trace_at(0.0)), {}, rank)


def test_worst_paths_and_what_is_left_without_them():
    report = report_of({field: fake.paths_at(field) for field in (0.0, 10.0, 20.0)})
    worst = worst_of_all_fields(report)
    assert len({path.label for path in worst}) == len(worst) == 4
    assert (worst[0].label, worst[0].fields) == ("detector → L1_rear", (0.0, 10.0, 20.0))
    values = {field: bounds(report.top(field, 1, "rms"))[0, 0] for field in report}
    assert worst[0].field_deg == max(values, key=values.get)
    assert worst[-1].few_rays  # three rays in a point have the highest irradiance
    powers = [path.power_W.value for path in worst_of_all_fields(report_of({0.0: fake.paths_at(0.0)}, "power"), 3)]
    assert powers == sorted(powers, reverse=True)
    assert powers[0] == pytest.approx(2e-4)
    report = report_of({0.0: fake.scatter_paths_at(0.0)})
    shares = shares_of_kinds(report, 0.0)
    assert sum(share.value for share in shares.values()) == pytest.approx(100)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    straight = fake.FakePath(f"stop_wall:R {fake.LENS} detector:A", 1e-3, 99)
    (alone,) = shares_of_kinds(report_of({0.0: [straight]}), 0.0).values()
    assert (alone.value, alone.se) == pytest.approx((100, 0), abs=1e-9)
    # The remedy is not the detector, at which all ghosts of the fake trace turn; a dark one needs none
    dark = [fake.FakePath(f"{fake.LENS} detector:A", 1.0, 99)]
    found = remedy(report_of({0.0: fake.paths_at(0.0), 10.0: dark, 20.0: []}))
    assert found.surface == "window_rear"
    assert found.left_W[0.0].value > 0 == found.left_W[10.0].value == found.left_W[20.0].value
    report = report_of({0.0: []})
    assert (worst_of_all_fields(report), most_stray(report), remedy(report)) == ([], None, None)
    assert verdict(report) == ["No stray path reaches the detector."]
    # The surface to change: most of the light of field 20 has one cause, and a ghost off the lens is left
    ghost, direct = fake.FakePath(fake.ROUND, 1e-4, 400), fake.FakePath(DIRECT, 3.0, 1000)
    for events, deed in (
        (f"{fake.LENS} detector:R window_rear:R L1_front:T L1_rear:T detector:A", "reflects"),
        ("window_front:T window_rear:t L1_front:T L1_rear:T detector:A", "scatters"),
    ):
        found = remedy(report_of({0.0: [direct, ghost], 20.0: [ghost, fake.FakePath(events, 9e-4, 500)]}))
        assert (found.surface, found.deed, found.field_deg) == ("window_rear", deed, 20.0)
        assert found.percent.value == pytest.approx(90)
        assert {field: left.value for field, left in found.left_W.items()} == pytest.approx({0.0: 1e-4, 20.0: 1e-4})
    # The phone camera at 20°: light through the bevel of L3 is half of the stray light, docs/validation
    report = mistray.ghosts(mistray.load("phone_camera"), field_deg=[20.0], rays=4000)
    found = remedy(report)
    assert (found.surface, found.deed) == ("L3_bevel_2", "passes")
    assert 30 < found.percent.value < 65  # 48.1 ± 1.1 of 20 000 rays; at 4000 rays one error is 2.5
    rows = report.table(20.0)
    through = rows.events.str.contains("L3_bevel_2:", regex=False)
    assert found.left_W[20.0].value == pytest.approx(rows.power_W[~through].sum())


def test_what_is_left_without_a_surface_is_left_without_it(load_scene):
    """A plate before a detector: traced again with R = 0 and the same T; equal seeds, so they agree to rounding."""

    def report(rear):
        sides = (("front", 0.0, ("air", "N-BK7"), 0.02), ("rear", 3.0, ("N-BK7", "air"), rear))
        faces = [
            shape_xml("asphere", name, z, interface_xml(*media, R=share, T=0.9), semi_diameter=20.0)
            for name, z, media, share in sides
        ]
        detector = shape_xml("asphere", "detector", 9.0, interface_xml(R=0.3), sensor=True, semi_diameter=15.0)
        scene = load_scene(scene_text(*faces, detector, radius=4.0))
        return mistray.ghosts(scene, field_deg=[0.0, 10.0], rays=4000, max_reflections=3)

    found, after = remedy(report(0.05)), report(0.0)
    assert found.surface == "rear"
    for field, left in found.left_W.items():
        assert left.value == pytest.approx(after.summary(field).stray_W.value, rel=1e-5)
    assert math.isfinite(found.percent.se)
    assert np.isfinite([left.se for left in found.left_W.values()]).all()


def test_the_worst_paths_of_each_source(load_scene):
    """Two beams through a plate: each has its ghosts, and they are not one path."""
    other = '<emitter type="collimated" id="other"><float name="radius" value="0.5"/></emitter>'
    text = plates_text(1, R=0.1, T=0.9).replace("</emitter>", f"</emitter>{other}", 1)
    report = mistray.ghosts(load_scene(text), 0.0, rays=2000)
    stray = report.table(0.0)[lambda rows: rows.kind != "direct"]
    assert stray.source.nunique() == 2
    worst = worst_of_all_fields(report, len(stray))
    assert sorted(path.power_W.value for path in worst) == sorted(stray.power_W)
    assert {path.label for path in worst} == {f"{row.label} ({row.source})" for row in stray.itertuples()}


DIRECT = f"{fake.LENS} detector:A"
CLOSE = 10.0  # field, degrees


def lens_trace(field_deg, rays, rival):
    """A field whose ghosts have so many rays, and a second one of `rival` of the irradiance of the first."""
    paths = [
        fake.FakePath(DIRECT, 3.0, rays, radius=0.02),
        fake.FakePath(fake.ROUND, 1e-4, rays, y=0.5, radius=0.05),
        fake.FakePath(fake.WIDE, rival * 1e-4, rays, y=-0.5, radius=0.05),
    ]
    t = fake.FakeTrace(paths, field_deg)
    t.settings = t.settings | {"rays": rays}
    return t


@pytest.fixture
def traced(monkeypatch):
    """Replaces the tracer and notes its calls; at `CLOSE` the ghosts are 10 % apart, elsewhere a factor of 10."""
    calls = []

    def trace(scene, field_deg=None, progress=None, **settings):
        calls.append((field_deg, settings.get("rays")))
        if progress:
            progress(1, 1)
        angle = 10.0 if field_deg is None else field_deg
        return lens_trace(angle, int(settings.get("rays", 1000)), 0.9 if angle == CLOSE else 0.1)

    monkeypatch.setattr(importlib.import_module("mistray.analyses.ghosts.field_traces"), "trace", trace)
    monkeypatch.setattr("mistray.toolkit.analysis.require_scene", lambda *_: None)
    return calls


def test_a_contested_field_is_traced_again_with_four_times_the_rays(traced, monkeypatch):
    """A uniform disc of 100 rays has its area to 10 %, one of 6400 to 1.2 %: ghosts 10 % apart are then distinct."""
    seen = []
    report = ghosts(lens_scene(), [0.0, 10.0], rays=100, contested_rays=6400, progress=lambda *at: seen.append(at))
    assert traced == [(0.0, 100), (10.0, 100), (10.0, 6400)]
    assert seen == [(1, 2), (2, 2), (3, 3)]
    assert (list(report), report.traced_again) == ([0.0, 10.0], (10.0,))
    assert report[10.0].settings["rays"] == 6400
    assert report.rivals(10.0).empty
    assert report.top(10.0, 1).events.iloc[0] == fake.ROUND
    traced.clear()  # several sources may each have an angle of their own, which stays
    assert ghosts(lens_scene(), rays=100).traced_again == (10.0,)
    assert traced == [(None, 100), (0.0, 100), (None, 400)]
    traced.clear()
    monkeypatch.setitem(globals(), "CLOSE", 0.0)
    report = ghosts(lens_scene(), [10.0, 0.0], rays=100)
    assert (list(report), report.traced_again) == ([10.0, 0.0], (0.0,))
    assert report.nominal_trace is report[0.0]
    assert report.nominal_trace.settings["rays"] == 400


def test_an_interrupt_leaves_what_was_traced_first(traced, monkeypatch):
    for given in ({"contested_rays": 0}, {"contested_rays": 100}, {"rank": "power"}, {"seconds": 60}):
        report = ghosts(lens_scene(), [0.0, 10.0], rays=100, **given)
        assert traced == [(0.0, 100), (10.0, 100)]  # nothing is traced again
        assert report.traced_again == ()
        assert {"traced_again_deg", "contested_rays"}.isdisjoint(report.settings)
        traced.clear()
    module = importlib.import_module("mistray.analyses.ghosts.field_traces")
    trace = module.trace

    def interrupted(scene, rays, **settings):
        if rays > 100:
            raise Interrupted("few rays are finished", lens_trace(10.0, 7, 0.9))
        return trace(scene, rays=rays, **settings)

    monkeypatch.setattr(module, "trace", interrupted)
    with pytest.raises(Interrupted, match="2 of 2 fields are finished") as error:
        ghosts(lens_scene(), [0.0, 10.0], rays=100)
    assert error.value.partial[10.0].settings["rays"] == 100
    assert error.value.partial.traced_again == ()


def test_what_is_told(traced):
    """Of rays: those of each field. Of what is still contested: a mark, a warning that names the path, a column."""
    report = ghosts(lens_scene(), [0.0, 10.0], rays=100)
    rival = report.rivals(10.0)
    assert list(rival.events) == [fake.WIDE]
    assert list(summary_frame(report).rays) == [100, 400]
    told = record(report)
    assert [field["rays"] for field in told["fields"]] == [100, 400]
    assert (told["settings"]["traced_again_deg"], told["settings"]["contested_rays"]) == ([10.0], 400)
    assert f"{rival.path_id.iloc[0]} {CONTESTED}" in main_table(report)
    assert any("is open" in text and f"path {rival.path_id.iloc[0]} " in text for text in report.notes)
    # The worst of all fields are contested by the first of all
    first, other = lens_trace(0.0, 400, 0.01), fake.FakeTrace([fake.FakePath(fake.WIDE, 1e-4, 100, radius=0.05)], 10.0)
    report = fake.ghosts_of(first, other)
    assert [report.rivals(field).empty for field in report] == [True, True]
    worst = worst_of_all_fields(report)
    low, high = np.concatenate([bounds(report.top(path.field_deg, 1)) for path in worst[:2]], axis=1)
    assert low[0] > low[1]
    assert [path.contested for path in worst] == [False, high[1] > low[0]]
    assert worst[1].contested
    assert brightest_field(report) == worst[0].field_deg


def test_more_rays_are_those_of_a_trace_of_so_many():
    scene = mistray.load("phone_camera")
    report = mistray.ghosts(scene, 10.0, rays=2000, seed=3)
    again = mistray.trace(scene, rays=8000, field_deg=10.0, seed=3)
    assert report.traced_again == (10.0,)
    assert report[10.0].rays_traced == again.rays_traced == 8000
    found, expected = (one.paths.to_pandas() for one in (report[10.0], again))
    for name in ("power_W", "power_se_W", "rms_radius_mm"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9)


LINES = {450.0: 1.0, 550.0: 2.0, 650.0: 1.0}
LENS = {"semi_diameter": 6.0, "part": "L1"}
# A dense flint lens: strong dispersion, two-reflection ghost inside of it; the stop is the lens
SINGLET = Prescription(
    name="singlet",
    surfaces=(
        Surface("L1_front", radius=40.0, back="N-SF5", **LENS),
        Surface("L1_rear", z=3.0, radius=-40.0, front="N-SF5", **LENS),
    ),
    detector=Detector(z=30.0, half_width=20.0, half_height=20.0, pixels=(40, 40)),
    source=Source(radius=5.0, field_deg=5.0),
)


@pytest.fixture(scope="module")
def scene():
    return SINGLET.to_scene()


def analyse(scene, seed=0, **options):
    spectrum = {"wavelength_nm": list(LINES), "weights": list(LINES.values())}
    return mistray.ghosts(scene, field_deg=[0.0], rays=8000, seed=seed, **(spectrum | options))


@pytest.fixture(scope="module")
def report(scene):
    return analyse(scene)


UNITS = {"power": "W", "rms_radius": "mm", "rms_irradiance": "W_mm2"}


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
        for (name, unit), factor in zip(UNITS.items(), (share, 1.0, share), strict=True):
            names.append(f"{name} at {row.wavelength_nm:g} nm")
            got.append(getattr(row, f"{name}_{unit}"))
            expected.append(factor * getattr(alone, f"{name}_{unit}"))
            errors = getattr(row, f"{name}_se_{unit}"), factor * getattr(alone, f"{name}_se_{unit}")
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
    source = replace(SINGLET.source, wavelength_nm=tuple(LINES), weights=tuple(LINES.values()))
    own = mistray.ghosts(replace(SINGLET, source=source).to_scene(), field_deg=[0.0], rays=100)
    for found in (report, own):
        assert [found.weight(wavelength) for wavelength in LINES] == pytest.approx([0.25, 0.5, 0.25])
    for wavelength in LINES:
        assert abs(t.energy_at(wavelength).closure) < 1e-5
    launched = sum(t.energy_at(wavelength).launched_W for wavelength in LINES)
    assert launched == pytest.approx(t.energy.launched_W, rel=1e-12)
    assert launched == pytest.approx(math.pi * 5.0**2, rel=1e-6)


def test_standard_errors_of_the_ghost_of_all_lines(scene):
    """40 seeds: Σz² against the common mean is χ² with 39 degrees of freedom; within 9.5 … 100, false alarm 1e-6."""
    rows = [ghost_of(analyse(scene, seed=seed)) for seed in range(40)]
    for name, unit in UNITS.items():
        both = f"{name}_{unit}", f"{name}_se_{unit}"
        values, errors = (np.array([getattr(row, column) for row in rows]) for column in both)
        chi2 = float(np.sum(((values - values.mean()) / errors) ** 2))
        assert 9.5 < chi2 < 100, f"{name}: χ² = {chi2:.1f} for 39 degrees of freedom"


@pytest.mark.parametrize("rank", fake.ORDERS)
def test_each_rank_has_its_order(rank):
    assert tuple(fake.ranked_report().top(0.0, rank=rank).events) == fake.ORDERS[rank]
    report = fake.ranked_report(rank)
    assert tuple(report.top(0.0).events) == fake.ORDERS[rank]
    for count in (0, 1, 2, 9):  # every list has the strongest path
        events = list(report.listed(0.0, count).events)
        assert tuple(events[:count]) == fake.ORDERS[rank][:count]
        assert events.count(fake.WIDE) == min(count, 1)
        assert len(events) <= count + 1
    assert report.listed(0.0, 1, "peak").peak_W_mm2.notna().all()  # lists by power from before know no peaks


def test_a_peak_is_the_brightest_pixel_of_all_wavelengths():
    """The wide disc covers 628 pixels of 318 rays each: 3.8 σ of the brightest is 21 %, whose spread is below 10 %."""
    report = fake.ranked_report("peak")
    table = report.table(0.0).set_index("events")
    for events, peak in ((fake.WIDE, 1e-3 / 0.5), (fake.ROUND, 2e-4 / 0.04), (fake.TWIN, 1e-4 / 0.01)):
        image, se = report[0.0].irradiance_of(table.path_ids[events])
        at = np.unravel_index(np.argmax(image), image.shape)
        assert (table.peak_W_mm2[events], table.peak_se_W_mm2[events]) == (image[at], se[at])
        assert 1.0 < table.peak_W_mm2[events] / peak * math.pi < 1.4
    assert table.rank_peak[table.kind == "direct"].tolist() == [0]
    for call in (fake.ranked_report, lambda name: fake.ranked_report().top(0.0, rank=name)):
        with refused(r"'rms_irradiance'.*rms, power, peak"):
            call("rms_irradiance")


def test_maps_that_do_not_fit_come_from_several_runs(monkeypatch):
    report = fake.ranked_report()
    whole = with_peaks(report.table(0.0), report[0.0])
    monkeypatch.setattr(peaks, "MAP_BYTES", 1.0)  # room for one path
    single = with_peaks(report.table(0.0), report[0.0])
    for column in ("peak_W_mm2", "peak_se_W_mm2", "rank_peak"):
        np.testing.assert_array_equal(single[column], whole[column])
    monkeypatch.setattr(peaks, "SURE", 1)
    found = with_peaks(report.table(0.0), report[0.0])
    assert found.peak_W_mm2.notna().tolist() == [True, False, False, False]
    assert found.rank_peak.tolist() == [0, 1, 2, 3]  # by power, as nothing else is known


# share of the power, x and radius of the disc in mm, at 450, 550, 650 nm
DISCS = {450.0: (1.0, -0.05, 0.08), 550.0: (3.0, 0.0, 0.1), 650.0: (2.0, 0.12, 0.14)}


def made(*more):
    lines = [fake.FakePath(DIRECT, power, 500, x, 0.02, radius, nm) for nm, (power, x, radius) in DISCS.items()]
    return fake.FakeTrace([*lines, *more], shares=dict.fromkeys(DISCS, 1 / 3))


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
    assert got.incident_W == pytest.approx(6.0 / fake.DETECTOR_ABSORBS, rel=1e-12)
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
    rows = made(fake.FakePath(fake.ROUND, 0.1, 1, wavelength=550.0)).paths.by_way()
    row = rows[rows.events == fake.ROUND].iloc[0]
    assert (row.rms_radius_mm, row.effective_rays, row.error_rays) == pytest.approx((0, 1, 1))
    assert row.few_rays
    assert all(math.isnan(row[name]) for name in ("rms_irradiance_W_mm2", "rms_radius_se_mm", "power_se_W"))
    # A path of three weak lines is stronger than another of one strong line; the shares of both have one error
    for power, ids in ((0.5, [(0, 1, 2), (3,)]), (3.5, [(1, 2, 3), (0,)])):
        t = made(fake.FakePath(fake.ROUND, power, 100, wavelength=550.0))
        rows = t.paths.by_way()
        table = by_path(rows, t.paths)
        assert list(table.events) == [DIRECT, fake.ROUND]
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
    rng, power = np.random.default_rng(5), spot((500, 300), slice(30, 480), slice(11, 270))
    found = PathMap.of(power, 64)
    assert found.pixels == 8
    for _ in range(50):
        c0, c1 = sorted(rng.choice(np.arange(0, 305, 8), 2, replace=False))
        r0, r1 = sorted(rng.choice(np.arange(0, 505, 8), 2, replace=False))
        assert found.within((c0, c1), (r0, r1)) == pytest.approx(power[r0:r1, c0:c1].sum(), rel=1e-12, abs=1e-15)


EXTENT = (-2.0, 2.0, -1.5, 1.5)


def test_statistics_asymmetry_and_range_of_a_map():
    image = np.random.default_rng(3).poisson(50, (60, 80)).astype(float)
    se = np.sqrt(image)
    got = statistics(image, se, EXTENT, incident_rays=1234)
    assert (got.minimum, got.maximum, got.mean) == (image.min(), image.max(), image.mean())
    assert got.rms == pytest.approx(np.linalg.norm(image) / np.sqrt(image.size), rel=1e-12)
    assert got.flux_W == pytest.approx(image.sum() * 0.05**2, rel=1e-12)
    assert (got.maximum_se, got.incident_rays) == (se.flat[np.argmax(image)], 1234)
    assert pixel_size(np.zeros((3, 8)), EXTENT) == (0.5, 1.0)
    measured, expected = mirror_asymmetry(image, se)
    # 2400 independent pairs: the mean of |N| has a relative error of 0.76/sqrt(2400) = 1.5 %
    assert measured == pytest.approx(expected, rel=4 * 0.0155)
    image[:, :40] *= 1.5  # lopsided
    measured, expected = mirror_asymmetry(image, se)
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
    assert log_range([np.zeros((2, 2))]) is log_range([]) is None
    image = log10_image(np.array([[0.0, 1e-9], [1e-3, 100.0]]), floor=1e-6)
    assert np.isnan(image[0]).all()
    np.testing.assert_allclose(image[1], [-3.0, 2.0], rtol=1e-15)
    with refused("floor is 0 W/mm²"):
        log10_image(np.ones((2, 2)), 0.0)


INDEX, RADIUS = 1.5, 10.0
FOCUS = INDEX * RADIUS / (INDEX - 1)  # mm behind the vertex


def aperture(half: float, inner: float) -> float:
    """√(2 <n² sin²u>) over an evenly lit annulus, by Gauss-Legendre over the squares of the heights."""
    x, weight = np.polynomial.legendre.leggauss(40)
    square = inner**2 + (half**2 - inner**2) * (x + 1) / 2
    sag = square / RADIUS / (1 + np.sqrt(1 - (1 - 1 / INDEX**2) * square / RADIUS**2))
    sine = square / (square + (FOCUS - sag) ** 2)
    return float(INDEX * np.sqrt(2 * np.sum(weight * sine) / 2))


@pytest.mark.parametrize(("half", "inner"), [(1.5, 0.0), (4.0, 2.0)])
def test_airy_radius_of_a_perfect_focus_in_glass(load_scene, half: float, inner: float) -> None:
    """The aperture is n sin u in the glass, within 4 errors (false alarm 6e-5 each) of below 3 %; P/(π r²) follows.

    A surface of conic constant -1/n² (Descartes), a detector at its focus, its middle covered or not.
    """
    glass, behind = interface_xml("air", f"{INDEX}", R=0.0, T=1.0), interface_xml(f"{INDEX}", R=0.0)
    front = shape_xml("asphere", "front", 0.0, glass, radius=RADIUS, conic=-1 / INDEX**2, semi_diameter=half)
    detector = shape_xml("asphere", "detector", FOCUS, behind, sensor=True, semi_diameter=1.0)
    spot = [shape_xml("asphere", "spot", -1.0, semi_diameter=inner)] if inner else []
    report = mistray.ghosts(load_scene(scene_text(front, detector, *spot, radius=half)), [0.0], rays=4000, seed=1)
    table = report.table(0.0)
    (cone,) = report[0.0].light_cones(list(table.path_id)).values()
    exact = aperture(half, inner)
    assert cone.aperture_se < 0.03 * exact
    assert abs(cone.aperture - exact) < 4 * cone.aperture_se
    row = report.with_airy(0.0, table).iloc[0]
    expected = 3.8317059702075125 / (2 * math.pi) * 550e-6 / exact  # by the first zero of J1
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
    cones |= {4: LightCone(0.125, 0.01, 9), 5: LightCone(1e-16, 1e-18, 99)}
    found = with_airy(table.assign(power_W=2.0, power_se_W=0.1), cones)
    assert list(found.airy_radius_mm[[0, 2]]) == pytest.approx([2.683274e-3, 1.341637e-3], rel=1e-6)
    names = [name for name in found if str(name).startswith("airy")]
    assert len(names) == 4
    assert found[names].isna().all(axis=1).tolist() == [False, True, False, True, True, True, True]
    row = found.iloc[0]  # errors of cone and power add up
    assert row.airy_radius_se_mm == pytest.approx(0.02 * row.airy_radius_mm)
    assert row.airy_irradiance_se_W_mm2 == pytest.approx(math.hypot(0.05, 0.04) * row.airy_irradiance_W_mm2)


def test_where_it_is_told() -> None:
    report = mistray.ghosts(mistray.load("phone_camera"), [10.0], rays=50_000, contested_rays=0, seed=2)
    listed = report.with_airy(10.0, report.listed(10.0, 4))
    floored = listed[listed.airy_radius_mm.notna()]
    assert 0 < len(floored) < len(listed)
    assert floored.label.str.contains("stop_front").all()
    assert AIRY_TEXT in main_table(report)
    paths = record(report)["fields"][0]["worst_paths"]
    assert [path["airy_radius_mm"] is not None for path in paths] == list(listed.airy_radius_mm.notna())

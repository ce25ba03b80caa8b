"""What a ghost analysis comes to: the worst paths, the surface to change first, and several wavelengths."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace

import numpy as np
import pytest
from analyses.fake_scene import lens_scene
from analyses.fake_trace import LENS, ROUND, WIDE, FakePath, FakeTrace, ghosts_of, paths_at, scatter_paths_at, trace_at
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import assert_z

import mistray
from mistray.analyses.ghosts.page.answer import verdict
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.run import ghosts
from mistray.analyses.ghosts.tables.ghosts import CONTESTED, main_table
from mistray.analyses.ghosts.tables.ghosts_csv import summary_frame
from mistray.analyses.ghosts.verdict import brightest_field, most_stray, remedy, shares_of_kinds, worst_of_all_fields
from mistray.errors import Interrupted
from mistray.metrics.ranking import bounds
from mistray.prescription import Detector, Prescription, Source, Surface


def report_of(paths_by_field, rank="rms"):
    traces = {field: FakeTrace(paths, field) for field, paths in paths_by_field.items()}
    return GhostReport(lens_scene(), traces, traces.get(0.0, trace_at(0.0)), {}, rank)


def test_worst_paths_stand_once_at_their_worst_field():
    report = report_of({field: paths_at(field) for field in (0.0, 10.0, 20.0)})
    worst = worst_of_all_fields(report)
    assert len({path.label for path in worst}) == len(worst) == 4
    assert worst[0].label == "detector → L1_rear"
    assert worst[0].fields == (0.0, 10.0, 20.0)
    values = {field: bounds(report.top(field, 1, "rms"))[0, 0] for field in report}
    assert worst[0].field_deg == max(values, key=values.get)
    assert worst[-1].few_rays  # three rays in a point have the highest irradiance
    powers = [path.power_W.value for path in worst_of_all_fields(report_of({0.0: paths_at(0.0)}, "power"), 3)]
    assert powers == sorted(powers, reverse=True)
    assert powers[0] == pytest.approx(2e-4)
    report = report_of({0.0: scatter_paths_at(0.0)})
    shares = shares_of_kinds(report, 0.0)
    assert sum(share.value for share in shares.values()) == pytest.approx(100)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    (alone,) = shares_of_kinds(report_of({0.0: [FakePath(f"stop_wall:R {LENS} detector:A", 1e-3, 99)]}), 0.0).values()
    assert (alone.value, alone.se) == pytest.approx((100, 0), abs=1e-9)


def test_a_field_without_stray_light_is_left_with_none():
    """The remedy is not the detector, at which all ghosts of the fake trace turn; a dark one needs none."""
    dark = [FakePath(f"{LENS} detector:A", 1.0, 99)]
    found = remedy(report_of({0.0: paths_at(0.0), 10.0: dark, 20.0: []}))
    assert found.surface == "window_rear"
    assert found.left_W[0.0].value > 0 == found.left_W[10.0].value == found.left_W[20.0].value
    report = report_of({0.0: []})
    assert (worst_of_all_fields(report), most_stray(report), remedy(report)) == ([], None, None)
    assert verdict(report) == ["No stray path reaches the detector."]
    # The surface to change: most of the light of field 20 has one cause, and a ghost off the lens is left
    ghost, direct = FakePath(ROUND, 1e-4, 400), FakePath(DIRECT, 3.0, 1000)
    for events, deed in (
        (f"{LENS} detector:R window_rear:R L1_front:T L1_rear:T detector:A", "reflects"),
        ("window_front:T window_rear:t L1_front:T L1_rear:T detector:A", "scatters"),
    ):
        found = remedy(report_of({0.0: [direct, ghost], 20.0: [ghost, FakePath(events, 9e-4, 500)]}))
        assert (found.surface, found.deed, found.field_deg) == ("window_rear", deed, 20.0)
        assert found.percent.value == pytest.approx(90)
        assert {field: left.value for field, left in found.left_W.items()} == pytest.approx({0.0: 1e-4, 20.0: 1e-4})


@pytest.mark.long
def test_light_that_passes_where_the_image_does_not():
    """The phone camera at 20°: light through the bevel of L3 is half of the stray light, docs/validation."""
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


DIRECT = f"{LENS} detector:A"
CLOSE = 10.0  # field, degrees


def lens_trace(field_deg, rays, rival):
    """A field whose ghosts have so many rays, and a second one of `rival` of the irradiance of the first."""
    paths = [
        FakePath(DIRECT, 3.0, rays, radius=0.02),
        FakePath(ROUND, 1e-4, rays, y=0.5, radius=0.05),
        FakePath(WIDE, rival * 1e-4, rays, y=-0.5, radius=0.05),
    ]
    t = FakeTrace(paths, field_deg)
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
    assert report.traced_again == (10.0,)
    assert report[10.0].settings["rays"] == 6400
    assert list(report) == [0.0, 10.0]
    assert report.rivals(10.0).empty
    assert report.top(10.0, 1).events.iloc[0] == ROUND
    traced.clear()  # several sources may each have an angle of their own, which stays
    assert ghosts(lens_scene(), rays=100).traced_again == (10.0,)
    assert traced == [(None, 100), (0.0, 100), (None, 400)]
    traced.clear()
    monkeypatch.setitem(globals(), "CLOSE", 0.0)
    report = ghosts(lens_scene(), [10.0, 0.0], rays=100)
    assert report.traced_again == (0.0,)
    assert report.nominal_trace is report[0.0]
    assert report.nominal_trace.settings["rays"] == 400
    assert list(report) == [10.0, 0.0]


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
    assert list(rival.events) == [WIDE]
    assert list(summary_frame(report).rays) == [100, 400]
    told = record(report)
    assert [field["rays"] for field in told["fields"]] == [100, 400]
    assert (told["settings"]["traced_again_deg"], told["settings"]["contested_rays"]) == ([10.0], 400)
    assert f"{rival.path_id.iloc[0]} {CONTESTED}" in main_table(report)
    assert any("is open" in text and f"path {rival.path_id.iloc[0]} " in text for text in report.notes)
    # The worst of all fields are contested by the first of all
    first, other = lens_trace(0.0, 400, 0.01), FakeTrace([FakePath(WIDE, 1e-4, 100, radius=0.05)], 10.0)
    report = ghosts_of(first, other)
    assert report.rivals(0.0).empty
    assert report.rivals(10.0).empty
    worst = worst_of_all_fields(report)
    low, high = np.concatenate([bounds(report.top(path.field_deg, 1)) for path in worst[:2]], axis=1)
    assert low[0] > low[1]
    assert [path.contested for path in worst] == [False, high[1] > low[0]]
    assert worst[1].contested
    assert brightest_field(report) == worst[0].field_deg


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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
    """40 seeds: Σz² against the common mean is χ² with 39 degrees of freedom; within 9.5 … 100, false alarm 1e-6."""
    rows = [ghost_of(analyse(scene, seed=seed)) for seed in range(40)]
    for name, unit in (("power", "W"), ("rms_radius", "mm"), ("rms_irradiance", "W_mm2")):
        value, error = f"{name}_{unit}", f"{name}_se_{unit}"
        values = np.array([getattr(row, value) for row in rows])
        errors = np.array([getattr(row, error) for row in rows])
        chi2 = float(np.sum(((values - values.mean()) / errors) ** 2))
        assert 9.5 < chi2 < 100, f"{value}: χ² = {chi2:.1f} for 39 degrees of freedom"

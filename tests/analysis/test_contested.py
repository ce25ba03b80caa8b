"""Fields where the worst ghost is not certain: which are traced again, with how many rays, and what is told of it."""

import importlib

import numpy as np
import pytest
from report.fake_scene import lens_scene
from report.fake_trace import LENS, FakePath, FakeTrace

import mistray
from mistray.analysis.ghosts import GhostReport, ghosts
from mistray.analysis.ranking import bounds
from mistray.analysis.verdict import brightest_field, worst_of_all_fields
from mistray.cli.ghosts_json import as_json
from mistray.errors import Interrupted
from mistray.report.tables.ghosts import CONTESTED, main_table
from mistray.report.tables.ghosts_csv import summary_frame

BRIGHT = f"{LENS} detector:R L1_rear:R detector:A"
RIVAL = f"{LENS} detector:R L1_rear:T L1_front:T window_rear:R L1_front:T L1_rear:T detector:A"
DIRECT = f"{LENS} detector:A"
CLOSE = 10.0  # field, degrees


def lens_trace(field_deg, rays, rival):
    """A field whose ghosts have so many rays, and a second one of `rival` of the irradiance of the first."""
    paths = [
        FakePath(DIRECT, 3.0, rays, radius=0.02),
        FakePath(BRIGHT, 1e-4, rays, y=0.5, radius=0.05),
        FakePath(RIVAL, rival * 1e-4, rays, y=-0.5, radius=0.05),
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

    monkeypatch.setattr(importlib.import_module("mistray.analysis.field_traces"), "trace", trace)
    return calls


def test_a_contested_field_is_traced_again_with_four_times_the_rays(traced):
    """A uniform disc of 100 rays has its area to 10 %, one of 6400 to 1.2 %: ghosts 10 % apart are then distinct."""
    seen = []
    report = ghosts(lens_scene(), [0.0, 10.0], rays=100, contested_rays=6400, progress=lambda *at: seen.append(at))
    assert traced == [(0.0, 100), (10.0, 100), (10.0, 6400)]
    assert seen == [(1, 2), (2, 2), (3, 3)]
    assert report.traced_again == (10.0,)
    assert report[10.0].settings["rays"] == 6400
    assert list(report) == [0.0, 10.0]
    assert report.rivals(10.0).empty
    assert report.top(10.0, 1).events.iloc[0] == BRIGHT
    traced.clear()  # several sources may each have an angle of their own, which stays
    assert ghosts(lens_scene(), rays=100).traced_again == (10.0,)
    assert traced == [(None, 100), (0.0, 100), (None, 400)]


@pytest.mark.parametrize("given", [{"contested_rays": 0}, {"contested_rays": 100}, {"rank": "power"}, {"seconds": 60}])
def test_nothing_is_traced_again(traced, given):
    """With so few rays, by another rank, and within a time."""
    report = ghosts(lens_scene(), [0.0, 10.0], rays=100, **given)
    assert traced == [(0.0, 100), (10.0, 100)]
    assert report.traced_again == ()
    assert {"traced_again_deg", "contested_rays"}.isdisjoint(report.settings)


def test_the_yardstick_has_the_rays_of_its_field(traced, monkeypatch):
    monkeypatch.setitem(globals(), "CLOSE", 0.0)
    report = ghosts(lens_scene(), [10.0, 0.0], rays=100)
    assert report.traced_again == (0.0,)
    assert report.nominal_trace is report[0.0]
    assert report.nominal_trace.settings["rays"] == 400
    assert list(report) == [10.0, 0.0]


def test_an_interrupt_leaves_what_was_traced_first(traced, monkeypatch):
    module = importlib.import_module("mistray.analysis.field_traces")
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
    assert list(rival.events) == [RIVAL]
    assert list(summary_frame(report).rays) == [100, 400]
    told = as_json(report)
    assert [field["rays"] for field in told["fields"]] == [100, 400]
    assert (told["settings"]["traced_again_deg"], told["settings"]["contested_rays"]) == ([10.0], 400)
    assert f"{rival.path_id.iloc[0]} {CONTESTED}" in main_table(report)
    (note,) = [text for text in report.notes if "is open" in text]
    assert f"path {rival.path_id.iloc[0]} may be as bright" in note


def test_the_worst_of_all_fields_are_contested_by_the_first_of_all():
    """The worst of each field is sure there; that of the other may be as bright."""
    first, other = lens_trace(0.0, 400, 0.01), FakeTrace([FakePath(RIVAL, 1e-4, 100, radius=0.05)], 10.0)
    report = GhostReport(lens_scene(), {0.0: first, 10.0: other}, first, {})
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

"""What a ghost analysis comes to: the worst paths of all fields and the surface that is worth changing first."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from report.fake_scene import lens_scene
from report.fake_trace import LENS, FakePath, FakeTrace, paths_at, scatter_paths_at, trace_at

import mistray
from mistray.analysis.ghosts import GhostReport
from mistray.analysis.ranking import bounds
from mistray.analysis.verdict import most_stray, remedy, shares_of_kinds, worst_of_all_fields
from mistray.report.ghosts.answer import verdict


def report_of(paths_by_field, rank="rms"):
    traces = {field: FakeTrace(paths, field) for field, paths in paths_by_field.items()}
    return GhostReport(lens_scene(), traces, traces.get(0.0, trace_at(0.0)), {}, rank)


def test_worst_paths_stand_once_at_their_worst_field():
    report = report_of({field: paths_at(field) for field in (0.0, 10.0)} | {20.0: [*paths_at(20.0)]})
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


def test_a_field_without_stray_light_is_left_with_none():
    """The remedy is not the detector, at which all ghosts of the fake trace turn; a dark one needs none."""
    dark = [FakePath(f"{LENS} detector:A", 1.0, 99)]
    found = remedy(report_of({0.0: paths_at(0.0), 10.0: dark, 20.0: []}))
    assert found.surface == "window_rear"
    assert found.left_W[0.0].value > 0 == found.left_W[10.0].value == found.left_W[20.0].value
    report = report_of({0.0: []})
    assert (worst_of_all_fields(report), most_stray(report), remedy(report)) == ([], None, None)
    assert verdict(report) == ["No stray path reaches the detector."]


def test_shares_of_kinds_add_up():
    report = report_of({0.0: scatter_paths_at(0.0)})
    shares = shares_of_kinds(report, 0.0)
    assert sum(share.value for share in shares.values()) == pytest.approx(100)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    (alone,) = shares_of_kinds(report_of({0.0: [FakePath(f"stop_wall:R {LENS} detector:A", 1e-3, 99)]}), 0.0).values()
    assert (alone.value, alone.se) == pytest.approx((100, 0), abs=1e-9)


@pytest.mark.parametrize(
    ("events", "surface", "deed"),
    [
        (f"{LENS} detector:R window_rear:R L1_front:T L1_rear:T detector:A", "window_rear", "reflects"),
        ("window_front:T window_rear:t L1_front:T L1_rear:T detector:A", "window_rear", "scatters"),
    ],
)
def test_the_surface_to_change(events, surface, deed):
    """Most of the light of field 20 has one cause; a ghost off the lens is left, and all of field 0."""
    ghost = FakePath(f"{LENS} detector:R L1_rear:R detector:A", 1e-4, 400)
    direct = FakePath(f"{LENS} detector:A", 3.0, 1000)
    found = remedy(report_of({0.0: [direct, ghost], 20.0: [ghost, FakePath(events, 9e-4, 500)]}))
    assert (found.surface, found.deed, found.field_deg) == (surface, deed, 20.0)
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


def test_verdict_is_five_sentences_at_most():
    report = report_of({0.0: scatter_paths_at(0.0), 20.0: scatter_paths_at(20.0)})
    sentences = verdict(report)
    assert len(sentences) == 5
    assert all(sentence.endswith(".") for sentence in sentences)
    field = most_stray(report)
    assert f"{field:g}°" in sentences[0]
    assert remedy(report).surface in sentences[3]


def test_what_is_left_without_a_surface_is_left_without_it(load_scene):
    """A plate before a detector: traced again with R = 0 and the same T; equal seeds, so they agree to rounding."""

    def report(rear):
        faces = [
            shape_xml("asphere", name, z, interface_xml(*sides, R=share, T=0.9), semi_diameter=20.0)
            for name, z, sides, share in (
                ("front", 0.0, ("air", "N-BK7"), 0.02), ("rear", 3.0, ("N-BK7", "air"), rear),
            )
        ]  # fmt: skip
        detector = shape_xml("asphere", "detector", 9.0, interface_xml(R=0.3), sensor=True, semi_diameter=15.0)
        scene = load_scene(scene_text(*faces, detector, radius=4.0))
        return mistray.ghosts(scene, field_deg=[0.0, 10.0], rays=4000, max_reflections=3)

    found, after = remedy(report(0.05)), report(0.0)
    assert found.surface == "rear"
    for field, left in found.left_W.items():
        assert left.value == pytest.approx(after.summary(field).stray_W.value, rel=1e-5)
    assert math.isfinite(found.percent.se)
    assert np.isfinite([left.se for left in found.left_W.values()]).all()

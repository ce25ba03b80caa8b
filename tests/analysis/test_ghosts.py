"""Ranking, normalisation and sums of the ghost analysis, on traces whose numbers are known."""

import importlib
import math

import mitsuba as mi
import numpy as np
import pytest
from report.fake_scene import lens_scene
from report.fake_trace import LENS, FakePath, FakeTrace, trace_at, trace_in_colours

import mistray
from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import GhostReport, ghosts
from mistray.analysis.ranking import direct_image
from mistray.analysis.spectral import spectral_maps
from mistray.errors import MistrayError
from mistray.recorders.path_events import STRAY_KINDS
from mistray.report.tables.ghosts import main_table

pytestmark = pytest.mark.quick


@pytest.fixture
def traced(monkeypatch):
    """Replaces the tracer by the fake one and notes its calls."""
    calls = []

    def trace(scene, field_deg=None, progress=None, **settings):
        calls.append({"field_deg": field_deg, **settings})
        if progress:
            progress(500, 1000)
            progress(1000, 1000)
        return trace_at(4.0 if field_deg is None else field_deg)

    monkeypatch.setattr(importlib.import_module("mistray.analysis.field_traces"), "trace", trace)
    return calls


@pytest.fixture
def report():
    traces = {field: trace_at(field) for field in (0.0, 10.0, 20.0)}
    return GhostReport(lens_scene(), traces, traces[0.0], {})


def test_quotient_propagates_both_errors():
    got = Estimate(2.0, 0.02).over(Estimate(4.0, 0.08))
    assert got.value == 0.5
    assert got.se == pytest.approx(0.5 * math.hypot(0.01, 0.02))
    assert math.isnan(Estimate(1.0, 0.1).over(Estimate(0.0, 0.0)).value)


def test_normalised_rms_irradiance_is_over_the_on_axis_image(report):
    direct = report[0.0].paths[0]
    nominal = 3.0 / (math.pi * direct.rms_radius_mm**2)
    assert report.nominal.rms_irradiance_W_mm2.value == pytest.approx(nominal, rel=1e-12)
    table = report.table(20.0)
    expected = table.power_W / (math.pi * table.rms_radius_mm**2) / nominal
    np.testing.assert_allclose(table.normalised_rms_irradiance, expected, rtol=1e-12)
    assert (table.normalised_rms_irradiance_se[~table.few_rays] > 0).all()
    assert table.normalised_rms_irradiance_se[table.few_rays].isna().all()


def test_ranks_by_power_and_by_rms_irradiance_differ(report):
    by_power = report.top(10.0, rank="power")
    by_irradiance = report.top(10.0)
    assert list(by_power.label[:2]) == ["detector → window_rear", "detector → L1_rear"]
    assert list(by_irradiance.label[:2]) == ["detector → L1_rear", "detector → window_rear"]
    assert "direct" not in set(by_power.kind)
    assert list(by_power.rank_power) == [1, 2, 3, 4]


def test_paths_of_a_few_rays_are_ranked_last(report):
    top = report.top(10.0, 4)
    few = top[top.few_rays]
    assert list(few.rays) == [3]
    assert few.rms_irradiance_W_mm2.iloc[0] > top.rms_irradiance_W_mm2.iloc[0]
    assert few.rank_rms_irradiance.iloc[0] == 4


def test_direct_paths_have_no_rank(report):
    table = report.table(0.0)
    assert (table.rank_power[table.kind == "direct"] == 0).all()
    assert sorted(table.rank_power[table.kind != "direct"]) == [1, 2, 3, 4]


def test_summary_adds_up(report):
    s = report.summary(10.0)
    assert s.stray_W.value == pytest.approx(2e-4 + 1e-4 + 3e-6 + 1e-9)
    assert s.stray_W.value == pytest.approx(sum(part.value for part in s.stray_of_kind_W.values()))
    assert s.direct.power_W.value == pytest.approx(3.0, rel=1e-12)
    assert s.ghost_to_signal.value == pytest.approx(s.stray_W.value / 3.0)
    assert s.paths == 5
    assert list(s.paths_of_kind) == ["direct", *STRAY_KINDS]
    assert {kind: count for kind, count in s.paths_of_kind.items() if count} == {
        "direct": 1, "ghost": 2, "structure": 2,
    }  # fmt: skip
    assert s.brightest == report.top(10.0, 1).path_id.iloc[0]


def test_peak_is_that_of_the_stray_map(report):
    image, se = report.stray_map(10.0)
    numbers = report.stray_statistics(10.0)
    assert (numbers.maximum, numbers.maximum_se) == (image.max(), se.flat[np.argmax(image)])
    assert numbers.incident_rays == 903
    nominal, _ = report[0.0].irradiance_of([0])
    assert report.peak_to_nominal(10.0).value == pytest.approx(image.max() / nominal.max())


def test_peak_over_a_nominal_image_of_its_own_trace():
    report = GhostReport(lens_scene(), {10.0: trace_at(10.0)}, trace_at(0.0), {})
    nominal, _ = report.nominal_trace.irradiance_of([0])
    assert report.peak_to_nominal(10.0).value == pytest.approx(report.stray_map(10.0)[0].max() / nominal.max())


def test_out_of_field_there_is_no_signal(report):
    s = report.summary(20.0)
    assert s.direct.power_W.value == 0
    assert math.isnan(s.ghost_to_signal.value)
    assert s.stray_to_nominal.value == pytest.approx(s.stray_W.value / 3.0)


def test_maps_of_direct_and_stray_add_to_the_whole(report):
    (direct,), stray, light = report[10.0].each_map([[0]], [True]), report.stray_light(10.0), report[10.0].light
    np.testing.assert_allclose(direct.value + stray.value, light.value, rtol=1e-12)
    np.testing.assert_allclose(direct.weights + stray.weights, light.weights, rtol=1e-9, atol=1e-9)
    # Paths of one trace share start rays: the squares of the errors add where only one of the two has light
    apart = (direct.value == 0) | (stray.value == 0)
    whole, own, others = (np.square(one.apart).sum(axis=-1) for one in (light, direct, stray))
    np.testing.assert_allclose((own + others)[apart], whole[apart], rtol=1e-9)
    value, se = report.stray_map(10.0)
    assert np.all((se > 0) | np.isnan(se) | (value == 0))
    np.testing.assert_array_equal(np.isnan(se), stray.few_rays)


def test_maps_are_there_for_the_worst_paths_only(report):
    ids = list(report.top(10.0, 4).path_id)
    parts = [report.map(10.0, path_id)[0] for path_id in ids]
    np.testing.assert_allclose(np.sum(parts, axis=0), report.stray_map(10.0)[0], rtol=1e-12)
    with pytest.raises(MistrayError, match="path 0 is not among the worst 4 of field 10 deg"):
        report.map(10.0, 0)


def test_report_is_a_mapping_of_fields(report):
    assert list(report) == [0.0, 10.0, 20.0]
    assert len(report) == 3
    assert 7 not in report
    assert report.get(7) is None
    with pytest.raises(MistrayError, match="field 7 deg was not traced"):
        report.table(7.0)


def test_two_wavelengths_are_one_image():
    """Two discs of equal power 0.4 mm apart: the pooled second moment is the mean one plus 0.2²."""
    lines = [FakePath(f"{LENS} detector:A", 1.0, 5000, x, 0.0, 0.1, wavelength=550 + x) for x in (-0.2, 0.2)]
    trace = FakeTrace(lines)
    image = direct_image(trace.paths)
    a, b = trace.paths
    radius2 = (a.rms_radius_mm**2 + b.rms_radius_mm**2 + ((a.x_mm - b.x_mm) ** 2 + (a.y_mm - b.y_mm) ** 2) / 2) / 2
    assert image.power_W.value == pytest.approx(2.0, rel=1e-12)
    assert image.rms_radius_mm.value**2 == pytest.approx(radius2, rel=1e-12)
    assert image.rms_irradiance_W_mm2.value == pytest.approx(2.0 / (math.pi * radius2), rel=1e-12)


def test_on_axis_field_is_traced_for_the_yardstick(traced):
    report = ghosts("scene", field_deg=[5.0, 20.0], rays=1000, seed=7)
    assert [call["field_deg"] for call in traced] == [0.0, 5.0, 20.0]  # first: an interrupt then leaves a report
    assert traced[0]["max_reflections"] == traced[0]["max_scatters"] == 0
    assert traced[1] == {"field_deg": 5.0, "rays": 1000, "seed": 7}
    assert list(report) == [5.0, 20.0]


def test_on_axis_field_is_not_traced_twice(traced):
    report = ghosts("scene", field_deg=[0, 5, 5.0])
    assert [call["field_deg"] for call in traced] == [0.0, 5.0]
    assert report.nominal_trace is report[0.0]


def test_one_field_needs_no_list(traced):
    assert list(ghosts("scene", field_deg=0.0)) == [0.0]


def test_default_field_is_the_source_s_own(traced):
    assert list(ghosts("scene")) == [4.0]


def test_progress_counts_fields(traced):
    seen = []
    ghosts("scene", field_deg=[0.0, 5.0], progress=lambda done, of: seen.append((done, of)))
    assert seen == [(0.5, 2), (1.0, 2), (1.5, 2), (2.0, 2)]


def test_unknown_arguments_are_an_error(traced):
    with pytest.raises(MistrayError, match="unknown argument max_bounces of ghosts; see mistray"):
        ghosts("scene", field_deg=[0.0], max_bounces=3)
    assert traced == []


def test_no_field_is_an_error(traced):
    with pytest.raises(MistrayError, match="ghosts: field_deg is empty; give at least one"):
        ghosts("scene", field_deg=[])


@pytest.fixture
def colours():
    traces = {field: trace_in_colours(field) for field in (0.0, 10.0)}
    return GhostReport(lens_scene(), traces, traces[0.0], {})


def test_a_path_occurs_once_for_all_wavelengths(colours):
    assert colours.wavelengths_nm == [450.0, 550.0, 650.0]
    table = colours.table(10.0)
    assert len(table) == 5
    assert len(colours.table(10.0, per_wavelength=True)) == 5 * 3 - 1
    assert table.power_W.sum() == pytest.approx(colours[10.0].energy.detected_W, rel=1e-12)
    lens = table[table.ghost_2 == "L1_rear"].iloc[0]
    assert lens.power_W == pytest.approx(1e-4)
    assert len(lens.path_ids) == 3


def test_spectrum_of_a_path(colours):
    table = colours.table(10.0)
    lens, window = (table[table.ghost_2 == name].iloc[0] for name in ("L1_rear", "window_rear"))
    spectrum = colours.spectrum(10.0, lens.path_id)
    assert list(spectrum.wavelength_nm) == [450.0, 550.0, 650.0]
    assert spectrum.power_W.sum() == pytest.approx(lens.power_W)
    assert sorted(spectrum.path_id) == sorted(lens.path_ids)
    assert list(colours.spectrum(10.0, window.path_id).wavelength_nm) == [550.0, 650.0]


def test_one_wavelength_is_normalised_to_the_image_at_it(colours):
    rows = colours.table(10.0, per_wavelength=True)
    row = rows[(rows.wavelength_nm == 650.0) & (rows.ghost_2 == "L1_rear")].iloc[0]
    nominal = colours.nominal_at(650.0)
    assert nominal.power_W.value == pytest.approx(0.25 * 3.0)
    expected = row.rms_irradiance_W_mm2 / nominal.rms_irradiance_W_mm2.value
    assert row.normalised_rms_irradiance == pytest.approx(expected, rel=1e-12)
    assert sorted(rows.rank_power[(rows.wavelength_nm == 450.0) & (rows.kind != "direct")]) == [1, 2, 3]


def test_weight_is_the_share_of_the_launched_flux(colours):
    assert [colours.weight(wavelength) for wavelength in colours.wavelengths_nm] == [0.25, 0.5, 0.25]


def test_summaries_of_the_wavelengths_add_up(colours):
    whole = colours.summary(10.0)
    parts = [colours.summary(10.0, wavelength) for wavelength in colours.wavelengths_nm]
    assert whole.wavelength_nm is None
    assert [part.wavelength_nm for part in parts] == colours.wavelengths_nm
    assert [part.paths for part in parts] == [4, 5, 5]
    assert sum(part.stray_W.value for part in parts) == pytest.approx(whole.stray_W.value)
    assert math.sqrt(sum(part.stray_W.se**2 for part in parts)) == pytest.approx(whole.stray_W.se)
    assert sum(part.map.flux_W for part in parts) == pytest.approx(whole.map.flux_W)
    assert sum(part.direct.power_W.value for part in parts) == pytest.approx(3.0)


def test_maps_hold_all_wavelengths_of_a_path(colours):
    worst = colours.top(10.0, 1).iloc[0]
    image, se = colours.map(10.0, worst.path_id)
    expected, expected_se = colours[10.0].irradiance_of(worst.path_ids)
    np.testing.assert_allclose(image, expected, rtol=1e-12)
    np.testing.assert_allclose(se, expected_se, rtol=1e-12)
    direct, _ = colours[10.0].irradiance_of(colours.table(10.0).path_ids[0])
    np.testing.assert_allclose(direct + colours.stray_map(10.0)[0], colours[10.0].irradiance, rtol=1e-12)


def test_spectral_maps_split_the_light(colours):
    t = colours[10.0]
    maps = spectral_maps(t)
    np.testing.assert_array_equal(maps.wavelengths_nm, [450.0, 550.0, 650.0])
    np.testing.assert_allclose((maps.direct + maps.stray).sum(axis=0), t.irradiance, rtol=1e-12)
    np.testing.assert_allclose(maps.direct[2] + maps.stray[2], t.irradiance_at(650.0)[0], rtol=1e-12)
    np.testing.assert_allclose(maps.stray.sum(axis=0), colours.stray_map(10.0)[0], rtol=1e-12)


def test_a_wavelength_that_was_not_traced_is_an_error(colours):
    for ask in (colours.nominal_at, colours.weight, lambda nm: colours.summary(0.0, nm)):
        with pytest.raises(MistrayError, match="500 nm was not traced"):
            ask(500.0)


def test_wavelengths_weights_and_polarisation_are_passed_on(traced):
    spectrum = {"wavelength_nm": [450.0, 550.0], "weights": [1.0, 2.0], "polarization": "stokes"}
    ghosts("scene", field_deg=[5.0], **spectrum)
    yardstick, field = traced
    assert field == {"field_deg": 5.0, **spectrum}
    assert yardstick == {"field_deg": 0.0, **spectrum, "max_reflections": 0, "max_scatters": 0}


def test_rays_to_draw_are_of_the_wavelength_asked_for(colours, monkeypatch):
    t = colours[10.0]
    asked, sampled = [], t.sampled_rays
    monkeypatch.setattr(t, "sampled_rays", lambda ids, n: asked.append(list(ids)) or sampled(ids, n))
    worst = int(colours.top(10.0, 1).path_id.iloc[0])
    rays = colours.rays_of(10.0, worst)
    assert len(rays) > 0
    (ids,) = asked  # the worst paths all at once
    assert worst in ids
    way = (t.paths[worst].events, t.paths[worst].wavelength_nm)
    assert [i for i in ids if (t.paths[i].events, t.paths[i].wavelength_nm) == way] == [worst]
    assert rays[0][-1, :2] == pytest.approx((t.fakes[worst].x, t.fakes[worst].y))
    assert colours.rays_of(10.0, worst) is rays
    assert len(asked) == 1


def test_watts_are_absorbed_or_incident() -> None:
    """Of a detector that reflects R everywhere: absorbed = (1 - R) incident, by sums, tables and single rays."""
    scene = mistray.load("singlet_window_detector")
    reflectance = float(mi.traverse(scene)["detector.bsdf.R"][0])
    assert reflectance > 0.01
    report = mistray.ghosts(scene, field_deg=[0.0], rays=1000, max_reflections=1)
    s, t = report.summary(0.0), report[0.0]
    for absorbed, incident in ((s.direct.power_W, s.direct_incident_W), (s.stray_W, s.stray_incident_W)):
        assert absorbed.value == pytest.approx((1 - reflectance) * incident.value, rel=1e-5)
        assert absorbed.se == pytest.approx((1 - reflectance) * incident.se, rel=1e-5)
    arriving = t.rays(n=None).flux_W.sum()
    assert arriving == pytest.approx(s.direct_incident_W.value + s.stray_incident_W.value, rel=1e-5)
    text = main_table(report)
    assert "[W absorbed]" in text
    assert "[W incident]" in text

"""Ranking, normalisation and sums of the ghost analysis, on traces whose numbers are known."""

import importlib
import math

import mitsuba as mi
import numpy as np
import pytest
from analyses.fake_trace import LENS, FakePath, FakeTrace, ghosts_of, trace_at, trace_in_colours

import mistray
from mistray.analyses.ghosts.run import ghosts
from mistray.analyses.ghosts.spectral import spectral_maps
from mistray.analyses.ghosts.tables.ghosts import main_table
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.metrics.ranking import direct_image
from mistray.recorders.path_events import STRAY_KINDS

pytestmark = pytest.mark.quick


@pytest.fixture
def report():
    return ghosts_of(*map(trace_at, (0.0, 10.0, 20.0)))


def test_normalised_rms_irradiance_is_over_the_on_axis_image(report):
    direct = report[0.0].paths[0]
    nominal = 3.0 / (math.pi * direct.rms_radius_mm**2)
    assert report.nominal.rms_irradiance_W_mm2.value == pytest.approx(nominal, rel=1e-12)
    table = report.table(20.0)
    expected = table.power_W / (math.pi * table.rms_radius_mm**2) / nominal
    np.testing.assert_allclose(table.normalised_rms_irradiance, expected, rtol=1e-12)
    assert (table.normalised_rms_irradiance_se[~table.few_rays] > 0).all()
    assert table.normalised_rms_irradiance_se[table.few_rays].isna().all()
    got = Estimate(2.0, 0.02).over(Estimate(4.0, 0.08))
    assert (got.value, got.se) == (0.5, pytest.approx(0.5 * math.hypot(0.01, 0.02)))
    assert math.isnan(Estimate(1.0, 0.1).over(Estimate(0.0, 0.0)).value)
    # Two discs of equal power 0.4 mm apart: the pooled second moment is the mean one plus 0.2²
    lines = [FakePath(f"{LENS} detector:A", 1.0, 5000, x, 0.0, 0.1, wavelength=550 + x) for x in (-0.2, 0.2)]
    trace = FakeTrace(lines)
    image = direct_image(trace.paths)
    a, b = trace.paths
    radius2 = (a.rms_radius_mm**2 + b.rms_radius_mm**2 + ((a.x_mm - b.x_mm) ** 2 + (a.y_mm - b.y_mm) ** 2) / 2) / 2
    assert image.power_W.value == pytest.approx(2.0, rel=1e-12)
    assert image.rms_radius_mm.value**2 == pytest.approx(radius2, rel=1e-12)
    assert image.rms_irradiance_W_mm2.value == pytest.approx(2.0 / (math.pi * radius2), rel=1e-12)


def test_ranks_and_sums(report):
    """Power and irradiance differ; a path of a few rays comes last, direct light has no rank."""
    by_power, by_irradiance = report.top(10.0, rank="power"), report.top(10.0, 4)
    assert list(by_power.label[:2]) == ["detector → window_rear", "detector → L1_rear"]
    assert list(by_irradiance.label[:2]) == ["detector → L1_rear", "detector → window_rear"]
    assert list(by_power.rank_power) == [1, 2, 3, 4]
    few = by_irradiance[by_irradiance.few_rays]
    assert (list(few.rays), list(few.rank_rms_irradiance)) == ([3], [4])
    assert few.rms_irradiance_W_mm2.iloc[0] > by_irradiance.rms_irradiance_W_mm2.iloc[0]
    table = report.table(0.0)
    assert (table.rank_power[table.kind == "direct"] == 0).all()
    assert sorted(table.rank_power[table.kind != "direct"]) == [1, 2, 3, 4]
    s = report.summary(10.0)
    assert s.stray_W.value == pytest.approx(2e-4 + 1e-4 + 3e-6 + 1e-9)
    assert s.stray_W.value == pytest.approx(sum(part.value for part in s.stray_of_kind_W.values()))
    assert s.direct.power_W.value == pytest.approx(3.0, rel=1e-12)
    assert s.ghost_to_signal.value == pytest.approx(s.stray_W.value / 3.0)
    assert list(s.paths_of_kind) == ["direct", *STRAY_KINDS]
    counts = {kind: count for kind, count in s.paths_of_kind.items() if count}
    assert (s.paths, counts) == (5, {"direct": 1, "ghost": 2, "structure": 2})
    assert s.brightest == report.top(10.0, 1).path_id.iloc[0]
    outside = report.summary(20.0)  # of the field: there is no signal
    assert outside.direct.power_W.value == 0
    assert math.isnan(outside.ghost_to_signal.value)
    assert outside.stray_to_nominal.value == pytest.approx(outside.stray_W.value / 3.0)


def test_maps_add_to_the_whole(report):
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
    parts = [report.map(10.0, path_id)[0] for path_id in report.top(10.0, 4).path_id]
    np.testing.assert_allclose(np.sum(parts, axis=0), value, rtol=1e-12)
    with pytest.raises(MistrayError, match="path 0 is not among the worst 4 of field 10 deg"):
        report.map(10.0, 0)
    assert list(report) == [0.0, 10.0, 20.0]
    assert (len(report), report.get(7)) == (3, None)
    with pytest.raises(MistrayError, match="field 7 deg was not traced"):
        report.table(7.0)
    # The peak is that of the stray map over that of the nominal image, of the field on axis or of its own trace
    for found in (report, ghosts_of(trace_at(10.0), nominal=trace_at(0.0))):
        image, se = found.stray_map(10.0)
        numbers = found.stray_statistics(10.0)
        assert (numbers.maximum, numbers.maximum_se) == (image.max(), se.flat[np.argmax(image)])
        assert numbers.incident_rays == 903
        nominal, _ = found.nominal_trace.irradiance_of([0])
        assert found.peak_to_nominal(10.0).value == pytest.approx(image.max() / nominal.max())


def test_on_axis_field_is_traced_for_the_yardstick(monkeypatch):
    """Before the others, as an interrupt then leaves a report, with their spectrum and without stray light."""
    traced = []

    def trace(scene, field_deg=None, progress=None, **settings):
        traced.append({"field_deg": field_deg, **settings})
        if progress:
            progress(500, 1000)
            progress(1000, 1000)
        return trace_at(4.0 if field_deg is None else field_deg)

    monkeypatch.setattr(importlib.import_module("mistray.analyses.ghosts.field_traces"), "trace", trace)
    monkeypatch.setattr("mistray.toolkit.analysis.require_scene", lambda *_: None)
    spectrum = {"wavelength_nm": (450.0, 550.0), "weights": (1.0, 2.0), "polarization": "stokes"}
    seen = []
    report = ghosts("scene", field_deg=[5.0, 20.0], rays=1000, seed=7, progress=lambda *at: seen.append(at), **spectrum)
    assert [call["field_deg"] for call in traced] == [0.0, 5.0, 20.0]
    assert traced[0]["max_reflections"] == traced[0]["max_scatters"] == 0
    assert spectrum.items() <= traced[0].items()
    assert traced[1] == {"field_deg": 5.0, "rays": 1000, "seed": 7, **spectrum}
    assert list(report) == [5.0, 20.0]
    assert seen[-2:] == [(1.5, 2), (2.0, 2)]
    traced.clear()
    report = ghosts("scene", field_deg=[0, 5, 5.0])
    assert [call["field_deg"] for call in traced] == [0.0, 5.0]
    assert report.nominal_trace is report[0.0]
    assert list(ghosts("scene", field_deg=0.0)) == [0.0]
    assert list(ghosts("scene")) == [4.0]  # the source's own
    traced.clear()
    for given, words in (
        ({"max_bounces": 3}, "there is no argument 'max_bounces'"),
        ({"field_deg": []}, "field_deg is empty"),
    ):
        with pytest.raises(MistrayError, match=words):
            ghosts("scene", **given)
    assert traced == []


@pytest.fixture
def colours():
    return ghosts_of(*map(trace_in_colours, (0.0, 10.0)))


def test_a_path_occurs_once_for_all_wavelengths(colours):
    """Its spectrum has its lines, its map their light; the ghost off the window lacks 450 nm."""
    assert colours.wavelengths_nm == [450.0, 550.0, 650.0]
    assert [colours.weight(wavelength) for wavelength in colours.wavelengths_nm] == [0.25, 0.5, 0.25]
    table = colours.table(10.0)
    assert (len(table), len(colours.table(10.0, per_wavelength=True))) == (5, 5 * 3 - 1)
    assert table.power_W.sum() == pytest.approx(colours[10.0].energy.detected_W, rel=1e-12)
    lens, window = (table[table.ghost_2 == name].iloc[0] for name in ("L1_rear", "window_rear"))
    assert lens.power_W == pytest.approx(1e-4)
    spectrum = colours.spectrum(10.0, lens.path_id)
    assert list(spectrum.wavelength_nm) == [450.0, 550.0, 650.0]
    assert spectrum.power_W.sum() == pytest.approx(lens.power_W)
    assert sorted(spectrum.path_id) == sorted(lens.path_ids)
    assert list(colours.spectrum(10.0, window.path_id).wavelength_nm) == [550.0, 650.0]
    worst = colours.top(10.0, 1).iloc[0]
    whole = colours[10.0].irradiance_of(worst.path_ids)
    np.testing.assert_allclose(colours.map(10.0, worst.path_id), whole, rtol=1e-12)
    fake, rays = colours[10.0].fakes[worst.path_id], colours.rays_of(10.0, worst.path_id)
    assert rays[0][-1, :2] == pytest.approx((fake.x, fake.y))
    assert colours.rays_of(10.0, worst.path_id) is rays


def test_one_wavelength_is_normalised_to_the_image_at_it(colours):
    rows = colours.table(10.0, per_wavelength=True)
    row = rows[(rows.wavelength_nm == 650.0) & (rows.ghost_2 == "L1_rear")].iloc[0]
    nominal = colours.nominal_at(650.0)
    assert nominal.power_W.value == pytest.approx(0.25 * 3.0)
    expected = row.rms_irradiance_W_mm2 / nominal.rms_irradiance_W_mm2.value
    assert row.normalised_rms_irradiance == pytest.approx(expected, rel=1e-12)
    assert sorted(rows.rank_power[(rows.wavelength_nm == 450.0) & (rows.kind != "direct")]) == [1, 2, 3]
    for ask in (colours.nominal_at, colours.weight, lambda nm: colours.summary(0.0, nm)):
        with pytest.raises(MistrayError, match="500 nm was not traced"):
            ask(500.0)
    whole = colours.summary(10.0)
    parts = [colours.summary(10.0, wavelength) for wavelength in colours.wavelengths_nm]
    assert [part.paths for part in parts] == [4, 5, 5]
    assert sum(part.stray_W.value for part in parts) == pytest.approx(whole.stray_W.value)
    assert math.sqrt(sum(part.stray_W.se**2 for part in parts)) == pytest.approx(whole.stray_W.se)
    assert sum(part.map.flux_W for part in parts) == pytest.approx(whole.map.flux_W)
    assert sum(part.direct.power_W.value for part in parts) == pytest.approx(3.0)
    t = colours[10.0]
    maps = spectral_maps(t)
    np.testing.assert_array_equal(maps.wavelengths_nm, [450.0, 550.0, 650.0])
    np.testing.assert_allclose((maps.direct + maps.stray).sum(axis=0), t.irradiance, rtol=1e-12)
    np.testing.assert_allclose(maps.direct[2] + maps.stray[2], t.irradiance_at(650.0)[0], rtol=1e-12)
    np.testing.assert_allclose(maps.stray.sum(axis=0), colours.stray_map(10.0)[0], rtol=1e-12)


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
    assert all(words in main_table(report) for words in ("[W absorbed]", "[W incident]"))

"""Ranks, sums and maps of ghosts, and numbers as text, tables and files: what is read is what was traced."""

import importlib
import json
import math
import re
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from analyses import fake_trace as fake
from refusals import each_refused, refused

import mistray
from mistray import Trace, ghosts
from mistray.analyses.ghosts.spectral import spectral_maps
from mistray.analyses.ghosts.tables.ghosts_csv import write_csv
from mistray.analyses.ghosts.tables.printed import main_table
from mistray.analyses.study.page import fact_text
from mistray.analyses.study.step import Fact
from mistray.estimate import Estimate
from mistray.files.parquet import unit
from mistray.metrics.ghost_ranking import direct_image
from mistray.recorders.path_events import STRAY_KINDS
from mistray.report import IrradianceMap, read_irradiance, write_formats, write_irradiance, write_parquet
from mistray.toolkit.pages.formats import require_formats
from mistray.toolkit.pages.model import Table, columns
from mistray.toolkit.pages.render import html_parts
from mistray.toolkit.tables.frames import error_of, frame_table, heading_of, value_text
from mistray.toolkit.tables.text import table_text, with_error

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def report():
    return fake.ghosts_of(*map(fake.trace_at, (0.0, 10.0, 20.0)))


@pytest.fixture
def colours():
    return fake.ghosts_of(*map(fake.trace_in_colours, (0.0, 10.0)))


def test_numbers_headings_and_columns():
    """Errors have two digits, values end with them; headings, units and columns of errors follow from names."""
    for value, se, text in (
        (9.354802972e-05, 1.234e-07, "9.355e-05 ± 1.2e-07"),
        (0.95231, 0.00123, "0.9523 ± 0.0012"),
        (12.345, 2.1, "12.3 ± 2.1"),
        (1e-9, 5.8e-8, "1e-09 ± 5.8e-08"),
        (0.0, 2.5e-3, "0 ± 2.5e-03"),
        (1.5, 0.0, "1.5"),
        (1.5, math.nan, "1.5 ± ?"),
        (0.178015, 0.0, "0.17802"),
        (1.247231, 1.6e-5, "1.2472"),
        (1e308, 1e306, "1.000e+308 ± 1.0e+306"),
        (0.0, 0.0, "0"),
        (math.nan, 1.0, "–"),
        (math.inf, 1.0, "–"),
    ):
        assert with_error(Estimate(value, se)) == text
    text = table_text(Table(columns("<name", "power [W]"), [["a", "1.0"], ["longer", "22.0"]]))
    assert text == "name    power\n          [W]\n------  -----\na         1.0\nlonger   22.0"
    headings = {"z_mm": ("z", "mm"), "slope_before_per_deg": ("slope before", "decades/°"), "id": ("surface", "")}
    headings["frequency_per_mm"] = ("frequency", "1/mm")
    assert {name: heading_of(name) for name in headings} == headings
    names = ["pst", "pst_se", "power_W", "power_se_W", "flux_W", "flux_W_se", "rays"]
    errors = ["pst_se", "power_se_W", "flux_W_se", None]
    assert [error_of(column, names) for column in ("pst", "power_W", "flux_W", "rays")] == errors
    assert error_of("direct_per_mm2", ["direct_se_per_mm2"]) == "direct_se_per_mm2"
    values = 3, 12345.0, 0.123456789, -math.inf, math.nan, None, Estimate(0.2, 0.01)
    assert [value_text(value) for value in values] == ["3", "12 345", "0.12346", "-∞", "–", "–", "0.200 ± 0.010"]
    facts = Fact("half field", 18.0, "°"), Fact("focal length", 7.0734, "mm"), Fact("defocus", math.nan, "mm")
    assert [fact_text(fact) for fact in facts] == ["18°", "7.0734 mm", "–"]
    # A table hides its errors below the values
    light = {"power_W": [0.5, math.nan], "power_se_W": [0.01, math.nan]}
    frame = pd.DataFrame({"id": ["<L1>", "wall"], "space": [2, -1], **light, "low": [True, False]})
    html = html_parts([frame_table("t", frame)])
    cells = re.findall(r"<td[^>]*>(.*?)</td>", html)
    assert len(cells) == 2 * 4
    assert [cells[k] for k in (0, 2, 3, 5, 6)] == ["&lt;L1&gt;", "0.500<small>±\u00a00.010</small>", "yes", "–", "–"]
    assert "power_se" not in html


def test_main_table_names_the_worst_ghost_of_each_field(report):
    lines = main_table(report).splitlines()
    ghosts = [line for line in lines if "detector → L1_rear" in line]
    assert [line.split()[0] for line in ghosts] == ["0", "10", "20"]
    assert any("of the direct image on axis" in line for line in lines)
    assert any(line.startswith("energy closure, worst field: ") for line in lines)
    # Limits that cut light are warnings, and so are an open balance, a coarse coating and few rays
    t = fake.trace_at(0.0, cut_events=1e-4)
    before = fake.ghosts_of(t).notes
    assert any("2.0e-05 of the launched flux was cut by max_events = 32" in text for text in before)
    t.energy = replace(t.energy, escaped_W=t.energy.escaped_W + 0.0015)
    t.coating_error = 2e-3
    after = fake.ghosts_of(t).notes
    for words in ("field 0 deg: the energy closes to 3.0e-04 only", "too fast with the angle"):
        assert [any(words in text for text in notes) for notes in (before, after)] == [False, True]
    assert any("field 0, 10, 20 deg: some of the worst four paths hold too few rays" in w for w in report.notes)


def test_csv_holds_every_digit(report, tmp_path):
    files = write_csv(report, tmp_path)
    assert [file.stem for file in files] == ["summary", "paths", "energy", "surfaces", "stray_levels"]
    exact = ("power_W", "power_se_W", "rms_irradiance_W_mm2", "normalised_rms_irradiance")
    by_python = dict.fromkeys(exact, lambda text: float(text or "nan"))  # pandas 2 reads the last bits otherwise
    _, paths, energy, surfaces, _ = (pd.read_csv(file, converters=by_python) for file in files)
    assert list(paths.field_deg.unique()) == [0.0, 10.0, 20.0]
    for field in report:
        written, table = paths[paths.field_deg == field].reset_index(drop=True), report.table(field)
        for name in exact:
            np.testing.assert_array_equal(written[name], table[name])
        assert list(written.events) == list(table.events)
    for _, rows in energy.groupby("field_deg"):
        power = rows.groupby("entry").power_W.sum()
        assert power.drop(["launched", "unaccounted"]).sum() == pytest.approx(power["launched"], rel=1e-12)
        assert list(rows.name[rows.entry == "absorbed in"]) == ["N-BK7"]
    assert len(surfaces) == 3 * 6


def test_csv_per_wavelength_adds_up(colours, tmp_path):
    names = [file.name for file in write_csv(colours, tmp_path, per_wavelength=True)]
    assert names[4:8] == [f"{name}_per_wavelength.csv" for name in ("summary", "paths", "energy", "surfaces")]
    tables = {name: pd.read_csv(tmp_path / name) for name in names}
    for name in ("energy", "surfaces"):
        parts, whole = tables[f"{name}_per_wavelength.csv"], tables[f"{name}.csv"]
        assert list(parts.columns) == ["field_deg", "wavelength_nm", *whole.columns[1:]]
        assert sorted(parts.wavelength_nm.unique()) == list(fake.SHARES)
        column, key = ("power_W", ["field_deg", "name"]) if name == "energy" else ("incident_W", ["field_deg", "id"])
        got, expected = (table.groupby(key)[column].sum() for table in (parts, whole))
        pd.testing.assert_series_equal(got, expected, rtol=1e-9, atol=1e-12)
    paths, whole = tables["paths_per_wavelength.csv"], tables["paths.csv"]
    assert whole.groupby("field_deg").size().tolist() == [5, 5]
    assert [len(ids.split()) for ids in whole.path_ids[whole.ghost_2 == "window_rear"]] == [2, 2]
    got, expected = (table.groupby(["field_deg", "events"]).power_W.sum() for table in (paths, whole))
    pd.testing.assert_series_equal(got, expected, rtol=1e-9)
    plain = main_table(colours)
    assert [line.split()[0] for line in plain.splitlines() if "detector → L1_rear" in line] == ["0", "10"]
    assert "λ" not in plain
    lines = main_table(colours, per_wavelength=True).splitlines()
    start = next(k for k, line in enumerate(lines) if "detector → L1_rear" in line)
    assert " all " in lines[start]
    assert [line.split()[0] for line in lines[start + 1 : start + 4]] == ["450", "550", "650"]
    start = lines.index("Energy ledger") + 4
    ledger = [["0", "all", "5"], ["0", "450", "1.25"], ["0", "550", "2.5"], ["0", "650", "1.25"]]
    assert [line.split()[:3] for line in lines[start : start + 4]] == ledger


UNITS = {"rays": "1", "polarization_se": "1", "power_W": "W", "incident_se_W": "W", "percent_se": "%", "x_mm": "mm"}
UNITS |= {"rms_irradiance_W_mm2": "W/mm²", "rms_irradiance_se_W_mm2": "W/mm²", "wavelength_nm": "nm"}


@pytest.fixture(scope="module")
def trace() -> fake.FakeTrace:
    return fake.scatter_trace_at(5.0)


@pytest.fixture(scope="module")
def one(trace: fake.FakeTrace) -> IrradianceMap:
    return IrradianceMap.of(trace)


def test_tables_come_back(trace: fake.FakeTrace, tmp_path: Path) -> None:
    """Parquet to the last bit, CSV to nine digits; the columns of Parquet have units."""
    import pyarrow.parquet as parquet

    path, table = tmp_path / "paths.parquet", trace.paths.to_pandas()
    trace.paths.to_csv(tmp_path / "paths.csv")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "paths.csv"), table, rtol=1e-8, check_dtype=False)
    trace.paths.to_parquet(path)
    pd.testing.assert_frame_equal(pd.read_parquet(path), table, check_exact=True)
    assert (table.power_W.dtype, table.rays.dtype) == (np.float64, np.int64)
    write_parquet(table, path, {"field_deg": 5.0, "seed": 3})
    schema = parquet.read_schema(path)
    assert {name: schema.field(name).metadata[b"unit"].decode() for name in UNITS} == UNITS
    assert b"unit" not in (schema.field("events").metadata or {})
    assert json.loads(schema.metadata[b"mistray"]) == {"field_deg": 5.0, "seed": 3}
    assert (str(schema.field("power_W").type), str(schema.field("path_id").type)) == ("double", "int64")
    write_parquet(table.iloc[:0], path)
    assert list(pd.read_parquet(path).columns) == list(table.columns)
    assert [unit(column) for column in ("pst_se", "share", "x_direction", "mtf_tangential_50_per_mm")] == ["1"] * 4
    assert [unit(column) for column in ("photons_mm2_s_se", "phase_r_rad", "direct_se_per_mm2")] == [
        "1/(s mm²)", "rad", "1/mm²"
    ]  # fmt: skip


@pytest.mark.parametrize("ending", ["fits", "npy", "EXR"])
def test_maps_come_back(trace: fake.FakeTrace, one: IrradianceMap, tmp_path: Path, ending: str) -> None:
    """To the last bit, but for the single precision of EXR; odd extents, numbers of all sizes, facts beyond ASCII."""
    kind, file = np.float32 if ending == "EXR" else np.float64, tmp_path / f"map.{ending}"
    Trace.write_irradiance(trace, file)
    values, facts = 10.0 ** np.random.default_rng(5).uniform(-30, 30, (2, 3, 5)), {"Feld": "5°", "list": [1, 2.5, None]}
    odd = (IrradianceMap(*values, (-np.pi, 2 / 3, 1e-9 / 3, 0.1 + 0.2), facts, unit) for unit in ("W/mm²", "lx"))
    for written in (one, *odd):
        back = read_irradiance(file if written is one else write_irradiance(written, file))
        assert np.array_equal(back.irradiance, written.irradiance.astype(kind))
        assert np.array_equal(back.irradiance_se, written.irradiance_se.astype(kind), equal_nan=True)
        assert back.extent == (pytest.approx(written.extent, rel=1e-14) if ending == "fits" else written.extent)
        assert (back.facts, back.unit, back.irradiance.dtype.isnative) == (written.facts, written.unit, True)


def test_astropy_places_the_pixels(one: IrradianceMap, tmp_path: Path) -> None:
    """The world coordinate of a pixel is its centre in the frame of the detector, mm; the sum is the flux."""
    from astropy import units
    from astropy.io import fits
    from astropy.wcs import WCS

    write_irradiance(one, tmp_path / "map.fits")
    x0, x1, y0, y1 = fake.EXTENT
    half_x, half_y = (x1 - x0) / fake.SHAPE[1] / 2, (y1 - y0) / fake.SHAPE[0] / 2
    with fits.open(tmp_path / "map.fits", checksum=True) as hdus:
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "STDERR"]
        for hdu in hdus:
            assert units.Unit(hdu.header["BUNIT"]) == units.W / units.mm**2
            wcs = WCS(hdu.header)
            assert wcs.pixel_to_world_values(0, 0) == pytest.approx((x0 + half_x, y0 + half_y))
            last = wcs.pixel_to_world_values(fake.SHAPE[1] - 1, fake.SHAPE[0] - 1)
            assert last == pytest.approx((x1 - half_x, y1 - half_y))
            # wcslib turns mm into m only where it knows the kind of axis
            assert list(wcs.wcs.cunit) == [units.mm, units.mm]
        area = hdus[0].header["CDELT1"] * hdus[0].header["CDELT2"]
        assert hdus[0].data.sum() * area == pytest.approx(one.irradiance.sum() * 4 * 3 / (80 * 60))
    import OpenEXR

    write_irradiance(one, tmp_path / "map.exr")
    with OpenEXR.File(str(tmp_path / "map.exr")) as file:
        assert set(file.channels()) == {"Y", "standard_error.Y"}
        assert np.array_equal(file.channels()["Y"].pixels[0], one.irradiance[-1].astype(np.float32))
        assert file.header()["unit"] == "W/mm^2"
    write_irradiance(one, tmp_path / "map.npy")
    assert np.array_equal(np.load(tmp_path / "map.npy")["irradiance_W_mm2"], one.irradiance)


def test_formats_are_written_by_name_and_wrong_ones_refused(
    one: IrradianceMap, tmp_path: Path, trace: fake.FakeTrace, monkeypatch: pytest.MonkeyPatch
) -> None:
    dark = np.zeros((2, 2))
    bright = IrradianceMap(np.full((2, 2), 1e40), dark, fake.EXTENT)
    np.save(tmp_path / "other.npy", one.irradiance)
    broken = [tmp_path / f"broken.{ending}" for ending in ("fits", "exr", "npy")]
    for file in broken:
        file.write_bytes(b"no map")
    each_refused(
        (lambda: write_irradiance(one, tmp_path / "map.tif"), "its name must end in"),
        (lambda: write_irradiance(one, tmp_path / "nowhere/map.npy"), "check the folder and its permissions"),
        (lambda: write_irradiance(bright, tmp_path / "map.exr"), "1e\\+40 W/mm² is too large for EXR"),
        (lambda: read_irradiance(tmp_path / "map.npy"), "No such file or directory; check the path"),
        (lambda: read_irradiance(tmp_path / "other.npy"), "no field irradiance_se_W_mm2"),
        *((partial(read_irradiance, file), "give a file that mistray wrote") for file in broken),
        (lambda: IrradianceMap(dark, np.zeros((2, 3)), fake.EXTENT, unit="lx"), "give two arrays"),
        (lambda: IrradianceMap(dark, dark, fake.EXTENT, unit="W/m2"), "'W/m2'"),
    )
    table = trace.paths.to_pandas()
    files = write_formats(["npy", "parquet", "fits"], tmp_path, {"paths.csv": table}, {"irradiance_0deg": one})
    assert [file.name for file in files] == ["irradiance_0deg.npy", "paths.parquet", "irradiance_0deg.fits"]
    assert all(file.is_file() for file in files)
    with refused("format 'parket' is unknown; did you mean 'parquet'"):
        write_formats("parket", tmp_path, {"others.csv": table}, {})
    assert not (tmp_path / "others.parquet").exists()
    for package, name in (("pyarrow", "parquet"), ("OpenEXR", "exr"), ("astropy", "fits"), ("fpdf", "pdf")):
        for module in [package, *(module for module in sys.modules if module.startswith(f"{package}."))]:
            monkeypatch.setitem(sys.modules, module, None)
        with refused(r"pip install 'mistray\["):
            require_formats(name)


def test_normalised_rms_irradiance_is_over_the_on_axis_image(report):
    nominal = 3.0 / (math.pi * report[0.0].paths[0].rms_radius_mm ** 2)
    assert report.nominal.rms_irradiance_W_mm2.value == pytest.approx(nominal, rel=1e-12)
    table = report.table(20.0)
    expected = table.power_W / (math.pi * table.rms_radius_mm**2) / nominal
    np.testing.assert_allclose(table.normalised_rms_irradiance, expected, rtol=1e-12)
    assert (table.normalised_rms_irradiance_se[~table.few_rays] > 0).all()
    assert table.normalised_rms_irradiance_se[table.few_rays].isna().all()
    assert Estimate(2.0, 0.02).over(Estimate(4.0, 0.08)) == (0.5, pytest.approx(0.5 * math.hypot(0.01, 0.02)))
    assert math.isnan(Estimate(1.0, 0.1).over(Estimate(0.0, 0.0)).value)
    # Two discs of equal power 0.4 mm apart: the pooled second moment is the mean one plus 0.2²
    lines = [fake.FakePath(f"{fake.LENS} detector:A", 1.0, 5000, x, 0.0, 0.1, wavelength=550 + x) for x in (-0.2, 0.2)]
    trace = fake.FakeTrace(lines)
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
    assert s.paths == 5
    assert s.paths_of_kind == {**dict.fromkeys(["direct", *STRAY_KINDS], 0), "direct": 1, "ghost": 2, "structure": 2}
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
    assert list(report) == [0.0, 10.0, 20.0]
    assert (len(report), report.get(7)) == (3, None)
    each_refused(
        (lambda: report.map(10.0, 0), "path 0 is not among the worst 4 of field 10 deg"),
        (lambda: report.table(7.0), "field 7 deg was not traced"),
    )
    # The peak is that of the stray map over that of the nominal image, of the field on axis or of its own trace
    for found in (report, fake.ghosts_of(fake.trace_at(10.0), nominal=fake.trace_at(0.0))):
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
        return fake.trace_at(4.0 if field_deg is None else field_deg)

    monkeypatch.setattr(importlib.import_module("mistray.analyses.ghosts.field_traces"), "trace", trace)
    monkeypatch.setattr("mistray.toolkit.analysis.require_scene", lambda *_: None)
    spectrum = {"wavelength_nm": (450.0, 550.0), "weights": (1.0, 2.0), "polarization": "stokes"}
    seen = []
    report = ghosts("scene", field_deg=[5.0, 20.0], rays=1000, seed=7, progress=lambda *at: seen.append(at), **spectrum)
    assert [call["field_deg"] for call in traced] == [0.0, 5.0, 20.0]
    assert traced[0]["max_reflections"] == traced[0]["max_scatters"] == 0
    assert spectrum.items() <= traced[0].items()
    assert traced[1] == {"field_deg": 5.0, "rays": 1000, "seed": 7, **spectrum}
    assert (list(report), seen[-2:]) == ([5.0, 20.0], [(1.5, 2), (2.0, 2)])
    traced.clear()
    report = ghosts("scene", field_deg=[0, 5, 5.0])
    assert [call["field_deg"] for call in traced] == [0.0, 5.0]
    assert report.nominal_trace is report[0.0]
    assert list(ghosts("scene", field_deg=0.0)) == [0.0]
    assert list(ghosts("scene")) == [4.0]  # the source's own
    traced.clear()
    each_refused(
        (lambda: ghosts("scene", max_bounces=3), "there is no argument 'max_bounces'"),
        (lambda: ghosts("scene", field_deg=[]), "field_deg is empty"),
    )
    assert traced == []


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
    assert (spectrum.power_W.sum(), sorted(spectrum.path_id)) == (pytest.approx(lens.power_W), sorted(lens.path_ids))
    assert list(colours.spectrum(10.0, window.path_id).wavelength_nm) == [550.0, 650.0]
    with refused("path 999 is not in the table"):
        colours.spectrum(10.0, 999)
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
        with refused("500 nm was not traced"):
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
    assert list(maps.wavelengths_nm) == colours.wavelengths_nm
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

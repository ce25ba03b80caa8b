"""Parquet tables and irradiance maps as EXR, FITS, NPY: what other programs read is what was traced."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report.fake_trace import EXTENT, SHAPE, FakeTrace, scatter_trace_at

from mistray.errors import MistrayError
from mistray.files.parquet import unit
from mistray.report import IrradianceMap, read_irradiance, write_formats, write_irradiance, write_parquet
from mistray.report.formats import require_formats
from mistray.trace import Trace

pytestmark = pytest.mark.quick
UNITS = {"rays": "1", "polarization_se": "1", "power_W": "W", "incident_se_W": "W", "percent_se": "%", "x_mm": "mm"}
UNITS |= {"rms_irradiance_W_mm2": "W/mm²", "rms_irradiance_se_W_mm2": "W/mm²", "wavelength_nm": "nm"}


@pytest.fixture(scope="module")
def trace() -> FakeTrace:
    return scatter_trace_at(5.0)


@pytest.fixture(scope="module")
def one(trace: FakeTrace) -> IrradianceMap:
    return IrradianceMap.of(trace)


def test_tables_come_back(trace: FakeTrace, tmp_path: Path) -> None:
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
    assert [unit(column) for column in ("pst_se", "share", "x_direction")] == ["1"] * 3


@pytest.mark.parametrize("ending", ["fits", "npy", "EXR"])
def test_maps_come_back(trace: FakeTrace, one: IrradianceMap, tmp_path: Path, ending: str) -> None:
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
    x0, x1, y0, y1 = EXTENT
    half_x, half_y = (x1 - x0) / SHAPE[1] / 2, (y1 - y0) / SHAPE[0] / 2
    with fits.open(tmp_path / "map.fits", checksum=True) as hdus:
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "STDERR"]
        for hdu in hdus:
            assert units.Unit(hdu.header["BUNIT"]) == units.W / units.mm**2
            wcs = WCS(hdu.header)
            assert wcs.pixel_to_world_values(0, 0) == pytest.approx((x0 + half_x, y0 + half_y))
            last = wcs.pixel_to_world_values(SHAPE[1] - 1, SHAPE[0] - 1)
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


def test_wrong_names_and_files(one: IrradianceMap, tmp_path: Path) -> None:
    bright = IrradianceMap(np.full((2, 2), 1e40), np.zeros((2, 2)), EXTENT)
    for what, name, words in (
        (one, "map.tif", "its name must end in"),
        (one, "nowhere/map.npy", "check the folder and its permissions"),
        (bright, "map.exr", "1e\\+40 W/mm² is too large for EXR"),
    ):
        with pytest.raises(MistrayError, match=words):
            write_irradiance(what, tmp_path / name)
    np.save(tmp_path / "other.npy", one.irradiance)
    for ending in ("fits", "exr", "npy"):
        (tmp_path / f"broken.{ending}").write_bytes(b"no map")
    for name, words in (
        ("map.npy", "No such file or directory; check the path"),
        ("other.npy", "no field irradiance_se_W_mm2"),
        *((f"broken.{ending}", "give a file that mistray wrote") for ending in ("fits", "exr", "npy")),
    ):
        with pytest.raises(MistrayError, match=words):
            read_irradiance(tmp_path / name)
    for shape, its_unit, words in (((2, 3), "lx", "give two arrays"), ((2, 2), "W/m2", "'W/m2'")):
        with pytest.raises(MistrayError, match=words):
            IrradianceMap(np.zeros((2, 2)), np.zeros(shape), EXTENT, unit=its_unit)


def test_formats_are_written_by_name(
    trace: FakeTrace, one: IrradianceMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = trace.paths.to_pandas()
    files = write_formats(["npy", "parquet", "fits"], tmp_path, {"paths.csv": table}, {"irradiance_0deg": one})
    assert [file.name for file in files] == ["irradiance_0deg.npy", "paths.parquet", "irradiance_0deg.fits"]
    assert all(file.is_file() for file in files)
    for package, name in (("pyarrow", "parquet"), ("OpenEXR", "exr"), ("astropy", "fits"), ("fpdf", "pdf")):
        for module in [package, *(module for module in sys.modules if module.startswith(f"{package}."))]:
            monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(MistrayError, match=r"pip install 'mistray\["):
            require_formats([name])

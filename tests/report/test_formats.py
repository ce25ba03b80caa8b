"""Parquet tables and irradiance maps as EXR, FITS, NPY: what other programs read is what was traced."""

from __future__ import annotations

import builtins
import json
import sys

import numpy as np
import pandas as pd
import pytest
from report.fake_trace import EXTENT, SHAPE, scatter_trace_at, trace_at

from mistray.errors import MistrayError
from mistray.files.parquet import unit
from mistray.report import IrradianceMap, read_irradiance, write_formats, write_irradiance, write_parquet
from mistray.report.formats import require_formats
from mistray.trace import Trace

pytestmark = pytest.mark.quick

UNITS = {
    "path_id": "1",
    "wavelength_nm": "nm",
    "rays": "1",
    "power_W": "W",
    "power_se_W": "W",
    "incident_se_W": "W",
    "percent": "%",
    "percent_se": "%",
    "x_mm": "mm",
    "x_se_mm": "mm",
    "rms_irradiance_W_mm2": "W/mm²",
    "rms_irradiance_se_W_mm2": "W/mm²",
    "polarization": "1",
    "polarization_se": "1",
}


@pytest.fixture(scope="module")
def trace():
    return scatter_trace_at(5.0)


@pytest.fixture(scope="module")
def one(trace):
    return IrradianceMap.of(trace)


def hidden(monkeypatch, name):
    """As if a package were not installed."""
    real = builtins.__import__

    def without(module, *arguments, **keywords):
        if module.partition(".")[0] == name:
            raise ImportError(name)
        return real(module, *arguments, **keywords)

    for module in [module for module in sys.modules if module.partition(".")[0] == name]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(builtins, "__import__", without)


def test_the_path_table_comes_back_from_parquet(trace, tmp_path):
    trace.paths.to_parquet(tmp_path / "paths.parquet")
    table = trace.paths.to_pandas()
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "paths.parquet"), table, check_exact=True)
    assert table.power_W.dtype == np.float64
    assert table.rays.dtype == np.int64


def test_csv_holds_the_same_numbers(trace, tmp_path):
    trace.paths.to_csv(tmp_path / "paths.csv")
    table = trace.paths.to_pandas()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "paths.csv"), table, rtol=1e-8, check_dtype=False)


def test_columns_of_parquet_have_units(trace, tmp_path):
    import pyarrow.parquet as parquet

    write_parquet(trace.paths.to_pandas(), tmp_path / "paths.parquet", {"field_deg": 5.0, "seed": 3})
    schema = parquet.read_schema(tmp_path / "paths.parquet")
    found = {name: schema.field(name).metadata[b"unit"].decode() for name in UNITS}
    assert found == UNITS
    assert b"unit" not in (schema.field("events").metadata or {})
    assert json.loads(schema.metadata[b"mistray"]) == {"field_deg": 5.0, "seed": 3}
    assert str(schema.field("power_W").type) == "double"
    assert str(schema.field("path_id").type) == "int64"


def test_a_table_without_paths(tmp_path, trace):
    empty = trace.paths.to_pandas().iloc[:0]
    write_parquet(empty, tmp_path / "none.parquet")
    assert list(pd.read_parquet(tmp_path / "none.parquet").columns) == list(empty.columns)


@pytest.mark.parametrize("column", ["pst_se", "share", "x_direction"])
def test_pure_numbers_have_unit_one(column):
    assert unit(column) == "1"


@pytest.mark.parametrize("ending", ["fits", "npy"])
def test_maps_come_back_to_the_last_bit(one, tmp_path, ending):
    back = read_irradiance(write_irradiance(one, tmp_path / f"map.{ending}"))
    assert np.array_equal(back.irradiance, one.irradiance)
    assert np.array_equal(back.irradiance_se, one.irradiance_se, equal_nan=True)
    assert back.extent == EXTENT
    assert back.facts == one.facts
    assert back.irradiance.dtype == np.float64
    assert back.irradiance.dtype.isnative


def test_exr_rounds_to_single_precision_and_no_further(one, tmp_path):
    back = read_irradiance(write_irradiance(one, tmp_path / "map.EXR"))
    assert np.array_equal(back.irradiance, one.irradiance.astype(np.float32))
    assert np.array_equal(back.irradiance_se, one.irradiance_se.astype(np.float32), equal_nan=True)
    assert back.extent == EXTENT
    assert back.facts == one.facts


@pytest.mark.parametrize("unit", ["W/mm²", "lx"])
@pytest.mark.parametrize("ending", ["fits", "npy", "exr"])
def test_odd_extents_and_numbers(tmp_path, ending, unit):
    """Extents without a short decimal form, numbers of all sizes, facts that are not ASCII."""
    rng = np.random.default_rng(5)
    values = 10.0 ** rng.uniform(-30, 30, (2, 3, 5))
    one = IrradianceMap(*values, (-np.pi, 2 / 3, 1e-9 / 3, 0.1 + 0.2), {"Feld": "5°", "list": [1, 2.5, None]}, unit)
    back = read_irradiance(write_irradiance(one, tmp_path / f"map.{ending}"))
    kind = np.float32 if ending == "exr" else np.float64
    assert np.array_equal(back.irradiance, values[0].astype(kind))
    assert np.array_equal(back.irradiance_se, values[1].astype(kind))
    assert back.extent == (pytest.approx(one.extent, rel=1e-14) if ending == "fits" else one.extent)
    assert back.facts == one.facts
    assert back.unit == unit


def test_a_unit_that_no_map_has():
    with pytest.raises(MistrayError, match="'W/m2'"):
        IrradianceMap(np.zeros((2, 2)), np.zeros((2, 2)), (0, 1, 0, 1), unit="W/m2")


def test_astropy_places_the_pixels(one, tmp_path):
    """The world coordinate of a pixel is its centre in the frame of the detector, mm; the sum is the flux."""
    from astropy import units
    from astropy.io import fits
    from astropy.wcs import WCS

    write_irradiance(one, tmp_path / "map.fits")
    x0, x1, y0, y1 = EXTENT
    with fits.open(tmp_path / "map.fits", checksum=True) as hdus:
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "STDERR"]
        for hdu in hdus:
            assert units.Unit(hdu.header["BUNIT"]) == units.W / units.mm**2
            wcs = WCS(hdu.header)
            assert wcs.pixel_to_world_values(0, 0) == pytest.approx(
                (x0 + (x1 - x0) / SHAPE[1] / 2, y0 + (y1 - y0) / SHAPE[0] / 2)
            )
            last = wcs.pixel_to_world_values(SHAPE[1] - 1, SHAPE[0] - 1)
            assert last == pytest.approx((x1 - (x1 - x0) / SHAPE[1] / 2, y1 - (y1 - y0) / SHAPE[0] / 2))
            # wcslib turns mm into m only where it knows the kind of axis
            assert list(wcs.wcs.cunit) == [units.mm, units.mm]
        area = hdus[0].header["CDELT1"] * hdus[0].header["CDELT2"]
        assert hdus[0].data.sum() * area == pytest.approx(one.irradiance.sum() * 4 * 3 / (80 * 60))


def test_exr_stands_upright_and_names_its_channels(one, tmp_path):
    import OpenEXR

    write_irradiance(one, tmp_path / "map.exr")
    with OpenEXR.File(str(tmp_path / "map.exr")) as file:
        assert set(file.channels()) == {"Y", "standard_error.Y"}
        assert np.array_equal(file.channels()["Y"].pixels[0], one.irradiance[-1].astype(np.float32))
        assert file.header()["unit"] == "W/mm^2"


def test_npy_is_plain_numpy(one, tmp_path):
    write_irradiance(one, tmp_path / "map.npy")
    assert np.array_equal(np.load(tmp_path / "map.npy")["irradiance_W_mm2"], one.irradiance)


def test_the_trace_writes_its_map(one, trace, tmp_path):
    Trace.write_irradiance(trace, tmp_path / "map.npy")
    assert np.array_equal(read_irradiance(tmp_path / "map.npy").irradiance, trace.irradiance)


@pytest.mark.parametrize(
    ("package", "name", "text"),
    [
        (
            "pyarrow",
            "parquet",
            "Parquet files need pyarrow, which is not installed; run: pip install 'mistray[tables]'",
        ),
        ("OpenEXR", "exr", "EXR files need OpenEXR, which is not installed; run: pip install 'mistray[images]'"),
        ("astropy", "fits", "FITS files need astropy, which is not installed; run: pip install 'mistray[images]'"),
    ],
)
def test_a_missing_package_is_one_line(monkeypatch, one, tmp_path, package, name, text):
    hidden(monkeypatch, package)
    with pytest.raises(MistrayError) as caught:
        require_formats([name])
    assert str(caught.value) == text
    with pytest.raises(MistrayError) as caught:
        write_formats([name], tmp_path, {"paths.csv": pd.DataFrame({"a": [1]})}, {"map": one})
    assert str(caught.value) == text
    assert list(tmp_path.iterdir()) == []


def test_npy_needs_nothing():
    require_formats(["npy"])


def test_wrong_names_and_files(one, tmp_path):
    with pytest.raises(MistrayError, match=r"its name must end in \.fits, \.exr, \.npy"):
        write_irradiance(one, tmp_path / "map.tif")
    with pytest.raises(MistrayError, match="No such file or directory; check the path"):
        read_irradiance(tmp_path / "map.npy")
    with pytest.raises(MistrayError, match="check the folder and its permissions"):
        write_irradiance(one, tmp_path / "nowhere" / "map.npy")
    for ending in ("fits", "exr", "npy"):
        path = tmp_path / f"broken.{ending}"
        path.write_bytes(b"no map")
        with pytest.raises(MistrayError, match="give a file that mistray wrote"):
            read_irradiance(path)
    np.save(tmp_path / "other.npy", one.irradiance)
    with pytest.raises(MistrayError, match="no field irradiance_se_W_mm2"):
        read_irradiance(tmp_path / "other.npy")
    with pytest.raises(MistrayError, match="1e\\+40 W/mm² is too large for EXR"):
        write_irradiance(IrradianceMap(np.full((2, 2), 1e40), np.zeros((2, 2)), EXTENT), tmp_path / "map.exr")
    with pytest.raises(MistrayError, match="give two arrays"):
        IrradianceMap(np.zeros((2, 2)), np.zeros((2, 3)), EXTENT)


def test_formats_are_written_by_name(one, tmp_path):
    table = trace_at(0.0).paths.to_pandas()
    files = write_formats(["npy", "parquet", "fits"], tmp_path, {"paths.csv": table}, {"irradiance_0deg": one})
    assert [file.name for file in files] == ["irradiance_0deg.npy", "paths.parquet", "irradiance_0deg.fits"]
    assert all(file.is_file() for file in files)

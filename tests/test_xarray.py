"""`to_xarray`: the numbers, axes, units and errors of a result, and what is said where xarray is missing."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyses.fake_pst import fake_pst

import mistray
from mistray.recorders.direction_recorder import CLASSES

xarray = pytest.importorskip("xarray")
pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def trace() -> mistray.Trace:
    scene = mistray.load("singlet_window_detector")
    return mistray.trace(scene, rays=2000, field_deg=2.0, wavelength_nm=[500.0, 600.0], weights=[1, 2])


def units_of(found: Any) -> dict[str, str]:
    assert all(item.attrs["long_name"] for item in found.variables.values())
    return {str(name): item.attrs.get("units", "") for name, item in found.variables.items()}


def test_irradiance_and_the_places_of_pixels(trace: mistray.Trace) -> None:
    """The centre of all light by the map is that of the path table, for no hit is off its pixel's middle by more."""
    found = trace.to_xarray()
    assert found.irradiance.dims == ("y", "x")
    np.testing.assert_array_equal(found.irradiance, trace.irradiance)
    np.testing.assert_array_equal(found.irradiance_se, trace.irradiance_se)
    both = found.irradiance_by_wavelength
    np.testing.assert_array_equal(both.sel(wavelength=600.0), trace.irradiance_at(600.0)[0])
    np.testing.assert_allclose(both.sum("wavelength"), trace.irradiance, rtol=1e-12, atol=1e-300)
    units = units_of(found)
    assert {units.pop(name) for name in ("x", "y")} == {"mm"}
    assert units.pop("wavelength") == "nm"
    assert set(units.values()) == {"W mm-2"}
    assert found.irradiance.attrs["ancillary_variables"] == "irradiance_se"
    assert json.loads(found.attrs["facts"])["rays"] == 2000

    pixel = float(found.y[1] - found.y[0])
    area = pixel * float(found.x[1] - found.x[0])
    assert float(found.irradiance.sum()) * area == pytest.approx(trace.energy.detected_W, rel=1e-9)
    rows = trace.paths.to_pandas()
    expected = float((rows.power_W * rows.y_mm).sum() / rows.power_W.sum())
    assert abs(expected) > 5 * pixel, "the light is off the axis"
    centre = float((found.irradiance * found.y).sum() / found.irradiance.sum())
    assert abs(centre - expected) < 0.5 * pixel


def test_pst() -> None:
    angles = [10.0, 20.0, 40.0]
    pst = fake_pst(field_deg=angles, map_pixels=4).to("projected")
    found = pst.to_xarray()
    assert found.pst.dims == ("light", "field", "azimuth")
    assert found.light.values.tolist() == ["total", "stray", *CLASSES]
    stray, ghost = found.sel(light="stray"), found.sel(light="ghost")
    np.testing.assert_array_equal([stray.pst, stray.pst_se], pst.map("stray"))
    np.testing.assert_array_equal([ghost.pst_mean, ghost.pst_mean_se], pst.curve("ghost"))
    np.testing.assert_array_equal(found.field, angles)
    assert (found.field_from < found.field).all()
    assert (found.field < found.field_to).all()
    one = found.sel(field=20.0).isel(azimuth=0)
    np.testing.assert_array_equal([one.irradiance, one.irradiance_se], pst.irradiance(20.0))
    units = units_of(found)
    assert {units[name] for name in ("field", "field_from", "field_to", "azimuth")} == {"degree"}
    assert {units[name] for name in ("pst", "pst_se", "pst_mean", "pst_mean_se")} == {"1"}
    assert units["light"] == ""
    assert "projected" in found.pst.attrs["long_name"]
    assert json.loads(found.attrs["facts"])["convention"] == "projected"
    assert set(fake_pst(field_deg=[10.0]).to_xarray().sizes) == {"light", "field", "azimuth"}  # without maps


def test_as_netcdf_and_back(trace: mistray.Trace, tmp_path: Path) -> None:
    for found in (trace.to_xarray(), fake_pst(field_deg=[10.0, 30.0], map_pixels=3).to_xarray()):
        found.to_netcdf(tmp_path / "result.nc", engine="scipy")
        with xarray.open_dataset(tmp_path / "result.nc", engine="scipy") as back:
            assert back.identical(found)


def test_without_xarray(trace: mistray.Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    for result in (trace, fake_pst(field_deg=[10.0])):
        with pytest.raises(mistray.MistrayError, match=r"^to_xarray needs xarray.*pip install 'mistray\[xarray\]'$"):
            result.to_xarray()

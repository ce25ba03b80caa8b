"""Photometric units: 683 lm/W at 555 nm, illuminant A by colour-science, a lamp in candela, light that nobody sees."""

import json

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds
from lit_detector import lit, square

import mistray
from mistray import MistrayError
from mistray.recorders import FarField, Probe, SurfaceMaps
from mistray.report import read_irradiance
from mistray.spectra.cie import colour_science

DETECTOR = square(5.0, z=10.0)


def beam(**light: object) -> mi.Scene:
    source = {"type": "collimated", "half_width": 5.0, "half_height": 5.0, "irradiance": 0.01, **light}
    return lit(source, detector=DETECTOR)


@pytest.mark.quick
def test_a_watt_at_555_nm():
    """V(555 nm) = 1: 683.002 lm, and over 1e-4 m² 6.83e6 lx in the mean."""
    t = mistray.trace(beam(), rays=4000, wavelength_nm=555.0)
    assert t.luminous_flux[0] == pytest.approx(683.002, rel=1e-6)
    assert t.illuminance[0].mean() == pytest.approx(683.002e4, rel=1e-6)
    # To the error of each pixel, of 32 batches: fails once in 10⁵
    assert np.all(np.abs(t.illuminance[0] - 683.002e4) < 6 * t.illuminance[1] + 1)
    for nm in (300.0, 1550.0):
        dark = mistray.trace(beam(), rays=200, wavelength_nm=nm)
        for what in ("luminous_flux", "illuminance"):
            with pytest.raises(MistrayError, match=f"{nm:g} nm"):
                getattr(dark, what)


def test_illuminant_a_with_power_outside_of_the_visible():
    """Lines every 20 nm, 300 … 1100 nm, against the integral of colour-science over the same lines; most are unseen."""
    lines = np.arange(300.0, 1101.0, 20.0)
    colour = colour_science()
    power = colour.sd_blackbody(2856.0, colour.SpectralShape(300, 1100, 20)).values
    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"].copy()
    inside = [nm for nm in lines if 360 <= nm <= 830]
    exact = sum(power[lines.tolist().index(nm)] * v[nm] for nm in inside)
    walls, sky = SurfaceMaps("walls", "detector", 2, 2), FarField("sky", edges_deg=(0, 90, 180))
    probe = Probe("probe", (0, 0, 5), half_width=6.0, half_height=6.0, pixels=(1, 1), directions=2)
    spectrum = {"wavelength_nm": lines.tolist(), "weights": power.tolist()}
    t = mistray.trace(beam(), rays=100, recorders=[walls, sky, probe], **spectrum)
    efficacy = 683.002 * exact / power.sum()
    assert 50 < efficacy < 55  # most of the power is infrared
    assert t.luminous_flux[0] == pytest.approx(efficacy, rel=1e-5)
    assert t.illuminance[0].mean() == pytest.approx(efficacy * 1e4, rel=1e-5)
    assert np.mean(walls.illuminance["detector"][0]) == pytest.approx(efficacy * 1e4, rel=1e-5)
    assert probe.illuminance[0][0, 0] == pytest.approx(efficacy / 144e-6, rel=1e-5)
    assert sky.luminous_intensity[0].sum() == 0


@pytest.mark.quick
def test_a_lamp_all_around():
    """1 W in all directions at 510 nm, V = 0.503: 683.002 V/(4π) cd, and at a distance of 10 mm that over 1e-4 m²."""
    scene = lit({"type": "point_source", "power": 1.0, "wavelength_nm": 510.0}, detector=DETECTOR | {"z": 20.0})
    sky, size = FarField("sky", edges_deg=(120, 180)), 0.5
    probe = Probe("probe", (0, 0, 10), half_width=size, half_height=size, pixels=(1, 1))
    mistray.trace(scene, rays=100_000, recorders=[sky, probe], ledger=False)
    candela = 683.002 * 0.503 / (4 * np.pi)
    value, se = sky.luminous_intensity
    assert abs(value[0, 0] - candela) < 6 * se[0, 0]  # fails once in 10⁶ of a normal number
    value, se = probe.illuminance  # the mean is 0.25 % less than on axis
    assert abs(value[0, 0] - candela / 1e-4) < 6 * se[0, 0] + 0.003 * candela / 1e-4
    np.testing.assert_allclose(probe.luminance[0].sum() * 4, value[0, 0], rtol=1e-9)  # du dv = 2 × 2


def test_the_command_and_its_files(capsys, tmp_path):
    """The file of the detector over its irradiance is 683.002 lm/W times V(555 nm), and 1e6 mm² are a square metre."""
    command = ["ghosts", "plate", "--rays", 300, "--quiet", "--json", "--photometric"]
    assert "1550" in fails(capsys, *command, "--wavelength-nm", 1550)
    assert "--wavelength-nm" in fails(capsys, *command, "--source", "beam:radius=3")
    more = ["--far-field", "edges_deg=0 90 180", "--formats", "npy", "--out", tmp_path / "out"]
    record = json.loads(succeeds(capsys, *command, "--wavelength-nm", 555, *more))
    (flux,) = record["sections"]["photometric"]["luminous_flux"]
    assert flux["luminous_flux_lm"] == pytest.approx(683.002 * record["fields"][0]["energy"]["detected_W"], rel=1e-6)
    assert [row["unit"] for row in record["sections"]["photometric"]["photometric"]] == ["lx", "cd"]
    lux, watts = (read_irradiance(tmp_path / "out" / f"{name}_0deg.npy") for name in ("illuminance", "irradiance"))
    assert (lux.unit, lux.irradiance.sum()) == ("lx", pytest.approx(683.002e6 * watts.irradiance.sum(), rel=1e-9))

"""Surface transfer functions of scatter models: from the BSDF and from the spectrum, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mistray.analyses.transfer.surface import product, transfer_of_bsdf, transfer_of_spectrum
from mistray.errors import MistrayError, MistrayWarning
from mistray.physics.imaging import surface_transfer as formulas
from mistray.scatter.abg import ABg
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.total import lobe_total

pytestmark = pytest.mark.quick
LINE = 632.8
LAGS_UM = np.array([0.0, 0.1, 1.0, 10.0, 50.0, 200.0, 1e3, 1e4])
B_UM = 400.0
KNEE = LINE * 1e-3 / B_UM  # in direction cosines: shares of the scattered light about this large go beyond the horizon


def mirror(rms_nm: float, **more) -> KCorrelation:
    return KCorrelation(rms_nm, B_UM, 3.0, event="reflection", **more)


@pytest.mark.parametrize("rms_nm", [3.0, 40.0, 90.0])
def test_the_full_theory_has_the_transfer_function_of_harvey(rms_nm):
    """Its BSDF is the transform of exp(a C/σ²) - 1, so that both agree but for light near the horizon."""
    a = (4 * math.pi * rms_nm / LINE) ** 2
    found = transfer_of_bsdf(mirror(rms_nm, theory="ghs_full"), LINE)
    expected = formulas.surface_transfer(formulas.exponential_correlation(LAGS_UM, B_UM / (2 * math.pi)), a)
    # Of the scattered light the horizon and the obliquity take a few of these
    few = 3 * KNEE * (1 + a) * a
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=few)
    assert found.at_lag(np.zeros(1))[0] == pytest.approx(1, abs=1e-12)
    assert found.plateau == pytest.approx(math.exp(-a), abs=few)


@pytest.mark.parametrize("event", ["reflection", "transmission"])
def test_bsdf_and_spectrum_agree_to_the_first_order(event):
    model = KCorrelation(5.0, B_UM, 2.6, event=event)
    n_out = 1.0 if event == "reflection" else 1.5
    by_bsdf = transfer_of_bsdf(model, LINE, event, 1.0, n_out)
    by_spectrum = transfer_of_spectrum(model, LINE, event, 1.0, n_out)
    a = by_spectrum.tis
    # Slope 2.6 leaves (B/λ)^-0.6 of the light at the horizon, where theories differ
    wide = (B_UM / (LINE * 1e-3)) ** -0.6
    np.testing.assert_allclose(by_bsdf.at_lag(LAGS_UM), by_spectrum.at_lag(LAGS_UM), atol=a * a / 2 + a * wide)
    assert by_bsdf.tis == pytest.approx(a, rel=a + wide)


def test_the_spectrum_of_a_band_is_the_closed_form_where_the_band_holds_all():
    """A table of a spectrum is that spectrum; oblique incidence lowers the phase, independent surfaces multiply."""
    a = (4 * math.pi * 10 / LINE) ** 2
    expected = formulas.surface_transfer(formulas.k_correlation(LAGS_UM, B_UM, 5.0), a)
    found = transfer_of_spectrum(KCorrelation(10.0, B_UM, 5.0, event="reflection"), LINE)
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=1e-4 * a)
    f = np.geomspace(1e-6, 4.0, 400)
    table = PsdTable(tuple(f.tolist()), tuple(mirror(4.0).psd(LINE)(f).tolist()), event="reflection")
    of_table, one = (transfer_of_spectrum(model, LINE) for model in (table, mirror(4.0)))
    np.testing.assert_allclose(of_table.at_lag(LAGS_UM), one.at_lag(LAGS_UM), atol=1e-6)
    np.testing.assert_allclose(product([one, one], [LAGS_UM, LAGS_UM]), one.at_lag(LAGS_UM) ** 2)
    oblique = transfer_of_spectrum(mirror(4.0), LINE, cos_i=0.5)
    assert math.log(oblique.plateau) == pytest.approx(math.log(one.plateau) * 0.5**2, rel=1e-9)
    nu = np.array([0.0, 1.0, 30.0])  # frequencies are lags by f-number and footprint
    np.testing.assert_allclose(one.at(nu, 5.0, 20.0), one.at_lag(LINE * 1e-3 * 5.0 * 20.0 * nu))


def test_a_gaussian_lobe_has_a_gaussian_transform():
    width = 1e-3
    found = transfer_of_bsdf(Gaussian(0.2, width), LINE)
    expected = 0.8 + 0.2 * np.exp(-((math.pi * width * LAGS_UM / (LINE * 1e-3)) ** 2))
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=0.2 * 1e-4)


@pytest.mark.parametrize(
    "model",
    [ABg(1e-4, 1e-5, 2.0), HarveyShack(0.5), Particulate(level=500.0), Paint(0.04), mirror(5.0)],
    ids=lambda model: type(model).__name__,
)
def test_tis_is_the_integral_of_the_lobes_at_every_angle(model):
    for angle in (0.0, 45.0, 80.0):
        cos_i = math.cos(math.radians(angle))
        found = transfer_of_bsdf(model, LINE, cos_i=cos_i, share=0.9)
        lobes = [lobe for lobe in model.lobes(LINE, 1.0, 1.0, True) if lobe.event == "reflection"]
        scattered, lost = 0.0, 0.0
        for lobe in lobes:
            total = float(lobe_total(lobe, np.array([cos_i]), 1.0, 1.0)[0])
            scattered += float(np.polyval(lobe.shares[::-1], 0.9)) * total
            depth = lobe.optical_depth
            lost += lobe.shares[1] * total if depth is None else depth * float(lobe.oblique(np.array([cos_i]))[0])
        assert found.tis == pytest.approx(scattered / (scattered + 0.9 * (1 - lost)), rel=1e-9)
        values = found.at_lag(np.array([0.0, 1e-3, 1e6]))
        assert values[0] == pytest.approx(1, abs=1e-9)
        assert values[2] == pytest.approx(found.plateau, abs=1e-3)


def test_a_smooth_surface_changes_nothing():
    for found in (
        transfer_of_spectrum(mirror(0.0), LINE),
        transfer_of_bsdf(mirror(0.0), LINE),
        transfer_of_bsdf(ABg(0.0, 1e-5, 2.0), LINE),
        transfer_of_spectrum(mirror(5.0, side="front"), LINE, "transmission", 1.5, 1.5),
    ):
        assert found.tis == 0
        np.testing.assert_array_equal(found.at([0.0, 100.0], 4.0, 25.0), 1)


def test_a_rough_surface_is_told():
    with pytest.warns(MistrayWarning, match="not smooth in reflection at 632.8 nm"):
        found = transfer_of_spectrum(mirror(120.0), LINE)
    assert found.plateau == pytest.approx(math.exp(-((4 * math.pi * 120 / LINE) ** 2)), rel=0.02)
    # and is smooth in the infrared
    assert transfer_of_spectrum(mirror(120.0), 10600.0).tis == pytest.approx((4 * math.pi * 120 / 10600) ** 2, rel=0.05)


def test_what_cannot_be_is_refused():
    for named, call in (
        ("event", lambda: transfer_of_bsdf(mirror(1.0), LINE, "both")),
        ("wavelength_nm", lambda: transfer_of_spectrum(mirror(1.0), 0.5)),
        ("totally reflected", lambda: transfer_of_bsdf(mirror(1.0), LINE, "transmission", 1.5, 1.0, cos_i=0.2)),
        ("nothing goes on", lambda: transfer_of_bsdf(mirror(1.0), LINE, share=0.0)),
        ("f_number", lambda: transfer_of_spectrum(mirror(1.0), LINE).at([1.0], 0.0, 1.0)),
        ("frequencies_per_mm", lambda: transfer_of_spectrum(mirror(1.0), LINE).at([-1.0], 1.0, 1.0)),
    ):
        with pytest.raises(MistrayError, match=named):
            call()

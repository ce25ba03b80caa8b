"""The ABg model against float64 test vectors, TracePro's sheet, and quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
import vectors
from oracles import scatter_integrals
from scipy.integrate import quad

from mistray.errors import MistrayError
from mistray.physics import abg
from mistray.physics.disc import disc_total

pytestmark = pytest.mark.quick

VECTORS, QUADRATURE = 1e-6, 1e-4  # relative, as required

# σ 50 Å, correlation length 100 µm, λ 0.5 µm, Δn 2, R 0.95: the sheet "ABg from RMS"
SHEET = {"rms_um": 0.005, "correlation_length_um": 100.0, "wavelength_um": 0.5, "index_step": 2.0, "reflectance": 0.95}
SHEET_INTEGRAL = 0.015552516


def test_directions() -> None:
    """|β - β0| from angles, for the A, B and g that both sources plot."""
    table = vectors.frame("abg_directions.csv")
    theta_i, theta_s, phi = (np.radians(table[key]) for key in ("theta_i", "theta_s", "phi_s_from_specular"))
    r = np.hypot(np.sin(theta_s) * np.cos(phi) - np.sin(theta_i), np.sin(theta_s) * np.sin(phi))
    np.testing.assert_allclose(r, table["abs_dbeta"], rtol=VECTORS, atol=1e-12)
    np.testing.assert_allclose(abg.bsdf(r.to_numpy(), 0.0025, 0.001, 1.8), table["BSDF"], rtol=VECTORS)


@pytest.mark.parametrize("b", [2e-12, 1e-6, 1e-2, 3.0])
@pytest.mark.parametrize("g", [2 / 3, 1.0, 2.0])
@pytest.mark.parametrize("step", [0.0, 1e-12, -1e-10, 1e-8, 1e-6, -1e-4])
def test_tis_where_the_hypergeometric_function_degenerates(b: float, g: float, step: float) -> None:
    g = g * (1 + step)
    expected = scatter_integrals.total_scatter(scatter_integrals.abg(1.0, b, g), 0.0)
    assert abg.tis(1.0, b, g) == pytest.approx(expected, rel=VECTORS)


@pytest.mark.parametrize("b", [1e-12, 1e-3, 0.5, 3.0, 1e300])
@pytest.mark.parametrize("g", [1e-308, 1e-6, 1e-2, 0.3, 0.999])
def test_tis_of_slight_slopes(b: float, g: float) -> None:
    """2π A ∫ r dr/(B + r^g) over r = exp(-t); the function of 1/B was lost below g 0.03."""
    integral, _ = quad(lambda t: math.exp(-2 * t) / (b + math.exp(-g * t)), 0, 300, epsabs=0, epsrel=1e-12, limit=500)
    assert abg.tis(1.0, b, g) == pytest.approx(2 * math.pi * integral, rel=1e-11)


def test_tis_limits() -> None:
    assert abg.tis(0.3, 0.5, 0.0) == pytest.approx(math.pi * 0.3 / 1.5, rel=1e-15)  # Lambertian
    assert abg.tis(0.3, 0.0, 1.5) == pytest.approx(2 * math.pi * 0.3 / 0.5, rel=1e-15)
    assert abg.tis(0.3, 1e-14, 0.5) == pytest.approx(abg.tis(0.3, 0.0, 0.5), rel=VECTORS)
    for sine in (0.0, 0.6, 1.0):
        assert disc_total(lambda r: abg.bsdf(r, 0.05 / math.pi, 0.0, 0.0), sine) == pytest.approx(0.05, rel=1e-12)
    with pytest.raises(MistrayError, match="give B > 0"):
        abg.tis(1.0, 0.0, 2.0)
    a, b = abg.at_wavelength(1.0, 1e-6, 2.0, 1.0, step_ratio=3.0, specular_ratio=0.5)
    assert (a, b) == (pytest.approx(4.5), pytest.approx(1e-6))


def sheet() -> dict[str, float]:
    return dict(vectors.frame("tracepro_sheet.csv").set_index("quantity")["computed"])


def test_sheet_abg_from_rms() -> None:
    """Every cell of TracePro's sheet, with the sheet's own integral."""
    expected, found = sheet(), abg.abg_from_rms(**SHEET, raw_integral=SHEET_INTEGRAL)
    cells = {
        "As_um4": found.psd_amplitude_um4,
        "Bs_um": found.psd_length_um,
        "C": found.psd_slope,
        "D_um-4": found.bsdf_per_psd,
        "BSDF0=D*As": found.bsdf_0,
        "BP_TIS=R(1-exp(-(2 pi dn sigma/lam)^2))": found.tis,
        "B=(lam/Bs)^g": found.b,
        "g": found.g,
        "correction=BP/raw": found.correction,
        "min wave = sigma/0.02": found.shortest_wavelength_um,
    }
    for name, value in cells.items():
        assert value == pytest.approx(expected[name], rel=VECTORS), name
    assert f"{found.a:.5E}" == "1.81832E-06"  # as the sheet prints it
    total = abg.tis(found.a, found.b, found.g)
    printed = expected["TIS of the sheet's own final ABg (A,B,g)"]
    assert total == pytest.approx(printed, rel=1e-5)  # A has 6 digits there
    assert total > 1.16 * found.tis


def test_abg_from_rms_scatters_what_it_says() -> None:
    expected, found = sheet(), abg.abg_from_rms(**SHEET)
    assert found.a == pytest.approx(expected["A for exact ABg TIS = BP"], rel=VECTORS)
    rng = np.random.default_rng(2)
    for _ in range(20):
        wavelength = rng.uniform(0.3, 2)
        result = abg.abg_from_rms(
            rng.uniform(1e-4, 0.02) * wavelength, 10 ** rng.uniform(0, 3), wavelength, rng.uniform(0.3, 2), 0.9
        )
        profile = scatter_integrals.abg(result.a, result.b, result.g)
        assert scatter_integrals.total_scatter(profile, 0.0) == pytest.approx(result.tis, rel=QUADRATURE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rms_um": 0.0}, "rms is 0; it must"),
        ({"rms_um": math.nan}, "rms is nan; it must"),
        ({"correlation_length_um": -1.0}, "correlation length is -1; it must"),
        ({"wavelength_um": 0.0}, "wavelength is 0; it must"),
        ({"wavelength_um": 0.2}, "is not smooth at 0.2 um; give at least 0.25 um"),
        ({"index_step": 0.0}, "index step is 0"),
        ({"reflectance": 1.2}, "reflectance is 1.2"),
        ({"raw_integral": 0.0}, "raw integral is 0"),
    ],
)
def test_abg_from_rms_refuses(change: dict[str, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        abg.abg_from_rms(**{**SHEET, **change})

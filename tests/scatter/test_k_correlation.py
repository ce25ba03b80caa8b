"""The K-correlation model with each theory: lobes against the theories' formulas, totals, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from oracles.scatter_integrals import gauss_legendre

from mistray.errors import MistrayError
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack, rayleigh_rice
from mistray.physics import k_correlation as kc
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.lobe import Lobe
from mistray.scatter.total import factor_values, lobe_total

QUADRATURE = 1e-4  # relative, as required
TABLE = 0.01  # share of the flux that a ratio table may put elsewhere, up to 75° of incidence
WAVELENGTH_UM = 0.55
ALUMINIUM = 0.958 + 6.69j
ANGLES_DEG = np.array([0.0, 30.0, 60.0, 75.0])
BSDF = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # of cos θi, cos θs, cos φ, r


def only(model: KCorrelation, event: str, n_in: float = 1.0, n_out: float = 1.5168) -> Lobe:
    (lobe,) = (lobe for lobe in model.lobes(1e3 * WAVELENGTH_UM, n_in, n_out, True) if lobe.event == event)
    return lobe


def polar(sine: float) -> tuple[np.ndarray, ...]:
    """
    Directions above the horizon in polar coordinates about the specular direction.

    r, ψ, cos θs, cos φ and weights, whose sum is π: the area of the disc of direction cosines.
    """
    inside = 1 - sine
    # panels shrink towards the peak, and towards the horizon, where cos θs is a square root
    edges = np.concatenate([[0.0], np.logspace(-6, -0.3, 47), 1 - np.logspace(-0.5, -6, 12), [1.0]])
    r, weight = gauss_legendre(inside * edges, 8)
    if sine > 0:
        t, w = gauss_legendre(np.pi * np.concatenate([[0.0], np.logspace(-5, 0, 33)]), 8)
        r, weight = np.concatenate([r, 1 - sine * np.cos(t)]), np.concatenate([weight, w * sine * np.sin(t)])
        half = np.arccos(np.clip((r * r + sine * sine - 1) / (2 * sine * r), -1, 1))
    else:
        half = np.full(len(r), np.pi)
    # u² (3 - 2u) takes the square root of cos θs at the horizon
    u, v = gauss_legendre(np.linspace(0, 1, 9), 8)
    psi = np.pi - half[:, None] * (1 - u * u * (3 - 2 * u))
    x, y = sine + r[:, None] * np.cos(psi), r[:, None] * np.sin(psi)
    beta = np.hypot(x, y)
    weights = 2 * (weight * r * half)[:, None] * v * 6 * u * (1 - u)
    cos_phi = np.divide(x, beta, out=np.ones_like(x), where=beta > 0)
    return np.broadcast_to(r[:, None], x.shape), psi, np.sqrt(np.maximum(0, 1 - beta**2)), cos_phi, weights


def specular(angle_deg: float, event: str, n_in: float, n_out: float) -> tuple[float, float]:
    """cos θi and the sine of the specular direction."""
    sine = math.sin(math.radians(angle_deg))
    return math.sqrt(1 - sine * sine), sine if event == "reflection" else sine * n_in / n_out


def compare(lobe: Lobe, bsdf: BSDF, n_in: float = 1.0, n_out: float = 1.5168, angles_deg: Any = ANGLES_DEG) -> Any:
    """Per angle: total of the lobe, total of the formula, and the flux of their absolute difference over the latter."""
    rows = []
    for angle in angles_deg:
        cos_i, sine = specular(angle, lobe.event, n_in, n_out)
        if sine >= 1:
            continue
        r, psi, cos_s, cos_phi, weight = polar(sine)
        expected = bsdf(cos_i, cos_s, cos_phi, r)
        found = factor_values(lobe, cos_i, cos_s) * lobe.profile(r)
        if lobe.ratio is not None:
            pair = (r, psi) if lobe.ratio.axes == "radial" else (cos_s, np.arccos(np.clip(cos_phi, -1, 1)))
            found = found * lobe.ratio.at(np.sqrt(1 - sine * sine), *pair)
        total = lobe_total(lobe, np.array([cos_i]), n_in, n_out)[0]
        whole = np.sum(weight * expected)
        rows.append((total, whole, np.sum(weight * np.abs(found - expected)) / whole))
    return np.array(rows).T


def test_oracle() -> None:
    for sine in (0.0, 0.5, 0.99):
        r, psi, cos_s, cos_phi, weight = polar(sine)
        assert weight.sum() == pytest.approx(np.pi, rel=1e-6)
        assert np.sum(weight * cos_s) == pytest.approx(2 * np.pi / 3, rel=1e-6)
        assert np.sum(weight * cos_s * cos_phi) == pytest.approx(0, abs=QUADRATURE)
        np.testing.assert_allclose(sine + r * np.cos(psi), np.sqrt(1 - cos_s**2) * cos_phi, atol=1e-7)


@pytest.mark.parametrize("slope", [1.5, 2.0, 2.7])
def test_ghs_reflection(slope: float) -> None:
    """From air and from inside glass, where λ is shorter."""
    model = KCorrelation(1.0, 20.0, slope, band_limited=True)
    for n_in, n_out in ((1.0, 1.5168), (1.5168, 1.0)):

        def bsdf(cos_i, cos_s, cos_phi, r, n=n_in):
            psd = kc.psd_um4(n * r / WAVELENGTH_UM, model.amplitude_um4(1e3 * WAVELENGTH_UM), 20.0, slope)
            return ghs.smooth(ghs.path_in_reflection(cos_i, cos_s, n), psd, WAVELENGTH_UM, n)

        total, expected, difference = compare(only(model, "reflection", n_in, n_out), bsdf, n_in, n_out)
        np.testing.assert_allclose(total, expected, rtol=QUADRATURE)
        assert np.all(difference < 1e-12)


def test_totals_of_smooth_surfaces() -> None:
    """A long correlation length: (2π Δn σ/λ)² in reflection and transmission, from both sides."""
    model = KCorrelation(2.0, 2000.0, 3.0)
    for n_in, n_out in ((1.0, 1.5168), (1.5168, 1.0)):
        for event, step in (("reflection", 2 * n_in), ("transmission", 0.5168)):
            total = lobe_total(only(model, event, n_in, n_out), np.array([1.0]), n_in, n_out)[0]
            # what lies in the wings, beyond the band or where the path is another, is λ/B of it at a slope of 3
            assert total == pytest.approx(harvey_shack.tis_from_rms(2e-3, WAVELENGTH_UM, step), rel=2e-3)


@pytest.mark.parametrize(("n_in", "n_out"), [(1.0, 1.5168), (1.5168, 1.0)])
def test_ghs_transmission(n_in: float, n_out: float) -> None:
    model = KCorrelation(1.0, 20.0, 2.5)

    def bsdf(cos_i, cos_s, cos_phi, r):
        psd = kc.psd_um4(n_out * r / WAVELENGTH_UM, model.amplitude_um4(1e3 * WAVELENGTH_UM), 20.0, 2.5)
        return ghs.smooth(ghs.path_in_transmission(cos_i, cos_s, n_in, n_out), psd, WAVELENGTH_UM, n_out)

    total, expected, difference = compare(only(model, "transmission", n_in, n_out), bsdf, n_in, n_out)
    np.testing.assert_allclose(total, expected, rtol=TABLE)
    assert np.all(difference < TABLE)


def test_ghs_full() -> None:
    """Where exp(-a) is 0.98 and 0.14, and against the smooth form where a is small."""
    for rms_nm in (6.0, 61.0):
        model = KCorrelation(rms_nm, 100 * math.pi, 3.0, theory="ghs_full")

        def bsdf(cos_i, cos_s, cos_phi, r, rms_nm=rms_nm):
            return ghs.exponential(cos_i + cos_s, r / WAVELENGTH_UM, 1e-3 * rms_nm, 50.0, WAVELENGTH_UM)

        total, expected, difference = compare(only(model, "reflection"), bsdf)
        np.testing.assert_allclose(total, expected, rtol=TABLE)
        assert np.all(difference < TABLE)
        lost = -math.expm1(-harvey_shack.tis_from_rms(1e-3 * rms_nm, WAVELENGTH_UM, 2.0))
        assert total[0] == pytest.approx(lost, rel=TABLE)  # no constant restores what the path takes from the wings
    r = np.array([0.0, 0.01, 0.5])
    full, smooth = (only(KCorrelation(0.1, 12.0, 3.0, theory=theory), "reflection") for theory in ("ghs_full", "ghs"))
    np.testing.assert_allclose(full.profile(r), smooth.profile(r), rtol=1e-5)
    assert {lobe.event for lobe in KCorrelation(40.0, 12.0, 3.0, theory="ghs_full").lobes(550.0, 1.0, 1.5, True)} == {
        "reflection",
        "transmission",
    }


def test_rayleigh_rice() -> None:
    """In a medium of index n the wavelength is λ/n."""
    model = KCorrelation(1.0, 20.0, 2.5, theory="rayleigh_rice", event="reflection")
    for n_in, n_out in ((1.0, 1.5168), (1.5168, 1.0)):

        def bsdf(cos_i, cos_s, cos_phi, r, n=n_in):
            psd = kc.psd_um4(n * r / WAVELENGTH_UM, model.amplitude_um4(1e3 * WAVELENGTH_UM), 20.0, 2.5)
            return rayleigh_rice.brdf(cos_i, cos_s, 1.0, psd, WAVELENGTH_UM / n)

        total, expected, difference = compare(only(model, "reflection", n_in, n_out), bsdf, n_in, n_out)
        np.testing.assert_allclose(total, expected, rtol=QUADRATURE)
        assert np.all(difference < 1e-12)


@pytest.mark.parametrize("relative_to", ["specular", "incident"])
@pytest.mark.parametrize("substrate", [None, ALUMINIUM])
def test_vector_reflection(substrate: complex | None, relative_to: str) -> None:
    """Times R of the coating it holds Q/R, absolute it holds Q."""
    model = KCorrelation(
        1.0, 20.0, 2.5, theory="rayleigh_rice_vector", event="reflection", substrate=substrate, relative_to=relative_to
    )
    index = substrate or 1.5168

    def bsdf(cos_i, cos_s, cos_phi, r):
        psd = kc.psd_um4(r / WAVELENGTH_UM, model.amplitude_um4(1e3 * WAVELENGTH_UM), 20.0, 2.5)
        q = rayleigh_rice.polarization_factor(cos_i, cos_s, cos_phi, index)
        whole = rayleigh_rice.polarization_factor(cos_i, cos_i, 1.0, index) if relative_to == "specular" else 1.0
        return rayleigh_rice.brdf(cos_i, cos_s, q / whole, psd, WAVELENGTH_UM)

    lobe = only(model, "reflection")
    assert lobe.shares == ((0, 1, 0) if relative_to == "specular" else (1, 0, 0))
    total, expected, difference = compare(lobe, bsdf)
    np.testing.assert_allclose(total, expected, rtol=TABLE)
    assert np.all(difference < TABLE)


@pytest.mark.parametrize(("n_in", "n_out"), [(1.0, 1.5168), (1.5168, 1.0)])
def test_vector_transmission(n_in: float, n_out: float) -> None:
    model = KCorrelation(1.0, 20.0, 2.5, theory="rayleigh_rice_vector")

    def bsdf(cos_i, cos_s, cos_phi, r):
        refracted = math.sqrt(1 - (n_in / n_out) ** 2 * (1 - cos_i * cos_i))
        psd = kc.psd_um4(n_out * r / WAVELENGTH_UM, model.amplitude_um4(1e3 * WAVELENGTH_UM), 20.0, 2.5)
        q = rayleigh_rice.transmitted_factor(cos_i, cos_s, cos_phi, n_out / n_in)
        whole = rayleigh_rice.transmitted_factor(cos_i, refracted, 1.0, n_out / n_in)
        path = ghs.path_in_transmission(cos_i, refracted, n_in, n_out)
        return ghs.smooth(path, psd, WAVELENGTH_UM, n_out) * q / whole

    total, expected, difference = compare(only(model, "transmission", n_in, n_out), bsdf, n_in, n_out)
    np.testing.assert_allclose(total, expected, rtol=TABLE)
    assert np.all(difference < TABLE)


def test_band() -> None:
    """A total roughness and one of a reference wavelength are the surface's; one of the light's wavelength is not."""
    assert KCorrelation(1.0, 20.0, 3.0).amplitude_um4(400.0) == KCorrelation(1.0, 20.0, 3.0).amplitude_um4(800.0)
    band = KCorrelation(1.0, 20.0, 2.0, band_limited=True)
    fixed = KCorrelation(1.0, 20.0, 2.0, band_limited=True, reference_nm=500.0)
    assert fixed.amplitude_um4(400.0) == fixed.amplitude_um4(800.0) == band.amplitude_um4(500.0)
    assert band.amplitude_um4(400.0) < band.amplitude_um4(800.0)
    assert band.amplitude_um4(500.0) == pytest.approx(1e-6 * 400 / (math.pi * math.log1p(20.0**2 / 0.25)), rel=1e-12)


def test_no_lobes() -> None:
    assert KCorrelation(0.0, 20.0, 3.0).lobes(550.0, 1.0, 1.5, True) == ()
    assert [lobe.event for lobe in KCorrelation(1.0, 20.0, 3.0).lobes(550.0, 1.5, 1.5, True)] == ["reflection"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rms_nm": -1.0}, "rms_nm is -1; it must lie"),
        ({"B_um": 0.0}, "B_um is 0; it must lie"),
        ({"slope": 0.0}, "slope is 0; it must lie"),
        ({"slope": 2.0}, "slope is 2, whose total roughness is infinite; give slope > 2 or band_limited"),
        ({"slope": math.nan}, "slope is nan"),
        ({"theory": "beckmann"}, "theory is 'beckmann'"),
        ({"theory": "ghs_full", "slope": 2.5}, "ghs_full needs slope 3"),
        ({"theory": "ghs_full", "band_limited": True}, "ghs_full needs slope 3 and a total roughness"),
        ({"theory": "rayleigh_rice"}, "rayleigh_rice is about reflection, event is 'both'"),
        ({"reference_nm": 550.0}, "reference_nm goes with band_limited"),
        ({"reference_nm": 0.0, "band_limited": True}, "reference_nm is 0; it must"),
        ({"substrate": 1.5 + 0j}, "substrate goes with theory rayleigh_rice_vector"),
        ({"substrate": -1 + 2j, "theory": "rayleigh_rice_vector"}, "substrate is -1"),
    ],
)
def test_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises(MistrayError, match=message) as caught:
        KCorrelation(**{"rms_nm": 1.0, "B_um": 20.0, "slope": 3.0, "name": "lens", **options})
    assert str(caught.value).startswith("KCorrelation 'lens': ")


def test_refuses_rough_surfaces() -> None:
    rough = KCorrelation(20.0, 20.0, 3.0)
    with pytest.raises(MistrayError, match=r"not smooth in reflection at 550 nm .*"):
        rough.lobes(550.0, 1.0, 1.5, True)
    assert len(KCorrelation(20.0, 20.0, 3.0, event="transmission").lobes(550.0, 1.0, 1.5, True)) == 1
    # most of this roughness is of frequencies that do not scatter
    assert len(KCorrelation(20.0, 0.3, 2.2).lobes(550.0, 1.0, 1.5, True)) == 2
    with pytest.raises(MistrayError, match=r"rms roughness 100 nm is too much in reflection .* limit 2\)"):
        KCorrelation(100.0, 20.0, 3.0, theory="ghs_full").lobes(550.0, 1.0, 1.5, True)


def test_vector_theory_needs_a_step_of_index() -> None:
    model = KCorrelation(1.0, 20.0, 3.0, theory="rayleigh_rice_vector")
    with pytest.raises(MistrayError, match="indices are 1 on both sides, which has no reflection"):
        model.lobes(550.0, 1.0, 1.0, True)
    mirror = KCorrelation(1.0, 20.0, 3.0, theory="rayleigh_rice_vector", substrate=ALUMINIUM)
    assert [lobe.event for lobe in mirror.lobes(550.0, 1.0, 1.0, True)] == ["reflection"]


def test_advice() -> None:
    assert KCorrelation(1.0, 20.0, 3.0).advice() is None
    assert "slope 4.5" in str(KCorrelation(1.0, 20.0, 4.5).advice())

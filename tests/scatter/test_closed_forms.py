"""Lobes of all models against their equations in float64: values over the hemisphere, and totals."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pytest
import scatter_forms as forms
import vectors
from oracles import scatter_integrals
from scatter_forms import BAND_UM, FORMS, WAVELENGTH_NM, WAVELENGTH_UM, K, Light, lambertian, scalar_rayleigh_rice

from mistray.physics import harvey_shack, rayleigh_rice
from mistray.physics import phong as phong_physics
from mistray.scatter.abg import ABg
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.scatter.evaluate import bsdf
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.kinds import KINDS
from mistray.scatter.paint import PRESETS, Paint
from mistray.scatter.polynomial import Polynomial
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import lobe_total, totals

EXACT, QUADRATURE = 1e-10, 1e-4  # relative: of values without a table, and of totals as required
TABLE = 0.01  # share of the flux that a ratio table may put elsewhere, up to 75° of incidence
GLASS = 1.5
ALUMINIUM = 0.958 + 6.69j
ANGLES_DEG, STEEP_DEG = np.array([0.0, 30.0, 60.0, 75.0]), np.degrees(np.arccos([1.0, 0.7, 0.1]))
Values = dict[str, float]


def polar(sine: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions above the horizon, in polar coordinates about the specular one, and weights, whose sum is π."""
    inside = 1 - sine
    # Panels shrink towards the peak, and towards the horizon, where cos θs is a square root
    edges = np.concatenate([[0.0], np.logspace(-6, -0.3, 47), 1 - np.logspace(-0.5, -6, 12), [1.0]])
    r, weight = scatter_integrals.gauss_legendre(inside * edges, 8)
    if sine > 0:
        t, w = scatter_integrals.gauss_legendre(np.pi * np.concatenate([[0.0], np.logspace(-5, 0, 66)]), 8)
        r, weight = np.concatenate([r, 1 - sine * np.cos(t)]), np.concatenate([weight, w * sine * np.sin(t)])
        half = np.arccos(np.clip((r * r + sine * sine - 1) / (2 * sine * r), -1, 1))
    else:
        half = np.full(len(r), np.pi)
    # u² (3 - 2u) takes the square root of cos θs at the horizon
    u, v = scatter_integrals.gauss_legendre(np.linspace(0, 1, 9), 8)
    psi = np.pi - half[:, None] * (1 - u * u * (3 - 2 * u))
    x, y = sine + r[:, None] * np.cos(psi), r[:, None] * np.sin(psi)
    weights = 2 * (weight * r * half)[:, None] * v * 6 * u * (1 - u)
    z = np.sqrt(np.maximum(0, 1 - x * x - y * y))
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), weights.ravel()


def test_oracle() -> None:
    for sine in (0.0, 0.5, 0.99):
        w, weight = polar(sine)
        assert (weight.sum(), weight @ w[:, 2]) == pytest.approx((np.pi, 2 * np.pi / 3), rel=1e-6)
        assert weight @ w[:, 0] == pytest.approx(0, abs=QUADRATURE)


@dataclass(frozen=True)
class Case:
    kind: str
    values: dict[str, Any]
    equation: Callable[..., np.ndarray]  # of the values, the light and R or T; times R or T unless absolute
    events: tuple[str, ...] = ("reflection", "transmission")
    difference: float = EXACT
    total: float = QUADRATURE
    absolute: bool = False
    options: dict[str, Any] = field(default_factory=dict)
    from_back: bool = True
    angles_deg: np.ndarray = field(default_factory=lambda: ANGLES_DEG)


def of_form(name: str, difference: float = EXACT, total: float = QUADRATURE, **values: float) -> Case:
    form = FORMS[name]
    return Case(form.kind, form.values | values, form.bsdf, form.events, difference, total, True, form.options,
                form.reflects_at_back)  # fmt: skip


def at_slope_two(v: Values, light: Light) -> np.ndarray:
    length = v["B_um"]
    amplitude = (1e-3 * v["rms_nm"] * length) ** 2 / (np.pi * math.log1p((length / BAND_UM) ** 2))
    psd = amplitude / (1 + (length * light.n * light.r / WAVELENGTH_UM) ** 2)
    return 4 * np.pi**2 * light.n**2 * light.path**2 / WAVELENGTH_UM**4 * psd


def on_metal(relative: bool, v: Values, light: Light, index: complex | None = ALUMINIUM) -> np.ndarray:
    index = light.n_out / light.n_in if index is None else index
    q = rayleigh_rice.polarization_factor(light.cos_i, light.cos_s, light.cos_phi, index)
    one = np.ones_like(light.cos_i)
    whole = rayleigh_rice.polarization_factor(light.cos_i, light.cos_i, one, ALUMINIUM) if relative else 1.0
    return scalar_rayleigh_rice(v, light) * q / whole


IN_BAND = {"band_limited": True, "reference_nm": 1e3 * BAND_UM}
MIRROR = {"theory": "rayleigh_rice_vector", "event": "reflection"}
POWERS = {"c000": 0.6, "c001": 0.0, "c010": 0.0, "c100": 0.0, "l10": -0.6, "l11": 0.0, "d": 2e3}
PAINT = {"reflectance": 0.045, "b0": 0.05, "l": 0.1, "s": -3.0}
REFLECTED = ("reflection",)
CASES = {
    "abg": of_form("abg"),
    "abg absolute": Case("abg", FORMS["abg"].values, forms.abg, absolute=True, options={"relative_to": "incident"}),
    "abg narrow": of_form("abg narrow"),
    "abg of 633 nm": of_form("abg of 633 nm"),
    "abg lambertian": Case("abg", {"A": 0.05 / np.pi, "B": 0.0, "g": 0.0},
                           lambda _, light: lambertian({"reflectance": 0.05}, light)),
    "harvey_shack": of_form("harvey_shack"),
    "harvey_shack of a roughness": of_form("harvey_shack of a roughness"),
    "gaussian_lobe": of_form("gaussian_lobe"),
    **{f"phong {n}": Case("phong", {"b0": 0.05, "exponent": n}, forms.phong, total=3e-4, angles_deg=STEEP_DEG)
       for n in (1.0, 2.7, 16.0, 300.0)},
    "polynomial": of_form("polynomial", 5e-3, 1e-3),
    "polynomial of r": Case("polynomial", {"c000": 0.6, "l10": -0.6, "d": 2e3}, partial(forms.polynomial, POWERS)),
    "ghs": of_form("ghs", TABLE, TABLE),
    **{f"ghs in a band, slope {s}": Case("k_correlation", K | {"rms_nm": 1.0, "slope": s}, forms.smooth_in_band,
                                         REFLECTED, options=IN_BAND) for s in (1.5, 2.7)},
    "ghs in a band, slope 2": Case("k_correlation", K | {"rms_nm": 1.0, "slope": 2.0}, at_slope_two, REFLECTED,
                                   options=IN_BAND),
    **{f"ghs_full, {rms} nm": Case("k_correlation", {"rms_nm": rms, "B_um": 100 * np.pi, "slope": 3.0},
                                   forms.all_orders, REFLECTED, TABLE, TABLE,
                                   options={"theory": "ghs_full"}, from_back=False)
       for rms in (6.0, 61.0)},
    "rayleigh_rice": of_form("rayleigh_rice"),
    "rayleigh_rice_vector": of_form("rayleigh_rice_vector", TABLE, TABLE),
    "rayleigh_rice_vector absolute": Case("k_correlation", K, lambda *x: on_metal(False, *x, None), REFLECTED, TABLE,
                                          TABLE, True, MIRROR | {"relative_to": "incident"}),
    "on metal": Case("k_correlation", K, partial(on_metal, True), REFLECTED, TABLE, TABLE,
                     options=MIRROR | {"substrate": ALUMINIUM}, from_back=False),
    "on metal absolute": Case("k_correlation", K, partial(on_metal, False), REFLECTED, TABLE, TABLE, True,
                              MIRROR | {"substrate": ALUMINIUM, "relative_to": "incident"}, from_back=False),
    "psd_table": of_form("psd_table", 2e-3, 2e-3),
    "edge_diffraction": of_form("edge_diffraction", 1e-5),
    "paint": Case("paint", PAINT, lambda v, light: lambertian(v, light) + forms.harvey_shack(v, light), REFLECTED,
                  absolute=True),
    "glossy paint": Case("paint", PAINT | {"n": 1.5}, lambda v, light: lambertian(v, light) + forms.gloss(v, light),
                         REFLECTED, 1e-3, 1e-3, absolute=True),
    "particulate": of_form("particulate", 1e-3, 0.03),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_values_and_totals(name: str) -> None:
    """The flux of the difference over that of the equation, and the total, from air into glass and out of it."""
    case, share = CASES[name], 0.7
    event = {"event": case.events[0]} if len(case.events) == 1 else {}
    model = KINDS[case.kind].of(**case.values, **event | case.options)
    for front in (True, False) if case.from_back else (True,):
        n_in, n_out = (1.0, GLASS) if front else (GLASS, 1.0)
        lobes = model.lobes(WAVELENGTH_NM, n_in, n_out, front)
        assert {lobe.event for lobe in lobes} <= set(case.events)
        for event in case.events:
            for angle in np.radians(case.angles_deg):
                sine = np.sin(angle) * (1.0 if event == "reflection" else n_in / n_out)
                if sine >= 1:
                    continue
                w, weight = polar(sine)
                d = np.tile([np.sin(angle), 0.0, np.cos(angle)], (len(w), 1))
                reflect = event == "reflection"
                seen = w * [1, 1, -1 if reflect else 1]
                light = Light(d, seen, np.tile([0.0, 0.0, 1.0], (len(w), 1)), reflect, front, n_in, n_out)
                given = (case.values, light, share) if hasattr(case.equation, "__self__") else (case.values, light)
                expected = case.equation(*given) * (1.0 if case.absolute else share)
                found = bsdf(lobes, event, np.cos(angle), w, n_in, n_out, share)
                whole = weight @ expected
                total = totals(lobes, np.cos([angle]), n_in, n_out).scattered(event, np.array([share]))[0]
                where = f"{event} at {np.degrees(angle)}°, front {front}"
                assert weight @ np.abs(found - expected) <= case.difference * whole, where
                assert total == pytest.approx(whole, rel=case.total), where


def test_totals_at_random_parameters_and_angles() -> None:
    """Of profiles of the distance, reflected and about the refracted direction."""
    rng = np.random.default_rng(1)
    cases: list[tuple[Any, scatter_integrals.Profile]] = []
    for _ in range(25):
        b, g, length, slope = rng.uniform([-11.9, 0, -5, -4], [0, 4, -0.3, -0.1])
        cases.append((ABg(1.0, 10**b, g), scatter_integrals.abg(1.0, 10**b, g)))
        profile = scatter_integrals.harvey_shack(1.0, 10**length, slope)
        cases.append((HarveyShack(1.0, 10**length, slope), profile))
    for width in (1e-3, 0.05, 0.5, 3.0):
        flat = math.pi * width**2 * -math.expm1(-1 / width**2)
        cases.append((Gaussian(0.2, width), lambda r, w=width, flat=flat: 0.2 / flat * np.exp(-((r / w) ** 2))))
        assert scatter_integrals.total_scatter(cases[-1][1], 0.0) == pytest.approx(0.2, rel=1e-6)
    cases.append((Polynomial((("c000", 0.0), ("l10", -1.0)), 1e4), lambda r: 1 / (1 + 1e4 * r * r)))
    for model, profile in cases:
        n, cos_i = rng.uniform(0.6, 2), rng.uniform(0.01, 1, 3)
        for lobe in model.lobes(550.0, 1.0, n, True):
            sine = np.sqrt(1 - cos_i**2) / (1 if lobe.event == "reflection" else n)
            expected = [0.0 if s >= 1 else scatter_integrals.total_scatter(profile, s) for s in sine]
            np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, n), expected, rtol=QUADRATURE, err_msg=repr(model))


def test_wavelengths() -> None:
    """With a reference the spectrum of the surface stays; with the roughness alone, l stays."""
    r = np.array([0.0, 1e-3, 0.3])

    def profile(model: HarveyShack, wavelength_nm: float) -> np.ndarray:
        return model.lobes(wavelength_nm, 1.0, 1.5, True)[0].profile(r)

    def shape(r: np.ndarray) -> np.ndarray:
        return (1 + (r / 0.01) ** 2) ** -0.75

    for options, at_660 in (
        ({"b0": 0.11, "reference_nm": 550.0}, shape(r / 1.2) / 1.2**4),
        ({"b0": 0.11}, shape(r)),
        ({"rms_nm": 2.0}, shape(r) / 1.2**2),
        ({"rms_nm": 2.0, "reference_nm": 550.0}, shape(r / 1.2) / 1.2**4),
    ):
        model = HarveyShack(l=0.01, s=-1.5, **options)
        np.testing.assert_allclose(profile(model, 660.0) / profile(model, 550.0)[0], at_660, rtol=1e-12)


def test_totals_of_smooth_surfaces() -> None:
    """(2π Δn σ/λ)² from both sides; what lies beyond the band or in the wings is λ/B of it at a slope of 3."""
    model = KCorrelation(2.0, 2000.0, 3.0)
    for n_in, n_out in ((1.0, GLASS), (GLASS, 1.0)):
        for lobe in model.lobes(WAVELENGTH_NM, n_in, n_out, True):
            step = 2 * n_in if lobe.event == "reflection" else GLASS - 1
            total = lobe_total(lobe, np.array([1.0]), n_in, n_out)[0]
            assert total == pytest.approx(harvey_shack.tis_from_rms(2e-3, WAVELENGTH_UM, step), rel=2e-3)
    for rms_nm in (6.0, 61.0):  # no constant restores what the path takes from the wings
        rough = KCorrelation(rms_nm, 100 * math.pi, 3.0, theory="ghs_full", event="reflection")
        (lobe,) = rough.lobes(WAVELENGTH_NM, 1.0, GLASS, True)
        lost = -math.expm1(-harvey_shack.tis_from_rms(1e-3 * rms_nm, WAVELENGTH_UM, 2.0))
        assert lobe_total(lobe, np.ones(1), 1.0, GLASS)[0] == pytest.approx(lost, rel=TABLE)
    r = np.array([0.0, 0.01, 0.5])
    full, first = (KCorrelation(0.1, 12.0, 3.0, theory=t).lobes(550, 1.0, GLASS, True)[0] for t in ("ghs_full", "ghs"))
    np.testing.assert_allclose(full.profile(r), first.profile(r), rtol=1e-5)
    # A total roughness and one of a reference wavelength are the surface's; one of the light's wavelength is not
    assert KCorrelation(1.0, 20.0, 3.0).amplitude_um4(400.0) == KCorrelation(1.0, 20.0, 3.0).amplitude_um4(800.0)
    band = KCorrelation(1.0, 20.0, 2.0, band_limited=True)
    fixed = KCorrelation(1.0, 20.0, 2.0, band_limited=True, reference_nm=500.0)
    assert fixed.amplitude_um4(400.0) == fixed.amplitude_um4(800.0) == band.amplitude_um4(500.0)
    assert band.amplitude_um4(400.0) < band.amplitude_um4(800.0)


def test_totals_in_closed_form() -> None:
    """Of Lambertian paints at all angles, of Phong's law at normal incidence, and of ABg models within a radius."""
    for name, reflectance in PRESETS.items():
        (lobe,) = Paint.preset(name).lobes(550.0, 1.0, 1.5, True)
        np.testing.assert_allclose(lobe_total(lobe, np.cos(np.radians([0, 45, 89])), 1.0, 1.5), reflectance, rtol=1e-5)
        assert lobe.profile(np.array([0.3]))[0] == pytest.approx(reflectance / np.pi, rel=1e-12)
    assert PRESETS["flat_black"] == 0.045  # of the phone camera
    for exponent in (1.0, 2.7, 16.0, 300.0):
        lobe, _ = KINDS["phong"].of(b0=0.05, exponent=exponent).lobes(550.0, 1.0, 1.5, True)
        assert phong_physics.tis(0.05, exponent) == pytest.approx(lobe_total(lobe, np.ones(1), 1.0, 1.5)[0], rel=1e-4)
    # The share of the flux within r, for g = 2 and B = 1e-6: r(u) = sqrt(B ((1 + 1/B)^u - 1))
    rows = vectors.frame("abg_sampling_g2.csv")
    lobe, _ = ABg(1.0, 1e-6, 2.0).lobes(550.0, 1.0, 1.5, True)
    table = RadialTable.of(lobe.profile)
    share = table.within(rows["r"].to_numpy()) / table.within(np.array([1.0]))
    np.testing.assert_allclose(share, rows["u"], atol=QUADRATURE)
    np.testing.assert_allclose(np.sqrt(1e-6 * (np.power(1 + 1e6, rows["u"]) - 1)), rows["r"], rtol=1e-6)


@pytest.mark.parametrize("law", ["half_plane", "heisenberg"])
@pytest.mark.parametrize("width", [0.015, 0.1, 1.0])
def test_an_edge_deflects_all_light(width: float, law: str) -> None:
    """The total is 1 far from grazing incidence, and nowhere more, so that every ring has a balanced budget."""
    cosines = np.linspace(0, 1, 101)
    for n_in, n_out in ((1.0, 1.0), (1.0, 1.5), (1.5, 1.0)):
        (lobe,) = EdgeDiffraction(width, law).lobes(550.0, n_in, n_out, True)
        total = lobe_total(lobe, cosines, n_in, n_out)
        assert np.all(total < 1 + 1e-6)
        assert total[-1] == pytest.approx(1, abs=1.5e-3), "0.13 % of the law of Heisenberg lie beyond the horizon"
        if n_in <= n_out:
            assert np.all(total[80:] > 0.99)

"""Scatter models: what they refuse and scatter, totals over the hemisphere, scans, chances without aimed rays."""

import functools
import json
import math
import re
from typing import Any

import numpy as np
import pytest
from command_line import fails, succeeds
from refusals import each_refused, refused

from mistray.scatter.abg import ABg
from mistray.scatter.chance import Chance, chance
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.scatter.evaluate import bsdf
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack, index_step
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.lobe import Lobe, RatioTable
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.phong import Phong
from mistray.scatter.polynomial import Polynomial
from mistray.scatter.radial import R_MAX, RadialTable
from mistray.scatter.scan import IncidentLight, scan, table
from mistray.scatter.total import check_budget, lobe_total, totals

pytestmark = pytest.mark.quick

ABG = {"A": 1.0, "B": 1e-3, "g": 2.0}
ROUGH = {"rms_nm": 1.0, "B_um": 20.0, "slope": 3.0}
VECTOR = {"theory": "rayleigh_rice_vector"}
REFUSED: list[tuple[type, dict[str, Any], str]] = [
    (ABg, ABG | {"B": 0.0}, "B is 0; give B > 1e-12, or B ≥ 0 with g = 0"),
    (HarveyShack, {}, "neither of b0 and rms_nm"),
    (HarveyShack, {"b0": 1.0, "rms_nm": 4.0}, "both of b0 and rms_nm"),
    (KCorrelation, ROUGH | {"slope": 2.0}, "slope is 2, .*band_limited"),
    (KCorrelation, ROUGH | {"theory": "beckmann"}, "theory is 'beckmann'"),
    (KCorrelation, ROUGH | {"theory": "ghs_full", "slope": 2.5}, "ghs_full needs slope 3"),
    (KCorrelation, ROUGH | {"theory": "ghs_full", "band_limited": True}, "slope 3 and a total roughness"),
    (KCorrelation, ROUGH | {"theory": "rayleigh_rice"}, "rayleigh_rice is about reflection"),
    (KCorrelation, ROUGH | {"reference_nm": 550.0}, "reference_nm goes with band_limited"),
    (KCorrelation, ROUGH | {"substrate": 1.5 + 0j}, "substrate goes with theory rayleigh_rice_vector"),
    (KCorrelation, ROUGH | VECTOR | {"substrate": -1 + 2j}, "substrate is -1"),
    (KCorrelation, ROUGH | VECTOR | {"substrate": [0.9, 6.6]}, r"substrate is \[0.9, 6.6\]; it must be n\+ik"),
    (KCorrelation, ROUGH | VECTOR | {"substrate": 10**400}, "substrate is 1000*…; it must be"),
    (Paint, {}, "nothing is scattered"),
    (Paint, {"reflectance": 0.99, "b0": 1.0}, "of the light at 0°; lower reflectance or b0"),
    (Paint, {"reflectance": 0.9, "b0": 1.0, "l": 0.1, "s": -3.0, "n": 1.5}, r"scatters 1\.\d+ of the light at \d+.*°"),
    (Paint, {"spectrum": "400:0.1"}, "nothing is scattered"),  # as a factor of no reflectance
    (Paint, {"reflectance": 1.0, "spectrum": "400:0.1, 500"}, "spectrum holds '500'; write wavelength:factor"),
    (Paint, {"reflectance": 1.0, "spectrum": "400:nan"}, "spectrum holds '400:nan'"),
    (Paint, {"reflectance": 1.0, "spectrum": "0:0.1"}, "spectrum holds '0:0.1'"),
    (Paint, {"reflectance": 1.0, "spectrum": "500:-0.1"}, "spectrum holds '500:-0.1'"),
    (Paint, {"reflectance": 1.0, "spectrum": "500:0.1 400:0.2"}, "400 nm after 500 nm; let wavelengths ascend"),
    (Paint, {"reflectance": 0.5, "spectrum": "400:0.1, 500:2.5"}, "scatters 1.25 of the light"),
    (Particulate, {}, "neither of level and coverage_percent"),
    (Particulate, {"level": 300.0, "coverage_percent": 0.1}, "both of level and coverage_percent"),
    (Particulate, {"level": 300.0, "max_um": 400.0}, "max_um ≤ level"),
    (Particulate, {"level": 300.0, "relative_to": "incident"}, "relative_to is 'incident'"),
    (Phong, {"b0": 0.1, "exponent": 0.5}, "exponent is 0.5"),
    (Polynomial, {"coefficients": (("c00", -1.0),)}, "'c00' is not a coefficient"),
    (Polynomial, {"coefficients": (("c100", -1.0),)}, "give each once, and c000"),
    (Polynomial, {"coefficients": (("c000", -1.0), ("c000", -2.0))}, "c000, c000; give each once"),
    (Polynomial, {"coefficients": ()}, "coefficients none"),
    (Polynomial, {"coefficients": (("c000", 400.0),)}, "its BSDF runs from .* the coefficients are too large"),
    (EdgeDiffraction, {"width_mm": 1.0, "law": "fresnel"}, "law is 'fresnel'"),
    (EdgeDiffraction, {"width_mm": 1.0, "event": "both"}, "event is 'both'.*transmission"),
]


@pytest.mark.parametrize(("model", "options", "words"), REFUSED)
def test_wrong_values(model: type, options: dict[str, Any], words: str) -> None:
    with refused(words) as caught:
        model(**options, name="lens")
    assert str(caught.value).startswith((f"{model.__name__} 'lens': ", "particles: "))


def test_light_that_a_model_does_not_describe() -> None:
    each_refused(
        (HarveyShack(rms_nm=15.0), (1.0, 1.5), r"rms roughness 15 nm is not smooth .*0\.343, limit 0\.251"),
        (HarveyShack(rms_nm=8.0), (1.5, 1.0), "not smooth in reflection"),
        (KCorrelation(20.0, 20.0, 3.0), (1.0, 1.5), "not smooth in reflection at 550 nm"),
        (KCorrelation(100.0, 20.0, 3.0, theory="ghs_full"), (1.0, 1.5), r"100 nm is too much .* limit 2\)"),
        (KCorrelation(**ROUGH, **VECTOR), (1.0, 1.0), "indices are 1 on both sides"),
        (EdgeDiffraction(0.01), (1.0, 1.0), "width_mm is 0.01 mm at 550 nm"),
        by=lambda model, indices: model.lobes(550.0, *indices, True),
    )


def test_advice() -> None:
    for model, words in (
        (ABg(1e-4, 1e-8, 2.5), None),
        (ABg(1e-4, float(np.float32(1e-6)), 2), None),
        (ABg(0.3, 7, 0), None),
        (ABg(1e-4, 1e-3, 1.8, name="lens"), "ABg 'lens': B 0.001 and g 1.8"),
        (ABg(1e-4, 1e-8, 1), "B 1e-08 and g 1"),
        (ABg(1.0, 1e-8, 2.0), "TIS is 57.9"),  # π ln(1 + 1/B)
        (Gaussian(0.1, 0.5), None),
        (Gaussian(0.95, 0.5), "TIS is 0.95"),
        (Gaussian(0.1, 2.0), "width 2"),
        (HarveyShack(1.0, l=float(np.float32(0.01))), None),
        (HarveyShack(100.0), "TIS is"),
        (HarveyShack(1.0, l=0.5), "l 0.5 and s -1.5"),
        (HarveyShack(1.0, s=-5.0), "s -5"),
        (KCorrelation(**ROUGH), None),
        (KCorrelation(1.0, 20.0, 4.5), "slope 4.5"),
        (Phong(0.1, 16.0), None),
        (Phong(3.0, 16.0), "TIS is 1.05"),  # 6π/18
    ):
        assert words in str(model.advice()) if words else model.advice() is None, model


BOTH, REFLECTED, TRANSMITTED = ["reflection", "transmission"], ["reflection"], ["transmission"]


def test_what_scatters() -> None:
    for model, indices, from_front, events in (
        (ABg(**ABG), (1.0, 1.5), False, BOTH),
        (ABg(**ABG, event="transmission"), (1.0, 1.5), True, TRANSMITTED),
        (ABg(**ABG, side="back"), (1.0, 1.5), True, []),
        (ABg(**ABG, side="back"), (1.0, 1.5), False, BOTH),
        (HarveyShack(0.0), (1.0, 1.5), True, []),
        (HarveyShack(rms_nm=2.0), (1.5, 1.5), True, REFLECTED),  # no step of index
        (HarveyShack(rms_nm=15.0, event="transmission"), (1.0, 1.5), True, TRANSMITTED),  # too rough to reflect
        (KCorrelation(1.0, 20.0, 3.0), (1.5, 1.5), True, REFLECTED),
        (KCorrelation(20.0, 20.0, 3.0, event="transmission"), (1.0, 1.5), True, TRANSMITTED),
        (KCorrelation(20.0, 0.3, 2.2), (1.0, 1.5), True, BOTH),  # most of its frequencies do not scatter
        (KCorrelation(40.0, 12.0, 3.0, theory="ghs_full"), (1.0, 1.5), True, BOTH),
        (KCorrelation(**ROUGH, **VECTOR, substrate=1 + 7j), (1.0, 1.0), True, REFLECTED),
        (Paint(0.1), (1.0, 1.5), True, REFLECTED),
        (EdgeDiffraction(0.05, side="back"), (1.0, 1.0), False, TRANSMITTED),
        (Particulate(level=300.0, immersion=1.5, particle="1.6"), (1.5, 1.0), True, [*TRANSMITTED, *2 * REFLECTED]),
        (Particulate(level=300.0), (1.5, 1.0), True, TRANSMITTED),  # light in the glass does not meet them
    ):
        assert [lobe.event for lobe in model.lobes(550.0, *indices, from_front)] == events, model


def test_paint_over_wavelength() -> None:
    """Its reflectance times the factor, linear between the points and unknown beyond them."""
    paint = Paint.of(spectrum="400:0.1, 500:0.3 700:0")
    assert paint.reflectance == 1
    for nm, reflectance in ((400.0, 0.1), (450.0, 0.2), (600.0, 0.15)):
        (lobe,) = paint.lobes(nm, 1.0, 1.5, True)
        assert np.pi * lobe.profile(np.zeros(1)) == pytest.approx(reflectance, rel=1e-12)
    assert paint.lobes(700.0, 1.0, 1.5, True) == ()
    assert Paint.of(spectrum="400:0.5", reflectance=0.2).reflectance == 0.2
    with refused(r"Paint 'wall': 701 nm is outside its spectrum, 400 … 700 nm"):
        Paint.of(spectrum=paint.spectrum, name="wall").lobes(701.0, 1.0, 1.5, True)


def test_shares_and_steps_and_refused_scans() -> None:
    """Relative to the specular beam or to all light; the step of index that light meets."""
    for model, shares in (
        (ABg(**ABG), (0, 1, 0)),
        (ABg(**ABG, relative_to="incident"), (1, 0, 0)),
        (Paint(0.1), (1, 0, 0)),
        (Paint.preset("flat_black", relative_to="specular"), (0, 1, 0)),
    ):
        assert model.lobes(550.0, 1.0, 1.5, True)[0].shares == shares
    assert index_step("transmission", 1.0, 1.5) == index_step("transmission", 1.5, 1.0) == 0.5
    assert index_step("reflection", 1.5, 1.0) == 3.0
    with refused("'flat_blak' is unknown"):
        Paint.preset("flat_blak")
    model, dense = ABg(0.0025, 0.001, 1.8), IncidentLight(n_in=1.5, n_out=1.0)
    each_refused(
        ((model, [90.0]), "angle of incidence 90°"),
        ((model, [60.0], "transmission", dense), "is totally reflected, nothing is transmitted; give smaller angles"),
        ((Paint(0.2), [0.0], "transmission"), "scatters nothing in transmission"),
        by=lambda arguments: scan(*arguments),
    )


@pytest.mark.parametrize("frame", ["specular", "normal"])
def test_a_table_holds_the_model(frame: str) -> None:
    samples = table(ABg(0.0025, 0.001, 1.8), [0, 40], frame)
    d = samples.directions()
    sine = np.sin(np.radians(samples.specular_deg))[:, None, None]
    expected = 0.0025 / (0.001 + np.hypot(d[..., 0] - sine, d[..., 1]) ** 1.8)
    above = d[..., 2] > 1e-9
    np.testing.assert_allclose(samples.values[above], expected[above], rtol=1e-9)
    assert np.all(samples.values[d[..., 2] < -1e-9] == 0)
    Tabulated(samples)
    refracted = table(ABg(0.0025, 0.001, 1.8), [0, 40], "specular", "transmission", IncidentLight(n_out=1.5))
    assert refracted.event == "transmission"
    assert np.sin(np.radians(refracted.specular_deg[1])) * 1.5 == pytest.approx(np.sin(np.radians(40)), rel=1e-12)


LENS = ABg(2e-5, 1e-6, 2.0)
COMMAND = ["bsdf", "abg", "--A", "2e-5", "--B", "1e-6", "--g", "2", "--event", "transmission", "--angles-deg", "0"]


def test_the_example_of_the_webinar(capsys: pytest.CaptureFixture[str]) -> None:
    """p2 = 2.7713e-10, p = 3.4641e-11: 3e10 rays are one hit in the mean, 50 % need 2.0e10."""
    found = chance(LENS, 30.0, 4e-6, event="transmission", before=0.125)
    assert (found.rays_for_one_hit, found.rays_for(0.5)) == pytest.approx((2.887e10, 2.001e10), rel=1e-3)
    assert -math.expm1(-found.total * found.rays_for_one_hit) == pytest.approx(0.632, abs=1e-3)
    where = ["--hit-deg", 30, "--hit-sr", 4e-6, "--hit-before", 0.125]
    out = succeeds(capsys, *COMMAND, *where)
    assert all(f"{number:.4e}" in out for number in (found.of_scatter, found.total))
    assert (f"{found.of_scatter:.4e}", f"{found.total:.4e}") == ("2.7713e-10", "3.4641e-11")
    for more, total in ((where, pytest.approx(found.total)), ([], None)):
        record = json.loads(succeeds(capsys, *COMMAND, *more, "--json"))["without_importance_sampling"]
        assert (record and record["total"]) == total
    for half in (where[:2], where[4:]):
        assert "hit" in fails(capsys, *COMMAND, *half)


def test_half_of_the_runs_hit_and_what_is_refused() -> None:
    """Counted: 20 000 runs of as many rays as `rays_for` says. False alarm 1e-5 (4.4 standard errors)."""
    for confidence in (0.5, 0.9):
        whole = math.ceil(Chance(0.03, 0.5).rays_for(confidence))
        hit = np.random.default_rng(2).binomial(whole, 0.015, 20_000) > 0
        exact = 1 - (1 - 0.015) ** whole
        assert exact >= confidence > 1 - (1 - 0.015) ** (whole - 1)
        assert abs(hit.mean() - exact) < 4.4 * math.sqrt(exact * (1 - exact) / 20_000)
    each_refused(
        ((90.0, 1e-6), "scattered direction is 90"),
        ((30.0, 0.0), "solid angle is 0"),
        ((30.0, math.nan), "solid angle is nan"),
        ((0.0, 1.0), "solid angle 1 sr: too large for one value"),
        by=lambda arguments: chance(LENS, *arguments),
    )
    with refused("event is 'reflect'"):
        chance(LENS, 30.0, 1e-6, event="reflect")


legendre = functools.cache(np.polynomial.legendre.leggauss)
THERE = np.sin(np.radians(20)) * np.array([np.cos(np.radians(70)), np.sin(np.radians(70)), 0])
THERE[2] = np.cos(np.radians(20))


def brute(lobe: Lobe, theta: float, n_in: float, n_out: float) -> float:
    """Sum over a polar grid about the normal, each part of the lobe by its definition, to which `bsdf` keeps."""
    n = 600
    sine_spec = np.sin(theta) * (n_in / n_out if lobe.event == "transmission" else 1)
    centre_tangent = {"specular": sine_spec, "normal": 0.0, "retro": -np.sin(theta)}[lobe.centre]
    x, w = legendre(n)
    t = 0.5 * (x + 1)
    polar, wp = 0.5 * np.pi * t[:, None], 0.25 * np.pi * w[:, None]
    phi = (np.arange(n) + 0.5) * np.pi / n
    bx, by, cos_s = np.sin(polar) * np.cos(phi), np.sin(polar) * np.sin(phi), np.cos(polar)
    solid = wp * np.sin(polar) * (2 * np.pi / n)
    r2 = (bx - centre_tangent) ** 2 + by**2
    cos_spec = np.sqrt(1 - sine_spec**2)
    if lobe.measure == "angle":
        r = np.sqrt(r2 + (cos_s - np.sqrt(1 - centre_tangent**2)) ** 2)
        values = lobe.profile(r) * lobe.oblique(np.array([np.cos(theta)]))[0]
    else:
        r = np.sqrt(r2)
        values = lobe.profile(r) * cos_s
        if lobe.factor == "ghs":
            values = values * 0.25 * (np.cos(theta) + cos_s) ** 2
        elif lobe.factor == "rayleigh_rice":
            values = values * np.cos(theta) * cos_s
        if lobe.ratio is not None:
            psi = np.arctan2(by, bx - centre_tangent)
            second, angle = (r, psi) if lobe.ratio.axes == "radial" else (cos_s, np.broadcast_to(phi, r.shape))
            values = values * lobe.ratio.at(np.asarray(cos_spec), second, angle)
    if sine_spec < 1:
        directions = np.stack(np.broadcast_arrays(bx, by, cos_s), axis=-1)
        found = bsdf([lobe], lobe.event, np.cos(theta), directions, n_in, n_out, 1.0)
        np.testing.assert_allclose(found * cos_s, values, rtol=1e-9)
        other = {"reflection": "transmission", "transmission": "reflection"}[lobe.event]
        assert not bsdf([lobe], other, np.cos(theta), directions[:1], n_in, n_out, 1.0).any()
    return float(np.sum(values * solid))


def wide(r: np.ndarray) -> np.ndarray:
    return 0.05 / (0.2 + r**2)


RATIO = np.random.default_rng(5).uniform(0.5, 1.5, (4, 5, 6))
LOBES = {
    "reflection": Lobe("reflection", wide),
    "transmission": Lobe("transmission", wide),
    "normal": Lobe("reflection", lambda r: 0.1 + 0 * r, centre="normal"),
    "retro": Lobe("reflection", wide, centre="retro"),
    "angle": Lobe("transmission", wide, measure="angle", oblique_limit=5.0),
    "angle retro": Lobe("reflection", wide, measure="angle", centre="retro"),
    "ghs": Lobe("reflection", wide, factor="ghs"),
    "rayleigh_rice": Lobe("reflection", wide, factor="rayleigh_rice"),
    "ratio": Lobe("reflection", wide, ratio=RatioTable(RATIO, 0.05)),
    "ratio of cosines": Lobe("transmission", wide, ratio=RatioTable(RATIO, axes="cosines")),
}


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 60.0, 85.0])
@pytest.mark.parametrize("name", LOBES)
def test_against_brute_quadrature(name: str, theta_deg: float) -> None:
    """1e-4; trilinear ratios have kinks, which both quadratures cross: 1e-3."""
    lobe, theta = LOBES[name], np.radians(theta_deg)
    for n_in, n_out in ((1.0, 1.5), (1.0, 1.0)):
        value = lobe_total(lobe, np.array([np.cos(theta)]), n_in, n_out)[0]
        assert value == pytest.approx(brute(lobe, theta, n_in, n_out), rel=1e-3 if lobe.ratio else 1e-4)


@pytest.mark.parametrize("axes", ["radial", "cosines"])
def test_ratio(axes: str) -> None:
    """A table that is linear in each of its variables is exact: cos θ0 + log(r/r_min)/log(2/r_min) + ψ/π."""
    a, b, c = np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 5), np.linspace(0, 1, 4), indexing="ij")
    x, y = THERE[0] - np.sin(np.radians(40)), THERE[1]
    radial = np.log(np.hypot(x, y) / 0.01) / np.log(200) + np.arctan2(y, x) / np.pi
    expected = np.cos(np.radians(40)) + (radial if axes == "radial" else np.cos(np.radians(20)) + 70 / 180)
    found, plain = (
        bsdf([Lobe("reflection", wide, ratio=ratio)], "reflection", np.cos(np.radians(40)), THERE[None], 1.0, 1.5, 1.0)
        for ratio in (RatioTable(a + b + c, 0.01, axes=axes), None)
    )
    assert found[0] == pytest.approx(expected * plain[0], rel=1e-12)


def test_shares_losses_budget_and_nothing_beyond_the_critical_angle() -> None:
    cos_i = np.cos(np.radians([30.0, 41.0, 42.0, 80.0]))
    assert (lobe_total(LOBES["transmission"], cos_i, 1.5, 1.0) > 0).tolist() == [True, True, False, False]
    for centre, expected in (("specular", 0.0), ("normal", wide(np.sin(np.radians(20))))):
        lobe = Lobe("transmission", wide, centre=centre)
        assert bsdf([lobe], "transmission", cos_i[3], THERE[None], 1.5, 1.0, 1.0)[0] == pytest.approx(expected)
    # c0 + c1 X + c2 X², and an extinction that is more than what is scattered
    cos_i = np.array([1.0, 0.5])
    lobe = Lobe("reflection", wide, measure="angle", shares=(0.5, 0.25, 0.125), optical_depth=0.3, oblique_limit=1.5)
    sums = totals([lobe], cos_i, 1.0, 1.0)
    total = lobe_total(lobe, cos_i, 1.0, 1.0)
    assert sums.scattered("reflection", np.array([0.4, 0.4])) == pytest.approx(total * (0.5 + 0.1 + 0.02))
    assert sums.loss["reflection"] == pytest.approx([0.3, 0.45])
    assert sums.scattered("transmission", np.ones(2)) == pytest.approx([0, 0])
    cos_i = np.cos(np.radians([0.0, 60.0, 80.0]))
    lambertian = Lobe("reflection", lambda r: 0.6 / np.pi + 0 * r, centre="normal", shares=(1.0, 0.0, 0.0))
    sums = totals([lambertian], cos_i, 1.0, 1.0)
    assert check_budget("wall", sums, cos_i, np.full(3, 0.3), np.zeros(3)) == pytest.approx(np.full(3, 0.1), abs=1e-5)
    with refused(re.escape("wall: at 80° specular 0.5 + scattered 0.6 is more than 1")):
        check_budget("wall", sums, cos_i, np.array([0.3, 0.3, 0.5]), np.zeros(3))
    strong = totals([Lobe("transmission", lambda r: 0.5 + 0 * r)], cos_i, 1.0, 1.0)
    with refused(r"lens: at \d+° scatter takes 1\.571 of the specular transmission"):
        check_budget("lens", strong, cos_i, np.zeros(3), np.ones(3))


def test_a_profile_ends_where_it_is_told_to_and_impossible_ones() -> None:
    table = RadialTable.of(lambda r: 0.3 + 0 * r, 1.0)
    assert table.within(np.array([1.0, R_MAX])) == pytest.approx([0.3 * np.pi] * 2, rel=1e-3)
    assert table.value(np.array([1.5]))[0] < 1e-25
    wrong = (lambda r: -r, lambda r: np.nan * r, lambda r: 0 * r, lambda r: 1 / np.maximum(r - 1, 0))
    with np.errstate(divide="ignore"):
        each_refused(*((f, "give a BSDF > 0") for f in wrong), by=RadialTable.of)

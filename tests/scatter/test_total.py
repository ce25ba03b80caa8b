"""Totals of lobes over the hemisphere, their radial tables and the budget, against quadrature over directions."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.scatter.evaluate import bsdf
from mistray.scatter.lobe import Lobe, RatioTable
from mistray.scatter.radial import R_MAX, RadialTable
from mistray.scatter.total import check_budget, lobe_total, totals

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


def test_nothing_is_transmitted_beyond_the_critical_angle() -> None:
    cos_i = np.cos(np.radians([30.0, 41.0, 42.0, 80.0]))
    assert (lobe_total(LOBES["transmission"], cos_i, 1.5, 1.0) > 0).tolist() == [True, True, False, False]
    for centre, expected in (("specular", 0.0), ("normal", wide(np.sin(np.radians(20))))):
        lobe = Lobe("transmission", wide, centre=centre)
        assert bsdf([lobe], "transmission", cos_i[3], THERE[None], 1.5, 1.0, 1.0)[0] == pytest.approx(expected)


def test_shares_and_losses() -> None:
    """c0 + c1 X + c2 X², and an extinction that is more than what is scattered."""
    cos_i = np.array([1.0, 0.5])
    lobe = Lobe("reflection", wide, measure="angle", shares=(0.5, 0.25, 0.125), optical_depth=0.3, oblique_limit=1.5)
    sums = totals([lobe], cos_i, 1.0, 1.0)
    total = lobe_total(lobe, cos_i, 1.0, 1.0)
    assert sums.scattered("reflection", np.array([0.4, 0.4])) == pytest.approx(total * (0.5 + 0.1 + 0.02))
    assert sums.loss["reflection"] == pytest.approx([0.3, 0.45])
    assert sums.scattered("transmission", np.ones(2)) == pytest.approx([0, 0])


def test_budget() -> None:
    cos_i = np.cos(np.radians([0.0, 60.0, 80.0]))
    lambertian = Lobe("reflection", lambda r: 0.6 / np.pi + 0 * r, centre="normal", shares=(1.0, 0.0, 0.0))
    sums = totals([lambertian], cos_i, 1.0, 1.0)
    absorbed = check_budget("wall", sums, cos_i, np.full(3, 0.3), np.zeros(3))
    assert absorbed == pytest.approx(np.full(3, 0.1), abs=1e-5)
    with pytest.raises(MistrayError, match=re.escape("wall: at 80° specular 0.5 + scattered 0.6 is more than 1")):
        check_budget("wall", sums, cos_i, np.array([0.3, 0.3, 0.5]), np.zeros(3))
    strong = totals([Lobe("transmission", lambda r: 0.5 + 0 * r)], cos_i, 1.0, 1.0)
    with pytest.raises(MistrayError, match=r"lens: at \d+° scatter takes 1\.571 of the specular transmission"):
        check_budget("lens", strong, cos_i, np.zeros(3), np.ones(3))


def test_a_profile_ends_where_it_is_told_to() -> None:
    table = RadialTable.of(lambda r: 0.3 + 0 * r, 1.0)
    assert table.within(np.array([1.0, R_MAX])) == pytest.approx([0.3 * np.pi] * 2, rel=1e-3)
    assert table.value(np.array([1.5]))[0] < 1e-25


@pytest.mark.parametrize(
    "bad", [lambda r: -r, lambda r: np.nan * r, lambda r: 0 * r, lambda r: 1 / np.maximum(r - 1, 0)]
)
def test_impossible_profiles(bad: Callable) -> None:
    with pytest.raises(MistrayError, match="give a BSDF > 0"), np.errstate(divide="ignore"):
        RadialTable.of(bad)

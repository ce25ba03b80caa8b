"""Polynomial and binomial scatter: other models as its cases, reciprocity, totals, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import scatter_integrals

from mistray.errors import MistrayError
from mistray.physics import polynomial
from mistray.scatter.evaluate import bsdf
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.polynomial import Polynomial
from mistray.scatter.total import lobe_total

FULL = {"c000": 0.6, "c100": -0.8, "c010": 0.3, "c001": 0.5, "l10": -0.6, "l11": 0.1}
TABLE = 5e-3  # relative: what a trace sees of it, at 80°


def model(d: float = 2e3, **coefficients: float) -> Polynomial:
    return Polynomial(tuple(coefficients.items()), d)


def test_harvey_shack_is_a_case() -> None:
    """b0 (1 + (r/l)²)^(s/2) is c000 = log10 b0, d = 1/l², l10 = s/2; one lobe of the distance alone."""
    ours = model(1 / 0.013**2, c000=math.log10(0.7), l10=-0.83).lobes(550.0, 1.0, 1.5, True)
    theirs = HarveyShack(b0=0.7, l=0.013, s=-1.66).lobes(550.0, 1.0, 1.5, True)
    r = np.geomspace(1e-6, 2, 50)
    for a, b in zip(ours, theirs, strict=True):
        assert a.ratio is None
        np.testing.assert_allclose(a.profile(r), b.profile(r), rtol=1e-12)


@pytest.mark.parametrize("binomial", [True, False])
def test_reciprocal(binomial: bool) -> None:
    """f(a → b) = f(b → a), to the rounding for the equation and to the table's error for the lobes."""
    named = {name: value for name, value in FULL.items() if not (binomial and name == "c010")}
    rng = np.random.default_rng(3)
    beta = np.sqrt(0.95 * rng.random((2, 200))) * np.exp(2j * np.pi * rng.random((2, 200)))
    diffuse = {(0, 0, 0): 0.6, (1, 0, 0): -0.8, (0, 0, 1): 0.5} | ({} if binomial else {(0, 1, 0): 0.3})

    def equation(s: np.ndarray, i: np.ndarray) -> np.ndarray:
        u, w, v = abs(s) ** 2, abs(i) ** 2, (s * i.conj()).real
        return polynomial.bsdf((u + w, u * w, v), abs(s - i) ** 2, diffuse, {(1, 0): -0.6, (1, 1): 0.1}, 2e3)

    there, back = equation(beta[0], beta[1]), equation(beta[1], beta[0])
    np.testing.assert_allclose(there, back, rtol=1e-12)
    lobes = model(**named).lobes(550.0, 1.0, 1.5, True)
    for s, i, expected in zip(beta[0], beta[1], there, strict=True):
        turned = s * abs(i) / i  # the incident light lies along x
        out = np.array([[turned.real, turned.imag, math.sqrt(1 - abs(s) ** 2)]])
        found = float(bsdf(lobes, "reflection", math.sqrt(1 - abs(i) ** 2), out, 1.0, 1.5, 1.0)[0])
        assert found == pytest.approx(expected, rel=TABLE)


def test_total() -> None:
    """Against a grid over the unit disc of direction cosines."""
    named, cos_i = {"c000": -1.0, "c100": -0.4, "c001": 0.5, "l10": -0.5}, np.array([1.0, 0.8, 0.2])
    rho, phi = np.meshgrid(np.sqrt((np.arange(1500) + 0.5) / 1500), 2 * np.pi * (np.arange(720) + 0.5) / 720)
    for lobe in model(30.0, **named).lobes(550.0, 1.0, 1.5, True):
        sines = np.sqrt(1 - cos_i**2) / (1.0 if lobe.event == "reflection" else 1.5)
        expected = []
        for sine in sines:
            u, w, v = rho**2, sine**2, rho * sine * np.cos(phi)
            values = 10 ** (-1 - 0.4 * (u + w) + 0.5 * v) * (1 + 30 * (u - 2 * v + w)) ** -0.5
            expected.append(np.pi * values.mean())
        np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, 1.5), expected, rtol=1e-3)


def test_total_of_the_lorentzian_part() -> None:
    (lobe, _) = model(1e4, c000=0.0, l10=-1.0).lobes(550.0, 1.0, 1.5, True)
    expected = scatter_integrals.total_scatter(lambda r: 1 / (1 + 1e4 * r * r), 0.6)
    assert lobe_total(lobe, np.array([0.8]), 1.0, 1.5)[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ((("c00", -1.0),), "'c00' is no coefficient"),
        ((("c100", -1.0),), "coefficients c100; give each once, and c000"),
        ((("c000", -1.0), ("c000", -2.0)), "coefficients c000, c000; give each once"),
        ((("c000", math.nan),), "c000 is nan"),
        ((), "coefficients none"),
    ],
)
def test_refuses(coefficients: tuple[tuple[str, float], ...], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        Polynomial(coefficients)


@pytest.mark.parametrize("coefficients", [{"c000": 400.0}, {"c000": -400.0}, {"c000": -1.0, "c900": 900.0}])
def test_refuses_what_no_number_holds(coefficients: dict[str, float]) -> None:
    with pytest.raises(MistrayError, match=r"^Polynomial: its BSDF runs from .* the coefficients are too large"):
        model(**coefficients)


def test_refuses_the_knee() -> None:
    with pytest.raises(MistrayError, match="d is 0"):
        model(0.0, c000=-1.0)

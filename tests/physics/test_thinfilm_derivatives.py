"""Derivatives of R, T, r and t by Dr.Jit's automatic differentiation, against central differences in float64."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.stacks import Stack

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import thinfilm
from mistray.physics.thinfilm import amplitudes, reflectance_transmittance

pytestmark = pytest.mark.quick

WAVELENGTH = 550.0
# Differences of fourth order: h⁴f⁽⁵⁾/30 of truncation and 1e-15/h of rounding, with f of order 1 in 2πnd/λ, are below
# 1e-10 for these steps; resonances of total reflection are steeper.
STEP = {"d": 1e-2, "n": 1e-4, "k": 1e-4}
TOLERANCE = {"rtol": 1e-6, "atol": 1e-8}

CRITICAL = math.degrees(math.asin(1.2 / 1.5))

CASES = {
    "antireflection": (Stack(1.0, (1.38, 2.1, 1.63), (99.6, 131.0, 84.4), 1.5168), [0, 40, 80]),
    "absorbing": (Stack(1.0, (1.6 + 0.05j, 3.1 + 3.3j, 2.0 + 0.5j), (80.0, 12.0, 60.0), 1.5168), [0, 40, 80]),
    "on a metal": (Stack(1.0, (1.38, 2.1), (99.6, 65.0), 0.958 + 6.69j), [0, 40, 80]),
    "opaque silver": (Stack(1.0, (1.6, 0.055 + 3.32j), (110.0, 400.0), 1.5), [0, 40, 80]),
    "total reflection": (Stack(1.5168, (1.38, 2.1, 1.1), (90.0, 50.0, 200.0), 1.0), [45, 60, 85]),
    "total reflection with absorption": (Stack(1.5168, (1.38 + 0.01j, 0.1 + 2j), (90.0, 20.0), 1.0), [45, 60, 85]),
    "frustrated total reflection": (Stack(1.5168, (1.0, 1.01), (150.0, 100.0), 1.5168), [42, 50, 70]),
    "grazing incidence": (Stack(1.0, (1.38, 2.1 + 0.1j), (100.0, 50.0), 1.5168), [89.9, 89.999]),
    "thin layers": (Stack(1.5, (1.38, 2.1 + 0.1j, 1.2), (1.0, 0.0, 3.0), 1.0), [0, 30, 60]),
    # 0.6 is the cosine of the critical angle from 1.5 to 1.2
    "critical angle of a layer": (
        Stack(1.5, (1.2, 1.38, 1.2), (300.0, 80.0, 20.0), 1.6),
        [math.degrees(math.acos(0.6))],
    ),
}


def parameters(stack: Stack) -> np.ndarray:
    """(3, layers): d, n, k."""
    n = np.array(stack.n_layers, dtype=complex)
    return np.array([stack.d_nm, n.real, n.imag])


def outputs(solution: Any) -> list[Any]:
    """R, T and the parts of r and t, for s and p."""
    (R, T), (r, t) = solution
    return [*R, *T, *(part for z in (*r, *t) for part in (z.real, z.imag))]


def solve(stack: Stack, n: Any, d: Any, cosine: Any) -> list[Any]:
    arguments = stack.n_incident, n, d, stack.n_substrate, WAVELENGTH, cosine
    return outputs((reflectance_transmittance(*arguments), amplitudes(*arguments)))


def differences(stack: Stack, cosine: np.ndarray) -> np.ndarray:
    """(12, angles, 3, layers) by central differences in NumPy."""
    values = parameters(stack)
    result = np.zeros((12, len(cosine), *values.shape))
    for i, kind in enumerate("dnk"):
        for j in range(values.shape[1]):
            for steps, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
                moved = values.copy()
                moved[i, j] += steps * STEP[kind]
                side = np.array(solve(stack, list(moved[1] + 1j * moved[2]), list(moved[0]), cosine))
                result[:, :, i, j] += weight * side / (12 * STEP[kind])
    return result


def leaves_of(stack: Stack, lanes: int, real: Any) -> list[Any]:
    """All d, then all n, then all k as arrays of their own, ready for derivatives."""
    leaves = [dr.full(real, v, lanes) for v in parameters(stack).ravel()]
    dr.make_opaque(leaves)
    for leaf in leaves:
        dr.enable_grad(leaf)
    return leaves


def solve_leaves(stack: Stack, leaves: list[Any], cosine: Any) -> list[Any]:
    d, n, k = (leaves[i : i + len(stack.d_nm)] for i in range(0, len(leaves), len(stack.d_nm)))
    kind = mi.Complex2f64 if type(cosine) is mi.Float64 else mi.Complex2f
    return solve(stack, [kind(a, b) for a, b in zip(n, k, strict=True)], d, cosine)


def forward(stack: Stack, cosine: np.ndarray, real: Any = None) -> np.ndarray:
    """(12, angles, 3, layers) by forward differentiation, one lane for each angle and parameter."""
    real = real or mi.Float64
    shape = parameters(stack).shape
    lanes = len(cosine) * math.prod(shape)
    leaves = leaves_of(stack, lanes, real)
    for i, leaf in enumerate(leaves):
        dr.set_grad(leaf, dr.select(dr.arange(mi.UInt32, lanes) % len(leaves) == i, real(1), real(0)))
    results = solve_leaves(stack, leaves, real(np.repeat(cosine, len(leaves))))
    dr.enqueue(dr.ADMode.Forward, leaves)
    dr.traverse(dr.ADMode.Forward)
    gradients = dr.grad(results)
    dr.eval(gradients)
    return np.array([np.array(x, dtype=float) for x in gradients]).reshape(12, len(cosine), *shape)


def backward(stack: Stack, cosine: np.ndarray, weights: np.ndarray, real: Any = None) -> np.ndarray:
    """(angles, 3, layers): derivatives of a weighted sum of all outputs by backward differentiation."""
    real = real or mi.Float64
    leaves = leaves_of(stack, len(cosine), real)
    results = solve_leaves(stack, leaves, real(cosine))
    dr.backward(sum(float(w) * x for w, x in zip(weights, results, strict=True)))
    gradients = dr.grad(leaves)
    dr.eval(gradients)
    return np.array([np.array(x, dtype=float) for x in gradients]).T.reshape(len(cosine), *parameters(stack).shape)


def cosines(degrees: Any) -> np.ndarray:
    return np.cos(np.radians(np.asarray(degrees, dtype=float)))


@pytest.mark.parametrize("case", CASES)
def test_forward(case):
    stack, degrees = CASES[case]
    found = forward(stack, cosines(degrees))
    np.testing.assert_allclose(found, differences(stack, cosines(degrees)), **TOLERANCE)


@pytest.mark.parametrize("case", CASES)
def test_backward(case):
    stack, degrees = CASES[case]
    weights = np.random.default_rng(3).uniform(-1, 1, 12)
    expected = np.tensordot(weights, differences(stack, cosines(degrees)), axes=1)
    np.testing.assert_allclose(backward(stack, cosines(degrees), weights), expected, **TOLERANCE)


@pytest.mark.parametrize("case", CASES)
def test_float32(case):
    """Same derivatives to the rounding of the arguments, which the phases magnify."""
    stack, degrees = CASES[case]
    double, single = forward(stack, cosines(degrees)), forward(stack, cosines(degrees), mi.Float)
    np.testing.assert_allclose(single, double, rtol=0, atol=2e-5 * max(1.0, abs(double).max()))


def test_real_layers():
    """Layers given as real arrays take another path through the formulas."""
    stack, degrees = CASES["frustrated total reflection"]
    weights = np.array([1.0, 0.5, -0.3, 2.0])
    expected = np.tensordot(weights, differences(stack, cosines(degrees))[:4, :, :2], axes=1)
    leaves = leaves_of(stack, len(degrees), mi.Float64)[:4]
    arguments = stack.n_incident, leaves[2:], leaves[:2], stack.n_substrate, WAVELENGTH, mi.Float64(cosines(degrees))
    R, T = reflectance_transmittance(*arguments)
    dr.backward(sum(float(w) * x for w, x in zip(weights, (*R, *T), strict=True)))
    np.testing.assert_allclose(np.array(dr.grad(leaves)).T.reshape(3, 2, 2), expected, **TOLERANCE)


@pytest.mark.parametrize("name", ["n_incident", "n_substrate", "k_substrate", "wavelength_nm", "cosine"])
def test_other_arguments(name):
    point = {"n_incident": 1.2, "n_substrate": 1.5, "k_substrate": 0.3, "wavelength_nm": 550.0, "cosine": 0.7}

    def run(values: dict[str, Any], kind: Any) -> Any:
        n_substrate = kind(values["n_substrate"], values["k_substrate"])
        outer = values["n_incident"], [1.38, 2.1 + 0.1j], [100.0, 50.0], n_substrate
        return reflectance_transmittance(*outer, values["wavelength_nm"], values["cosine"])

    h = 1e-2 if name == "wavelength_nm" else 1e-5
    sides = [np.array(run({**point, name: point[name] + sign * h}, complex)) for sign in (1, -1)]
    leaf = dr.opaque(mi.Float64, point[name])
    dr.enable_grad(leaf)
    results = run({**point, name: leaf}, mi.Complex2f64)
    dr.forward(leaf)
    found = [[dr.grad(x)[0] for x in pair] for pair in results]
    np.testing.assert_allclose(found, (sides[0] - sides[1]) / (2 * h), **TOLERANCE)


@pytest.mark.parametrize("real", ["Float", "Float64"])
def test_finite_everywhere(real):
    """cos θ = 0, critical angles, no step, opaque layers: derivatives may be large there, but are numbers."""
    places = [
        (Stack(1.0, (1.38, 2.1 + 0.1j), (100.0, 50.0), 1.5), [0.0, 1e-30, 1e-12, 1.0]),
        (Stack(1.5, (1.5, 1.5 + 1e-9j), (100.0, 50.0), 1.5), [0.0, 1e-30, 1e-12, 1.0]),
        (Stack(1.5, (1.2, 1.38), (100.0, 1e6), 1.2), [0.6, np.nextafter(0.6, 0), np.nextafter(0.6, 1), 0.0]),
        (Stack(1.0, (0.055 + 3.32j, 3 + 1j), (1e6, 1e6), 1.5), [0.0, 1e-12, 0.5, 1.0]),
        (Stack(1.5, (1.0, 1.0), (1e6, 1e9), 1.5), [0.0, 0.3, 0.6, 1.0]),
    ]
    for stack, cosine in places:
        assert np.all(np.isfinite(forward(stack, np.array(cosine), getattr(mi, real))))
        assert np.all(np.isfinite(backward(stack, np.array(cosine), np.ones(12), getattr(mi, real))))


def test_a_wrong_derivative_is_seen(monkeypatch):
    """A layer whose values are right and whose derivative by the index is half of what it should be."""
    original = thinfilm._joined

    def joined(ops: Any, small: Any, q2: Any, phase_per_q: Any, general: Any) -> Any:
        layer = original(ops, small, q2, phase_per_q, general)
        return layer._replace(times=0.5 * (layer.times + ops.detach(layer.times)))

    monkeypatch.setattr(thinfilm, "_joined", joined)
    with pytest.raises(AssertionError):
        test_forward("antireflection")

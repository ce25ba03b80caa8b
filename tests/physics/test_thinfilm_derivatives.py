"""Derivatives of R, T, r and t by Dr.Jit's automatic differentiation, against central differences in float64."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drjit_derivatives import forward_derivatives
from oracles.derivatives import central_differences
from oracles.stacks import Stack

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics.thinfilm import amplitudes, reflectance_transmittance

pytestmark = pytest.mark.quick

WAVELENGTH = 550.0
# Differences of fourth order: h⁴f⁽⁵⁾/30 of truncation and 1e-15/h of rounding, with f of order 1 in 2πnd/λ, are below
# 1e-10 for these steps; resonances of total reflection are steeper.
STEP = {"d": 1e-2, "n": 1e-4, "k": 1e-4}
TOLERANCE = {"rtol": 1e-6, "atol": 1e-8}

CRITICAL = math.degrees(math.acos(0.6))  # from 1.5 to 1.2
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
    "critical angle of a layer": (Stack(1.5, (1.2, 1.38, 1.2), (300.0, 80.0, 20.0), 1.6), [CRITICAL]),
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

    def at(*moved: float) -> np.ndarray:
        d, n, k = np.reshape(moved, values.shape)
        return np.array(solve(stack, list(n + 1j * k), list(d), cosine))

    found = central_differences(at, values.ravel(), np.repeat([STEP[kind] for kind in "dnk"], values.shape[1]))
    return np.moveaxis(found, 0, -1).reshape(12, len(cosine), *values.shape)


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


@pytest.mark.parametrize("case", CASES)
def test_forward(case):
    """And backward, of a weighted sum; in float32 to the rounding of the arguments, which the phases magnify."""
    stack, degrees = CASES[case]
    cosine, weights = np.cos(np.radians(degrees)), np.random.default_rng(3).uniform(-1, 1, 12)
    expected, found = differences(stack, cosine), forward(stack, cosine)
    np.testing.assert_allclose(found, expected, **TOLERANCE)
    summed = backward(stack, cosine, weights)
    np.testing.assert_allclose(summed, np.tensordot(weights, expected, axes=1), **TOLERANCE)
    single = forward(stack, cosine, mi.Float)
    np.testing.assert_allclose(single, found, rtol=0, atol=2e-5 * max(1.0, abs(found).max()))


def test_real_layers():
    stack, degrees = CASES["frustrated total reflection"]
    weights, cosine = np.array([1.0, 0.5, -0.3, 2.0]), np.cos(np.radians(degrees))
    expected = np.tensordot(weights, differences(stack, cosine)[:4, :, :2], axes=1)
    leaves = leaves_of(stack, len(degrees), mi.Float64)[:4]
    arguments = stack.n_incident, leaves[2:], leaves[:2], stack.n_substrate, WAVELENGTH, mi.Float64(cosine)
    R, T = reflectance_transmittance(*arguments)
    dr.backward(sum(float(w) * x for w, x in zip(weights, (*R, *T), strict=True)))
    np.testing.assert_allclose(np.array(dr.grad(leaves)).T.reshape(3, 2, 2), expected, **TOLERANCE)


@pytest.mark.parametrize("result", range(4))
def test_other_arguments(result):
    point, steps = (1.2, 1.5, 0.3, 550.0, 0.7), (1e-3, 1e-3, 1e-3, 1e-1, 1e-3)

    def run(n_incident: Any, n_substrate: Any, k_substrate: Any, wavelength: Any, cosine: Any) -> Any:
        kind = mi.Complex2f64 if dr.is_array_v(cosine) else complex
        outer = n_incident, [1.38, 2.1 + 0.1j], [100.0, 50.0], kind(n_substrate, k_substrate)
        R, T = reflectance_transmittance(*outer, wavelength, cosine)
        return (*R, *T)[result]

    np.testing.assert_allclose(forward_derivatives(run, point), central_differences(run, point, steps), **TOLERANCE)


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

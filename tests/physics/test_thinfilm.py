"""Fresnel's formulas and stacks, with derivatives, in NumPy and Dr.Jit against tables, `tmm` and closed forms."""

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
import vectors
from drjit_derivatives import forward_derivatives
from oracles.derivatives import central_differences
from oracles.stacks import Stack, by_tmm, random_stack

import mistray
from mistray.physics import fresnel, thinfilm
from mistray.physics.fresnel import cos2_refracted, reflectance
from mistray.physics.thinfilm import amplitudes, reflectance_transmittance

pytestmark = pytest.mark.quick

GLASS = 1.5168
# Vectors: 1e-12 where the computation is float64 throughout; 2e-6 with float32 arguments.
EXACT, SINGLE = 1e-12, 2e-6


@dataclass(frozen=True)
class Library:
    """Makes the arrays of one library, and NumPy arrays from them."""

    name: str
    tolerance: float

    def __str__(self) -> str:
        return self.name

    def real(self, x: Any) -> Any:
        x = np.asarray(x, dtype=float)
        if self.name == "numpy":
            return x
        return (mi.Float if self.name == "float32" else mi.Float64)(x.ravel())

    def index(self, n: Any) -> Any:
        """Real arrays for real indices, complex ones for the others."""
        n = np.asarray(n)
        if not np.any(n.imag):
            return self.real(n.real)
        if self.name == "numpy":
            return n
        kind = mi.Complex2f if self.name == "float32" else mi.Complex2f64
        return kind(self.real(n.real), self.real(n.imag))

    def back(self, x: Any) -> np.ndarray:
        if self.name == "numpy":
            return np.atleast_1d(x)
        parts = [np.array(part, dtype=float) for part in ((dr.real(x), dr.imag(x)) if dr.is_complex_v(x) else (x,))]
        return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]

    def solve(self, stack: Stack, wavelength_nm: Any, cosine: Any) -> np.ndarray:
        """R, T, r, t for s and p: (4, 2, m) complex128."""
        layers = [self.index(n) for n in stack.n_layers], [self.real(d) for d in stack.d_nm]
        outside = self.index(stack.n_substrate), self.real(wavelength_nm), self.real(cosine)
        arguments = (self.index(stack.n_incident), *layers, *outside)
        results = (*reflectance_transmittance(*arguments), *amplitudes(*arguments))
        if self.name != "numpy":
            dr.eval(results)  # in one kernel
        m = np.broadcast(wavelength_nm, cosine).size
        return np.array([[np.broadcast_to(self.back(x), m) for x in pair] for pair in results])


NUMPY, DOUBLE, FLOAT = Library("numpy", EXACT), Library("float64", EXACT), Library("float32", SINGLE)
each_library = pytest.mark.parametrize("library", [NUMPY, DOUBLE, FLOAT], ids=str)


def designs() -> dict[str, Stack]:
    found = {"bare": Stack(1.0, (), (), GLASS), "Al_bare": Stack(1.0, (), (), 0.958 + 6.69j)}
    for name, rows in vectors.frame("thinfilm_designs.csv").groupby("design"):
        rows = rows.sort_values("layer_index_from_air")
        substrate = complex(rows.substrate_n.iloc[0], rows.substrate_k.iloc[0])
        found[str(name)] = Stack(1.0, tuple(rows.n + 1j * rows.k), tuple(rows.thickness_nm), substrate)
    return found


INTERNAL = {
    "glass_to_air": Stack(GLASS, (), (), 1.0),
    "glass_MgF2_air": Stack(GLASS, (1.38,), (550 / 4 / 1.38,), 1.0),
    "FTIR_gap100nm": Stack(GLASS, (1.0,), (100.0,), GLASS),
    "FTIR_gap1000nm": Stack(GLASS, (1.0,), (1000.0,), GLASS),
}


def cosines(degrees: Any) -> np.ndarray:
    return np.cos(np.radians(np.asarray(degrees, dtype=float)))


def of_polarisation(values: np.ndarray, pol: pd.Series) -> np.ndarray:
    """(4, 2, m) → (4, m), the polarisation of each row."""
    return values[:, (pol == "p").astype(int), np.arange(len(pol))]


class TestVectors:
    @each_library
    @pytest.mark.parametrize("design", sorted(designs()))
    def test_designs(self, design, library):
        rows = vectors.frame("thinfilm.csv").query("design == @design")
        assert len(rows) == 56
        found = of_polarisation(library.solve(designs()[design], rows.lambda_nm, cosines(rows.aoi_deg)), rows.pol)
        amplitudes = (rows.r_re + 1j * rows.r_im, rows.t_re + 1j * rows.t_im)
        expected = (rows["R"], rows["T"], *amplitudes, rows["A"])
        np.testing.assert_allclose([*found, 1 - found[0] - found[1]], expected, rtol=0, atol=library.tolerance)

    @each_library
    @pytest.mark.parametrize("case", sorted(INTERNAL))
    def test_internal(self, case, library):
        """From inside glass, total reflection and its frustration included, with phases."""
        rows = vectors.frame("thinfilm_internal.csv").query("case == @case")
        assert len(rows) == 14
        found = of_polarisation(library.solve(INTERNAL[case], 550.0, cosines(rows.aoi_deg_in_glass)), rows.pol)
        expected = rows.r_re + 1j * rows.r_im
        np.testing.assert_allclose(found[:3], [rows["R"], rows["T"], expected], rtol=0, atol=library.tolerance)
        turn = np.exp(1j * np.radians(rows.phase_deg))
        np.testing.assert_allclose(np.angle(found[2] / turn), 0, atol=(library.tolerance / abs(expected)).max())


LAYERS = 40
ANGLES = 7


@functools.lru_cache
def random_cases() -> tuple[list[tuple[Stack, float, np.ndarray]], np.ndarray]:
    """200 stacks of 1-40 layers, each with a wavelength and 7 angles of 0-89.9°, and their (200, 4, 2, 7) by `tmm`."""
    rng = np.random.default_rng(20)
    cases, expected = [], []
    for i in range(200):
        stack, wavelength = random_stack(rng, 1 + i % LAYERS), rng.uniform(300.0, 1100.0)
        angle = np.concatenate([[0.0, 89.9], rng.uniform(0, 89.9, ANGLES - 2)])
        cases.append((stack, wavelength, cosines(angle)))
        expected.append(np.stack([by_tmm(stack, wavelength, c) for c in cosines(angle)], axis=-1))
    return cases, np.array(expected)


def side_by_side() -> tuple[Stack, np.ndarray, np.ndarray]:
    """All 200 cases as arrays, one lane for each stack and angle; missing layers have no thickness."""
    cases, _ = random_cases()
    n, d = np.ones((LAYERS, len(cases)), complex), np.zeros((LAYERS, len(cases)))
    for i, (stack, _, _) in enumerate(cases):
        n[: len(stack.d_nm), i], d[: len(stack.d_nm), i] = stack.n_layers, stack.d_nm

    def lanes(x: Any) -> np.ndarray:
        return np.repeat(x, ANGLES)

    outer = [lanes([getattr(stack, side) for stack, _, _ in cases]) for side in ("n_incident", "n_substrate")]
    every = Stack(outer[0], tuple(map(lanes, n)), tuple(map(lanes, d)), outer[1])
    return every, lanes([wavelength for _, wavelength, _ in cases]), np.concatenate([cosine for _, _, cosine in cases])


class TestRandomStacks:
    @each_library
    def test_against_tmm(self, library):
        """In float32 R and T alone: rounding turns the phases of r and t more. Absorption is never negative."""
        found = np.moveaxis(library.solve(*side_by_side()).reshape(4, 2, -1, ANGLES), 2, 0)  # (200, 4, 2, 7)
        R, T = np.moveaxis(found.real, 1, 0)[:2]
        assert (1 - R - T).min() >= -(2**-23 if library is FLOAT else 1e-13)  # the last digits of R and T
        assert min(R.min(), T.min()) >= 0
        results = slice(2) if library is FLOAT else slice(4)
        found, expected = found[:, results], random_cases()[1][:, results]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
        assert abs(found - expected).mean() < 2e-7

    def test_float32_is_the_rounded_float64_result(self):
        """Float32 arguments, taken as they are, give the same as in float64 to half a unit of the last digit."""
        stack, wavelength, cosine = side_by_side()

        def rounded(x: Any) -> np.ndarray:
            x = np.asarray(x)
            return x.astype(np.complex64 if x.dtype.kind == "c" else np.float32).astype(x.dtype)

        n, d = tuple(map(rounded, stack.n_layers)), tuple(map(rounded, stack.d_nm))
        same = Stack(rounded(stack.n_incident), n, d, rounded(stack.n_substrate)), rounded(wavelength), rounded(cosine)
        found, exact = (library.solve(*same)[:2] for library in (FLOAT, NUMPY))
        np.testing.assert_allclose(found, exact, rtol=2**-24 * (1 + 1e-6), atol=2**-149)


class TestEnergy:
    def test_complex_indices_without_absorption_are_real_ones(self):
        stack = designs()["HR_(HL)^7H"]
        cosine = np.linspace(0, 1, 101)
        real = DOUBLE.solve(stack, 500.0, cosine)[:2]
        n = [mi.Complex2f64(x.real, 0) for x in stack.n_layers]
        d = [mi.Float64(x) for x in stack.d_nm]
        found = reflectance_transmittance(1.0, n, d, GLASS, 500.0, mi.Float64(cosine))
        np.testing.assert_allclose(np.array(found), real, rtol=0, atol=EXACT)

    @pytest.mark.parametrize("n_incident", [1.5 + 1e-7j, 1.5 + 0.01j, 0.9 + 3j])
    def test_absorbing_incident_medium(self, n_incident):
        """As `tmm` has it, with a real tangential index; T stays ≥ 0 beyond the critical angle."""
        stack = Stack(n_incident, (1.38, 2.1 + 0.1j), (80.0, 60.0), 1.0)
        cosine = cosines([0, 30, 45, 60, 85])
        found = NUMPY.solve(stack, 550.0, cosine)
        expected = np.stack([by_tmm(stack, 550.0, c) for c in cosine], axis=-1)
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
        assert found[1].real.min() >= 0

    @pytest.mark.parametrize("seed", range(20))
    def test_reciprocity(self, seed):
        """Between lossless media T is the same along a path from either side, whatever the stack absorbs."""
        stack = replace(random_stack(np.random.default_rng(seed), 1 + 2 * seed), n_substrate=1.7)
        from_back = np.linspace(0.85, 1, 20)
        sine = 1.7 / stack.n_incident * np.sqrt(1 - from_back**2)
        from_back, from_front = from_back[sine < 1], np.sqrt(1 - sine[sine < 1] ** 2)
        forth = NUMPY.solve(stack, 550.0, from_front)
        back = NUMPY.solve(stack.reversed(), 550.0, from_back)
        np.testing.assert_allclose(forth[1], back[1], rtol=1e-11)
        if max(np.imag(stack.n_layers)) > 0.01:
            assert abs(forth[0] - back[0]).max() > 1e-6  # R differs, so the test can tell the sides apart


class TestLimits:
    @each_library
    def test_total_and_frustrated_total_reflection(self, library):
        """|r| = 1 and the phases of Born and Wolf, 7th ed., section 1.5.4; it survives lossless layers."""
        cosine = cosines(np.linspace(41.5, 89.9, 50))
        for layers in (((1.38, 2.1, 1.2), (90.0, 50.0, 200.0)), ((), ())):
            R, T, r, _ = library.solve(Stack(GLASS, *layers, 1.0), 550.0, cosine)
            np.testing.assert_allclose(R, 1, rtol=0, atol=library.tolerance)
            assert np.all(T == 0)
        decay = np.sqrt(GLASS**2 * (1 - cosine**2) - 1)
        s, p = -2 * np.arctan(decay / (GLASS * cosine)), -2 * np.arctan(GLASS * decay / cosine)
        slack = 100 * library.tolerance  # the phase is steep at the critical angle
        np.testing.assert_allclose(np.angle(r / np.exp(1j * np.array([s, p]))), 0, atol=slack)
        # Airy's formula for a gap with the internal reflection coefficient, for a real exponent that may underflow
        cosine, gap, wavelength = cosines(55.0), np.array([1.0, 30.0, 200.0, 1000.0, 1e6]), 550.0
        decay = np.sqrt(GLASS**2 * (1 - cosine**2) - 1)
        through = np.exp(-2 * math.pi * decay * gap / wavelength)
        for i, ratio in enumerate((GLASS * cosine / (1j * decay), cosine / GLASS / (1j * decay))):
            r = (ratio - 1) / (ratio + 1)
            T = abs((1 - r**2) * through / (1 - r**2 * through**2)) ** 2
            for one_gap, expected in zip(gap, T, strict=True):
                found = library.solve(Stack(GLASS, (1.0,), (one_gap,), GLASS), wavelength, cosine)
                np.testing.assert_allclose(found[1, i], expected, rtol=library.tolerance * 10)

    @pytest.mark.parametrize("n", [1.2, 1.2 + 1e-12j])
    def test_critical_angle_of_a_layer(self, n):
        """q = 0 in the layer: its matrix is 1 for E, linear for H, and R, T pass smoothly through it."""
        stack, cosine = Stack(1.5, (n, 1.38), (300.0, 80.0), 1.6), 0.6
        shift = np.concatenate([[0.0], 10.0 ** np.arange(-18, -5), -(10.0 ** np.arange(-18, -5))])
        values = NUMPY.solve(stack, 550.0, cosine + shift)
        assert np.all(np.isfinite(values))
        np.testing.assert_allclose(values, values[:, :, :1] + 0 * values, rtol=0, atol=1e-4)
        np.testing.assert_allclose(values[:, :, abs(shift) < 1e-12], values[:, :, :1] + np.zeros(13), atol=1e-10)
        exact = by_tmm(stack, 550.0, cosine + 1e-6)
        np.testing.assert_allclose(values[:, :, np.argmin(abs(shift - 1e-6))], exact, rtol=0, atol=1e-9)

    def test_series_meets_the_general_form(self):
        """Layers a little thinner and a little thicker than where the series ends, real, evanescent and absorbing."""
        for n in (1.38, 1.01, 0.5 + 3j):
            q = np.sqrt(complex(n) ** 2 - 1.5**2 * (1 - 0.6**2))
            edge = math.sqrt(thinfilm._SERIES) / abs(q) * 550 / (2 * math.pi)
            for d in (edge * 0.999, edge * 1.001):
                stack = Stack(1.5, (n,), (d,), 1.7)
                found = NUMPY.solve(stack, 550.0, 0.6)[..., 0]
                np.testing.assert_allclose(found, by_tmm(stack, 550.0, 0.6), rtol=0, atol=1e-13)

    @each_library
    def test_grazing_incidence_and_thick_absorbing_layers(self, library):
        """cos θ = 0: all is reflected, unless there is no step of the index at all."""
        for stack in (INTERNAL["glass_MgF2_air"], designs()["HR_(HL)^7H"], designs()["Al_SiO_HW"]):
            R, T, r, t = library.solve(stack, 550.0, 0.0)
            np.testing.assert_allclose(R, 1, atol=1e-7)
            np.testing.assert_allclose(T, 0, atol=1e-7)
            assert np.all(np.isfinite([r, t]))
        R, T, *_ = library.solve(Stack(1.5, (1.5, 1.5), (100.0, 200.0), 1.5), 550.0, [0.0, 1e-9, 0.5])
        np.testing.assert_allclose(R, 0, atol=1e-7)
        np.testing.assert_allclose(T, 1, atol=1e-7)
        # A millimetre of silver, forty times: R of bulk silver, T = 0, no NaN
        silver = 0.055 + 3.32j
        stack = Stack(1.0, (silver,) * 40, (1e6,) * 40, 1.5)
        cosine = cosines([0, 30, 60, 89, 90])
        R, T, r, t = library.solve(stack, 550.0, cosine)
        bulk = library.solve(Stack(1.0, (), (), silver), 550.0, cosine)[2]
        np.testing.assert_allclose(r, bulk, rtol=0, atol=library.tolerance)
        assert np.all((T == 0) & (t == 0) & (R.real < 1 + 1e-12))


class TestCalls:
    def test_arguments_broadcast(self):
        wavelength, cosine = np.linspace(400, 700, 5)[:, None], np.linspace(0, 1, 7)
        n = 1.38 + 0.01 * (550 / wavelength) ** 2
        (R, _), (T, _) = reflectance_transmittance(1.0, [n, 2.1], [100.0, 50.0], 1.5, wavelength, cosine)
        assert R.shape == T.shape == (5, 7)
        assert R.dtype == np.float64
        r, _ = amplitudes(1.0, [n, 2.1], [100.0, 50.0], 1.5, wavelength, cosine)
        assert (r[0].shape, r[0].dtype) == ((5, 7), np.complex128)
        alone = reflectance_transmittance(1.0, [float(n[2, 0]), 2.1], [100.0, 50.0], 1.5, 550.0, float(cosine[3]))
        assert R[2, 3] == pytest.approx(float(alone[0][0]), abs=1e-15)
        with pytest.raises(mistray.MistrayError, match="2 indices and 1 thicknesses"):
            reflectance_transmittance(1.0, [1.38, 2.1], [100.0], 1.5, 550.0, 1.0)

    @pytest.mark.parametrize("kind", ["Float", "Float64"])
    def test_types_of_the_arguments_are_kept(self, kind):
        real, complex_ = getattr(mi, kind), mi.Complex2f if kind == "Float" else mi.Complex2f64
        (R, _), (T, _) = reflectance_transmittance(1.0, [2.1 + 0.1j], [real(50.0)], 1.5, 550.0, 0.5)
        assert type(R) is type(T) is real
        (r, _), (t, _) = amplitudes(1.0, [2.1 + 0.1j], [50], np.float64(1.5), 550, real([0.5, 1.0]))
        assert type(r) is type(t) is complex_
        assert dr.width(r) == 2


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


def refracted(angle_deg, n1, n2):
    cos_i = math.cos(math.radians(angle_deg))
    return cos_i, math.sqrt(max(0.0, cos2_refracted(cos_i, n1, n2)))


def test_vectors():
    for row in vectors.frame("fresnel.csv").itertuples():
        at = *refracted(row.aoi, row.n1, row.n2), row.n1, row.n2
        assert reflectance(*at) == pytest.approx(row.Runpol, abs=1e-12)
        assert np.square(fresnel.amplitudes(*at)) == pytest.approx((row.Rs, row.Rp), abs=1e-12)


@pytest.mark.parametrize("n", [1.0, 1.3, 1.5168, 4.0])
def test_limits(n):
    """Normal and grazing incidence, the critical angle, and the same R from either side along a pair of angles."""
    assert reflectance(1.0, 1.0, 1.0, n) == pytest.approx(((n - 1) / (n + 1)) ** 2, abs=1e-15)
    assert reflectance(0.0, 0.0, n, n) == 0.0  # grazing without a step: 0/0 without the guard
    cos_i = np.linspace(0.01, 1, 50)
    cos_t = np.sqrt(cos2_refracted(cos_i, 1.0, n))
    np.testing.assert_allclose(reflectance(cos_i, cos_t, 1.0, n), reflectance(cos_t, cos_i, n, 1.0), rtol=1e-13)
    if n > 1:
        assert reflectance(0.0, math.sqrt(1 - 1 / n**2), 1.0, n) == pytest.approx(1.0)
        assert reflectance(*refracted(89.999, n, 1.0), n, 1.0) == pytest.approx(1.0, abs=1e-15)
        cosine = math.cos(math.asin(1 / n))
        assert cos2_refracted(cosine, n, 1.0) == pytest.approx(0, abs=4e-16 * n * n)
        assert cos2_refracted(cosine - 1e-6, n, 1.0) < 0 < cos2_refracted(cosine + 1e-6, n, 1.0)


def test_float32_stays_finite_and_in_range():
    cos_i = np.concatenate([np.linspace(0, 1, 1001), [1e-7, 1e-20, 1e-38]]).astype(np.float32)
    for n1, n2 in [(1.0, 1.5), (1.5, 1.0), (1.0, 1.0)]:
        cos_t = np.sqrt(np.maximum(cos2_refracted(cos_i, np.float32(n1), np.float32(n2)), np.float32(0)))
        r = reflectance(cos_i, cos_t, np.float32(n1), np.float32(n2))
        assert r.dtype == np.float32
        assert np.all((r >= 0) & (r <= 1 + 1e-6))

"""Formulas of lobes against float64 vectors (closed forms and quadrature), in Dr.Jit, and their derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from types import ModuleType

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from drjit_derivatives import forward_derivatives
from oracles import scatter_integrals
from oracles.derivatives import central_differences

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import abg, gaussian, harvey_shack
from mistray.physics import k_correlation as kc
from mistray.physics.disc import disc_total
from mistray.physics.growth import growth

pytestmark = pytest.mark.quick

VECTORS = 1e-6  # relative, as required
R = np.array([0.0, 1e-6, 1e-3, 0.1, 1.0, 1.99])


@pytest.mark.parametrize(
    ("model", "table", "distance", "names", "value"),
    [
        (abg, "abg_values.csv", "abs_beta_minus_beta0", "ABg", "BSDF_per_sr"),
        (harvey_shack, "harvey_values.csv", "abs_dbeta", ("b0", "l", "s"), "BSDF"),
    ],
)
def test_values(model: ModuleType, table: str, distance: str, names: str, value: str) -> None:
    rows = vectors.frame(table)
    found = model.bsdf(rows[distance].to_numpy(), *(rows[name].to_numpy() for name in names))
    np.testing.assert_allclose(found, rows[value], rtol=VECTORS)


@pytest.mark.parametrize(
    ("model", "table", "names"), [(abg, "abg_tis.csv", "ABg"), (harvey_shack, "harvey_tis.csv", ("b0", "l", "s"))]
)
def test_tis_vectors(model: ModuleType, table: str, names: str) -> None:
    for row in vectors.frame(table).to_dict("records"):
        numbers, sine = [row[name] for name in names], math.sin(math.radians(row["theta_i_deg"]))
        total = disc_total(lambda r, numbers=numbers: model.bsdf(r, *numbers), sine)
        assert total == pytest.approx(row["TIS_numeric"], rel=VECTORS), row
        if sine == 0:
            closed = row["TIS_closed_normal"]
            assert model.tis(*numbers) == pytest.approx(closed, rel=VECTORS), row
            if model is harvey_shack:
                assert harvey_shack.b0_from_tis(closed, row["l"], row["s"]) == pytest.approx(row["b0"], rel=VECTORS)


@pytest.mark.parametrize("width", [1e-4, 0.01, 0.3, 1.0, 1e3, 1e7])
def test_total_of_a_gaussian(width: float) -> None:
    total = scatter_integrals.total_scatter(lambda r: gaussian.bsdf(r, 0.3, width), 0.0)
    assert total == pytest.approx(0.3, rel=1e-4)


@pytest.mark.parametrize("x", [-700.0, -3.0, -0.06, -0.05, -0.049, -1e-9, 0.0, 1e-9, 0.049, 0.05, 0.06, 3.0])
def test_growth(x: float) -> None:
    """The series in exact fractions, and the quotient where nothing cancels."""
    exact, term = Fraction(1), Fraction(1)
    for k in range(2, 60):
        term *= Fraction(x) / k
        exact += term
    expected = float(exact) if abs(x) < 4 else math.expm1(x) / x
    assert growth(x) == pytest.approx(expected, rel=1e-14)
    assert growth(np.array([x, 0.0]))[0] == pytest.approx(expected, rel=1e-14)


def k_correlation(f: np.ndarray, rms: float, length: float, slope: float) -> np.ndarray:
    return kc.psd_um4(f, kc.band_amplitude_um4(rms, length, slope, 0.55), length, slope)


def alone(function: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """A function of the numbers alone, as one of a distance, too."""
    return lambda _, *numbers: function(*numbers)


ABG_STEPS, HARVEY_STEPS = (2.5e-7, 1e-7, 1e-4), (1e-5, 1e-6, 1e-4)


@pytest.mark.parametrize(
    ("function", "r", "point", "steps"),
    [
        *((abg.bsdf, R[1:], (0.0025, 1e-3, g), ABG_STEPS) for g in (0.0, 0.5, 1.8, 3.0)),
        *(
            (function, R, point, HARVEY_STEPS)
            for function in (harvey_shack.bsdf, alone(harvey_shack.tis), alone(harvey_shack.b0_from_tis))
            for point in ((0.11, 0.01, -1.5), (1.0, 0.01, -2.0), (1.0, 0.01, -2.0001))
        ),
        (gaussian.bsdf, np.array([0.0, 0.05, 0.4, 1.9]), (0.3, 0.2), (1e-4, 1e-4)),
        (k_correlation, np.array([0.0, 1e-3, 0.1, 2.0]), (1.5e-3, 200.0, 2.0), (1e-7, 1e-2, 1e-4)),
    ],
)
def test_drjit(
    function: Callable[..., np.ndarray], r: np.ndarray, point: tuple[float, ...], steps: tuple[float, ...]
) -> None:
    """Values to the rounding of float32; derivatives against central differences in float64."""
    single, double = function(mi.Float(r), *map(mi.Float, point)), function(r, *point)
    rounding = 1e-4 if function is gaussian.bsdf else 3e-6
    np.testing.assert_allclose(np.squeeze(single), double, rtol=rounding, atol=1e-30)
    expected = central_differences(lambda *numbers: function(r, *numbers), point, steps)
    found = forward_derivatives(lambda *numbers: function(dr.llvm.ad.Float64(r), *numbers), point)
    scale = np.abs(expected).max(axis=tuple(range(1, expected.ndim)), keepdims=True)
    np.testing.assert_array_less(np.abs(found - expected), 1e-7 * np.abs(expected) + 1e-9 * scale + 1e-300)


def test_derivatives_at_the_peak_of_an_abg() -> None:
    for g in (0.0, 0.5, 1.8, 3.0):
        found = forward_derivatives(lambda *numbers: abg.bsdf(dr.llvm.ad.Float64([0.0]), *numbers), (0.0025, 1e-3, g))
        assert np.all(np.isfinite(found))

"""Forbes's Q polynomials: departures of mild (Qbfs) and strong (Qcon) aspheres from a conic.

G. W. Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15, 5218 (2007), and "Robust,
efficient computational methods for axially symmetric optical aspheres", Opt. Express 18, 19700 (2010). With u the
distance from the axis in units of `radius` and x = u²:

    Qcon:  u⁴ Σ a_m Qcon_m(x),             Qcon_m the Jacobi polynomials P_m^(0,4)(2x - 1)
    Qbfs:  u² (1 - u²)/cos γ Σ a_m Qbfs_m(x),  cos² γ = (1 - (1 + k) c² ρ²)/(1 - k c² ρ²)

ρ is the distance from the axis, and γ the slope angle of the conic of curvature c and constant k from which the asphere
departs along its normals; Forbes uses a sphere, k = 0. The Qbfs have slopes, along these normals, that are orthogonal
with the weight 1/√(x - x²).

Terms without symmetry about the axis follow G. W. Forbes, "Characterizing the shape of freeform optics", Opt. Express
20, 2483 (2012), with the same factor along the axis:

    Q2D:  1/cos γ Σ_m u^m Σ_n (a_mn cos mφ + b_mn sin mφ) Q_mn(x),  m ≥ 1

The squares of the gradients of these terms have a mean of 1, and the gradients are orthogonal, with the weight
1/√(u² - u⁴) over the disc; Q_mn is of degree n, and its leading coefficient has the sign of (-1)^n.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np


def qcon(x: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """
    Return the sum x² Σ a_m Qcon_m(x) of strong-asphere polynomials, with coefficients a_m by m = 0, 1, ….

    x is the squared distance from the axis in units of the radius; the sum has its shape and the coefficients' unit.
    """
    from scipy.special import eval_jacobi  # takes longer to import than all else of a sag

    total = np.zeros(np.shape(x))
    for m, amount in terms.items():
        total = total + amount * eval_jacobi(m, 0, 4, 2 * np.asarray(x) - 1)
    return np.asarray(total * np.square(x))


def qbfs(x: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """
    Return the sum x (1 - x) Σ a_m Qbfs_m(x) of mild-asphere polynomials, with coefficients a_m by m = 0, 1, ….

    x is the squared distance from the axis in units of the radius; the sum has its shape and the coefficients' unit.
    The factor 1/cos γ is left out.
    """
    x = np.asarray(x, dtype=np.float64)
    values = qbfs_values(x, max(terms, default=0))
    total = np.zeros(x.shape)
    for m, amount in terms.items():
        total = total + amount * values[m]
    return np.asarray(total * x * (1 - x))


def qbfs_values(x: np.ndarray, last: int) -> list[np.ndarray]:
    """Return the polynomials Qbfs_0 … Qbfs_last at x, as in `qbfs`, by the recurrence of Forbes (2010), app. A."""
    auxiliary = [np.full_like(x, 2.0), 6 - 8 * x]
    while len(auxiliary) <= last:
        auxiliary.append((2 - 4 * x) * auxiliary[-1] - auxiliary[-2])
    f, g, h = [2.0, math.sqrt(19) / 2], [-0.5], [0.0]
    values = [np.ones_like(x), (13 - 16 * x) / math.sqrt(19)]
    for m in range(2, last + 1):
        h.append(-m * (m - 1) / (2 * f[m - 2]))
        g.append(-(1 + g[m - 2] * h[m - 1]) / f[m - 1])
        f.append(math.sqrt(m * (m + 1) + 3 - g[m - 1] ** 2 - h[m - 1] ** 2))
        values.append((auxiliary[m] - g[m - 1] * values[m - 1] - h[m - 1] * values[m - 2]) / f[m])
    return values[: last + 1]


def q2d(
    u: np.ndarray, v: np.ndarray, cosines: Mapping[tuple[int, int], float], sines: Mapping[tuple[int, int], float]
) -> np.ndarray:
    """
    Return the sum Σ ρ^m (a_mn cos mφ + b_mn sin mφ) Q_mn(ρ²) of Forbes's freeform polynomials.

    Coefficients a_mn, `cosines`, and b_mn, `sines`, are keyed by (m, n). The coordinates u = ρ cos φ and v = ρ sin φ
    are in units of the radius. The sum has their shape and the unit of the coefficients.
    """
    x = np.asarray(u * u + v * v)
    total = np.zeros(x.shape)
    for m in {m for m, _ in (*cosines, *sines)}:
        last = max(n for k, n in (*cosines, *sines) if k == m)
        values = q2d_values(x, m, last)
        turned = (u + 1j * v) ** m
        for terms, part in ((cosines, turned.real), (sines, turned.imag)):
            for (k, n), amount in terms.items():
                if k == m:
                    total = total + amount * part * values[n]
    return total


def q2d_values(x: np.ndarray, m: int, last: int) -> np.ndarray:
    """Return Forbes's freeform polynomials Q_m0 … Q_m,last at x, as in `qbfs`, (last + 1, …), for m ≥ 1."""
    return np.tensordot(_orthonormal(m, last), _jacobi(x, m, last), axes=1)


@cache
def _orthonormal(m: int, last: int) -> np.ndarray:
    """
    Return the coefficients of Forbes's Q_m0 … Q_m,last in Jacobi polynomials, (last + 1, last + 1), a row for each n.

    Gauss-Chebyshev nodes in u integrate the products of gradients exactly. The gradients of the Jacobi polynomials are
    the columns of A = QR. Then the columns of A R⁻¹ are orthonormal, and each has its own degree.
    """
    count = m + last + 2
    u = np.cos(np.pi * (2 * np.arange(count) + 1) / (4 * count))  # the positive ones of 2 count nodes
    x = u * u
    values, slopes = _jacobi(x, m, last), _jacobi(x, m, last, slope=True)
    radial = m * u ** (m - 1) * values + 2 * u ** (m + 1) * slopes
    around = m * u ** (m - 1) * values
    # Half of each square, cos² or sin², and twice for the mean of both, in the normalisation of Forbes
    gradients = np.concatenate([radial, around], axis=1).T / math.sqrt(2 * count)
    triangle = np.linalg.qr(gradients, mode="r")
    rows = np.linalg.inv(triangle).T
    # The leading coefficients of the Jacobi polynomials are positive
    signs = np.sign(np.diag(rows)) * (-1.0) ** np.arange(last + 1)
    return np.asarray(rows * signs[:, None])


def _jacobi(x: np.ndarray, m: int, last: int, slope: bool = False) -> np.ndarray:
    """
    Return the Jacobi polynomials in 2x - 1 of degree 0 … last, (last + 1, …).

    With `slope` the result is their derivatives with respect to x. The polynomials are orthogonal on 0 … 1 with the
    weight x^(m-3/2) (1-x)^(-1/2).
    """
    from scipy.special import eval_jacobi

    a, b, t = -0.5, m - 1.5, 2 * np.asarray(x, dtype=np.float64) - 1
    if not slope:
        return np.stack([eval_jacobi(n, a, b, t) for n in range(last + 1)])
    return np.stack(
        [(n + a + b + 1) * eval_jacobi(n - 1, a + 1, b + 1, t) if n else np.zeros(t.shape) for n in range(last + 1)]
    )

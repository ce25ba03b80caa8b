"""Mie scattering by one sphere in float64 with SciPy's spherical Bessel functions: another way than recurrences."""

import numpy as np
from scipy.special import eval_legendre, spherical_jn, spherical_yn


def sphere(x: float, index: complex, angle: np.ndarray, more_orders: int = 20) -> tuple[float, float, np.ndarray]:
    """Extinction and scattering efficiency and (|S1|² + |S2|²)/2 of a sphere, with exp(-iωt)."""
    n = np.arange(1, int(x + 4.05 * x ** (1 / 3) + 2 + more_orders) + 1)
    m = complex(index)
    j, dj = spherical_jn(n, x), spherical_jn(n, x, derivative=True)
    h = j + 1j * spherical_yn(n, x)
    dh = dj + 1j * spherical_yn(n, x, derivative=True)
    jm, djm = spherical_jn(n, m * x), spherical_jn(n, m * x, derivative=True)
    psi, dpsi, xi, dxi = x * j, j + x * dj, x * h, h + x * dh
    psim, dpsim = m * x * jm, jm + m * x * djm
    a = (m * psim * dpsi - psi * dpsim) / (m * psim * dxi - xi * dpsim)
    b = (psim * dpsi - m * psi * dpsim) / (psim * dxi - m * xi * dpsim)
    mu = np.cos(np.asarray(angle, dtype=float))[:, None]
    # π = P'_n and τ = μ P'_n - sin²θ P''_n, the derivatives from Legendre's equation
    p, before = eval_legendre(n, mu), eval_legendre(n - 1, mu)
    sin2 = 1 - mu * mu
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.where(sin2 > 1e-14, n * (before - mu * p) / sin2, 0)
    ends = np.where(mu > 0, 1.0, (-1.0) ** (n + 1)) * n * (n + 1) / 2
    pi = np.where(sin2 > 1e-14, first, ends)
    tau = n * (n + 1) * p - mu * pi
    weight = (2 * n + 1) / (n * (n + 1))
    s1, s2 = (weight * (a * pi + b * tau)).sum(axis=1), (weight * (a * tau + b * pi)).sum(axis=1)
    extinction = 2 / x**2 * float(np.sum((2 * n + 1) * (a + b).real))
    scattering = 2 / x**2 * float(np.sum((2 * n + 1) * (abs(a) ** 2 + abs(b) ** 2)))
    return extinction, scattering, (abs(s1) ** 2 + abs(s2) ** 2) / 2

"""R and T of a stack by Abelès' characteristic matrices, float64 (M. Born & E. Wolf, Principles of Optics, 1.6)."""

import numpy as np

from .geometry import Array


def stack_powers(
    n_incident: float, n_layers: Array, d_nm: Array, n_substrate: float, wavelength_nm: float, cosine: Array
) -> tuple[Array, Array]:
    """Mean R and T of s and p, (m,) each, at cosines of incidence (m,); T is 0 beyond the critical angle."""
    sine = n_incident * np.sqrt(1 - np.square(cosine))

    def cosine_in(n: complex) -> np.ndarray:
        root = np.sqrt((1 - (sine / n) ** 2).astype(complex))
        return np.where((n * root).imag < 0, -root, root)  # waves that fade away along the light

    R, T = np.zeros(len(cosine)), np.zeros(len(cosine))
    for p_polarised in (False, True):

        def admittance(n: complex, c: np.ndarray, p: bool = p_polarised) -> np.ndarray:
            return n / c if p else n * c

        first = admittance(n_incident, cosine.astype(complex))
        last = admittance(n_substrate, cosine_in(n_substrate))
        field, flux = np.ones(len(cosine), dtype=complex), last
        for n, d in zip(n_layers[::-1], d_nm[::-1], strict=True):
            c = cosine_in(n)
            phase, eta = 2 * np.pi * n * c * d / wavelength_nm, admittance(n, c)
            field, flux = (
                np.cos(phase) * field - 1j * np.sin(phase) / eta * flux,
                np.cos(phase) * flux - 1j * eta * np.sin(phase) * field,
            )
        R += 0.5 * np.abs((first * field - flux) / (first * field + flux)) ** 2
        T += 0.5 * 4 * first.real * last.real / np.abs(first * field + flux) ** 2
    return R, T

"""Thin-film stacks for the tests: random ones, and their amplitudes and powers by S. J. Byrnes' `tmm`, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tmm


@dataclass(frozen=True)
class Stack:
    n_incident: complex
    n_layers: tuple[complex, ...]
    d_nm: tuple[float, ...]
    n_substrate: complex

    def reversed(self) -> Stack:
        return Stack(self.n_substrate, self.n_layers[::-1], self.d_nm[::-1], self.n_incident)


def random_stack(rng: np.random.Generator, layers: int) -> Stack:
    """Layers of 1-400 nm; half of the stacks absorb, a quarter lies on a metal, a third is lit from a denser medium."""
    n = rng.uniform(1.3, 3.0, layers).astype(complex)
    if rng.random() < 0.5:
        n += 1j * np.where(rng.random(layers) < 0.5, 10.0 ** rng.uniform(-4, 0.6, layers), 0)
    d = 10.0 ** rng.uniform(0, 2.6, layers)
    n_incident = rng.uniform(1.4, 2.0) if rng.random() < 1 / 3 else 1.0
    n_substrate = complex(rng.uniform(1.0, 2.0))
    if rng.random() < 0.25:
        n_substrate = complex(rng.uniform(0.05, 2.0), rng.uniform(1.0, 7.0))
    return Stack(n_incident, tuple(map(complex, n)), tuple(map(float, d)), n_substrate)


def by_tmm(stack: Stack, wavelength_nm: float, cosine: float) -> np.ndarray:
    """R, T, r and t for s and p, (4, 2), at one wavelength and angle."""
    angle = np.arccos(cosine)
    if complex(stack.n_incident).imag:  # the angle that gives a real tangential index
        angle = np.arcsin(complex(stack.n_incident.real * np.sin(angle) / stack.n_incident))
    n = np.array([stack.n_incident, *stack.n_layers, stack.n_substrate], dtype=complex)
    d = [np.inf, *stack.d_nm, np.inf]
    s, p = (tmm.coh_tmm(pol, n, d, angle, wavelength_nm) for pol in "sp")
    return np.array([[s[key], p[key]] for key in "RTrt"])

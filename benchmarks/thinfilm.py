"""R(λ, θ) of stacks of ten layers: `mistray.physics.thinfilm` in Dr.Jit and NumPy, tmm and tmm_fast.

One evaluation is one wavelength and one angle with R and T of both polarisations. Dr.Jit computes in float32 on all
cores, the others in complex128; NumPy runs the same function as Dr.Jit, so that its rows compare at equal precision.
tmm takes one wavelength and angle at a time, the others arrays of them. ``python benchmarks/thinfilm.py`` prints the
rows alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import REPEATS, Row, agree, alternate, missing, version

import mistray
from mistray.physics.thinfilm import reflectance_transmittance

BAR = 1e7
N = np.array([1.38, 2.1, 1.63, 2.3, 1.46, 1.9, 1.38, 2.1, 1.46, 1.7])
D_NM = np.array([95.0, 60.0, 84.0, 25.0, 140.0, 70.0, 33.0, 14.0, 110.0, 50.0])
K = np.array([0.0, 0.01, 0.0, 0.02, 0.0, 0.001, 0.0, 0.01, 0.0, 0.1])
SUBSTRATE = 1.5168
FLOAT32, FLOAT64 = 1e-5, 1e-9  # tolerances of R over its largest

Action = Callable[[], np.ndarray]
"""Evaluates a grid; R_s of (angles, wavelengths)."""


@dataclass(frozen=True)
class Grid:
    """Wavelengths in nm times angles in radians."""

    wavelengths: np.ndarray
    angles: np.ndarray

    @classmethod
    def of(cls, wavelengths: int, angles: int) -> Grid:
        """400-700 nm, 0-85°."""
        return cls(np.linspace(400.0, 700.0, wavelengths), np.linspace(0.0, np.radians(85.0), angles))

    @property
    def count(self) -> int:
        """Evaluations."""
        return len(self.wavelengths) * len(self.angles)


def in_drjit(n: np.ndarray, d_nm: np.ndarray, grid: Grid) -> tuple[Callable[[], None], Action]:
    """Float32, every number of the stack opaque to the compiler; the evaluation alone, and with R_s on the host."""
    wavelength = mi.Float(np.tile(grid.wavelengths, len(grid.angles)))
    cosine = mi.Float(np.repeat(np.cos(grid.angles), len(grid.wavelengths)))
    dr.eval(wavelength, cosine)

    def opaque(x: complex) -> object:
        if np.isrealobj(n):
            return dr.opaque(mi.Float, float(x))
        return mi.Complex2f(dr.opaque(mi.Float, float(x.real)), dr.opaque(mi.Float, float(x.imag)))

    layers, thickness = [opaque(x) for x in n], [dr.opaque(mi.Float, float(x)) for x in d_nm]
    result = []

    def action() -> None:
        result[:] = reflectance_transmittance(1.0, layers, thickness, SUBSTRATE, wavelength, cosine)
        dr.eval(result)
        dr.sync_thread()

    def reflectance() -> np.ndarray:
        action()
        return np.array(result[0][0]).reshape(len(grid.angles), len(grid.wavelengths))

    return action, reflectance


def in_numpy(n: np.ndarray, grid: Grid) -> Action:
    """Complex128."""
    cosine = np.cos(grid.angles)[:, None]
    return lambda: reflectance_transmittance(1.0, n, D_NM, SUBSTRATE, grid.wavelengths, cosine)[0][0]


def in_tmm(grid: Grid) -> Action:
    """Point by point, both polarisations in turn; its answers hold R and T."""
    import tmm

    index, thickness = [1.0, *N, SUBSTRATE], [np.inf, *D_NM, np.inf]
    wavelengths, angles = grid.wavelengths, grid.angles

    def action() -> np.ndarray:
        found = [
            [[tmm.coh_tmm(pol, index, thickness, angle, wavelength)["R"] for pol in "sp"] for wavelength in wavelengths]
            for angle in angles
        ]
        return np.array(found)[:, :, 0]

    return action


def in_tmm_fast(grid: Grid, threads: int) -> Action:
    """NumPy arrays in and out, lengths in metres, both polarisations in turn."""
    import tmm_fast
    import torch

    index = np.concatenate([[1.0], N, [SUBSTRATE]]).astype(complex)
    index = np.repeat(index[None, :, None], len(grid.wavelengths), axis=2)
    thickness = np.concatenate([[np.inf], 1e-9 * D_NM, [np.inf]])[None]

    def action() -> np.ndarray:
        torch.set_num_threads(threads)
        s, _ = (tmm_fast.coh_tmm(pol, index, thickness, grid.angles, 1e-9 * grid.wavelengths)["R"] for pol in "sp")
        return np.asarray(s)[0]

    return action


def per_second(rate: float) -> str:
    """Cell of the table."""
    return f"{rate / 1e6:.3g} M/s"


def row(key: str, what: str, ours: float, other: float, bar: float | None = None, equal: str = "") -> Row:
    """Rates of both sides, evaluations/s."""
    text = f"R(λ, θ), s and p, of {len(N)} {what} (evaluations/s)"
    return Row(key, text, per_second(ours), per_second(other), ours / other, bar, equal=equal)


def against_itself(kind: str, n: np.ndarray, large: Grid, grid: Grid, repeats: int) -> list[Row]:
    """Dr.Jit on a large grid against the bar, and against NumPy on a small one, on which both must agree."""
    action, _ = in_drjit(n, D_NM, large)
    _, reflectance = in_drjit(n, D_NM, grid)
    numpy = in_numpy(n, grid)
    equal = agree("R", reflectance(), numpy(), FLOAT32)
    here, there = alternate(action, numpy, repeats=repeats)
    rate, other = large.count / here.seconds, grid.count / there.seconds
    return [
        row(f"drjit-{kind}", f"{kind} layers, Dr.Jit float32 against the bar", rate, BAR, 1.0),
        row(f"numpy-{kind}", f"{kind} layers, Dr.Jit float32 against the same in NumPy complex128", rate, other,
            equal=equal),
    ]  # fmt: skip


def against_peer(name: str, grid: Grid, large: Grid, others: list[Action], repeats: int) -> list[Row]:
    """Dr.Jit on a large grid and NumPy on the same grid against the fastest of the peer's ways."""
    action, _ = in_drjit(N, D_NM, large)
    _, reflectance = in_drjit(N, D_NM, grid)
    numpy = in_numpy(N, grid)
    single = [agree("R", reflectance(), other(), FLOAT32) for other in others]
    double = [agree("R", numpy(), other(), FLOAT64) for other in others]
    here, same, *there = alternate(action, numpy, *others, repeats=repeats)
    rate = grid.count / min(timing.seconds for timing in there)
    what = f"lossless layers, {{}} against {version(name)}, complex128 on the CPU"
    return [
        row(name, what.format("Dr.Jit float32"), large.count / here.seconds, rate, equal=single[0]),
        row(f"{name}-numpy", what.format("NumPy complex128"), grid.count / same.seconds, rate, equal=double[0]),
    ]


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `films`."""
    mistray.ensure_variant()
    large, small, few = (Grid.of(64, 32), Grid.of(16, 8), Grid.of(4, 2))
    if not quick:
        large, small, few = Grid.of(2048, 1024), Grid.of(256, 64), Grid.of(16, 16)
    repeats = 1 if quick else REPEATS
    yield from against_itself("lossless", N, large, small, repeats)
    yield from against_itself("absorbing", N + 1j * K, large, small, repeats)
    absent = missing("tmm", f"R(λ, θ) of {len(N)} layers against tmm", "tmm")
    if absent:
        yield absent
    else:
        yield from against_peer("tmm", few, large, [in_tmm(few)], repeats)
    absent = missing("tmm_fast", f"R(λ, θ) of {len(N)} layers against tmm_fast", "tmm_fast", "torch")
    if absent:
        yield absent
    else:
        threads = (1, os.cpu_count() or 1)
        yield from against_peer("tmm_fast", small, large, [in_tmm_fast(small, count) for count in threads], repeats)


if __name__ == "__main__":
    print(*rows(False), sep="\n")

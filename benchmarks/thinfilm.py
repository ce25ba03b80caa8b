"""R(λ, θ) of stacks of ten layers: evaluations per second of `mistray.physics.thinfilm` in Dr.Jit, NumPy and tmm_fast.

One evaluation is one wavelength and one angle with R and T of both polarisations. ``python benchmarks/thinfilm.py``
prints the rows alone.
"""

from __future__ import annotations

import importlib.metadata
import math
import os
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import Row, alternate

import mistray
from mistray.physics.thinfilm import reflectance_transmittance

BAR = 1e7
LAYERS = 10
N = np.array([1.38, 2.1, 1.63, 2.3, 1.46, 1.9, 1.38, 2.1, 1.46, 1.7])
D_NM = np.array([95.0, 60.0, 84.0, 25.0, 140.0, 70.0, 33.0, 14.0, 110.0, 50.0])
K = np.array([0.0, 0.01, 0.0, 0.02, 0.0, 0.001, 0.0, 0.01, 0.0, 0.1])
SUBSTRATE = 1.5168

Grid = tuple[np.ndarray, np.ndarray]


def grid(wavelengths: int, angles: int) -> Grid:
    """Wavelengths in nm and angles in radians."""
    return np.linspace(400.0, 700.0, wavelengths), np.linspace(0.0, np.radians(85.0), angles)


def in_drjit(n: np.ndarray, points: Grid) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """Float32, every number of the stack opaque to the compiler; the action, and its R_s as (angles, wavelengths)."""
    wavelengths, angles = points
    wavelength = mi.Float(np.tile(wavelengths, len(angles)))
    cosine = mi.Float(np.repeat(np.cos(angles), len(wavelengths)))
    dr.eval(wavelength, cosine)

    def opaque(x: complex) -> object:
        if np.isrealobj(n):
            return dr.opaque(mi.Float, float(x))
        return mi.Complex2f(dr.opaque(mi.Float, float(x.real)), dr.opaque(mi.Float, float(x.imag)))

    layers, thickness = [opaque(x) for x in n], [dr.opaque(mi.Float, float(x)) for x in D_NM]
    result = []

    def action() -> None:
        result[:] = reflectance_transmittance(1.0, layers, thickness, SUBSTRATE, wavelength, cosine)
        dr.eval(result)
        dr.sync_thread()

    return action, lambda: np.array(result[0][0]).reshape(len(angles), len(wavelengths))


def in_numpy(n: np.ndarray, points: Grid) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    wavelengths, angles = points
    result = []

    def action() -> None:
        result[:] = reflectance_transmittance(1.0, n, D_NM, SUBSTRATE, wavelengths, np.cos(angles)[:, None])

    return action, lambda: result[0][0]


def in_tmm_fast(n: np.ndarray, points: Grid, threads: int) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """NumPy arrays in and out, lengths in metres, both polarisations in turn."""
    import tmm_fast
    import torch

    wavelengths, angles = points
    index = np.concatenate([[1.0], n, [SUBSTRATE]]).astype(complex)
    index = np.repeat(index[None, :, None], len(wavelengths), axis=2)
    thickness = np.concatenate([[np.inf], 1e-9 * D_NM, [np.inf]])[None]
    result = []

    def action() -> None:
        torch.set_num_threads(threads)
        result[:] = [tmm_fast.coh_tmm(pol, index, thickness, angles, 1e-9 * wavelengths)["R"] for pol in "sp"]

    return action, lambda: result[0][0]


def rate(per_second: float) -> str:
    return f"{per_second / 1e6:.3g} M/s"


def thin_films() -> list[Row]:
    """Dr.Jit against the bar for a lossless and an absorbing stack; against NumPy and tmm_fast for the lossless one."""
    mistray.ensure_variant()
    large, small = grid(2048, 1024), grid(256, 64)
    count, count_small = (points[0].size * points[1].size for points in (large, small))

    def rates(n: np.ndarray, others: list[tuple[Callable[[], None], Callable[[], np.ndarray]]]) -> tuple[float, float]:
        """Ours, and the best of the others, which must agree with ours."""
        ours, theirs = 0.0, 0.0
        check, r_ours = in_drjit(n, small)
        check()
        for action, r_theirs in others:
            seconds = alternate(in_drjit(n, large)[0], action)
            ours, theirs = max(ours, count / seconds[0]), max(theirs, count_small / seconds[1])
            np.testing.assert_allclose(r_theirs(), r_ours(), atol=1e-5)
        return ours, theirs

    def row(kind: str, against: str, ours: float, other: float, bar: float | None = None) -> Row:
        what = f"R(λ, θ), s and p, of {LAYERS} {kind} layers, Dr.Jit float32 against {against} (evaluations/s)"
        return Row(what, rate(ours), rate(other), ours / other, bar)

    lossless, numpy = rates(N, [in_numpy(N, small)])
    absorbing, _ = rates(N + 1j * K, [in_numpy(N + 1j * K, small)])
    rows = [
        row("lossless", "the bar", lossless, BAR, 1.0),
        row("absorbing", "the bar", absorbing, BAR, 1.0),
        row("lossless", "the same in NumPy float64", lossless, numpy),
    ]
    try:
        theirs = [in_tmm_fast(N, small, threads) for threads in (1, os.cpu_count() or 1)]
    except ImportError:
        missing = "not installed (pip install tmm_fast)"
        rows.append(Row("R(λ, θ) of 10 layers, Dr.Jit against `tmm_fast`", rate(lossless), missing, math.nan, None))
    else:
        version = importlib.metadata.version("tmm_fast")
        rows.append(row("lossless", f"`tmm_fast` {version}, NumPy arrays on the CPU", *rates(N, theirs)))
    return rows


if __name__ == "__main__":
    print(*thin_films(), sep="\n")

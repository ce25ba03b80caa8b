"""R(λ, θ) of stacks of ten layers: evaluations per second of `mistray.physics.thinfilm` in Dr.Jit, NumPy and tmm_fast.

One evaluation is one wavelength and one angle with R and T of both polarisations. ``python benchmarks/thinfilm.py``
prints the rows alone.
"""

from __future__ import annotations

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


def in_tmm_fast(n: np.ndarray, points: Grid) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """NumPy arrays in and out, lengths in metres, both polarisations in turn."""
    import tmm_fast

    wavelengths, angles = points
    index = np.concatenate([[1.0], n, [SUBSTRATE]]).astype(complex)
    index = np.repeat(index[None, :, None], len(wavelengths), axis=2)
    thickness = np.concatenate([[np.inf], 1e-9 * D_NM, [np.inf]])[None]
    result = []

    def action() -> None:
        result[:] = [tmm_fast.coh_tmm(pol, index, thickness, angles, 1e-9 * wavelengths)["R"] for pol in "sp"]

    return action, lambda: result[0][0]


def rate(evaluations: int, seconds: float) -> str:
    return f"{evaluations / seconds / 1e6:.3g} M/s"


def thin_films() -> list[Row]:
    """Dr.Jit against the bar, against tmm_fast and against NumPy, for a lossless and for an absorbing stack."""
    mistray.ensure_variant()
    large, small = grid(2048, 1024), grid(256, 64)
    rows = []
    for kind, n in (("lossless", N), ("absorbing", N + 1j * K)):
        what = f"R(λ, θ), s and p, of {LAYERS} {kind} layers (evaluations/s): Dr.Jit float32 against"
        ours, _ = in_drjit(n, large)
        _, r_ours = (check := in_drjit(n, small))
        check[0]()
        count = large[0].size * large[1].size
        for name, other in (("tmm_fast", in_tmm_fast), ("our own NumPy path", in_numpy)):
            try:
                theirs, r_theirs = other(n, small)
            except ImportError:
                rows.append(Row(f"{what} {name}", "", f"{name} is not installed: pip install {name}", np.nan, None))
                continue
            t_ours, t_theirs = alternate(ours, theirs)
            np.testing.assert_allclose(r_ours(), r_theirs(), atol=1e-5)
            fast, slow = count / t_ours, small[0].size * small[1].size / t_theirs
            if name == "tmm_fast":
                rows.append(Row(f"{what} the bar", rate(count, t_ours), f"{BAR / 1e6:g} M/s", fast / BAR, 1.0))
            rows.append(Row(f"{what} {name}", rate(1, 1 / fast), rate(1, 1 / slow), fast / slow, None))
    return rows


if __name__ == "__main__":
    print(*thin_films(), sep="\n")

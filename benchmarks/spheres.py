"""Mie spheres: `mistray.physics.mie` against miepython.

A sphere is its efficiencies of extinction and scattering and its unpolarised intensity at 181 angles. Both compute in
float64 on the CPU. miepython takes sphere by sphere, compiled by numba where that is installed; here all spheres go
together through NumPy, which is compiled once and for all.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec

import numpy as np
from rows import REPEATS, Row, agree, alternate, measured, missing, version

from mistray.physics.mie import spheres

INDEX = 1.53 + 0.001j
LARGEST_X = 400.0
COUNT, ANGLES = 400, 181
TOLERANCE = 1e-5  # relative, at every angle, in dark fringes too: both series end somewhere


def against_miepython(count: int, repeats: int, compiled: bool) -> Row:
    """The same spheres and angles on both sides."""
    if compiled:
        os.environ.setdefault("MIEPYTHON_USE_JIT", "1")  # read when it is imported
    import miepython

    x, angles = np.geomspace(0.1, LARGEST_X, count), np.linspace(0.0, np.pi, ANGLES)
    mu, index = np.cos(angles), INDEX.conjugate()  # n - ik there

    def theirs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        extinction, scattering, *_ = miepython.efficiencies_mx(index, x)
        return extinction, scattering, np.array([miepython.i_unpolarized(index, one, mu, norm="wiscombe") for one in x])

    ours, (extinction, scattering, intensity) = spheres(x, INDEX, angles), theirs()
    cells = [
        agree(what, mine / other, 1.0, TOLERANCE)
        for what, mine, other in (
            ("extinction", ours.extinction, extinction),
            ("scattering", ours.scattering, scattering),
            ("intensity", ours.intensity, intensity),
        )
    ]
    here, there = alternate(lambda: spheres(x, INDEX, angles), theirs, repeats=repeats)
    mode = "with numba" if os.environ.get("MIEPYTHON_USE_JIT") == "1" else "without numba"
    return Row(
        "miepython",
        f"{count} spheres of x = 0.1 … {LARGEST_X:g}, {ANGLES} angles, {version('miepython')} {mode} (spheres/s)",
        f"{count / here.seconds / 1e3:.3g} k/s",
        f"{count / there.seconds / 1e3:.3g} k/s",
        there.seconds / here.seconds,
        equal=", ".join(cells),
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `mie`."""
    what = "Mie spheres, miepython"
    absent = missing("miepython", what, "miepython")
    compiled = find_spec("numba") is not None and not quick
    make = partial(against_miepython, 30 if quick else COUNT, 1 if quick else REPEATS, compiled)
    yield absent or measured("miepython", what, make)

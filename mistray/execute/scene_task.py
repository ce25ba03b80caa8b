"""
Tasks on a scene that are shared among workers: each rebuilds the task's object and computes parts of the result.

Two processes, or two runs, compare the arrays that the kernel reads, and so verify that they trace the same scene.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.kernel.scattering import Scattering
from mistray.surfaces.surfaces import SurfaceTable

# Machines may differ in the last digits of a number, and in what is left of differences of larger ones
TOLERANCE, ROUNDING = 1e-5, 1e-9


@dataclass(frozen=True, eq=False)
class SceneTask:
    """
    Task on a scene: each worker builds an object of class `kind`, which then does parts, see `mistray.execute.workers`.

    Attributes
    ----------
    kind : callable
        Class of the object. It has ``kernel_arrays()``, the arrays that the kernel reads for each wavelength, and
        ``do(part)``, the sums of a part.
    scene : mi.Scene
        Loaded scene.
    arguments : tuple
        Other arguments of the class.
    arrays : sequence of list of array
        Arrays that the kernel reads here: workers check that they have the same.
    """

    kind: Callable[..., Any]
    scene: mi.Scene
    arguments: tuple[Any, ...]
    arrays: Sequence[list[np.ndarray]]

    def make(self) -> Any:
        """
        Return the task's object, rebuilt in this worker.

        Raise `MistrayError` if its kernel arrays differ from the original's.
        """
        made = self.kind(self.scene, *self.arguments)
        there = made.kernel_arrays()
        if len(self.arrays) != len(there) or not all(agree(a, b) for a, b in zip(self.arrays, there, strict=True)):
            raise MistrayError(
                "the scene is another one at the worker than here: it, or a file that it names, has changed since it "
                "was loaded or traced; load it again"
            )
        return made

    def do(self, made: Any, part: Any) -> Any:
        """Return the sums of one part, computed by the rebuilt object `made`."""
        return made.do(part)


def kernel_arrays(table: SurfaceTable, scattering: Scattering | None = None) -> list[np.ndarray]:
    """Return the arrays of geometry, coatings, media and, if given, scatter that the kernel reads at one wavelength."""
    optics = table.optics
    geometry = table.quadric, table.vertex, table.polynomial, table.rotation, table.clip
    bounds = [{"size": piece.size, **piece.kernel_values()} for piece in table.pieces]
    names = dict.fromkeys(name for row in bounds for name, value in row.items() if not isinstance(value, tuple))
    arrays = [optics.words, optics.indices, optics.places, optics.table, optics.extinction, optics.albedo]
    arrays += [optics.asymmetry] if optics.scatters else []
    arrays += scattering.arrays if scattering is not None else ()
    # A row for each surface: its numbers are of different units and sizes
    rows = [np.array([[row.get(name, 0.0) for name in names] for row in bounds], dtype=np.float64)]
    rows += [np.array(values).reshape(table.count, -1) for values in geometry]
    return rows + [np.array(values) for values in arrays]


def fingerprint(bands: Iterable[tuple[SurfaceTable, Scattering]]) -> str:
    """Return a hexadecimal SHA-256 hash of all that the kernel reads of a scene, over all wavelengths."""
    digest = hashlib.sha256()
    for number, (table, scattering) in enumerate(bands):
        if number == 0:
            digest.update(repr(table.ids).encode())
        for values in kernel_arrays(table, scattering):
            digest.update(values.tobytes())
        # Mitsuba's own shapes are not in these arrays, nor is the index of a medium that walls alone declare
        digest.update(repr([str(shape) for shape in table.shapes[len(table.pieces) :]]).encode())
        digest.update(table.mitsuba_hash + table.optics.host_media_n.tobytes())
    return digest.hexdigest()


def agree(here: Sequence[np.ndarray], there: Sequence[np.ndarray]) -> bool:
    """True if kernel arrays of two machines agree: floats within the relative `TOLERANCE`, integers exactly."""
    return len(here) == len(there) and all(_agree(a, b) for a, b in zip(here, there, strict=True))


def _agree(a: np.ndarray, b: np.ndarray) -> bool:
    """True if two arrays agree: floats within `TOLERANCE` of the largest value in their column, others exactly."""
    if a.shape != b.shape or a.dtype.kind != "f":
        return np.array_equal(a, b)
    largest = np.max(np.abs(a), axis=0, initial=0, where=np.isfinite(a))
    allowed = TOLERANCE * largest + ROUNDING * np.max(largest, initial=0)
    return bool(np.all(np.isclose(a, b, rtol=TOLERANCE, atol=allowed, equal_nan=True)))

"""Arrays that the kernel reads of a scene, by which two processes, or two runs, verify that they trace the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np

from mistray.kernel.scattering import Scattering
from mistray.surfaces.surfaces import SurfaceTable

# Machines may differ in the last digits of a table
TOLERANCE = 1e-5


def kernel_arrays(table: SurfaceTable, scattering: Scattering) -> list[np.ndarray]:
    """Return the arrays of geometry, coatings, media and scatter that the kernel reads at one wavelength."""
    optics = table.optics
    arrays = [table.quadric, table.vertex, table.polynomial, table.rotation, table.clip, optics.words]
    arrays += [optics.indices, optics.places, optics.table, optics.extinction, optics.albedo]
    return [np.array(values) for values in (*arrays, *scattering.arrays)]


def fingerprint(bands: Iterable[tuple[SurfaceTable, Scattering]]) -> str:
    """Return a hexadecimal SHA-256 hash of all that the kernel reads of a scene, over all wavelengths."""
    digest = hashlib.sha256()
    for number, (table, scattering) in enumerate(bands):
        if number == 0:
            digest.update(repr(table.ids).encode())
        for values in kernel_arrays(table, scattering):
            digest.update(values.tobytes())
        # Mitsuba's own shapes are not in these arrays
        digest.update(repr([str(shape) for shape in table.shapes[len(table.pieces) :]]).encode())
    return digest.hexdigest()


def agree(here: Sequence[np.ndarray], there: Sequence[np.ndarray]) -> bool:
    """Whether kernel arrays of two machines are equal within `TOLERANCE`, a relative one; integers exactly."""
    return len(here) == len(there) and all(_agree(a, b) for a, b in zip(here, there, strict=True))


def _agree(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays are equal but for rounding; integers must be identical."""
    if a.shape != b.shape or a.dtype.kind != "f":
        return np.array_equal(a, b)
    largest = float(np.max(np.abs(a), initial=0, where=np.isfinite(a)))
    return np.allclose(a, b, rtol=TOLERANCE, atol=TOLERANCE * largest, equal_nan=True)

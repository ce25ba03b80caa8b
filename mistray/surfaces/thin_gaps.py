"""Detection of gaps between surfaces that are thinner than float32 rounding of positions, in which light is lost."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from mistray.cache.remembered import remembered
from mistray.messages import Message
from mistray.notes import Note
from mistray.physics.geometry.sag import conic_end
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.surfaces import SurfaceTable

ROUNDINGS = 4  # roundings of a position: a thicker gap passes its light
SAMPLES = 65  # samples of the common aperture, in equal areas
SHARE = 0.02  # fraction of the aperture that may be thinner: surfaces may touch


def thin_gaps(table: SurfaceTable) -> list[Note]:
    """
    Return a note for each gap between neighbouring surfaces that is too thin for float32 positions.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene. Planes, conics and aspheres that are neighbours on one axis are compared; walls and all
        other surfaces are left out.
    """
    return [*remembered(table.shared, "thin_gaps", lambda: [*_thin_gaps(table)])]


def _thin_gaps(table: SurfaceTable) -> Iterator[Note]:
    optics = sorted((p for p in table.pieces if isinstance(p, SagSurface) and not p.wall), key=lambda p: (p.axis, p.z))
    for a, b in pairwise(optics):
        low, high = max(a.inner, b.inner), min(a.size, b.size)
        if a.axis != b.axis or high <= low:
            continue
        r2 = np.linspace(low**2, high**2, SAMPLES)
        gap = np.abs(_height(b, r2) - _height(a, r2))
        place = abs(a.z) if a.frame == 0 else float(np.linalg.norm(table.vertices[a.index] - table.centre))
        least = ROUNDINGS * float(np.spacing(np.float32(place)))
        if np.mean(gap < least) > SHARE:
            names = {"first": table.ids[a.index], "second": table.ids[b.index]}
            yield Message.THIN_GAP.note(**names, gap=np.median(gap), least=least, place=place)


def _height(piece: SagSurface, r2: np.ndarray) -> np.ndarray:
    """Return the z coordinate of a surface, mm, at squared radii r2, mm², in the frame of its axis."""
    return piece.z + piece.sag(np.minimum(r2, conic_end(piece.curvature, piece.conic) ** 2 * (1 - 1e-12)))

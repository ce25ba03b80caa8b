"""Base class of surfaces of revolution: a generatrix in r and z, rotated about the local z axis."""

from __future__ import annotations

import numpy as np

from mistray.plugins.shapes.formula_shape import FormulaShape

# Facets of the mesh around the axis, and points along the generatrix, for Mitsuba's own integrators alone. Chords of a
# sphere's generatrix leave it by a quarter of what the azimuths do; Embree takes all triangles anew at each change.
AZIMUTHS, ALONG = 96, 33


class Revolution(FormulaShape):
    """Base class of surfaces of revolution about the local z axis; a subclass also provides `profile`."""

    mesh_points = ALONG
    """Number of points of the generatrix at which the mesh has its rings; it must not follow the parameters."""

    def profile(self, count: int = 65) -> np.ndarray:
        """Return `count` points of the generatrix, r and z in the local frame, (count, 2), mm."""
        raise NotImplementedError

    @property
    def flipped(self) -> bool:
        """True if the mesh made from `profile` must be reversed to have the surface's normal."""
        return False

    def _local_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        return revolve(self.profile(self.mesh_points), self.flipped)


def revolve(profile: np.ndarray, flipped: bool = False, azimuths: int = AZIMUTHS) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the triangle mesh of a generatrix rotated about the z axis.

    Parameters
    ----------
    profile : (n, 2) float
        Radius r and position z along the generatrix, mm.
    flipped : bool
        Whether to reverse the winding. Otherwise a profile of growing r has normals towards +z.

    Returns
    -------
    vertices : (n·azimuths, 3) float64
        Corners of the triangles, mm.
    faces : (m, 3) uint32
        Indices of the corners of each triangle.
    """
    count = len(profile)
    phi = np.arange(azimuths) * (2 * np.pi / azimuths)
    r, z = profile[:, :1], profile[:, 1:]
    vertices = np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z, (count, azimuths))], axis=-1).reshape(
        -1, 3
    )
    i, j = np.meshgrid(np.arange(count - 1), np.arange(azimuths), indexing="ij")
    a, b = i * azimuths + j, i * azimuths + (j + 1) % azimuths
    c, d = a + azimuths, b + azimuths
    inner = np.stack([a, c, d], axis=-1)[profile[1:, 0] > 0]
    outer = np.stack([a, d, b], axis=-1)[profile[:-1, 0] > 0]
    faces = np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)]).astype(np.uint32)
    return vertices, faces[:, ::-1] if flipped else faces

"""
Emissivity of surfaces, which by Kirchhoff's law is their absorptance for light from the same direction.

The absorptance is ε(θ) = 1 - R - T - scatter, with the shares of the coating and of the scatter at the angle θ.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.interaction import interact
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.surfaces.host_points import across, surface_points
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

FRONT, BACK = range(2)
TURNS = 4  # azimuths of incidence that are averaged, for surfaces whose scatter depends on it
LEAST = 2e-6  # smaller values are rounding of 1 - R - T


def emissivities(table: SurfaceTable, cosines: np.ndarray) -> np.ndarray:
    """
    Return the emissivity of surfaces: the fraction of unpolarised light that they absorb, by side and angle.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    cosines : (m,) float64
        Cosines of the angles of incidence, above 0.

    Returns
    -------
    (surfaces, 2, m) float64
        Absorptance of light that comes to the front and to the back, 0 … 1; less than `LEAST` is returned as 0.
    """
    # Incident directions: each cosine at `TURNS` azimuths, at one point of each surface
    count, m = table.count, len(cosines)
    rng = np.random.default_rng(0)
    points, normals = (
        np.concatenate(vectors)
        for vectors in zip(*(surface_points(table, k, 1, rng) for k in range(count)), strict=True)
    )
    turns = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    sine = np.sqrt(1 - cosines**2)
    sides = np.array([1.0, -1.0])  # light to the front travels along the normal, which points to the back
    u, v = (np.stack([across(normal)[:, k] for normal in normals]) for k in range(2))
    around = np.cos(turns)[:, None, None] * u + np.sin(turns)[:, None, None] * v  # (turns, surfaces, 3)
    d = (
        sides[None, :, None, None, None] * cosines[None, None, :, None, None] * normals[:, None, None, None, :]
        + sine[None, None, :, None, None] * around.transpose(1, 0, 2)[:, None, None, :, :]
    ).reshape(-1, 3)
    # Interactions on the device, all in one launch
    number = np.repeat(np.arange(count), 2 * m * TURNS)
    p, normal = table.upload_points(points[number]), None
    if table.mitsuba_scene is not None:
        normal = mi.Vector3f(*(upload(mi.Float, column) for column in normals[number].T))
    s, along = upload(mi.UInt32, number), mi.Vector3f(*(upload(mi.Float, column) for column in d.T))
    it = interact(table, p, along, s, normal, None, mi.Bool(True))
    # Absorbed shares, averaged over azimuth
    scattering = Scattering(ScatterTables(table, {}))
    absorbed = scattering.budget(s, it, mi.Bool(True)).absorbed if scattering.any else 1 - it.R - it.T
    shares = np.array(absorbed + dr.zeros(mi.Float, len(number)), dtype=np.float64)
    found = np.clip(shares.reshape(count, 2, m, TURNS).mean(axis=3), 0.0, 1.0)
    return np.where(found < LEAST, 0.0, found)


def medium_of(table: SurfaceTable, surface: int, side: int) -> int:
    """
    Return the position in `Optics.media` of the medium on a side of a surface.

    `side` is 0 for the front and 1 for the back. The result is 0 if the material there is not among the media.
    """
    optics = table.optics
    if number := int(optics.declared[surface, side]):
        return number
    material = material_of(table, surface, side)  # an opaque one without a declared material is in air
    return optics.media.index(material) if material in optics.media else 0


def material_of(table: SurfaceTable, surface: int, side: int) -> str:
    """Return the name of the material on a side (0 front, 1 back) of a surface."""
    interface = table.interfaces[surface]
    return str(interface.front if side == FRONT else interface.back).strip()

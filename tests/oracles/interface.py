"""Snell's law, and R and T of unpolarised light, whose s and p are averaged anew at every hit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from .geometry import Array, Mask


@dataclass(frozen=True)
class CoatingTable:
    """R and T over wavelength (nm) and angle (rad, in the rarer medium), bilinear; grids (L,), (A,), values (L, A)."""

    wavelength_nm: Array
    angle: Array
    front: Array
    back: Array
    transmittance: Array

    @classmethod
    def read(cls, path: Path) -> CoatingTable:
        """Reads columns wavelength_nm, angle_deg, R, T and optionally R_back; lines that start with # are comments."""
        table = pd.read_csv(path, comment="#").pivot(index="wavelength_nm", columns="angle_deg")
        front, back, t = (table[name].to_numpy() for name in ("R", "R_back" if "R_back" in table else "R", "T"))
        if np.isnan(front).any():
            raise ValueError(f"{path}: its rows do not fill a grid")
        return cls(table.index.to_numpy(float), np.radians(table["R"].columns.to_numpy(float)), front, back, t)

    def evaluate(self, wavelength_nm: float, cos_rarer: Array, from_front: Mask) -> tuple[Array, Array]:
        """R and T, (n,), for the cosine in the rarer medium."""
        if len(self.wavelength_nm) > 1 and not self.wavelength_nm[0] <= wavelength_nm <= self.wavelength_nm[-1]:
            raise ValueError(f"coating table ends before {wavelength_nm} nm")
        angle = np.arccos(np.clip(cos_rarer, 0.0, 1.0))
        front, back, t = (
            np.interp(angle, self.angle, [np.interp(wavelength_nm, self.wavelength_nm, column) for column in values.T])
            for values in (self.front, self.back, self.transmittance)
        )
        return np.where(from_front, front, back), t


@dataclass(frozen=True)
class Interface:
    """Materials on both sides and one coating: bare Fresnel (all None), ideal R and T, or a table."""

    front: str = "air"
    back: str = "air"
    reflectance: float | None = None
    transmittance: float | None = None
    table: CoatingTable | None = None
    mirror: bool = False

    @property
    def opaque(self) -> bool:
        """No transmission at any angle, so the materials do not matter."""
        if self.table is not None:
            return not self.table.transmittance.any()
        return self.reflectance is not None and not self.transmittance


ABSORBER = Interface(reflectance=0.0, transmittance=0.0)


@dataclass(frozen=True)
class Interaction:
    """Outcome of n hits: directions (n, 3), factors (n,); TIR has T = 0 and R = what R + T would have been."""

    normal: Array
    transmitted: Array
    reflected: Array
    reflectance: Array
    transmittance: Array
    tir: Mask
    from_front: Mask


def fresnel_unpolarised(n1: Array, n2: Array, cos_i: Array, cos_t: Array) -> Array:
    """Mean of Rs and Rp of a bare interface between real indices (Born & Wolf 1.5.2)."""
    rs = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    rp = (n2 * cos_i - n1 * cos_t) / (n2 * cos_i + n1 * cos_t)
    return 0.5 * (rs * rs + rp * rp)


def interact(
    interface: Interface, n_front: float, n_back: float, wavelength_nm: float, direction: Array, normal: Array
) -> Interaction:
    """Both daughters of each hit; a ray with direction . normal > 0 comes from the front side."""
    along = np.einsum("ij,ij->i", direction, normal)
    from_front = along > 0
    facing = np.where(from_front, 1.0, -1.0)[:, None] * normal
    cos_i = np.minimum(np.abs(along), 1.0)
    reflected = direction - 2 * along[:, None] * normal
    if interface.opaque:
        if interface.table is not None:
            r, t = interface.table.evaluate(wavelength_nm, cos_i, from_front)
        else:
            r = np.full(len(along), float(interface.reflectance or 0.0))
            t = np.zeros(len(along))
        return Interaction(normal, direction, reflected, r, t, np.zeros(len(along), dtype=bool), from_front)
    n1 = np.where(from_front, n_front, n_back)
    n2 = np.where(from_front, n_back, n_front)
    eta = n1 / n2
    sin2_t = eta**2 * (1 - cos_i**2)
    tir = sin2_t >= 1
    cos_t = np.sqrt(np.maximum(1 - sin2_t, 0.0))
    transmitted = eta[:, None] * direction + (cos_t - eta * cos_i)[:, None] * facing
    transmitted /= np.linalg.norm(transmitted, axis=1, keepdims=True)
    if interface.table is not None:
        r, t = interface.table.evaluate(wavelength_nm, np.where(n1 <= n2, cos_i, cos_t), from_front)
    elif interface.reflectance is not None:
        r = np.full(len(along), interface.reflectance)
        t = np.full(len(along), float(interface.transmittance or 0.0))
    else:
        r = fresnel_unpolarised(n1, n2, cos_i, cos_t)
        t = 1 - r
    r, t = np.where(tir, r + t, r), np.where(tir, 0.0, t)
    return Interaction(normal, transmitted, reflected, r, t, tir, from_front)

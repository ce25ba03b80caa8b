"""What the tracer knows of the derivatives of a metric: by rows of coatings, geometry, indices, tables of scatter."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mistray.trace.scattering import Scattering
    from mistray.trace.surfaces import SurfaceTable

COEFFICIENTS = tuple(f"a{order}" for order in range(4, 21, 2))
# By surface, in its own frame at the vertex: displacement (mm) and rotation (rad) about its axes; curvature (1/mm),
# conic and aspheric coefficients; radius at the vertex (mm) and dr/dz of a cone
SHAPE_COLUMNS = (
    *("x", "y", "z", "tilt_x", "tilt_y", "tilt_z"),
    *("curvature", "conic", *COEFFICIENTS),
    *("r0", "slope"),
)
# Rims: clear radii, half sides of a rectangle, ends of a cone along the axis from the vertex; mm
RIM_COLUMNS = ("outer", "inner", "half_width", "half_height", "z_low", "z_high")
GEOMETRY = (*SHAPE_COLUMNS, *RIM_COLUMNS)
EDGE_WIDTH = 0.05  # usual width of the zones at rims, in units of their radii
MOMENTS = 6  # coefficients of a path: 1, x, y, x², y², x y


@dataclass(frozen=True)
class Wanted:
    """
    Which derivatives are asked for.

    Attributes
    ----------
    rows : bool
        By the rows of the tables of R and T, and by ideal R and T.
    geometry : frozenset of str
        Columns of `GEOMETRY`.
    indices : bool
        By the refractive indices on both sides of every surface.
    scatter : bool
        By the tables of scatter.
    edges : bool
        With what rays gain and lose at rims.
    edge_width : float
        Width of the zone at a rim in which rays are looked at, in units of its radius.
    """

    rows: bool = True
    geometry: frozenset[str] = frozenset()
    indices: bool = False
    scatter: bool = False
    edges: bool = True
    edge_width: float = EDGE_WIDTH

    @property
    def replays(self) -> bool:
        """Whether more than factors of coatings is asked for, so that rays are followed again one by one."""
        return self.moves or self.scatter

    @property
    def moves(self) -> bool:
        """Whether places of hits change, and with them what rays gain and lose at rims."""
        return bool(self.geometry) or self.indices

    @property
    def only_rims(self) -> bool:
        """Whether visibility is all that can change."""
        return self.geometry <= set(RIM_COLUMNS) and not (self.rows or self.indices or self.scatter)


@dataclass(frozen=True)
class HitDerivative:
    """
    Derivative of a metric by the flux of a hit of the detector, as a function of its path and place.

    Attributes
    ----------
    pixel : (maps, height, width) float64 or None
        By the flux in each pixel, 1/W, for one or more groups of paths.
    map_of_path : (paths,) int or None
        Number of the map that a path counts in, -1: in none; None: all hits count in map 0.
    path : (paths, MOMENTS) float64 or None
        For each path, in the order of `Trace.paths`, the coefficients of 1, x, y, x², y², x y (mm, in the detector's
        frame) of the derivative by the flux of a hit at (x, y), 1/W.
    """

    pixel: np.ndarray | None = None
    path: np.ndarray | None = None
    map_of_path: np.ndarray | None = None


@dataclass(frozen=True)
class PathDerivative:
    """
    `HitDerivative.path` and `map_of_path` for one run, by path.

    Attributes
    ----------
    keys : (p,) uint64
        Of the paths, ascending.
    slots : (p,) int
        Their slots in the ledger.
    coefficients : (p, MOMENTS) float64
        By the flux in units of a start ray.
    maps : (p,) int
    """

    keys: np.ndarray
    slots: np.ndarray
    coefficients: np.ndarray
    maps: np.ndarray

    @classmethod
    def of_paths(
        cls, keys: np.ndarray, slots: np.ndarray, coefficients: np.ndarray, maps: np.ndarray
    ) -> PathDerivative:
        """The same with the paths in any order."""
        order = np.argsort(keys)
        return cls(keys[order], slots[order], coefficients[order], maps[order])

    def of(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of some rays by their keys, (n, MOMENTS), and their maps, (n,); 0 and -1 of unknown keys."""
        found, maps = np.zeros((len(keys), MOMENTS)), np.full(len(keys), -1)
        if len(self.keys):
            place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            same = self.keys[place] == keys
            found[same], maps[same] = self.coefficients[place[same]], self.maps[place[same]]
        return found, maps


@dataclass
class RawGradient:
    """
    Derivatives of a metric at one source and wavelength, by batch of start rays.

    Attributes
    ----------
    table : SurfaceTable
    scattering : Scattering
    rows : (BATCHES, rows, CHANNELS) float64 or None
        By the rows of the tables of R and T, see `mistray.trace.adjoint`.
    geometry : (BATCHES, surfaces, len(GEOMETRY)) float64 or None
        With visibility as it is: what rims gain and lose is in `edges`.
    edges : (2, BATCHES, surfaces, len(GEOMETRY)) float64 or None
        Of rims, with the width that was asked for and with half of it.
    indices : (BATCHES, surfaces, 2) float64 or None
        By the real indices in front and behind.
    edge_indices : (2, BATCHES, surfaces, 2) float64 or None
        Their part of `edges`.
    scatter : dict
        Name of an array of `Scattering.arrays` (totals, lobes, ratios, logs) → (BATCHES, size) float64.
    left_out : list of str
        What is not in it.
    seconds : float
        Time it took.
    backward : bool
        Of a trace against the light.
    """

    table: SurfaceTable
    scattering: Scattering
    rows: np.ndarray | None = None
    geometry: np.ndarray | None = None
    edges: np.ndarray | None = None
    indices: np.ndarray | None = None
    edge_indices: np.ndarray | None = None
    scatter: dict[str, np.ndarray] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    seconds: float = 0.0
    backward: bool = False

    def add(self, other: RawGradient) -> None:
        """Add another one, with the same tables and the same parts."""
        for name in ("rows", "geometry", "edges", "indices", "edge_indices"):
            value = getattr(self, name)
            if value is not None:
                value += getattr(other, name)
        for name, values in self.scatter.items():
            values += other.scatter[name]
        self.left_out += [text for text in other.left_out if text not in self.left_out]
        self.seconds += other.seconds

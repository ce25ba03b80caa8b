"""Light over a grid of directions as the rays of one direction find it: sums that are added, saved and continued."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from mistray.execute.sums import Sums
from mistray.recorders.path_sums import PathsByCell
from mistray.recorders.tallies import CUTS, SEGMENTS
from mistray.settings import BATCHES

PATHS = "path_"  # prefix of the names of saved arrays of the paths
FoundByCell = tuple[PathsByCell, np.ndarray, np.ndarray]  # paths, unit and start rays of each cell


@dataclass(frozen=True, eq=False, kw_only=True)
class CellSums(Sums):
    """
    Contributions by class of light and cell, in units of a start ray.

    Attributes
    ----------
    rays : (BATCHES,) or (n, m, BATCHES) float64
        Start rays by batch: of all cells together, or of each cell.
    cells : (CLASS_COUNT, n, m, BATCHES) float64
    largest : (n, m) float64
        Largest contribution of a scattered ray.
    maps : (2, n, m, pixels) float64 or None
        Contributions by pixel of the detector, and the sums of their squares.
    paths : PathsByCell
        Paths that are not in the memory of the device: of rays of another process, or of an earlier run.
    passes : int
    seconds : float
    """

    rays: np.ndarray
    cells: np.ndarray
    largest: np.ndarray
    maps: np.ndarray | None = None
    paths: PathsByCell
    passes: int = 0
    seconds: float = 0.0

    def of_ray(self, unit: np.ndarray) -> np.ndarray:
        """Return the PST_normal of a weight of 1 of one start ray of each cell, (n, m), from that of a mean of 1."""
        return np.divide(unit, self.rays.sum(axis=-1), out=np.zeros(unit.shape), where=self.rays.sum(axis=-1) > 0)

    def by_batch(self, unit: np.ndarray) -> np.ndarray:
        """Return the PST_normal of each class from each batch alone, (CLASS_COUNT, n, m, BATCHES)."""
        return np.asarray(BATCHES * self.of_ray(unit)[..., None] * self.cells)

    def strongest(self, unit: np.ndarray) -> np.ndarray:
        """Return the PST_normal of the strongest scattered ray of each cell, (n, m)."""
        return self.of_ray(unit) * self.largest

    def by_pixel(self, unit: np.ndarray) -> np.ndarray:
        """Return the part of each pixel in the PST_normal of a cell, and its variance, (2, n, m, pixels)."""
        assert self.maps is not None
        # Variance of a sum over start rays: Σ w² - (Σ w)²/n
        (weight, squares), of_ray = self.maps, self.of_ray(unit)[..., None]
        rays = np.maximum(self.rays.sum(axis=-1, keepdims=True), 1)
        return np.stack([of_ray * weight, of_ray**2 * np.maximum(squares - weight**2 / rays, 0)])

    def found(self, unit: np.ndarray, paths: PathsByCell) -> FoundByCell:
        """Return paths, with the PST_normal of the flux of one start ray of each cell, and start rays of each cell."""
        rays = np.broadcast_to(self.rays.sum(axis=-1), unit.shape)
        return paths, self.of_ray(unit).ravel(), rays.ravel()

    def arrays(self, paths: PathsByCell) -> dict[str, np.ndarray]:
        """Return the sums, and the paths with those in the memory of the device, as arrays that can be saved."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        kept = {name: values for name, values in own.items() if isinstance(values, np.ndarray)}
        return kept | {PATHS + name: values for name, values in paths.items()}

    def continued(self, saved: Mapping[str, np.ndarray], passes: int, seconds: float) -> Self:
        """Return the sums of a run, from the result of `arrays`; these are the sums before any ray."""
        own: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        # Arrays that are missing are at zero
        own = {
            name: saved[name].reshape(none.shape) if isinstance(none, np.ndarray) and name in saved else none
            for name, none in own.items()
        }
        return type(self)(**own | {"paths": PathsByCell(under(saved, PATHS)), "passes": passes, "seconds": seconds})


@dataclass(frozen=True, eq=False, kw_only=True)
class WaveSums(CellSums):
    """
    Sums of forward rays, each of which starts from a cell.

    Attributes
    ----------
    segments : (n, m) float64
        Numbers of ray segments.
    """

    segments: np.ndarray

    def arrays(self, paths: PathsByCell) -> dict[str, np.ndarray]:
        """See `CellSums.arrays`; the start rays are those of all batches."""
        return super().arrays(paths) | {"rays": self.rays.sum(axis=-1)}

    def continued(self, saved: Mapping[str, np.ndarray], passes: int, seconds: float) -> Self:
        """See `CellSums.continued`."""
        rays = np.repeat(saved["rays"] / BATCHES, BATCHES)
        return super().continued({**saved, "rays": rays}, passes, seconds)


@dataclass(frozen=True, eq=False, kw_only=True)
class BackwardSums(CellSums):
    """
    Sums of backward rays, which may leave through any cell.

    Attributes
    ----------
    elsewhere : (BATCHES,) float64
        Light that leaves outside of all cells.
    surfaces, media, channels : (…, BATCHES) float64
        See `mistray.recorders.tallies`.
    """

    elsewhere: np.ndarray
    surfaces: np.ndarray
    media: np.ndarray
    channels: np.ndarray

    @property
    def segments(self) -> float:
        """Number of ray segments that have been traced."""
        return float(self.channels[SEGMENTS].sum())

    @property
    def lost(self) -> np.ndarray:
        """Weight by batch, (BATCHES,), that limits and thresholds cut, and the net loss by random choices."""
        return np.asarray(self.channels[list(CUTS.values())].sum(axis=0))


def under(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}

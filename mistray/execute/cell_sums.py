"""Sums of light by cell of a grid of directions, by forward or backward rays, which are added, saved, continued."""

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
FoundByCell = tuple[PathsByCell, np.ndarray]  # result of `CellSums.found`


@dataclass(frozen=True, eq=False, kw_only=True)
class CellSums(Sums):
    """
    Sums of contributions to the detector by class of light, cell and batch, in units of a start ray's flux.

    PST_normal is the irradiance on the detector per irradiance of a plane wave across its own direction. The `unit`
    that methods take, (n, m), is the PST_normal of each cell per unit mean weight of the start rays.

    Attributes
    ----------
    rays : (BATCHES,) or (n, m, BATCHES) float64
        Start rays by batch: of all cells together, or of each cell.
    cells : (CLASS_COUNT, n, m, BATCHES) float64
        Sums of throughput times MIS weight.
    largest : (n, m) float64
        Largest contribution of a scattered ray.
    maps : (2, n, m, pixels) float64 or None
        Contributions by pixel of the detector, and the sums of their squares; None: there are no maps.
    paths : PathsByCell
        Paths that are not in the memory of the device: of rays of another process, or of an earlier run.
    passes : int
        Number of passes that have been traced.
    seconds : float
        Time in which they were traced, s.
    """

    rays: np.ndarray
    cells: np.ndarray
    largest: np.ndarray
    maps: np.ndarray | None = None
    paths: PathsByCell
    passes: int = 0
    seconds: float = 0.0

    def of_ray(self, unit: np.ndarray) -> np.ndarray:
        """Return PST_normal per unit weight of one start ray, (n, m); `unit` is that per unit mean weight."""
        rays = self.rays.sum(axis=-1)
        return np.divide(unit, rays, out=np.zeros(unit.shape), where=rays > 0)

    def by_batch(self, unit: np.ndarray) -> np.ndarray:
        """Return PST_normal as estimated from each batch alone, by class of light, (CLASS_COUNT, n, m, BATCHES)."""
        return np.asarray(BATCHES * self.of_ray(unit)[..., None] * self.cells)

    def strongest(self, unit: np.ndarray) -> np.ndarray:
        """Return the largest contribution of one scattered ray to the PST_normal of each cell, (n, m)."""
        return self.of_ray(unit) * self.largest

    def by_pixel(self, unit: np.ndarray, unscattered: np.ndarray | None = None) -> np.ndarray:
        """
        Return each pixel's contribution to the PST_normal of a cell, and its variance, (2, n, m, pixels).

        `unscattered` is the number of additional rays for unscattered light per start ray of each cell, (c,); None:
        there are none.
        """
        assert self.maps is not None
        # Variance of a sum over start rays: Σ w² - (Σ w)²/n. Of two kinds of rays it is at most that of all together
        (weight, squares), of_ray = self.maps, self.of_ray(unit)[..., None]
        rays = np.maximum(self.rays.sum(axis=-1, keepdims=True), 1)
        if unscattered is not None:
            rays = rays * (1 + unscattered.reshape(*unit.shape, 1))
        return np.stack([of_ray * weight, of_ray**2 * np.maximum(squares - weight**2 / rays, 0)])

    def found(self, unit: np.ndarray, paths: PathsByCell) -> FoundByCell:
        """Return paths, and PST_normal per unit weight of a start ray by cell, (c,)."""
        return paths, self.of_ray(unit).ravel()

    def arrays(self, paths: PathsByCell) -> dict[str, np.ndarray]:
        """Return the sums and `paths`, which may still be in device memory, as named arrays to be saved."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        kept = {name: values for name, values in own.items() if isinstance(values, np.ndarray)}
        return kept | {PATHS + name: values for name, values in paths.items()}

    def continued(self, saved: Mapping[str, np.ndarray], passes: int, seconds: float) -> Self:
        """
        Return the sums of light by cell as they were when a run saved their `arrays`.

        This object, still without rays, gives the shapes. Arrays that were not saved are those of this object, which
        are 0. `seconds` is the time that these sums took, s.
        """
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
    Sums of contributions of forward rays, by class of light and by the cell that each ray starts from.

    Attributes
    ----------
    segments : (n, m) float64
        Number of ray segments of the start rays of each cell.
    """

    segments: np.ndarray

    def arrays(self, paths: PathsByCell) -> dict[str, np.ndarray]:
        """Return the sums and `paths` as named arrays that can be saved; start rays are summed over batches, (n, m)."""
        return super().arrays(paths) | {"rays": self.rays.sum(axis=-1)}

    def continued(self, saved: Mapping[str, np.ndarray], passes: int, seconds: float) -> Self:
        """Return sums restored from saved `arrays`, with the start rays divided equally among batches."""
        rays = np.repeat(saved["rays"] / BATCHES, BATCHES)
        return super().continued({**saved, "rays": rays}, passes, seconds)


@dataclass(frozen=True, eq=False, kw_only=True)
class BackwardSums(CellSums):
    """
    Sums of contributions of backward rays, by class of light and by the cell that each ray leaves through.

    Attributes
    ----------
    elsewhere : (BATCHES,) float64
        Sum of the throughputs of rays that leave the scene outside all cells, in units of a start ray's flux.
    surfaces, media, channels : (…, BATCHES) float64
        See `mistray.recorders.tallies`.
    """

    elsewhere: np.ndarray
    surfaces: np.ndarray
    media: np.ndarray
    channels: np.ndarray

    @property
    def segments(self) -> float:
        """Number of ray segments traced so far, at all wavelengths."""
        return float(self.channels[SEGMENTS].sum())

    @property
    def lost(self) -> np.ndarray:
        """Weight that limits and thresholds cut, and net loss by roulette and scatter sampling, by batch (BATCHES,)."""
        return np.asarray(self.channels[list(CUTS.values())].sum(axis=0))


def under(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}

"""Paths found in a run of a PST by forward and backward rays, merged into one table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.events import ABSORBED, event_of
from mistray.execute.cell_sums import FoundByCell
from mistray.execute.grid_trace import GridTrace
from mistray.recorders.path_events import Events, describe_events
from mistray.recorders.path_key import joined_lists
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES

if TYPE_CHECKING:
    import pandas as pd

PATHS_LISTED = 200  # strongest paths of a cell
ONE_SIDED_LISTED = 40  # paths that one direction alone has found
LEAST_REPORTED = 1e-3  # share of a cell's light that such a path must have to be listed
FEWEST_HITS = 8  # least number of hits of such a path


def forward_events(events: np.ndarray, lengths: np.ndarray, detector: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return event lists of backward rays in forward order, with absorption in the detector at the end, and their lengths.

    `events`, (w, k) uint32, and `lengths`, (w,), become (w, k + 1), padded with 0, and (w,). `detector` is the surface
    index of the detector.
    """
    order = lengths[:, None] - 1 - np.arange(events.shape[1] + 1)
    turned = np.take_along_axis(np.pad(events, ((0, 0), (0, 1))), np.maximum(order, 0), axis=1)
    turned = np.where(order >= 0, turned, 0).astype(np.uint32)
    turned[np.arange(len(turned)), lengths] = event_of(detector, ABSORBED)
    return turned, lengths + 1


@dataclass(frozen=True)
class FoundPaths:
    """
    PST_normal by path and cell of directions, by batch, and the number of rays.

    Attributes
    ----------
    trace : GridTrace
        Trace that found the paths; of two, either one.
    events : (w, k) uint32
    lengths : (w,) int
        Events of the paths in forward order, and the number of events of each.
    path, cell : (p,) int
        Pairs of a path and a cell of directions.
    hits : (2, p) float64
        Numbers of forward and of backward rays that found them.
    by_batch : (p, BATCHES) float64
        Contributions of the batches of start rays to the PST_normal of each pair.
    """

    trace: GridTrace
    events: np.ndarray
    lengths: np.ndarray
    path: np.ndarray
    cell: np.ndarray
    hits: np.ndarray
    by_batch: np.ndarray

    @classmethod
    def of(cls, trace: GridTrace, along: FoundByCell | None, against: FoundByCell | None = None) -> FoundPaths:
        """
        Return one table of the paths that forward and backward rays have found, merged by path and cell.

        Parameters
        ----------
        trace : GridTrace
            Either of their traces.
        along, against : tuple or None
            Result of `found` of `AllCells` and of `CellSums`: path table of forward and of backward rays, and
            PST_normal per unit weight of a start ray by cell, (c,); None: there are no such rays.
        """
        tables: list[tuple[int, dict[str, np.ndarray], np.ndarray]] = []
        if along is not None and along[0]:
            tables.append((0, *along))
        if against is not None and against[0]:
            reverse, unit = against
            events, lengths = forward_events(reverse["events"], reverse["lengths"], trace.table.detector)
            tables.append((1, {**reverse, "events": events, "lengths": lengths}, unit))
        # Unique paths, and unique pairs of a path and a cell
        events, lengths, place = joined_lists(*((table["events"], table["lengths"]) for _, table, _ in tables))
        first = np.cumsum([0, *(len(table["lengths"]) for _, table, _ in tables)])
        cells = int(np.prod(trace.grid.shape))
        pairs = [
            place[table["path"] + low] * cells + table["cell"]
            for (_, table, _), low in zip(tables, first[:-1], strict=True)
        ]
        known, number = np.unique(np.concatenate(pairs), return_inverse=True)
        numbers = np.split(number, np.cumsum([len(one) for one in pairs])[:-1])
        # Values of both directions add up: they are weighted by MIS
        hits, by_batch = np.zeros((2, len(known))), np.zeros((len(known), BATCHES))
        for (k, table, unit), at in zip(tables, numbers, strict=True):
            hits[k][at] = table["hits"]
            by_batch[at] += unit[table["cell"], None] * table["weight"]
        return cls(trace, events, lengths, known // cells, known % cells, hits, by_batch)

    @property
    def value(self) -> np.ndarray:
        """PST_normal of each pair of a path and a cell, (p,)."""
        return np.asarray(self.by_batch.sum(axis=1))

    def _describe(self, paths: np.ndarray) -> dict[str, np.ndarray]:
        """Return the name, text and kind of some paths, given by index, as the columns of `describe_events`."""
        trace = self.trace
        return describe_events(Events.of(trace.table, trace.design, self.events[paths], self.lengths[paths]))

    def one_sided(self) -> list[dict[str, Any]]:
        """
        Return the strongest paths found by rays of one direction only, forward or backward, one dict each.

        There are at most `ONE_SIDED_LISTED`, each with at least `FEWEST_HITS` rays and more than 0.1 % of the light of
        its cell. Keys: angle_deg, azimuth_deg, events, seen ("forward" or "backward"), rays, pst_normal.
        """
        grid = self.trace.grid
        value = self.value
        light = np.bincount(self.cell, value, int(np.prod(grid.shape)))
        alone = (self.hits.min(axis=0) == 0) & (self.hits.max(axis=0) >= FEWEST_HITS)
        listed = np.flatnonzero(alone & (value > LEAST_REPORTED * light[self.cell]))
        listed = listed[np.argsort(-(value / light[self.cell])[listed], kind="stable")][:ONE_SIDED_LISTED]
        facts = self._describe(self.path[listed])
        angle, azimuth = np.divmod(self.cell[listed], grid.shape[1])
        columns = {
            "angle_deg": grid.field_deg[angle],
            "azimuth_deg": grid.azimuths_deg[azimuth],
            "events": facts["events"],
            "seen": np.where(self.hits[0][listed] > 0, "forward", "backward"),
            "rays": self.hits.max(axis=0)[listed].astype(np.int64),
            "pst_normal": value[listed],
        }
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def rows(self) -> pd.DataFrame:
        """Return the strongest paths of each cell, at most `PATHS_LISTED`, with the columns of `Pst.path_rows`."""
        import pandas as pd

        m = self.trace.grid.shape[1]
        kept = _strongest(self.cell, self.value, PATHS_LISTED)
        used, place = np.unique(self.path[kept], return_inverse=True)
        columns: dict[str, Any] = {"cell": self.cell[kept] // m, "azimuth_cell": self.cell[kept] % m}
        columns |= {name: values[place] for name, values in self._describe(used).items()}
        columns["rays"] = self.hits.sum(axis=0)[kept].astype(np.int64)
        columns["pst_normal"], columns["pst_normal_se"] = Sampled.of(self.by_batch[kept], np.ones(BATCHES)).with_se
        return pd.DataFrame(columns)


def _strongest(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of the largest values within each group, at most `count` per group."""
    order = np.lexsort((-values, group))
    sizes = np.bincount(group) if len(group) else np.zeros(0, dtype=np.int64)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.asarray(order[rank < count])

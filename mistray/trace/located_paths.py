"""Paths of one run with their places in its path ledger, where keys, events and flux sums are stored."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mistray.execute.tracer import Run
from mistray.recorders.path_events import Events


class LocatedPaths(NamedTuple):
    """Paths of one run: for each its `path_id` in the table and its index in the run's ledger, (n,) int each."""

    run: Run
    ids: np.ndarray
    places: np.ndarray

    @property
    def slots(self) -> np.ndarray:
        """Slots of the paths in the ledger, (n,) int."""
        return np.asarray(self.run.paths.slots[self.places])

    @property
    def keys(self) -> np.ndarray:
        """Hash keys of the paths, (n,) uint64; see `mistray.recorders.path_key`."""
        return np.asarray(self.run.paths.keys[self.places])

    @property
    def sums(self) -> np.ndarray:
        """
        Flux sums of the paths by batch, (n, BATCHES, SUMS or STOKES_SUMS), see `mistray.recorders.ledger`.

        Their unit of flux is the flux of a start ray.
        """
        return np.asarray(self.run.paths.sums[self.places])

    @property
    def events(self) -> Events:
        """Event lists of the paths, with names of their surfaces, in the order of `ids`."""
        paths = self.run.paths
        return Events.of(self.run.table, self.run.design, paths.events[self.places], paths.lengths[self.places])

    def ids_of(self, keys: np.ndarray) -> np.ndarray:
        """Return the `path_id` for each of some keys, (n,) uint64, which must be among those of the paths."""
        order = np.argsort(self.keys)
        return self.ids[order][np.searchsorted(self.keys[order], keys)]

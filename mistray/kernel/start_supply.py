"""Start rays for lanes whose trees are complete.

A packet of lanes goes on until the last of them has nothing left. Trees of a PST differ in size by factors of 100,
and most lanes would idle most of the time: two of three in a phone camera, four of five in a baffle. So a lane whose
tree is complete takes the next start ray that no lane has taken yet, until there are none. Each lane keeps to one
batch, so that its sums are those of a batch. A ray has its own random numbers: it does not matter which lane traces
it.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._variant import lanes_of_threads, on_gpu
from mistray.kernel.kernel_scene import KernelScene
from mistray.recorders.start_rays import StartRays, chosen
from mistray.settings import BATCHES, Settings
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.upload import upload

MANY_SURFACES = 4  # that transmit: trees are large then


class StartSupply:
    """
    Start rays, and what a lane knows of each when it has come to the first surface.

    Parameters
    ----------
    start : StartRays
    known : dict
        The variables of the loop there, evaluated; "active" are rays that have met a surface.
    """

    def __init__(self, start: StartRays, known: dict[str, Any]) -> None:
        self._start, self._known = start, known
        rays = np.flatnonzero(np.array(known["active"]))
        batch = np.array(start.batch)
        batch = batch[rays] if len(batch) > 1 else np.broadcast_to(batch, len(rays))
        self._order = upload(mi.UInt32, rays[np.argsort(batch.astype(np.uint8), kind="stable")])
        ends = np.cumsum(np.bincount(batch, minlength=BATCHES))
        self._ends = upload(mi.UInt32, ends)
        self._next = upload(mi.UInt32, np.append(0, ends[:-1]))
        self.any = len(rays) > 0
        self.lanes = max(BATCHES, min(len(rays), lanes_of_threads()))
        self._batch = dr.arange(mi.UInt32, self.lanes) % BATCHES

    @property
    def names(self) -> list[str]:
        """Of the variables of the loop."""
        return list(self._known)

    @staticmethod
    def pays(scene: KernelScene, settings: Settings) -> bool:
        """
        Whether lanes take several rays: where a PST has trees of many sizes.

        The rays of one source have neighbours with trees that are alike for the most part, and small trees are so, too:
        these are faster side by side. A GPU has too many lanes for more than one ray each.
        """
        if on_gpu() or not (scene.backward or scene.opposite is not None):
            return False
        transmitting = np.count_nonzero(np.asarray(scene.table.optics.host_words) & OPAQUE == 0)
        return bool(settings.max_scatters > 1 or transmitting >= MANY_SURFACES)

    def next(self, wanted: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """The numbers of the next rays for the lanes that want one, and whether there is one."""
        place = dr.scatter_inc(self._next, self._batch, wanted)
        found = wanted & (place < dr.gather(mi.UInt32, self._ends, self._batch, wanted))
        return dr.gather(mi.UInt32, self._order, place, found), found

    def start(self, ray: mi.UInt32) -> StartRays:
        """The start rays of the lanes."""
        found = self._start.picked(ray)
        found.batch = self._batch
        return found

    def known(self, name: str, ray: mi.UInt32, active: mi.Bool | bool = True) -> Any:
        """A variable of the loop at the first surface."""
        return chosen(self._known[name], ray, active)

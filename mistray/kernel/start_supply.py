"""Supply of new start rays to lanes whose ray trees are complete.

A packet of lanes runs until the last of them is finished. Trees of a PST differ in size by factors of 100, and most
lanes would idle most of the time: two of three in a phone camera, four of five in a baffle. So a lane whose tree is
complete takes the next start ray that no lane has taken yet, until there are none. Each lane keeps to one batch, so
that its sums are those of a batch. A ray has its own random numbers, so that it does not matter which lane traces it.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._variant import lanes_of_threads, on_gpu
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.pdf_ratios import State
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES, Settings
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.upload import upload

MANY_SURFACES = 4  # number of transmitting surfaces from which on trees are large


class StartSupply:
    """
    Supply of start rays for lanes that have finished a ray tree.

    Parameters
    ----------
    start : StartRays
        Start rays, one per lane.

    Attributes
    ----------
    lanes : int
        Number of lanes.
    """

    def __init__(self, start: StartRays) -> None:
        self._start = start.evaluated()
        batch = np.array(start.batch)
        # Rays by batch, and where each batch begins and ends: lanes of a batch share an atomic counter
        self._order = upload(mi.UInt32, np.argsort(batch.astype(np.uint8), kind="stable"))
        ends = np.cumsum(np.bincount(batch, minlength=BATCHES))
        self._ends = upload(mi.UInt32, ends)
        self._next = upload(mi.UInt32, np.append(0, ends[:-1]))
        self.lanes = max(BATCHES, min(len(batch), lanes_of_threads()))
        self._batch = dr.arange(mi.UInt32, self.lanes) % BATCHES

    @staticmethod
    def pays(scene: KernelScene, settings: Settings) -> bool:
        """
        True if a trace is expected to be faster when each lane takes several start rays in turn.

        Neighbouring rays of one source have similar trees for the most part, as have rays with small trees: these are
        faster side by side. A GPU has too many lanes for more than one ray each.
        """
        if on_gpu() or not (scene.backward or scene.competing is not None):
            return False
        transmitting = np.count_nonzero(np.asarray(scene.table.optics.host_words) & OPAQUE == 0)
        return bool(settings.max_scatters > 1 or transmitting >= MANY_SURFACES)

    def renew(self, state: State, at_start: Callable[[StartRays], State]) -> State:
        """
        Return the loop variables after idle lanes have taken a new start ray; those that find none go inactive.

        `at_start` returns the variables of start rays.
        """
        # The next ray of its batch: a lane that finds it used up stays idle, and the counter may run past the end
        idle = state["idle"]
        place = dr.scatter_inc(self._next, self._batch, idle)
        found = idle & (place < dr.gather(mi.UInt32, self._ends, self._batch, idle))
        ray = dr.gather(mi.UInt32, self._order, place, found)
        fresh = {name: value for name, value in at_start(self.start(ray, found)).items() if name in state}
        fresh |= {"ray": ray, "active": mi.Bool(True)}
        renewed = {name: dr.select(found, value, state[name]) for name, value in fresh.items()}
        return {**state, **renewed, "active": state["active"] & (found | ~idle)}

    def start(self, ray: mi.UInt32, active: mi.Bool | bool = True) -> StartRays:
        """Return the start rays with the given indices, one per lane, each assigned to the batch of its lane."""
        # A lane keeps its batch before it has a ray
        found = self._start.picked(ray, active)
        found.batch = self._batch
        return found

"""Whole branches that arrive at chosen surfaces, or that leave the scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.passing.surface_maps import SurfaceMaps
from mistray.recorders.recorder import Departure, Memory, Visit
from mistray.surfaces.upload import upload


@dataclass
class ElsewhereRecorder(BranchRecorder):
    """
    Append buffer for branches of the ray tree up to each hit of chosen surfaces, or to where rays leave the scene.

    Attributes
    ----------
    surfaces : (s,) bool
        Surfaces whose hits are recorded, whether they absorb light or not.
    departs : bool
        Record rays that leave the scene instead; rays that miss all surfaces have no event and are left out.
    """

    surfaces: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    departs: bool = False

    kernel_by = ("departs",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._chosen = upload(mi.UInt32, self.surfaces.astype(np.uint32))

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record the branches up to hits of the chosen surfaces, whether absorbed or not."""
        if not self.departs:
            here = visit.active & (dr.gather(mi.UInt32, self._chosen, visit.surface, visit.active) != 0)
            self.write(visit, here, mi.Float64(visit.weight))

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Record the branches of rays that leave the scene after at least one event, if `departs`."""
        if self.departs and departure.node is not None:
            self.write(departure, departure.active, mi.Float64(departure.weight), departure.heading)


@dataclass
class CellRecorder(ElsewhereRecorder):
    """
    Append buffer for branches of the ray tree up to each hit of mapped surfaces, with the cells of the hits.

    Attributes
    ----------
    maps : SurfaceMaps
        Maps, attached to the scene.
    cell, batch : (capacity,) mi.UInt32
        Cell in which a hit is summed, and the batch of its start ray.
    absorbed : (capacity,) mi.Float64
        Flux that the surface absorbs, in units of the start ray's.
    """

    maps: SurfaceMaps = field(kw_only=True)

    kernel_by = ("maps",)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Columns beside those of the branches
        self.cell = dr.zeros(mi.UInt32, self.capacity)
        self.batch = dr.zeros(mi.UInt32, self.capacity)
        self.absorbed = dr.zeros(mi.Float64, self.capacity)
        dr.eval(self.cell, self.batch, self.absorbed)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record the branches up to hits of mapped surfaces, with the cell, batch and absorbed flux of each."""
        # The cell is that of the incident flux; what is absorbed has its own
        cell, here = self.maps.cell(visit)
        slot, kept = self.write(visit, here, mi.Float64(visit.weight))
        dr.scatter(self.cell, cell, slot, kept)
        dr.scatter(self.batch, visit.start.batch, slot, kept)
        dr.scatter(self.absorbed, mi.Float64(dr.maximum(visit.absorbed, 0)), slot, kept)

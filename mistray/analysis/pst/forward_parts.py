"""Cells of a forward point source transmittance that other processes trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from mistray.analysis.pst.forward_cells import Cell, ForwardCells
from mistray.trace.by_parts import require_same


class CellPart(NamedTuple):
    """A cell: the arguments of `ForwardCells.cell`."""

    i: int
    j: int
    rays: int
    wanted_error: float | None
    paths: bool


@dataclass(frozen=True, eq=False)
class CellsTask:
    """
    Cells of a grid, for `mistray.trace.workers`.

    Attributes
    ----------
    scene : mi.Scene
    arguments : tuple
        The others of `ForwardCells`.
    arrays : sequence of list of array
        What the kernel reads here, for each wavelength.
    """

    scene: mi.Scene
    arguments: tuple[Any, ...]
    arrays: Sequence[list[np.ndarray]]

    def make(self) -> ForwardCells:
        """The cells at a worker."""
        cells = ForwardCells(self.scene, *self.arguments)
        require_same(self.arrays, cells.kernel_arrays())
        return cells

    def do(self, made: ForwardCells, part: CellPart) -> Cell:
        """Trace a cell."""
        return made.cell(*part)

"""Cells of a forward point source transmittance that other processes trace."""

from __future__ import annotations

from typing import NamedTuple

from mistray.analysis.pst.forward_cells import Cell, ForwardCells
from mistray.execute.by_parts import SceneTask


class CellPart(NamedTuple):
    """A cell: the arguments of `ForwardCells.cell`."""

    i: int
    j: int
    rays: int
    wanted_error: float | None
    paths: bool


class CellsTask(SceneTask):
    """Cells of a grid, for `mistray.execute.workers`."""

    def make(self) -> ForwardCells:
        """The cells at a worker."""
        cells: ForwardCells = self.build(ForwardCells)
        return cells

    def do(self, made: ForwardCells, part: CellPart) -> Cell:
        """Trace a cell."""
        return made.cell(*part)

"""Base class of recorders that sum flux by cell, over all sources and wavelengths of a trace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError, nearest
from mistray.ids import fits
from mistray.ranges import TEXT, Several
from mistray.recorders.film import group_of, groups_of
from mistray.recorders.recorder import Memory, Recorder
from mistray.recorders.sampled import Sampled
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES
from mistray.spectra.cie import luminous_efficacy
from mistray.surfaces.surfaces import SurfaceTable

if TYPE_CHECKING:
    from mistray.kernel.kernel_scene import KernelScene

MM2_PER_M2 = 1e6


def cell_of(place: mi.Float, count: int) -> mi.UInt32:
    """
    Return the index, 0 … count - 1, of the cell at a coordinate in cell widths.

    A coordinate beyond the ends belongs to the end cell.
    """
    return mi.UInt32(dr.clip(mi.Int32(place), 0, count - 1))


class PassingLight(Recorder):
    """
    Base class of recorders that sum flux by cell and, for its noise, by group of batches of start rays.

    Parameters
    ----------
    name : str
        Name in the result.
    cells : int
        Number of cells.

    Attributes
    ----------
    kind, unit : str
        Kind of recorder, and the unit of `image`.
    groups : int
        Number of groups of batches by which the flux of each cell is summed.

    Raises
    ------
    MistrayError
        For a blank name.
    """

    kind: ClassVar[str] = ""
    unit: ClassVar[str] = ""

    def __init__(self, name: str, cells: int) -> None:
        if not name.strip():
            raise MistrayError(f"{type(self).__name__} has the name '{name}'; give it one that is not blank")
        self.name = name
        self.resize(cells)
        self._flux: Sampled | None = None
        self._lumens: Sampled | None = None  # luminous flux, once there is light of several wavelengths
        self._of_nm = math.nan

    def resize(self, cells: int) -> None:
        """Set the number of cells, and choose as many groups of batches as the memory allows."""
        self.cells, self.groups = cells, groups_of(cells)

    def lay_out(self, table: SurfaceTable) -> None:
        """
        Set the number of cells for the surfaces in `table`, and upload the data by which hits find their cells.

        The base class does nothing here; subclasses override it.
        """

    def attach(self, scene: KernelScene) -> None:
        """Begin a trace of one source and wavelength with sums at zero."""
        self.lay_out(scene.table)
        self._nm = scene.table.wavelength_nm
        self._sums = dr.zeros(mi.Float64, self.groups * self.cells)
        self._started = dr.zeros(mi.Float64, BATCHES)
        dr.make_opaque(self._sums, self._started)

    def add(self, start: StartRays, cell: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """Add the flux of rays, in units of a start ray's flux, to the sums of the given cells."""
        group = group_of(start.batch, self.groups)
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, mi.Float64(flux), group * self.cells + cell, active)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Count, by batch, the start rays whose ray trees are complete."""
        dr.scatter_reduce(dr.ReduceOp.Add, self._started, mi.Float64(1), start.batch, active)

    def collect(self, unit: float) -> None:
        """Add the flux of one source and wavelength to the totals, W; `unit` is the flux of a start ray, W."""
        sums = np.array(self._sums).reshape(self.groups, self.cells).T
        started = np.array(self._started).reshape(self.groups, -1).sum(axis=1)
        found = Sampled.of(sums, started).scaled(unit)
        # Luminous flux is summed apart only once the wavelengths differ
        if self._flux is None:
            self._of_nm = self._nm
        elif self._lumens is not None or self._nm != self._of_nm:
            before = self._flux.scaled(luminous_efficacy(self._of_nm)) if self._lumens is None else self._lumens
            self._lumens = before + found.scaled(luminous_efficacy(self._nm))
        self._flux = found if self._flux is None else self._flux + found

    @property
    def power(self) -> tuple[float, float]:
        """Total flux in all cells and its standard error, W."""
        return self.flux.whole

    @property
    def image(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Values of the pixels of the image and their standard errors, (rows, columns) each, in `unit`.

        Each subclass defines its own.
        """
        # Subclasses divide the flux by areas or solid angles
        raise NotImplementedError

    @property
    def image_size(self) -> int:
        """Number of pixels of `image`, which may depend on the surfaces of `lay_out`; in the base class of cells."""
        return self.cells

    @property
    def flux(self) -> Sampled:
        """
        Flux of each cell with its noise, (cells,), W, over all sources and wavelengths so far.

        Raises
        ------
        MistrayError
            If nothing has been traced yet.
        """
        if self._flux is None:
            raise MistrayError(f"'{self.name}' has recorded nothing yet; give it to trace(…, recorders=[…])")
        return self._flux

    @property
    def luminous_flux(self) -> Sampled:
        """Luminous flux of each cell with its noise, (cells,), lm: flux times 683.002 lm/W · V(λ) of its wavelength."""
        flux = self.flux
        return flux.scaled(luminous_efficacy(self._of_nm)) if self._lumens is None else self._lumens


class SurfaceLight(PassingLight):
    """
    Base class of recorders of the flux that meets chosen surfaces.

    Parameters
    ----------
    name : str
        Name in the result.
    surfaces : str or sequence of str
        Patterns of ids of surfaces or of parts; none: the surfaces of `surfaces_by_default`.
    cells : int
        Number of cells before `lay_out` sets it.
    """

    def __init__(self, name: str, surfaces: str | Sequence[str], cells: int) -> None:
        super().__init__(name, cells)
        self._owner = f"{self.kind} '{name}'"
        self.patterns = Several(TEXT, least=0).check("surfaces", surfaces, self._owner)
        self._names: list[tuple[str, str]] = []  # id and part of each

    def surfaces_by_default(self, table: SurfaceTable) -> list[int]:
        """Return the indices of surfaces that are recorded without patterns: all; subclasses may restrict them."""
        return list(table.listed)

    def chosen(self, table: SurfaceTable) -> list[int]:
        """
        Return the indices of the surfaces that match the patterns, in the order of the scene.

        Without patterns they are those of `surfaces_by_default`.

        Raises
        ------
        MistrayError
            For a pattern that matches nothing, or if an earlier trace was of other surfaces.
        """
        known = {*table.ids, *table.parts}
        for pattern in self.patterns:
            if not any(fits(name, pattern) for name in known):
                raise MistrayError(
                    f"{self._owner}: no surface or part is called '{pattern}'; {nearest(pattern, known)}"
                )
        pairs = {k: (table.ids[k], table.parts[k]) for k in table.listed}
        found = [k for k, pair in pairs.items() if any(fits(name, one) for name in pair for one in self.patterns)]
        found = found if self.patterns else self.surfaces_by_default(table)
        names = [pairs[k] for k in found]
        if self._flux is not None and names != self._names:
            raise MistrayError(f"{self._owner} has recorded another scene; give each scene a recorder of its own")
        self._names = names
        return found

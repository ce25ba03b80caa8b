"""Derivatives of a metric with respect to data of the kernel: coating rows, geometry, indices, scatter tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mistray.gradients.full.full_rims import FullRims
from mistray.kernel.scattering import Scattering
from mistray.surfaces.gradient_columns import RIM_COLUMNS
from mistray.surfaces.surfaces import SurfaceTable


@dataclass(frozen=True)
class GradientRequest:
    """
    Request for derivatives of a metric: the quantities to differentiate, and the boundary zones along rims.

    Attributes
    ----------
    rows : bool
        Whether derivatives with respect to the rows of the tables of R and T, and to ideal R and T, are requested.
    geometry : frozenset of str
        Columns of `GEOMETRY` with respect to which derivatives are requested.
    indices : bool
        Whether derivatives with respect to the refractive indices on both sides of every surface are requested.
    scatter : bool
        Whether derivatives with respect to the entries of the scatter tables are requested.
    sources : frozenset of str
        Names of the parameters of sources with respect to which derivatives are requested.
    edge_widths : tuple of float
        Widths of the zones along rims, in units of the rims' radii, the widest first. If it is empty, there are no
        boundary terms.
    edge_samples : int
        Number of further samples of start rays, each of as many rays as the trace, over which boundary terms of rims
        are summed; nothing else is then accumulated. With 0 the rays of the trace itself are used, for all derivatives.
    """

    rows: bool = True
    geometry: frozenset[str] = frozenset()
    indices: bool = False
    scatter: bool = False
    sources: frozenset[str] = frozenset()
    edge_widths: tuple[float, ...] = ()
    edge_samples: int = 0

    @property
    def replays(self) -> bool:
        """True if derivatives beyond those of coatings are requested, for which rays are recorded and replayed."""
        # Coatings alone take an adjoint trace: their factors leave the paths in place
        return self.moves or self.scatter

    @property
    def moves(self) -> bool:
        """True if a requested parameter moves hits or rims, so that rims contribute boundary terms."""
        return bool(self.geometry or self.indices or self.sources)

    @property
    def only_rims(self) -> bool:
        """True if only boundary terms of rims are requested, or if all other derivatives are certain to be 0."""
        # A rim moves no hit: paths need no replay
        return self.edge_samples > 0 or (
            self.geometry <= set(RIM_COLUMNS) and not (self.rows or self.indices or self.scatter or self.sources)
        )


@dataclass
class Derivatives:
    """
    Derivatives of a metric with respect to the properties of a scene, by batch of start rays.

    They are in the metric's unit per unit of the property; None or empty: not requested.

    Attributes
    ----------
    rows : (BATCHES, rows, CHANNELS) float64 or None
        Derivatives with respect to the rows of the tables of R and T, see `mistray.recorders.adjoint`.
    geometry : (BATCHES, surfaces, len(GEOMETRY)) float64 or None
        Derivatives with respect to the columns of `GEOMETRY`, in their units.
    indices : (BATCHES, surfaces, 2) float64 or None
        Derivatives with respect to the real indices in front and behind.
    scatter : dict
        Name of an array of `Scattering.arrays` (totals, lobes, ratios, logs) → (BATCHES, size) float64.
    sources : list of (mi.Emitter, str, (BATCHES,) float64)
        Derivatives with respect to the parameters of sources: emitter, name of the parameter, derivatives.
    """

    rows: np.ndarray | None = None
    geometry: np.ndarray | None = None
    indices: np.ndarray | None = None
    scatter: dict[str, np.ndarray] = field(default_factory=dict)
    sources: list[tuple[Any, str, np.ndarray]] = field(default_factory=list)

    @classmethod
    def stacked(cls, parts: Sequence[Derivatives]) -> Derivatives:
        """
        Return derivatives with respect to geometry, indices and sources, stacked along a new first axis.

        Each of `parts` is an entry of that axis; rows and scatter tables are left out.
        """
        columns = ([getattr(part, name) for part in parts] for name in ("geometry", "indices"))
        geometry, indices = (np.stack(arrays) if arrays and arrays[0] is not None else None for arrays in columns)
        sources = zip(*(part.sources for part in parts), strict=True)
        by_sources = [(*same[0][:2], np.stack([values for _, _, values in same])) for same in sources]
        return cls(None, geometry, indices, {}, by_sources)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of the derivatives that are present, by name; those with respect to sources are not among them."""
        named = {name: getattr(self, name) for name in ("rows", "geometry", "indices")}
        return {name: values for name, values in named.items() if values is not None} | self.scatter

    def add(self, other: Derivatives) -> None:
        """
        Add the derivatives of another object with the same arrays, in place.

        Derivatives with respect to sources are not added up: their lists are joined.
        """
        for name, values in self.arrays.items():
            values += other.arrays[name]
        self.sources += other.sources


@dataclass
class TableGradient:
    """
    Derivatives of a metric at one source and wavelength, with notes on what they leave out.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces at the wavelength.
    scattering : Scattering
        Scatter of the surfaces.
    inner : Derivatives
        Derivatives with visibility held fixed.
    rims : Derivatives
        Boundary terms of rims; their arrays have a first axis, that of the widths of the zones.
    full : list of FullRims
        Sources whose beam just fills rims, with these rims; empty if there are none.
    left_out : list of str
        Contributions that are left out, in words.
    seconds : float
        Time of the computation, s.
    backward : bool
        Whether the trace was a backward one.
    """

    table: SurfaceTable
    scattering: Scattering
    inner: Derivatives
    rims: Derivatives = field(default_factory=Derivatives)
    full: list[FullRims] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    seconds: float = 0.0
    backward: bool = False

    @property
    def parts(self) -> tuple[tuple[str, ...], ...]:
        """Names of derivative arrays: those with visibility held fixed, then those of boundary terms of rims."""
        return tuple(self.inner.arrays), tuple(self.rims.arrays)

    def add(self, other: TableGradient) -> None:
        """Add the derivatives and notes of another gradient with the same tables and arrays, in place."""
        self.inner.add(other.inner)
        self.rims.add(other.rims)
        self.full += other.full
        # A note is kept once
        self.left_out += [text for text in other.left_out if text not in self.left_out]
        self.seconds += other.seconds

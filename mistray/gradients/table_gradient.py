"""Derivatives of a metric by data that the kernel reads: coating rows, geometry, indices, scatter tables."""

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
    Request of derivatives of a metric: by which quantities, and with which boundary zones along rims.

    Attributes
    ----------
    rows : bool
        Whether derivatives with respect to the rows of the tables of R and T, and to ideal R and T, are requested.
    geometry : frozenset of str
        Columns of `GEOMETRY` with respect to which derivatives are requested.
    indices : bool
        Whether those with respect to the refractive indices on both sides of every surface are.
    scatter : bool
        Whether those with respect to the entries of the scatter tables are.
    sources : frozenset of str
        Names of the parameters of sources with respect to which derivatives are requested.
    edge_widths : tuple of float
        Widths of the zones along rims, in units of the rims' radii, the widest first. Empty: no boundary terms.
    edge_samples : int
        0: the rays of the trace. More: the sum over so many further samples of as many rays, of which only the
        boundary terms of rims are accumulated.
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
        """True if only boundary terms of rims are requested, or nothing else can differ from 0."""
        # A rim moves no hit: paths need no replay
        return self.edge_samples > 0 or (
            self.geometry <= set(RIM_COLUMNS) and not (self.rows or self.indices or self.scatter or self.sources)
        )


@dataclass
class Derivatives:
    """
    Derivatives of a metric with respect to the parameters of a scene, by batch of start rays.

    Attributes
    ----------
    rows : (BATCHES, rows, CHANNELS) float64 or None
        Derivatives by the rows of the tables of R and T, see `mistray.recorders.adjoint`.
    geometry : (BATCHES, surfaces, len(GEOMETRY)) float64 or None
        Derivatives by the columns of `GEOMETRY`, in their units.
    indices : (BATCHES, surfaces, 2) float64 or None
        Derivatives by the real indices in front and behind.
    scatter : dict
        Name of an array of `Scattering.arrays` (totals, lobes, ratios, logs) → (BATCHES, size) float64.
    sources : list of (mi.Emitter, str, (BATCHES,) float64)
        Derivatives by the parameters of sources: owner, name, values.
    """

    rows: np.ndarray | None = None
    geometry: np.ndarray | None = None
    indices: np.ndarray | None = None
    scatter: dict[str, np.ndarray] = field(default_factory=dict)
    sources: list[tuple[Any, str, np.ndarray]] = field(default_factory=list)

    @classmethod
    def stacked(cls, parts: Sequence[Derivatives]) -> Derivatives:
        """Return derivatives by geometry, indices and sources of several parts, stacked along a new first axis."""
        columns = ([getattr(part, name) for part in parts] for name in ("geometry", "indices"))
        geometry, indices = (np.stack(arrays) if arrays and arrays[0] is not None else None for arrays in columns)
        sources = zip(*(part.sources for part in parts), strict=True)
        by_sources = [(*same[0][:2], np.stack([values for _, _, values in same])) for same in sources]
        return cls(None, geometry, indices, {}, by_sources)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of derivatives that are present, by name, those by scatter tables included."""
        named = {name: getattr(self, name) for name in ("rows", "geometry", "indices")}
        return {name: values for name, values in named.items() if values is not None} | self.scatter

    def add(self, other: Derivatives) -> None:
        """Add the derivatives of another object with the same arrays, in place."""
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
        Rims that a beam just fills, where there are any.
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

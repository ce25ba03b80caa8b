"""What the tracer knows of the derivatives of a metric: by rows of coatings, geometry, indices, tables of scatter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from mistray.surfaces.gradient_columns import RIM_COLUMNS

if TYPE_CHECKING:
    from mistray.gradients.full.full_rims import FullRims
    from mistray.gradients.start_motion import SourceDerivative
    from mistray.kernel.scattering import Scattering
    from mistray.surfaces.surfaces import SurfaceTable

ARRAYS = ("rows", "geometry", "edges", "indices", "edge_indices")


@dataclass(frozen=True)
class GradientRequest:
    """
    Which derivatives are requested.

    Attributes
    ----------
    rows : bool
        By the rows of the tables of R and T, and by ideal R and T.
    geometry : frozenset of str
        Columns of `GEOMETRY`.
    indices : bool
        By the refractive indices on both sides of every surface.
    scatter : bool
        By the tables of scatter.
    sources : frozenset of str
        Names of parameters of sources.
    edge_widths : tuple of float
        Widths of the zones at rims in which rays are looked at, in units of their radii, the widest first. None:
        without what rays gain and lose at rims.
    edge_samples : int
        0: the rays of the trace. More: so many further samples of as many rays, of which nothing but what they gain
        and lose at rims is gathered; their sum.
    """

    rows: bool = True
    geometry: frozenset[str] = frozenset()
    indices: bool = False
    scatter: bool = False
    sources: frozenset[str] = frozenset()
    edge_widths: tuple[float, ...] = ()
    edge_samples: int = 0

    def further(self, width: float, samples: int) -> GradientRequest:
        """Of further samples of rays, with zones of a width and half of it."""
        return replace(self, edge_widths=(width, 0.5 * width), edge_samples=samples)

    @property
    def replays(self) -> bool:
        """Whether more than factors of coatings is requested, so that rays are followed again one by one."""
        return self.moves or self.scatter

    @property
    def moves(self) -> bool:
        """Whether places of hits change, and with them what rays gain and lose at rims."""
        return bool(self.geometry or self.indices or self.sources)

    @property
    def only_rims(self) -> bool:
        """Whether visibility is all that can change, or is asked for."""
        return self.edge_samples > 0 or (
            self.geometry <= set(RIM_COLUMNS) and not (self.rows or self.indices or self.scatter or self.sources)
        )


@dataclass
class TableGradient:
    """
    Derivatives of a metric at one source and wavelength, by batch of start rays.

    Attributes
    ----------
    table : SurfaceTable
    scattering : Scattering
    rows : (BATCHES, rows, CHANNELS) float64 or None
        By the rows of the tables of R and T, see `mistray.recorders.adjoint`.
    geometry : (BATCHES, surfaces, len(GEOMETRY)) float64 or None
        With visibility as it is: what rims gain and lose is in `edges`.
    edges : (w, BATCHES, surfaces, len(GEOMETRY)) float64 or None
        Of rims, for each width of the zones.
    indices : (BATCHES, surfaces, 2) float64 or None
        By the real indices in front and behind.
    edge_indices : (w, BATCHES, surfaces, 2) float64 or None
        Their part of `edges`.
    scatter : dict
        Name of an array of `Scattering.arrays` (totals, lobes, ratios, logs) → (BATCHES, size) float64.
    sources : list of SourceDerivative
        By the parameters of sources.
    full : list of FullRims
        Rims that a beam just fills, where there are any.
    left_out : list of str
        What is not in it.
    seconds : float
        Time it took.
    backward : bool
        Of a backward trace.
    """

    table: SurfaceTable
    scattering: Scattering
    rows: np.ndarray | None = None
    geometry: np.ndarray | None = None
    edges: np.ndarray | None = None
    indices: np.ndarray | None = None
    edge_indices: np.ndarray | None = None
    scatter: dict[str, np.ndarray] = field(default_factory=dict)
    sources: list[SourceDerivative] = field(default_factory=list)
    full: list[FullRims] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    seconds: float = 0.0
    backward: bool = False

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the arrays that there are."""
        return (*(name for name in ARRAYS if getattr(self, name) is not None), *sorted(self.scatter))

    def add(self, other: TableGradient) -> None:
        """Add another one, with the same tables and the same parts."""
        for name in ARRAYS:
            value = getattr(self, name)
            if value is not None:
                value += getattr(other, name)
        for name, values in self.scatter.items():
            values += other.scatter[name]
        self.sources += other.sources
        self.full += other.full
        self.left_out += [text for text in other.left_out if text not in self.left_out]
        self.seconds += other.seconds

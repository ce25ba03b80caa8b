"""Rays at the start of a trace, forward from a source or backward from the detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.sampler import Sampler


def generators(seed: int, lane: mi.UInt32, group: mi.UInt32 | None = None) -> tuple[mi.PCG32, mi.UInt32]:
    """
    Return one random number generator for each lane, and the identifier of its stream.

    Parameters
    ----------
    seed : int
        Seed of the trace.
    lane : mi.UInt32
        Index of each lane, within its group if there are groups.
    group : mi.UInt32, optional
        Group of each lane, whose generators do not depend on the lanes of other groups; None: all are one group.

    Returns
    -------
    rng : mi.PCG32
        Generator of each lane.
    scrambled : mi.UInt32
        Identifier of the stream of each lane's generator, a hash of seed and lane.
    """
    # Streams of PCG32 with neighbouring numbers are correlated: seed and ray number are hashed first
    start = dr.opaque(mi.UInt32, seed % 2**32)
    state, sequence = mi.sample_tea_32(start if group is None else start + group, lane)
    words = [mi.UInt64(state), mi.UInt64(sequence)]
    if group is not None:  # the generator adds the number of the lane
        words = [word - dr.arange(mi.UInt64, dr.width(lane)) for word in words]
    return mi.PCG32(size=dr.width(lane), initstate=words[0], initseq=words[1]), sequence


@dataclass
class StartRays:
    """
    Start rays of a trace, one in each lane: origins, directions, throughputs and random numbers.

    Attributes
    ----------
    lane : mi.UInt32
        Indices of the start rays within the trace.
    batch : mi.UInt32
        Batch of each ray, for standard errors.
    seed : mi.UInt32
        Seed of the random numbers of each ray's tree, see `mistray.recorders.sampler`.
    o, d : mi.Vector3f
        Origins relative to `SurfaceTable.centre` (mm), and unit directions.
    w : mi.Float
        Throughput at the start: 1, or the weight with which the ray was sampled.
    index : mi.UInt32, optional
        Index of each ray in the sequences of these numbers; None: `lane`.
    left : mi.UInt32, optional
        Index of the surface that the rays start on; None: they start on none.
    normal : mi.Vector3f, optional
        Unit normal of that surface at the origins; None: not needed, or no surface.
    pixel : mi.UInt32, optional
        Index of the pixel of the detector that they start from; None: they do not start there.
    cell : mi.UInt32, optional
        Index of the cell of directions that they come from; None: of a trace without cells.
    medium : mi.UInt32, optional
        Position in `Optics.media` of the material that they start in; 0 or None: unknown.
    depth, reflections, scatters : mi.UInt32, optional
        Number of events before, counted reflections, and scatter events (packed, see
        `mistray.recorders.path_key.COUNT_MASK`), for rays that continue from within a tree; None: 0.
    key, path_class : mi.UInt64, mi.UInt32, optional
        Key of these events, and the sum of their hashes for the path class, see
        `mistray.recorders.path_key.mixed_events`; None: there are no events before.
    reference : mi.Float, optional
        Throughput with which such a ray left the source or was scattered last; None: `w`.
    aimed_from : mi.UInt32, optional
        Index of the surface that sent such a ray to a target; `NO_SURFACE` or None: none did.
    run : mi.UInt32, optional
        Hits of one surface in a row before, packed as in `mistray.kernel.branch_limits`; None: there were none.
    at : mi.UInt32, optional
        Index of the surface that a ray has just arrived at, with its origin on it; `NO_SURFACE` or None: it is between
        surfaces.
    scale : mi.Float, optional
        Throughput with which the ray left the source, or the detector: the unit of `Settings.flux_threshold`; None: 1.
    place : list of mi.Float, optional
        Point of the start ray in the unit cube of its cell, see `mistray.sampling.plane_wave.wave_rays`; None: of a
        trace without cells.
    stokes : mi.Vector3f, optional
        (q, u, v) of polarised light with respect to the axes of `mistray.kernel.polarization`; None: unpolarised.
    """

    lane: mi.UInt32
    batch: mi.UInt32
    seed: mi.UInt32
    o: mi.Vector3f
    d: mi.Vector3f
    w: mi.Float
    _: KW_ONLY
    index: mi.UInt32 | None = None
    left: mi.UInt32 | None = None
    normal: mi.Vector3f | None = None
    pixel: mi.UInt32 | None = None
    cell: mi.UInt32 | None = None
    medium: mi.UInt32 | None = None
    depth: mi.UInt32 | None = None
    reflections: mi.UInt32 | None = None
    scatters: mi.UInt32 | None = None
    key: mi.UInt64 | None = None
    path_class: mi.UInt32 | None = None
    reference: mi.Float | None = None
    aimed_from: mi.UInt32 | None = None
    run: mi.UInt32 | None = None
    at: mi.UInt32 | None = None
    scale: mi.Float | None = None
    place: list[mi.Float] | None = None
    stokes: mi.Vector3f | None = None

    @property
    def weights(self) -> np.ndarray:
        """Throughputs at the start on the host, (n,) float64."""
        # Of a copy: a literal stays one, so that a compiled kernel can be reused
        return np.array(mi.Float(self.w), dtype=np.float64)

    def given(self, name: str, otherwise: Any) -> Any:
        """Return an optional attribute by its name, or the default `otherwise` if it is None."""
        value = getattr(self, name)
        return otherwise if value is None else value

    def sampler(self, seed: mi.UInt32) -> Sampler:
        """Return the random numbers of the rays at nodes of their trees that have the given seeds."""
        return Sampler(self.given("index", self.lane), seed)

    def picked(self, index: mi.UInt32, active: mi.Bool | bool = True) -> StartRays:
        """
        Return the start rays at some indices; those of inactive lanes have no meaning.

        Literal constants stay literal, so that a compiled kernel can be reused.
        """
        return self._mapped(lambda value: dr.gather(type(value), value, index, active), dr.width(index))

    def with_new_literals(self) -> StartRays:
        """
        Return these start rays with literal constants made anew.

        Dr.Jit orders the code of a kernel by when its constants were made: those of rays that are traced a second time,
        with more room for what is recorded, would make another kernel.
        """
        return self._mapped(lambda value: value)

    def _mapped(self, change: Callable[[Any], Any], width: int | None = None) -> StartRays:
        return StartRays(**{f.name: _mapped(getattr(self, f.name), change, width) for f in fields(self)})

    def take(self, index: mi.UInt32) -> StartRays:
        """Return the start rays at some indices, evaluated in device memory."""
        return self.picked(index).evaluated()

    def evaluated(self) -> StartRays:
        """Return these start rays, whose arrays it evaluates in device memory."""
        dr.eval(*(getattr(self, f.name) for f in fields(self)))
        return self


def _mapped(value: Any, change: Callable[[Any], Any], width: int | None) -> Any:
    """
    Return an array, or each array of a vector or list, after `change`; None for None.

    A literal constant is made anew instead, with `width` entries; None: with as many as it has.
    """
    if value is None:
        return None
    if isinstance(value, list):
        return [_mapped(one, change, width) for one in value]
    if dr.depth_v(value) > 1:
        return type(value)(*(_mapped(one, change, width) for one in value))
    # A changed literal would be a variable, and its kernel another one
    if value.state == dr.VarState.Literal:
        return dr.full(type(value), value[0], dr.width(value) if width is None else width)
    return change(value)

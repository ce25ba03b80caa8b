"""Rays at the start of a trace, with the light from a source or against it from the detector."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class StartRays:
    """
    Rays as they leave a source.

    Attributes
    ----------
    lane : mi.UInt32
        Numbers of the start rays within the trace.
    batch : mi.UInt32
        Batch of each ray, for standard errors.
    rng : mi.PCG32
        One generator a lane.
    o, d : mi.Vector3f
        Origins (mm) and unit directions.
    w : mi.Float
        Weights; 1 from a source.
    left : mi.UInt32, optional
        Surface that the rays start on.
    normal : mi.Vector3f, optional
        Its normal at the origins.
    pixel : mi.UInt32, optional
        Pixel of the detector that they start from.
    medium : mi.UInt32, optional
        Number of the material that they start in; 0 is not known.
    """

    lane: mi.UInt32
    batch: mi.UInt32
    rng: mi.PCG32
    o: mi.Vector3f
    d: mi.Vector3f
    w: mi.Float
    left: mi.UInt32 | None = None
    normal: mi.Vector3f | None = None
    pixel: mi.UInt32 | None = None
    medium: mi.UInt32 | None = None

    def take(self, index: mi.UInt32) -> StartRays:
        """Some of the rays of a source."""
        rng = mi.PCG32()
        rng.state, rng.inc = (dr.gather(mi.UInt64, v, index) for v in (self.rng.state, self.rng.inc))
        lane, batch = (dr.gather(mi.UInt32, v, index) for v in (self.lane, self.batch))
        o, d = (dr.gather(mi.Vector3f, v, index) for v in (self.o, self.d))
        w = dr.gather(mi.Float, self.w, index)
        dr.eval(lane, batch, rng, o, d, w)
        return StartRays(lane, batch, rng, o, d, w)

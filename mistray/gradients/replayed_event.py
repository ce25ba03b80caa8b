"""Events of recorded rays as the replay sees them, and hits at which they are differentiated."""

from __future__ import annotations

from dataclasses import dataclass, field

import mitsuba as mi

from mistray.gradients.scatter_replay import ScatterEvent


@dataclass(kw_only=True)
class ReplayedEvent(ScatterEvent):
    """
    Events of recorded paths, differentiable, in float32 or float64.

    Vectors are in the frames of the surfaces, except for `p` and `heading`.

    Attributes
    ----------
    q : mi.Vector3d
        Point in the frame of the surface, mm.
    active : mi.Bool
        Lanes that have an event.
    length : mi.Float64
        Length of the segment that led to the hit, mm.
    turn : mi.Vector3d
        Rotation vector of the frame (rad): its value is 0, but it carries derivatives.
    p : mi.Vector3d
        Point in the world, mm, relative to the centre of the scene.
    scattered : mi.Bool
        Whether the surface scatters the light.
    heading : mi.Vector3d
        Unit direction in the world after specular reflection or refraction, also where the surface scatters.
    """

    q: mi.Vector3d
    active: mi.Bool
    length: mi.Float64
    turn: mi.Vector3d
    p: mi.Vector3d
    scattered: mi.Bool
    heading: mi.Vector3d


@dataclass
class Hit:
    """
    Hits of rays on surfaces, in the frames that the surfaces have when they do not move.

    Attributes
    ----------
    x : mi.Vector3d
        Point, mm.
    d : mi.Vector3d
        Unit direction of arrival.
    axis : mi.Vector3d
        Unit normal on the side of transmission.
    length : mi.Float64
        Length of the segment that led to the hit, mm.
    shift, turn : mi.Vector3d
        Displacement, mm, and rotation vector, rad, of the surface.
    from_front : mi.Bool
        Whether the ray arrives from the front.
    """

    x: mi.Vector3d
    d: mi.Vector3d
    axis: mi.Vector3d
    length: mi.Float64
    shift: mi.Vector3d
    turn: mi.Vector3d
    from_front: mi.Bool = field(kw_only=True)

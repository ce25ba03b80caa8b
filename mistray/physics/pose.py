"""Rigid motions: a frame that is displaced and tilted."""

from __future__ import annotations

import math

import numpy as np


def moved(frame: np.ndarray, x: float, y: float, z: float, tilt_x: float, tilt_y: float, tilt_z: float) -> np.ndarray:
    """
    A frame that is displaced along its own axes and then tilted about them.

    frame · T(x, y, z) · Rx(tilt_x) · Ry(tilt_y) · Rz(tilt_z), so that the tilt about z acts on a point first.

    Parameters
    ----------
    frame : (4, 4) float64
        Rigid transform from the frame to the world, mm.
    x, y, z : float
        mm.
    tilt_x, tilt_y, tilt_z : float
        Right-handed, degrees.

    Returns
    -------
    (4, 4) float64
        `frame` itself where all numbers are 0.
    """
    if not any((x, y, z, tilt_x, tilt_y, tilt_z)):
        return frame
    motion = np.eye(4)
    motion[:3, 3] = x, y, z
    for axis, tilt in enumerate((tilt_x, tilt_y, tilt_z)):
        if tilt:
            motion[:3, :3] = motion[:3, :3] @ rotation(axis, tilt)
    return frame @ motion


def rotation(axis: int, degrees: float) -> np.ndarray:
    """Right-handed rotation about the x, y or z axis (0, 1, 2), (3, 3)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result = np.eye(3)
    result[[i, j, i, j], [i, j, j, i]] = c, c, -s, s
    return result

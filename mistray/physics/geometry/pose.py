"""Rigid motions: a frame that is displaced and tilted."""

from __future__ import annotations

import math

import numpy as np

_ROUND_OFF = 1e-12


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


def fixed_angles_deg(turn: np.ndarray) -> tuple[float, float, float]:
    """
    Angles about the fixed axes x, then y, then z that make a rotation Rz Ry Rx; round-off is cleaned to 0.

    Parameters
    ----------
    turn : (3, 3) float64
        Rotation matrix.

    Returns
    -------
    tuple of three float
        Degrees; where the second is ±90° the third is 0.
    """
    y = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.hypot(turn[0, 0], turn[1, 0]) < _ROUND_OFF:
        x, z = math.copysign(1.0, y) * math.atan2(turn[0, 1], turn[1, 1]), 0.0
    else:
        x, z = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    about_x, about_y, about_z = (math.degrees(a) if abs(a) > _ROUND_OFF else 0.0 for a in (x, y, z))
    return about_x, about_y, about_z

"""Rigid motions: displacements and tilts of frames, and rotation matrices."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.ranges import TILT_DEG

_ROUND_OFF = 1e-12
MOST_STRAIN = 1e-5  # scale or shear of a matrix up to which it counts as a rounded rigid motion
ROUNDING = 2e-15  # rounding error of the product of two rotations in float64
SINGLE_RAD = 1e-7  # rounding error of a direction in single precision


def rigid_motion(to_world: npt.ArrayLike, owner: str, remedy: str = "set the size by parameters") -> np.ndarray:
    """
    Return the exactly rigid frame nearest to a given matrix, which may be rounded to single precision.

    The rotation is the orthogonal factor of the polar decomposition R = Q S by Newton-Schulz steps, Q ← Q (3 - QᵀQ)/2:
    N. J. Higham, "Functions of Matrices", SIAM 2008, section 8.3. A matrix that is rigid to the rounding of float64 is
    not changed.

    Parameters
    ----------
    to_world : (4, 4) or 16 float
        Transform from the frame to the world, mm.
    owner : str
        Name of the object that has the frame, for error messages.
    remedy : str
        Advice in place of scaling, for error messages.

    Returns
    -------
    (4, 4) float64
        Rigid transform from the frame to the world, mm.

    Raises
    ------
    MistrayError
        If the matrix scales or shears by more than 1e-5, mirrors, or is not finite.
    """
    matrix = np.array(to_world, dtype=np.float64).reshape(4, 4)
    rotation = matrix[:3, :3]
    strain = rotation.T @ rotation - np.eye(3)
    strain[np.diag_indices(3)] /= 2  # a scale 1 + e is 1 + 2 e there
    if not np.abs(strain).max() <= MOST_STRAIN or np.linalg.det(rotation) < 0:
        raise MistrayError(f"{owner}: to_world scales, shears or mirrors; use a rigid motion and {remedy}")
    while np.abs(excess := rotation.T @ rotation - np.eye(3)).max() > ROUNDING:  # each step squares it
        rotation = rotation @ (np.eye(3) - 0.5 * excess)
    matrix[:3, :3] = rotation
    return matrix


def pointing_error(to_world: npt.ArrayLike) -> float:
    """
    Return the rounding error of the axes of a frame, rad.

    It is 1e-7 if the rotation is in single precision and not made of -1, 0 and 1 only; else 0.
    """
    rotation = np.array(to_world, dtype=np.float64).reshape(4, 4)[:3, :3]
    single = np.array_equal(rotation, rotation.astype(np.float32)) and not np.isin(rotation, (-1.0, 0.0, 1.0)).all()
    return SINGLE_RAD if single else 0.0


def moved(frame: np.ndarray, x: float, y: float, z: float, tilt_x: float, tilt_y: float, tilt_z: float) -> np.ndarray:
    """
    Return a frame displaced along its own axes and then tilted about them: about x, then the new y, then the new z.

    It is frame · T(x, y, z) · Rx(tilt_x) · Ry(tilt_y) · Rz(tilt_z), so that the tilt about z acts on a point first.

    Parameters
    ----------
    frame : (4, 4) float64
        Rigid transform from the frame to the world, mm.
    x, y, z : float
        Displacements along the axes, mm.
    tilt_x, tilt_y, tilt_z : float
        Right-handed rotations about the axes, degrees.

    Returns
    -------
    (4, 4) float64
        Rigid transform, mm; `frame` itself if all displacements and tilts are 0.
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
    """Return the matrix, (3, 3), of a right-handed rotation by an angle in degrees about axis 0, 1 or 2: x, y or z."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result = np.eye(3)
    result[[i, j, i, j], [i, j, j, i]] = c, c, -s, s
    return result


def fixed_turn(angles_deg: Iterable[float]) -> np.ndarray:
    """
    Return the matrix, (3, 3), of right-handed rotations by three angles, degrees, about the fixed x, then y, then z.

    Raise `MistrayError` if one is out of range.
    """
    turn = np.eye(3)
    for axis, angle in enumerate(TILT_DEG.check("angles_deg", angles_deg)):
        turn = rotation(axis, angle) @ turn
    return turn


def fixed_angles_deg(turn: np.ndarray) -> tuple[float, float, float]:
    """
    Return the angles about the fixed axes x, then y, then z that make a rotation Rz Ry Rx; round-off becomes 0.

    Parameters
    ----------
    turn : (3, 3) float64
        Rotation matrix.

    Returns
    -------
    tuple of three float
        Angles in degrees; if the second is ±90°, the third is 0.
    """
    y = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.hypot(turn[0, 0], turn[1, 0]) < _ROUND_OFF:
        x, z = math.copysign(1.0, y) * math.atan2(turn[0, 1], turn[1, 1]), 0.0
    else:
        x, z = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    about_x, about_y, about_z = (math.degrees(a) if abs(a) > _ROUND_OFF else 0.0 for a in (x, y, z))
    return about_x, about_y, about_z

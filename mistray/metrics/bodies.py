"""Bodies: parts made of several surfaces that are displaced and tilted as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mistray.errors import refuse_unknown
from mistray.metrics.parameters import KNOWN, PARALLEL, Parameter
from mistray.physics.geometry.pose import fixed_angles_deg, moved
from mistray.ranges import FINITE, POINT_MM, TILT_DEG, ByName
from mistray.surfaces.gradient_columns import DISPLACEMENT, POSE, ROTATION

ROUND_OFF = 1e-10  # slope of a number below which it counts as 0
STEP_DEG = 1e-3  # step of the central differences of positions, which are smooth and have errors of 1e-15
AMOUNTS = ByName(FINITE, "{'z': 0.1, 'tilt_x': 0.02}")


@dataclass(frozen=True, eq=False)
class Body:
    """
    Mechanical part of several surfaces that can be displaced and tilted as a whole.

    Displacements and tilts of the body are those of all its surfaces together. A tilt by a, b and c degrees rotates it
    about the pivot by Rx(a) Ry(b) Rz(c), from its present position.

    Attributes
    ----------
    part : str
        Name of the part.
    frames : dict of str to (4, 4) float64
        Frames of its surfaces before their own x, y, z and tilts, by the keys of the surfaces.
    start : dict of str to (6,) float64
        Present x, y, z, mm, and tilts, degrees, of its surfaces, by the same keys.
    axes : (3, 3) float64
        Columns: axes of the body in the world; those of its surfaces if these agree, else the world's.
    pivot : (3,) float64
        Point of the world that stays in place in a tilt, mm.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> window = mistray.optimize.bodies(known)["window"]
    >>> window.pivot  # mm
    array([ 0.,  0., 64.])
    >>> window.moved({"z": 0.5})["window_front.z"]
    0.5
    """

    part: str
    frames: dict[str, np.ndarray]
    start: dict[str, np.ndarray]
    axes: np.ndarray
    pivot: np.ndarray

    def about(self, pivot: Sequence[float] | np.ndarray) -> Body:
        """
        Return the body with another pivot, the point about which it tilts.

        Parameters
        ----------
        pivot : (3,) float
            Point of the world, mm.

        Raises
        ------
        MistrayError
            If the pivot is not three finite numbers.
        """
        point = POINT_MM.check("pivot", pivot, f"body '{self.part}'")
        return Body(self.part, self.frames, self.start, self.axes, np.array(point))

    def tilted(self, tilt_deg: Sequence[float] | np.ndarray) -> dict[str, float]:
        """
        Return the changes of all surfaces' positions, mm, and tilts, degrees, when the body is tilted.

        Parameters
        ----------
        tilt_deg : (3,) float
            Right-handed rotations about its axes x, y and z, degrees, see `Body`.

        Returns
        -------
        dict
            Change, mm or degrees, by the key of a parameter, such as "L1_front.tilt_x". A displacement of the body adds
            to these changes, because a surface is displaced along its axes before its own tilts.
        """
        angles = TILT_DEG.check("tilt_deg", tilt_deg, f"body '{self.part}'")
        own, turn = np.eye(4), moved(np.eye(4), 0.0, 0.0, 0.0, *angles)
        own[:3, :3], own[:3, 3] = self.axes, self.pivot
        motion = own @ turn @ np.linalg.inv(own)
        found: dict[str, float] = {}
        for surface, frame in self.frames.items():
            start = self.start[surface]
            there = np.linalg.inv(frame) @ motion @ moved(frame, *start)
            # Rx Ry Rz is the inverse of Rz(-c) Ry(-b) Rx(-a)
            there_deg = -np.array(fixed_angles_deg(there[:3, :3].T))
            # Of the two triples of angles that make a rotation, the one nearest to the present tilts
            ways = np.array([there_deg, 180 + there_deg * (1, -1, 1)])
            turned = min((ways - start[3:] + 180) % 360 - 180, key=np.linalg.norm)
            change = (*(there[:3, 3] - start[:3]), *turned)
            found |= {f"{surface}.{name}": float(value) for name, value in zip(POSE, change, strict=True)}
        return found

    def moved(self, amounts: Mapping[str, float]) -> dict[str, float]:
        """
        Return the changes of the surfaces' positions, mm, and tilts, degrees, when the body is tilted and displaced.

        Parameters
        ----------
        amounts : mapping of str to float
            Displacements "x", "y", "z" along its axes, mm, and tilts "tilt_x", "tilt_y", "tilt_z", degrees; missing
            ones are 0.
        """
        refuse_unknown(AMOUNTS.check("amounts", amounts, f"body '{self.part}'"), POSE, f"body '{self.part}': ")
        found = self.tilted([amounts.get(name, 0.0) for name in ROTATION])
        for name in DISPLACEMENT:
            for key, slope in self.slopes(name).items():
                found[key] += slope * amounts.get(name, 0.0)
        return found

    @property
    def keys(self) -> tuple[str, ...]:
        """Scene keys of the positions and tilts of all surfaces of the body."""
        return tuple(f"{surface}.{name}" for surface in self.frames for name in POSE)

    def slopes(self, name: str) -> dict[str, float]:
        """
        Return the derivatives of the surfaces' positions and tilts with respect to a displacement or tilt of the body.

        Parameters
        ----------
        name : {"x", "y", "z", "tilt_x", "tilt_y", "tilt_z"}
            Displacement or tilt.

        Returns
        -------
        dict
            Change, mm or degrees, per mm or degree of the body, by the key of a parameter. Parameters that do not
            change are left out.

        Raises
        ------
        MistrayError
            If there is no such displacement or tilt.
        """
        refuse_unknown([name], POSE, f"body '{self.part}': ")
        if name in ROTATION:
            step = STEP_DEG * np.eye(3)[ROTATION.index(name)]
            more, less = self.tilted(step), self.tilted(-step)
            found = {key: (more[key] - less[key]) / (2 * STEP_DEG) for key in more}
        else:
            way = self.axes[:, DISPLACEMENT.index(name)]
            found = {
                f"{surface}.{axis}": float(value)
                for surface, frame in self.frames.items()
                for axis, value in zip(DISPLACEMENT, frame[:3, :3].T @ way, strict=True)
            }
        return {key: slope for key, slope in found.items() if abs(slope) > ROUND_OFF}


def bodies(known: Mapping[str, Parameter]) -> dict[str, Body]:
    """
    Return the scene's parts of several surfaces that can be displaced and tilted as a whole, by name.

    Parameters
    ----------
    known : mapping of str to Parameter
        Parameters of the scene, from `parameters`.

    Returns
    -------
    dict
        Bodies by the names of their parts. The pivot is the middle of the box around the vertices of the surfaces.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> list(mistray.optimize.bodies(known))
    ['L1', 'window', 'barrel', 'board']
    """
    owners: dict[str, dict[str, Parameter]] = {}
    for key, p in KNOWN.check("known", known).items():
        if p.kind in ("position", "tilt") and key.endswith(f".{POSE[0]}"):
            surface = key.removesuffix(f".{POSE[0]}")
            if all(f"{surface}.{name}" in known for name in POSE):
                owners.setdefault(p.owner.part, {})[surface] = p
    found = {}
    for part, surfaces in owners.items():
        if len(surfaces) < 2:
            continue
        frames = {surface: np.asarray(p.owner.base) for surface, p in surfaces.items()}
        start = {s: np.array([float(known[f"{s}.{name}"].value[0]) for name in POSE]) for s in surfaces}
        rotations = np.array([frame[:3, :3] for frame in frames.values()])
        axes = rotations[0] if np.ptp(rotations, axis=0).max() <= PARALLEL else np.eye(3)
        vertices = np.array(
            [p.owner.vertex_frame(p.owner.values, p.owner.matrix)[:3, 3] for p in surfaces.values()], dtype=np.float64
        )
        found[part] = Body(part, frames, start, axes, 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    return found

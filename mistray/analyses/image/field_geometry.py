"""Chief rays of a system and their neighbours: image points, exit pupils, image scale and foci."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.sampling.design_path import DesignPath
from mistray.sampling.outlines import outline
from mistray.trace.host.bundle import PointBundle
from mistray.trace.host.design_light import design_light
from mistray.trace.host.stop import PupilStop, Region

Array = npt.NDArray[np.float64]

FIELD_STEP = 1e-4  # of the field, in tangents of an angle or units of the distance of a near object
PUPIL_STEP = 1e-4  # of rays beside the chief ray, in units of the pupil's size
PARALLEL = 1e-9  # turn of a chief ray for a turn of the light, below which the exit pupil lies at infinity


@dataclass(frozen=True)
class ChiefRay:
    """
    Chief ray of a field point at the detector: image point, direction, and exit pupil.

    Attributes
    ----------
    coordinates : (1, 2) float64
        Coordinates of the ray, see `PointBundle`.
    point, direction, normal : (3,) float64
        Point on the detector, mm, unit direction there, and the detector's unit normal on the side that light heads
        for, all in world coordinates.
    by_field : (2, 3) float64
        Derivatives of the point with respect to the field, in its direction and across it: mm per radian by which the
        light of a distant object turns, or per mm by which a near object point moves.
    pupil_distance : float
        Distance from the exit pupil to the detector along the ray, mm, negative if the pupil lies behind the detector;
        ``inf`` if chief rays of neighbouring fields are parallel to it.
    """

    coordinates: Array
    point: Array
    direction: Array
    normal: Array
    by_field: Array
    pupil_distance: float

    @property
    def exit_pupil(self) -> Array | None:
        """Centre of the exit pupil, (3,), mm; None if it lies at infinity."""
        return None if np.isinf(self.pupil_distance) else self.point - self.pupil_distance * self.direction

    def distance_from(self, pupil: Array | None) -> float:
        """
        Return the distance, mm, from an exit pupil to the image point, negative if the pupil lies behind it.

        It is infinite for None, a pupil at infinity.
        """
        if pupil is None:
            return np.inf
        away = self.point - pupil
        return float(np.copysign(np.linalg.norm(away), away @ self.direction))


def chief_ray(path: DesignPath, bundle: PointBundle, region: Region, stop: PupilStop, field: str) -> ChiefRay:
    """
    Return the chief ray of a field with its exit pupil, where chief rays of neighbouring fields cross it.

    The two sections of a field give two crossings. The exit pupil is their mean by least squares: the place where the
    neighbours, one step along the field and one across, come nearest to the ray.

    Raises
    ------
    MistrayError
        If no ray goes through the middle of the stop, or neighbouring chief rays are lost; `field` names the field in
        the message.
    """
    x = stop.chief(path, bundle, region.middle, region.size)
    light = design_light(path, *bundle.rays(x))
    if not np.all(np.isfinite(light.hit)):
        raise MistrayError(
            f"{field}: no ray through the middle of the stop '{stop.name}' reaches the detector's surface; "
            "name another surface as the stop"
        )
    point, d, normal = light.hit[0], light.direction[0], light.normal[0]
    across = np.cross(bundle.along, bundle.axis)
    across = across / np.linalg.norm(across)
    unit = np.linalg.norm(bundle.origin - path.steps[0].point) if bundle.near else 1.0
    step = FIELD_STEP * float(unit)
    points, turns = [], []
    for shift in (bundle.along, across):
        ends = []
        for sign in (1, -1):
            other = bundle.shifted(sign * step * shift)
            ends.append(design_light(path, *other.rays(stop.chief(path, other, x, region.size))))
        points.append((ends[0].hit[0] - ends[1].hit[0]) / (2 * step))
        turns.append((ends[0].direction[0] - ends[1].direction[0]) / (2 * step))
    by_field, by_turn = np.array(points), np.array(turns)
    if not np.all(np.isfinite(by_field)):
        raise MistrayError(f"{field}: chief rays of its neighbours are lost; give a smaller field")
    aside = by_field - (by_field @ d)[:, None] * d
    square = float((by_turn**2).sum())
    far = square * float(unit) ** 2 < PARALLEL**2
    distance = np.inf if far else float((aside * by_turn).sum()) / square
    return ChiefRay(x, point, d, normal if normal @ d > 0 else -normal, by_field, distance)


def image_axes(path: DesignPath, chief: ChiefRay) -> Array:
    """
    Return image axes as columns, (3, 3): x (sagittal) and y (tangential) in the detector's plane, z along the light.

    y is the direction in which the image moves as the field grows, or its opposite, whichever is closer to the y axis
    of the detector; that axis itself if the image does not move. x and y have the handedness of the detector.
    """
    opening = outline(path.table.shapes[path.table.detector])
    z = chief.normal
    frame = np.stack([opening.u / np.linalg.norm(opening.u), opening.v / np.linalg.norm(opening.v)])
    frame = frame - (frame @ z)[:, None] * z
    frame[0] /= np.linalg.norm(frame[0])
    frame[1] -= (frame[1] @ frame[0]) * frame[0]
    frame[1] /= np.linalg.norm(frame[1])
    a, b = frame @ chief.by_field[0]
    if not np.hypot(a, b) > 0:
        a, b = 0.0, 1.0
    if b < -1e-6 * np.hypot(a, b) or (abs(b) <= 1e-6 * np.hypot(a, b) and a < 0):
        a, b = -a, -b
    c, s = b / np.hypot(a, b), a / np.hypot(a, b)
    return np.stack([c * frame[0] - s * frame[1], s * frame[0] + c * frame[1], z], axis=1)


def foci_beside(
    path: DesignPath, bundle: PointBundle, chief: ChiefRay, axes: Array, size: float
) -> tuple[float, float]:
    """
    Return tangential and sagittal foci of rays near the chief ray, mm from the detector along z, positive beyond it.

    They are Coddington's foci, computed from differences of real rays; NaN if the light is afocal. `axes` are those of
    `image_axes`, and `size` is the extent of the light in coordinates of the bundle.
    """
    h = PUPIL_STEP * size
    shifts = h * np.concatenate([np.eye(2), -np.eye(2)])
    light = design_light(path, *bundle.rays(chief.coordinates + shifts))
    hits, slopes = light.hit @ axes, light.direction @ axes
    moved, turned = hits[:2] - hits[2:], slopes[:2] - slopes[2:]
    result = []
    for k in (1, 0):
        # The pair of rays in the plane of this axis: a mix of both differences that turns in it alone
        mix = np.array([turned[1, 1 - k], -turned[0, 1 - k]])
        x, turn = float(mix @ moved[:, k]), mix @ turned
        gamma = float(chief.direction @ axes[:, 2])
        lean = float(chief.direction @ axes[:, k])
        tangent = (turn[k] * gamma - lean * turn[2]) / gamma**2
        result.append(-x / tangent if abs(tangent) > 1e-300 else np.nan)
    return float(result[0]), float(result[1])

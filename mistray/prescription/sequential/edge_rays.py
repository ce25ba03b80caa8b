"""Rays that the aperture and the fields of a sequential lens define, and the surface sizes that follow from them.

Pupil coordinates (px, py) are 1 at the rim. `launch` aims a ray at the paraxial entrance pupil. `edge_rays` aims it so
that it really meets the stop at (px, py) times the stop's radius. If the file requests a telecentric object space, rays
fill the cone about parallel chief rays, and the stop is not used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.prescription.sequential.first_order import SequentialFirstOrder, field_tangents, first_order, stop_place
from mistray.prescription.sequential.rays import passes, to_world, trace
from mistray.prescription.sequential.table import Row, Sequential

Array = npt.NDArray[np.float64]

_RIM = 16
_WITHIN = (0.2, 0.4, 0.6, 0.8, 0.98)
_MOST_FIELDS = 24
_INNER_FIELDS = 9  # of these, for the middle of the beams
_FIELD_STEPS = (0.25, 0.5, 0.75, 1.0)
_AIMING = 12
_AIMED = 1e-9  # of the stop's radius
_MET = 1e-3  # of the stop's radius: a ray that comes so near to its place on the rim stands for it
_PROBE = 1e-4  # of the pupil's radius, for differences


@dataclass(frozen=True)
class EdgeRays:
    """
    Chief and rim rays of a lens at the fields and wavelengths of `edge_rays`, and sizes that follow from them.

    Attributes
    ----------
    data : SequentialFirstOrder
        First-order data of the lens.
    stop_radius : float
        Radius of the stop, mm: the stated one, else that at which the real marginal ray on the axis meets it. If the
        lens is `telecentric`, the largest radius that rays reach there.
    positions, directions : (n_rows, n, 3) float64
        Positions (mm) and directions at each row, as from `mistray.prescription.sequential.rays.trace`; NaN from where
        a surface or a stated aperture stops a ray. If no ray of the rim gets through, apertures stop none.
    world : (n_rows + 1, n, 3) float64
        Positions in the world at which each ray starts, upstream of all surfaces, and meets each row, mm.
    entering : (2, 17, 3) float64
        Point (mm) and direction of the chief ray and the 16 rim rays of the first field, in the world before the first
        row.
    pupils : (k, 2) float64
        Points at which rays from a distant object that meet the rim of the stop cross the plane of the entrance pupil,
        mm. All these fields are included, without vignetting. It is empty for a near object and a pupil at infinity.
    reach : (n_rows,) float64
        Largest distance of a ray from the axis of each row, mm; 0 if no ray arrives.
    chief : (n_rows, 3) float64
        Direction behind each row, in its frame, of the ray through the centre of the stop in the first field.
        Apertures do not stop it.
    within : (n_rows + 1, m, 3) float64
        Positions as in `world`, mm, of rays at the reference wavelength between the chief ray and the rim of up to nine
        fields. Apertures do not stop them.
    weights : (m,) float64
        Relative area of the beam that each ray of `within` represents.
    notes : tuple of str
        Notes on fields whose rays do not all arrive, and on the surfaces that stop them.
    """

    data: SequentialFirstOrder
    stop_radius: float
    positions: Array
    directions: Array
    world: Array
    entering: Array
    pupils: Array
    reach: Array
    chief: Array
    within: Array
    weights: Array
    notes: tuple[str, ...]


def launch(
    lens: Sequential, data: SequentialFirstOrder, field: tuple[float, float] | int, pupil: npt.ArrayLike
) -> tuple[Array, Array]:
    """
    Return start points and directions of rays of one field, aimed at the paraxial entrance pupil.

    Parameters
    ----------
    lens : Sequential
        Lens to be traced.
    data : SequentialFirstOrder
        First-order data of the lens.
    field : int or tuple of two float
        Index of a field of the lens, whose vignetting factors then apply, or coordinates (x, y) in degrees or mm.
    pupil : (n, 2) array_like
        Pupil coordinates, 1 at the rim.

    Returns
    -------
    positions, directions : (n, 3) float64
        Positions in the world, mm, and unit directions.

    Raises
    ------
    MistrayError
        If the fields do not fit the object, see `field_tangents`, or the object lies in the entrance pupil.
    """
    points = np.atleast_2d(np.asarray(pupil, dtype=np.float64))
    if isinstance(field, int):
        points, field = _vignetted(lens, field, points), lens.fields[field]
    return _aimed_at(lens, data, field, points * data.epd / 2)


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def edge_rays(lens: Sequential) -> EdgeRays:
    """
    Return rays through centre and rim of the stop, at the shortest, longest and reference wavelength.

    They belong to all fields, or to the first and the 23 outermost others of more, in the order of the lens.

    Parameters
    ----------
    lens : Sequential
        Lens to trace. Its vignetting factors shrink and shift the rim in the stop.

    Returns
    -------
    EdgeRays
        Rays and the sizes that follow from them.

    Raises
    ------
    MistrayError
        If no ray of any field reaches the image; the message says which surface stops them.
    """
    data = first_order(lens)
    radius = _stop_radius(lens, data)
    angle = np.arange(_RIM) * 2 * math.pi / _RIM
    pupil = np.concatenate([[[0.0, 0.0]], np.stack([np.sin(angle), np.cos(angle)], axis=1)])
    wavelengths = sorted({min(lens.wavelengths_nm), lens.wavelength_nm, max(lens.wavelengths_nm)})
    parts: list[tuple[Array, Array, Array, Array]] = []
    free: list[tuple[Array, Array, Array, Array]] = []  # the same without apertures
    notes: list[str] = []
    chief: Array | None = None
    aimed: dict[int, tuple[Array, Array]] = {}  # at the whole rim of the stop
    numbers = _outer_fields(lens)
    if len(numbers) < len(set(lens.fields)):
        others = f"the {len(numbers) - 1} outermost others"
        notes.append(f"of {len(lens.fields)} fields the first and {others} give sizes and vignetting")
    for number in numbers:
        field = lens.fields[number]
        if lens.telecentric:
            start, heading = launch(lens, data, number, pupil)
        else:
            start, heading = _through_stop(lens, data, radius, field, _vignetted(lens, number, pupil))
        if not lens.vignetting:
            aimed[number] = start[1:], heading[1:]
        for wavelength in wavelengths:
            hits, onward = trace(lens, start, heading, wavelength)
            if chief is None and wavelength == lens.wavelength_nm:
                chief = onward[:, 0].copy()
            free.append((hits.copy(), onward.copy(), start, heading))
            lost = _clip(lens, hits, onward)
            parts.append((hits, onward, start, heading))
            if wavelength == lens.wavelength_nm and lost:
                notes.append(f"field ({field[0]:g}, {field[1]:g}): " + lost)
    if not any(np.any(np.isfinite(part[0][-1, 1:])) for part in parts):
        parts = free
        notes.append("of these no ray of the rim gets through: sizes are those of rays that no aperture stops")
    positions, directions = (np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1))
    start, heading = (np.concatenate([part[k] for part in parts]) for k in (2, 3))
    if chief is None or not np.any(np.isfinite(positions[-1])):
        raise MistrayError(f"lens '{lens.name}': no ray reaches the image; {notes[0] if notes else 'check its fields'}")
    places = to_world(lens, positions)
    upstream = min(0.0, float(np.nanmin(places[..., 2]))) - data.epd
    some = parts[:: len(wavelengths)]
    some = [some[k] for k in sorted({round(k) for k in np.linspace(0, len(some) - 1, _INNER_FIELDS)})]
    inner = [_inner_rays(part[2], part[3]) for part in some]
    inner_start, inner_heading = (np.concatenate([rays[k] for rays in inner]) for k in (0, 1))
    inner_places = to_world(lens, trace(lens, inner_start, inner_heading)[0])
    r = np.hypot(positions[..., 0], positions[..., 1])
    reach = np.where(np.isfinite(r), r, 0.0).max(axis=1)
    if lens.telecentric:
        radius = float(reach[stop_place(lens)])
        notes.append("object space is telecentric: the stop is as wide as the beams of all fields and limits none")
    return EdgeRays(
        data=data,
        stop_radius=radius,
        positions=positions,
        directions=directions,
        world=np.concatenate([_upstream(start, heading, upstream)[None], places]),
        entering=np.array([parts[0][2], parts[0][3]]),
        pupils=_pupils(lens, data, radius, numbers, pupil[1:], aimed),
        reach=reach,
        chief=chief,
        within=np.concatenate([_upstream(inner_start, inner_heading, upstream)[None], inner_places]),
        weights=np.tile(np.repeat(_WITHIN, _RIM), len(some)),
        notes=tuple(notes),
    )


def _pupils(
    lens: Sequential,
    data: SequentialFirstOrder,
    radius: float,
    numbers: list[int],
    rim: Array,
    aimed: Mapping[int, tuple[Array, Array]],
) -> Array:
    """
    Return points (k, 2), mm, at which rays to the stop's rim cross the entrance pupil; see `EdgeRays.pupils`.

    `radius` is that of the stop, mm, and `rim` are pupil coordinates, (n, 2). `numbers` are the indices of the fields.
    `aimed` maps such an index to starts and directions of these rays if they are known.
    """
    if lens.telecentric or not math.isinf(lens.object_distance) or math.isinf(data.entrance_pupil_z):
        return np.zeros((0, 2))
    found = []
    for number in numbers:
        start, heading = aimed.get(number) or _through_stop(lens, data, radius, lens.fields[number], rim)
        met = trace(lens, start, heading)[0][stop_place(lens), :, :2]
        there = np.linalg.norm(met - rim * radius, axis=1) < _MET * radius  # and not lost on the way
        found.append(start[there, :2])
    return np.concatenate(found)


def _inner_rays(start: Array, heading: Array) -> tuple[Array, Array]:
    """
    Return starts, mm, and directions, (n, 3), of rays between the chief ray and the rim rays.

    `start` and `heading` are those of the chief ray, in row 0, and of the rim rays.
    """
    points = np.concatenate([start[0] + share * (start[1:] - start[0]) for share in _WITHIN])
    along = np.concatenate([heading[0] + share * (heading[1:] - heading[0]) for share in _WITHIN])
    return points, along / np.linalg.norm(along, axis=1, keepdims=True)


def _upstream(start: Array, heading: Array, z: float) -> Array:
    """Return the points, (n, 3), mm, at which the straight lines of rays in the world cross the plane at `z`, mm."""
    return start + ((z - start[:, 2]) / heading[:, 2])[:, None] * heading


def _outer_fields(lens: Sequential) -> list[int]:
    """Return the indices of distinct fields, ascending; only the first and the outermost ones if there are too many."""
    places = list({field: k for k, field in reversed(list(enumerate(lens.fields)))}.values())
    chosen = sorted(places, key=lambda k: (k > 0, -math.hypot(*lens.fields[k])))[:_MOST_FIELDS]
    return sorted(chosen)


def _vignetted(lens: Sequential, field: int, pupil: Array) -> Array:
    """Return pupil coordinates (n, 2), 1 at the rim, after the vignetting factors of the field with index `field`."""
    if not lens.vignetting:
        return pupil
    shift_x, shift_y, squeeze_x, squeeze_y = lens.vignetting[field]
    return pupil * (1 - np.array([squeeze_x, squeeze_y])) + np.array([shift_x, shift_y])


def _aimed_at(
    lens: Sequential, data: SequentialFirstOrder, field: tuple[float, float], point: Array
) -> tuple[Array, Array]:
    """
    Return rays of a field, as coordinates in `launch`, aimed at points (n, 2) of the paraxial entrance pupil.

    Points are in mm from its centre; if it is at infinity, they lie in the plane of the first row, relative to the
    chief ray. The results are starts, mm, and unit directions, (n, 3). Raise `MistrayError` if object and entrance
    pupil coincide, or both lie at infinity.
    """
    z = data.entrance_pupil_z  # at infinity, points lie in the plane of the first row, from the chief ray
    if math.isinf(lens.object_distance):
        if math.isinf(z):
            raise MistrayError(
                f"lens '{lens.name}': object and entrance pupil both lie at infinity, so there is no beam; give the "
                "object a distance or move the stop"
            )
        slope_x, slope_y = field_tangents(replace(lens, fields=(field,)), data)[0]
        start = np.column_stack([point, np.full(len(point), z)])
        heading = np.broadcast_to([slope_x, slope_y, 1.0], start.shape)
    else:
        origin = np.array([*_object_point(lens, data, field), -lens.object_distance])
        start = np.broadcast_to(origin, (len(point), 3)).copy()
        if math.isinf(z):
            heading = np.column_stack([point / lens.object_distance, np.ones(len(point))])
        elif abs(z + lens.object_distance) < _AIMED * data.epd:
            raise MistrayError(f"lens '{lens.name}': its object lies in the entrance pupil; move one of them")
        else:
            heading = np.column_stack([point, np.full(len(point), z)]) - origin
            heading *= math.copysign(1.0, z + lens.object_distance)
    return start, heading / np.linalg.norm(heading, axis=1, keepdims=True)


def _object_point(lens: Sequential, data: SequentialFirstOrder, field: tuple[float, float]) -> Array:
    """
    Return the point (x, y), mm, of a field, as coordinates in `launch`, on an object at a finite distance.

    Raise `MistrayError` if the field has no such point because the magnification is 0 or the lens is telecentric.
    """
    if lens.field_kind == "object_height":
        return np.array(field)
    if lens.field_kind == "image_height":
        if data.magnification == 0:
            raise MistrayError(f"lens '{lens.name}': its magnification is 0; give its fields as object heights")
        return np.array(field) / data.magnification
    if math.isinf(data.entrance_pupil_z):
        raise MistrayError(f"lens '{lens.name}': it is telecentric; give its fields as object heights")
    slopes = field_tangents(replace(lens, fields=(field,)), data)[0]
    return -slopes * (lens.object_distance + data.entrance_pupil_z)


def _stop_radius(lens: Sequential, data: SequentialFirstOrder) -> float:
    """
    Return the radius of the stop, mm: the stated one, else that at which the real marginal ray meets it.

    If that ray is lost, the paraxial one counts.
    """
    stop = stop_place(lens)
    row = lens.rows[stop]
    opening = row.aperture.annulus if row.stop and row.aperture else None
    stated = opening[0] if opening else math.inf
    if row.stop and row.semi_diameter_fixed and row.semi_diameter is not None:
        return min(stated, row.semi_diameter)
    if lens.aperture_kind == "stop_diameter":
        return min(stated, lens.aperture / 2)
    hits, _ = trace(lens, *_aimed_at(lens, data, (0.0, 0.0), np.array([[0.0, 0.0], [0.0, data.epd / 2]])))
    centre, rim = hits[stop, :, :2]
    found = float(np.hypot(*(rim - centre)))
    return min(stated, found if np.isfinite(found) and found > 0 else data.stop_radius)


def _through_stop(
    lens: Sequential, data: SequentialFirstOrder, radius: float, field: tuple[float, float], pupil: Array
) -> tuple[Array, Array]:
    """
    Return starts, mm, and directions, (n, 3), of rays of a field that meet the stop at `pupil` times its `radius`, mm.

    `field` has coordinates as in `launch`. Newton's method finds the points in the entrance pupil. If it fails, the
    field grows in steps, because the pupil of a wide-angle lens shifts with it. Rays that do not converge keep their
    last aim, or the paraxial one if that fails too.
    """
    target = pupil * radius
    point, met = _aimed_at_stop(lens, data, field, target, pupil * data.epd / 2)
    if not met:
        point = pupil * data.epd / 2
        for step in _FIELD_STEPS:
            point, _ = _aimed_at_stop(lens, data, (step * field[0], step * field[1]), target, point)
            lost = ~np.isfinite(point[:, 0])
            point[lost] = pupil[lost] * data.epd / 2
    return _aimed_at(lens, data, field, point)


def _aimed_at_stop(
    lens: Sequential, data: SequentialFirstOrder, field: tuple[float, float], target: Array, start: Array
) -> tuple[Array, bool]:
    """
    Return points in the entrance pupil, mm, whose rays meet the stop at `target`, (n, 2), mm, by Newton's method.

    The iteration begins at `start`, (n, 2), mm from the pupil's centre as the results are. The second result says
    whether all converged. If not, points hold their last iterate, NaN where the ray does not reach the stop.
    """
    stop, unit = stop_place(lens), data.epd / 2
    ahead = lens.with_rows([*lens.rows[: stop + 1], Row(0, kind="image")])  # what lies behind the stop aims no ray
    point, probe = start.copy(), unit * _PROBE
    right_by, up_by = np.array([probe, 0.0]), np.array([0.0, probe])
    size = float(np.abs(target).max())
    for _ in range(_AIMING):
        aims = np.concatenate([point, point + right_by, point + up_by])
        hits, _ = trace(ahead, *_aimed_at(lens, data, field, aims))
        here, right, up = hits[stop, :, :2].reshape(3, -1, 2)
        miss = here - target
        if np.all(np.abs(miss) <= _AIMED * size):
            return point, True
        slope = np.stack([(right - here) / probe, (up - here) / probe], axis=2)
        good = np.isfinite(slope).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(slope))) > _AIMED)
        if not np.any(good):
            break
        change = np.linalg.solve(slope[good], miss[good][..., None])[..., 0]
        # No further than a pupil at once: far from it the map is not linear
        length = np.linalg.norm(change, axis=1, keepdims=True)
        point[good] -= change * np.minimum(1.0, unit / np.maximum(length, _AIMED))
    point[~np.isfinite(hits[stop, : len(point), 0])] = np.nan
    return point, False


def _clip(lens: Sequential, hits: Array, onward: Array) -> str:
    """Set rays in `hits` and `onward` to NaN from where an aperture stops them; return a note on losses, else ""."""
    alive = np.ones(hits.shape[1], dtype=bool)
    losses = []
    for k, row in enumerate(lens.rows):
        if row.kind == "coordinate_break":
            continue
        through = passes(row, hits[k])
        lost = int(np.sum(alive & ~through))
        if lost:
            losses.append(f"{lost} at surface {row.number}")
        alive &= through
        hits[k:, ~alive] = np.nan
        onward[k:, ~alive] = np.nan
    if not losses:
        return ""
    return f"of {hits.shape[1]} rays through the centre and the rim of the stop {', '.join(losses)} are lost"

"""Real rays through a sequential lens in float64, surface by surface in the order of the table.

The world is the frame of the first row before its `Decentre`: its origin is the first vertex, light travels along +z.
Rays meet rows in order, at positive or negative distance, whatever lies between, as in lens design programs. If a line
meets a conic at two points, the point on the sheet of the vertex counts. No aperture stops a ray; `passes` finds the
rays that an aperture would stop.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mistray.errors import errors_of
from mistray.materials import refractive_index
from mistray.physics.geometry.pose import fixed_turn, moved
from mistray.physics.geometry.sag import sag, sag_derivative
from mistray.physics.sags import terms as sags
from mistray.prescription.sequential.table import Decentre, Row, Sequential

Array = npt.NDArray[np.float64]

_ITERATIONS = 60
_TOLERANCE = 1e-13  # of the size of the numbers, where a Newton step ends
_ON_SURFACE_MM = 1e-7
_ON_RIM_MM = 1e-6  # rays that touch a rim pass
_STEP = 1e-3  # of the differences that give the slopes of a freeform, in units of its size
_SMALLEST_MM = 1e-6


def frames(lens: Sequential) -> Array:
    """
    Return the frames of all rows of a lens in the world.

    Parameters
    ----------
    lens : Sequential
        Lens in mm and degrees.

    Returns
    -------
    (n_rows, 4, 4) float64
        Rigid transforms from the frame of each row, after its `Decentre`, to the world; mm.
    """
    here, result = np.eye(4), []
    for row in lens.rows:
        own = here if row.decentre is None else here @ motion(row.decentre)
        result.append(own)
        here = here if row.decentre is not None and row.decentre.returns else own
        here = here @ _shift(0.0, 0.0, row.thickness)
    return np.array(result)


def motion(decentre: Decentre) -> Array:
    """Return the rigid transform, (4, 4) in mm, from the frame after a `Decentre` to that before it."""
    shift = (decentre.x, decentre.y, decentre.z)
    if not decentre.tilt_first:
        return moved(np.eye(4), *shift, *decentre.tilt_deg)
    turn = np.eye(4)
    turn[:3, :3] = fixed_turn(decentre.tilt_deg)
    return turn @ _shift(*shift)


def materials_before(lens: Sequential) -> tuple[str, ...]:
    """Return the material string of the medium in front of each row; mirrors and coordinate breaks change none."""
    result = [lens.object_material]
    for row in lens.rows[:-1]:
        result.append(row.material if row.kind == "surface" and not row.mirror else result[-1])
    return tuple(result)


def indices(lens: Sequential, wavelength_nm: float | None = None) -> Array:
    """
    Return the refractive indices in front of each row and behind the last.

    Parameters
    ----------
    lens : Sequential
        Lens with its materials.
    wavelength_nm : float or None
        Wavelength, nm; ``None``: the reference wavelength.

    Returns
    -------
    (n_rows + 1,) float64
        Refractive indices n. Behind a mirror or a coordinate break it is that in front.

    Raises
    ------
    MistrayError
        If a material is unknown at this wavelength; the message names the surface.
    """
    wavelength = lens.wavelength_nm if wavelength_nm is None else wavelength_nm
    result = [refractive_index(lens.object_material, wavelength)]
    for row in lens.rows:
        if row.mirror or row.kind != "surface":
            result.append(result[-1])
            continue
        with errors_of(f"lens '{lens.name}', surface {row.number}"):
            result.append(refractive_index(row.material, wavelength))
    return np.array(result)


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite is lost
def trace(
    lens: Sequential, positions: npt.ArrayLike, directions: npt.ArrayLike, wavelength_nm: float | None = None
) -> tuple[Array, Array]:
    """
    Return positions and directions of real rays at all rows of a lens.

    Parameters
    ----------
    lens : Sequential
        Lens to trace.
    positions : (n, 3) array_like
        Any point of each ray before the first row, in the world, mm.
    directions : (n, 3) array_like
        Direction of each ray in the world; it need not be of unit length.
    wavelength_nm : float or None
        Wavelength, nm; ``None``: the reference wavelength.

    Returns
    -------
    positions, directions : (n_rows, n, 3) float64
        Positions at each row in its own frame (after its `Decentre`), mm, and unit directions behind it. NaN once a ray
        has missed a surface or has been totally reflected, and in rows of kind "coordinate_break", which no ray meets.

    Raises
    ------
    MistrayError
        If a material is unknown at this wavelength.
    """
    index = indices(lens, wavelength_nm)
    point = np.atleast_2d(np.array(positions, dtype=np.float64))
    along = np.atleast_2d(np.array(directions, dtype=np.float64))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    hits, onward = np.full((2, len(lens.rows), *point.shape), np.nan)
    for k, (row, frame) in enumerate(zip(lens.rows, frames(lens), strict=True)):
        if row.kind == "coordinate_break":
            continue
        turn, origin = frame[:3, :3], frame[:3, 3]
        local, heading = (point - origin) @ turn, along @ turn
        local = local + distance(row, local, heading)[:, None] * heading
        if row.kind == "surface":
            heading = _bent(row, local, heading, float(index[k]), float(index[k + 1]))
        heading = np.where(np.isnan(local), np.nan, heading)
        hits[k], onward[k] = local, heading
        point, along = local @ turn.T + origin, heading @ turn.T
    return hits, onward


def to_world(lens: Sequential, positions: Array) -> Array:
    """Return positions at each row, (n_rows, n, 3) as from `trace`, in world coordinates, mm."""
    places = frames(lens)
    return np.einsum("kij,knj->kni", places[:, :3, :3], positions) + places[:, None, :3, 3]


def distance(row: Row, position: Array, direction: Array) -> Array:
    """
    Return the signed distance along rays to the surface of a row.

    Parameters
    ----------
    row : Row
        Row with the figure.
    position, direction : (n, 3) float64
        Positions in the frame of the row, mm, and unit directions.

    Returns
    -------
    (n,) float64
        Distance, mm; NaN if a ray misses the sheet of the vertex, or runs parallel to a plane.
    """
    c, conic = curvature(row), row.conic
    x, y, z = position.T
    u, v, w = direction.T
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        plane = -z / w
        x, y = x + plane * u, y + plane * v
        # From the tangent plane on, so that flat surfaces lose no digits: a s² - 2 b s + c (x² + y²) = 0
        a = c * (1 + conic * w * w)
        b = w - c * (x * u + y * v)
        root = np.sqrt(b * b - a * c * (x * x + y * y))
        step = c * (x * x + y * y) / (b + np.copysign(root, w))
        if row.coefficients or row.sag:
            step = _newton(row, (x, y), direction, np.where(np.isfinite(step), step, 0.0))
        else:
            r2 = (x + step * u) ** 2 + (y + step * v) ** 2
            height = sag(r2, c, conic)
            step = np.where(np.abs(step * w - height) < _ON_SURFACE_MM * (1 + np.abs(height)), step, np.nan)
    result: Array = np.where(np.isfinite(plane + step), plane + step, np.nan)
    return result


def curvature(row: Row) -> float:
    """Return the curvature 1/radius of a row, 1/mm; 0 for a plane."""
    return 0.0 if row.radius == 0 else 1.0 / row.radius


def passes(row: Row, position: Array) -> npt.NDArray[np.bool_]:
    """
    Return a mask of rays that the stated apertures of a row let pass.

    Parameters
    ----------
    row : Row
        Row with its apertures; its ``semi_diameter`` counts only if it is fixed.
    position : (n, 3) float64
        Positions of rays in the frame of the row, mm.

    Returns
    -------
    (n,) bool
        True for rays that pass; False also for NaN.
    """
    x, y = position[:, 0], position[:, 1]
    result = np.isfinite(x)
    if row.semi_diameter_fixed and row.semi_diameter is not None:
        result &= np.hypot(x, y) <= row.semi_diameter + _ON_RIM_MM
    if row.aperture is not None:
        result &= row.aperture.touches(x, y, _ON_RIM_MM)
    if row.obscuration is not None:
        result &= ~row.obscuration.touches(x, y, -_ON_RIM_MM)
    return result


def height_and_slopes(row: Row, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return the sag, mm, and its slopes dz/dx and dz/dy at points x, y, (n,), mm, of a row; NaN where it has none."""
    if row.sag:
        numbers = row.sag_numbers
        size = max(float(np.nanmax(np.hypot(x, y), initial=0.0)), 1e-3 * (row.semi_diameter or 0.0), _SMALLEST_MM)
        return (sags.sag(x, y, numbers), *sags.slopes(x, y, numbers, _STEP * size))
    r2 = x * x + y * y
    d = sag_derivative(r2, curvature(row), row.conic, row.coefficients)
    return sag(r2, curvature(row), row.conic, row.coefficients), 2 * x * d, 2 * y * d


def _newton(row: Row, start: tuple[Array, Array], direction: Array, step: Array) -> Array:
    """
    Return distances along rays from the tangent plane to an asphere, (n,), mm; NaN where Newton's method fails.

    `start` holds x and y of the rays on that plane, mm, in the frame of the row. `step` is the first guess, (n,), mm.
    """
    (x0, y0), (u, v, w) = start, direction.T
    error = np.full_like(step, np.inf)
    for _ in range(_ITERATIONS):
        x, y = x0 + step * u, y0 + step * v
        height, across, along = height_and_slopes(row, x, y)
        change = (step * w - height) / (w - u * across - v * along)
        step = step - change
        error = np.abs(change) / (1 + np.abs(step))
        if not np.any(error > _TOLERANCE):
            break
    result: Array = np.where(error < _ON_SURFACE_MM, step, np.nan)
    return result


def _bent(row: Row, position: Array, direction: Array, before: float, behind: float) -> Array:
    """
    Return the unit directions of rays, (n, 3), after reflection or refraction at a row; NaN at total reflection.

    Positions, mm, and directions are in the frame of the row; `before` and `behind` are the refractive indices.
    """
    x, y = position[:, 0], position[:, 1]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        _, across, along = height_and_slopes(row, x, y)
        normal = np.stack([-across, -along, np.ones_like(x)], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cosine = np.sum(normal * direction, axis=1)
        if row.mirror:
            bent = direction - 2 * cosine[:, None] * normal
        else:
            ratio = before / behind
            root = np.sqrt(1 - ratio * ratio * (1 - cosine * cosine))
            bent = ratio * direction + (np.copysign(root, cosine) - ratio * cosine)[:, None] * normal
        length = np.linalg.norm(bent, axis=1, keepdims=True)
        result: Array = bent / length
    return result


def _shift(x: float, y: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix

"""First-order data of a sequential lens: focal lengths, pupils, and fields.

Tilts and decentres are ignored, as in lens design programs: surfaces stand on one axis at the thicknesses of the table.
A reflection is a refraction into the negative index, see `mistray.physics.imaging.paraxial`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.imaging.paraxial import ParaxialSystem
from mistray.physics.sags.terms import vertex_curvatures
from mistray.prescription.sequential.rays import curvature, indices
from mistray.prescription.sequential.table import Row, Sequential

_STEP = 1e-3  # of the differences that give the curvature of a freeform, in units of its radius
_NONE = 1e-12  # slope per mm of height below which light is taken for collimated, 1/mm


@dataclass(frozen=True)
class SequentialFirstOrder:
    """
    First-order data of a lens at one wavelength: focal lengths, pupils and magnification.

    Attributes
    ----------
    efl : float
        Effective focal length -y/(n'u') with n' positive, mm; positive if a collimated beam is focused, ``inf`` if
        afocal.
    bfl : float
        Back focal length from the last surface to the rear focus, along the direction of light there, mm; ``inf`` if
        afocal.
    f_number : float
        Image-space F-number at infinite conjugates, > 0: the size of efl over epd. It is ``inf`` if object space is
        telecentric, or if afocal.
    epd : float
        Diameter of the entrance pupil, mm. If the pupil lies at infinity, the diameter of the axial beam in the plane
        of the first row.
    entrance_pupil_z : float
        Position of the entrance pupil from the first surface along +z, mm; ``inf`` if object space is telecentric.
    stop_radius : float
        Paraxial radius of the stop, mm.
    stop_number : int
        Number of the stop's surface, as counted by the file.
    magnification : float
        Image height per object height, negative for an inverted image; 0 for an object at infinity.
    wavelength_nm : float
        Wavelength of the data, nm.

    Examples
    --------
    >>> from mistray.prescription.closing.system import build
    >>> from mistray.scenes.cooke_triplet.prescription import build as triplet
    >>> found = build(mistray.prescription.to_sequential(triplet())).first_order
    >>> print(f"f = {found.efl:.2f} mm, f/{found.f_number:.2f}, entrance pupil {found.epd:.2f} mm wide")
    f = 50.00 mm, f/4.00, entrance pupil 12.50 mm wide
    """

    efl: float
    bfl: float
    f_number: float
    epd: float
    entrance_pupil_z: float
    stop_radius: float
    stop_number: int
    magnification: float
    wavelength_nm: float


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def first_order(lens: Sequential, wavelength_nm: float | None = None) -> SequentialFirstOrder:
    """
    Return the first-order data of a lens.

    Parameters
    ----------
    lens : Sequential
        Lens to analyse.
    wavelength_nm : float or None
        Wavelength, nm; ``None``: the reference wavelength.

    Returns
    -------
    SequentialFirstOrder
        Focal lengths, pupils and magnification.

    Raises
    ------
    MistrayError
        If a material is unknown, if the kind of aperture is undefined for the lens, such as an F-number of an afocal
        one, or if values overflow.
    """
    wavelength = lens.wavelength_nm if wavelength_nm is None else wavelength_nm
    system, sign = paraxial_system(lens, wavelength)
    up, down = system.trace(1.0, 0.0), system.trace(0.0, 1.0)
    last = max((k for k, row in enumerate(lens.rows) if row.kind == "surface"), default=0)
    y, u = up[last]
    n = abs(system.index[last + 1])
    afocal = abs(u) < _NONE
    power = -sign[last + 1] * n * u
    efl = math.inf if afocal else 1 / power
    bfl = math.inf if afocal else -y / u * sign[last + 1]
    stop = stop_place(lens)
    from_height, from_slope = up[stop, 0], down[stop, 0]
    pupil_z = math.inf if lens.telecentric or abs(from_height) < _NONE else from_slope / from_height
    if any(math.isnan(value) for value in (efl, bfl, pupil_z)):
        raise MistrayError(f"lens '{lens.name}': its first-order data are not numbers; look for huge values in it")
    epd, stop_radius = _beam(lens, efl, (from_height, from_slope), pupil_z, float(system.index[0]))
    return SequentialFirstOrder(
        efl=float(efl),
        bfl=float(bfl),
        f_number=math.inf if math.isinf(pupil_z) else float(abs(efl) / epd),
        epd=float(epd),
        entrance_pupil_z=float(pupil_z),
        stop_radius=float(stop_radius),
        stop_number=lens.rows[stop].number,
        magnification=_magnification(lens, up, down),
        wavelength_nm=wavelength,
    )


def paraxial_system(lens: Sequential, wavelength_nm: float | None = None) -> tuple[ParaxialSystem, np.ndarray]:
    """
    Return the paraxial system of all rows of a lens, unfolded onto one axis; the image is a plane without power.

    Parameters
    ----------
    lens : Sequential
        Lens with the rows.
    wavelength_nm : float, optional
        Wavelength, nm; by default the reference wavelength.

    Returns
    -------
    system : ParaxialSystem
        System in mm; indices are negative where light travels along -z.
    sign : (n_rows + 1,) float64
        Direction of light along z in front of each row and behind the last, +1 or -1.
    """
    sign = [1.0]
    for row in lens.rows:
        sign.append(-sign[-1] if row.mirror else sign[-1])
    z = np.concatenate([[0.0], np.cumsum([row.thickness for row in lens.rows[:-1]])])
    bends = [_paraxial_curvature(row) if row.kind == "surface" else 0.0 for row in lens.rows]
    return ParaxialSystem(bends, list(z), list(indices(lens, wavelength_nm) * np.array(sign))), np.array(sign)


def _paraxial_curvature(row: Row) -> float:
    """Return the curvature at the vertex of a row, 1/mm; for a freeform that along y, as in lens design programs."""
    if not row.sag:
        return curvature(row)
    return vertex_curvatures(row.sag_numbers, _STEP * (row.semi_diameter or 1.0))[1]


def stop_place(lens: Sequential) -> int:
    """Return the index of the row that is the stop; that of the first surface if none is marked."""
    for k, row in enumerate(lens.rows):
        if row.stop:
            return k
    return next(k for k, row in enumerate(lens.rows) if row.kind != "coordinate_break")


def field_tangents(lens: Sequential, data: SequentialFirstOrder) -> np.ndarray:
    """
    Return the slopes of the chief rays of all fields before the first surface.

    Fields are angles, at any object distance, or image heights for an object at infinity.

    Parameters
    ----------
    lens : Sequential
        Lens with the fields.
    data : SequentialFirstOrder
        First-order data, with which image heights are converted.

    Returns
    -------
    (n_fields, 2) float64
        Slopes dx/dz and dy/dz.

    Raises
    ------
    MistrayError
        If fields are object heights, angles of 90° or more either way, or image heights of an afocal lens.
    """
    fields = np.array(lens.fields, dtype=np.float64).reshape(-1, 2)
    if lens.field_kind == "angle_deg":
        if np.any(np.abs(fields) >= 90):
            raise MistrayError(f"lens '{lens.name}': a field of {np.abs(fields).max():g}°; it must be less than 90°")
        return np.asarray(np.tan(np.radians(fields)))
    if lens.field_kind == "image_height":
        if math.isinf(data.efl):
            raise MistrayError(f"lens '{lens.name}': it is afocal; give its fields as angles, not image heights")
        return np.asarray(fields / (data.efl * indices(lens, data.wavelength_nm)[0]))
    raise MistrayError(
        f"lens '{lens.name}': its fields are object heights and its object lies at infinity; give angles"
    )


def _beam(
    lens: Sequential, efl: float, to_stop: tuple[float, float], pupil_z: float, index: float
) -> tuple[float, float]:
    """
    Return the diameter of the entrance pupil, as in `SequentialFirstOrder`, and the paraxial stop radius, mm.

    Parameters
    ----------
    lens : Sequential
        Lens with the aperture.
    efl, pupil_z : float
        Focal length, and position of the entrance pupil, mm.
    to_stop : tuple of two float
        Height in the stop, mm, of a ray that meets the first row at height 1 mm and slope 0, and of one at height 0 and
        slope 1.
    index : float
        Refractive index of the object's medium.

    Raises
    ------
    MistrayError
        If the aperture is out of range, or does not determine the beam of this lens.
    """
    kind, value, distance = lens.aperture_kind, lens.aperture, lens.object_distance
    if not 0 < value < math.inf:
        raise MistrayError(
            f"lens '{lens.name}': its aperture ({kind.replace('_', ' ')}) is {value:g}; it must be greater than 0"
        )
    if kind == "object_na" and (math.isinf(distance) or value >= index):
        raise MistrayError(
            f"lens '{lens.name}': object NA {value:g} needs an object at a finite distance and a value below "
            f"{index:.6g}, the index of its medium; give a diameter"
        )
    # Radius in the stop for each mm of radius in the entrance pupil, or in the first row where that lies at infinity
    telecentric = math.isinf(pupil_z)
    scale = abs(to_stop[0] + to_stop[1] / distance) if telecentric else abs(to_stop[0])
    if kind == "object_na":
        epd = abs(2 * (distance + (0.0 if telecentric else pupil_z)) * math.tan(math.asin(value / index)))
    elif kind == "stop_diameter":
        if scale < _NONE:
            raise MistrayError(f"lens '{lens.name}': the stop lies in a focus; give the entrance pupil instead")
        epd = value / scale
    elif telecentric and math.isfinite(distance):
        raise MistrayError(
            f"lens '{lens.name}': its entrance pupil lies at infinity, so its aperture ({kind.replace('_', ' ')} "
            f"{value:g}) limits no beam; give the NA of the object"
        )
    elif kind == "entrance_pupil_diameter":
        epd = value
    else:
        if math.isinf(efl):
            raise MistrayError(f"lens '{lens.name}': it is afocal, so F/{value:g} is not an aperture; give a diameter")
        epd = abs(efl) / value
    return epd, scale * epd / 2


def _magnification(lens: Sequential, up: np.ndarray, down: np.ndarray) -> float:
    """
    Return the image height per object height, from the ray `up` of height 1 mm and slope 0.

    It is 0 for an object at infinity.
    """
    if math.isinf(lens.object_distance):
        return 0.0
    # y(image) = A (h + u d) + B u = A h + (A d + B) u: at a focused image the second term vanishes
    return float(up[-1, 0])

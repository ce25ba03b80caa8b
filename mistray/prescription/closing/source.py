"""Source for a lens file: its beam, and how the beam fills the stop."""

from __future__ import annotations

import math

import numpy as np

from mistray.percent import percent_text
from mistray.prescription.closing.surfaces import OpticalSurfaces
from mistray.prescription.imported_beam import Beam, beam_size
from mistray.prescription.model import Surface
from mistray.prescription.sequential.first_order import field_tangents, stop_place
from mistray.prescription.sequential.rays import trace
from mistray.prescription.sources import ObjectPoint, Source

_ASIDE = 0.02  # of the pupil's radius: a beam that comes in so far from the axis moves the source
_RINGS, _RAYS = 101, 8  # of the beam, that show how it fills the stop
_FULL = 0.01  # of the stop's radius: less is what two neighbouring rings leave open
_SOURCE_DIGITS = 9  # of its place in mm and direction in degrees


def source_of(table: OpticalSurfaces, beam: Beam) -> Source | ObjectPoint:
    """
    Return the source for a lens: collimated light of the first field, or the first field's point of a near object.

    Light of a virtual object is collimated along the axis. `beam` is that of
    `mistray.prescription.closing.system.to_prescription`. Notes on assumptions, and on how the beam fills the stop, are
    added to `table`.
    """
    lens, data = table.lens, table.rays.data
    near = not math.isinf(lens.object_distance)
    weights = np.array(lens.weights) / (sum(lens.weights) or 1.0)
    lit = [k for k, weight in enumerate(weights) if weight > 0] or [lens.primary]
    wavelengths = tuple(lens.wavelengths_nm[k] for k in lit)
    shares = None if len(lit) == 1 else tuple(float(weights[k]) for k in lit)
    if near:
        pupil = data.entrance_pupil_z if math.isfinite(data.entrance_pupil_z) else 0.0
        if lens.object_distance > 0:
            table.notes.append(
                "the object is near: its point lights all of the first surface, whatever the stop lets in"
            )
            if lens.object_distance + pupil <= 0:
                pupil = 0.0  # the object lies between the pupil and the lens
            distance = lens.object_distance + pupil
            field_deg, azimuth_deg = _direction(table, -table.rays.entering[0, 0, :2] / distance)
            return ObjectPoint(
                z=pupil,
                distance=distance,
                field_deg=field_deg,
                azimuth_deg=azimuth_deg,
                wavelength_nm=wavelengths,
                weights=shares,
            )
        table.notes.append(
            f"the object is virtual, {-lens.object_distance:.6g} mm behind the first surface, but the source is "
            "collimated along the axis: its light does not come to a focus on the detector"
        )
    x, y, z, radius, reach, filled = 0.0, 0.0, data.entrance_pupil_z, data.epd / 2, 0.0, "the pupil"
    if table.surfaces and (beam == "front" or math.isinf(z)):
        first = table.surfaces[min(table.surfaces)]
        x, y, z, radius, filled = first.x, first.y, first.z, first.outer_radius, "the first surface"
    elif not near:
        x, y, radius = _entrance(table, z, radius)
        reach = float(np.hypot(*(table.rays.pupils - [x, y]).T).max(initial=0.0))
    size, notes = beam_size(beam, radius, reach, of=filled)
    table.notes += notes
    field_deg, azimuth_deg = (0.0, 0.0) if near else _direction(table, field_tangents(lens, data)[0])
    if not near:
        table.notes.append(_filling(table, np.array([x, y, z]), size["radius"]))
    return Source(
        x=x,
        y=y,
        z=z,
        **size,
        field_deg=field_deg,
        azimuth_deg=azimuth_deg,
        plane="axis",
        wavelength_nm=wavelengths,
        weights=shares,
    )


def _entrance(table: OpticalSurfaces, z: float, radius: float) -> tuple[float, float, float]:
    """
    Return centre x, y and radius, mm, of the first field's beam in the plane `z`, mm, of the entrance pupil.

    They are 0, 0 and `radius`, that of the pupil in mm, unless the beam comes in beside the axis. Then `table` gets a
    note.
    """
    start, heading = table.rays.entering
    x, y = (start + ((z - start[:, 2]) / heading[:, 2])[:, None] * heading)[:, :2].T
    if math.hypot(x[0], y[0]) <= _ASIDE * radius:
        return 0.0, 0.0, radius
    centre = round(float(x[0]), _SOURCE_DIGITS) + 0.0, round(float(y[0]), _SOURCE_DIGITS) + 0.0
    radius = max(radius, float(np.hypot(x - x[0], y - y[0]).max()))
    table.notes.append(
        f"the source is centred at ({centre[0]:.6g}, {centre[1]:.6g}) mm, where the beam of the first field comes in"
    )
    return *centre, radius


def _direction(table: OpticalSurfaces, slopes: np.ndarray) -> tuple[float, float]:
    """
    Return field angle and azimuth of the first field, degrees, as in `Source`.

    `slopes`, (2,), are those in x and y of its light on the way to the origin of the source's frame. In the yz plane
    the azimuth is 0 and the angle has a sign. If the field is off the axis, `table` gets a note.
    """
    x, y = map(float, slopes)
    slope, azimuth = (math.hypot(x, y), math.degrees(math.atan2(-x, y))) if x else (y, 0.0)
    field = round(math.degrees(math.atan(slope)), _SOURCE_DIGITS)
    if field:
        table.notes.append(f"the source shines at the first field, {field:g} degrees off the axis")
    return field, round(azimuth, _SOURCE_DIGITS) + 0.0


def _filling(table: OpticalSurfaces, centre: np.ndarray, radius: float) -> str:
    """
    Return the note that says how far the beam of the first field fills the stop, from real rays with clipping.

    If the file marks no stop, the note says so.

    Parameters
    ----------
    table : OpticalSurfaces
        Optical surfaces and rays.
    centre : (3,) float64
        Centre of the beam's cross-section in the world, mm.
    radius : float
        Radius of the beam, mm.
    """
    lens, stop, size = table.lens, stop_place(table.lens), table.rays.stop_radius
    row = lens.rows[stop]
    if not row.stop:
        return f"the file marks no stop: surface {row.number} is it, as wide as the beam"
    turn = np.arange(_RAYS) * 2 * math.pi / _RAYS
    share = np.repeat(np.linspace(0.0, 1.0, _RINGS), _RAYS)
    across = radius * share[:, None] * np.tile(np.stack([np.cos(turn), np.sin(turn)], axis=1), (_RINGS, 1))
    heading = np.append(field_tangents(lens, table.rays.data)[0], 1.0)
    start = centre + np.column_stack([across, np.zeros(len(across))])
    hits = trace(lens, start, np.broadcast_to(heading, start.shape))[0][: stop + 1]
    reach = np.hypot(*hits[stop, :, :2].T) / size
    alive, taken = np.isfinite(reach), ""
    whole = float(np.max(reach, where=alive, initial=0.0))
    for j, surface in table.surfaces.items():
        if j < stop:
            passing = alive & _within(surface, hits[j, :, 0], hits[j, :, 1])
            if float(np.max(reach, where=passing, initial=0.0)) < min(
                1 - _FULL, np.max(reach, where=alive, initial=0.0)
            ):
                taken = surface.name
            alive = passing
    filled = float(np.max(reach, where=alive, initial=0.0))
    what = f"the stop, surface {row.number}, of radius {size:.5g} mm"
    if filled < 1 - _FULL:
        why = f": '{taken}' takes the rest" if taken else ""
        return f"the beam fills {what} only to {percent_text(filled, 3)} of its radius{why}"
    if whole < 1 + _FULL:
        return f"the beam just fills {what}"
    return f"the beam overfills {what}, by {percent_text(whole - 1)} of it"


def _within(surface: Surface, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a mask of points x, y, mm, in a surface's vertex plane that lie in its clear aperture, (n,) bool."""
    if surface.outline is not None:
        return np.asarray(surface.outline.contains(x, y))
    if surface.semi_diameter is None:
        assert surface.half_width is not None
        assert surface.half_height is not None
        return (np.abs(x) <= surface.half_width) & (np.abs(y) <= surface.half_height)
    r = np.hypot(x, y)
    return (r <= surface.semi_diameter) & (r >= surface.inner_semi_diameter)

"""Conversion of a prescription to a sequential table of surfaces, in the order of light.

Light starts along +z and meets the surfaces in their order; mirrors reflect it. Each surface gets a frame whose z axis
points along the light before it, or against it after an odd number of mirrors. Surfaces that are displaced sideways but
not turned against one another get a decentre, others a coordinate break whose z axis runs from vertex to vertex.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mistray.errors import MistrayError
from mistray.io.conventions import turns_deg
from mistray.materials import refractive_index
from mistray.physics.geometry.outline import Outline, circle, rectangle
from mistray.physics.geometry.pose import moved
from mistray.physics.sags.terms import half_turned
from mistray.prescription.coating import Coating
from mistray.prescription.model import Detector, Prescription, Surface
from mistray.prescription.sequential.rays import Array, passes, trace
from mistray.prescription.sequential.table import Decentre, Row, Sequential
from mistray.prescription.sources import ObjectPoint, Source

_TINY = 1e-9  # mm and radians below which a displacement or a turn is rounding
_DECIMALS = 12  # of thicknesses in mm and tilts in degrees, beyond which they are rounding
_RAYS, _REFINEMENTS = 201, 5  # that look for the stop
_DEFAULT_NM = 587.56


def to_sequential(prescription: Prescription) -> Sequential:
    """
    Convert a prescription to a sequential table of its surfaces.

    Parameters
    ----------
    prescription : Prescription
        Prescription with surfaces in the order of light, and a detector.

    Returns
    -------
    Sequential
        Lens in mm. Its stop is that of the prescription, else the surface that limits a beam along the axis. Its
        `notes` state the choice and list omissions: structure, further detectors, scatter and coatings without a name.

    Raises
    ------
    MistrayError
        If there is no detector or no surface, or if the material in front of a surface differs from the one behind the
        surface before it. It is also raised if light would have to travel backwards, a surface that is not a mirror is
        opaque, or no axial beam gets through.

    Examples
    --------
    >>> from mistray.scenes.cooke_triplet.prescription import build
    >>> triplet = mistray.prescription.to_sequential(build())
    >>> [row.material for row in triplet.rows]
    ['N-LAK9', 'air', 'N-SF5', 'air', 'N-LAK9', 'air', 'air']
    """
    if prescription.detector is None or not prescription.surfaces:
        missing = "detector" if prescription.surfaces else "optical surface"
        raise MistrayError(f"prescription '{prescription.name}': it has no {missing}, so it is not a sequential lens")
    return _Walk(prescription).sequential()


@dataclass
class _Walk:
    """Builder of the sequential table along the light, with the present frame, direction and material."""

    prescription: Prescription

    def __post_init__(self) -> None:
        self.rows: list[Row] = []
        self.notes: list[str] = []
        self.bare: list[str] = []
        self.frame: Array = np.eye(4)
        self.light: Array = np.array([0.0, 0.0, 1.0])
        self.sense = 1.0  # of light along the frame's z axis
        self.material = ""
        self.last, self.vertex = "", np.zeros(3)
        self.begin = 0.0  # z of the first row in the world, mm

    def sequential(self) -> Sequential:
        p = self.prescription
        assert p.detector is not None
        first = p.surfaces[0]
        self.material = self._sides(first, self._against(first.to_world()))[0]
        start = self.material
        stop = self._stop_place()
        for place, surface in enumerate(p.surfaces):
            if place == stop:
                self._add_stop()
            self._add(surface)
        if stop == len(p.surfaces):
            self._add_stop()
        self._add(p.detector)
        self.rows = [replace(row, number=number) for number, row in enumerate(self.rows, 1)]
        return self._with_aperture(self._lens(start))

    def _lens(self, start: str) -> Sequential:
        p, source = self.prescription, self.prescription.source
        assert p.detector is not None
        if self.bare:
            self.notes.append(f"coatings without a name are left out: those of {', '.join(self.bare)}")
        if p.structures:
            self.notes.append(f"structure is left out ({len(p.structures)} shapes)")
        if p.more_detectors:
            self.notes.append(f"detectors besides '{p.detector.name}' are left out ({len(p.more_detectors)})")
        if any(surface.scatter for surface in p.surfaces):
            self.notes.append("scatter is left out")
        field, distance = ((0.0, 0.0), math.inf) if source is None else self._field(source)
        wavelengths: tuple[float, ...] = (_DEFAULT_NM,)
        weights: tuple[float, ...] = (1.0,)
        if source is not None and source.spectrum is None:
            wavelengths, weights = source.wavelength_nm, source.weights or (1.0,) * len(source.wavelength_nm)
        elif source is not None:
            wavelengths, weights = (tuple(map(float, v)) for v in (source.light.wavelengths_nm, source.light.weights))
        # Waves in a coating file are those of the primary wavelength
        waves = {c.design_nm for s in p.surfaces if (c := s.coating) is not None and ":" in (c.table or "")}
        primary = next((k for k, nm in enumerate(wavelengths) if nm in waves), len(wavelengths) // 2)
        if waves - {wavelengths[primary]}:
            told = ", ".join(f"{nm:g}" for nm in sorted(waves))
            self.notes.append(
                f"waves in the coating file are of {told} nm here, and of {wavelengths[primary]:g} nm there"
            )
        return Sequential(
            name=p.name,
            rows=tuple(self.rows),
            source=f"mistray prescription '{p.name}'",
            object_material=start,
            object_distance=distance,
            field_kind="angle_deg" if math.isinf(distance) else "object_height",
            fields=tuple(dict.fromkeys([(0.0, 0.0), field])),
            wavelengths_nm=wavelengths,
            weights=weights,
            primary=primary,
        )

    def _field(self, source: Source | ObjectPoint) -> tuple[tuple[float, float], float]:
        """
        Return the field (x, y) of a source, degrees or mm on the object, and the object's distance, mm, or ``inf``.

        Raise `MistrayError` if collimated light does not travel along +z.
        """
        slope, azimuth = math.tan(math.radians(source.field_deg)), math.radians(source.azimuth_deg)
        pose = source.to_world()
        along = pose[:3, :3] @ [-slope * math.sin(azimuth), slope * math.cos(azimuth), 1.0]
        if isinstance(source, ObjectPoint):
            x, y, z = pose[:3, 3] - source.distance * along
            return (float(x), float(y)), self.begin - float(z)
        if along[2] <= 0:
            raise MistrayError(
                f"prescription '{self.prescription.name}': its source shines against the z axis; turn the system round"
            )
        if source.x or source.y:
            self.notes.append("the beam is centred beside the axis; it is taken about the axis")
        x, y = (round(math.degrees(math.atan(slope / along[2])), _DECIMALS) + 0.0 for slope in along[:2])
        return (x, y), math.inf

    def _add(self, surface: Surface) -> None:
        pose = self._follow(surface.to_world(), surface.name)
        against = self._against(pose)
        if against:
            pose = pose @ np.diag([-1.0, 1.0, -1.0, 1.0])  # half a turn about y: z points the other way
        image = isinstance(surface, Detector)
        before, behind = self._sides(surface, against != (self.sense < 0))
        if before != self.material:
            raise MistrayError(
                f"prescription '{self.prescription.name}': light comes to surface '{surface.name}' in "
                f"'{self.material}', but the surface stands in '{before}'; the surfaces are not in the order of light"
            )
        if not (image or surface.mirror) and surface.coating is not None and surface.coating.opaque:
            raise MistrayError(
                f"prescription '{self.prescription.name}': surface '{surface.name}' is opaque and no mirror, so light "
                "goes no further; make it a structure"
            )
        flip = -1.0 if against else 1.0
        semi_diameter, fixed, aperture = _clip(surface)
        if against and aperture is not None:
            aperture = aperture.half_turned()
        self._place(
            pose,
            Row(
                0,
                kind="image" if image else "surface",
                label=surface.name,
                radius=flip * surface.radius if surface.curvature else math.inf,
                conic=surface.conic,
                coefficients=tuple(flip * a for a in surface.coefficients),
                sag=half_turned(surface.sag) if against else surface.sag,
                material="air" if image else self.material if surface.mirror else behind,
                mirror=surface.mirror,
                semi_diameter=semi_diameter,
                semi_diameter_fixed=fixed,
                aperture=aperture,
                coating="" if image else self._coating(surface),
            ),
        )
        if surface.mirror:
            normal = pose[:3, 2]
            self.light = self.light - 2 * (self.light @ normal) * normal
            self.sense = -self.sense
        else:
            self.material = behind
        self.last, self.vertex = surface.name, pose[:3, 3]

    def _place(self, pose: Array, row: Row) -> None:
        """
        Append a row at the frame `pose`, (4, 4), mm, to the table.

        Set the thickness before it, and tilt or shift the axis if needed.
        """
        step = np.linalg.inv(self.frame) @ pose
        turned = not np.allclose(step[:3, :3], np.eye(3), atol=_TINY)
        aside = math.hypot(step[0, 3], step[1, 3]) > _TINY
        if aside and turned and self.rows:
            step = self._towards(step)
            turned = not np.allclose(step[:3, :3], np.eye(3), atol=_TINY)
            aside = False
        x, y, z = (round(float(value), _DECIMALS) + 0.0 for value in step[:3, 3])
        if self.rows:
            self.rows[-1] = replace(self.rows[-1], thickness=z)
        else:  # the table begins at the first vertex
            self.begin = z
        if aside or turned:
            tilt = _tilts(step[:3, :3])
            row = replace(row, decentre=Decentre(x=x if aside else 0.0, y=y if aside else 0.0, tilt_deg=tilt))
        self.rows.append(row)
        self.frame = pose

    def _towards(self, step: Array) -> Array:
        """
        Add a coordinate break so that the z axis runs through the next vertex; return the step from the turned frame.

        `step` is the frame of the next surface in the frame here, and the result is that in the turned frame, both
        (4, 4), mm. After an odd number of mirrors the axis points away from the vertex.
        """
        way = step[:3, 3] * self.sense
        x, y, z = way / np.linalg.norm(way)
        about_x, about_y = math.atan2(-y, z), math.asin(min(max(float(x), -1.0), 1.0))
        turn = moved(np.eye(4), 0.0, 0.0, 0.0, math.degrees(about_x), math.degrees(about_y), 0.0)
        decentre = Decentre(tilt_deg=_tilts(turn[:3, :3]))
        self.rows.append(Row(0, kind="coordinate_break", material=self.material, decentre=decentre))
        return np.asarray(np.linalg.inv(turn) @ step)

    def _follow(self, pose: Array, name: str) -> Array:
        """Return the frame `pose` of the next surface; raise `MistrayError` if its vertex lies behind the last one."""
        if self.last:
            way = pose[:3, 3] - self.vertex
            length = float(np.linalg.norm(way))
            if length > _TINY and float(way @ self.light) < -_TINY * length:
                raise MistrayError(
                    f"prescription '{self.prescription.name}': light behind surface '{self.last}' runs away from "
                    f"surface '{name}'; the surfaces are not in the order of light"
                )
        return pose

    def _against(self, pose: Array) -> bool:
        """True if a surface's z axis must be reversed to point as that of the table, see the module's docstring."""
        return float(pose[:3, 2] @ self.light) * self.sense < 0

    def _sides(self, surface: Surface, reversed_: bool) -> tuple[str, str]:
        """Return the materials before and behind a surface along the light; `reversed_`: the back is met first."""
        return (surface.back, surface.front) if reversed_ else (surface.front, surface.back)

    def _stop_place(self) -> int | None:
        """
        Return the index of the surface before which light along the axis first meets the stop.

        It is the number of surfaces if the stop is behind all, and that of the first surface off the axis if it is not
        ahead of this. None: there is no stop.
        """
        p = self.prescription
        if p.stop is None:
            return None
        sense, to_come = 1.0, True  # of the light along z, and whether the stop lies ahead of it
        for place, surface in enumerate(p.surfaces):
            along = float(surface.to_world()[2, 2])
            if math.hypot(surface.x, surface.y) > _TINY or abs(along) < 1 - _TINY:
                return place
            r = min(p.stop.radius, surface.outer_radius)
            ahead = sense * (surface.z + along * (float(surface.z_at(r)) - surface.z) - p.stop.z_front)
            if to_come and ahead >= -_TINY:
                return place
            to_come = (ahead if surface.mirror else -ahead) >= -_TINY
            sense = -sense if surface.mirror else sense
        return len(p.surfaces)

    def _add_stop(self) -> None:
        stop = self.prescription.stop
        assert stop is not None
        if stop.z_rear > stop.z_front:
            self.notes.append(f"the stop is {stop.z_rear - stop.z_front:g} mm thick; its front face is taken")
        pose = np.eye(4)
        pose[2, 3] = stop.z_front
        self._place(
            pose,
            Row(
                0,
                label=stop.part,
                material=self.material,
                stop=True,
                semi_diameter=stop.radius,
                semi_diameter_fixed=True,
            ),
        )

    def _coating(self, surface: Surface) -> str:
        coating = surface.coating
        if coating is None:
            return ""
        name = _coating_name(coating)
        if not name:
            self.bare.append(surface.name)
        return name

    def _with_aperture(self, lens: Sequential) -> Sequential:
        """
        Return the lens with its stop and the size of the axial beam that passes.

        The size is a diameter, mm, or the object-space NA for a near object.
        """
        source = self.prescription.source
        beam, cone = math.inf, 90.0  # mm and degrees
        if isinstance(source, Source):
            beam = source.radius or min(source.half_width or math.inf, source.half_height or math.inf)
        elif source is not None:
            cone = min(source.half_angle_deg, cone)
        diameter, limit = _widest_beam(lens)
        rows = list(lens.rows)
        if not any(row.stop for row in rows):
            rows[limit] = replace(rows[limit], stop=True)
            self.notes.append(f"the stop is '{rows[limit].label}', which limits a beam along the axis")
        notes = tuple(self.notes)
        if math.isfinite(lens.object_distance):
            sine = math.sin(min(math.atan(0.5 * diameter / lens.object_distance), math.radians(cone)))
            na = sine * refractive_index(lens.object_material, lens.wavelength_nm)
            return replace(lens, rows=tuple(rows), aperture_kind="object_na", aperture=na, notes=notes)
        return replace(lens, rows=tuple(rows), aperture=min(diameter, 2 * beam), notes=notes)


def _widest_beam(lens: Sequential) -> tuple[float, int]:
    """
    Return the diameter, mm, of the widest round beam whose rim passes, and the index of the row that limits it.

    The beam travels along the axis, or comes from the middle of a near object. Its diameter is measured in the plane of
    the first row. Raise `MistrayError` if no beam passes.
    """
    low, high, limit = 0.0, max(_reach(row) for row in lens.rows), 0
    for _ in range(_REFINEMENTS):
        heights = np.linspace(low, high, _RAYS)
        start = np.zeros((_RAYS, 3))
        start[:, 0] = heights  # most tilts are about x, and foreshorten nothing there
        heading = np.tile([0.0, 0.0, 1.0], (_RAYS, 1))
        if math.isfinite(lens.object_distance):
            heading[:, 0] = heights / lens.object_distance
            heading /= np.linalg.norm(heading, axis=1, keepdims=True)
            start = np.tile([0.0, 0.0, -lens.object_distance], (_RAYS, 1))
        points, _directions = trace(lens, start, heading)
        through = _RAYS
        for place, row in enumerate(lens.rows):
            if row.kind != "surface":
                continue
            shape = row
            ring = row.aperture.annulus if row.aperture is not None else None
            if ring:  # the hole of a mirror is no limit of its beam
                shape = replace(row, aperture=circle(ring[0]))
            stopped = np.flatnonzero(~passes(shape, points[place]))
            if stopped.size and stopped[0] < through:
                through, limit = int(stopped[0]), place
        if through == _RAYS:
            return 2 * high, limit
        if through == 0:
            break
        low, high = float(heights[through - 1]), float(heights[through])
    if low:
        return 2 * low, limit
    raise MistrayError(
        f"lens '{lens.name}': surface '{lens.rows[limit].label}' lets no beam along the axis through, so that it has "
        "no stop; check its surfaces"
    )


def _reach(row: Row) -> float:
    sides = row.aperture.sides if row.aperture is not None else None
    return min(sides) if sides else row.semi_diameter or 0.0


def _clip(surface: Surface) -> tuple[float, bool, Outline | None]:
    """
    Return the semi-diameter of a surface, mm, whether it alone bounds the surface, and its outline, None for a disc.

    The semi-diameter of a rectangle or another outline is the largest distance from the axis.
    """
    if surface.outline is not None:
        return surface.outer_radius, False, surface.outline
    if surface.semi_diameter is None:
        assert surface.half_width is not None
        assert surface.half_height is not None
        width, height = surface.half_width, surface.half_height
        return surface.outer_radius, False, rectangle(width, height)
    outer, inner = surface.semi_diameter, surface.inner_semi_diameter
    return outer, not inner, circle(outer, inner) if inner else None


def _coating_name(coating: Coating) -> str:
    table = coating.table or ""
    return table if ":" in table else coating.name or coating.preset or ""


def _tilts(m: Array) -> tuple[float, float, float]:
    """Return tilts about x, the new y and the newest z, degrees, of a rotation (3, 3), without round-off."""
    a, b, c = (round(angle, _DECIMALS - 2) + 0.0 for angle in turns_deg(m))
    return a, b, c

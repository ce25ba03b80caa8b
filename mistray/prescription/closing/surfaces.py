"""Optical surfaces of a sequential lens placed in the world, with clips, materials and coatings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from mistray.coatings import PRESETS
from mistray.errors import errors_of
from mistray.physics.geometry.crossing import SAMPLES, meeting
from mistray.physics.geometry.outline import Outline, rectangle
from mistray.physics.geometry.sag import conic_end, trimmed
from mistray.prescription.closing.apertures import ended, own_clip
from mistray.prescription.closing.edges import meets_plane, on_axis, placed
from mistray.prescription.closing.mirrors import beside_vertex, footprint, piece_beside_vertex
from mistray.prescription.closing.names import Names, names_of
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import is_gas
from mistray.prescription.model import Surface
from mistray.prescription.sequential.edge_rays import EdgeRays, edge_rays
from mistray.prescription.sequential.first_order import stop_place
from mistray.prescription.sequential.materials import usable
from mistray.prescription.sequential.rays import curvature, frames, materials_before, passes
from mistray.prescription.sequential.table import Row, Sequential

COVER_MM = 1e-3
"""Distance, mm, that separates faces which coincide in the lens file."""

_MIRROR = Coating(R=1.0)
_SMALLEST = 1e-3  # of the pupil: radius of a surface that no ray reaches off its vertex
_BEYOND = 1e-3  # relative: rays that pass a drawn radius by less are round-off of the file
_INSIDE_CONIC = 0.999
_TWO_SECTIONS = {"curvature_x", "toroid_curvature"}  # of a sag that ends at other distances in x than in y
_ROUND_OFF_MM = 1e-9


class OpticalSurfaces:
    """
    Optical surfaces of a lens, with the rays that set their sizes and notes on assumptions.

    Parameters
    ----------
    lens : Sequential
        Lens to convert.
    coatings : mapping of str to Coating or None
        Coatings, keyed by their names in the lens file.
    margin : float
        Fraction by which clear radii exceed the rays if the file gives none.

    Attributes
    ----------
    surfaces : dict of int to Surface
        Surfaces in the world, keyed by the index of the row; a surface that light meets twice has two keys.
    rays : EdgeRays
        Chief and rim rays of the lens, for up to 24 fields.
    beam : (n_rows + 1, n, 3) float64
        Positions of rays all over the beams of up to nine fields, mm, see `EdgeRays.within`; NaN from a stated aperture
        that stops them.
    beam_and_rim : (n_rows + 1, m, 3) float64
        Positions of these rays and of the rays of `EdgeRays.world`, which mark the rim of the beam, mm.
    blocked : (n,) bool
        Whether each ray of `beam` is blocked by a mirror that it should pass, as `cut_holes` finds.
    frames : (n_rows, 4, 4) float64
        Transforms from the frame of each row to the world, mm.
    before, behind : list of str
        Materials in front of and behind each row, with a known k.
    aheads : list of bool
        Whether light arrives at each row along +z of its frame.
    names : dict of int to str
        Names of all rows, keyed by index.
    patches : set of str
        Names of mirrors that are spots on a lens, without their own body.
    notes : list of str
        Notes on assumptions.
    """

    def __init__(self, lens: Sequential, coatings: Mapping[str, Coating] | None, margin: float) -> None:
        self.lens = lens
        self.coatings = {key.lower(): coating for key, coating in (coatings or {}).items()}
        self.margin = margin
        self.rays: EdgeRays = edge_rays(lens)
        self.frames = frames(lens)
        self.beam = self._stopped(self.rays.within)
        self.beam_and_rim = np.concatenate([self.beam, self.rays.world], axis=1)
        self.blocked = np.zeros(self.beam.shape[1], dtype=bool)
        self.notes: list[str] = [*lens.notes, *self.rays.notes]
        before = materials_before(lens)
        self.before = [self._material(material, row) for material, row in zip(before, lens.rows, strict=True)]
        self.behind = [*self.before[1:], self.before[-1]]
        names = names_of(lens, self._has_effect)
        self.names = names.rows
        self.notes += names.note()
        self.surfaces: dict[int, Surface] = {}
        self._vertices = np.full((len(lens.rows), 3), np.inf)
        self.enlarged: dict[int, float] = {}  # number of a surface → part by which rays exceed its drawn radius
        self.patches: set[str] = set()
        self.aheads = [self._ahead(k) for k in range(len(lens.rows))]
        self._place_surfaces(names)
        self._cut_where_they_cross()
        self._cut_at_the_stop()

    def _place_surfaces(self, names: Names) -> None:
        part, count = "", 0
        bending = [k for k in range(len(self.lens.rows) - 1) if self._has_effect(k)]
        for k, after in pairwise([*bending, *bending[-1:]]):
            row = self.lens.rows[k]
            if not is_gas(self.behind[k]) and not row.mirror:
                # The glass behind begins a new body; its first surface bears the name
                count += 1
                part = names.body(k, after, count)
            own_part = part if not (is_gas(self.before[k]) and is_gas(self.behind[k])) else self.names[k]
            front, back = (self.before[k], self.behind[k]) if self.aheads[k] else (self.behind[k], self.before[k])
            if row.mirror:
                front = back = self.before[k]
            surface = Surface(
                self.names[k],
                radius=row.radius,
                conic=row.conic,
                coefficients=trimmed(row.coefficients),
                sag=row.sag,
                front=front,
                back=back,
                coating=self._coating(k),
                mirror=row.mirror,
                part=own_part,
                **self._clear(k),
            )
            surface = placed(surface, self._off_its_lens(k, surface))
            twins = self._at(surface)
            self._vertices[k] = surface.x, surface.y, surface.z
            again = next((j for j in twins if _same(self.surfaces[j], surface)), None)
            if again is None:
                self.surfaces[k] = surface
                continue
            first = self.surfaces[again]
            larger = max(first.outer_radius, surface.outer_radius)
            if first.semi_diameter is not None:
                first = replace(first, semi_diameter=larger)
            for j in [j for j, other in self.surfaces.items() if other.name == first.name]:
                self.surfaces[j] = first
            self.surfaces[k] = first
            self.notes.append(f"surface {row.number} is '{first.name}' on the way back")
        if self.enlarged:
            numbers = ", ".join(map(str, self.enlarged))
            self.notes.append(
                f"drawn clear radii that are not apertures, made larger because rays reach up to "
                f"{100 * max(self.enlarged.values()):.3g} % beyond: surfaces {numbers}"
            )

    def _has_effect(self, k: int) -> bool:
        """True if row `k` refracts or reflects light."""
        row = self.lens.rows[k]
        return row.kind == "surface" and (row.mirror or self.before[k] != self.behind[k])

    def is_stop_plane(self, k: int) -> bool:
        """True if row `k` is the stop and has neither glass nor a mirror."""
        return k == stop_place(self.lens) and self.lens.rows[k].stop and not self._has_effect(k)

    def _ahead(self, k: int) -> bool:
        """True if light arrives at row `k` along +z of its frame, judged by the chief ray of `EdgeRays.chief`."""
        inward = np.array([0.0, 0.0, 1.0])
        for j in range(k - 1, -1, -1):
            if np.all(np.isfinite(self.rays.chief[j])):
                inward = self.frames[j][:3, :3] @ self.rays.chief[j]
                break
        return bool(inward @ self.frames[k][:3, 2] > 0)

    def _material(self, material: str, row: Row) -> str:
        """Return a material of a row with a known k; if its absorption is unknown, k = 0 and a note says so."""
        with errors_of(f"lens '{self.lens.name}', surface {row.number}"):
            known = usable(material, self.lens.wavelengths_nm)
        if known != material:
            self.notes.append(f"material '{material}': its absorption is unknown and taken for 0")
        return known

    def _at(self, surface: Surface) -> list[int]:
        """Return the indices of rows, so far, whose vertex in the world coincides with that of a surface."""
        apart = np.abs(self._vertices - [surface.x, surface.y, surface.z])
        return [int(k) for k in np.flatnonzero(np.all(apart <= _ROUND_OFF_MM, axis=1))]

    def _off_its_lens(self, k: int, surface: Surface) -> np.ndarray:
        """
        Return the frame of row `k` in the world, (4, 4), mm, for its surface.

        That of a mirror that is a spot on a lens lies 1 µm in front of the lens, with a note and an entry in `patches`.
        """
        frame = self.frames[k]
        if not surface.mirror:
            return frame
        there = placed(surface, frame)
        others = [self.surfaces[j] for j in self._at(there)]
        on = [other for other in others if _same_figure(other, there) and not other.mirror]
        if not on:
            return frame
        self.notes.append(f"mirror '{surface.name}' is a spot on '{on[0].name}': it stands 1 µm before it")
        self.patches.add(surface.name)
        frame = frame.copy()
        frame[:3, 3] -= frame[:3, 2] * (COVER_MM if self.aheads[k] else -COVER_MM)
        return frame

    def _clear(self, k: int) -> dict[str, Any]:
        """
        Return arguments of `Surface` for the clip of row `k`, mm: its stated size, its drawn one, or that of the beam.

        A drawn size counts if no ray exceeds it; that of the beam has the `margin` of the class. A mirror that the beam
        meets beside its vertex becomes a disc there. What lies beyond the end of the conic is cut off. Notes say so.
        """
        row, reach = self.lens.rows[k], float(self.rays.reach[k])
        end = conic_end(curvature(row), row.conic)
        clip = own_clip(row)
        outline: Outline | None = clip.pop("outline", None)
        if "half_width" in clip or (outline is not None and outline.bounded):
            stated = rectangle(clip["half_width"], clip["half_height"]) if outline is None else outline
            kept = stated if _TWO_SECTIONS & row.sag.keys() else ended(stated, end * _INSIDE_CONIC)
            if kept is not stated:
                self.notes.append(f"surface {row.number}: its aperture is cut where its conic ends, at {end:.6g} mm")
            return clip if outline is None and kept is stated else {"outline": kept}
        if row.mirror and outline is None and "semi_diameter" not in clip:
            points = footprint(self, k, self.frames[k])
            if beside_vertex(points):
                piece = piece_beside_vertex(points, self.margin)
                (disc,) = piece.figures
                self.notes.append(
                    f"mirror of surface {row.number}: the beam meets it beside its vertex; it is a disc of radius "
                    f"{disc.sizes[0]:.6g} mm about ({disc.x:.6g}, {disc.y:.6g}) mm"
                )
                return {"outline": piece}
        if "semi_diameter" in clip:
            radius = clip["semi_diameter"]
        elif k == stop_place(self.lens) and row.stop and not self.lens.telecentric:
            radius = self.rays.stop_radius
        elif row.semi_diameter is not None and row.semi_diameter >= reach * (1 - _BEYOND):
            radius = row.semi_diameter
        else:
            if row.semi_diameter:
                self.enlarged[row.number] = reach / row.semi_diameter - 1
            radius = max(reach, _SMALLEST * self.rays.data.epd) * (1 + self.margin)
        if radius >= end:
            self.notes.append(f"surface {row.number}: clear radius {radius:.6g} mm; its conic ends at {end:.6g} mm")
            radius = end * _INSIDE_CONIC
        return {**clip, "semi_diameter": radius} if outline is None else {"outline": outline.within(radius)}

    def _coating(self, k: int) -> Coating | None:
        row = self.lens.rows[k]
        bare = _MIRROR if row.mirror else None
        what = "reflects all light" if row.mirror else "is bare"
        if not row.coating:
            if row.mirror:
                self.notes.append("mirrors without a coating reflect all light")
            return bare
        name = row.coating.rpartition(":")[2].lower()
        if name in self.coatings:
            return self.coatings[name]
        if ":" in row.coating:
            # OpticStudio reverses layers at the way out of glass alone; between glasses the light meets the first one
            within = not (row.mirror or is_gas(self.before[k]) or is_gas(self.behind[k]))
            first = ("front" if self.aheads[k] else "back") if within else "outside"
            return Coating(table=row.coating, first=first, design_nm=self.lens.wavelength_nm, mirror=row.mirror)
        if row.coating in PRESETS:
            return Coating(preset=row.coating, name=row.coating)
        self.notes.append(f"coating '{row.coating}' of surface {row.number} is not given (coatings=): it {what}")
        return bare

    def _cut_where_they_cross(self) -> None:
        """Reduce the clear radii of round neighbours on one axis that would cross, so that they end where they meet."""
        order = list(self.surfaces)
        for j, k in pairwise(order):
            a, b = self.surfaces[j], self.surfaces[k]
            if a.semi_diameter is None or b.semi_diameter is None or not on_axis(a.to_world(), b.to_world()):
                continue
            gap = float((np.linalg.inv(a.to_world()) @ b.to_world())[2, 3])
            flat: dict[str, Any] = {"x": 0.0, "y": 0.0, "tilt_deg": (0.0, 0.0, 0.0)}
            here, there = replace(a, z=0.0, **flat), replace(b, z=gap, **flat)
            met = meeting(here.z_at, there.z_at, 0.0, min(a.semi_diameter, b.semi_diameter))
            if met is None or met.coincide or met.r == 0:
                continue
            reach = max(self._reach(a), self._reach(b))
            # The radius found is up to one sample of the profile too large
            radius = met.r - 2 * min(a.semi_diameter, b.semi_diameter) / SAMPLES
            self.notes.append(
                f"surfaces '{a.name}' and '{b.name}' cross at {met.r:.6g} mm: their clear radii end there"
                + (f", rays reach {reach:.6g} mm" if reach > radius else "")
            )
            for own in (a, b):
                if own.outer_radius > radius:
                    self.exchange(own, replace(own, semi_diameter=radius))

    def _cut_at_the_stop(self) -> None:
        """Reduce the clear radius of a surface that bulges through the stop's opening to the radius of its beam."""
        k = stop_place(self.lens)
        if not self.is_stop_plane(k):
            return
        before, after = [j for j in self.surfaces if j < k][-1:], [j for j in self.surfaces if j > k][:1]
        for j, above in [(j, not self.aheads[k]) for j in before] + [(j, self.aheads[k]) for j in after]:
            surface = self.surfaces[j]
            if surface.semi_diameter is None or not on_axis(surface.to_world(), self.frames[k]):
                continue
            reach = self._reach(surface)
            if meets_plane(surface, self.frames[k], above) <= self.rays.stop_radius and reach > 0:
                self.exchange(surface, replace(surface, semi_diameter=reach))

    def _reach(self, surface: Surface) -> float:
        """Return the largest distance of a ray from the axis of a surface, mm, whenever light meets it."""
        return max(float(self.rays.reach[k]) for k, own in self.surfaces.items() if own is surface)

    def exchange(self, old: Surface, new: Surface) -> None:
        """Put `new` in the place of a surface, at all rows that are this surface."""
        for k in [k for k, surface in self.surfaces.items() if surface is old]:
            self.surfaces[k] = new

    def segments(self) -> list[tuple[int, int]]:
        """Return the segments of the beam: pairs of `beam` indices at which it leaves a surface and meets the next."""
        met = [*self.surfaces, len(self.lens.rows) - 1]
        return list(pairwise([0, *(k + 1 for k in met)]))

    def _stopped(self, beam: np.ndarray) -> np.ndarray:
        """
        Return beam positions, mm, as in `beam`, with NaN from where a stated aperture stops a ray.

        If apertures stop all rays, none is stopped.
        """
        result = beam.copy()
        for k, (row, frame) in enumerate(zip(self.lens.rows, self.frames, strict=True)):
            if row.kind != "coordinate_break":
                local = (beam[k + 1] - frame[:3, 3]) @ frame[:3, :3]
                result[k + 1 :, ~passes(row, local)] = np.nan
        return result if np.any(np.isfinite(result[-1])) else beam


def _same(a: Surface, b: Surface) -> bool:
    """True if two surfaces at one vertex are one that light meets twice: equal media, figures and kinds (mirror)."""
    return a.mirror == b.mirror and {a.front, a.back} == {b.front, b.back} and _same_figure(a, b)


def _same_figure(a: Surface, b: Surface) -> bool:
    equal = all(getattr(a, key) == getattr(b, key) for key in ("radius", "conic", "coefficients", "sag", "outline"))
    return equal and bool(np.allclose(a.to_world()[:3, 2:], b.to_world()[:3, 2:], rtol=0, atol=_ROUND_OFF_MM))

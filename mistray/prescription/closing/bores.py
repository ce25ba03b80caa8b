"""Holes bored through lenses for other lenses inside them, or for a later part of the beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mistray.prescription.closing.edges import Closing, on_axis, placed
from mistray.prescription.closing.mirrors import beam_shares, percent
from mistray.prescription.closing.shadows import met_at
from mistray.prescription.closing.surfaces import COVER_MM, OpticalSurfaces
from mistray.prescription.coating import BLACK
from mistray.prescription.geometry import gas_of, is_gas
from mistray.prescription.model import Structure, Surface

_CLEARANCE = 1.02  # of what stands in the bore
_FULL_BORE = 0.9  # of the body's radius: a wider bore would leave no lens
_SAMPLES = 257


@dataclass(frozen=True)
class _Body:
    """
    Lens body of glass between two round faces on a common axis.

    Attributes
    ----------
    places : tuple of two int
        Indices of the rows of the faces, where light meets them first.
    lower, upper : Surface
        Faces in the order of the axis.
    gap : float
        Distance between their vertices, mm.
    """

    places: tuple[int, int]
    lower: Surface
    upper: Surface
    gap: float

    @property
    def radius(self) -> float:
        return min(self.lower.outer_radius, self.upper.outer_radius)

    @property
    def names(self) -> tuple[str, str]:
        return self.lower.name, self.upper.name

    @property
    def extent(self) -> tuple[float, float]:
        """Positions of both ends of the glass along the axis, mm, from the vertex of the lower face."""
        r = np.linspace(0.0, self.radius, _SAMPLES)
        return float(_sag(self.lower, r).min()), float(_sag(self.upper, r).max()) + self.gap

    def reached(self, shape: Surface | Structure, z: float) -> float:
        """
        Return the largest radius, mm, at which a shape on the axis lies in the glass; 0 if nowhere.

        The origin of the shape's frame is at z, mm, from the vertex of the lower face.
        """
        r, heights = _profile(shape)
        own = np.minimum(r, self.radius)
        below, above = heights + z - _sag(self.lower, own), _sag(self.upper, own) + self.gap - heights - z
        within = (r < self.radius) & (below > 2 * COVER_MM) & (above > 2 * COVER_MM)
        return float(r[within].max()) if np.any(within) else 0.0

    def wall(self, radius: float, closing: Closing) -> Structure:
        """Return the wall, in the world, of a hole of given radius, mm, through the lens; the glass is outside it."""
        low, high = self.lower, self.upper
        part = low.part if low.mirror else high.part if high.mirror else low.part
        ends = [float(_sag(face, np.array(radius))) + z for face, z in ((low, 0.0), (high, self.gap))]
        wall = Structure(
            f"{part}_bore", radius, ends[0], radius, ends[1],
            front=gas_of(low.front, high.back), back=low.back, coating=None if closing.edges == "open" else BLACK,
            scatter=closing.edge_scatter, part=part,
        )  # fmt: skip
        return placed(wall, low.to_world())


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # huge numbers reach nothing
def add_bores(table: OpticalSurfaces, closing: Closing) -> None:
    """
    Bore the lenses that need it: their faces get a hole, and the bore gets a wall like that of the edges.

    Parameters
    ----------
    table : OpticalSurfaces
        Optical surfaces, which are replaced. Notes are added on each bore, and on bores that are needed but impossible.
    closing : Closing
        Closed system, to which the walls are added.
    """
    walls = [piece for piece in closing.structures if isinstance(piece, Structure)]
    standing = _Standing([*_lens_faces(table), *walls])
    for body in _bodies(table):
        inside = standing.inside(body)
        legs = _out_of_turn(table, body)
        passing = max((widest for widest, _, _ in legs), default=0.0)
        radius = max([*(_CLEARANCE * r for r in inside.values()), passing * (1 + table.margin)], default=0.0)
        if radius == 0:
            continue
        # The hole that a mirror on the back of the lens has already
        radius = max(radius, body.lower.inner_semi_diameter, body.upper.inner_semi_diameter)
        glass = f"between '{body.lower.name}' and '{body.upper.name}'"
        guests = ", ".join(f"'{surface.name}'" for surface in _lens_faces(table) if surface.name in inside)
        if radius > min(_FULL_BORE * body.radius, _nearest_own_ray(table, body)):
            # A bore would take the light that the lens is there for
            if guests:
                table.notes.append(
                    f"{guests} lies in the glass {glass}, which leaves no room for a bore: check the table"
                )
            table.notes += [
                f"the lens {glass} stands in the beam on its way to surface {number} and takes {share} of it"
                for _, number, share in legs
            ]
            continue
        for k, surface in list(table.surfaces.items()):
            if surface.name in body.names and surface.semi_diameter is not None:
                table.surfaces[k] = replace(surface, inner_semi_diameter=radius)
        closing.structures.append(body.wall(radius, closing))
        standing = _Standing([*_lens_faces(table), *walls])
        what = guests or "the beam, which passes there"
        table.notes.append(f"the lens {glass} has a bore of radius {radius:.6g} mm for {what}")


def _lens_faces(table: OpticalSurfaces) -> list[Surface]:
    """Return the refracting surfaces of a table, each once though light may meet it several times."""
    return list({surface.name: surface for surface in table.surfaces.values() if not surface.mirror}.values())


def _bodies(table: OpticalSurfaces) -> list[_Body]:
    """Return the lens bodies with round faces on a common axis, without duplicates, the widest first."""
    found: dict[frozenset[str], _Body] = {}
    for j, k in pairwise(table.surfaces):
        a, b = table.surfaces[j], table.surfaces[k]
        if is_gas(table.behind[j]) or a.name == b.name or None in (a.semi_diameter, b.semi_diameter):
            continue
        if not on_axis(a.to_world(), b.to_world()):
            continue
        gap = float((np.linalg.inv(a.to_world()) @ b.to_world())[2, 3])
        low, high = (a, b) if gap >= 0 else (b, a)
        found.setdefault(frozenset((a.name, b.name)), _Body((j, k), low, high, abs(gap)))
    return sorted(found.values(), key=lambda body: -body.radius)


class _Standing:
    """Lens faces and walls with their frames and their extents along their axes, mm, to find those in a lens body."""

    def __init__(self, shapes: Sequence[Surface | Structure]) -> None:
        self.shapes = shapes
        self.frames = np.array([shape.to_world() for shape in shapes]).reshape(-1, 4, 4)
        heights = np.array([_profile(shape)[1] for shape in shapes]).reshape(-1, _SAMPLES)
        self.low, self.high = heights.min(axis=1, initial=np.inf), heights.max(axis=1, initial=-np.inf)

    def inside(self, body: _Body) -> dict[str, float]:
        """Return the shapes on a body's axis that lie in its glass, by name, with the largest radius there, mm."""
        frame = body.lower.to_world()
        low, high = body.extent
        z = (self.frames[:, :3, 3] - frame[:3, 3]) @ frame[:3, 2]
        result = {}
        for place in map(int, np.flatnonzero((z + self.high > low) & (z + self.low < high))):
            shape = self.shapes[place]
            if shape.name not in body.names and on_axis(frame, self.frames[place]):
                radius = body.reached(shape, float(z[place]))
                if radius > 0:
                    result[shape.name] = radius
        return result


def _out_of_turn(table: OpticalSurfaces, body: _Body) -> list[tuple[float, int, str]]:
    """
    Return the parts of the beam that cross a lens body out of sequence; none in a lens without mirrors.

    Each has its largest radius there, mm, the number of the row that it goes to, and its share of the light in words.
    """
    if not any(row.mirror for row in table.lens.rows):
        return []
    frame = body.lower.to_world()
    low, high = body.extent
    heights = (table.beam_and_rim - frame[:3, 3]) @ frame[:3, 2]
    faces = [(table.lens.rows[k], replace(table.surfaces[k], inner_semi_diameter=0.0)) for k in body.places]
    found = []
    for begin, end in table.segments():
        ends = {table.surfaces[k].name for k in (begin - 1, end - 1) if k in table.surfaces}
        way = heights[[begin, end]]
        beside = not (np.any(way < high) and np.any(way > low))
        if beside or ends & set(body.names):
            continue
        rays = table.beam_and_rim[begin], table.beam_and_rim[end]
        r = np.stack([met_at(row, face, *rays) for row, face in faces])
        met = np.isfinite(r[:, : len(table.blocked)]) & ~table.blocked
        if np.any(met):
            share = beam_shares(table)[met.any(axis=0)].sum()
            found.append((float(np.nanmax(r)), table.lens.rows[end - 1].number, percent(share)))
    return found


def _nearest_own_ray(table: OpticalSurfaces, body: _Body) -> float:
    """Return the least radius, mm, at which unblocked rays of the beam meet the faces of a body; inf if none does."""
    frame = body.lower.to_world()
    places = [k + 1 for k, surface in table.surfaces.items() if surface.name in body.names]
    local = (table.beam[places][:, ~table.blocked] - frame[:3, 3]) @ frame[:3, :3]
    return float(np.nanmin(np.hypot(local[..., 0], local[..., 1]), initial=np.inf))


def _profile(shape: Surface | Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return radii and z, both (m,) in mm, of points along the cross-section of a shape, in its own frame."""
    share = np.linspace(0.0, 1.0, _SAMPLES)
    if isinstance(shape, Structure):
        return shape.r0 + share * (shape.r1 - shape.r0), shape.z0 + share * (shape.z1 - shape.z0)
    r = shape.inner_semi_diameter + share * (shape.outer_radius - shape.inner_semi_diameter)
    return r, _sag(shape, r)


def _sag(surface: Surface, r: np.ndarray) -> np.ndarray:
    return np.asarray(surface.z_at(r) - surface.z)

"""Stated apertures of a sequential lens, converted to clips of its surfaces and to opaque plates."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mistray.physics.geometry.outline import Outline, circle
from mistray.physics.geometry.sag import conic_end
from mistray.prescription.coating import BLACK
from mistray.prescription.geometry import detector_frame
from mistray.prescription.model import Detector, Structure, Surface
from mistray.prescription.sequential.rays import curvature
from mistray.prescription.sequential.table import Row

Shape = Surface | Structure

_IN_FRONT_MM = 1e-3
_FIGURE_END = 0.999  # of the radius at which a conic ends
_PLATE = 1.25  # outer radius of a plate by that of its opening, where nothing in the lens is larger


def own_clip(row: Row) -> dict[str, Any]:
    """
    Return arguments of `Surface` for the clip that a row's apertures state, mm; empty if they state none.

    An ``outline`` may be unbounded: a radius must then be found to end the surface. A hole in the aperture of a lens is
    left out, since it becomes an opaque patch, see `aperture_pieces`. A hole in that of a mirror is kept.
    """
    fixed = row.semi_diameter if row.semi_diameter_fixed else None
    own: dict[str, Any] = {} if fixed is None else {"semi_diameter": fixed}
    aperture, _ = _clear_and_opaque(row)
    if aperture is None:
        return own
    ring, sides = aperture.annulus, aperture.sides
    if ring:
        own["semi_diameter"] = min(own.get("semi_diameter", math.inf), ring[0])
        return own | ({"inner_semi_diameter": ring[1]} if ring[1] else {})
    if sides and aperture.bounded and fixed is None:
        return {"half_width": sides[0], "half_height": sides[1]}
    hole = aperture.figures[0]
    if len(aperture.figures) == 1 and (hole.sign, hole.kind, hole.x, hole.y) == ("-", "circle", 0.0, 0.0):
        return own | {"inner_semi_diameter": hole.sizes[0]}
    return {"outline": aperture if fixed is None else aperture.within(fixed)}


def _clear_and_opaque(row: Row) -> tuple[Outline | None, list[Outline]]:
    """
    Return the clear outline of a row's aperture, None if it has none, and a row's opaque outlines.

    These are its obscuration and, but for a mirror, holes cut last into its aperture.
    """
    opaque = [] if row.obscuration is None else [row.obscuration]
    figures = () if row.aperture is None else row.aperture.figures
    while figures and not row.mirror and figures[-1].sign == "-":
        opaque.append(Outline((replace(figures[-1], sign="+"),)))
        figures = figures[:-1]
    return (Outline(figures) if figures else None), opaque


def aperture_pieces(
    row: Row, name: str, on_surface: bool, ahead: bool, widest: float, material: str
) -> tuple[list[Shape], list[str]]:
    """
    Make opaque plates in the frame of a row: obscurations, and openings of rows that are not optical surfaces.

    Parameters
    ----------
    row : Row
        Row that states the apertures.
    name : str
        Start of the names of the plates.
    on_surface : bool
        Whether the row refracts or reflects light. Then obscurations lie 1 µm before it, and no opening gets a plate.
    ahead : bool
        Whether light arrives along +z of the frame.
    widest : float
        Largest clear radius of the lens, to which plates with an opening extend, mm.
    material : str
        Material in front of the row, which surrounds the plates.

    Returns
    -------
    pieces : list of Surface or Structure
        Plates, in the frame of the row.
    notes : list of str
        Notes on approximations.
    """
    clear, opaque = _clear_and_opaque(row)
    before = -_IN_FRONT_MM if ahead else _IN_FRONT_MM
    pieces: list[Shape] = []
    notes: list[str] = []
    for number, outline in enumerate(opaque):
        own_name = f"{name}_obscuration" + (f"_{number + 1}" if number else "")
        patch = _patch(row, own_name, before if on_surface else 0.0, outline, widest)
        if patch is None:
            notes.append(f"surface {row.number}: no plate of an obscuration that lies beyond the rim of the lens")
        else:
            pieces.append(patch)
    fixed = row.semi_diameter if row.semi_diameter_fixed else None
    if not on_surface and (clear is not None or fixed):
        if clear is None:
            assert fixed is not None
            clear, fixed = circle(fixed), None
        pieces += _plate(row.number, name, clear, widest, notes)
        if fixed:
            pieces += _plate(row.number, f"{name}_rim", circle(fixed), widest, notes)
        if curvature(row) or row.coefficients or row.sag:
            notes.append(f"surface {row.number}: the plate of its aperture is flat, the surface is not")
    return [replace(piece, front=material, back=material) for piece in pieces], notes


def _plate(number: int, name: str, clear: Outline, widest: float, notes: list[str]) -> list[Shape]:
    """
    Return flat opaque faces around the opening `clear`, out to at least the radius `widest`, mm.

    The list is empty if figures cannot express the face around the opening. `name` starts the names of the faces.
    Remarks are added to `notes`, with the `number` of the row.
    """
    first = clear.figures[0]
    if not clear.bounded:
        notes.append(f"surface {number}: its aperture has no end on one side; a plate of {widest:.6g} mm ends it")
        clear = clear.within(widest)
    if len(clear.figures) == 1 and first.kind == "circle":
        outer = max(widest + math.hypot(first.x, first.y), _PLATE * first.sizes[0])
        own = f"{name}_aperture"
        return [Structure(own, outer, 0.0, first.sizes[0], 0.0, x=first.x, y=first.y, part=own)]
    if len(clear.figures) == 1 and first.kind == "rectangle" and not first.angle_deg:
        window = Detector(half_width=first.sizes[0], half_height=first.sizes[1])
        outer = max(widest + math.hypot(first.x, first.y), _PLATE * window.outer_radius)
        frame = detector_frame(window, outer, name=f"{name}_frame")
        return [replace(piece, x=piece.x + first.x, y=piece.y + first.y) for piece in frame]
    x0, x1, y0, y1 = clear.bounds()
    around = clear.around(max(widest, _PLATE * math.hypot(max(-x0, x1), max(-y0, y1))))
    if around is None:
        notes.append(f"surface {number}: the part of its aperture that two figures share has no plate around it")
        return []
    return [Surface(f"{name}_aperture", outline=around, coating=BLACK, part=f"{name}_aperture")]


def _patch(row: Row, name: str, z: float, opaque: Outline, widest: float) -> Surface | None:
    """
    Return an opaque surface with the shape of a row and the outline `opaque`, its vertex at `z` in the row's frame, mm.

    An outline that extends beyond the radius `widest`, mm, is cut there, unless it is a circle or an annulus. All are
    cut where the conic ends. The result is None if nothing is left.
    """
    own: dict[str, Any] = {"radius": row.radius, "conic": row.conic, "coefficients": row.coefficients, "sag": row.sag}
    ring, end = opaque.annulus, _FIGURE_END * conic_end(curvature(row), row.conic)
    if ring and opaque.bounded and ring[1] < end:
        return Surface(name, z=z, coating=BLACK, semi_diameter=min(ring[0], end), inner_semi_diameter=ring[1], **own)
    opaque = ended(opaque, min(max(widest, row.semi_diameter or 0.0), end))
    if opaque.empty:
        return None
    if opaque.sides:
        half_width, half_height = opaque.sides
        return Surface(name, z=z, coating=BLACK, half_width=half_width, half_height=half_height, **own)
    return Surface(name, z=z, coating=BLACK, outline=opaque, **own)


def ended(outline: Outline, radius: float) -> Outline:
    """Return an outline, cut at a circle about the origin if it extends beyond it; the radius is in mm."""
    x0, x1, y0, y1 = outline.bounds()
    return outline.within(radius) if math.hypot(max(-x0, x1), max(-y0, y1)) > radius else outline

"""The apertures that a sequential lens states, as clips of its surfaces and as opaque plates."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mistray.physics.geometry.sag import sag
from mistray.prescription.coating import BLACK
from mistray.prescription.geometry import detector_frame
from mistray.prescription.model import Detector, Structure, Surface
from mistray.prescription.sequential.rays import curvature
from mistray.prescription.sequential.table import Row

Shape = Surface | Structure

_IN_FRONT_MM = 1e-3
_PLATE = 1.25  # outer radius of a plate by that of its opening, where nothing in the lens is larger


def own_clip(row: Row) -> tuple[dict[str, Any], str]:
    """
    The clip that a row's own apertures give its surface.

    Returns
    -------
    clip : dict
        ``semi_diameter`` or ``half_width`` and ``half_height``, and ``inner_semi_diameter`` of a mirror; empty where
        nothing is stated.
    note : str
        What differs from the file, "" if nothing.
    """
    fixed = row.semi_diameter if row.semi_diameter_fixed else None
    own: dict[str, Any] = {} if fixed is None else {"semi_diameter": fixed}
    aperture = row.aperture
    if aperture is None or aperture.obscures:
        return own, ""
    off = math.hypot(aperture.x, aperture.y)
    note = ""
    if off > 0:
        note = (
            f"surface {row.number}: its aperture is centred at ({aperture.x:g}, {aperture.y:g}) mm; here the surface "
            "is the ring or disc around its vertex that holds it"
        )
    x, y = abs(aperture.x), abs(aperture.y)
    if aperture.kind == "rectangle":
        sides = {"half_width": aperture.half_width + x, "half_height": aperture.half_height + y}
        if not all(map(math.isfinite, sides.values())):
            return own, f"surface {row.number}: its rectangular aperture has no end on one side and is left out"
        nearest = math.hypot(max(x - aperture.half_width, 0.0), max(y - aperture.half_height, 0.0))
        if row.mirror and nearest > 0:
            return {"semi_diameter": math.hypot(*sides.values()), "inner_semi_diameter": nearest}, note
        return sides, note
    if math.isfinite(aperture.outer):
        own["semi_diameter"] = min(own.get("semi_diameter", math.inf), aperture.outer + off)
    if row.mirror and (off > aperture.outer or (aperture.inner > 0 and off == 0)):
        own["inner_semi_diameter"] = off - aperture.outer if off else aperture.inner
    return own, note


def aperture_pieces(
    row: Row, name: str, on_surface: bool, ahead: bool, widest: float, material: str
) -> tuple[list[Shape], list[str]]:
    """
    Opaque plates in the frame of a row: obscurations, and openings of rows that are no optical surface.

    Parameters
    ----------
    row : Row
    name : str
        Start of the names.
    on_surface : bool
        The row bends or reflects light, so that plates lie 1 µm before it.
    ahead : bool
        Whether light arrives along +z of the frame.
    widest : float
        Greatest clear radius of the lens, mm, to which plates with an opening reach.
    material : str
        In front of the row, in which the plates stand.

    Returns
    -------
    pieces, notes
    """
    aperture = row.aperture
    pieces: list[Shape] = []
    notes: list[str] = []
    before = -_IN_FRONT_MM if ahead else _IN_FRONT_MM
    if aperture is not None and aperture.obscures:
        pieces.append(_patch(row, f"{name}_obscuration", before if on_surface else 0.0, ahead))
    elif aperture is not None and aperture.kind == "circle" and aperture.inner > 0 and not (on_surface and row.mirror):
        disc = replace(row, aperture=replace(aperture, inner=0.0, outer=aperture.inner, obscures=True))
        pieces.append(_patch(disc, f"{name}_obscuration", before if on_surface else 0.0, ahead))
    if on_surface:
        return [replace(piece, front=material, back=material) for piece in pieces], notes
    opening, x, y = row.semi_diameter if row.semi_diameter_fixed else None, 0.0, 0.0
    if aperture is not None and not aperture.obscures:
        x, y = aperture.x, aperture.y
        if aperture.kind == "rectangle":
            window = Detector(half_width=aperture.half_width, half_height=aperture.half_height)
            outer = max(widest, _PLATE * window.outer_radius)
            frame = detector_frame(window, outer, name=f"{name}_frame")
            pieces += [replace(piece, x=piece.x + x, y=piece.y + y) for piece in frame]
        elif math.isfinite(aperture.outer):
            opening = min(opening or math.inf, aperture.outer)
    if opening:
        outer = max(widest, _PLATE * opening)
        pieces.append(Structure(f"{name}_aperture", outer, 0.0, opening, 0.0, x=x, y=y, part=f"{name}_aperture"))
        if curvature(row) or row.coefficients:
            notes.append(f"surface {row.number}: the plate of its aperture is flat, the surface is not")
    return [replace(piece, front=material, back=material) for piece in pieces], notes


def _patch(row: Row, name: str, z: float, ahead: bool) -> Surface:
    """An opaque patch on the figure of a row; flat, in front of it, where it is off the axis."""
    aperture = row.aperture
    assert aperture is not None
    clip: dict[str, Any]
    if aperture.kind == "circle":
        clip = {"semi_diameter": aperture.outer, "inner_semi_diameter": aperture.inner}
        reach = aperture.outer
    else:
        clip = {"half_width": aperture.half_width, "half_height": aperture.half_height}
        reach = math.hypot(aperture.half_width, aperture.half_height)
    off = math.hypot(aperture.x, aperture.y)
    if off == 0:
        own: dict[str, Any] = {"radius": row.radius, "conic": row.conic, "coefficients": row.coefficients}
        return Surface(name, z=z, coating=BLACK, **clip, **own)
    radii = (max(0.0, off - reach), off + reach)
    heights = [float(sag(r * r, curvature(row), row.conic, row.coefficients)) for r in radii]
    z += min(heights) if ahead else max(heights)
    return Surface(name, x=aperture.x, y=aperture.y, z=z, coating=BLACK, **clip)

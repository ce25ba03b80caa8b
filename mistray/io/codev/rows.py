"""Rows of a lens table from the surfaces of a CODE V file: units, moves that bend the axis, apertures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from mistray.io.codev.commands import Command
from mistray.prescription.sequential.table import ClearAperture, Decentre, Row, Unread


@dataclass
class CodevSurface:
    """
    A surface in units of the file, as far as it has been read.

    Attributes
    ----------
    line : int
    curvature, thickness, conic : float
    material : str
        Material string behind it; "" for the medium in front of a mirror, else air.
    mirror : bool
    label : str
    coefficients : dict of int to float
        0: of r⁴, 1: of r⁶, …
    moves : dict of str to float
        By the first letters of XDE … CDE.
    mode : str
        "", "DAR", "REV" or "BEN".
    apertures : dict
        "CLR", "EDG", "OBS" or "HOL" → "CIR", "REX", … → size and where it stands.
    offset : dict of str to float
        Of the aperture, "X" and "Y".
    """

    line: int
    curvature: float = 0.0
    thickness: float = 0.0
    material: str = ""
    mirror: bool = False
    label: str = ""
    conic: float = 0.0
    coefficients: dict[int, float] = field(default_factory=dict)
    moves: dict[str, float] = field(default_factory=dict)
    mode: str = ""
    apertures: dict[str, dict[str, tuple[float, Command]]] = field(default_factory=dict)
    offset: dict[str, float] = field(default_factory=dict)


def rows_of(
    surface: CodevSurface, number: int, *, unit_mm: float, before: str, unread: list[Unread], **more: Any
) -> list[Row]:
    """
    The row of a surface, and a coordinate break behind it where REV or BEN move what follows.

    Parameters
    ----------
    surface, number
        The surface and its number.
    unit_mm : float
        The unit of length.
    before : str
        Material in front of it.
    unread : list of Unread
        Grows by the apertures that have no counterpart.
    **more
        Further fields of the row, as ``stop``.
    """
    material = before if surface.mirror else surface.material or "air"
    orders = range(max(surface.coefficients, default=-1) + 1)
    coefficients = [surface.coefficients.get(k, 0.0) / unit_mm ** (2 * k + 3) for k in orders]
    while coefficients and coefficients[-1] == 0:
        coefficients.pop()
    ahead, behind = _moves(surface, unit_mm)
    thickness = surface.thickness * unit_mm
    row = Row(
        number,
        label=surface.label,
        radius=unit_mm / surface.curvature if surface.curvature else math.inf,
        conic=surface.conic,
        coefficients=tuple(coefficients),
        thickness=0.0 if behind else thickness,
        material=material,
        mirror=surface.mirror,
        decentre=ahead,
        line=surface.line,
        **(_apertures(surface, unit_mm, unread) | more),
    )
    if behind is None:
        return [row]
    turn = Row(
        number, kind="coordinate_break", thickness=thickness, material=material, decentre=behind, line=surface.line
    )
    return [row, turn]


def _moves(surface: CodevSurface, unit_mm: float) -> tuple[Decentre | None, Decentre | None]:
    """
    The moves of the frame before and behind a surface.

    With R the turn of the surface, REV has the inverse of (shift, R) behind it. BEN: the old axis ẑ is R⁻¹ẑ in the
    frame of the surface, its reflection there (half a turn of it about z) is R_z(-γ) R_y(β) R_x(α) ẑ, since
    R = R_x(α) R_y(β) R_z(γ): the same angles, but γ, in the opposite order.
    """
    if not any(surface.moves.values()):
        return None, None
    x, y, z = (surface.moves.get(axis, 0.0) * unit_mm for axis in "XYZ")
    a, b, c = (surface.moves.get(angle, 0.0) * sign for angle, sign in (("A", -1), ("B", -1), ("C", 1)))
    move = Decentre(x=x, y=y, z=z, tilt_deg=(a, b, c), returns=surface.mode == "DAR")
    if surface.mode == "REV":
        return None, Decentre(x=-x, y=-y, z=-z, tilt_deg=(-a, -b, -c), tilt_first=True)
    if surface.mode == "BEN" and (a or b or c):
        return move, Decentre(tilt_deg=(a, b, -c), tilt_first=True)
    return move, None


def _apertures(surface: CodevSurface, unit_mm: float, unread: list[Unread]) -> dict[str, Any]:
    """Semi-diameter and aperture of a row; what does not fit into one of each is listed."""
    given = {kind: {key: pair[0] * unit_mm for key, pair in s.items()} for kind, s in surface.apertures.items()}
    x, y = (surface.offset.get(axis, 0.0) * unit_mm for axis in "XY")
    result: dict[str, Any] = {}

    def skip(kind: str, reason: str) -> None:
        for _, command in surface.apertures.get(kind, {}).values():
            unread.append(Unread(command.line, command.text, reason))

    clear, hole, obscuration = (_outline(given.get(kind, {})) for kind in ("CLR", "HOL", "OBS"))
    edge = given.get("EDG", {}).get("CIR")
    for kind, outline in (("CLR", clear), ("HOL", hole), ("OBS", obscuration)):
        if kind in given and outline is None:
            skip(kind, "an elliptical aperture has no counterpart: nothing is clipped there")
    if clear and "outer" in clear and not (x or y):
        result = {"semi_diameter": clear["outer"], "semi_diameter_fixed": True}
    elif clear:
        result = {"aperture": ClearAperture(**clear, x=x, y=y)}
    elif edge and not (x or y):
        result = {"semi_diameter": edge}
    if clear:
        skip("EDG", "the edge of the body; edges are generated from clear apertures")
    elif "semi_diameter" not in result:
        skip("EDG", "the edge of the body is not round; edges are generated from clear apertures")
    if hole:
        if "outer" in hole and "aperture" not in result and not (x or y):
            result["aperture"] = ClearAperture(inner=hole["outer"], outer=result.get("semi_diameter", math.inf))
        else:
            skip("HOL", "a hole that is not round, or beside another aperture, has no counterpart: the surface is full")
    if obscuration:
        if "aperture" not in result:
            shift: dict[str, Any] = {} if clear else {"x": x, "y": y}
            result["aperture"] = ClearAperture(**obscuration, **shift, obscures=True)
        else:
            skip("OBS", "one aperture a surface is kept: this obscuration stops nothing")
    return result


def _outline(sizes: dict[str, float]) -> dict[str, Any] | None:
    """Arguments of a `ClearAperture`; None if there is none or it is an ellipse."""
    if "CIR" in sizes:
        return {"outer": sizes["CIR"]}
    if "REX" in sizes or "REY" in sizes:
        half = {"half_width": sizes.get("REX", math.inf), "half_height": sizes.get("REY", math.inf)}
        return {"kind": "rectangle", **half}
    if "ELX" in sizes and sizes["ELX"] == sizes.get("ELY"):
        return {"outer": sizes["ELX"]}
    return None

"""Conversion of CODE V surfaces to rows of a lens table: units, moves of the axis, apertures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from mistray.errors import MistrayError
from mistray.io.codev.commands import SeqCommand
from mistray.io.codev.sags import sag_of
from mistray.physics.geometry.outline import ALL, Outline, OutlineFigure
from mistray.physics.geometry.sag import trimmed
from mistray.prescription.sequential.table import Decentre, Row, Unread


@dataclass
class CodevSurface:
    """
    Surface of a CODE V file, in units of the file, completed as the file is read.

    Attributes
    ----------
    line : int
        Line number of the surface in the file.
    curvature, thickness, conic : float
        Curvature in y (1/unit), thickness (unit) and conic constant.
    material : str
        Material string behind the surface; "" means the medium in front of a mirror, else air.
    mirror : bool
        Whether the surface reflects.
    label : str
        Label of the surface.
    coefficients : dict of int to float
        Aspheric coefficients: key 0 for r⁴ (1/unit³), 1 for r⁶ (1/unit⁵), …
    kind : str
        Surface type: "" or one of `sags.KINDS`.
    curvature_x : float
        Curvature in x, 1/unit.
    extra : dict of str to float
        Further coefficients of the surface type, in units of the file, by command name.
    moves : dict of str to float
        Shifts (unit) and tilts (degrees), keyed by the first letters of XDE … CDE.
    mode : str
        Mode of the move: "", "DAR", "REV" or "BEN".
    apertures : dict
        "CLR", "EDG", "OBS" or "HOL" → "CIR", "REX", … → size (unit) and its command.
    offset : dict of str to float
        Centre of the apertures, "X" and "Y" (unit), and their rotation, "O" (degrees); "CLRX" is for one kind of
        aperture only.
    """

    line: int
    curvature: float = 0.0
    thickness: float = 0.0
    material: str = ""
    mirror: bool = False
    label: str = ""
    conic: float = 0.0
    coefficients: dict[int, float] = field(default_factory=dict)
    kind: str = ""
    curvature_x: float = 0.0
    extra: dict[str, float] = field(default_factory=dict)
    moves: dict[str, float] = field(default_factory=dict)
    mode: str = ""
    apertures: dict[str, dict[str, tuple[float, SeqCommand]]] = field(default_factory=dict)
    offset: dict[str, float] = field(default_factory=dict)


def rows_of(
    surface: CodevSurface, number: int, *, unit_mm: float, before: str, unread: list[Unread], **more: Any
) -> list[Row]:
    """
    Return the row of a surface, and a coordinate break behind it if REV or BEN moves the surfaces that follow.

    Parameters
    ----------
    surface, number
        Surface, and its number as counted by the file.
    unit_mm : float
        Length of the file's unit, mm.
    before : str
        Material in front of the surface.
    unread : list of Unread
        List to which apertures without a counterpart are added.
    **more
        Further fields of the row, such as ``stop``.

    Raises
    ------
    MistrayError
        If an XTO is tilted or decentred, or a coefficient of the surface type is unknown.
    """
    material = before if surface.mirror else surface.material or "air"
    orders = range(max(surface.coefficients, default=-1) + 1)
    coefficients = trimmed(surface.coefficients.get(k, 0.0) / unit_mm ** (2 * k + 3) for k in orders)
    ahead, behind = _moves(surface, unit_mm)
    thickness = surface.thickness * unit_mm
    sag = sag_of(surface.kind, surface.curvature_x, surface.conic, surface.extra, unit_mm) if surface.kind else {}
    clips = _apertures(surface, unit_mm, unread)
    curvature = surface.curvature
    if surface.kind == "XTO":  # a YTO in a frame that is turned by 90 degrees
        if ahead or behind:
            raise MistrayError(f"surface {number}: an XTO that is tilted or decentred is not read; make it a YTO")
        ahead = Decentre(tilt_deg=(0.0, 0.0, 90.0), returns=True)
        curvature, sag = surface.curvature_x, {"toroid_curvature": surface.curvature / unit_mm}
        clips |= {key: clips[key].turned(-90.0) for key in ("aperture", "obscuration") if clips.get(key)}
    row = Row(
        number,
        label=surface.label,
        radius=unit_mm / curvature if curvature else math.inf,
        conic=surface.conic,
        coefficients=coefficients,
        sag=sag,
        thickness=0.0 if behind else thickness,
        material=material,
        mirror=surface.mirror,
        decentre=ahead,
        line=surface.line,
        **(clips | more),
    )
    if behind is None:
        return [row]
    turn = Row(
        number, kind="coordinate_break", thickness=thickness, material=material, decentre=behind, line=surface.line
    )
    return [row, turn]


def _moves(surface: CodevSurface, unit_mm: float) -> tuple[Decentre | None, Decentre | None]:
    """
    Return the moves of the frame, mm and degrees, before and behind a surface; None where there is no such move.

    R = R_x(α) R_y(β) R_z(γ) is the rotation of the surface. REV applies the inverse of (shift, R) behind the surface.
    For BEN, the old axis ẑ is R⁻¹ẑ in the frame of the surface. Its reflection there, a half turn about z, is
    R_z(-γ) R_y(β) R_x(α) ẑ. So the angles α, β and -γ apply in the opposite order.
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
    """
    Return semi-diameter, aperture and obscuration, mm, as arguments of `Row`.

    Apertures that it cannot hold are added to `unread`.
    """
    given = {kind: {key: pair[0] * unit_mm for key, pair in s.items()} for kind, s in surface.apertures.items()}
    result: dict[str, Any] = {}

    def skip(kind: str, reason: str) -> None:
        for _, command in surface.apertures.get(kind, {}).values():
            unread.append(Unread(command.line, command.text, reason))

    def figures(kind: str) -> list[OutlineFigure]:
        x, y, angle = (surface.offset.get(kind + axis, surface.offset.get(axis, 0.0)) for axis in "XYO")
        return [
            replace(f, x=x * unit_mm, y=y * unit_mm, angle_deg=0.0 if f.kind == "circle" else angle)
            for f in _figures(given.get(kind, {}))
        ]

    clear, holes, opaque = (figures(kind) for kind in ("CLR", "HOL", "OBS"))
    shape = [replace(f, sign="&" if k else "+") for k, f in enumerate(clear)] + [replace(f, sign="-") for f in holes]
    if shape:
        outline = Outline(tuple(shape))
        ring = outline.annulus
        if clear and ring:
            result = {"semi_diameter": ring[0], "semi_diameter_fixed": True}
        if not (ring and ring[1] == 0):
            result["aperture"] = outline
    edge = figures("EDG")
    if clear:
        skip("EDG", "the edge of the body; edges are generated from clear apertures")
    elif edge and Outline((edge[0],)).annulus:
        result["semi_diameter"] = edge[0].sizes[0]
    else:
        skip("EDG", "the edge of the body is not round; edges are generated from clear apertures")
    if opaque:
        result["obscuration"] = Outline(tuple(opaque))
    return result


def _figures(sizes: dict[str, float]) -> list[OutlineFigure]:
    """
    Return outline figures, mm, for the sizes, mm by keyword, of one kind of aperture, centred at the origin.

    A half size that is missing is unlimited for a rectangle, and equal to the other one for an ellipse.
    """
    found = []
    if "CIR" in sizes:
        found.append(OutlineFigure("circle", sizes=(sizes["CIR"],)))
    if "REX" in sizes or "REY" in sizes:
        found.append(OutlineFigure("rectangle", sizes=(sizes.get("REX", ALL), sizes.get("REY", ALL))))
    if "ELX" in sizes or "ELY" in sizes:
        a, b = (sizes.get(key, sizes.get(other, 0.0)) for key, other in (("ELX", "ELY"), ("ELY", "ELX")))
        found.append(OutlineFigure("ellipse", sizes=(a, b)) if a != b else OutlineFigure("circle", sizes=(a,)))
    return found

"""Conversion of batoid's obscurations to outlines in mm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from mistray.errors import MistrayError
from mistray.physics.geometry.outline import Outline, OutlineFigure

M_TO_MM = 1e3


def clear_outline(obscuration: Any, radius: float, owner: str) -> Outline:
    """
    Return the outline, mm, that an obscuration on a surface leaves clear.

    Parameters
    ----------
    obscuration : batoid.obscuration.Obscuration or None
        Obscuration on the surface; None leaves the whole disc clear.
    radius : float
        Radius at which the clear area ends if the obscuration sets no limit, m.
    owner : str
        Name of the element, for messages.

    Raises
    ------
    MistrayError
        If the obscuration has no counterpart, or figures cannot express the clear area.
    """
    return _outline(obscuration, radius, owner, clear=True)


def opaque_outlines(obscuration: Any, radius: float, owner: str) -> list[Outline]:
    """
    Return the outlines, mm, that an obscuration covers, one for each of its parts; they may overlap.

    Parameters
    ----------
    obscuration : batoid.obscuration.Obscuration or None
        Obscuration of a baffle.
    radius : float
        Radius at which the covered area ends if the obscuration sets no limit, m.
    owner : str
        Name of the element, for messages.

    Raises
    ------
    MistrayError
        If a part of the obscuration has no counterpart, or figures cannot express the covered area.
    """
    return [_outline(part, radius, owner, clear=negated) for part, negated in _parts(obscuration)]


def _outline(obscuration: Any, radius: float, owner: str, clear: bool) -> Outline:
    """Return the clear or covered area of an obscuration as an outline, mm; see `clear_outline`, `opaque_outlines`."""
    figures = _figures(obscuration, radius, owner, clear)
    if figures[0].sign == "-":
        figures = [OutlineFigure("circle", sizes=(radius * M_TO_MM,)), *figures]
    return Outline(tuple(figures))


def is_open(obscuration: Any, negated: bool = False) -> bool:
    """True if an obscuration, or the rest of the plane if `negated`, has no outer limit of its own."""
    kind = type(obscuration).__name__
    if kind == "ObscNegation":
        return is_open(obscuration.original, not negated)
    if kind in ("ObscUnion", "ObscIntersection"):
        some = any if (kind == "ObscUnion") != negated else all
        return some(is_open(item, negated) for item in obscuration.items)
    return negated or kind == "ObscRay"


def _parts(obscuration: Any, negated: bool = False) -> Iterator[tuple[Any, bool]]:
    """Yield parts whose union is an obscuration, or the rest of the plane if `negated`; each with its own `negated`."""
    kind = type(obscuration).__name__
    if kind == "ObscNegation":
        yield from _parts(obscuration.original, not negated)
    elif kind == ("ObscIntersection" if negated else "ObscUnion"):
        for item in obscuration.items:
            yield from _parts(item, negated)
    elif obscuration is not None:
        yield obscuration, negated


def _figures(obscuration: Any, radius: float, owner: str, clear: bool) -> list[OutlineFigure]:
    """
    Return the clear area of an obscuration, or the covered area without `clear`, as figures, mm.

    If the first figure is cut away, the area is the rest of a disc of `radius`, m. Raise `MistrayError`, which names
    the element `owner`, if figures cannot express the area.
    """
    kind = type(obscuration).__name__
    if obscuration is None:
        return [OutlineFigure("circle", "+" if clear else "-", sizes=(radius * M_TO_MM,))]
    if kind == "ObscNegation":
        return _figures(obscuration.original, radius, owner, not clear)
    if kind in ("ObscUnion", "ObscIntersection"):  # what a union leaves clear is the intersection of what its items do
        areas = [_figures(item, radius, owner, clear) for item in obscuration.items]
        return _combined(areas, (kind == "ObscUnion") == clear, owner)
    if kind == "ObscAnnulus":
        outer, inner = (_circle(obscuration, value) for value in (obscuration.outer, obscuration.inner))
        if not clear:
            return [_signed(outer, "+"), *([_signed(inner, "-")] if obscuration.inner > 0 else [])]
        return [_signed(outer, "-"), _signed(inner, "+")] if obscuration.inner > 0 else [_signed(outer, "-")]
    figure = _single(obscuration, kind, radius, owner)
    return [_signed(figure, "-" if clear else "+")]


def _combined(areas: list[list[OutlineFigure]], meet: bool, owner: str) -> list[OutlineFigure]:
    """
    Return the intersection of areas with `meet`, else their union, as one list of figures.

    An area that figures can express only at the start of a list comes first. Raise `MistrayError` if there are two such
    areas; `owner` is the name of the element for the message.
    """

    def narrowing(area: list[OutlineFigure]) -> list[OutlineFigure]:
        return [_signed(area[0], "&"), *area[1:]] if meet and area[0].sign == "+" else area

    def leads(area: list[OutlineFigure]) -> bool:
        return any((figure.sign == "+") == meet for figure in narrowing(area))

    start, *others = sorted(areas, key=lambda area: (not leads(area), area[0].sign == "-"))
    if any(map(leads, others)):
        raise MistrayError(f"{owner}: the area of its obscuration is not a list of figures; split the obscuration")
    return [*start, *(figure for area in others for figure in narrowing(area))]


def _single(obscuration: Any, kind: str, radius: float, owner: str) -> OutlineFigure:
    if kind == "ObscCircle":
        return _circle(obscuration, obscuration.radius)
    if kind == "ObscRectangle":
        sizes = (0.5 * obscuration.width * M_TO_MM, 0.5 * obscuration.height * M_TO_MM)
        angle = math.degrees(obscuration.theta)
        return OutlineFigure("rectangle", "+", obscuration.x * M_TO_MM, obscuration.y * M_TO_MM, angle, sizes)
    if kind == "ObscPolygon":
        corners = [float(v) * M_TO_MM for corner in zip(obscuration.xs, obscuration.ys, strict=True) for v in corner]
        if corners[:2] == corners[-2:]:
            corners = corners[:-2]
        return OutlineFigure("polygon", sizes=tuple(corners))
    if kind == "ObscRay":  # half a strip, as long as the surface needs
        x, y, theta = obscuration.x, obscuration.y, obscuration.theta
        half = 0.5 * (radius + math.hypot(x, y))
        middle = x + half * math.cos(theta), y + half * math.sin(theta)
        sizes = (half * M_TO_MM, 0.5 * obscuration.width * M_TO_MM)
        return OutlineFigure("rectangle", "+", middle[0] * M_TO_MM, middle[1] * M_TO_MM, math.degrees(theta), sizes)
    raise MistrayError(f"{owner}: obscuration {kind} has no counterpart; use circles, rectangles, polygons and rays")


def _circle(obscuration: Any, radius: float) -> OutlineFigure:
    return OutlineFigure("circle", "+", obscuration.x * M_TO_MM, obscuration.y * M_TO_MM, sizes=(radius * M_TO_MM,))


def _signed(figure: OutlineFigure, sign: str) -> OutlineFigure:
    return OutlineFigure(figure.kind, sign, figure.x, figure.y, figure.angle_deg, figure.sizes)

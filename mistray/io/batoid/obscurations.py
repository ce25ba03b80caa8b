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
    Return the outline that an obscuration on a surface leaves clear.

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
    Return the outlines that an obscuration covers, one for each of its parts; they may overlap.

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
    return [_outline(part, radius, owner, clear=False) for part in _parts(obscuration)]


def _outline(obscuration: Any, radius: float, owner: str, clear: bool) -> Outline:
    """Return the clear or covered area of an obscuration as an outline, mm; it ends at `radius`, m, if unlimited."""
    figures = _figures(obscuration, radius, owner, clear)
    if figures[0].sign == "-":
        figures = [OutlineFigure("circle", sizes=(radius * M_TO_MM,)), *figures]
    return Outline(tuple(figures))


def is_open(obscuration: Any) -> bool:
    """True if an obscuration is opaque everywhere except in an opening, so that it has no outer limit."""
    kind = type(obscuration).__name__
    if kind == "ObscUnion":
        return any(is_open(item) for item in obscuration.items)
    return kind in ("ObscNegation", "ObscRay")


def _parts(obscuration: Any) -> Iterator[Any]:
    if type(obscuration).__name__ == "ObscUnion":
        for item in obscuration.items:
            yield from _parts(item)
    elif obscuration is not None:
        yield obscuration


def _figures(obscuration: Any, radius: float, owner: str, clear: bool) -> list[OutlineFigure]:
    """
    Return the clear area of an obscuration, or the covered area without `clear`, as figures, mm.

    If the first figure is cut away, the area is the rest of a disc of `radius`, m. Raise `MistrayError` if figures
    cannot express the area.
    """
    kind = type(obscuration).__name__
    if obscuration is None:
        return [OutlineFigure("circle", "+" if clear else "-", sizes=(radius * M_TO_MM,))]
    if kind == "ObscNegation":
        return _figures(obscuration.original, radius, owner, not clear)
    if kind == "ObscUnion" and clear:  # clear where none of them covers
        figures: list[OutlineFigure] = []
        for item in sorted(obscuration.items, key=lambda item: not is_open(item)):
            figures += _within(_figures(item, radius, owner, clear=True), figures, owner)
        return figures
    if kind == "ObscIntersection" and not clear:
        figures = []
        for item in obscuration.items:
            figures += _within(_figures(item, radius, owner, clear=False), figures, owner)
        return figures
    if kind == "ObscAnnulus":
        outer, inner = (_circle(obscuration, value) for value in (obscuration.outer, obscuration.inner))
        if not clear:
            return [_signed(outer, "+"), *([_signed(inner, "-")] if obscuration.inner > 0 else [])]
        return [_signed(outer, "-"), _signed(inner, "+")] if obscuration.inner > 0 else [_signed(outer, "-")]
    figure = _single(obscuration, kind, radius, owner)
    return [_signed(figure, "-" if clear else "+")]


def _within(parts: list[OutlineFigure], before: list[OutlineFigure], owner: str) -> list[OutlineFigure]:
    """
    Return figures `parts` with "+" replaced by "&", so that they narrow the area of the figures before them.

    Without figures before they stay. Raise `MistrayError` if a later part adds an area.
    """
    if not before:
        return parts
    if any(figure.sign == "+" for figure in parts[1:]):
        raise MistrayError(f"{owner}: what its obscuration leaves clear is no list of figures; split the obscuration")
    return [_signed(figure, "&") if figure.sign == "+" else figure for figure in parts]


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

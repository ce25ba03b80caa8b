"""Drawing of the optical system's section with critical, illuminated and common objects in colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mistray.analyses.objects.result import Objects
from mistray.toolkit.drawings.section_layout import (
    GLASS,
    GLASS_EDGE,
    Polyline,
    SectionLine,
    bounds,
    glass_bodies,
    section,
)
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.figures.palette import BLUE, GREEN, PURPLE, VERMILION

UNMET = "#b5b5b5"
# Group: how the legend calls it, colour, width, dashes, order of drawing
STYLES: dict[str, tuple[str, str, float, str, int]] = {
    "common": ("common: critical and illuminated", VERMILION, 2.6, "-", 7),
    "apart": ("both, but on other sides or places", PURPLE, 2.0, "-", 6),
    "critical": ("critical: the detector sees it", BLUE, 1.9, "-", 5),
    "illuminated": ("illuminated from outside", GREEN, 1.9, "-", 4),
    "optics": ("optics", GLASS_EDGE, 0.9, "-", 3),
    "neither": ("neither", UNMET, 1.2, "-", 2),
}
LABELS = 16  # common objects with a name in the picture, the strongest
LABEL_HEIGHT = 0.62  # room for the names above the system, inches for each tenth letter


def groups(found: Objects) -> dict[str, str]:
    """
    Return the colour group (a key of `STYLES`) of each shape by id; its sides count together.

    A shape is "common" if one of its sides is, else "optics" if it is on the design path. Else it is "apart" if it is
    both seen and lit, on different sides or places.
    """
    seen = {row.id for row in found.critical}
    lit = {row.id for row in found.illuminated}
    both = {row.id for row in found.common}
    optics = {row.id for row in found.optics}

    def group(name: str) -> str:
        if name in both:
            return "common"
        if name in optics:
            return "optics"
        if name in seen and name in lit:
            return "apart"
        return "critical" if name in seen else "illuminated" if name in lit else "neither"

    return {line.name: group(line.name) for line in section(found.scene)}


def objects_layout(found: Objects, title: str = "") -> Figure:
    """
    Draw the system cut by the plane x = 0, with surfaces coloured as critical, illuminated, common or neither.

    Parameters
    ----------
    found : Objects
        Result of the search for objects.
    title : str
        Name of the optical system.

    Examples
    --------
    >>> found = mistray.objects(mistray.load("cassegrain"), rays=2000)
    >>> figure = mistray.report.objects_layout(found, title="Cassegrain telescope")
    >>> figure.savefig("objects.png")
    """
    lines = section(found.scene)
    low, high = bounds(lines)
    size = np.maximum(high - low, 1e-9)
    width = 10.4
    weight = {row.id: row.critical_power * row.illuminated_power for row in found.common}
    labels = sorted(weight, key=lambda name: -weight[name])[:LABELS]
    above = LABEL_HEIGHT * max((len(name) for name in labels), default=0) / 10 + 0.3
    drawn = float(np.clip(0.92 * width * size[1] / size[0], 1.6, 6.6))
    figure, axes = Figure.of_panels(width, drawn + above + 1.0, dpi=110)
    for body in glass_bodies(found.scene):
        axes.fill(body[:, 0], body[:, 1], facecolor=GLASS, edgecolor="none", zorder=1)
    of_shape = groups(found)
    for surface in lines:
        _draw(axes, surface, of_shape[surface.name], surface.name == found.facts["detector"])
    scale = max(size[0] / (0.92 * width), size[1] / drawn)  # mm for each inch
    _names(axes, {line.name: line for line in lines}, labels, low, high, above * scale)
    margin = 0.04 * size
    (z0, y0), (z1, y1) = low - margin, high + margin
    axes.set(xlim=(z0, z1), ylim=(y0, y1 + above * scale), aspect="equal", xlabel="z [mm]", ylabel="y [mm]")
    stop = f"; aperture stop: {found.stop}" if found.stop else ""
    axes.set_title(f"{title + ': ' if title else ''}section x = 0{stop}", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    used = [name for name in STYLES if name in of_shape.values()]
    handles = [Line2D([], [], color=STYLES[name][1], lw=STYLES[name][2], label=STYLES[name][0]) for name in used]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(used), fontsize=8, frameon=False)
    return figure


def _draw(axes: Axes, surface: SectionLine, group: str, is_detector: bool) -> None:
    _, colour, width, dashes, order = STYLES[group]
    style: dict[str, Any] = {"color": colour, "lw": width, "ls": dashes, "zorder": order}
    if is_detector:
        style |= {"color": "black", "lw": 2.4}
    for line in surface.lines:
        axes.plot(line[:, 0], line[:, 1], solid_capstyle="butt", **style)


def _names(
    axes: Axes, lines: Mapping[str, SectionLine], labels: list[str], low: Polyline, high: Polyline, room: float
) -> None:
    """
    Label objects side by side above the system, each with a thin line to the upper end of its object.

    `low` and `high` are the corners of the system in z and y, mm, and `room` is the height above it, mm. Objects that
    lie in the lower half of the drawing have no label.
    """
    anchors: dict[str, Polyline] = {}
    for name in labels:
        points = np.concatenate(lines[name].lines) if lines[name].lines else np.empty((0, 2))
        if len(points) and points[:, 1].max() > 0.5 * (low[1] + high[1]):  # not those below the axis alone
            upper = points[points[:, 1] >= points[:, 1].max() - 0.5 * np.ptp(points[:, 1])]
            anchors[name] = upper.mean(axis=0)
    names = sorted(anchors, key=lambda name: float(anchors[name][0]))
    places = spread([float(anchors[name][0]) for name in names], float(low[0]), float(high[0]), LABELS)
    foot = float(high[1]) + 0.15 * room
    for name, x in zip(names, places, strict=True):
        z, y = anchors[name]
        axes.plot([z, x], [y, foot], color=VERMILION, lw=0.5, alpha=0.7, zorder=8)
        axes.text(x, foot, f" {name}", rotation=90, ha="center", va="bottom", fontsize=7)


def spread(wanted: Sequence[float], low: float, high: float, most: int) -> list[float]:
    """
    Return label positions close to the ascending `wanted` ones, from `low` to `high`.

    Neighbours are at least 1/`most` of that range apart. More than `most` + 1 of them begin below `low`.
    """
    apart = (high - low) / most
    places: list[float] = []
    for place in wanted:
        places.append(max(place, places[-1] + apart) if places else max(place, low))
    limit = high
    for k in reversed(range(len(places))):
        places[k] = min(places[k], limit)
        limit = places[k] - apart
    return places

"""Drawings of baffles: sections with the rays that place the vanes, and the zones of the wall that are lit or seen.

The public functions return Matplotlib figures that are not registered with pyplot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mistray.prescription import Prescription, Structure, Surface
from mistray.prescription.baffles.cassegrain import CassegrainBaffles
from mistray.prescription.baffles.two_stage import TwoStageBaffle
from mistray.prescription.baffles.vane_tube import BaffleTube
from mistray.prescription.baffles.zones import first_order_zones, lit_zones, seen_zones
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION

WIDTH, HIGHEST = 10.4, 9.0  # inches
MARGINS = 0.8  # inches, for axis labels and the legend
BAND = 0.025  # breadth of a zone, in units of the largest radius
PROFILE_POINTS = 65


def baffle_figure(baffle: BaffleTube | TwoStageBaffle, *, exclusion_deg: float = 0.0, title: str = "") -> Figure:
    """
    Return a drawing of the section of a tube with vanes, or of two stages, mm, with the rays of the construction.

    Rays are above the axis. For each vane, a blue ray leads from the far rim of the optic past its tip; the wall before
    it is hidden. From the second vane on, an orange ray is the steepest from outside past its tip; the wall behind it
    is lit. Colours along the walls mark zones that are lit, zones that are seen, and in red zones that are both.

    Parameters
    ----------
    baffle : BaffleTube or TwoStageBaffle
        Baffle to draw.
    exclusion_deg : float
        Field angle, degrees; light at smaller angles is left out of the lit zones, except in an inner stage.
    title : str
        Title of the figure.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> mistray.report.baffle_figure(tube, title="Hood").savefig("hood.png")
    """
    if isinstance(baffle, TwoStageBaffle):
        stages = [(baffle.outer, exclusion_deg), (baffle.inner, 0.0)]
    else:
        stages = [(baffle, exclusion_deg)]
    ends = [end for t, _ in stages for end in ((t.z_front, t.wall_front), (t.z_rear, t.wall_rear))]
    axes = _axes(title, *_extent(ends))
    size = max(radius for _, radius in ends)
    for shape in baffle.structures():
        _draw(axes, shape, 1.4)
    for tube, least_deg in stages:
        _draw_rays(axes, tube)
        for sign in (1, -1):
            axes.plot([tube.z_rear] * 2, [0, sign * tube.optic_radius], color=GREEN, lw=2.6, solid_capstyle="butt")
        zones = (
            (lit_zones(tube, least_deg), ORANGE, 0.7),
            (seen_zones(tube), BLUE, 1.9),
            (first_order_zones(tube, least_deg), VERMILION, 3.1),
        )
        for found, colour, place in zones:
            for zone in found:
                _draw_zone(axes, tube, zone, colour, place * BAND * size, BAND * size)
    beyond = f" beyond {exclusion_deg:g}°" if exclusion_deg else ""
    one = "optic" if len(stages) == 1 else "end of a stage"
    return _with_legend(
        axes,
        {
            f"lit from outside{beyond}": ORANGE,
            f"seen from the {one}": BLUE,
            "both: a first-order path": VERMILION,
            one: GREEN,
        },
    )


def cassegrain_figure(prescription: Prescription, baffles: CassegrainBaffles, title: str = "") -> Figure:
    """
    Return a drawing of the section of a Cassegrain telescope, mm, with the ray that just misses the detector.

    Parameters
    ----------
    prescription : Prescription
        Telescope; its meshes and its shapes off the axis are not drawn.
    baffles : CassegrainBaffles
        Baffles, whose rims A and B are marked, with the line from the edge of the detector past them.
    title : str
        Title of the figure.

    Examples
    --------
    >>> from mistray.scenes.cassegrain.prescription import build
    >>> telescope = build()
    >>> primary, secondary = telescope.surfaces
    >>> baffles = mistray.prescription.cassegrain_baffles(
    ...     primary, secondary, telescope.detector, field_deg=0.28, wall_depth=4, wall_rear=26
    ... )
    >>> mistray.report.cassegrain_figure(telescope, baffles).savefig("baffles.png")
    """
    shapes = [shape for shape in prescription.shapes() if isinstance(shape, Structure | Surface) and shape.coaxial]
    axes = _axes(title, *_extent([point for shape in shapes for point in _profile(shape).tolist()]))
    for shape in shapes:
        optical = isinstance(shape, Surface)
        _draw(axes, shape, 2.4 if optical else 1.1, BLUE if optical else BLACK)
    (r_a, z_a), (r_b, z_b) = baffles.outer_rim, baffles.inner_rim
    z_d = baffles.tube.z_rear
    slope = (r_a - r_b) / (z_a - z_b)
    left = axes.get_xlim()[0]
    for sign in (1, -1):
        axes.plot([left, z_d], [sign * (r_a + slope * (z - z_a)) for z in (left, z_d)], color=VERMILION, lw=1.0)
    for name, r, z in (("A", r_a, z_a), ("B", r_b, z_b)):
        axes.plot(z, r, "o", color=VERMILION, ms=4)
        axes.annotate(name, (z, r), xytext=(2, 5), textcoords="offset points", fontsize=10)
    return _with_legend(
        axes,
        {"line that just misses the detector": VERMILION, "mirrors, detector": BLUE, "baffles, vanes, walls": BLACK},
    )


def _extent(points: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return the first and last z and the largest radius, mm, of (z, r) pairs."""
    z, r = np.array(points).T
    return float(z.min()), float(z.max()), float(r.max())


def _axes(title: str, first: float, last: float, radius: float) -> Axes:
    margin = 0.04 * (last - first)
    height = (WIDTH - MARGINS) * (2.3 * radius) / (last - first + 2 * margin)
    axes: Axes
    _, axes = Figure.of_panels(WIDTH, min(height + MARGINS, HIGHEST))
    axes.set(aspect="equal", xlim=(first - margin, last + margin), ylim=(-1.15 * radius, 1.15 * radius))
    axes.set(xlabel="z [mm]", ylabel="r [mm]")
    axes.axhline(0, color=GREY, lw=0.6, ls="-.")
    axes.spines[["top", "right"]].set_visible(False)
    if title:
        axes.set_title(title, fontsize=11)
    return axes


def _profile(shape: Structure | Surface) -> np.ndarray:
    """Return the curve, (z, r) as (n, 2), mm, whose rotation about the axis makes a surface."""
    if isinstance(shape, Structure):
        return np.array([(shape.z0 + shape.z, shape.r0), (shape.z1 + shape.z, shape.r1)])
    r = np.linspace(shape.inner_semi_diameter, shape.outer_radius, PROFILE_POINTS)
    return np.column_stack([np.asarray(shape.z_at(r)), r])


def _draw(axes: Axes, shape: Structure | Surface, width: float, colour: str = BLACK) -> None:
    z, r = _profile(shape).T
    for sign in (1, -1):
        axes.plot(z, sign * r, color=colour, lw=width, solid_capstyle="round")


def _draw_rays(axes: Axes, tube: BaffleTube) -> None:
    """
    Draw for each vane, above the axis, the rays that bound the hidden wall before it and the lit wall behind.

    The first vane has only the first of these rays.
    """
    for k, vane in enumerate(tube.vanes):
        hides = (vane.radius + tube.optic_radius) / (tube.z_rear - vane.z)
        _draw_line(axes, (tube.z_rear, -tube.optic_radius), -hides, _meeting(tube, vane.z, vane.radius, -hides), BLUE)
        before = tube.vanes[:k]
        if before:
            other = min(before, key=lambda v, of=vane: (of.radius + v.radius) / (of.z - v.z))  # type: ignore[misc]
            lights = (vane.radius + other.radius) / (vane.z - other.z)
            _draw_line(axes, (other.z, -other.radius), lights, _meeting(tube, vane.z, vane.radius, lights), ORANGE)


def _meeting(tube: BaffleTube, z: float, r: float, slope: float) -> float:
    """
    Return z, mm, at which a line through (z, r), mm, of slope dr/dz meets the wall, limited to the tube.

    For a line parallel to the wall it is `z` itself.
    """
    growth = (tube.wall_rear - tube.wall_front) / (tube.z_rear - tube.z_front)
    if slope == growth:
        return z
    return float(np.clip(z + (tube.wall_radius(z) - r) / (slope - growth), tube.z_front, tube.z_rear))


def _draw_line(axes: Axes, start: tuple[float, float], slope: float, end: float, colour: str) -> None:
    z, r = start
    axes.plot([z, end], [r, r + slope * (end - z)], color=colour, lw=0.6, alpha=0.8)


def _draw_zone(
    axes: Axes, tube: BaffleTube, zone: tuple[float, float], colour: str, offset: float, breadth: float
) -> None:
    z = np.array(zone)
    r = np.array([tube.wall_radius(at) for at in zone])
    tilt = math.hypot(1.0, (tube.wall_rear - tube.wall_front) / (tube.z_rear - tube.z_front))
    for sign in (1, -1):
        axes.fill_between(z, sign * (r + tilt * offset), sign * (r + tilt * (offset + breadth)), color=colour, lw=0)


def _with_legend(axes: Axes, entries: dict[str, str]) -> Figure:
    """Return the figure of the axes with a legend; `entries` maps each label to its colour."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    lines = [Line2D([], [], color=colour, lw=3, label=label) for label, colour in entries.items()]
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), frameon=False, fontsize=9)
    return figure

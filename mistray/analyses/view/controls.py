"""Axes, colour scales, viewpoints and buttons of the 3-D view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.colors import to_hex

from mistray.analyses.view.drawing import ROLE_COLOURS, xyz
from mistray.toolkit.drawings.cut_open import CutPlane, OpenSurface
from mistray.toolkit.drawings.path_polylines import RayLine
from mistray.toolkit.typeset import power_of_ten

if TYPE_CHECKING:
    from mistray.recorders.flux_maps.surface_maps import SurfaceMap
    from mistray.trace.energy import SurfaceFlux

Menu = list[tuple[str, str, list[Any]]]  # method, label and arguments of each button
Box = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]

COLOURINGS = {"flux": "incident", "absorbed": "absorbed"}
IRRADIANCE = "irradiance"  # of the cells of walls
COLOUR_AXES = ("coloraxis", "coloraxis2", "coloraxis3")
NO_LIGHT = "#d3d3d3"
DECADES, WALL_DECADES = 8.0, 5.0  # of the scales of flux and of irradiance, at most
LONGEST, WIDEST = 1.3, 0.95  # sides of the box along z and across, in units of plotly's camera
BELOW = 0.12  # of these units, from the middle of the box to where the first camera looks: its near edge takes room
NEAR = 1.45  # as much larger without perspective
BEAM_SHOWN = 0.15  # of the size of the scene, before the first surface


class LogScale:
    """
    Colours of values on a log10 scale; values that are not positive are grey.

    Parameters
    ----------
    values : (n,) float64
        Values, in the unit that `title` names.
    title : str
        Label of the colour bar.
    decades : float
        Greatest length of the scale below the largest value, in powers of ten.

    Attributes
    ----------
    floor, top : float
        log10 of the ends of the scale.
    colours : list of str
        Hexadecimal colour of each value.
    """

    def __init__(self, values: npt.NDArray[np.float64], title: str, decades: float = DECADES) -> None:
        self.title = title
        lit = values > 0
        logs = np.log10(values, where=lit, out=np.full(len(values), np.nan))
        self.top = float(np.nanmax(logs)) if lit.any() else 0.0
        self.floor = max(float(np.nanmin(logs)) if lit.any() else -1.0, self.top - decades)
        if self.top - self.floor < 1e-6:
            self.floor = self.top - 1.0
        shares = np.clip((logs - self.floor) / (self.top - self.floor), 0.0, 1.0)
        palette = colormaps["viridis"]
        self.colours = [
            to_hex(palette(float(share))) if bright else NO_LIGHT for share, bright in zip(shares, lit, strict=True)
        ]

    @property
    def decades(self) -> list[int]:
        """Powers of ten, as whole exponents, within the range of the colour scale."""
        return list(range(math.ceil(self.floor - 1e-9), math.floor(self.top + 1e-9) + 1))


class FluxScale(LogScale):
    """Colours of surfaces by their incident or absorbed flux, W, on a log10 scale."""

    def __init__(self, surfaces: Sequence[OpenSurface], flux: Mapping[str, SurfaceFlux], what: str) -> None:
        values = np.array([getattr(flux[surface.name], f"{what}_W") for surface in surfaces], dtype=np.float64)
        super().__init__(values, f"{what} flux of a surface, W")


def light_scales(
    surfaces: Sequence[OpenSurface], flux: Mapping[str, SurfaceFlux], walls: Sequence[SurfaceMap]
) -> dict[str, LogScale]:
    """
    Return the colour scales of incident and absorbed flux, W, and of recorded irradiance, W/mm², by name.

    There are none without a trace, and none of irradiance without wall maps.
    """
    scales: dict[str, LogScale] = {}
    if flux:
        scales = {key: FluxScale(surfaces, flux, what) for key, what in COLOURINGS.items()}
    if walls:
        cells = np.concatenate([one.irradiance[0].ravel() for one in walls])
        scales[IRRADIANCE] = LogScale(cells, "irradiance of a wall, W/mm²", WALL_DECADES)
    return scales


def colour_axes(scales: Mapping[str, LogScale], by: str) -> dict[str, dict[str, Any]]:
    """Return the colour axes of a plotly layout, by name; only the axis `by`, which colours surfaces, has a bar."""
    axes = {}
    for key, name in zip(scales, COLOUR_AXES, strict=False):
        scale = scales[key]
        ticks = [(float(power), power_of_ten(power)) for power in scale.decades]
        if len(ticks) < 2:
            ticks = [(power, f"{10**power:.3g}") for power in (scale.floor, scale.top)]
        dark = " (grey: none)" if NO_LIGHT in scale.colours else ""
        axes[name] = {
            "colorscale": "Viridis",
            "cmin": scale.floor,
            "cmax": scale.top,
            "showscale": key == by,
            "colorbar": {
                "title": {"text": f"{scale.title}{dark}", "side": "top"},
                "tickvals": [value for value, _ in ticks],
                "ticktext": [text for _, text in ticks],
                "orientation": "h",
                "len": 0.5,
                "x": 1.0,
                "xanchor": "right",
                "y": 0.0,
                "yanchor": "top",
                "thickness": 12,
            },
        }
    return axes


def scale_marks(go: Any, scales: Mapping[str, LogScale], box: Box) -> list[Any]:
    """
    Return one invisible plotly mark per scale, since plotly draws a colour bar only for an axis with a mark.

    The marks are in the middle of `box`, from `shown_box`. `go` is `plotly.graph_objects`.
    """
    centre = (box[0] + box[1]) / 2
    return [
        go.Scatter3d(
            **xyz(centre[None]),
            mode="markers",
            marker={"size": 0.001, "opacity": 0.0, "color": [scale.floor], "coloraxis": name},
            showlegend=False,
            hoverinfo="skip",
            meta={"scale": scale.title},
        )
        for scale, name in zip(scales.values(), COLOUR_AXES, strict=False)
    ]


def shown_box(surfaces: Sequence[OpenSurface], lines: Sequence[RayLine], cut: CutPlane | None) -> Box:
    """
    Return the lowest and the highest corner, (3,) mm each, of the shown volume.

    It holds the surfaces, and rays within `BEAM_SHOWN` of their size, also those in the half that the cut removes.
    """
    points = np.concatenate([surface.vertices for surface in surfaces]).astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    if lines:
        if cut is not None:
            points = np.concatenate([points, points - 2 * cut.height(points)[:, None] * cut.normal])
        beams = np.concatenate([line.points for line in lines])
        reach = BEAM_SHOWN * size
        low = np.minimum(low, np.maximum(beams.min(axis=0), points.min(axis=0) - reach))
        high = np.maximum(high, np.minimum(beams.max(axis=0), points.max(axis=0) + reach))
    margin = 0.02 * size
    return low - margin, high + margin


def cameras(cut: CutPlane | None) -> dict[str, dict[str, Any]]:
    """
    Return plotly cameras by name of the view: "3-D", "side" and "from the light", which looks along z.

    In the first two z points to the right. The viewer is on the open side of the cut, without a cut at -x.
    """
    towards = np.array([-1.0, 0.0, 0.0]) if cut is None else cut.normal
    up = np.array([-towards[1], towards[0], 0.0]) * -1.0  # z × towards the viewer, turned so that z points right
    z = np.array([0.0, 0.0, 1.0])

    def camera(
        eye: npt.NDArray[np.float64], upwards: npt.NDArray[np.float64], kind: str, below: float = 0.0
    ) -> dict[str, Any]:
        named = {"eye": eye, "up": upwards, "center": -below * up}
        found = {name: dict(zip("xyz", vector.tolist(), strict=True)) for name, vector in named.items()}
        return {**found, "projection": {"type": kind}}

    return {
        "3-D": camera(1.5 * towards + 0.55 * up - 0.85 * z, up, "perspective", BELOW),
        "side": camera(1.1 * towards, up, "orthographic"),
        "from the light": camera(-1.1 * z, up, "orthographic"),
    }


def arrange(figure: Any, box: Box, cut: CutPlane | None) -> None:
    """Set equal axes in mm that show the box, the legends and the first camera of a plotly figure."""
    low, high = box
    span = high - low
    axes = {
        f"{name}axis": {
            "range": [float(low[k]), float(high[k])],
            "title": {"text": f"{name}, mm"},
            "backgroundcolor": "#fbfbfb",
            "gridcolor": "#e2e2e2",
            "zeroline": False,
            "showspikes": False,
            "nticks": 6,
        }
        for k, name in enumerate("xyz")
    }
    sides = span / max(span[2] / LONGEST, span[:2].max() / WIDEST)
    figure.update_layout(
        template="plotly_white",
        scene={
            **axes,
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", sides.tolist(), strict=True)),
            "camera": cameras(cut)["3-D"],
            "dragmode": "orbit",
        },
        margin={"l": 0, "r": 0, "t": 36, "b": 64},
        uirevision="view",
        legend={"title": {"text": "paths (click: on or off,<br>double click: only this)"}, "y": 1.0, "x": 1.01},
        legend2={"orientation": "h", "y": 0.0, "x": 0.0, "yanchor": "top"},
    )


def add_buttons(
    figure: Any, scales: Mapping[str, LogScale], by: str, shown: Sequence[OpenSurface], cut: CutPlane | None
) -> None:
    """
    Add buttons above a plotly figure: viewpoint, colours of the surfaces, and all rays or none.

    `by` is the key of the colours at first, one of `scales` or "role". `shown` are the surfaces of the first meshes.
    """
    role = [ROLE_COLOURS[surface.role] for surface in shown]
    keys = [*scales, "role"]
    colours = {key: role if key in ("role", IRRADIANCE) else scales[key].colours for key in keys}
    walls = {trace.meta["wall"]: k for k, trace in enumerate(figure.data) if "wall" in (trace.meta or {})}
    paths = [k for k, trace in enumerate(figure.data) if "path_id" in (trace.meta or {})]
    for mesh, colour in zip(figure.data, colours[by], strict=False):  # the meshes of the surfaces come first
        mesh.color = colour
    meshes = list(range(len(shown)))

    def seen(key: str) -> list[bool]:
        """
        Return for each mesh True if it is shown with the colours `key`.

        Surfaces come first, then cells of wall maps, which replace them.
        """
        cells = key == IRRADIANCE
        return [not (cells and surface.name in walls) for surface in shown] + [cells] * len(walls)

    for k, is_seen in zip((*meshes, *walls.values()), seen(by), strict=True):
        figure.data[k].visible = is_seen

    def recolour(key: str) -> list[Any]:
        bars = {f"{name}.showscale": key == other for other, name in zip(scales, COLOUR_AXES, strict=False)}
        if not walls:
            return [{"color": colours[key]}, bars, meshes]
        of_cells = [figure.data[k].color for k in walls.values()]
        return [{"color": [*colours[key], *of_cells], "visible": seen(key)}, bars, [*meshes, *walls.values()]]

    ratio = figure.layout.scene.aspectratio
    looks: Menu = []
    for name, camera in cameras(cut).items():
        flat = camera["projection"]["type"] == "orthographic"
        near = NEAR if flat else 1.0  # there the eye's distance has no say
        sides = {axis: near * ratio[axis] for axis in "xyz"}
        along = max("xyz", key=lambda axis: abs(camera["eye"][axis]))
        # The labels of an axis that points at the viewer would lie upon each other
        axes = {f"scene.{axis}axis.visible": not (flat and axis == along) for axis in "xyz"}
        looks.append(("relayout", name, [{"scene.camera": camera, "scene.aspectratio": sides, **axes}]))
    menus = [looks]
    if scales:
        words = {"flux": "incident flux", "absorbed": "absorbed flux", IRRADIANCE: "irradiance", "role": "role"}
        menus.append([("update", words[key], recolour(key)) for key in keys])
    if paths:
        menus.append(
            [("restyle", name, [{"visible": state}, paths])
             for name, state in (("all rays", True), ("no rays", "legendonly"))]
        )  # fmt: skip
    figure.update_layout(colour_axes(scales, by))
    active = [0, keys.index(by), 0]
    figure.update_layout(
        updatemenus=[
            {
                "type": "buttons",
                "direction": "right",
                "buttons": [{"method": method, "label": label, "args": args} for method, label, args in menu],
                "x": place,
                "xanchor": "left",
                "y": 1.0,
                "yanchor": "bottom",
                "pad": {"t": 0, "b": 4},
                "active": chosen,
                "font": {"size": 11},
            }
            for menu, place, chosen in zip(menus, (0.0, 0.3, 0.68), active, strict=False)
        ]
    )

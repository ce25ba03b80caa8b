"""The scene in three dimensions, cut open, with the rays of the strongest paths: for Jupyter and as an HTML file.

Everything is drawn by plotly, an optional dependency (``pip install 'mistray[view]'``). The HTML holds plotly.js itself
and needs no network.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.view.controls import (
    COLOURINGS,
    IRRADIANCE,
    add_buttons,
    arrange,
    light_scales,
    scale_marks,
    shown_box,
)
from mistray.analyses.view.drawing import ROLES, glass_faces, outlines, path_lines, surface_mesh, wall_mesh
from mistray.errors import MistrayError
from mistray.known_arguments import known_arguments
from mistray.replace_file import replace_file
from mistray.scene.check import require_scene
from mistray.toolkit.drawings.cut_open import CutPlane, OpenSurface, open_surfaces
from mistray.toolkit.drawings.path_rays import RayChoice, RayLine, check_count
from mistray.toolkit.pages.parts import thousands

if TYPE_CHECKING:
    from mistray.recorders.passing.surface_maps import SurfaceMap
    from mistray.trace import Trace
    from mistray.trace.energy import SurfaceFlux
    from mistray.trace.paths import PathRow

MOST_PATHS, RAYS_PER_PATH = 8, 10
BEYOND = 0.25  # of the size of the scene: what is drawn of rays that leave it


class View:
    """
    A scene drawn in three dimensions.

    Attributes
    ----------
    figure : plotly.graph_objects.Figure
        What is drawn; every surface is a ``mesh3d``, every path one ``scatter3d`` whose rays are parted by NaN.
    surfaces : list of OpenSurface
        What is left of the surfaces.
    rays : list of RayLine
        The rays that are drawn, for `mistray.report.write_rays`.
    title, note : str
        Head of the page, and what it shows.
    """

    def __init__(self, figure: Any, surfaces: list[OpenSurface], rays: list[RayLine], title: str, note: str) -> None:
        self.figure, self.surfaces, self.rays = figure, surfaces, rays
        self.title, self.note = title, note

    def html(self, command: str = "") -> str:
        """One HTML page with everything in it; `command` is quoted at its foot."""
        from mistray.toolkit.pages.render import template

        body = self.figure.to_html(
            full_html=False,
            include_plotlyjs=True,
            div_id="view",
            default_height="100%",
            config={"displaylogo": False, "scrollZoom": True, "responsive": True},
        )
        return template("view.html", title=self.title, note=self.note, body=body, command=command) + "\n"

    def write(self, path: str | Path, command: str = "") -> Path:
        """Write the page of `html` to a file, complete or not at all; raises `MistrayError` if that fails."""
        return replace_file(path, self.html(command), "view")

    def _repr_html_(self) -> str:
        """The page in a frame of its own, so that no other script of a notebook gets into its way."""
        return (
            f'<iframe srcdoc="{escape(self.html())}" title="{escape(self.title)}" '
            'style="width: 100%; height: 640px; border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"View({self.title!r}, {len(self.surfaces)} surfaces, {len(self.rays)} rays)"


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@known_arguments
def view(
    scene: Any,
    trace: Trace | Sequence[Trace] | None = None,
    *,
    paths: int = MOST_PATHS,
    path_ids: Sequence[int | str] | None = None,
    classes: Sequence[str] | None = None,
    selection: str = "",
    box: Sequence[float] | None = None,
    rays: int = RAYS_PER_PATH,
    colour: str | None = None,
    cut_deg: float | None = 180.0,
    cut_mm: float = 0.0,
    title: str = "scene",
) -> View:
    """
    Show a scene in three dimensions, cut open, with the rays of its strongest paths.

    Parameters
    ----------
    scene : mi.Scene
        From `mistray.load`.
    trace : Trace or sequence of Trace, optional
        Of this scene; without it there are no rays and no fluxes. Of several, such as of several fields, the rays of
        each are drawn, and the fluxes are those of all together.
    paths : int
        Number of rows of the path table to draw, the strongest first.
    path_ids : sequence of int or str, optional
        Draw these rows instead: by number, or all that have a name ("L2_rear -> L1_front"), are of a kind ("ghost"), or
        pass a filter, see `mistray.trace.path_filter`.
    classes : sequence of str, optional
        Draw rays by class instead of paths: "direct", "ghost", "stray", "all", … of light on the detector; "blocked",
        "escaped", "returned", or a surface or part at which they arrive, of light anywhere, see `Trace.rays_at`.
    selection : str
        Only rays, or the strongest rows, that pass a filter.
    box : x0, x1, y0, y1, optional
        Of `classes` only rays that land in this rectangle of the detector, mm.
    rays : int
        Most rays of each path or class.
    colour : {"flux", "absorbed", "irradiance", "role"}, optional
        Colour surfaces by the flux that reaches them, by what they absorb of it (both log10, `DECADES` decades at
        most), by place where the trace has `mistray.recorders.SurfaceMaps`, or by what they are. Default: by place if
        the trace has these, else "flux", without a trace "role".
    cut_deg : float or None
        Direction of the half that is taken away, degrees about z from x: 180 takes x < 0, 90 takes y > 0. None: the
        whole scene.
    cut_mm : float
        Distance of the cut from the z axis along that direction.
    title : str
        Name of the system.

    Returns
    -------
    View
        Shows itself in Jupyter; ``write("view.html")`` makes a file.

    Raises
    ------
    MistrayError
        If plotly is missing, an argument is out of range or needs a trace, or the trace is of another scene.
    """
    require_scene(scene, "view")
    go = graph_objects()
    traces = [] if trace is None else [trace] if not isinstance(trace, Sequence) else list(trace)
    chosen = RayChoice(paths, path_ids, classes, selection, box, rays)
    _check(traces, chosen, colour, cut_deg, cut_mm)
    rows = [chosen.rows(one) for one in traces]
    cut = None if cut_deg is None else CutPlane(cut_deg, cut_mm)
    surfaces = open_surfaces(scene, cut)
    shown = [surface for surface in surfaces if len(surface.faces)]
    if not shown:
        raise MistrayError(f"cut_deg={cut_deg}, cut_mm={cut_mm:g} leaves no surface; move the cut")
    flux = flux_of(surfaces, traces)
    size = scene_size(surfaces)
    groups = chosen.groups(scene, traces, BEYOND * size)
    lines = [line for group in groups for line in group.lines]
    shown_mm = shown_box(shown, lines, cut)
    figure = go.Figure()
    meshes = [surface_mesh(go, surface, flux.get(surface.name)) for surface in shown]
    edges = outlines(go, shown)
    for role in ROLES:  # one entry of the legend, which switches all of its surfaces
        first = next((drawn for drawn in (*edges, *meshes) if drawn.legendgroup == role), None)
        if first is not None:
            first.showlegend = True
    figure.add_traces(meshes)
    figure.add_traces(edges)
    figure.add_traces(glass_faces(go, scene, surfaces, cut))
    maps = _maps_of(traces)
    if colour == IRRADIANCE and not maps:
        raise MistrayError("colour is 'irradiance' but the trace has no maps of surfaces; record them (SurfaceMaps)")
    by = colour or (IRRADIANCE if maps else "role" if not traces else "flux")
    scales = light_scales(shown, flux, maps)
    figure.add_traces(scale_marks(go, scales, shown_mm))
    figure.add_traces(path_lines(go, groups))
    start = 0
    for one in maps:
        cells = one.areas.size * (len(one.across_borders) - 1)
        figure.add_trace(wall_mesh(go, one, scales[IRRADIANCE].colours[start : start + cells], cut))
        start += cells
    arrange(figure, shown_mm, cut)
    add_buttons(figure, scales, by, shown, cut)
    return View(figure, surfaces, lines, title, _note(traces, rows, chosen, cut))


def graph_objects() -> Any:
    """The module of plotly that draws; raises `MistrayError` if plotly is missing."""
    try:
        return importlib.import_module("plotly.graph_objects")
    except ImportError:
        raise MistrayError("the 3-D view needs plotly, which is not installed; pip install 'mistray[view]'") from None


def _check(
    traces: Sequence[Trace], chosen: RayChoice, colour: str | None, cut_deg: float | None, cut_mm: float
) -> None:
    check_count(chosen.rays)
    if colour not in (None, "role", IRRADIANCE, *COLOURINGS):
        raise MistrayError(f"colour is '{colour}'; choose {', '.join(COLOURINGS)}, {IRRADIANCE} or role")
    if not traces and colour in (IRRADIANCE, *COLOURINGS):
        raise MistrayError(f"colour is '{colour}' but nothing was traced; give the trace, or colour='role'")
    if not traces and (chosen.path_ids is not None or chosen.classes is not None):
        what = "classes" if chosen.path_ids is None else "path_ids"
        raise MistrayError(f"{what} without a trace; give the trace that has these rays")
    if chosen.classes is None and chosen.box is not None:
        raise MistrayError("box is about rays by class; give classes=['all'] with it")
    if chosen.path_ids is not None and chosen.selection:
        raise MistrayError("path_ids and selection are given; choose rows by one of them")
    if chosen.classes is not None and chosen.path_ids is not None:
        raise MistrayError("path_ids and classes are given; draw rays by path or by class")
    if not math.isfinite(cut_mm) or not math.isfinite(cut_deg or 0.0):
        raise MistrayError(f"cut_deg is {cut_deg}, cut_mm is {cut_mm}; both must be finite")


def _maps_of(traces: Sequence[Trace]) -> list[SurfaceMap]:
    """Return the maps that a trace has recorded of its surfaces, each surface once."""
    from mistray.recorders.passing.surface_maps import SurfaceMaps

    recorders = [one for trace in traces for one in trace.recorders.values() if isinstance(one, SurfaceMaps)]
    if recorders and len(traces) > 1:
        raise MistrayError("surface maps are of one field; give one trace, or trace without maps")
    return list({name: one for recorder in recorders for name, one in recorder.maps.items()}.values())


def flux_of(surfaces: Sequence[OpenSurface], traces: Sequence[Trace]) -> dict[str, SurfaceFlux]:
    """The fluxes of all traces together by id, after a look whether their surfaces are those of the scene."""
    found: dict[str, SurfaceFlux] = {}
    for trace in traces:
        flux = {row.id: row for row in trace.surfaces}
        strange = sorted({surface.name for surface in surfaces} ^ set(flux))
        if strange:
            raise MistrayError(f"surface '{strange[0]}' is not both in scene and trace; give the scene that was traced")
        found = {name: row + found[name] if found else row for name, row in flux.items()}
    return found


def scene_size(surfaces: Sequence[OpenSurface]) -> float:
    """Diagonal of the surfaces, mm."""
    points = np.concatenate([surface.vertices for surface in surfaces])
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _note(traces: Sequence[Trace], rows: Sequence[Sequence[PathRow]], chosen: RayChoice, cut: CutPlane | None) -> str:
    parts = ["mm, equal axes"]
    if cut is None:
        parts.append("whole")
    else:
        parts.append(f"cut open: the half towards azimuth {cut.azimuth_deg:g}° is taken away")
        if cut.offset_mm:
            parts.append(f"beyond {cut.offset_mm:g} mm")
    if traces:
        settings = traces[0].settings
        wavelengths = ", ".join(f"{value:g}" for value in traces[0].wavelengths_nm)
        azimuth = settings["azimuth_deg"]
        at = f" at azimuth {azimuth:g}°" if azimuth else ""
        fields = ", ".join(f"{one.settings['field_deg']:g}°" for one in traces)
        parts.append(f"field {fields}{at}, {wavelengths} nm, {thousands(settings['rays'])} start rays")
        if chosen.classes is None:
            count = "; ".join(
                f"{len(own)} of {len(one.paths)} paths drawn, {sum(row.percent for row in own):.4g} % of the light"
                for one, own in zip(traces, rows, strict=True)
            )
            parts.append(f"{count} on the detector")
        else:
            kept = [f"that pass {chosen.selection}"] * bool(chosen.selection)
            if chosen.box is not None:
                x0, x1, y0, y1 = chosen.box
                kept.append(f"that land in x {x0:g} … {x1:g}, y {y0:g} … {y1:g} mm")
            parts.append(" ".join([f"at most {chosen.rays} rays of each class", *kept]))
    return "; ".join(parts)

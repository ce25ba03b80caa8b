"""View of a scene in three dimensions, cut open, with the rays of the strongest paths: for Jupyter and as HTML.

Everything is drawn by plotly, an optional dependency (``pip install 'mistray[view]'``). The HTML holds plotly.js itself
and needs no network.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.view.controls import (
    IRRADIANCE,
    add_buttons,
    arrange,
    light_scales,
    scale_marks,
    shown_box,
)
from mistray.analyses.view.drawing import ROLES, glass_faces, outlines, path_lines, surface_mesh, wall_mesh
from mistray.analyses.view.request import ViewRequest
from mistray.analyses.view.result import View
from mistray.errors import MistrayError
from mistray.files.packages import package
from mistray.toolkit.analysis import analysis
from mistray.toolkit.drawings.cut_open import CutPlane, OpenSurface, open_surfaces
from mistray.toolkit.drawings.path_polylines import ray_groups, rows_of, traces_of
from mistray.toolkit.pages.parts import thousands
from mistray.trace import Trace

if TYPE_CHECKING:
    import mitsuba as mi

    from mistray.recorders.flux_maps.surface_maps import SurfaceMap
    from mistray.trace.energy import SurfaceFlux
    from mistray.trace.path_row import PathRow

BEYOND = 0.25  # of the size of the scene: what is drawn of rays that leave it


def run(
    scene: mi.Scene,
    request: ViewRequest,
    trace: Trace | Sequence[Trace] | None = None,
    *,
    title: str = "scene",
) -> View:
    """
    Return a view of a scene in three dimensions, cut open, with the rays of its strongest paths.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : ViewRequest
    trace : Trace or sequence of Trace, optional
        Traces of this scene; none: no rays and no fluxes. Of several, such as several fields, the rays of
        each are drawn, and the fluxes are summed.
    title : str
        Name of the optical system.

    Returns
    -------
    View
        View, shown by Jupyter; ``write("view.html")`` writes it to a file.

    Raises
    ------
    MistrayError
        If plotly is missing, a value is out of range or needs a trace or surface maps, the trace is of another scene,
        or the cut leaves nothing. Also if there are several traces and one has surface maps.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> view = mistray.view(scene, mistray.trace(scene, rays=10_000), paths=2, rays=5)
    >>> len(view.rays)
    10
    >>> view.write("view.html").name
    'view.html'
    """
    go = graph_objects()
    traces = traces_of(trace)
    if not traces:
        _check_untraced(request)
    rows = [rows_of(request, one) for one in traces]
    cut = None if request.cut_deg is None else CutPlane(request.cut_deg, request.cut_mm)
    surfaces = open_surfaces(scene, cut)
    shown = [surface for surface in surfaces if len(surface.faces)]
    if not shown:
        raise MistrayError(f"cut_deg={request.cut_deg}, cut_mm={request.cut_mm:g} leaves no surface; move the cut")
    flux = flux_of(surfaces, traces)
    size = scene_size(surfaces)
    groups = ray_groups(request, scene, traces, BEYOND * size)
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
    if request.colour == IRRADIANCE and not maps:
        raise MistrayError("colour is 'irradiance' but the trace has no maps of surfaces; record them (SurfaceMaps)")
    by = request.colour or (IRRADIANCE if maps else "role" if not traces else "flux")
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
    return View(figure, surfaces, lines, title, _note(traces, rows, request, cut))


view = analysis("view", ViewRequest, run, positional=("trace",))


def graph_objects() -> Any:
    """Return the module `plotly.graph_objects`; raise `MistrayError` if plotly is missing."""
    return package("the 3-D view needs plotly", "plotly.graph_objects", "view")


def _check_untraced(request: ViewRequest) -> None:
    """Raise `MistrayError` if a request needs a trace, as for colours by flux, path ids or classes of light."""
    if request.colour not in (None, "role"):
        raise MistrayError(f"colour is '{request.colour}' but nothing was traced; give the trace, or colour='role'")
    for name in ("path_ids", "classes"):
        if getattr(request, name) is not None:
            raise MistrayError(f"{name} without a trace; give the trace that has these rows")


def _maps_of(traces: Sequence[Trace]) -> list[SurfaceMap]:
    """
    Return the irradiance maps of surfaces that a trace recorded.

    Raise `MistrayError` if there are several traces and one of them recorded any.
    """
    from mistray.recorders.flux_maps.surface_maps import SurfaceMaps

    recorders = [one for trace in traces for one in trace.recorders.values() if isinstance(one, SurfaceMaps)]
    if recorders and len(traces) > 1:
        raise MistrayError("surface maps are of one field; give one trace, or trace without maps")
    return list({name: one for recorder in recorders for name, one in recorder.maps.items()}.values())


def flux_of(surfaces: Sequence[OpenSurface], traces: Sequence[Trace]) -> dict[str, SurfaceFlux]:
    """Return the fluxes, W, by surface id, summed over traces; raise `MistrayError` if a trace is of another scene."""
    found: dict[str, SurfaceFlux] = {}
    for trace in traces:
        flux = {row.id: row for row in trace.surfaces}
        strange = sorted({surface.name for surface in surfaces} ^ set(flux))
        if strange:
            raise MistrayError(f"surface '{strange[0]}' is not both in scene and trace; give the scene that was traced")
        found = {name: row + found[name] if found else row for name, row in flux.items()}
    return found


def scene_size(surfaces: Sequence[OpenSurface]) -> float:
    """Return the diagonal of the bounding box of all surfaces, mm."""
    points = np.concatenate([surface.vertices for surface in surfaces])
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _field(trace: Trace) -> str:
    """Return the field angle of a trace as text, with its azimuth unless that is 0."""
    azimuth = trace.settings["azimuth_deg"]
    return f"{trace.settings['field_deg']:g}°" + (f" at azimuth {azimuth:g}°" if azimuth else "")


def _note(traces: Sequence[Trace], rows: Sequence[Sequence[PathRow]], chosen: ViewRequest, cut: CutPlane | None) -> str:
    parts = ["mm, equal axes"]
    if cut is None:
        parts.append("whole")
    else:
        parts.append(f"cut open: the half towards azimuth {cut.azimuth_deg:g}° is taken away")
        if cut.offset_mm:
            parts.append(f"beyond {cut.offset_mm:g} mm")
    if traces:
        wavelengths = ", ".join(f"{nm:g}" for nm in sorted({nm for one in traces for nm in one.wavelengths_nm}))
        rays = ", ".join(dict.fromkeys(thousands(one.settings["rays"]) for one in traces))
        parts.append(f"field {', '.join(map(_field, traces))}, {wavelengths} nm, {rays} start rays")
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

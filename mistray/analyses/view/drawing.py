"""Elements of the 3-D view: meshes of surfaces, their outlines, cut faces of glass, and rays of paths."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mistray.estimate import Estimate
from mistray.ids import event_words
from mistray.toolkit.drawings.cut_open import CutPlane, OpenSurface, triangulate
from mistray.toolkit.drawings.path_polylines import RayGroup
from mistray.toolkit.drawings.section_layout import GLASS, PATH_COLOURS, glass_bodies
from mistray.toolkit.figures.palette import BLACK, INDIGO
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.tables.text import with_error

if TYPE_CHECKING:
    from mistray.recorders.flux_maps.surface_maps import SurfaceMap
    from mistray.trace.energy import SurfaceFlux

ROLES = {"glass": "glass", "mirror": "mirrors", "structure": "mechanics", "detector": "detector"}
ROLE_COLOURS = {"glass": "#8fbbe0", "mirror": "#d9b44a", "structure": "#8d8f92", "detector": "#2b2b2b"}
ROLE_OPACITY = {"glass": 0.32, "mirror": 1.0, "structure": 1.0, "detector": 1.0}
EDGE = "#44546a"
LINES_OF_PAGE = {BLACK: "--ink", INDIGO: "--indigo", EDGE: "--rule"}  # what a dark page draws in colours of its own
DASHES = ("solid", "dash", "dot")
LIGHT = {"ambient": 0.72, "diffuse": 0.5, "specular": 0.08, "roughness": 0.7, "fresnel": 0.05}
FLAT_LIGHT = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0}
FACE_OPACITY = 0.5
LEGEND_LETTERS = 38  # of a line; plotly makes the picture as much smaller as its legend is wide
SILENT = {"legend": "legend2", "showlegend": False, "hoverinfo": "skip"}  # what goes with a surface


def surface_mesh(go: Any, surface: OpenSurface, flux: SurfaceFlux | None) -> Any:
    """
    Return a surface, mm, as ``mesh3d`` of plotly.

    Its hover text gives part, role and materials, and the flux (W) if there was a trace. `go` is
    `plotly.graph_objects`.
    """
    head = f"<b>{escape(surface.name)}</b>, part {escape(surface.part)}<br>{ROLES[surface.role]}"
    lines = [f"{head} {escape(surface.materials)}".rstrip()]
    if flux is not None:
        incident, absorbed = (
            with_error(Estimate(*pair))
            for pair in ((flux.incident_W, flux.incident_se_W), (flux.absorbed_W, flux.absorbed_se_W))
        )
        lines += [f"incident {incident} W, {thousands(flux.hits)} hits", f"absorbed {absorbed} W"]
    lines.append("x %{x:.5g}, y %{y:.5g}, z %{z:.5g} mm<extra></extra>")
    return go.Mesh3d(
        **xyz(surface.vertices),
        **dict(zip("ijk", _small(surface.faces).T, strict=True)),
        name=ROLES[surface.role],
        legend="legend2",
        legendgroup=surface.role,
        showlegend=False,
        color=ROLE_COLOURS[surface.role],
        opacity=ROLE_OPACITY[surface.role],
        lighting=LIGHT,
        hovertemplate="<br>".join(lines),
        meta={"surface": surface.name},
    )


def wall_mesh(go: Any, one: SurfaceMap, colours: Sequence[str], cut: CutPlane | None) -> Any:
    """
    Return the cells of a wall map, mm, as ``mesh3d``, without the half that `cut` removes.

    `colours` are hexadecimal, one for each cell, row by row. `go` is `plotly.graph_objects`.
    """
    rows, columns = one.places.shape[:2]
    row, column = np.divmod(np.arange(rows * columns), columns)
    kept = np.ones(len(row), dtype=bool) if cut is None else cut.height(one.places.reshape(-1, 3)) <= 0
    first = (row * (columns + 1) + column)[kept]
    faces = np.concatenate([
        np.column_stack([first, first + 1, first + columns + 2]),
        np.column_stack([first, first + columns + 2, first + columns + 1]),
    ])  # fmt: skip
    own = np.array(colours)[kept].tolist()
    head = f"<b>{escape(one.surface)}</b>, part {escape(one.part)}<br>incident {with_error(Estimate(*one.power))} W"
    return go.Mesh3d(
        **xyz(one.corners.reshape(-1, 3)),
        **dict(zip("ijk", _small(faces).T, strict=True)),
        facecolor=own + own,
        lighting=FLAT_LIGHT,
        legend="legend2",
        legendgroup="structure",
        showlegend=False,
        visible=False,
        hovertemplate=f"{head}<br>x %{{x:.5g}}, y %{{y:.5g}}, z %{{z:.5g}} mm<extra></extra>",
        meta={"wall": one.surface},
    )


def outlines(go: Any, surfaces: Sequence[OpenSurface]) -> list[Any]:
    """
    Return rims and cut edges, mm, as one plotly trace per role, which is shown and hidden with its surfaces.

    `go` is `plotly.graph_objects`.
    """
    traces = []
    for role in ROLES:
        lines = [line for surface in surfaces if surface.role == role for line in surface.lines]
        if lines:
            traces.append(
                go.Scatter3d(
                    **xyz(joined(lines)),
                    mode="lines",
                    line={"color": EDGE if role != "detector" else BLACK, "width": 2},
                    name=ROLES[role],
                    legendgroup=role,
                    meta={"outlines": role},
                    **SILENT,
                )
            )
    return traces


def glass_faces(go: Any, scene: Any, surfaces: Sequence[OpenSurface], cut: CutPlane | None) -> list[Any]:
    """
    Return the faces that the cut makes through pieces of glass, as ``mesh3d`` of plotly's `graph_objects` (`go`).

    There are faces in the plane x = 0, and in every plane through the z axis if all glass is of revolution about z. For
    other planes, and without a cut, the list is empty.
    """
    if cut is None or cut.offset_mm != 0:
        return []
    glass = {surface.name for surface in surfaces if surface.role == "glass"}
    turned = all(
        hasattr(shape, "profile") and not np.any(shape.matrix[:2, 2:]) and not getattr(shape, "rectangular", False)
        for shape in scene.shapes()
        if shape.id() in glass
    )
    if not turned and cut.normal[1] != 0:
        return []
    across = np.array([-cut.normal[1], cut.normal[0], 0.0]) * (1.0 if cut.normal[0] >= 0 else -1.0)
    faces = []
    for body in glass_bodies(scene):
        points = body[:, :1] * np.array([0.0, 0.0, 1.0]) + body[:, 1:] * across
        triangles = triangulate(body)
        faces.append(
            go.Mesh3d(
                **xyz(points),
                **dict(zip("ijk", _small(triangles).T, strict=True)),
                color=GLASS,
                opacity=FACE_OPACITY,
                lighting=FLAT_LIGHT,
                legendgroup="glass",
                meta={"face": "glass"},
                **SILENT,
            )
        )
    return faces


def path_lines(go: Any, groups: Sequence[RayGroup]) -> list[Any]:
    """
    Return the rays of each path or class, mm, as one named ``scatter3d``; hover texts give the flux, W.

    `go` is `plotly.graph_objects`.
    """
    traces = []
    for number, (name, own, path_id) in enumerate(groups):
        texts: list[str] = []
        for line in own:
            places = ["start", *event_words(line.events)]
            places += ["leaves"] * (len(line.points) - len(places))
            texts += [f"{escape(place)}, {flux:.4g} W" for place, flux in zip(places, line.flux_W, strict=True)]
            texts.append("")
        rare = "too rare to draw" if path_id is not None else "none"
        traces.append(
            go.Scatter3d(
                **xyz(joined([line.points for line in own])),
                mode="lines",
                line={
                    "color": PATH_COLOURS[number % len(PATH_COLOURS)],
                    "width": 2,
                    "dash": DASHES[number // len(PATH_COLOURS) % len(DASHES)],
                },
                name=legend_text(name if own else f"{name}, {rare}"),
                text=texts,
                hovertemplate=f"<b>{escape(name)}</b><br>%{{text}}<br>x %{{x:.5g}}, y %{{y:.5g}}, z %{{z:.5g}} mm"
                "<extra></extra>",
                meta={"name": name} | ({"class": name} if path_id is None else {"path_id": path_id}),
                showlegend=True,
            )
        )
    return traces


def legend_text(name: str) -> str:
    """
    Return the name of a path as the text that plotly shows in a legend: at most three lines of `LEGEND_LETTERS`.

    Of a longer name the beginning and, after "…", the end are kept.
    """
    lines = textwrap.wrap(name, LEGEND_LETTERS, break_on_hyphens=False)
    if len(lines) > 3:
        lines = [*lines[:2], f"…{name[-(LEGEND_LETTERS - 1) :]}"]
    return "<br>".join(escape(line, quote=False) for line in lines)


def joined(lines: Sequence[npt.NDArray[Any]]) -> npt.NDArray[np.float64]:
    """Return polylines as one array, (n, 3), mm, with a row of NaN after each."""
    gap = np.full((1, 3), np.nan)
    parts = [part for line in lines for part in (np.asarray(line, dtype=np.float64), gap)]
    return np.concatenate(parts) if parts else np.empty((0, 3))


def xyz(points: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of points (n, 3) by the names that plotly gives them: x, y and z."""
    return dict(zip("xyz", np.ascontiguousarray(points.T), strict=True))


def _small(faces: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return vertex indices in the smaller sufficient integer type, uint16 or uint32."""
    return faces.astype(np.uint16 if faces.size == 0 or faces.max() < 2**16 else np.uint32)

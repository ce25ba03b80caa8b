"""Section of the optical system in the y-z plane, with real rays of chosen paths, for reports and papers."""

from __future__ import annotations

import io
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes

from mistray.errors import MistrayError
from mistray.ids import event_words
from mistray.prescription.geometry import is_gas
from mistray.ranges import several
from mistray.recorders.path_events import DIRECT
from mistray.replace_file import replace_file
from mistray.surfaces.surfaces import solid_shapes
from mistray.toolkit.drawings.chains import chain
from mistray.toolkit.drawings.cut_open import CutPlane, clip, role_of, surface_names, triangles
from mistray.toolkit.drawings.path_polylines import row_name, rows_of, traces_of
from mistray.toolkit.drawings.ray_choice import RayChoice
from mistray.toolkit.figures.figure import Figure, legend_label
from mistray.toolkit.figures.palette import BLACK, BLUE, BROWN, GREEN, INDIGO, PURPLE, SKY, VERMILION

if TYPE_CHECKING:
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.trace import Trace

Polyline = npt.NDArray[np.float64]

GLASS, GLASS_EDGE, STRUCTURE, MIRROR, DETECTOR = "#dbe9f4", "#4a6a86", "#7a7a7a", "#333333", "#000000"
# The direct image, if drawn, is first; orange marks surfaces in the page of a report
PATH_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, BLACK, SKY, BROWN, INDIGO)
# One after another, so that rays that lie on each other are told apart, and in print without colours
LINE_STYLES = ("solid", (0, (7, 2)), (0, (4, 1.5, 1, 1.5)), (0, (1.5, 1.2)), (0, (7, 1.5, 1, 1.5, 1, 1.5)))
LEAST_WEIGHT = 0.66  # of lines, in those of a picture for the screen
MOST_HEIGHT = 6.6  # inch
RAYS_DRAWN, PATHS_DRAWN, GHOSTS_DRAWN = 7, 4, 3
CANDIDATES = 40  # rays of a path among which those near the section are chosen, for each that is drawn
SCREEN_WIDTH, PAPER_WIDTH = 10.4, 6.9  # inch; the second is both columns of a journal
ANSWER_WIDTH, ANSWER_HEIGHT = 6.6, 4.6
HANDLE = 3.5  # length of the lines in the legend, in letters
LEGEND_SIGN, LETTER = 0.8, 0.55 / 72  # inch: beside a label of the legend, and of a letter of one point
FORMATS = (".svg", ".pdf", ".eps", ".png")


class Drawn(NamedTuple):
    """Path to draw: rays, (k, 3) mm each, colour, label, and indices of points of reflections and scatter events."""

    rays: list[Polyline]
    colour: str
    label: str
    turns: Sequence[int] = ()


@dataclass(frozen=True)
class SectionLine:
    """
    Section of a surface by the plane x = 0.

    Attributes
    ----------
    name : str
        Shape id.
    lines : list of (n, 2) float
        Polylines, columns z and y, mm.
    kind : {"glass", "structure", "mirror", "detector"}
        Role of the surface, which decides how it is drawn.
    """

    name: str
    lines: list[Polyline]
    kind: str


def section(scene: Any) -> list[SectionLine]:
    """
    Return the section of every shape of a scene with the plane x = 0.

    Surfaces with a profile whose axis lies in the plane are cut exactly: their profile and its mirror image. All other
    shapes are cut as triangle meshes.
    """
    return [SectionLine(name, _cut(shape, name), role_of(shape)) for name, shape in surface_names(scene)]


def glass_bodies(scene: Any) -> list[Polyline]:
    """
    Return the outlines of the pieces of glass, (n, 2) float with columns z and y, mm.

    A body lies between a surface with glass at its back and the next surface, with larger z, that has the same glass
    at its front. Only transmitting surfaces of revolution that reach their axis, which lies in the section, are
    considered: a Mangin mirror has no outline. Its rim follows the frusta (edges, flanges, bevels) that lead from one
    surface to the other; without any, straight lines join the rims.
    """
    shapes = [shape for shape in solid_shapes(scene) if hasattr(shape, "profile") and _in_plane(shape)]
    shapes = [shape for shape in shapes if hasattr(shape.bsdf(), "opaque")]  # those of mistray
    faces = [shape for shape in shapes if not shape.bsdf().opaque and shape.profile()[0, 0] == 0]
    faces.sort(key=lambda shape: float(shape.matrix[2, 3]))
    bodies = []
    for k, face in enumerate(faces):
        glass = face.bsdf().back
        if is_gas(glass):
            continue
        partner = next((other for other in faces[k + 1 :] if other.bsdf().front == glass), None)
        if partner is None:
            continue
        rims = [shape for shape in shapes if shape not in faces and glass in (shape.bsdf().front, shape.bsdf().back)]
        halves = []
        for sign in (1, -1):
            front, rear = _placed(face, face.profile(), sign), _placed(partner, partner.profile(), sign)
            steps = [_placed(shape, shape.profile(), sign)[[0, -1]] for shape in rims]
            halves.append(np.concatenate([front, chain(front[-1], rear[-1], steps), rear[::-1]]))
        bodies.append(np.concatenate([halves[0], halves[1][::-1]]))
    return bodies


def layout(
    report: GhostReport, field_deg: float, ghosts: int = GHOSTS_DRAWN, path_ids: int | Sequence[int] | None = None
) -> Figure:
    """
    Return a section with rays of the direct image and of the worst stray paths of one field, or of chosen paths.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    field_deg : float
        Field angle, degrees.
    ghosts : int
        Number of stray paths drawn, the worst first by the rank of the report; the strongest by power is added.
    path_ids : int or sequence of int, optional
        Draw these paths of ``report.table(field_deg)`` instead; the first one in blue.

    Raises
    ------
    MistrayError
        If a path is not in the table of the field.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> mistray.report.layout(report, 10, ghosts=2).savefig("ghosts.svg")
    """
    chosen = worst_paths(report, field_deg, ghosts) if path_ids is None else _asked(report, field_deg, path_ids)
    drawn = _drawn(report, [(field_deg, *one) for one in chosen])
    title = f"field {field_deg:g}°: section x = 0; rays projected onto it; dots: reflections and scatter"
    return _figure(report.scene, drawn, title, width=SCREEN_WIDTH, size=8.0)


def _drawn(report: GhostReport, paths: Sequence[tuple[float, int, str, str]]) -> list[Drawn]:
    """
    Return the paths to draw from tuples of field angle (degrees), path id, colour and label.

    Rays of each path have their own heights in the pupil, see `meridional`.
    """
    return [
        Drawn(
            meridional(report.rays_of(field, path_id), RAYS_DRAWN, (number, len(paths))),
            colour,
            label,
            _turns(report, field, path_id),
        )
        for number, (field, path_id, colour, label) in enumerate(paths)
    ]


def layout_of_fields(report: GhostReport, paths: Sequence[tuple[float, int, str]]) -> Figure:
    """
    Return a section with rays of stray paths of several fields, low enough for the first page of a report.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    paths : sequence of (float, int, str)
        Field angle, degrees, path of ``report.table`` at that field, and label.
    """
    coloured = zip(paths, itertools.cycle(PATH_COLOURS[1:]), strict=False)
    drawn = _drawn(report, [(field, path_id, colour, label) for (field, path_id, label), colour in coloured])
    return _figure(report.scene, drawn, "", width=ANSWER_WIDTH, size=8.0, most=ANSWER_HEIGHT)


def layout_figure(
    scene: Any,
    trace: Trace | Sequence[Trace] | None = None,
    paths: int = PATHS_DRAWN,
    path_ids: int | str | Sequence[int | str] | None = None,
    rays: int = RAYS_DRAWN,
    selection: str = "",
) -> Figure:
    """
    Return a y-z section of the system with rays of the strongest paths, as wide as a page of a journal.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    trace : Trace or sequence of Trace, optional
        Traces of this scene, also of several fields; none: the section alone is drawn.
    paths : int
        Number of rows of the path table to draw, the strongest first.
    path_ids : int, str or sequence of them, optional
        Rows to draw instead, see `mistray.report.view`.
    rays : int
        Rays per path: those nearest to the plane x = 0 and spread over the beam, projected onto the plane.
    selection : str
        Filter; only the strongest rows that pass it are drawn.

    Returns
    -------
    Figure
        Figure for `write_layout` or ``figure.savefig``.

    Raises
    ------
    MistrayError
        If a row is unknown, no row passes the filter, rows come without a trace, or there are fewer than 0 paths or 1
        ray.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> figure = mistray.report.layout_figure(scene, mistray.trace(scene, rays=10_000), path_ids=[0, 1])
    >>> mistray.report.write_layout(figure, "layout.svg").name
    'layout.svg'
    """
    asked = None if path_ids is None else several(path_ids)
    choice = RayChoice(paths=paths, path_ids=asked, rays=rays, selection=selection)
    if trace is None and path_ids is not None:
        raise MistrayError("path_ids without a trace; give the trace that has these paths")
    drawn: list[Drawn] = []
    title = ""
    traces = traces_of(trace)
    if traces:
        chosen = [(one, row) for one in traces for row in rows_of(choice, one)]
        fields = [f"{one.settings['field_deg']:g}°" for one in traces]
        for (one, row), colour in zip(chosen, itertools.cycle(PATH_COLOURS), strict=False):
            history = one.history(row.path_id, CANDIDATES * rays).rays
            name = row_name(row, len(one.wavelengths_nm) > 1)
            before = f"{one.settings['field_deg']:g}°: " if len(traces) > 1 else ""
            drawn.append(Drawn(meridional(history, rays), colour, f"{before}{name}"))
        title = f"field {', '.join(fields)}, section x = 0; rays projected onto it"
    return _figure(scene, drawn, title, width=PAPER_WIDTH, size=7.0)


def write_layout(figure: Figure, path: str | Path) -> Path:
    """
    Write a layout as a vector file with text as text, or as PNG.

    Parameters
    ----------
    figure : Figure
        Matplotlib figure.
    path : str or Path
        File, whose ending chooses the format: ``.svg``, ``.pdf``, ``.eps`` or ``.png``.

    Returns
    -------
    Path
        File that was written.

    Raises
    ------
    MistrayError
        If the ending is another one, or the file cannot be written.

    Examples
    --------
    >>> figure = mistray.report.layout_figure(mistray.load("cooke_triplet"))
    >>> mistray.report.write_layout(figure, "layout.pdf").name
    'layout.pdf'
    """
    kind = layout_format(path)
    buffer = io.BytesIO()
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    with rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": "mistray"}):
        figure.savefig(buffer, format=kind, dpi=300, bbox_inches="tight", pad_inches=0.05, metadata=metadata)
    return replace_file(path, buffer.getvalue(), "layout")


def layout_format(path: str | Path) -> str:
    """Return the file format of a layout from the suffix of its name; raise `MistrayError` if it is unknown."""
    ending = Path(path).suffix.lower()
    if ending not in FORMATS:
        raise MistrayError(f"layout '{path}': layouts are written as {', '.join(FORMATS)}; choose one of these endings")
    return ending[1:]


def _figure(
    scene: Any, chosen: Sequence[Drawn], title: str, width: float, size: float, most: float = MOST_HEIGHT
) -> Figure:
    """Return the section with rays; `width` and `most` (height) in inches, legend text `size` in points."""
    lines = section(scene)
    low, high = bounds(lines)
    span = np.maximum(high - low, 1e-9)
    longest = max((len(path.label) for path in chosen), default=0)
    columns = max(1, min(len(chosen), int(width / (LEGEND_SIGN + LETTER * size * longest))))
    legend = 0.22 * -(-len(chosen) // columns)
    height = float(np.clip(0.9 * width * span[1] / span[0] + 0.7 + legend, 2.6, most))
    figure, axes = Figure.of_panels(width, height, dpi=110)
    weight = max(width / SCREEN_WIDTH, LEAST_WEIGHT)
    _draw_system(axes, scene, lines, weight)
    for number, (rays, colour, label, turns) in enumerate(chosen):
        # A colour comes again with another style
        style: dict[str, Any] = {
            "color": colour,
            "ls": LINE_STYLES[(number + number // len(PATH_COLOURS)) % len(LINE_STYLES)],
        }
        axes.plot([], [], **style, lw=1.3, label=legend_label(label if rays else f"{label}, too rare to draw"))
        for ray in rays:
            axes.plot(ray[:, 2], ray[:, 1], **style, lw=weight, alpha=0.9, zorder=4)
            points = ray[[k for k in turns if k < len(ray)]]
            axes.plot(points[:, 2], points[:, 1], ls="", marker="o", ms=2.5, color=colour, zorder=5)
    margin = 0.06 * span
    (left, bottom), (right, top) = low - margin * (2.5, 1.0), high + margin
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_xlabel("z [mm]", fontsize=size + 2)
    axes.set_ylabel("y [mm]", fontsize=size + 2)
    axes.tick_params(labelsize=size + 2)
    axes.set_title(title, fontsize=size + 2)
    axes.spines[["top", "right"]].set_visible(False)
    if chosen:
        figure.legend(
            *axes.get_legend_handles_labels(),
            loc="outside lower center",
            ncols=columns,
            fontsize=size,
            frameon=False,
            handlelength=HANDLE,
        )
    return figure


def worst_paths(report: GhostReport, field_deg: float, ghosts: int = GHOSTS_DRAWN) -> list[tuple[int, str, str]]:
    """
    Return path id, colour and label of the direct image, the worst stray paths of a field, and the strongest one.

    `ghosts` is the number of the worst; the direct image is left out if the field has none.
    """
    table = report.table(field_deg)
    chosen = [(int(path_id), BLUE, "direct image") for path_id in table.path_id[table.kind == DIRECT][:1]]
    for number, row in enumerate(report.listed(field_deg, ghosts).itertuples(index=False), 1):
        kind = f" ({row.kind})"  # labels of structure paths end in it
        chosen.append((int(row.path_id), PATH_COLOURS[number % len(PATH_COLOURS)], row.label.removesuffix(kind) + kind))
    return chosen


def _asked(report: GhostReport, field_deg: float, path_ids: int | Sequence[int]) -> list[tuple[int, str, str]]:
    """Return path id, colour and label of paths with given ids. Raise `MistrayError` for an unknown id."""
    labels = report.table(field_deg).set_index("path_id").label
    return [
        (path_id, colour, f"path {path_id}: {labels[path_id]}")
        for path_id, colour in zip(report.check_ids(field_deg, path_ids), itertools.cycle(PATH_COLOURS), strict=False)
    ]


def _turns(report: GhostReport, field_deg: float, path_id: int) -> list[int]:
    """Return the indices of the ray points where a path is reflected or scattered; the start is point 0."""
    table = report.table(field_deg)
    words = event_words(str(table.events[table.path_id == path_id].iloc[0]))
    return [k for k, word in enumerate(words, 1) if word[-1] not in "TA"]


def meridional(rays: Sequence[Polyline], count: int, turn: tuple[int, int] = (0, 1)) -> list[Polyline]:
    """
    Return some rays that stay near the plane x = 0 and spread over the pupil.

    Parameters
    ----------
    rays : sequence of (k, 3) float
        Polylines, mm.
    count : int
        Largest number of rays.
    turn : (int, int)
        Index of this path, and number of paths. Each takes other heights of the pupil, so that rays of paths that have
        a part of their way in common do not hide each other.
    """
    number, paths = turn
    height = [float(ray[min(1, len(ray) - 1), 1]) for ray in rays]
    off_plane = [float(np.max(np.abs(ray[:, 0]))) for ray in rays]
    order = np.argsort(height)
    groups = np.array_split(order, count * paths)[number::paths]
    if any(not len(group) for group in groups):  # too few rays for heights of their own
        groups = [group for group in np.array_split(order, count) if len(group)]
    return [rays[min(group, key=lambda k: off_plane[k])] for group in groups]


def _draw_system(axes: Axes, scene: Any, lines: Sequence[SectionLine], weight: float) -> None:
    for body in glass_bodies(scene):
        axes.fill(body[:, 0], body[:, 1], facecolor=GLASS, edgecolor="none", zorder=1)
    style: dict[str, dict[str, Any]] = {
        "glass": {"color": GLASS_EDGE, "lw": 0.9, "zorder": 3},
        "structure": {"color": STRUCTURE, "lw": 1.4, "zorder": 2},
        "mirror": {"color": MIRROR, "lw": 1.6, "zorder": 3},
        "detector": {"color": DETECTOR, "lw": 2.4, "zorder": 3, "solid_capstyle": "butt"},
    }
    for surface in lines:
        for line in surface.lines:
            axes.plot(line[:, 0], line[:, 1], **style[surface.kind] | {"lw": weight * style[surface.kind]["lw"]})


def _in_plane(shape: Any) -> bool:
    """
    True if the profile of a surface is its section with the plane x = 0, the plane of the drawing.

    Its axis lies in the plane then, and of a rectangle the y axis, too.
    """
    axes = shape.matrix[0, 1:] if getattr(shape, "rectangular", False) else shape.matrix[0, 2:]
    return bool(np.abs(axes).max() < 1e-9)


def _cut(shape: Any, name: str) -> list[Polyline]:
    if hasattr(shape, "profile") and _in_plane(shape):
        whole = _mirrored(shape)
        return [whole] if whole is not None else [_placed(shape, shape.profile(), sign) for sign in (1, -1)]
    return slice_mesh(*triangles(shape, name))


def _mirrored(shape: Any) -> Polyline | None:
    """
    Return a profile joined to its mirror image, as one line (z, y), mm, through the axis.

    It is None if the profile does not reach the axis.
    """
    profile = shape.profile()
    if profile[0, 0] > 0:
        return None
    return np.concatenate([_placed(shape, profile, -1)[:0:-1], _placed(shape, profile, 1)])


def _placed(shape: Any, profile: Polyline, sign: int) -> Polyline:
    """Return profile points (r, z) as (z, y) of the scene, mm; `sign` selects the half above or below the axis."""
    axis = shape.matrix[:3, 2]
    across = np.array([0.0, axis[2], -axis[1]])
    points = shape.matrix[:3, 3] + sign * profile[:, :1] * across + profile[:, 1:] * axis
    return points[:, [2, 1]]


def slice_mesh(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> list[Polyline]:
    """
    Return the section of a triangle mesh with the plane x = 0.

    Parameters
    ----------
    vertices : (n, 3) float
        Vertices, mm.
    faces : (m, 3) int
        Vertex indices of each triangle.

    Returns
    -------
    list of (2, 2) float
        One segment for each triangle that crosses the plane, columns z and y, mm.
    """
    _, _, lines = clip(np.asarray(vertices, dtype=np.float64), faces, CutPlane())
    return [line[:, [2, 1]] for line in lines]


def bounds(lines: Sequence[SectionLine]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the smallest and largest (z, y) of a section, mm; (0, 0) without lines."""
    points = np.concatenate([line for surface in lines for line in surface.lines] or [np.zeros((1, 2))])
    return points.min(axis=0), points.max(axis=0)

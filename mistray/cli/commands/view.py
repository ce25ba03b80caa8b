"""`mistray view`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import Help
from mistray.cli.claims import claim_files, declare_outputs
from mistray.cli.tracing_arguments import (
    add_ray_tree,
    add_scatter,
    add_scene,
    add_spectrum,
    check_weights,
    print_json,
    progress_bar,
    scene_title,
    settings_of,
    start_mitsuba,
    working,
)
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, PLACE_MM, RAYS_DRAWN, ROWS

if TYPE_CHECKING:
    from mistray.report import View
    from mistray.trace import Trace

RAYS = 20_000
WHOLE = "none"
PICTURE = ("colour", "cut_deg", "cut_mm")  # options of the page alone
OF_A_TRACE = ("field_deg", "azimuth_deg", "wavelength_nm", "weights", "paths", "path_ids", "filter", "rays_per_path",
              "save_rays")  # fmt: skip


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "view",
        help="show a scene in 3-D, cut open, with the rays of its strongest paths",
        description="Trace a scene and write one HTML page: the surfaces cut open and coloured by the flux on them,\n"
        "rays of the strongest paths, the rows of the path table to switch them. The page needs no network; to\n"
        "make it takes plotly: pip install 'mistray[view]'.",
        epilog="examples:\n"
        "  mistray view phone_camera --field-deg 20 --out view.html\n"
        "  mistray view cooke_triplet --field-deg 10 --layout triplet.pdf --save-rays rays.ply\n"
        "  mistray view scene.xml --cut-deg 90 --path-ids 0 3 7 --out view.html\n"
        "  mistray view scene.xml --no-trace",
        formatter_class=Help,
    )
    add_scene(parser)
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=FIELD_DEG, metavar="DEG", help="field angle, degrees")
    source.add_argument("--azimuth-deg", type=AZIMUTH_DEG, metavar="DEG", help="azimuth of the field about z, degrees")
    add_spectrum(source)
    add_ray_tree(parser, f"start rays ({RAYS}, whatever the scene says)")
    add_scatter(parser)
    picture = parser.add_argument_group("picture")
    picture.add_argument(
        "--paths",
        type=ROWS,
        metavar="N",
        help="paths, strongest first, each at its strongest wavelength (8; 4 in a layout)",
    )
    picture.add_argument("--path-ids", type=ROWS, nargs="+", metavar="ID", help="these rows instead")
    picture.add_argument("--filter", metavar="EXPR",
                         help="strongest rows that pass a filter, as 'G(lens*) & !S' (docs/rays.md)")  # fmt: skip
    picture.add_argument("--rays-per-path", type=RAYS_DRAWN, metavar="N",
                         help="most rays of each path (10; 7 in a layout)")  # fmt: skip
    picture.add_argument("--colour", choices=("flux", "absorbed", "role"),
                         help="of surfaces: incident flux, absorbed flux, or what they are (flux)")  # fmt: skip
    picture.add_argument("--cut-deg", type=_cut, metavar="DEG",
                         help="azimuth of the half that is taken away, about z; none: the whole (180)")  # fmt: skip
    picture.add_argument("--cut-mm", type=PLACE_MM, metavar="MM",
                         help="distance of the cut from the z axis, mm (0)")  # fmt: skip
    picture.add_argument("--no-trace", action="store_true", help="the scene alone: no rays, no flux")
    output = parser.add_argument_group("output")
    output.add_argument("--out", type=Path, metavar="FILE", help="HTML page (view.html, unless another file is named)")
    output.add_argument("--layout", type=Path, metavar="FILE",
                        help="section y-z with rays, for papers: .svg, .pdf, .eps or .png")  # fmt: skip
    output.add_argument("--save-rays", type=Path, nargs="+", default=[], metavar="FILE",
                        help="rays of the rows as polylines: .ply, .obj, .json")  # fmt: skip
    declare_outputs(parser, output, "out", "layout", "save_rays")
    output.add_argument("--json", action="store_true", help="print JSON instead of the names of the files")
    output.add_argument("--quiet", action="store_true", help="no progress, nothing printed")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    start_mitsuba(options)
    from mistray.report.figures.layout import PATHS_DRAWN, RAYS_DRAWN, layout_figure, layout_format, write_layout
    from mistray.report.output import writable_directory
    from mistray.report.rays.path_rays import chosen_rows, rays_of_paths
    from mistray.report.rays.ray_files import format_of, write_rays
    from mistray.report.view3d.view import MOST_PATHS, RAYS_PER_PATH, graph_objects
    from mistray.scene import load
    from mistray.trace import trace
    from mistray.trace.path_filter import PathFilter

    check_weights(options)
    if options.filter is not None:
        PathFilter(options.filter)  # an error in its text shows before the trace
        _refuse(options, ("path_ids",), "beside --filter; give one of them")
    page = options.out
    if page is None and options.layout is None and not options.save_rays:
        page = Path("view.html")
    _check(options, page)
    if page is not None:
        graph_objects()  # before anything is traced
    if options.layout is not None:
        layout_format(options.layout)
    for file in options.save_rays:
        format_of(file)
    for file in filter(None, (page, options.layout, *options.save_rays)):
        writable_directory(file.parent)
    claim_files(options, page, options.layout, *options.save_rays)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    traced = None
    if not options.no_trace:
        with progress_bar(options) as progress:
            settings = settings_of(options)
            traced = trace(
                scene,
                field_deg=options.field_deg,
                azimuth_deg=options.azimuth_deg,
                wavelength_nm=options.wavelength_nm,
                weights=options.weights,
                progress=progress,
                **settings | {"rays": RAYS if settings["rays"] is None else settings["rays"]},
            )
    if options.filter is not None and traced is not None:
        options.path_ids = _passing(traced, options)
    most = PATHS_DRAWN if page is None and not options.save_rays else MOST_PATHS
    paths = most if options.paths is None else options.paths
    rays = RAYS_PER_PATH if options.rays_per_path is None else options.rays_per_path
    files = []
    with working("drawing", options.quiet):
        shown = None
        if page is not None:
            shown = _view(scene, traced, paths, rays, options)
            files.append(shown.write(page, options.command_line))
        if options.layout is not None:
            drawn = PATHS_DRAWN if options.paths is None else paths
            each = RAYS_DRAWN if options.rays_per_path is None else rays
            figure = layout_figure(scene, traced, drawn, options.path_ids, each)
            files.append(write_layout(figure, options.layout))
        if options.save_rays and traced is not None:
            ids = [row.path_id for row in chosen_rows(traced, paths, options.path_ids)]
            lines = rays_of_paths(traced, ids, rays) if shown is None else shown.rays
            files += [write_rays(lines, file) for file in options.save_rays]
    if options.json:
        print_json(_record(traced, paths, options), files)
    elif not options.quiet:
        print("\n".join(str(file) for file in files))
    return 0


def _passing(traced: Trace, options: argparse.Namespace) -> list[int]:
    """The strongest rows that pass the filter."""
    from mistray.report.rays.path_rays import one_of_each
    from mistray.report.view3d.view import MOST_PATHS

    most = MOST_PATHS if options.paths is None else options.paths
    found = [row.path_id for row in one_of_each(traced.paths.select(options.filter), most)]
    if not found:
        raise MistrayError(f"no path passes the filter '{options.filter}'; widen it, or see mistray ghosts --filter")
    return found


def _check(options: argparse.Namespace, page: Path | None) -> None:
    """Refuse options that would have no effect."""
    if page is None:
        _refuse(options, PICTURE, "without a page; give --out")
    if options.no_trace:
        from mistray.trace import Settings

        settings = (setting.name for setting in fields(Settings))
        _refuse(options, (*OF_A_TRACE, *settings), "with --no-trace; leave it out")


def _refuse(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Raise for the first of these options that is given."""
    for name in names:
        if getattr(options, name) not in (None, []):
            raise MistrayError(f"--{name.replace('_', '-')} has no effect {why}")


def _view(scene: Any, traced: Trace | None, paths: int, rays: int, options: argparse.Namespace) -> View:
    from mistray.report.view3d.view import view

    given = {name: getattr(options, name) for name in PICTURE if getattr(options, name) is not None}
    if given.get("cut_deg") == WHOLE:
        given["cut_deg"] = None
    title = scene_title(options.scene)
    return view(scene, traced, paths=paths, path_ids=options.path_ids, rays=rays, title=title, **given)


def _record(traced: Trace | None, paths: int, options: argparse.Namespace) -> dict[str, Any]:
    """What --json prints: the rows that are drawn."""
    if traced is None:
        return {"paths": []}
    from mistray.files.json_values import plain
    from mistray.report.rays.path_rays import chosen_rows

    rows = chosen_rows(traced, paths, options.path_ids)
    names = ("path_id", "label", "kind", "events", "wavelength_nm", "power_W", "power_se_W", "percent")
    record = {
        "field_deg": traced.settings["field_deg"],
        "wavelength_nm": traced.wavelengths_nm,
        "paths": [{name: getattr(row, name) for name in names} for row in rows],
    }
    return dict(plain(record))


def _cut(text: str) -> float | str:
    """An azimuth in degrees, or "none"."""
    return WHOLE if text == WHOLE else AZIMUTH_DEG(text)

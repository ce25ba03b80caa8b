"""Command `mistray view`, which shows a scene in 3-D, cut open, with the rays of its strongest paths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.shared_options import FORCE, MAPS, NAMES, SCATTER, SCENE, SOURCE, SURFACES, ray_tree

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

PICTURE = ("colour", "cut_deg", "cut_mm")
LIGHT = ("field_deg", "light")
RAYS = ("paths", "path_ids", "selection", "classes", "box", "rays")
NO_EFFECT = " has no effect "
COMMAND = Command(
    "view",
    "show a scene in 3-D, cut open, with the rays of its strongest paths",
    "Trace a scene and write one HTML page: the surfaces cut open and coloured by the flux on them, and the\n"
    "rays of the strongest paths, which a legend switches. The page needs no network; to make it takes plotly:\n"
    "pip install 'mistray[view]'. In a layout are 4 paths and 7 rays of each where nothing else is said.",
    (
        "mistray view phone_camera --field-deg 20 --out view.html",
        "mistray view cooke_triplet --field-deg 10 --layout triplet.pdf --save-rays rays.ply",
        "mistray view scene.xml --cut-deg 90 --path-ids 0 3 7 --out view.html",
        "mistray view double_gauss_barrel --field-deg 20 --surface-maps 'barrel*' hood --out walls.html",
        "mistray view phone_camera --field-deg 0 20 --classes direct ghost blocked escaped --out classes.html",
        "mistray view scene.xml --no-trace",
    ),
    lambda request: (
        SCENE,
        Group("source (default: as the scene says)", (*options_of(request.ViewTraces, *LIGHT), SOURCE, MAPS)),
        ray_tree(request.ViewTraces),
        SURFACES,
        SCATTER,
        Group(
            "picture",
            (
                *options_of(request.ViewRequest, *RAYS, *PICTURE),
                Option("--no-trace", "the scene alone: no rays, no flux", bool),
            ),
        ),
        Group(
            "output",
            (
                Option("--out", "HTML page (view.html, unless another file is named)", Path, "FILE", writes=()),
                Option(
                    "--layout", "section y-z with rays, for papers: .svg, .pdf, .eps or .png", Path, "FILE", writes=()
                ),
                Option(
                    *("--save-rays", "rays of the rows as polylines: .ply, .obj, .json", Path, "FILE", "+"),
                    default=[],
                    writes=(),
                ),
                FORCE,
                Option("--json", "print JSON instead of the names of the files", bool),
                Option("--quiet", "no progress, nothing printed", bool),
            ),
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray view` with parsed options; return the exit code 0."""
    from mistray.analyses.view.request import ViewRequest, ViewTraces

    light, picture = request_of(ViewTraces, vars(options)), request_of(ViewRequest, vars(options))
    options.start()
    from mistray.analyses.view.page import record
    from mistray.analyses.view.ray_files import format_of, write_rays
    from mistray.analyses.view.run import graph_objects
    from mistray.analyses.view.run import run as view
    from mistray.toolkit.drawings.path_polylines import ray_groups
    from mistray.toolkit.drawings.ray_choice import BACKWARD
    from mistray.toolkit.drawings.section_layout import PATHS_DRAWN, layout_figure, layout_format, write_layout
    from mistray.toolkit.pages.output import writable_directory
    from mistray.trace import trace
    from mistray.trace.check_paths import check_paths
    from mistray.trace.elsewhere import ELSEWHERE
    from mistray.trace.named_paths import KINDS

    if picture.classes is not None:
        options.refuse(["paths", "layout"], " is about paths, and --classes draws rays by class; give one")
    if options.no_trace:
        of_a_trace = (*options_of(ViewTraces, *LIGHT), *options_of(ViewRequest, *RAYS), MAPS)
        names = (*NAMES, *(option.dest for option in of_a_trace), "save_rays")
        options.refuse(names, NO_EFFECT + "with --no-trace; leave it out")
    if options.out is None and options.layout is None and not options.save_rays:
        options.out = Path("view.html")
    if options.out is None:
        options.refuse((*PICTURE, "surface_maps"), NO_EFFECT + "without a page; give --out")
    else:
        graph_objects()  # before anything is traced
    if options.layout is not None:
        layout_format(options.layout)
    for file in options.save_rays:
        format_of(file)
    for file in options.claim():
        writable_directory(file.parent)
    scene = options.load()
    texts = [picture.selection, *(picture.path_ids or ())]
    texts += [f'H("{name}")' for name in picture.classes or () if name not in (*KINDS, *ELSEWHERE, BACKWARD)]
    check_paths(scene, [text for text in texts if text and isinstance(text, str)])  # before anything is traced
    traced = []
    for angle in () if options.no_trace else light.field_deg or (None,):
        with options.tracing() as progress:
            settings = {**options.settings(), **light.light, "rays": light.rays}
            traced.append(trace(scene, field_deg=angle, progress=progress, **settings))
    few = {"rays" if name != "paths" else name: n for name, n in options.given("paths", "rays_per_path").items()}
    if options.out is None and not options.save_rays:
        picture = replace(picture, **{"paths": PATHS_DRAWN} | few)
    files = []
    with options.working("drawing"):
        if options.out is not None:
            shown = view(scene, picture, traced or None, title=options.title)
            files.append(shown.write(options.out, options.command_line))
        if options.layout is not None:
            figure = layout_figure(scene, traced or None, path_ids=picture.path_ids, selection=picture.selection, **few)
            files.append(write_layout(figure, options.layout))
        if options.save_rays and traced:
            groups = ray_groups(picture, scene, traced) if options.out is None else ()
            lines = [line for group in groups for line in group.lines] if options.out is None else shown.rays
            files += [write_rays(lines, file) for file in options.save_rays]
    return options.say(lambda: record(traced, picture), lambda: "\n".join(map(str, files)), files)

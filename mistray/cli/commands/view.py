"""`mistray view`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.claims import claim_files
from mistray.cli.options import Options, print_json
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, PLACE_MM, RAYS_DRAWN, ROWS
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import FORCE, MAPS, NAMES, SCATTER, SCENE, SOURCE, SPECTRUM, SURFACES, ray_tree

if TYPE_CHECKING:
    from mistray.analyses.view.run import View
    from mistray.toolkit.drawings.path_rays import RayChoice
    from mistray.trace import Trace

RAYS = 20_000
WHOLE = "none"
PICTURE = ("colour", "cut_deg", "cut_mm")  # options of the page alone
OF_A_TRACE = ("field_deg", "azimuth_deg", "wavelength_nm", "weights", "paths", "path_ids", "filter", "classes", "box",
              "rays_per_path", "save_rays", "surface_maps", *NAMES)  # fmt: skip
NO_EFFECT = " has no effect "


def _cut(text: str) -> float | str:
    """An azimuth in degrees, or "none"."""
    return WHOLE if text == WHOLE else AZIMUTH_DEG(text)


def _row(text: str) -> int | str:
    """A row of the path table by its number, or rows by what they are called."""
    return ROWS(text) if text.strip().lstrip("+-").isdigit() else text


# fmt: off
COMMAND = Command(
    "view",
    "show a scene in 3-D, cut open, with the rays of its strongest paths",
    "Trace a scene and write one HTML page: the surfaces cut open and coloured by the flux on them, and the\n"
    "rays of the strongest paths, which a legend switches. The page needs no network; to make it takes plotly:\n"
    "pip install 'mistray[view]'.",
    (
        "mistray view phone_camera --field-deg 20 --out view.html",
        "mistray view cooke_triplet --field-deg 10 --layout triplet.pdf --save-rays rays.ply",
        "mistray view scene.xml --cut-deg 90 --path-ids 0 3 7 --out view.html",
        "mistray view double_gauss_barrel --field-deg 20 --surface-maps 'barrel*' hood --out walls.html",
        "mistray view phone_camera --field-deg 0 20 --classes direct ghost blocked escaped --out classes.html",
        "mistray view scene.xml --no-trace",
    ),
    (
        SCENE,
        Group("source (default: as the scene says)", (
            Option("--field-deg", "field angles, degrees; the rays of each are drawn", FIELD_DEG, "DEG", "+"),
            Option("--azimuth-deg", "azimuth of the field about z, degrees", AZIMUTH_DEG, "DEG"),
            *SPECTRUM,
            SOURCE,
            MAPS,
        )),
        ray_tree(f"start rays ({RAYS}, whatever the scene says)"),
        SURFACES,
        SCATTER,
        Group("picture", (
            Option("--paths", "paths, strongest first, each at its strongest wavelength (8; 4 in a layout)", ROWS, "N"),
            Option("--path-ids", "these rows instead, by number or by name, as 'L2_rear -> L1_front' (docs/rays.md)",
                   _row, "ID", "+"),
            Option("--filter", "strongest rows that pass a filter, as 'G(lens*) & !S' (docs/rays.md)", metavar="EXPR"),
            Option("--classes", "rays by class instead of paths: direct, ghost, stray, all … on the detector; blocked, "
                   "escaped, returned, or surfaces at which they arrive; backward: from the detector (docs/view.md)",
                   None, "CLASS", "+"),
            Option("--box", "of rays by class only those that land there on the detector, mm", PLACE_MM,
                   ("X0", "X1", "Y0", "Y1"), 4),
            Option("--rays-per-path", "most rays of each path or class (10; 7 in a layout)", RAYS_DRAWN, "N"),
            Option("--colour", "of surfaces: incident flux, absorbed flux, by place with --surface-maps (then the "
                   "default), or what they are (flux)", ("flux", "absorbed", "irradiance", "role")),
            Option("--cut-deg", "azimuth of the half that is taken away, about z; none: the whole (180)", _cut, "DEG"),
            Option("--cut-mm", "distance of the cut from the z axis, mm (0)", PLACE_MM, "MM"),
            Option("--no-trace", "the scene alone: no rays, no flux", bool),
        )),
        Group("output", (
            Option("--out", "HTML page (view.html, unless another file is named)", Path, "FILE", writes=()),
            Option("--layout", "section y-z with rays, for papers: .svg, .pdf, .eps or .png", Path, "FILE",
                   writes=()),
            Option("--save-rays", "rays of the rows as polylines: .ply, .obj, .json", Path, "FILE", "+", default=[],
                   writes=()),
            FORCE,
            Option("--json", "print JSON instead of the names of the files", bool),
            Option("--quiet", "no progress, nothing printed", bool),
        )),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.start()
    from mistray.analyses.view.ray_files import format_of, write_rays
    from mistray.analyses.view.run import MOST_PATHS, RAYS_PER_PATH, graph_objects
    from mistray.toolkit.drawings.layout import PATHS_DRAWN, RAYS_DRAWN, layout_figure, layout_format, write_layout
    from mistray.toolkit.drawings.path_rays import BACKWARD, RayChoice
    from mistray.toolkit.pages.output import writable_directory
    from mistray.trace import trace
    from mistray.trace.check_paths import check_paths
    from mistray.trace.elsewhere import ELSEWHERE
    from mistray.trace.named_paths import KINDS

    if options.filter is not None:
        options.refuse(["path_ids"], NO_EFFECT + "beside --filter; give one of them")
    if options.classes is None:
        options.refuse(["box"], " is about rays by class; add --classes all, or leave it out")
    else:
        options.refuse(["paths", "path_ids", "layout"], " is about paths, and --classes draws rays by class; give one")
        if BACKWARD in options.classes:
            options.refuse(["box", "filter"], f" is about light of the sources, not about {BACKWARD} rays; give one")
    page = options.out
    if page is None and options.layout is None and not options.save_rays:
        page = Path("view.html")
    if options.no_trace:
        options.refuse(OF_A_TRACE, NO_EFFECT + "with --no-trace; leave it out")
    if page is None:
        options.refuse((*PICTURE, "surface_maps"), NO_EFFECT + "without a page; give --out")
    else:
        graph_objects()  # before anything is traced
    if options.layout is not None:
        layout_format(options.layout)
    for file in options.save_rays:
        format_of(file)
    for file in filter(None, (page, options.layout, *options.save_rays)):
        writable_directory(file.parent)
    claim_files(options, page, options.layout, *options.save_rays)
    scene = options.load()
    texts = [options.filter, *(options.path_ids or ())]
    texts += [f'H("{name}")' for name in options.classes or () if name not in (*KINDS, *ELSEWHERE, BACKWARD)]
    check_paths(scene, [text for text in texts if isinstance(text, str)])  # before anything is traced
    traced: list[Trace] = []
    if not options.no_trace:
        for angle in options.field_deg or [None]:
            with options.tracing() as progress:
                traced.append(
                    trace(
                        scene,
                        field_deg=angle,
                        azimuth_deg=options.azimuth_deg,
                        progress=progress,
                        **options.spectral_settings() | {"rays": RAYS if options.rays is None else options.rays},
                    )
                )
    most = PATHS_DRAWN if page is None and not options.save_rays else MOST_PATHS
    chosen = RayChoice(
        most if options.paths is None else options.paths,
        options.path_ids,
        options.classes,
        options.filter or "",
        options.box,
        RAYS_PER_PATH if options.rays_per_path is None else options.rays_per_path,
    )
    files = []
    with options.working("drawing"):
        shown = None
        if page is not None:
            shown = _view(scene, traced, chosen, options)
            files.append(shown.write(page, options.command_line))
        if options.layout is not None:
            drawn = PATHS_DRAWN if options.paths is None else chosen.paths
            each = RAYS_DRAWN if options.rays_per_path is None else chosen.rays
            figure = layout_figure(scene, traced or None, drawn, chosen.path_ids, each, chosen.selection)
            files.append(write_layout(figure, options.layout))
        if options.save_rays and traced:
            lines = (
                shown.rays
                if shown is not None
                else [line for group in chosen.groups(scene, traced) for line in group.lines]
            )
            files += [write_rays(lines, file) for file in options.save_rays]
    if options.json:
        print_json(_record(traced, chosen), files)
    elif not options.quiet:
        print("\n".join(str(file) for file in files))
    return 0


def _view(scene: Any, traced: Sequence[Trace], chosen: RayChoice, options: Options) -> View:
    from mistray.analyses.view.run import view

    given = options.given(*PICTURE)
    if given.get("cut_deg") == WHOLE:
        given["cut_deg"] = None
    rays = {name: getattr(chosen, name) for name in ("paths", "path_ids", "classes", "selection", "box", "rays")}
    return view(scene, traced or None, title=options.title, **rays, **given)


def _record(traced: Sequence[Trace], chosen: RayChoice) -> dict[str, Any]:
    """Return the record that --json prints: the rows that are drawn."""
    if not traced:
        return {"paths": []}
    from mistray.files.json_values import plain

    names = ("path_id", "label", "kind", "events", "wavelength_nm", "power_W", "power_se_W", "percent")
    fields = [one.settings["field_deg"] for one in traced]
    rows = [
        {"field_deg": field} | {name: getattr(row, name) for name in names}
        for field, one in zip(fields, traced, strict=True)
        for row in chosen.rows(one)
    ]
    single = fields[0] if len(fields) == 1 else fields
    record = {"field_deg": single, "wavelength_nm": traced[0].wavelengths_nm, "paths": rows}
    return dict(plain(record))

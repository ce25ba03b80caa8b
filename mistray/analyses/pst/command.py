"""Command `mistray pst`: point source transmittance against field angle, with causes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from mistray.errors import MistrayError
from mistray.percent import percent_text
from mistray.toolkit.command import Command
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import (
    MAP_FORMATS,
    NEXT_ORDER,
    SCATTER,
    SCENE,
    SCHEDULER,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
    saved_run,
)

if TYPE_CHECKING:
    from mistray.analyses.pst.progress import PstProgress
    from mistray.analyses.pst.request import PstRequest
    from mistray.cli.parsed_options import Options

PAGE_S = 6.0  # of the report, see `Options.seconds_left`: two figures are drawn twice, as PNG and for the page
STATE = "pst_state.npz"
ONE_WAY = " with --method forward, which cannot go on from a saved run"

COMMAND = Command(
    "pst",
    "point source transmittance against field angle, with causes",
    "The PST is the irradiance on the detector over that of a distant source, as a function of the field angle.\n"
    "It is given for direct image, ghosts, single and multiple scatter, with standard errors and the strongest paths.",
    (
        "mistray pst phone_camera_scatter --out out",
        "mistray pst baffle_tube --field-deg 0:10:1 12:80:2 --max-scatters 3 --rays 1e6",
        "mistray pst scene.xml --relative-error 0.02 --up-to-deg 60 --out out    # until 2 % everywhere up to 60°",
        "mistray pst scene.xml --relative-error 0.01 --up-to-deg 60 --out out --resume    # go on to 1 %",
        "mistray pst scene.xml --azimuths-deg 0:350:10 --map-field-deg 20 40 --out out",
        "mistray pst scene.xml --field-deg 0 10 20 --method forward --convention projected --json",
    ),
    lambda request: (
        SCENE,
        group("directions", request.PstRequest, "field_deg", "azimuths_deg", "cell_deg", "azimuth_cell_deg"),
        group("result", request.PstRequest, "method", "convention", "relative_error", "error_up_to_deg"),
        group("source (default: as the scene says)", request.PstRequest, "light"),
        ray_tree(request.PstRequest, TIME, NEXT_ORDER, SCHEDULER),
        SURFACES,
        SCATTER,
        saved_run(STATE, " (not with --method forward)"),
        output(
            "report.html, CSV, JSON and PNG files",
            ("report.html", "pst.*", "pst_*.csv", "pst_*.png", "irradiance_*deg.png", STATE),
            *options_of(request.PstShown, "paths_shown", "map_field_deg", "map_azimuth_deg", "map_pixels"),
            formats=(*TABLE_FORMATS, *MAP_FORMATS),
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray pst` with parsed options and return the exit code."""
    from mistray.analyses.pst.request import PstRequest, PstShown

    shown = request_of(PstShown, vars(options))
    request = replace(
        request_of(PstRequest, vars(options)),
        paths=shown.paths_shown > 0,
        map_pixels=shown.map_pixels if shown.map_field_deg else 0,
        next_order=not options.no_next_order,
    )
    _check(options, request)
    options.start()
    from mistray.analyses.pst.cells import grid_of
    from mistray.analyses.pst.run import run as run_pst
    from mistray.analyses.pst.tables import pst_record, pst_text

    grid, maps_at = grid_of(request), shown.maps_at(request)
    for direction in maps_at:
        grid.nearest(*direction)  # each must lie in a cell
    passes: list[PstProgress] = []
    saved = options.saved_run("" if request.method == "forward" else STATE, lambda: _so_far(passes))
    scene = options.load()
    with saved.reported():
        with options.workers(), _progress(options, passes) as progress:
            seconds = options.seconds_left(PAGE_S)
            found = run_pst(scene, request, **saved.how, progress=progress, seconds=seconds)
        files, count = [], shown.paths_shown
        if options.out is not None:
            from mistray.analyses.pst.page import irradiance_maps, pst_report  # imports what draws

            maps = irradiance_maps(found, maps_at, options.command_line) if options.formats else {}
            files = options.write(lambda title, command: pst_report(found, title, command, count, maps_at), maps=maps)
        options.show(lambda: pst_record(found, count), lambda: pst_text(found, count), files)
    return saved.code


def _check(options: Options, request: PstRequest) -> None:
    """Raise `MistrayError` for options of `mistray pst` that exclude each other or lack another one."""
    if request.method == "forward":
        options.refuse(["resume", "state"], ONE_WAY)
    options.check()
    if options.map_field_deg is None:
        pictures = [name for name in options.formats if name in MAP_FORMATS]
        if pictures:
            raise MistrayError(
                f"--formats {pictures[0]} writes irradiance maps; say with --map-field-deg of which angles"
            )
    elif options.out is None:
        raise MistrayError("--map-field-deg draws pictures; say with --out where they shall go")


def _so_far(passes: list[PstProgress]) -> str:
    # Only the first measurement is saved; those with one more event have fewer rays
    most = max(passes, key=lambda now: now.rays_done, default=None)
    if most is None or not most.rays_done:
        return "the saved run is still"
    reached = f", worst error {percent_text(most.worst_error)}," if math.isfinite(most.worst_error) else ""
    return f"{most.rays_done:.3g} start rays{reached} are"


@contextlib.contextmanager
def _progress(options: Options, passes: list[PstProgress]) -> Iterator[Callable[[PstProgress], None]]:
    """Show a progress bar on a terminal; yield the callback that updates it and appends each state to `passes`."""
    with options.bar("{desc}: {percentage:3.0f}% |{bar}| {elapsed}{postfix}", "tracing") as bar:

        def draw(now: PstProgress) -> None:
            passes.append(now)
            if bar is not None:
                bar.set_postfix_str(_state_of(now), refresh=False)
                bar.n = max(now.share_done, bar.n)
                bar.refresh()

        yield draw


def _state_of(now: PstProgress) -> str:
    """Return present error and remaining time as text for the progress bar, as in "error 3.1 % of 2 %, 01:23 left"."""
    parts = []
    if not now.rays_done:
        parts.append("the pilot is done")
    elif math.isinf(now.worst_error):
        parts.append("no light yet at some angles")
    elif math.isfinite(now.worst_error):
        of = "" if now.requested_error is None else f" of {100 * now.requested_error:g} %"
        parts.append(f"error {percent_text(now.worst_error)}{of}")
    if math.isfinite(now.seconds_left):
        minutes, seconds = divmod(round(now.seconds_left), 60)
        hours, minutes = divmod(minutes, 60)
        parts.append(f"{f'{hours}:' if hours else ''}{minutes:02d}:{seconds:02d} left")
    return ", ".join(parts)

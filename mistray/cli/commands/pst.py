"""`mistray pst`."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.options import Options
from mistray.cli.progress import terminal_bar
from mistray.cli.saved_run import SavedRun
from mistray.errors import MistrayError
from mistray.percent import percent_text
from mistray.ranges import (
    AZIMUTH_DEG,
    AZIMUTH_WIDTH_DEG,
    CELL_WIDTH_DEG,
    PIXELS,
    POLAR_DEG,
    PST_FIELD_DEG,
    RELATIVE_ERROR,
    ROWS,
)
from mistray.toolkit.arguments import FIELD_ANGLES
from mistray.toolkit.command import Command, Group, Option, angles
from mistray.toolkit.shared_options import (
    DETECTOR,
    MAP_FORMATS,
    NEXT_ORDER,
    SCATTER,
    SCENE,
    SCHEDULER,
    SPECTRUM,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
    saved_run,
)

if TYPE_CHECKING:
    from mistray.analyses.pst.result import Pst
    from mistray.analyses.pst.state import PstProgress
    from mistray.files.irradiance_files import IrradianceMap
    from mistray.recorders.directions import DirectionGrid
    from mistray.toolkit.pages.model import Report

MAP_PIXELS = 64
PAGE_S = 6.0  # of the report, see `Options.seconds_left`: two figures are drawn twice, as PNG and for the page
STATE = "pst_state.npz"

# What --out writes
FILES = ("report.html", "pst.*", "pst_*.csv", "pst_*.png", "irradiance_*deg.png", STATE)

# fmt: off
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
    (
        SCENE,
        Group("directions (angles: numbers, and ranges first:last:step)", (
            angles("--field-deg", "field angles, ascending; negative ones are at the opposite azimuth (0:80:2)",
                   PST_FIELD_DEG),
            angles("--azimuths-deg", "azimuths of a map, from +y towards -x (the mean over all)", AZIMUTH_DEG),
            Option("--cell-deg", "width of the cells of field angle that the PST is averaged over (2)",
                   CELL_WIDTH_DEG, "DEG"),
            Option("--azimuth-cell-deg", "and of azimuth (the distance of two azimuths)", AZIMUTH_WIDTH_DEG, "DEG"),
        )),
        Group("result", (
            Option("--method", "both directions at once, rays from the detector alone, or beams of each angle (joined)",
                   ("joined", "adjoint", "forward"), default="joined"),
            Option("--convention", "E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ) (normal)",
                   ("normal", "projected"), default="normal"),
            DETECTOR,
            Option("--relative-error", "take the rays that this standard error over the PST needs at every angle",
                   RELATIVE_ERROR, "E"),
            Option("--up-to-deg", "angles beyond this do not count for --relative-error", POLAR_DEG, "DEG"),
        )),
        Group("source (default: as the scene says)", SPECTRUM),
        ray_tree("start rays in all, or for each angle (forward); with --relative-error the most (4e6; 2e5)",
                 TIME, NEXT_ORDER, SCHEDULER),
        SURFACES,
        SCATTER,
        saved_run(STATE, " (not with --method forward)"),
        output("report.html, CSV, JSON and PNG files", FILES,
               Option("--paths-shown", "strongest stray paths of each angle; 0: no paths (4)", ROWS, "N", default=4),
               angles("--map-field-deg", "field angles of irradiance maps of the detector (need --out)", PST_FIELD_DEG),
               Option("--map-azimuth-deg", "their azimuth (the first one)", AZIMUTH_DEG, "DEG"),
               Option("--map-pixels", f"pixels along their longer side ({MAP_PIXELS})", PIXELS, "N"),
               formats=(*TABLE_FORMATS, *MAP_FORMATS)),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    _check(options)
    options.start()
    from mistray.analyses.pst.tables import pst_record, pst_text
    from mistray.analyses.pst.transmittance import pst
    from mistray.recorders.directions import DirectionGrid

    angles_deg = FIELD_ANGLES if options.field_deg is None else options.field_deg
    grid = DirectionGrid.of(angles_deg, options.azimuths_deg, options.cell_deg, options.azimuth_cell_deg)
    maps_at, shown = _maps_at(options, grid), options.paths_shown
    state = None if options.method == "forward" else options.saved_run(STATE)
    scene = options.load()
    passes: list[PstProgress] = []
    saved = SavedRun(state, lambda: _so_far(passes), options.resume)
    files: list[Path] = []
    with saved.told():
        with options.workers(), _progress(options) as draw:

            def progress(now: PstProgress) -> None:
                passes.append(now)
                draw(now)

            found = pst(
                scene,
                angles_deg,
                method=options.method,
                convention=options.convention,
                azimuths_deg=options.azimuths_deg,
                cell_deg=options.cell_deg,
                azimuth_cell_deg=options.azimuth_cell_deg,
                detector=options.detector,
                relative_error=options.relative_error,
                error_up_to_deg=options.up_to_deg,
                paths=shown > 0,
                map_pixels=(MAP_PIXELS if options.map_pixels is None else options.map_pixels) if maps_at else 0,
                state=state,
                resume=options.resume,
                progress=progress,
                seconds=options.seconds_left(PAGE_S),
                next_order=not options.no_next_order,
                **options.spectral_settings(),
            )
        maps = _maps(found, options, maps_at) if options.formats else {}

        def page(title: str, command: str) -> Report:
            from mistray.analyses.pst.page import pst_report  # imports what draws

            return pst_report(found, title, command, shown, maps_at)

        files = options.write(page, maps=maps)
    return saved.code or options.show(lambda: pst_record(found, shown), lambda: pst_text(found, shown), files)


def _check(options: Options) -> None:
    """Refuse arguments that do not fit together."""
    options.check()
    if options.relative_error is None:
        options.refuse(["up_to_deg"], " is about --relative-error; give that too, or leave it out")
    if options.map_field_deg is None:
        pictures = [name for name in options.formats if name in MAP_FORMATS]
        if pictures:
            raise MistrayError(
                f"--formats {pictures[0]} writes irradiance maps; say with --map-field-deg of which angles"
            )
        options.refuse(["map_pixels", "map_azimuth_deg"], " without --map-field-deg; say which angles to draw")
    elif options.out is None:
        raise MistrayError("--map-field-deg draws pictures; say with --out where they shall go")
    if options.method == "forward":
        why = " with --method forward, which cannot go on from a saved run"
        options.refuse(["resume", "state"], why)
    options.check_resume()


def _maps(found: Pst, options: Options, maps_at: list[tuple[float, float]]) -> dict[str, IrradianceMap]:
    """The maps by file name: for a source of 1 W/mm² across its beam."""
    from mistray.analyses.pst.page import map_name
    from mistray.files.irradiance_files import IrradianceMap

    return {
        map_name(found, *at): IrradianceMap(
            *found.irradiance(*at),
            found.extent_mm,
            {"command": options.command_line, "angle_deg": at[0], "azimuth_deg": at[1], "source_W_mm2": 1.0},
        )
        for at in maps_at
    }


def _maps_at(options: Options, grid: DirectionGrid) -> list[tuple[float, float]]:
    """Directions whose maps of the detector are drawn; each must lie in a cell."""
    if options.map_field_deg is None:
        return []
    azimuth = float((options.azimuths_deg or [0.0])[0]) if options.map_azimuth_deg is None else options.map_azimuth_deg
    signed = dict.fromkeys(options.map_field_deg)
    directions = [(angle, azimuth) if angle >= 0 else (-angle, azimuth + 180) for angle in signed]
    for direction in directions:
        grid.nearest(*direction)
    return directions


def _so_far(passes: list[PstProgress]) -> str:
    if not passes or not passes[-1].rays_done:
        return "the saved run is still"
    worst = passes[-1].worst_error
    reached = f", worst error {percent_text(worst)}," if math.isfinite(worst) else ""
    return f"{passes[-1].rays_done:.3g} start rays{reached} are"


@contextlib.contextmanager
def _progress(options: Any) -> Iterator[Callable[[PstProgress], None]]:
    """A bar on stderr when that is a terminal."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed}{postfix}") as bar:

        def draw(now: PstProgress) -> None:
            if bar is not None:
                bar.set_postfix_str(_state_of(now), refresh=False)
                bar.n = max(now.share_done, bar.n)
                bar.refresh()

        yield draw


def _state_of(now: PstProgress) -> str:
    """Error and time left as the bar shows them, "error 3.1 % of 2 %, 01:23 left"."""
    error = (
        f"error {percent_text(now.worst_error)}" if math.isfinite(now.worst_error) else "no light yet at some angles"
    )
    if not now.rays_done:
        error = "the pilot is done"
    if now.requested_error is not None and math.isfinite(now.worst_error):
        error += f" of {100 * now.requested_error:g} %"
    if not math.isfinite(now.seconds_left):
        return error
    minutes, seconds = divmod(round(now.seconds_left), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{error}, {f'{hours}:' if hours else ''}{minutes:02d}:{seconds:02d} left"

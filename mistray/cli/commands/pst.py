"""`mistray pst`."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import FIELD_ANGLES, Help, add_angles
from mistray.cli.claims import claim_files, claim_folder
from mistray.cli.saved_run import SavedRun
from mistray.cli.tracing_arguments import (
    MAP_FORMATS,
    TABLE_FORMATS,
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_scheduler,
    add_seconds,
    add_spectrum,
    check_formats,
    check_weights,
    scene_title,
    seconds_left,
    settings_of,
    show,
    start_mitsuba,
    terminal_bar,
    workers_of,
    working,
)
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, AZIMUTH_WIDTH_DEG, CELL_WIDTH_DEG, PIXELS, POLAR_DEG, RELATIVE_ERROR, ROWS

if TYPE_CHECKING:
    from mistray.analysis import Pst
    from mistray.analysis.pst.state import PstProgress
    from mistray.recorders.directions import DirectionGrid

MAP_PIXELS = 64
STATE = "pst_state.npz"

# What --out writes
FILES = ("report.html", "pst.*", "pst_*.csv", "pst_*.png", "irradiance_*deg.png", STATE)


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "pst",
        help="point source transmittance against field angle, with causes",
        description="Irradiance on the detector from a distant source over that of the source (PST), against the\n"
        "field angle: direct image, ghosts, single and multiple scatter, with standard errors and the strongest paths.",
        epilog="examples:\n"
        "  mistray pst phone_camera_scatter --out out\n"
        "  mistray pst baffle_tube --field-deg 0:10:1 12:80:2 --max-scatters 3 --rays 1e6\n"
        "  mistray pst scene.xml --relative-error 0.02 --up-to-deg 60 --out out    # until 2 % everywhere up to 60°\n"
        "  mistray pst scene.xml --relative-error 0.01 --up-to-deg 60 --out out --resume    # go on to 1 %\n"
        "  mistray pst scene.xml --azimuths-deg 0:350:10 --map-field-deg 20 40 --out out\n"
        "  mistray pst scene.xml --field-deg 0 10 20 --method forward --convention projected --json",
        formatter_class=Help,
    )
    add_scene(parser)
    directions = parser.add_argument_group("directions (angles: numbers, and ranges first:last:step)")
    add_angles(directions, "--field-deg", "field angles, ascending (0:80:2)")
    add_angles(directions, "--azimuths-deg", "azimuths of a map, from +y towards -x (the mean over all)", AZIMUTH_DEG)
    directions.add_argument("--cell-deg", type=CELL_WIDTH_DEG, metavar="DEG",
                            help="width of the cells of field angle that the PST is averaged over (2)")  # fmt: skip
    directions.add_argument("--azimuth-cell-deg", type=AZIMUTH_WIDTH_DEG, metavar="DEG",
                            help="and of azimuth (the distance of two azimuths)")  # fmt: skip
    result = parser.add_argument_group("result")
    result.add_argument("--method", choices=("adjoint", "forward"), default="adjoint",
                        help="one trace from the detector, or one beam for each angle (adjoint)")  # fmt: skip
    result.add_argument("--convention", choices=("normal", "projected"), default="normal",
                        help="E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ) (normal)")  # fmt: skip
    result.add_argument("--detector", metavar="ID", help="shape with the sensor, where the scene has several")
    result.add_argument("--relative-error", type=RELATIVE_ERROR, metavar="E",
                        help="take the rays that this standard error over the PST needs at every angle")  # fmt: skip
    result.add_argument("--up-to-deg", type=POLAR_DEG, metavar="DEG",
                        help="angles beyond this do not count for --relative-error")  # fmt: skip
    source = parser.add_argument_group("source (default: as the scene says)")
    add_spectrum(source)
    rays = "start rays in all, or for each angle (forward); with --relative-error the most (4e6; 2e5)"
    tracing = add_ray_tree(parser, rays)
    add_seconds(tracing)
    add_scheduler(tracing)
    add_scatter(parser)
    saved = parser.add_argument_group("saved run (adjoint)")
    saved.add_argument("--state", type=Path, metavar="FILE",
                       help=f"what is finished, renewed as the run goes on ({STATE} in --out)")  # fmt: skip
    saved.add_argument("--resume", action="store_true", help="go on from the saved run")
    formats = (*TABLE_FORMATS, *MAP_FORMATS)
    output = add_output(parser, "report.html, CSV, JSON and PNG files", FILES, formats=formats)
    output.add_argument("--paths-shown", type=ROWS, default=4, metavar="N",
                        help="strongest stray paths of each angle; 0: no paths (4)")  # fmt: skip
    add_angles(output, "--map-field-deg", "field angles of irradiance maps of the detector (need --out)")
    output.add_argument("--map-azimuth-deg", type=AZIMUTH_DEG, metavar="DEG", help="their azimuth (the first one)")
    output.add_argument("--map-pixels", type=PIXELS, metavar="N", help=f"pixels along their longer side ({MAP_PIXELS})")
    parser.take_old_name("--angles-deg", "--field-deg")
    parser.take_old_name("--map-angles-deg", "--map-field-deg")
    parser.set_defaults(run=run, outputs=("out", "state"))


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    _check(options)
    start_mitsuba(options)
    from mistray.analysis.pst.transmittance import pst
    from mistray.recorders.directions import DirectionGrid
    from mistray.report.tables.pst import pst_record, pst_text
    from mistray.scene import load

    claim_folder(options)
    grid = DirectionGrid.of(
        FIELD_ANGLES if options.field_deg is None else options.field_deg,
        options.azimuths_deg,
        options.cell_deg,
        options.azimuth_cell_deg,
    )
    maps_at = _maps_at(options, grid)
    state = _state(options)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    passes: list[PstProgress] = []
    saved = SavedRun(state, lambda: _so_far(passes), options.resume)
    files: list[Path] = []
    with saved.told():
        with workers_of(options), _progress(options) as draw:

            def progress(now: PstProgress) -> None:
                passes.append(now)
                draw(now)

            found = pst(
                scene,
                grid.field_deg,
                method=options.method,
                convention=options.convention,
                azimuths_deg=None if options.azimuths_deg is None else grid.azimuths_deg,
                cell_deg=options.cell_deg,
                azimuth_cell_deg=options.azimuth_cell_deg,
                wavelength_nm=options.wavelength_nm,
                weights=options.weights,
                detector=options.detector,
                relative_error=options.relative_error,
                error_up_to_deg=options.up_to_deg,
                paths=options.paths_shown > 0,
                map_pixels=(MAP_PIXELS if options.map_pixels is None else options.map_pixels) if maps_at else 0,
                state=state,
                resume=options.resume,
                progress=progress,
                seconds=seconds_left(options),
                **settings_of(options),
            )
        if options.out is not None:
            from mistray.report.pst_output import write_pst

            title = scene_title(options.scene)
            with working("drawing the report", options.quiet):
                files = write_pst(found, options.out, title, options.command_line, options.paths_shown, maps_at)
                files += _write_formats(found, options, maps_at)
    if saved.code:
        return saved.code
    shown = options.paths_shown
    show(options, lambda: pst_record(found, shown), lambda: pst_text(found, shown), files)
    return 0


def _check(options: argparse.Namespace) -> None:
    """Refuse arguments that do not fit together."""
    check_weights(options)
    if options.up_to_deg is not None and options.relative_error is None:
        raise MistrayError("--up-to-deg is about --relative-error; give that too, or leave it out")
    check_formats(options)
    pictures = [name for name in options.formats if name in MAP_FORMATS]
    if pictures and options.map_field_deg is None:
        raise MistrayError(f"--formats {pictures[0]} writes irradiance maps; say with --map-field-deg of which angles")
    if options.map_field_deg is not None and options.out is None:
        raise MistrayError("--map-field-deg draws pictures; say with --out where they shall go")
    for name in ("map_pixels", "map_azimuth_deg"):
        if getattr(options, name) is not None and options.map_field_deg is None:
            raise MistrayError(f"--{name.replace('_', '-')} without --map-field-deg; say which angles to draw")
    if options.method == "forward" and (options.resume or options.state is not None):
        given = "resume" if options.resume else "state"
        raise MistrayError(f"--{given} with --method forward; only the adjoint method can go on from a saved run")
    if options.resume and options.state is None and options.out is None:
        raise MistrayError("--resume needs the saved run; give --state FILE, or the --out DIR of that run")


def _write_formats(found: Pst, options: argparse.Namespace, maps_at: list[tuple[float, float]]) -> list[Path]:
    """The tables as Parquet, and the maps in the other formats: for a source of 1 W/mm² across its beam."""
    from mistray.report import IrradianceMap, write_formats
    from mistray.report.pst_output import csv_tables, map_name

    maps = {
        map_name(found, *at): IrradianceMap(
            *found.irradiance(*at),
            found.extent_mm,
            {"command": options.command_line, "angle_deg": at[0], "azimuth_deg": at[1], "source_W_mm2": 1.0},
        )
        for at in maps_at
    }
    return write_formats(options.formats, options.out, csv_tables(found), maps, {"command": options.command_line})


def _maps_at(options: argparse.Namespace, grid: DirectionGrid) -> list[tuple[float, float]]:
    """Directions whose maps of the detector are drawn; each must lie in a cell."""
    if options.map_field_deg is None:
        return []
    azimuth = float(grid.azimuths_deg[0]) if options.map_azimuth_deg is None else options.map_azimuth_deg
    directions = [(angle, azimuth) for angle in dict.fromkeys(options.map_field_deg)]
    for direction in directions:
        grid.nearest(*direction)
    return directions


def _state(options: argparse.Namespace) -> Path | None:
    """File of the saved run: the one given, else one in the output directory; None: nothing is saved."""
    path = options.state
    if path is None and options.out is not None and options.method == "adjoint":
        path = options.out / STATE
    if path is None:
        return None
    if options.state is not None:
        claim_files(options, path)
    if path.is_dir():
        raise MistrayError(f"--state {path} is a directory; name a file")
    if options.resume and not path.exists():
        raise MistrayError(f"--resume: there is no saved run '{path}'; run without --resume first")
    return Path(path)


def _so_far(passes: list[PstProgress]) -> str:
    if not passes:
        return "the saved run is still"
    worst = passes[-1].worst_error
    reached = f", worst error {100 * worst:.2g} %," if math.isfinite(worst) else ""
    return f"{passes[-1].rays_done:.3g} start rays{reached} are"


@contextlib.contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Callable[[PstProgress], None]]:
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
    error = f"error {100 * now.worst_error:.2g} %" if math.isfinite(now.worst_error) else "no light yet at some angles"
    if now.wanted_error is not None and math.isfinite(now.worst_error):
        error += f" of {100 * now.wanted_error:g} %"
    if not math.isfinite(now.seconds_left):
        return error
    minutes, seconds = divmod(round(now.seconds_left), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{error}, {f'{hours}:' if hours else ''}{minutes:02d}:{seconds:02d} left"

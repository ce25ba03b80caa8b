"""`mistray study`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mistray.cli.arguments import FIELD_ANGLES, Help, add_angles
from mistray.cli.claims import claim_folder
from mistray.cli.saved_run import SavedRun
from mistray.cli.tracing_arguments import (
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
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, RELATIVE_ERROR

STATE = "pst_state.npz"
STEPS = 8

# What --out writes
FILES = ("report.html", "[1-8]_*.csv", STATE)


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "study",
        help="whole stray-light study: model, objects, scatter, sampling, ghosts and PST in one report",
        description="Run the eight steps of a stray-light study: optical model, mechanical model, critical,\n"
        "illuminated and common objects, coatings and scatter models, importance sampling, and the analysis\n"
        "(ghosts at some fields, PST at all angles, causes). Prints what was found; --out writes one report.",
        epilog="examples:\n"
        "  mistray study phone_camera_scatter --quick --out out\n"
        "  mistray study scene.xml --pst-field-deg 0:80:2 --field-deg 0 10 18 22 --rays 4e6 --out out\n"
        "  mistray study scene.xml --relative-error 0.05 --rays 1e8 --out out    # until 5 % at every angle\n"
        "  mistray study scene.xml --quick --json",
        formatter_class=Help,
    )
    add_scene(parser)
    what = parser.add_argument_group("what is traced")
    add_angles(what, "--pst-field-deg", "field angles of the PST, numbers and ranges first:last:step (0:80:2)")
    what.add_argument("--field-deg", type=FIELD_DEG, nargs="+", metavar="DEG",
                      help="field angles of the ghosts (0, 1/2, 1 and 5/4 of the half field)")  # fmt: skip
    what.add_argument("--azimuth-deg", type=AZIMUTH_DEG, metavar="DEG",
                      help="azimuth of these fields (as the scene says)")  # fmt: skip
    what.add_argument("--quick", action="store_true", help="fewer rays, for a first look")
    what.add_argument("--relative-error", type=RELATIVE_ERROR, metavar="E",
                      help="go on until the standard error over the PST is below this at every angle")  # fmt: skip
    what.add_argument("--convention", choices=("normal", "projected"), default="normal",
                      help="PST as E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ) (normal)")  # fmt: skip
    add_spectrum(what)
    rays = "start rays of the PST; objects get a fifth at each angle, ghosts a tenth (1e6; quick: 1e5)"
    tracing = add_ray_tree(parser, rays)
    add_seconds(tracing)
    add_scheduler(tracing)
    add_scatter(parser)
    output = add_output(
        parser, "report.html and a CSV file of every table", FILES, shown="findings", formats=TABLE_FORMATS
    )
    output.add_argument("--resume", action="store_true", help="go on with the PST that was saved in --out")
    parser.take_old_name("--angles-deg", "--pst-field-deg")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    check_weights(options)
    check_formats(options)
    if options.resume and options.out is None:
        raise MistrayError("--resume needs the folder of the saved run; give --out")
    start_mitsuba(options)
    from mistray.analysis.study.eight_steps import study
    from mistray.report.tables.study import study_record, study_text
    from mistray.scene import load

    state, folder = None, claim_folder(options)
    if folder is not None:
        state = folder / STATE
        if options.resume and not state.exists():
            raise MistrayError(f"--resume: there is no saved run '{state}'; run without --resume first")
        if not state.parent.exists():
            state.parent.mkdir(parents=True)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    saved = SavedRun(state, lambda: "the PST so far is", options.resume)
    files: list[Path] = []
    with saved.told():
        with workers_of(options), _progress(options) as progress:
            found = study(
                scene,
                FIELD_ANGLES if options.pst_field_deg is None else options.pst_field_deg,
                options.field_deg,
                quick=options.quick,
                wavelength_nm=options.wavelength_nm,
                weights=options.weights,
                azimuth_deg=options.azimuth_deg,
                relative_error=options.relative_error,
                convention=options.convention,
                state=state,
                resume=options.resume,
                name=scene_title(options.scene),
                progress=progress,
                seconds=seconds_left(options),
                **settings_of(options),
            )
        if options.out is not None:
            from mistray.report.formats import write_formats
            from mistray.report.study_output import csv_tables, write_study

            with working("drawing the report", options.quiet):
                files = write_study(found, options.out, options.command_line)
                tables = csv_tables(found)
                files += write_formats(options.formats, options.out, tables, {}, {"command": options.command_line})
    if saved.code:
        return saved.code
    show(options, lambda: study_record(found), lambda: study_text(found), files)
    return 0


@contextlib.contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Callable[[int, str, float], None] | None]:
    """A bar over the steps on stderr when that is a terminal."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed}", what="study") as bar:

        def draw(step: int, what: str, share: float) -> None:
            assert bar is not None
            bar.set_description_str(f"step {step} of {STEPS}, {what}", refresh=False)
            bar.n = share
            bar.refresh()

        yield None if bar is None else draw

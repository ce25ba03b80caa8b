"""`mistray sweep`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import INTERRUPTED, RAW, field, finite, positive
from mistray.cli.tracing_arguments import (
    TABLE_FORMATS,
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_scheduler,
    check_formats,
    claim_output,
    progress_bar,
    scene_title,
    settings_of,
    show,
    start_mitsuba,
    workers_of,
    working,
)
from mistray.errors import MistrayError, UnfinishedError

if TYPE_CHECKING:
    from mistray.sweeps import Sweep


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "sweep",
        help="trace all fields at all wavelengths in all configurations: one table",
        description="Trace a scene at every field and wavelength, in every configuration: zoom positions, coatings,\n"
        "temperatures as shifts of indices, whatever parameters of the scene say. STUDY is a TOML file with the\n"
        "configurations; docs/sweeps.md describes it. Rows that were traced before come from the cache.",
        epilog="examples:\n"
        "  mistray sweep cooke_triplet --field-deg 0 10 20 --wavelength-nm 450 550 650\n"
        "  mistray sweep cooke_triplet examples/triplet_states.toml --field-deg 0 20 --rays 1e5 --out out/sweep\n"
        "  mistray sweep scene.xml states.toml --json --no-cache",
        formatter_class=RAW,
    )
    add_scene(parser)
    parser.add_argument("study", metavar="STUDY", nargs="?", type=Path,
                        help="TOML file with the configurations (the scene as it is)")  # fmt: skip
    what = parser.add_argument_group("what is traced (default: as the scene says)")
    what.add_argument("--field-deg", type=field, nargs="+", metavar="DEG", help="field angles, degrees")
    what.add_argument("--azimuth-deg", type=finite, metavar="DEG", help="azimuth of the fields about z, degrees")
    what.add_argument("--wavelength-nm", type=positive, nargs="+", metavar="NM", help="wavelengths, nm")
    add_scheduler(add_ray_tree(parser, "start rays of every row (1e6)"))
    add_scatter(parser)
    output = add_output(parser, "report.html, CSV files, JSON and a picture", formats=TABLE_FORMATS)
    output.add_argument("--no-cache", action="store_true", help="neither read results from the cache nor keep them")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    check_formats(options)
    start_mitsuba(options)
    from mistray.report.sweep_tables import sweep_record, sweep_text
    from mistray.sweeps import Sweep, read_configurations, sweep

    claim_output(options)
    configurations = None if options.study is None else read_configurations(options.study)
    files = []
    before = _entries(options)
    try:
        with workers_of(options), progress_bar(options) as progress:
            result = sweep(
                options.scene,
                options.field_deg,
                options.wavelength_nm,
                configurations,
                azimuth_deg=options.azimuth_deg,
                cache=False if options.no_cache else None,
                progress=progress,
                **settings_of(options),
            )
    except UnfinishedError as error:
        if options.out is not None and isinstance(error.partial, Sweep) and error.partial.rows:
            _write(error.partial, options, ", unfinished")
            error.args = (f"{error}; the rows that are finished are in {options.out}",)
        raise
    except KeyboardInterrupt:
        if _entries(options) <= before:
            raise
        print("mistray: interrupted; finished rows are in the cache, the same command goes on", file=sys.stderr)
        return INTERRUPTED
    for warning in result.warnings:
        print(f"mistray: warning: {warning}", file=sys.stderr)
    if options.out is not None:
        files = _write(result, options)
    show(options, lambda: sweep_record(result), lambda: sweep_text(result), files)
    return 0


def _entries(options: argparse.Namespace) -> int:
    """Results in the cache; 0 without one."""
    from mistray.cache import open_cache

    cache = open_cache(False if options.no_cache else None)
    try:
        return 0 if cache is None else cache.contents().entries
    except MistrayError:  # the sweep will say so
        return 0


def _write(result: Sweep, options: argparse.Namespace, note: str = "") -> list[Path]:
    from mistray.report.formats import write_formats
    from mistray.report.sweep_output import sweep_tables, write_sweep

    with working("drawing the report", options.quiet):
        files = write_sweep(result, options.out, f"{scene_title(options.scene)}{note}", options.command_line)
        facts = {"command": options.command_line}
        return files + write_formats(options.formats, options.out, sweep_tables(result), {}, facts)

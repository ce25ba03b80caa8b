"""`mistray sweep`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import INTERRUPTED, Help, add_angles
from mistray.cli.claims import claim_folder
from mistray.cli.tracing_arguments import (
    TABLE_FORMATS,
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_scheduler,
    add_seconds,
    check_formats,
    progress_bar,
    scene_title,
    seconds_left,
    settings_of,
    show,
    start_mitsuba,
    workers_of,
    working,
)
from mistray.errors import MistrayError, UnfinishedError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, WAVELENGTH_NM

if TYPE_CHECKING:
    from mistray.sweeps import EditRanking, PstSweep, Sweep

# What --out writes
FILES = ("report.html", "configurations.csv", "sweep.*", "pst_sweep.csv", "edit_ranking.csv")


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
        "  mistray sweep scene.xml states.toml --json --no-cache\n"
        "  mistray sweep baffle_tube edits.toml --pst-field-deg 10:60:10 --rays 1e6    # what each edit does\n"
        "  mistray sweep baffle_tube --pst-field-deg 10:60:10 --rank --step rim=0.5     # which would pay",
        formatter_class=Help,
    )
    add_scene(parser)
    parser.add_argument("study", metavar="STUDY", nargs="?", type=Path,
                        help="TOML file with the configurations (the scene as it is)")  # fmt: skip
    what = parser.add_argument_group("what is traced (default: as the scene says)")
    what.add_argument("--field-deg", type=FIELD_DEG, nargs="+", metavar="DEG", help="field angles, degrees")
    what.add_argument("--azimuth-deg", type=AZIMUTH_DEG, metavar="DEG", help="azimuth of the fields about z, degrees")
    add_angles(what, "--pst-field-deg", "instead of fields: the PST at these field angles before and after what each "
               "configuration moves, paints, coats or blocks")  # fmt: skip
    what.add_argument("--rank", action="store_true",
                      help="with --pst-field-deg: rank what can be moved, blocked, painted and coated by the "
                      "derivatives of the stray PST; STUDY may be left out")  # fmt: skip
    what.add_argument("--step", nargs="+", type=_step, metavar="KEY=STEP",
                      help="of --rank: steps by kind (position, tilt, rim, scatter, share, coating), key or pattern, "
                      "in the unit of the parameter or per cent of its value, 2%% (0.1 mm and deg; 1%% of scatter and "
                      "of R; 1 nm)")  # fmt: skip
    what.add_argument("--wavelength-nm", type=WAVELENGTH_NM, nargs="+", metavar="NM", help="wavelengths, nm")
    tracing = add_ray_tree(parser, "start rays of every row (1e6; 4e6 with --pst-field-deg)")
    add_seconds(tracing)
    add_scheduler(tracing)
    add_scatter(parser)
    output = add_output(parser, "report.html, CSV files, JSON and a picture", FILES, formats=TABLE_FORMATS)
    output.add_argument("--no-cache", action="store_true", help="neither read results from the cache nor keep them")
    parser.take_old_name("--pst-deg", "--pst-field-deg")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    if options.pst_field_deg is not None:
        return _run_pst(options)
    if options.rank or options.step:
        raise MistrayError("--rank and --step are about the PST; give its field angles with --pst-field-deg")
    check_formats(options)
    start_mitsuba(options)
    from mistray.report.tables.sweep import sweep_record, sweep_text
    from mistray.sweeps import Sweep, read_configurations, sweep

    claim_folder(options)
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
                seconds=seconds_left(options),
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


def _run_pst(options: argparse.Namespace) -> int:
    """What the configurations do to the PST."""
    given = {
        "--field-deg": options.field_deg,
        "--azimuth-deg": options.azimuth_deg,
        "--formats": options.formats,
        "--seconds": options.seconds,
        "--no-cache": options.no_cache or None,
    }
    for name, value in given.items():
        if value:
            raise MistrayError(f"{name} is for traces of fields; leave it out with --pst-field-deg")
    if options.study is None and not options.rank:
        raise MistrayError("--pst-field-deg compares configurations; give a TOML file with them, or --rank")
    if options.step and not options.rank:
        raise MistrayError("--step is about the ranking; give --rank as well, or leave it out")
    start_mitsuba(options)
    folder = claim_folder(options)
    records: list[dict[str, Any]] = []
    texts: list[str] = []
    files: list[Path] = []
    if options.study is not None:
        from mistray.report.tables.pst_sweep import pst_sweep_record, pst_sweep_text, write_pst_sweep

        found = _swept_pst(options)
        records.append(pst_sweep_record(found))
        texts.append(pst_sweep_text(found))
        files += [] if folder is None else write_pst_sweep(found, folder, options.command_line)
    if options.rank:
        from mistray.report.tables.edit_ranking import edit_ranking_record, edit_ranking_text, write_edit_ranking

        ranking = _ranked(options)
        records.append(edit_ranking_record(ranking))
        texts.append(edit_ranking_text(ranking))
        files += [] if folder is None else write_edit_ranking(ranking, folder, options.command_line)
    record = {key: value for part in records for key, value in part.items()}
    show(options, lambda: record, lambda: "\n\n".join(texts), files, files[-1].name if files else "")
    return 0


def _swept_pst(options: argparse.Namespace) -> PstSweep:
    """The PST in each configuration."""
    from mistray.sweeps import read_configurations, sweep_pst

    with workers_of(options), progress_bar(options) as progress:
        return sweep_pst(
            options.scene,
            read_configurations(options.study),
            options.pst_field_deg,
            progress=progress,
            wavelength_nm=options.wavelength_nm,
            **settings_of(options),
        )


def _ranked(options: argparse.Namespace) -> EditRanking:
    """What can be edited, by the derivatives of the PST."""
    from mistray.sweeps import rank_edits

    settings = {"wavelength_nm": options.wavelength_nm, **settings_of(options)}
    with workers_of(options), progress_bar(options) as progress:
        return rank_edits(
            options.scene,
            options.pst_field_deg,
            steps=dict(options.step or ()),
            progress=progress,
            **{key: value for key, value in settings.items() if value is not None},
        )


def _step(text: str) -> tuple[str, str]:
    """A kind, key or pattern, and a step."""
    key, sign, value = text.rpartition("=")
    if not sign or not key:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no step; write KEY=STEP, such as rim=0.5 or paint.reflectance=2%"
        )
    return key, value


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

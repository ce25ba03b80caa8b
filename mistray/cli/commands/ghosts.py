"""`mistray ghosts`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import Help
from mistray.cli.claims import claim_folder
from mistray.cli.ghosts_json import WORST_SHOWN, as_json
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
    progress_bar,
    scene_title,
    seconds_left,
    settings_of,
    show,
    start_mitsuba,
    workers_of,
    working,
)
from mistray.errors import Interrupted, MistrayError, UnfinishedError
from mistray.ranges import AZIMUTH_DEG, BLOCK, FIELD_DEG, PART, SECONDS, STOPS
from mistray.time_budget import within

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from mistray.analysis import GhostReport
    from mistray.report import Look


# Of --seconds: the maps of a report trace the same rays again, and pictures take seconds, more with each field
SHARE_OF_TRACE = 0.45
PAGE_S, FIELD_S = 4.0, 1.0
MOST_OF_PICTURES = 0.4
ALL_ALIASES = ("part", "space")
# Of `mistray.analysis.ranking` and `mistray.analysis.path_analysis`, not imported to parse a command line
RANKS = ("rms", "power", "peak")
SORT_KEYS = ("power_W", "objects", "branches", "last_object", "unique_objects", "opl_mm", "diffractions")

# What --out writes
FILES = (
    "report.html",
    "summary*.csv",
    "paths*.csv",
    "energy*.csv",
    "surfaces*.csv",
    "scatter*.csv",
    "stray_levels.csv",
    "aiming.csv",
    "aliased_paths.csv",
    "path_analysis.csv",
    "filtered_*.csv",
    "overview.png",
    "levels.png",
    "ghosts_*deg.png",
    "layout_*deg.png",
    "colour_*deg.png",
    "path_sort_*deg.txt",
)


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "ghosts",
        help="trace the ghosts and the scattered light of a scene and rank them",
        description="Trace a scene at one or more field angles, list all paths to the detector and rank the stray\n"
        "ones by RMS irradiance P/(π r_rms²), by power or by their brightest pixel. The strongest path by power is\n"
        "always listed.",
        epilog="examples:\n"
        "  mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json\n"
        "  mistray ghosts scene.xml --max-scatters 2 --max-reflections 1 --aimed-rays 4 --out out\n"
        "  mistray ghosts scene.xml --out out --formats parquet fits\n"
        "  mistray ghosts scene.xml --rays 1e9 --scheduler tcp://host:8786 --out out    # docs/distributed.md\n"
        "  mistray ghosts scene.xml --wavelength-nm 450 550 650 --weights 1 2 1 --colour --out out",
        formatter_class=Help,
    )
    add_scene(parser)
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=FIELD_DEG, nargs="+", metavar="DEG", help="field angles, degrees")
    source.add_argument("--azimuth-deg", type=AZIMUTH_DEG, metavar="DEG", help="azimuth of the field about z, degrees")
    add_spectrum(source)
    rays = add_ray_tree(parser, "start rays at each field (1e6)")
    add_seconds(rays)
    add_scheduler(rays)
    add_scatter(parser)
    formats = (*TABLE_FORMATS, *MAP_FORMATS)
    output = add_output(parser, "report.html, CSV, PNG and path-sort files", FILES, formats=formats)
    output.add_argument("--rank", choices=RANKS, default="rms",
                        help="what the list of worst paths goes by: RMS irradiance, power, or peak, the brightest "
                        "pixel, for which the rays are traced again (rms)")  # fmt: skip
    output.add_argument("--per-wavelength", action="store_true", help="add paths and ledgers at each wavelength")
    output.add_argument("--levels", action="store_true",
                        help="print stray light by level of scatter or splitting and by critical surface")  # fmt: skip
    output.add_argument("--alias", nargs="+", type=_alias, metavar="PATTERN=NAME",
                        help="add the paths with surfaces under other names, such as 'L1_*=L1'; or part or space: by "
                        "part, by optical space; with --out aliased_paths.csv")  # fmt: skip
    output.add_argument(
        "--path-analysis",
        choices=SORT_KEYS,
        metavar="KEY",
        help=f"add the paths sorted by a key: {', '.join(SORT_KEYS)}; with --out path_analysis.csv",
    )
    output.add_argument("--least-share", type=PART, metavar="S",
                        help="in the path analysis paths below this share of all light stand together (0)")  # fmt: skip
    output.add_argument("--filter", metavar="EXPR",
                        help="add the paths that pass a filter, such as 'G(lens*) & !S' (docs/rays.md), and with --out "
                        "filtered_paths.csv and filtered_rays.csv")  # fmt: skip
    colour = parser.add_argument_group("colour pictures (need --out and three wavelengths or more)")
    colour.add_argument("--colour", action="store_true", help="draw the ghosts as a photograph would show them")
    colour.add_argument("--stops", type=STOPS, metavar="S",
                        help="exposure, stops over the one that just fills the brightest channel (0)")  # fmt: skip
    colour.add_argument("--reference", choices=("ghosts", "direct"),
                        help="brightest pixel of the stray light, or of the direct image on axis (ghosts)")  # fmt: skip
    colour.add_argument("--white", choices=("source", "D65"),
                        help="what comes out as grey: the light of the source, or D65 (source)")  # fmt: skip
    colour.add_argument("--block", type=BLOCK, metavar="N",
                        help="pixels averaged along each side; 0: as many as the noise asks for (0)")  # fmt: skip
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    start_mitsuba(options)
    from mistray.analysis import ghosts
    from mistray.report import main_table
    from mistray.scene import load
    from mistray.trace.path_filter import PathFilter

    check_weights(options)
    check_formats(options)
    look = _look(options)
    PathFilter(options.filter or "")  # an error in its text shows before the trace
    _aliases(options.alias)
    if options.least_share is not None and options.path_analysis is None:
        raise MistrayError("--least-share is about the path analysis; add --path-analysis power_W, or leave it out")
    if not 0 <= (options.least_share or 0.0) < 1:
        raise MistrayError(f"--least-share is {options.least_share:g}; it is a share of all light, 0 to 1")
    claim_folder(options)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    if look is not None:
        from mistray.report.colour import check_wavelengths

        check_wavelengths(options.wavelength_nm or _own_wavelengths(scene))
    lines = options.per_wavelength
    files, report = [], None
    try:
        with within(seconds_left(options)), workers_of(options):
            with progress_bar(options) as progress:
                report = ghosts(
                    scene,
                    field_deg=options.field_deg,
                    wavelength_nm=options.wavelength_nm,
                    weights=options.weights,
                    azimuth_deg=options.azimuth_deg,
                    progress=progress,
                    rank=options.rank,
                    seconds=_seconds_of_trace(options),
                    **settings_of(options),
                )
            if options.rank == "peak":
                with working("mapping the paths", options.quiet):
                    for field in report:
                        report.table(field)
            extra = _Extra(report, options)
            if options.out is not None:
                files = _write_report(report, extra, options, look)
    except UnfinishedError as error:
        if report is not None:  # all is traced, but for the maps
            error.partial = report
        _write_unfinished(error, options)
        raise
    except KeyboardInterrupt as error:
        finished = error.partial if isinstance(error, Interrupted) else report
        if not isinstance(finished, Mapping) or not finished or options.out is None:
            raise KeyboardInterrupt from None
        _write_tables(finished, options)
        raise Interrupted(f"{error}" if isinstance(error, Interrupted) else "all is traced", finished) from None

    def text() -> str:
        return "\n\n".join([main_table(report, WORST_SHOWN, lines), *extra.texts()])

    show(options, lambda: as_json(report, lines, options.filter, extra.tables), text, files)
    return 0


def _seconds_of_trace(options: argparse.Namespace) -> float | None:
    """What of --seconds the trace has, so that the report of its rays is written in time, too."""
    left = seconds_left(options)
    if left is None or options.out is None:
        return left
    pictures = min(PAGE_S + FIELD_S * len(options.field_deg or [None]), MOST_OF_PICTURES * left)
    return max(SHARE_OF_TRACE * (left - pictures), SECONDS.low)


def _write_report(report: GhostReport, extra: _Extra, options: argparse.Namespace, look: Look | None) -> list[Path]:
    """All files; where there is no room for them the tables, as many as there is room for."""
    from mistray.report import main_table, write_all

    try:
        with working("drawing the report", options.quiet):
            title = scene_title(options.scene)
            files = write_all(report, options.out, title, options.command_line, options.per_wavelength, look)
            return files + extra.write() + _write_formats(report, options)
    except UnfinishedError:
        raise
    except MistrayError as error:
        kept = ", ".join(path.name for path in _write_tables(report, options)) or "nothing"
        traced = ", ".join(f"{field:g}" for field in report)
        print(main_table(report, WORST_SHOWN, options.per_wavelength))
        raise MistrayError(
            f"{error}; of the fields {traced} deg {kept} is written, and the main table is printed"
        ) from None


class _Extra:
    """Tables that are asked for beside the main ones; made at once, so that a wrong name shows before the drawing."""

    def __init__(self, report: GhostReport, options: argparse.Namespace) -> None:
        from mistray.report.tables.ghosts_csv import alias_frame, analysis_frame, filter_frame, filter_rays

        self._report, self._options = report, options
        self._aliases = _aliases(options.alias)
        self.tables: dict[str, pd.DataFrame] = {}
        self._rays = None
        if options.filter:
            self._filtered = filter_frame(report, options.filter)
            self._rays = partial(filter_rays, report, options.filter)
        if self._aliases is not None:
            self.tables["aliased_paths"] = alias_frame(report, self._aliases)
        if options.path_analysis:
            self.tables["path_analysis"] = analysis_frame(report, options.path_analysis, options.least_share or 0.0)

    def texts(self) -> list[str]:
        """What is printed."""
        from mistray.report.tables.levels import alias_text, analysis_text, filter_text, level_text

        options = self._options
        parts = [level_text(self._report)] if options.levels else []
        parts += [alias_text(self._report, self._aliases)] if self._aliases is not None else []
        if options.path_analysis:
            parts.append(analysis_text(self.tables["path_analysis"], options.path_analysis))
        return parts + ([filter_text(self._report, options.filter)] if options.filter else [])

    def write(self) -> list[Path]:
        """The tables as CSV."""
        from mistray.replace_file import replace_file

        tables = dict(self.tables)
        if self._rays is not None:
            tables |= {"filtered_paths": self._filtered, "filtered_rays": self._rays()}
        return [
            replace_file(self._options.out / f"{name}.csv", table.to_csv(index=False, lineterminator="\n"), "table")
            for name, table in tables.items()
        ]


def _alias(text: str) -> str:
    """PATTERN=NAME, or a word for all surfaces."""
    if text not in ALL_ALIASES and not all(part for part in (*text.rpartition("="),)):
        raise argparse.ArgumentTypeError(f"'{text}' is no alias; give PATTERN=NAME, part or space")
    return text


def _aliases(words: list[str] | None) -> dict[str, str] | str | None:
    """What `mistray.trace.PathTable.by_way` takes."""
    if words is None:
        return None
    alone = [word for word in words if word in ALL_ALIASES]
    if alone and len(words) > 1:
        raise MistrayError(f"--alias {alone[0]} stands for all surfaces; give it alone")
    if alone:
        return alone[0]
    return {pattern: name for pattern, _, name in (word.rpartition("=") for word in words)}


def _write_unfinished(error: UnfinishedError, options: argparse.Namespace) -> None:
    """Write the fields that are finished, and of the last the rays that are, with maps that are traced here."""
    from mistray.analysis import GhostReport
    from mistray.report import write_all

    report = error.partial
    if options.out is None or not isinstance(report, GhostReport):
        return
    rays = "; ".join(f"{field:g}°: {t.rays_traced:.4g} of {t.rays_planned:.4g} rays" for field, t in report.items())
    title = f"{scene_title(options.scene)}, unfinished ({rays})"
    with working("drawing what is finished", options.quiet):
        write_all(report, options.out, title, options.command_line, options.per_wavelength, None)
    error.args = (f"{error}; a report of what is finished is in {options.out}",)


def _write_tables(report: Any, options: argparse.Namespace) -> list[Path]:
    """Write the tables of what is finished, as many as there is room for; maps would take as long as the trace has."""
    from mistray.analysis import GhostReport
    from mistray.replace_file import replace_file
    from mistray.report.tables.ghosts_csv import csv_tables

    files: list[Path] = []
    if isinstance(report, GhostReport):
        with contextlib.suppress(OSError, MistrayError):
            options.out.mkdir(parents=True, exist_ok=True)
            for name, table in csv_tables(report, options.per_wavelength).items():
                files.append(replace_file(options.out / name, table.to_csv(index=False, lineterminator="\n"), "table"))
    return files


def _write_formats(report: GhostReport, options: argparse.Namespace) -> list[Path]:
    """The tables as Parquet, and irradiance_<field>deg in the other formats."""
    from mistray.report import IrradianceMap, write_formats
    from mistray.report.tables.ghosts_csv import csv_tables

    tables = csv_tables(report, options.per_wavelength)
    maps = {f"irradiance_{field:g}deg": IrradianceMap.of(t) for field, t in report.items()}
    return write_formats(options.formats, options.out, tables, maps, {"command": options.command_line})


def _look(options: argparse.Namespace) -> Look | None:
    """How colour pictures shall look; None if there shall be none."""
    given = {key: getattr(options, key) for key in ("stops", "reference", "white", "block")}
    given = {key: value for key, value in given.items() if value is not None}
    if not options.colour:
        if given:
            raise MistrayError(f"--{next(iter(given))} is about colour pictures; add --colour, or leave it out")
        return None
    if options.out is None:
        raise MistrayError("--colour draws pictures; say with --out where they shall go")
    from mistray.report import Look

    return Look(**given)


def _own_wavelengths(scene: Any) -> list[float]:
    return sorted({float(nm) for emitter in scene.emitters() for nm in getattr(emitter, "wavelengths_nm", ())})

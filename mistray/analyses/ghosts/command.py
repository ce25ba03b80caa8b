"""Command `mistray ghosts`, which traces the ghosts and scattered light of a scene and ranks them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mistray.errors import Interrupted, MistrayError, UnfinishedError
from mistray.ranges import SECONDS
from mistray.time_budget import within
from mistray.toolkit.command import Command, Group
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import (
    MAP_FORMATS,
    SCATTER,
    SCENE,
    SCHEDULER,
    SENSORS,
    SOURCE,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mistray.analyses.ghosts.request import GhostsRequest, GhostTables
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.cli.parsed_options import Options

# Of --seconds: the maps of a report trace the same rays again, and pictures take seconds, more with each field
SHARE_OF_TRACE = 0.5
PAGE_S, FIELD_S = 4.0, 1.0
RAY_FORMAT = "dat"  # rays as a source file of Zemax
FILES = (
    "report.html",
    "ghosts.json",
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
    "rays_at.csv",
    "rays_at_*deg.dat",
    "probes.csv",
    "far_fields.csv",
    "surface_maps.csv",
    "light_maps.csv",
    "flux_split.csv",
    "luminous_flux.csv",
    "photometric.csv",
    "overview*.png",
    "levels.png",
    "ghosts_*deg.png",
    "layout_*deg.png",
    "surface_maps_*deg.png",
    "light_maps_*deg.png",
    "colour_*deg.png",
    "path_sort_*deg.txt",
)

COMMAND = Command(
    "ghosts",
    "trace the ghosts and the scattered light of a scene and rank them",
    "Trace a scene at one or more field angles and list all paths to the detector. Stray paths are ranked\n"
    "by RMS irradiance P/(π r_rms²), by power or by their brightest pixel. The strongest path by power is\n"
    "always listed.",
    (
        "mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out",
        "mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json",
        "mistray ghosts scene.xml --probe 0,0,17,half_width=20,half_height=20,id=stop --out out",
        "mistray ghosts double_gauss_barrel --field-deg 20 --surface-maps 'barrel*' hood --out out",
        "mistray ghosts double_gauss_barrel --field-deg 20 --maps ghost 'S(barrel*)' --out out",
        "mistray ghosts phone_camera --field-deg 20 --rays-at 'barrel*' --filter G --formats dat --out out",
        "mistray ghosts phone_camera --wavelength-nm 450 555 650 --weights 1 2 1 --photometric",
        "mistray ghosts scene.xml --max-scatters 2 --max-reflections 1 --aimed-rays 4 --out out",
        "mistray ghosts scene.xml --out out --formats parquet fits",
        "mistray ghosts scene.xml --rays 1e9 --scheduler tcp://host:8786 --out out    # docs/distributed.md",
        "mistray ghosts scene.xml --wavelength-nm 450 550 650 --weights 1 2 1 --colour --out out",
    ),
    lambda request: (
        SCENE,
        Group(
            "source (default: as the scene says)",
            (*options_of(request.GhostsRequest, "field_deg", "field_mm", "light"), SOURCE, *SENSORS),
        ),
        ray_tree(
            "start rays at each field (1e6)", *options_of(request.GhostsRequest, "contested_rays"), TIME, SCHEDULER
        ),
        SURFACES,
        SCATTER,
        output(
            "report.html, CSV, JSON, PNG and path-sort files",
            FILES,
            *options_of(request.GhostsRequest, "rank"),
            *options_of(
                request.GhostTables,
                "per_wavelength",
                "levels",
                "alias",
                "path_analysis",
                "least_share",
                "filter",
                "photometric",
                "rays_at",
                "most_rays",
                "maps",
            ),
            formats=(*TABLE_FORMATS, *MAP_FORMATS, RAY_FORMAT),
        ),
        group("colour pictures (need --out and three wavelengths or more)", request.GhostTables, "colour", "look"),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray ghosts` with parsed options and return the exit code."""
    from mistray.analyses.ghosts.request import GhostsRequest, GhostTables

    request, shown = request_of(GhostsRequest, vars(options)), request_of(GhostTables, vars(options))
    _refuse(options)
    options.start()
    from mistray.analyses.ghosts import run as analysis
    from mistray.analyses.ghosts.checks import check_tables, prepare
    from mistray.analyses.ghosts.page.record import record, text

    scene = options.load()
    check_tables(scene, request, shown)
    report: GhostReport | None = None
    files: list[Path] = []
    try:
        # The maps of the report are traced by the workers as well
        with within(options.seconds_left(0.0)), options.workers():
            with options.stepping() as progress:
                report = analysis.run(scene, request, progress=progress, seconds=_seconds_of_trace(options, request))
            with options.working("mapping the light"):
                prepare(report, shown)
            if options.out is not None:
                files = _write(report, shown, options)
    except UnfinishedError as error:
        if report is not None:  # all is traced, but for the maps
            error.partial = report
        _write_unfinished(error, shown, options)
        raise
    except KeyboardInterrupt as error:
        finished = error.partial if isinstance(error, Interrupted) else report
        if not isinstance(finished, Mapping) or not finished or options.out is None:
            raise KeyboardInterrupt from None
        _write_tables(finished, shown, options)
        raise Interrupted(f"{error}" if isinstance(error, Interrupted) else "all is traced", finished) from None
    return options.show(lambda: record(report, shown), lambda: text(report, shown), files)


def _refuse(options: Options) -> None:
    """Raise `MistrayError` for options given without another one that they need, or output without a destination."""
    for words, needed, why in (
        (["least_share"], options.path_analysis, "the path analysis; add --path-analysis power_W, or leave it out"),
        (["most_rays"], options.rays_at, "the rays of --rays-at; add it, or leave this out"),
        (["stops", "reference", "white", "block"], options.colour, "colour pictures; add --colour, or leave it out"),
    ):
        if not needed:
            options.refuse(words, f" is about {why}")
    if RAY_FORMAT in options.formats and not options.rays_at:
        raise MistrayError(f"--formats {RAY_FORMAT} writes the rays of --rays-at; add it, or leave the format out")
    if options.out is None:
        options.refuse(["rays_at"], " writes rays_at.csv; say with --out where it shall go")
        options.refuse(["colour"], " draws pictures; say with --out where they shall go")


def _seconds_of_trace(options: Options, request: GhostsRequest) -> float | None:
    """
    Return the part of --seconds available to the trace, s, leaving time for the report; None without a limit.

    If files are written, it is only half of that, for their pictures.
    """
    fields = request.field_deg or request.field_mm or [0.0]
    left = options.seconds_left(PAGE_S + FIELD_S * len(fields))
    if left is None or options.out is None:
        return left
    return max(SHARE_OF_TRACE * left, SECONDS.low)


def _write(report: GhostReport, shown: GhostTables, options: Options) -> list[Path]:
    """
    Write all files and return their paths; if that fails, write as many tables as possible, and print the main one.

    Raises
    ------
    MistrayError
        If a file cannot be written; the message names the tables that are. An `UnfinishedError` passes unchanged.
    """
    from mistray.analyses.ghosts.page.output import page
    from mistray.analyses.ghosts.tables.printed import WORST_SHOWN, main_table

    try:
        return options.write(lambda title, line: page(report, shown, title, line))
    except UnfinishedError:
        raise
    except MistrayError as error:
        kept = ", ".join(path.name for path in _write_tables(report, shown, options)) or "nothing"
        traced = ", ".join(f"{field:g}" for field in report)
        print(main_table(report, WORST_SHOWN, shown.per_wavelength))
        raise MistrayError(
            f"{error}; of the fields {traced} deg {kept} is written, and the main table is printed"
        ) from None


def _write_unfinished(error: UnfinishedError, shown: GhostTables, options: Options) -> None:
    """
    Write a report of the finished fields, and of the unfinished one with the rays that it has, and name it in `error`.

    Do nothing without --out, or if too little is finished for a report.
    """
    from mistray.analyses.ghosts.page.output import page
    from mistray.analyses.ghosts.request import GhostTables
    from mistray.analyses.ghosts.result import GhostReport

    report, main = error.partial, GhostTables(per_wavelength=shown.per_wavelength)
    if options.out is None or not isinstance(report, GhostReport):
        return
    rays = "; ".join(f"{field:g}°: {t.rays_traced:.4g} of {t.rays_planned:.4g} rays" for field, t in report.items())
    options.write(lambda title, line: page(report, main, title, line), note=f", unfinished ({rays})")
    error.args = (f"{error}; a report of what is finished is in {options.out}",)


def _write_tables(report: Any, shown: GhostTables, options: Options) -> list[Path]:
    """
    Write the finished tables as far as possible and return the paths of those that are written.

    Irradiance maps are left out, as they take as long as a trace.
    """
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables
    from mistray.replace_file import replace_file
    from mistray.toolkit.pages.output import csv_text

    files: list[Path] = []
    if isinstance(report, GhostReport):
        with contextlib.suppress(OSError, MistrayError):
            options.out.mkdir(parents=True, exist_ok=True)
            for name, table in csv_tables(report, shown.per_wavelength).items():
                files.append(replace_file(options.out / name, csv_text(table, in_full=True), "table"))
    return files

"""`mistray ghosts`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import RAW, count, field, finite
from mistray.cli.ghosts_json import WORST_SHOWN, as_json
from mistray.cli.tracing_arguments import (
    MAP_FORMATS,
    TABLE_FORMATS,
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_scheduler,
    add_spectrum,
    check_formats,
    check_weights,
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
    from pathlib import Path

    from mistray.analysis import GhostReport
    from mistray.report import Look


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "ghosts",
        help="trace the ghosts and the scattered light of a scene and rank them",
        description="Trace a scene at one or more field angles, list all paths to the detector and rank the stray\n"
        "ones by RMS irradiance P/(π r_rms²), relative to the direct image on axis.",
        epilog="examples:\n"
        "  mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json\n"
        "  mistray ghosts scene.xml --max-scatters 2 --max-reflections 1 --aimed-rays 4 --out out\n"
        "  mistray ghosts scene.xml --out out --formats parquet fits\n"
        "  mistray ghosts scene.xml --rays 1e9 --scheduler tcp://host:8786 --out out    # docs/distributed.md\n"
        "  mistray ghosts scene.xml --wavelength-nm 450 550 650 --weights 1 2 1 --colour --out out",
        formatter_class=RAW,
    )
    add_scene(parser)
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=field, nargs="+", metavar="DEG", help="field angles, degrees")
    source.add_argument("--azimuth-deg", type=finite, metavar="DEG", help="azimuth of the field about z, degrees")
    add_spectrum(source)
    add_scheduler(add_ray_tree(parser, "start rays at each field (1e6)"))
    add_scatter(parser)
    formats = (*TABLE_FORMATS, *MAP_FORMATS)
    output = add_output(parser, "report.html, CSV, PNG and path-sort files", formats=formats)
    output.add_argument("--per-wavelength", action="store_true", help="add paths and ledgers at each wavelength")
    output.add_argument("--levels", action="store_true",
                        help="print stray light by level of scatter or splitting and by critical surface")  # fmt: skip
    output.add_argument("--filter", metavar="EXPR",
                        help="add the paths that pass a filter, such as 'G(lens*) & !S' (docs/rays.md), and with --out "
                        "filtered_paths.csv and filtered_rays.csv")  # fmt: skip
    colour = parser.add_argument_group("colour pictures (need --out and three wavelengths or more)")
    colour.add_argument("--colour", action="store_true", help="draw the ghosts as a photograph would show them")
    colour.add_argument("--stops", type=finite, metavar="S",
                        help="exposure, stops over the one that just fills the brightest channel (0)")  # fmt: skip
    colour.add_argument("--reference", choices=("ghosts", "direct"),
                        help="brightest pixel of the stray light, or of the direct image on axis (ghosts)")  # fmt: skip
    colour.add_argument("--white", choices=("source", "D65"),
                        help="what comes out as grey: the light of the source, or D65 (source)")  # fmt: skip
    colour.add_argument("--block", type=count, metavar="N",
                        help="pixels averaged along each side; 0: as many as the noise asks for (0)")  # fmt: skip
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    start_mitsuba(options)
    from mistray.analysis import ghosts
    from mistray.report import main_table
    from mistray.report.level_tables import filter_text, level_text
    from mistray.scene import load
    from mistray.trace.path_filter import PathFilter

    check_weights(options)
    check_formats(options)
    look = _look(options)
    PathFilter(options.filter or "")  # an error in its text shows before the trace
    claim_output(options)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    if look is not None:
        from mistray.report.colour import check_wavelengths

        check_wavelengths(options.wavelength_nm or _own_wavelengths(scene))
    lines = options.per_wavelength
    files, report = [], None
    try:
        with workers_of(options):
            with progress_bar(options) as progress:
                report = ghosts(
                    scene,
                    fields_deg=options.field_deg,
                    wavelength_nm=options.wavelength_nm,
                    weights=options.weights,
                    azimuth_deg=options.azimuth_deg,
                    progress=progress,
                    **settings_of(options),
                )
            for field in report if options.filter else ():  # so does a name that the scene does not have
                report.filtered(field, options.filter)
            if options.out is not None:
                from mistray.report import write_all

                with working("drawing the report", options.quiet):
                    title = scene_title(options.scene)
                    files = write_all(report, options.out, title, options.command_line, lines, look)
                    files += _write_filtered(report, options) + _write_formats(report, options)
    except UnfinishedError as error:
        if report is not None:  # all is traced, but for the maps
            error.partial = report
        _write_unfinished(error, options)
        raise

    def text() -> str:
        parts = [main_table(report, WORST_SHOWN, lines)]
        parts += [level_text(report)] if options.levels else []
        parts += [filter_text(report, options.filter)] if options.filter else []
        return "\n\n".join(parts)

    show(options, lambda: as_json(report, lines, options.filter), text, files)
    return 0


def _write_filtered(report: GhostReport, options: argparse.Namespace) -> list[Path]:
    """The paths that pass the filter, and rays of them."""
    from mistray.replace_file import replace_file
    from mistray.report.csv_tables import filter_frame, filter_rays

    if not options.filter:
        return []
    return [
        replace_file(options.out / name, make(report, options.filter).to_csv(index=False, lineterminator="\n"), "table")
        for name, make in (("filtered_paths.csv", filter_frame), ("filtered_rays.csv", filter_rays))
    ]


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


def _write_formats(report: GhostReport, options: argparse.Namespace) -> list[Path]:
    """The tables as Parquet, and irradiance_<field>deg in the other formats."""
    from mistray.report import IrradianceMap, write_formats
    from mistray.report.csv_tables import csv_tables

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

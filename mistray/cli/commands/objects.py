"""`mistray objects`."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from mistray.cli.arguments import Help, add_angles
from mistray.cli.claims import claim_folder
from mistray.cli.tracing_arguments import (
    ELSE,
    TABLE_FORMATS,
    add_machine,
    add_output,
    add_scene,
    add_seconds,
    add_setting,
    check_formats,
    progress_bar,
    scene_title,
    seconds_left,
    show,
    start_mitsuba,
    working,
)
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, CONE_DEG, PLACE_MM, RAYS, ROWS, SHARE, WAVELENGTH_NM

ROWS_SHOWN = 25
HALF_ANGLE_DEG = 20.0

# What --out writes
FILES = ("objects.*", "objects_*.csv")


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "objects",
        help="critical, illuminated and common objects of a scene, and the light that they scatter",
        description="Objects that the detector sees (critical), that light from outside reaches (illuminated), and\n"
        "both (common): surfaces only transmit, mirrors reflect, nothing is split or scattered. Light that common\n"
        "objects and optics send to the detector by one scatter event is estimated as flux x BSDF x pi GCF. Ways by\n"
        "which the detector sees the outside past the optics are told as warnings.",
        epilog="examples:\n"
        "  mistray objects phone_camera --half-angle-deg 20 --out out\n"
        "  mistray objects phone_camera_scatter --field-deg 0 10 20:40:5 --rays 3e5\n"
        "  mistray objects phone_camera --disc -5.75 3.083 --view-half-angle-deg 45 --threshold 0 --json",
        formatter_class=Help,
    )
    add_scene(parser)
    source = parser.add_argument_group("light from outside (one of the first three)")
    source.add_argument("--half-angle-deg", type=CONE_DEG, metavar="DEG",
                        help=f"from everywhere within this angle of the axis ({HALF_ANGLE_DEG:g})")  # fmt: skip
    add_angles(source, "--field-deg", "a distant source at field angles: numbers, and ranges first:last:step")
    source.add_argument("--disc", type=PLACE_MM, nargs=2, metavar=("Z", "RADIUS"),
                        help="a Lambertian disc across the z axis, mm; its cone is --half-angle-deg")  # fmt: skip
    source.add_argument("--azimuth-deg", type=AZIMUTH_DEG, metavar="DEG",
                        help="azimuth of --field-deg, from +y to -x (0)")  # fmt: skip
    source.add_argument("--wavelength-nm", type=WAVELENGTH_NM, metavar="NM",
                        help="wavelength (first of the scene's source)")  # fmt: skip
    view = parser.add_argument_group("view of the detector")
    view.add_argument("--view-half-angle-deg", type=CONE_DEG, metavar="DEG",
                      help="rays leave the detector within this angle of its normal (90)")  # fmt: skip
    view.add_argument("--detector", metavar="ID", help="shape with the sensor, where the scene has several")
    view.add_argument("--stop", metavar="NAME", help="part or shape that is the aperture stop (found by marginal rays)")
    tracing = parser.add_argument_group(f"rays {ELSE}")
    tracing.add_argument("--rays", type=RAYS, metavar="N",
                         help="start rays from the detector, and from outside at each angle (1e6)")  # fmt: skip
    tracing.add_argument("--threshold", type=SHARE, metavar="W",
                         help="flux that makes an object count, W for each W that starts (1e-6)")  # fmt: skip
    add_setting(tracing, "ray_control", default="transmit_specular")
    tracing.add_argument("--no-total-reflection", action="store_true", help="end rays in total reflection")
    add_setting(tracing, "max_events")
    add_setting(tracing, "seed")
    add_seconds(tracing)
    add_machine(tracing)
    output = add_output(parser, "objects.html, CSV, JSON and PNG files", FILES, formats=TABLE_FORMATS)
    output.add_argument("--rows", type=ROWS, default=ROWS_SHOWN, metavar="N", help=f"rows of each table ({ROWS_SHOWN})")
    parser.take_old_name("--angles-deg", "--field-deg")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    _check(options)
    check_formats(options)
    start_mitsuba(options)
    from mistray.analysis.objects.search import objects
    from mistray.analysis.objects.sources import DiskSource
    from mistray.report.tables.objects import csv_tables, objects_record, objects_text
    from mistray.scene import load

    claim_folder(options)
    half_angle = options.half_angle_deg
    source = None
    if options.disc is not None:
        z, radius = options.disc
        source = DiskSource((0.0, 0.0, z), radius, HALF_ANGLE_DEG if half_angle is None else half_angle)
        half_angle = None
    given = {
        "rays": options.rays,
        "half_angle_deg": half_angle,
        "field_deg": options.field_deg,
        "azimuth_deg": options.azimuth_deg,
        "source": source,
        "view_half_angle_deg": options.view_half_angle_deg,
        "wavelength_nm": options.wavelength_nm,
        "detector": options.detector,
        "stop": options.stop,
        "threshold": options.threshold,
        "ray_control": options.ray_control,
        "max_events": options.max_events,
        "seed": options.seed,
    }
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    with progress_bar(options) as progress:
        found = objects(
            scene,
            total_reflection=not options.no_total_reflection,
            progress=progress,
            seconds=seconds_left(options),
            **{key: value for key, value in given.items() if value is not None},
        )
        estimates = found.estimates()
    files = []
    if options.out is not None:
        from mistray.report.formats import write_formats
        from mistray.report.objects_output import write_objects

        with working("drawing the report", options.quiet):
            files = write_objects(found, estimates, options.out, scene_title(options.scene), options.command_line)
            tables = csv_tables(found, estimates)
            files += write_formats(options.formats, options.out, tables, {}, {"command": options.command_line})
    text = partial(objects_text, found, estimates, options.rows)
    show(options, partial(objects_record, found, estimates), text, files, "objects.html")
    return 0


def _check(options: argparse.Namespace) -> None:
    """Refuse arguments that do not fit together."""
    if options.field_deg is not None:
        for name in ("half_angle_deg", "disc"):
            if getattr(options, name) is not None:
                raise MistrayError(
                    f"--field-deg and --{name.replace('_', '-')} are two kinds of source; give one of them"
                )
    elif options.azimuth_deg is not None:
        raise MistrayError("--azimuth-deg is about --field-deg; give that too, or leave it out")

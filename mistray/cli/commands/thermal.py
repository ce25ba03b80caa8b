"""`mistray thermal`."""

from __future__ import annotations

import argparse
from typing import Any

from mistray.cli.arguments import Help
from mistray.cli.claims import claim_folder
from mistray.cli.tracing_arguments import (
    TABLE_FORMATS,
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_seconds,
    check_formats,
    progress_bar,
    scene_title,
    seconds_left,
    settings_of,
    show,
    start_mitsuba,
    working,
)
from mistray.ranges import TEMPERATURE_K, WAVELENGTH_UM

# What --out writes
FILES = ("report.html", "thermal.*", "narcissus.csv")


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "thermal",
        help="irradiance that warm optics and structure put on their own detector",
        description="Trace a scene backwards from its detector and add up what every surface and medium emits towards\n"
        "it: π L of a blackbody of its temperature times what it absorbs, 1 - R - T - scatter.",
        epilog="examples:\n"
        "  mistray thermal scene.xml --temperature-K 293 --band-um 8 12 --out out\n"
        "  mistray thermal scene.xml --band-um 3 5 --part detector=77 'baffle_*=150' --scene-K 300\n"
        "  mistray thermal scene.xml --band-um 8 12 --wavelength-um 2 --max-scatters 3 --json",
        formatter_class=Help,
    )
    add_scene(parser)
    warmth = parser.add_argument_group("temperatures")
    warmth.add_argument("--temperature-K", type=TEMPERATURE_K, default=293.0, metavar="T",
                        help="of everything without one of its own, K (293)")  # fmt: skip
    warmth.add_argument("--part", type=_named, nargs="+", action="extend", metavar="NAME=T",
                        help="of surfaces, parts or materials by name, with * and ?; the last holds")  # fmt: skip
    warmth.add_argument("--scene-K", type=TEMPERATURE_K, metavar="T",
                        help="of the blackbody around the system, K (--temperature-K)")  # fmt: skip
    band = parser.add_argument_group("band")
    band.add_argument("--band-um", type=WAVELENGTH_UM, nargs=2, default=(8.0, 12.0), metavar=("LOW", "HIGH"),
                      help="of the detector, µm (8 12)")  # fmt: skip
    band.add_argument("--wavelength-um", type=WAVELENGTH_UM, nargs="+", metavar="UM",
                      help="where optics are traced, µm (middle of the band, and its ends if need be)")  # fmt: skip
    band.add_argument("--detector", metavar="ID", help="shape with the sensor, where the scene has several")
    add_seconds(add_ray_tree(parser, "rays from the detector, for each wavelength and twice (2e5)"))
    add_scatter(parser)
    add_output(parser, "report.html, CSV, JSON and PNG files", FILES, formats=TABLE_FORMATS)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    check_formats(options)
    start_mitsuba(options)
    from mistray.analysis.thermal.emission import thermal
    from mistray.report.thermal import csv_tables, thermal_record, thermal_text, write_thermal
    from mistray.scene import load

    claim_folder(options)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    with progress_bar(options) as progress:
        report = thermal(
            scene,
            options.temperature_K,
            tuple(options.band_um),
            temperatures=dict(options.part or ()),
            scene_K=options.scene_K,
            wavelengths_um=options.wavelength_um,
            detector=options.detector,
            progress=progress,
            seconds=seconds_left(options),
            **settings_of(options),
        )
    files = []
    if options.out is not None:
        from mistray.report.formats import write_formats

        with working("drawing the report", options.quiet):
            files = write_thermal(report, options.out, scene_title(options.scene), options.command_line)
            tables = csv_tables(report)
            files += write_formats(options.formats, options.out, tables, {}, {"command": options.command_line})
    show(options, lambda: thermal_record(report), lambda: thermal_text(report), files)
    return 0


def _named(text: str) -> tuple[str, float]:
    """NAME=T."""
    name, found, value = text.rpartition("=")
    if not found or not name:
        raise argparse.ArgumentTypeError(f"'{text}' is no NAME=T, such as detector=77")
    return name, TEMPERATURE_K(value)

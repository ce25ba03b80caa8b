"""`mistray budget`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mistray.cli.arguments import Help
from mistray.cli.claims import claim_folder
from mistray.cli.tracing_arguments import (
    add_machine,
    add_output,
    add_scene,
    progress_bar,
    scene_title,
    show,
    start_mitsuba,
    working,
)

# What --out writes
FILES = ("scene.xml", "report.html", "budget.*", "requirements.csv")


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "budget",
        help="how clean and how smooth each surface must be to meet a PST requirement at the least cost",
        description="Allocate cleanliness levels and roughness to the surfaces of a scene so that stray-light metrics\n"
        "stay below their limits at the least cost. BUDGET is a TOML file with the limits, the surfaces and what\n"
        "things cost; docs/sensitivity.md describes it. The result is measured on other random numbers.",
        epilog="examples:\n"
        "  mistray budget phone_camera_scatter budget.toml --out out/budget\n"
        "  mistray budget scene.xml budget.toml --json",
        formatter_class=Help,
    )
    add_scene(parser)
    parser.add_argument("budget", metavar="BUDGET", type=Path, help="TOML file")
    add_machine(parser)
    add_output(parser, "scene.xml, report.html, CSV files, JSON and a picture", FILES)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    start_mitsuba(options)
    from mistray.optimize.tolerances.budget import budget
    from mistray.optimize.toml.read_budget import read_budget
    from mistray.report.tables.budget import budget_record, budget_text

    claim_folder(options)
    study = read_budget(options.budget)
    with progress_bar(options) as progress:
        result = budget(options.scene, study, progress=progress)
    files = []
    if options.out is not None:
        from mistray.report.budget_output import write_budget

        with working("drawing the report", options.quiet):
            files = write_budget(result, options.out, scene_title(options.scene), options.command_line)
    show(options, lambda: budget_record(result), lambda: budget_text(result), files)
    return 0

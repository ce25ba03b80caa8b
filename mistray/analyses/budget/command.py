"""Command `mistray budget`: roughness and cleanliness of surfaces that meet limits at the least cost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mistray.toolkit.command import Command, Option
from mistray.toolkit.shared_options import MACHINE, SCENE, TABLE_FORMATS, output

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

COMMAND = Command(
    "budget",
    "how clean and how smooth each surface must be to meet a PST requirement at the least cost",
    "Allocate cleanliness levels and roughness to the surfaces of a scene so that stray-light metrics\n"
    "stay below their limits at the least cost. BUDGET is a TOML file with the limits, the surfaces and what\n"
    "things cost; docs/sensitivity.md describes it. The result is measured on other random numbers.",
    (
        "mistray budget phone_camera_scatter budget.toml --out out/budget",
        "mistray budget scene.xml budget.toml --json",
    ),
    (
        SCENE,
        Option("budget", "TOML file", Path, "BUDGET"),
        *MACHINE,
        output(
            "scene.xml, report.html, CSV files, JSON and a picture",
            ("scene.xml", "report.html", "budget.*", "requirements.csv"),
            formats=TABLE_FORMATS,
        ),
    ),
)


def run(options: Options) -> int:
    """Run `mistray budget` with parsed options and return the exit code."""
    options.start()
    from mistray.analyses.budget import page
    from mistray.analyses.budget.read_budget import read_budget
    from mistray.analyses.budget.run import budget

    study = read_budget(options.budget)
    with options.tracing() as progress:
        result = budget(options.scene, study, progress=progress)
    files = options.write(lambda title, command: page.page(result, title, command), result.scene_text)
    return options.show(lambda: page.record(result), lambda: page.text(result), files)

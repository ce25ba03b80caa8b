"""Command `mistray optimize`: minimise stray light over the variables of a study."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mistray.toolkit.command import Command, Option
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.shared_options import MACHINE, SCENE, TABLE_FORMATS, TIME, output

if TYPE_CHECKING:
    from mistray.analyses.optimize.study.state import Start, Step
    from mistray.cli.parsed_options import Options

CHECKPOINT = "checkpoint.json"
FILES = (
    "scene.xml",
    "report.html",
    CHECKPOINT,
    "terms.csv",
    "variables.*",
    "history.csv",
    "search.png",
    "reflectance.png",
)
BAR = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"
COMMAND = Command(
    "optimize",
    "make stray light small by coatings, shapes, positions, rims and scatter",
    "Search values of a scene's parameters that make a merit small, along the gradient of the traced\n"
    "merit, and prove the result on other random numbers. STUDY is a TOML file that says what is to be small,\n"
    "what is to be kept, and what may change; docs/optimization.md describes it.",
    (
        "mistray optimize cooke_triplet examples/triplet_ar.toml --out out/triplet_ar",
        "mistray optimize cooke_triplet examples/triplet_ar.toml --out out/triplet_ar --steps 80 --resume",
    ),
    lambda request: (
        SCENE,
        Option("study", "TOML file", Path, "STUDY"),
        *options_of(request.DesignRequest, "steps", "verification_seeds"),
        TIME,
        *options_of(request.DesignRequest, "next_order"),
        Option("--resume", "go on from the checkpoint in --out", bool),
        *MACHINE,
        output("scene.xml, report.html, tables, pictures and the checkpoint", FILES, formats=TABLE_FORMATS),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray optimize` with parsed options and return the exit code."""
    from mistray.analyses.optimize.request import DesignRequest

    request = request_of(DesignRequest, vars(options))
    folder = options.start()
    from mistray.analyses.optimize.page import optimization_report, scene_text
    from mistray.analyses.optimize.study.optimization import run as optimize
    from mistray.analyses.optimize.tables import optimization_record, report_text, step_text
    from mistray.analyses.optimize.toml.read_study import read_study

    study = read_study(options.study)
    steps = study.optimizer.steps if request.steps is None else request.steps
    saved = options.saved_run(CHECKPOINT, lambda: "all steps are")
    with saved.reported():
        searched = min(study.optimizer.starts, study.optimizer.searches) * steps
        with options.bar(BAR, "starts", max(searched, 1)) as bar:

            def shown(step: Step, start: Start) -> None:
                """Print a line for a step, and below it a progress bar over the steps; do nothing without a bar."""
                if bar is None:
                    return
                bar.write(step_text(step, start), file=sys.stderr)
                if step.step:
                    text = f"search from start {step.start + 1}, merit {step.merit:.4f}"
                    bar.set_description_str(text, refresh=False)
                    bar.n += 1
                    bar.refresh()

            how = {"checkpoint": saved.path, "resume": options.resume, "seconds": options.seconds_left()}
            result = optimize(options.scene, request, study, progress=shown, **how)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        files = options.write(
            lambda _, command: optimization_report(result, command), lambda path: scene_text(result, path)
        )
        options.show(lambda: optimization_record(result), lambda: report_text(result), files)
    return saved.code

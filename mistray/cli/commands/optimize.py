"""`mistray optimize`."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.options import Options
from mistray.cli.progress import terminal_bar
from mistray.cli.saved_run import SavedRun
from mistray.errors import MistrayError
from mistray.ranges import ROWS, SEEDS
from mistray.toolkit.command import Command, Option
from mistray.toolkit.shared_options import MACHINE, NEXT_ORDER, SCENE, TABLE_FORMATS, TIME, output

if TYPE_CHECKING:
    from mistray.analyses.design.study.state import Start, Step

# What --out writes
FILES = (
    "scene.xml",
    "report.html",
    "checkpoint.json",
    "terms.csv",
    "variables.*",
    "history.csv",
    "search.png",
    "reflectance.png",
)

# fmt: off
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
    (
        SCENE,
        Option("study", "TOML file", Path, "STUDY"),
        Option("--steps", "most steps of each search (default: as the study says)", ROWS, "N"),
        Option("--verification-seeds", "seeds on which the result is compared with the given design, at least 2 (8)",
               SEEDS, "N", default=8),
        TIME,
        NEXT_ORDER,
        Option("--resume", "go on from the checkpoint in --out", bool),
        *MACHINE,
        output("scene.xml, report.html, tables, pictures and the checkpoint", FILES, formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    if options.resume and options.out is None:
        raise MistrayError("--resume needs the folder of the checkpoint; give --out")
    folder = options.start()
    from mistray.analyses.design.study.optimization import optimize
    from mistray.analyses.design.tables import optimization_record, report_text
    from mistray.analyses.design.toml.read_study import read_study

    study = read_study(options.study)
    steps = study.optimizer.steps if options.steps is None else options.steps
    checkpoint = None if folder is None else folder / "checkpoint.json"
    saved = SavedRun(checkpoint, lambda: "all steps are", options.resume)
    files: list[Path] = []
    with saved.told():
        with _progress(options, min(study.optimizer.starts, study.optimizer.searches) * steps) as shown:
            result = optimize(
                options.scene,
                study,
                steps=steps,
                checkpoint=checkpoint,
                resume=options.resume,
                progress=shown,
                verification_seeds=options.verification_seeds,
                seconds=options.seconds_left(),
                next_order=not options.no_next_order,
            )
        if folder is not None:
            from mistray.analyses.design.page import optimization_report, scene_text

            folder.mkdir(parents=True, exist_ok=True)
            files = options.write(
                lambda _, command: optimization_report(result, command), lambda path: scene_text(result, path)
            )
    return saved.code or options.show(lambda: optimization_record(result), lambda: report_text(result), files)


@contextlib.contextmanager
def _progress(options: Any, steps: int) -> Iterator[Any]:
    """A line for each step and below them a bar over the steps, on stderr when that is a terminal."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed}", "starts", max(steps, 1)) as bar:

        def shown(step: Step, start: Start) -> None:
            if bar is None:
                return
            bar.write(step_text(step, start), file=sys.stderr)
            if step.step:
                bar.set_description_str(f"search from start {step.start + 1}, merit {step.merit:.4f}", refresh=False)
                bar.n += 1
                bar.refresh()

        yield shown


def step_text(step: Step, start: Start) -> str:
    """A step in one line: merit, terms, and an exclamation mark at each that breaks its limit."""
    terms = ", ".join(
        f"{name} {value:.4g}{' (!)' if name in step.broken else ''}" for name, value in step.terms.items()
    )
    return (
        f"start {step.start + 1} ({start.name}), step {step.step}: merit {step.merit:.4f} ± {step.merit_se:.1e}; "
        f"{terms}; |gradient| {step.gradient_norm:.1e}, {step.seconds:.0f} s"
    )
